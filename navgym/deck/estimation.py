"""Run a deck filter over recordings of two IMUs, and read attitude and deformation off its states."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from navgym.core.checks import Array
from navgym.deck.alignment import PHI, RATE, THETA, L
from navgym.deck.batch import DeckBatch
from navgym.deck.filters import Identified
from navgym.deck.filters import estimate as run_lanes
from navgym.deck.hypotheses import LAGS
from navgym.deck.increments import increments_of, rodrigues
from navgym.deck.mechanization import TAPE, coarse_alignment, write_tape
from navgym.deck.recording import DualIMURecording
from navgym.estimation import Estimate
from navgym.estimation import estimate as run_filter
from navgym.inertial.flexure import ARCMIN
from navgym.problem import Filter, Run

UNOBSERVED = np.radians(0.5)  # standard deviation of an attitude that counts as not observed


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class DeckEstimate(Estimate):
    """What a deck filter made of one recording. K filter steps; angles in rad, main IMU's axes.

    States and covariances are of l, δV, φ, ε, ∇, V_r, θ, θ̇ (IDAM eq. 73); innovations (K, 6) are
    of velocity (m/s) and rate (rad/s), NaN where not used, NIS and likelihood under S before model
    prediction.

    Args:
        attitude: (K, 4) attitude of the sub in the main IMU's axes, quaternions, scalar last:
            C_s^m = C_im^m C_is^im (I + φ×) C_s^ŝ.
        static: (K, 3) rotation vector of the static deformation and mounting, Φ.
        theta: (K, 3) dynamic deformation.
        theta_rate: (K, 3) rad/s.
        attitude_error: (K, 3) rotation vector from the reference attitude to the estimate, arcmin,
            or None without a reference.
        unobserved: (u, 3) directions (main axes at the start) about which the attitude has not
            been learnt: heading, where nothing moves.

    A bank's `extras` hold `mode_weights` (K, 4), the probabilities of calm, rougher sea, slam and glitch,
    and its `weights` are probabilities that a row is right.
    """

    attitude: Array
    static: Array
    theta: Array
    theta_rate: Array
    attitude_error: Array | None
    unobserved: Array

    @property
    def columns(self) -> dict[str, Array]:
        """Time, attitude (qx, qy, qz, qw), deformation and its rate (rad, rad/s), attitude error (arcmin) where it is known."""
        parts = {"q": ("xyzw", self.attitude), "static_": ("xyz", self.static), "theta_": ("xyz", self.theta),
                 "theta_rate_": ("xyz", self.theta_rate)}  # fmt: skip
        if self.attitude_error is not None:
            parts["attitude_error_"] = ("xyz", self.attitude_error)
        named = {
            f"{n}{a}": x
            for n, (axes, values) in parts.items()
            for a, x in zip(axes, values.T, strict=True)
        }
        return (
            {"time": self.time} | named | {"nis": self.nis, "log_likelihood": self.log_likelihood}
        )

    @property
    def pose(self) -> tuple[Array, Array]:
        """No position, (K, 3) zeros, and the attitude of the sub in the main IMU's axes (K, 4), scalar last."""
        return np.zeros((len(self.time), 3)), self.attitude

    @property
    def innovation_variance(self) -> Array:
        """(K, 6) diagonal of S = H P⁻ Hᵀ + R."""
        found: Array = self.extras["innovation_variance"]
        return found

    @property
    def weights(self) -> Array:
        """(K, 6) of the correntropy criterion, 1 where it is off."""
        found: Array = self.extras["weights"]
        return found

    @property
    def model_error(self) -> Array:
        """(K, 3) predicted error of the flexure's acceleration, rad/s²."""
        found: Array = self.extras["model_error"]
        return found

    def theta_rate_after(self, lag: float) -> Array:
        """(K, 3) rad/s, a bank's θ̇ at each step by what was measured until `lag` s later.

        A step's mean rate tells more of where it began than of where it ends. The last steps, which
        nothing follows, are NaN.

        Args:
            lag: s, none to two filter steps.

        Raises ValueError for another lag, and for a filter that is no bank.
        """
        step = float(self.time[1] - self.time[0])
        steps = round(lag / step)
        if not abs(lag - steps * step) < 1e-6 or not 0 <= steps <= LAGS:
            told = ", ".join(f"{n * step:g}" for n in range(LAGS + 1))
            raise ValueError(f"lag must be one of {told} s, got {lag:g}.")
        if steps == 0:
            return self.theta_rate
        if "theta_rate_lagged" not in self.extras:
            raise ValueError("only banks tell rates of steps before: use deck_bank.")
        found = np.full_like(self.theta_rate, np.nan)
        found[:-steps] = self.extras["theta_rate_lagged"][steps:, steps - 1]
        return found

    @property
    def flexures(self) -> tuple[Identified, ...]:
        """Models identified on the way, with the step from which each holds."""
        return tuple(self.extras["flexures"])


