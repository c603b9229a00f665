"""An IMU's errors put into its increments: biases, random walks, scale factors, axes askew."""

from __future__ import annotations

import math

import numpy as np

from navgym.core.checks import Array
from navgym.core.compile import kernel
from navgym.inertial.imu import ImuErrors


def add_errors(
    angle: Array, velocity: Array, errors: ImuErrors, rate: float, rng: np.random.Generator
) -> None:
    """Add an IMU's errors to its increments (T, 3), in place.

    Args:
        angle: rad.
        velocity: m/s.
        errors: their standard deviations.
        rate: samples per second.
        rng: what they are drawn from.
    """
    drift, walk, bias, shake, scale, tilt = errors.si
    h = 1.0 / rate
    for increments, constant, noise in ((angle, drift, walk), (velocity, bias, shake)):
        M = np.diag(scale * rng.standard_normal(3))
        x, y, z = tilt * rng.standard_normal(3)
        M += np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        steady = constant * rng.standard_normal(3) * h
        spoil(increments, M, steady, noise * math.sqrt(h), rng.standard_normal(increments.shape))


@kernel
def spoil(increments, M, steady, deviation, noise):
    """Add M x + steady + deviation · noise to increments x (T, 3), in place."""
    for k in range(len(increments)):
        x, y, z = increments[k, 0], increments[k, 1], increments[k, 2]
        for i in range(3):
            wrong = M[i, 0] * x + M[i, 1] * y + M[i, 2] * z + steady[i]
            increments[k, i] += wrong + deviation * noise[k, i]
