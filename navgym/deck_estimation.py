"""Run a deck filter over recordings of two IMUs, and read attitude and deformation off its states."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from navgym._checks import Array, one_of, positive_int
from navgym.deck_batch import DeckBatch
from navgym.dual_imu import DualIMURecording
from navgym.filters.alignment import PHI, RATE, THETA, L
from navgym.filters.catalogue import CATALOGUE, DECK_CATALOGUE, Filter
from navgym.filters.deck import Identified, estimate
from navgym.flexure import ARCMIN
from navgym.increments import rodrigues
from navgym.parameters import parameter_table
from navgym.tuned import settled

DECISION_SECONDS = 1.0  # per row of a parameter schedule, as in the environment
UNOBSERVED = np.radians(0.5)  # standard deviation of an attitude that counts as not observed


@dataclass(frozen=True, eq=False)
class DeckEstimate:
    """What a deck filter made of one recording. K filter steps; angles in rad, main IMU's axes.

    Args:
        time: (K,) s.
        attitude: (K, 4) attitude of the sub in the main IMU's axes, quaternions, scalar last:
            C_s^m = C_im^m C_is^im (I + φ×) C_s^ŝ.
        static: (K, 3) rotation vector of the static deformation and mounting, Φ.
        theta: (K, 3) dynamic deformation.
        theta_rate: (K, 3) rad/s.
        states: (K, 24) l, δV, φ, ε, ∇, V_r, θ, θ̇ (IDAM eq. 73).
        covariances: (K, 24, 24) of the states.
        innovations: (K, 6) velocity (m/s) and rate (rad/s); NaN where not used.
        innovation_variance: (K, 6) diagonal of S = H P⁻ Hᵀ + R.
        weights: (K, 6) of the correntropy criterion, 1 where it is off.
        model_error: (K, 3) predicted error of the flexure's acceleration, rad/s².
        nis: (K,) normalised innovation squared under S, before model prediction.
        log_likelihood: (K,) of each innovation under S, before model prediction.
        diverged: True after a numerical failure or once innovations have run away.
        flexures: models identified on the way, with the step from which each holds.
        attitude_error: (K, 3) rotation vector from the reference attitude to the estimate, arcmin,
            or None without a reference.
        unobserved: (u, 3) directions (main axes at the start) about which the attitude has not
            been learnt: heading, where nothing moves.
    """

    time: Array
    attitude: Array
    static: Array
    theta: Array
    theta_rate: Array
    states: Array
    covariances: Array
    innovations: Array
    innovation_variance: Array
    weights: Array
    model_error: Array
    nis: Array
    log_likelihood: Array
    diverged: bool
    flexures: tuple[Identified, ...]
    attitude_error: Array | None
    unobserved: Array


def find_deck(filter_name: str | Filter) -> Filter:
    """The deck catalogue's entry; ValueError with the nearest name if there is none."""
    if isinstance(filter_name, Filter):  # a variant of one's own
        return filter_name
    if filter_name in CATALOGUE and filter_name not in DECK_CATALOGUE:
        raise ValueError(
            f"filter {filter_name!r} is for single recordings, and this one is of two IMUs: use one "
            f"of {', '.join(DECK_CATALOGUE)}."
        )
    return DECK_CATALOGUE[one_of("deck filter", filter_name, DECK_CATALOGUE)]


def run_deck(
    filter_name: str | Filter,
    batch: DeckBatch,
    parameters: Any = None,
    decision_interval: int | None = None,
    everything: bool = False,
) -> dict[str, Any]:
    """Run one deck filter over a batch: arrays (N, K, ...), see `navgym.filters.deck.estimate`."""
    chosen = find_deck(filter_name)
    if chosen.needs_scales and any(
        r.true_flexure is None or r.impulse_variance is None or r.disturbance_variance is None
        for r in batch.recordings
    ):
        raise ValueError(
            f"filter {filter_name!r} needs the true flexure and noises, which only simulated "
            "recordings carry: use alignment or idam."
        )
    usual = max(1, round(DECISION_SECONDS / batch.step))
    interval = usual if decision_interval is None else decision_interval
    positive_int("decision_interval", interval)
    steps = batch.tapes.shape[1]
    given = settled(parameters, chosen.name)
    table = parameter_table(chosen.space, given, len(batch), steps, interval)
    return estimate(chosen, batch, table, interval, everything)


