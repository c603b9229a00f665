"""What INS estimates are judged by: position, velocity, heading, or what is measured next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from navgym.core.checks import Array
from navgym.ins.batch import InsBatch
from navgym.ins.kinds import DVL_KIND, FIRST, FIX_KIND, INNOVATIONS, NAMES
from navgym.ins.layout import PHI, STATES
from navgym.ins.settings import SETTLED
from navgym.metrics.consistency import nees as normalised
from navgym.metrics.errors import run_rmse
from navgym.problem import Believed, Run, Span

WHOLE: Span = (0.0, 1.0)
NAVIGATION = 9  # states that references know


def errors(
    batch: InsBatch, states: Array, names: Sequence[str], span: Span = WHOLE
) -> dict[str, Array]:
    """RMSE of the horizontal position (m) and velocity (m/s) and of the heading (°); see `Scoring.errors`.

    What comes before `SETTLED` is left out.
    """
    judged = scored(batch, span)
    return {
        name: run_rmse(np.where(judged, squared(batch, states, name, span), np.nan))
        for name in names
    }


def squared(batch: InsBatch, states: Array, name: str, span: Span = WHOLE) -> Array:
    """Squared errors over time (N, K), settling and all; NaN outside the span and without a reference.

    Raises ValueError for recordings without truth.
    """
    truth = batch.truth
    if truth is None:
        raise ValueError(
            "errors need recordings with truth to score against: set truth=, or measure by one of the "
            "one-step errors, which need none."
        )
    with np.errstate(over="ignore", invalid="ignore"):
        difference = states - truth[..., : states.shape[-1]]
        if name == "heading":
            angle = difference[..., PHI.start + 2]
            each = np.degrees((angle + np.pi) % (2.0 * np.pi) - np.pi) ** 2
        else:
            first = 0 if name == "position" else 3
            each = (difference[..., first : first + 2] ** 2).sum(axis=-1)
    known = np.isfinite(truth[..., :NAVIGATION]).all(axis=-1)
    each = np.where(known & ~np.isfinite(each), np.inf, each)
    return np.where(_within(batch, span) & known, each, np.nan)


def _within(batch: InsBatch, span: Span) -> NDArray[np.bool_]:
    first, last = (np.round(share * batch.lengths)[:, None] for share in span)
    k = np.arange(batch.steps)
    inside: NDArray[np.bool_] = (k >= first) & (k < last)
    return inside


def scored(batch: InsBatch, span: Span) -> NDArray[np.bool_]:
    """Which steps (N, K) are judged: within the span, what settles left out.

    Raises ValueError for a recording that is shorter than that.
    """
    mask = _within(batch, span) & (np.arange(batch.steps) >= round(SETTLED / batch.step))
    if not mask.any(axis=1).all():
        shortest = float(batch.lengths.min() * batch.step)
        raise ValueError(
            f"recordings must be longer than the {SETTLED:g} s that are not scored, got {shortest:g} s."
        )
    return mask


def nees(batch: InsBatch, run: Run) -> Array:
    """Normalised error squared of position, velocity and attitude per degree of freedom, (N, K)."""
    truth = batch.truth
    assert truth is not None
    known, own = truth[..., :NAVIGATION].copy(), run.states[..., :NAVIGATION].copy()
    own[..., PHI] = tilts(own[..., PHI], known[..., PHI])
    known[..., PHI] *= 0.0  # NaN stays
    P = run.covariances[..., :NAVIGATION, :NAVIGATION]
    found: Array = normalised(own, P, known) / NAVIGATION
    return found


def tilts(estimated: Array, true: Array) -> Array:
    """φ (..., 3) of roll, pitch and heading (..., 3) against true ones: Ĉ = (I − [φ×]) C; NaN where unknown."""
    found = np.full(estimated.shape, np.nan)
    good = np.isfinite(estimated).all(axis=-1) & np.isfinite(true).all(axis=-1)
    if good.any():
        own, other = (Rotation.from_euler("ZYX", x[good][:, ::-1]) for x in (estimated, true))
        found[good] = -(own * other.inv()).as_rotvec()
    return found


def rows(batch: InsBatch) -> dict[str, Array]:
    """Innovations (N, m) of Doppler velocities and of position fixes, by name; see `Scoring.rows`."""
    found = {}
    for name, kind in (("velocities", DVL_KIND), ("fixes", FIX_KIND)):
        heard = [
            any(r.model.sensors[s].kind == NAMES[kind] and not a.lost.all() for s, a in r.aiding.items())
            for r in batch.recordings
        ]  # fmt: skip
        if all(heard):
            factors = np.zeros((len(batch), INNOVATIONS))
            factors[:, FIRST[kind] : FIRST[kind + 1]] = 1.0
            found[name] = factors
    return found


def noises(batch: InsBatch) -> dict[str, Believed]:
    """What models believe of noise, by name; see `Problem.noises`."""
    model = batch.recordings[0].model
    _, gyro, _, accelerometer, _, _ = model.grade.si
    found = {"imu": Believed((gyro, accelerometer), "imu_noise_scale")}
    scales = {
        "dvl": "dvl_noise_scale", "fix": "fix_noise_scale", "magnetometer": "magnetic_noise_scale",
        "heading": "magnetic_noise_scale",
    }  # fmt: skip
    for name, sensor in model.sensors.items():
        if sensor.kind in scales:
            found[name] = Believed(tuple(sensor.noise.tolist()), scales[sensor.kind])
    return found


__all__ = ["STATES", "errors", "nees", "noises", "rows", "scored", "squared", "tilts"]
