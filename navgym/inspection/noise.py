"""The noise that a log itself suggests: by differences of its series, and by Allan deviations of an IMU."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import nnls

from navgym.core.checks import Array
from navgym.inspection.motion import Motion

LAGS = 16  # steps, over which a series' variogram is looked at
FEWEST = 50  # values
STRETCH = 9.0  # Allan: a time of averaging stands this often in the record


def white_and_walk(time: Array, x: Array) -> tuple[float, float] | None:
    """Deviation of a series' white noise, and root density of the walk beneath it; None for too few values.

    The mean square of differences over τ is 2σ² + a²τ: a line through robust ones at 1 to `LAGS` steps.
    """
    if len(x) < FEWEST:
        return None
    taus, squares = [], []
    for lag in range(1, min(LAGS, len(x) // 8) + 1):
        d, tau = x[lag:] - x[:-lag], time[lag:] - time[:-lag]
        usual = float(np.median(tau))
        near = np.abs(tau - usual) <= 0.5 * usual / lag
        if near.sum() >= FEWEST // 2:
            taus.append(usual)
            squares.append((float(np.median(np.abs(d[near] - np.median(d[near])))) / 0.6745) ** 2)
    if len(taus) < 2:
        return None
    A = np.stack([np.full(len(taus), 2.0), np.asarray(taus)], axis=-1)
    weight = 1.0 / np.maximum(np.asarray(squares), 1e-300)  # relative errors are alike
    (white, walk), _ = nnls(A * weight[:, None], np.asarray(squares) * weight)
    white = white or squares[0] / 2.0  # the walk takes all: what is known is a bound
    return math.sqrt(white), math.sqrt(walk)


def of_fixes(motion: Motion) -> float | None:
    """m, deviation of position fixes: what velocities do not explain and does not last."""
    left = motion.fixes - motion.integral(motion.fix_time)
    found = [white_and_walk(motion.fix_time, axis) for axis in left.T]
    known = [each[0] for each in found if each is not None]
    return float(np.mean(known)) if known else None


def of_bends(x: Array) -> float:
    """Deviation of white noise by robust third differences: what moves smoothly leaves nothing."""
    return (
        float(np.median(np.abs(np.diff(x, 3)))) / (0.6745 * math.sqrt(20.0)) if len(x) > 10 else 0.0
    )


def allan(rate: Array, interval: float) -> tuple[Array, Array]:
    """Overlapping Allan deviation (IEEE Std 952) of the longest stretch without a gap.

    Args:
        rate: (T,) means over each interval, NaN where missing.
        interval: s.

    Returns:
        Times of averaging (K,), s, and deviations (K,) in the unit of the rate.
    """
    x = _longest(rate)
    most = int(len(x) / STRETCH)
    if most < 2:
        return np.empty(0), np.empty(0)
    sizes = np.unique(np.round(np.geomspace(1, most, 30)).astype(int))
    total = np.concatenate([[0.0], np.cumsum(x - x.mean())]) * interval
    found = []
    for m in sizes:
        d = total[2 * m :] - 2.0 * total[m:-m] + total[: -2 * m]
        found.append(math.sqrt(float((d * d).mean()) / 2.0) / (m * interval))
    return sizes * interval, np.asarray(found)


def _longest(x: Array) -> Array:
    gone = np.flatnonzero(~np.isfinite(x))
    bounds = np.concatenate([[-1], gone, [len(x)]])
    k = int(np.diff(bounds).argmax())
    return x[bounds[k] + 1 : bounds[k + 1]]


def densities(rate: Array, interval: float) -> tuple[float, float]:
    """Root density of an inertial channel's white noise, and its lowest Allan deviation.

    The density is that of third differences at the full rate: motion leaves little there, vibration counts
    as noise. The lowest deviation holds motion, and says something only of an IMU at rest.
    """
    _, deviation = allan(rate, interval)
    lowest = float(deviation.min()) if len(deviation) else 0.0
    return of_bends(_longest(rate)) * math.sqrt(interval), lowest