def estimate_deck(
    filter_name: str,
    recording: DualIMURecording,
    parameters: Mapping[str, Any] | Any = None,
    decision_interval: int | None = None,
) -> DeckEstimate:
    """Run one deck filter over one recording; see `navgym.estimate`.

    Warns (UserWarning) where the attitude cannot be observed, and where samples were filled in.
    """
    batch = DeckBatch.of([recording])
    found = run_deck(filter_name, batch, parameters, decision_interval, everything=True)
    states, report = found["states"][0], found["report"][0]
    attitude, static = attitudes(batch.tapes[0], states)
    reference = recording.reference
    unobserved = _unobserved(found["covariances"][0])
    _warn(recording, unobserved)
    if find_deck(filter_name).option.method is not None and not found["flexures"][0]:
        warnings.warn(
            f"{filter_name} has identified nothing in this recording of {recording.steps * recording.step:.0f} s: "
            "it is shorter than identification_window, or its increments show no flexure.",
            stacklevel=3,
        )
    return DeckEstimate(
        time=recording.step_time,
        attitude=attitude,
        static=static,
        theta=states[:, THETA],
        theta_rate=states[:, RATE],
        states=states,
        covariances=found["covariances"][0],
        innovations=report["innovation"],
        weights=report["weights"],
        model_error=report["model_error"],
        nis=report["nis"],
        log_likelihood=report["log_likelihood"],
        innovation_variance=report["innovation_variance"],
        diverged=bool(found["diverged"][0]),
        flexures=tuple(found["flexures"][0]),
        attitude_error=None
        if reference is None
        else attitude_error(attitude, recording.at_steps(reference)),
        unobserved=unobserved,
    )


def attitudes(tape: Any, states: Array) -> tuple[Array, Array]:
    """Attitude of the sub in the main axes (K, 4), scalar last, and static deformation (K, 3) rad.

    2l is Φ + θ(0), so θ is not needed for the attitude, and is taken off it for the static part.
    NaN where the states are.
    """
    attitude, static = np.full((len(states), 4), np.nan), np.full((len(states), 3), np.nan)
    good = np.isfinite(states).all(axis=1)
    if good.any():
        x = states[good]
        main, sub = (Rotation.from_quat(tape[n][good], scalar_first=True) for n in ("q_m", "q_s"))
        tilt = Rotation.from_rotvec(x[:, PHI])
        found = main.inv() * rodrigues(x[:, L]) * tilt * sub
        attitude[good] = found.as_quat()
        static[good] = (Rotation.from_rotvec(x[:, THETA]).inv() * found).as_rotvec()
    return attitude, static


def attitude_error(attitude: Array, reference: Array) -> Array:
    """(K, 3) rotation vector Ĉ Cᵀ of quaternions (K, 4), scalar last, in arcmin."""
    error = np.full((len(attitude), 3), np.nan)
    good = np.isfinite(attitude).all(axis=1)
    if good.any():
        estimated, true = Rotation.from_quat(attitude[good]), Rotation.from_quat(reference[good])
        error[good] = (estimated * true.inv()).as_rotvec() / ARCMIN
    return error


def _unobserved(covariances: Array) -> Array:
    """Directions in which 2 l is still known to degrees only."""
    last = covariances[-1, L, L]
    if not np.isfinite(last).all():
        return np.empty((0, 3))
    values, vectors = np.linalg.eigh(last)
    weak: Array = vectors.T[2.0 * np.sqrt(np.maximum(values, 0.0)) > UNOBSERVED]
    return weak


def _warn(recording: DualIMURecording, unobserved: Array) -> None:
    for direction in unobserved:
        x, y, z = direction
        warnings.warn(
            f"the attitude about ({x:.2f}, {y:.2f}, {z:.2f}) (main IMU's axes at the start) cannot be "
            "observed in this recording and is known to some degrees only. It takes motion about other axes.",
            stacklevel=4,
        )
    filled = int(recording.gaps.sum())
    if filled:
        warnings.warn(
            f"{filled} of {len(recording)} IMU samples are missing and were filled in: the filter "
            "widened its covariance there and did not use the rates of those steps.",
            stacklevel=4,
        )
