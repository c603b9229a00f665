"""The delay and the lever arm between a reference trajectory and a Doppler velocity log (DVL).

A rigid body's DVL, at l from the reference point in body axes, measures v_b(t + d) + ω_b(t + d) × l
of a reference whose clock is late by d. Both are found by least squares over the body velocities:
l enters linearly, and is eliminated for each d, which leaves a search over one number.

Between samples of the reference a cubic spline through attitudes (scipy's RotationSpline), not a
straight arc (slerp), stands for its motion: the rate of slerp is a stair, and a rate is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation, RotationSpline

from navgym.core.checks import Array

LONGEST_DELAY = 5.0  # s, searched either way
COARSE = 0.25  # s, of the grid that the search starts from
LEAST_SAMPLES = 50  # that have a reference at any delay searched
DVL_NOISE, FARTHEST = 0.02, 5.0  # m/s, m: a lever arm that no turn shows is drawn to zero by these
LARGEST_DEVIATION = 0.1  # s, of a delay that is worth the name


@dataclass(frozen=True)
class Reference:
    """A reference trajectory, between whose samples one may ask.

    Args:
        time: (T,) s, of its own clock.
        position: (T, 2) north and east, m.
        velocity: (T, 3) north, east, down, m/s.
        attitude: body to north-east-down, T rotations.
    """

    time: Array
    position: Array
    velocity: Array
    attitude: Rotation

    def states(self, at: Array) -> Array:
        """(K, 4) [Px, Vx, Py, Vy] at times of its clock within the record."""
        cubic = CubicHermiteSpline(self.time, self.position, self.velocity[:, :2])
        p, v = cubic(at), CubicSpline(self.time, self.velocity[:, :2])(at)
        return np.stack([p[:, 0], v[:, 0], p[:, 1], v[:, 1]], axis=-1)


@dataclass(frozen=True)
class Alignment:
    """What aligns a reference with a DVL.

    Args:
        delay: s, by which the reference is late: what the DVL meets at t it shows at t + delay.
        lever_arm: (3,) m, from the reference point to the DVL in body axes (ahead, starboard, down).
        delay_deviation: s, of the least-squares fit with white residuals.
        lever_arm_deviation: (3,) m, likewise.
        rms_before: (3,) m/s, of the DVL's body velocity less the reference's, as recorded.
        rms: (3,) m/s, of what is left.
    """

    delay: float
    lever_arm: Array
    delay_deviation: float
    lever_arm_deviation: Array
    rms_before: Array
    rms: Array

    def as_dict(self) -> dict[str, Any]:
        """As plain numbers and lists, in the order of the fields."""
        return {name: np.asarray(value).tolist() for name, value in vars(self).items()}


class _Difference:
    """How a DVL and a delayed reference differ, over the samples that any delay has a reference for."""

    def __init__(self, reference: Reference, time: Array, body: Array) -> None:
        t = reference.time
        inside = (time >= t[0] + LONGEST_DELAY) & (time <= t[-1] - LONGEST_DELAY)
        if inside.sum() < LEAST_SAMPLES:
            raise ValueError(
                f"align needs {LEAST_SAMPLES} DVL samples at least {LONGEST_DELAY:g} s inside the "
                f"reference, got {int(inside.sum())}: use a longer track, or leave align out."
            )
        self.time, self.body = time[inside], body[inside]
        self.velocity = CubicSpline(t, reference.attitude.inv().apply(reference.velocity))
        self.attitude = RotationSpline(t, reference.attitude)

    def residual(self, delay: float) -> Array:
        """(3K,) body velocities of the DVL less those of the reference point."""
        return np.asarray(self.body - self.velocity(self.time + delay)).ravel()

    def levers(self, delay: float) -> Array:
        """(3K, 3) what a metre of lever arm along each body axis adds: columns of ω×."""
        rate = self.attitude(self.time + delay, order=1)
        return np.cross(rate[:, None, :], np.eye(3)).transpose(0, 2, 1).reshape(-1, 3)

    def arm(self, delay: float) -> tuple[Array, Array]:
        """The best lever arm (3,), m, and what it leaves (3K,), m/s."""
        left, A = self.residual(delay), self.levers(delay)
        arm = np.linalg.solve(A.T @ A + (DVL_NOISE / FARTHEST) ** 2 * np.eye(3), A.T @ left)
        return np.asarray(arm, dtype=float), left - A @ arm

    def cost(self, delay: float) -> float:
        """Mean square left, m²/s²."""
        return float(np.mean(self.arm(delay)[1] ** 2))

    def deviations(self, delay: float) -> tuple[float, Array]:
        """Standard deviations of the delay and the lever arm."""
        slope = (self.arm(delay + 1e-3)[1] - self.arm(delay - 1e-3)[1]) / 2e-3
        A = self.levers(delay)
        prior = np.diag([0.0, *np.full(3, (DVL_NOISE / FARTHEST) ** 2)])
        J = np.column_stack((slope, A))
        information = J.T @ J + prior + 1e-12 * np.eye(4)
        deviation = np.sqrt(self.cost(delay) * np.diag(np.linalg.inv(information)))
        return float(deviation[0]), deviation[1:]


def align_reference(reference: Reference, time: Array, body: Array) -> Alignment:
    """Estimate by how much a reference is late against a DVL, and where it sits.

    Args:
        reference: of the vehicle.
        time: (K,) s, rising, of the DVL's samples.
        body: (K, 3) m/s, the DVL's velocity in body axes.

    Raises:
        ValueError: a track too short, or too straight and even, to tell; a delay beyond 5 s.
    """
    difference = _Difference(reference, time, body)
    grid = np.arange(-LONGEST_DELAY, LONGEST_DELAY + COARSE / 2.0, COARSE)
    best = int(np.argmin([difference.cost(d) for d in grid]))
    if best in {0, len(grid) - 1}:
        raise ValueError(
            f"align finds no delay within {LONGEST_DELAY:g} s at which reference and DVL agree best: "
            "bring their clocks nearer to each other first, or leave align out."
        )
    around = (grid[best - 1], grid[best + 1])
    found = minimize_scalar(difference.cost, bounds=around, options={"xatol": 1e-5})
    delay = float(found.x)
    own, arms = difference.deviations(delay)
    if own > LARGEST_DEVIATION:
        raise ValueError(
            f"align finds the delay of the reference to {own:.2g} s only: the vehicle hardly changes "
            "its speed or turns on this track. Leave align out."
        )
    arm, left = difference.arm(delay)
    rms = (
        np.sqrt(np.mean(r.reshape(-1, 3) ** 2, axis=0)) for r in (difference.residual(0.0), left)
    )
    return Alignment(delay, arm, own, arms, *rms)


def aligned(
    reference: Reference, time: Array, body: Array, alignment: Alignment
) -> tuple[Array, Array, Array]:
    """What DVL and reference say of the reference point at the same instants.

    Returns:
        time (K,), s, of the DVL, where there is a reference; reference states (K, 4); the DVL's
        velocity north and east (K, 2), m/s, moved to the reference point.
    """
    at = time + alignment.delay
    inside = (at >= reference.time[0]) & (at <= reference.time[-1])
    spline, at = RotationSpline(reference.time, reference.attitude), at[inside]
    own = body[inside] - np.cross(spline(at, order=1), alignment.lever_arm)
    return time[inside], reference.states(at), spline(at).apply(own)[:, :2]
