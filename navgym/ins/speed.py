"""How a vehicle's speed wanders: a process fitted to a Doppler log, in legs and in turns.

    surge = cruise (1 + x) − loss · r²      sway = −slip · r + y

x and y forget themselves (Ornstein-Uhlenbeck, smoothed over `SMOOTHING` s), r is the turn rate, and r² is
felt with a lag. What matters for a lost Doppler log is how far the velocity goes from its last value over
10 to 180 s: `structure` of a log says it, and `fit` takes that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from navgym.core.checks import Array, within

SMOOTHING = 2.0  # s, each of two lags that keep accelerations those of a hull
LAGS = (1, 2, 3, 5, 10, 20, 30, 60, 90, 120, 150, 180)  # s
LONGEST = 200.0  # s: tracks of some minutes show no longer memory
TURN_TIMES = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)


@dataclass(frozen=True)
class SpeedProcess:
    """How a vehicle's body velocity wanders.

    Args:
        surge_deviation: long-run standard deviation of the surge over the cruise speed.
        surge_time: s, in which it forgets itself.
        turn_loss: surge lost per turn rate squared, m/s per (rad/s)².
        turn_time: s, lag of that loss.
        side_slip: sway per turn rate, m.
        sway_deviation: of what sway is left, over the cruise speed.
        sway_time: s.
    """

    surge_deviation: float
    surge_time: float
    turn_loss: float
    turn_time: float
    side_slip: float
    sway_deviation: float
    sway_time: float

    def __post_init__(self) -> None:
        for name in ("surge_deviation", "turn_loss", "sway_deviation"):
            within(name, getattr(self, name), 0.0)
        for name in ("surge_time", "turn_time", "sway_time"):
            within(name, getattr(self, name), 0.0, above=True)


# python scripts/fit_speed.py: of A-KIT's tracks 1-3
FITTED = SpeedProcess(0.28, 200.0, 13.7, 3.0, 3.34, 0.17, 146.0)
# the prototype's vehicle, which keeps its speed: what stands in for a lost log is too easy with it
STEADY = SpeedProcess(0.02, 60.0, 0.0, 1.0, 0.0, 0.005, 60.0)
PROCESSES = {"fitted": FITTED, "steady": STEADY}


def lagged(x: Array, time_constant: float) -> Array:
    """`x` (T,), a value per second, through a lag of first order."""
    found, state = np.empty_like(x), x[0]
    share = 1.0 - np.exp(-1.0 / time_constant)
    for k, value in enumerate(x):
        state += share * (value - state)
        found[k] = state
    return found


def structure(series: Sequence[Array], lags: Sequence[int] = LAGS) -> Array:
    """Mean square of x(t + lag) − x(t) over all series (T,), a value per second, at each lag."""
    pairs = ([s[lag:] - s[:-lag] for s in series] for lag in lags)
    return np.array([np.mean(np.concatenate(p) ** 2) for p in pairs])


def fit(logs: Sequence[tuple[Array, Array]]) -> SpeedProcess:
    """The process of some logs.

    Args:
        logs: of each, body velocity (T, 2 or 3), m/s, and turn rate (T,), rad/s, at the same whole seconds.

    The loss in turns is regressed on differences over 10 s, which a slow wander hardly enters; the
    side slip on the sway; wandering is what explains the structure of the rest, in logarithms.
    """
    cruise = float(np.mean(np.concatenate([v[:, 0] for v, _ in logs])))
    best = (np.inf, 0.0, 1.0)
    for turn_time in TURN_TIMES:
        fed = [lagged(rate**2, turn_time) for _, rate in logs]
        x = np.concatenate([f[10:] - f[:-10] for f in fed])
        y = np.concatenate([v[10:, 0] - v[:-10, 0] for v, _ in logs])
        slope = float(x @ y / (x @ x))
        best = min(best, (float(np.mean((y - slope * x) ** 2)), -slope, turn_time))
    loss, turn_time = best[1:]
    rates = np.concatenate([r for _, r in logs])
    sways = np.concatenate([v[:, 1] - v[:, 1].mean() for v, _ in logs])
    slip = float(-(rates @ sways) / (rates @ rates))
    surge = _wander([v[:, 0] + loss * lagged(r**2, turn_time) for v, r in logs])
    sway = _wander([v[:, 1] + slip * r for v, r in logs])
    return SpeedProcess(
        surge[0] / cruise, surge[1], max(loss, 0.0), turn_time, slip, sway[0] / cruise, sway[1]
    )


def _wander(series: Sequence[Array]) -> tuple[float, float]:
    """Deviation and memory of an Ornstein-Uhlenbeck process whose structure is nearest, from 5 s on."""
    lags = np.array([lag for lag in LAGS if lag >= 5])
    seen = np.log(structure(series, lags.tolist()))
    best = (np.inf, 0.0, 1.0)
    for memory in np.geomspace(5.0, LONGEST, 60):
        shape = np.log(2.0 * (1.0 - np.exp(-lags / memory)))
        offset = float(np.mean(seen - shape))
        best = min(best, (float(np.var(seen - shape)), float(np.exp(0.5 * offset)), float(memory)))
    return best[1:]
