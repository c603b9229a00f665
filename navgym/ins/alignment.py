"""How the clocks of an IMU, a Doppler log and a reference trajectory differ, and where they sit on the hull.

What the IMU meets at t the reference shows at t + delay; its gyros say so, against the rate of the
reference's attitude, and by how much one clock runs faster than the other. The Doppler log's own delay and its lever arm from the reference point follow from body
velocities, by least squares: the arm enters linearly. Nothing of it is taken from data sheets, and a reader
that uses it reports it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation, RotationSpline

from navgym.core.checks import Array

LONGEST_DELAY, COARSE = (
    3.0,
    0.1,
)  # s, searched either way; s, of the grid that the search starts from
RATES = 0.01  # share by which a clock may run wrong
SMOOTH = 1.0  # s: rates are compared as means over so long, which a reference at 1 Hz can show
NOISE, FARTHEST = 0.02, 5.0  # m/s, m: a lever arm that no turn shows is drawn to zero by these


@dataclass(frozen=True)
class Path:
    """A reference trajectory, between whose samples one may ask.

    Args:
        time: (T,) s, of its own clock.
        position: (T, 3) north, east, down, m.
        velocity: (T, 3) m/s.
        angles: (T, 3) roll, pitch, heading, rad.
    """

    time: Array
    position: Array
    velocity: Array
    angles: Array

    def stretched(self, rate: float) -> Path:
        """The same by a clock on which each second takes `rate` s."""
        return replace(self, time=rate * self.time)

    def attitude(self) -> RotationSpline:
        """Body to NED."""
        return RotationSpline(self.time, Rotation.from_euler("ZYX", self.angles[:, ::-1]))

    def states(self, at: Array, arm: Array) -> Array:
        """(K, 9) position, velocity, roll, pitch, heading of the point `arm` (3,) m, at times of its clock.

        NaN outside the record.
        """
        spline = self.attitude()
        inside = (at >= self.time[0]) & (at <= self.time[-1])
        t, found = at[inside], np.full((len(at), 9), np.nan)
        C = spline(t)
        found[inside, :3] = CubicHermiteSpline(self.time, self.position, self.velocity)(
            t
        ) + C.apply(arm)
        swing = C.apply(np.cross(spline(t, order=1), arm))
        found[inside, 3:6] = CubicSpline(self.time, self.velocity)(t) + swing
        found[inside, 6:] = C.as_euler("ZYX")[:, ::-1]
        return found


@dataclass(frozen=True)
class Clocks:
    """What brings a track's sensors together.

    Args:
        clock_rate: s of the IMU's clock in a second of the one that reference and Doppler log share.
        imu_delay: s, by which the reference is late against the IMU.
        dvl_delay: s, by which the reference is late against the Doppler log.
        lever_arm: (3,) m, from the reference point to the Doppler log, body axes.
        rate_rms: rad/s, of the gyros' heading rate less the reference's, means over a second.
        velocity_rms: (3,) m/s, of the log's body velocity less the reference's.
    """

    clock_rate: float
    imu_delay: float
    dvl_delay: float
    lever_arm: Array
    rate_rms: float
    velocity_rms: Array

    def as_dict(self) -> dict[str, Any]:
        """As plain numbers and lists."""
        return {name: np.asarray(value).tolist() for name, value in vars(self).items()}


def align(path: Path, clock: Array, rate: Array, time: Array, body: Array) -> Clocks:
    """Clock rate, delays and lever arm of a track.

    Args:
        path: the reference.
        clock: (T,) s, of the IMU.
        rate: (T, 3) rad/s, of its gyros.
        time: (M,) s, of the Doppler log, on the reference's clock.
        body: (M, 3) m/s, its velocities.

    Raises ValueError for a track that is too short to tell.
    """
    inside = (time >= path.time[0] + LONGEST_DELAY) & (time <= path.time[-1] - LONGEST_DELAY)
    if inside.sum() < 50:
        raise ValueError(
            f"align needs 50 samples of the Doppler log at least {LONGEST_DELAY:g} s inside the "
            f"reference, got {int(inside.sum())}: use a longer track, or leave align out."
        )
    turned = np.concatenate([[0.0], np.cumsum(rate[:-1, 2] * np.diff(clock))])

    def of_rate(stretch: float) -> tuple[float, float]:
        return _rate_delay(path.stretched(stretch), clock, turned, stretch * time[inside])

    low, high = 1.0 - RATES, 1.0 + RATES
    found = minimize_scalar(lambda x: of_rate(x)[1], bounds=(low, high), method="bounded", options={"xatol": 2e-5})  # fmt: skip
    stretch = float(found.x)
    imu, left = of_rate(stretch)
    velocity_left = _velocities(path.stretched(stretch), stretch * time[inside], body[inside])
    dvl = _least(lambda d: float(np.mean(velocity_left(d)[1] ** 2)))
    arm, rest = velocity_left(dvl)
    rms = np.sqrt(np.mean(rest.reshape(-1, 3) ** 2, axis=0))
    return Clocks(stretch, imu, dvl, arm, math.sqrt(left), rms)


def _rate_delay(path: Path, clock: Array, turned: Array, t: Array) -> tuple[float, float]:
    """The reference's delay against the gyros, and the mean square of what is left of their rates."""
    attitude = path.attitude()
    fine = np.linspace(path.time[0], path.time[-1], 20 * len(path.time))
    about = attitude(fine, order=1)[:, 2]  # the body's own rate about its vertical
    own = np.concatenate([[0.0], np.cumsum(0.5 * (about[1:] + about[:-1]) * np.diff(fine))])
    seen = _mean_rate(lambda at: np.interp(at, clock, turned), t)

    def cost(delay: float) -> float:
        shown = _mean_rate(lambda at: np.interp(at, fine, own), t + delay)
        return float(np.mean((seen - shown) ** 2))

    delay = _least(cost)
    return delay, cost(delay)


def _velocities(path: Path, t: Array, body: Array) -> Callable[[float], tuple[Array, Array]]:
    """(delay) to the best lever arm (3,) and the body velocities that it leaves (3M,)."""
    attitude = path.attitude()
    velocity = CubicSpline(path.time, attitude(path.time).inv().apply(path.velocity))

    def left(delay: float) -> tuple[Array, Array]:
        rest = np.asarray(body - velocity(t + delay)).ravel()
        rate = attitude(t + delay, order=1)
        A = np.cross(rate[:, None, :], np.eye(3)).transpose(0, 2, 1).reshape(-1, 3)
        arm = np.linalg.solve(A.T @ A + (NOISE / FARTHEST) ** 2 * np.eye(3), A.T @ rest)
        return np.asarray(arm, dtype=np.float64), rest - A @ arm

    return left


def _mean_rate(integral: Callable[[Array], Array], at: Array) -> Array:
    return (integral(at + 0.5 * SMOOTH) - integral(at - 0.5 * SMOOTH)) / SMOOTH


def _least(cost: Callable[[float], float]) -> float:
    """Where `cost` is least within the delays that are searched."""
    grid = np.arange(-LONGEST_DELAY, LONGEST_DELAY + COARSE / 2, COARSE)
    best = float(grid[int(np.argmin([cost(d) for d in grid]))])
    found = minimize_scalar(
        cost, bounds=(best - COARSE, best + COARSE), method="bounded", options={"xatol": 1e-4}
    )
    return float(found.x)