def run(chosen: Filter, batch: DeckBatch, table: Array, interval: int, everything: bool) -> Run:
    """Run one deck filter over a batch; see `navgym.problem.Problem.run`."""
    if chosen.needs_scales and any(
        r.true_flexure is None or r.impulse_variance is None or r.disturbance_variance is None
        for r in batch.recordings
    ):
        raise ValueError(
            f"filter {chosen.name!r} needs the true flexure and noises, which only simulated "
            "recordings carry: use alignment or idam."
        )
    found = run_lanes(chosen, batch, table, interval, everything)
    report = found["report"]
    return Run(
        states=found["states"],
        diverged=found["diverged"],
        covariances=found["covariances"],
        innovations=report["innovation"],
        nis=report["nis"],
        log_likelihood=report["log_likelihood"],
        components=np.isfinite(report["innovation"]).sum(axis=-1),
        extras={name: report[name] for name in ("weights", "model_error", "innovation_variance")}
        | {n: found[n] for n in ("flexures", "mode_weights", "theta_rate_lagged") if n in found},
    )


def estimate(chosen: Filter, batch: DeckBatch, run: Run) -> DeckEstimate:
    """What a filter made of a batch's only recording.

    Warns (UserWarning) where the attitude cannot be observed, and where samples were filled in.
    """
    recording, states = batch.recordings[0], run.states[0]
    attitude, static = attitudes(batch.tapes[0], states)
    reference = recording.reference
    unobserved = _unobserved(run.covariances[0])
    _warn(recording, unobserved)
    if chosen.option.method is not None and not run.extras["flexures"][0]:
        warnings.warn(
            f"{chosen.name} has identified nothing in this recording of {recording.steps * recording.step:.0f} s: "
            "it is shorter than identification_window, or its increments show no flexure.",
            stacklevel=4,
        )
    return DeckEstimate.of(
        run,
        batch.time_of(0),
        attitude=attitude,
        static=static,
        theta=states[:, THETA],
        theta_rate=states[:, RATE],
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
            stacklevel=5,
        )
    filled = int(recording.gaps.sum())
    if filled:
        warnings.warn(
            f"{filled} of {len(recording)} IMU samples are missing and were filled in: the filter "
            "widened its covariance there and did not use the rates of those steps.",
            stacklevel=5,
        )


def flexure_increments(
    recording: DualIMURecording, alignment: Rotation | None = None, frame: str = "inertial"
) -> Array:
    """Increments of θ over each filter step, (K - 1, 3) rad, in the main IMU's axes.

    Args:
        recording: of both IMUs.
        alignment: attitude of the sub in the main IMU's axes at the start, Ĉ_is^im; by default the
            one that the `alignment` filter arrives at over the recording.
        frame: "inertial" differences C_s^m = C_im^m Ĉ_is^im C_s^is; "body" is the printed form
            (IDAM eq. 13-16), which leaves δΘ × θ in and locks on to the sway.

    Returns:
        Increments; NaN in steps with samples that were not received. An increment spans
        `recording.step` seconds.
    """
    tape = np.zeros(recording.steps, TAPE)
    write_tape(recording, tape)
    if alignment is None:
        alignment = final_alignment(recording)
    return increments_of(tape, alignment, frame)


def final_alignment(recording: DualIMURecording) -> Rotation:
    """Ĉ_is^im at the end of a run of `alignment` from the coarse alignment on."""
    states = run_filter("alignment", recording).states
    return (
        rodrigues(states[-1, L]) if np.isfinite(states[-1]).all() else coarse_alignment(recording)
    )
