"""Increments of an IMU summed up over a filter step, with what its biases do to them (SCIENCE E3).

Per step, in the body's axes at the step's start, as if there were no bias:

    ΔR = Π exp(dθ_i)        Δv = Σ ΔR_i (dv_i + ½ dθ_i×dv_i)

and their derivatives by the gyro and accelerometer biases, so that a filter with biases b_g and b_a takes

    ΔR exp(J_R b_g)         Δv + J_vg b_g + J_va b_a

None of it depends on a filter's parameters: a tape of these is made once for all of them, 39 numbers per
step. A filter restarts from its own corrected state at each step, so what is taped is no navigation.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from navgym.core.compile import kernel, part
from navgym.inertial.rotation import exponential, multiply

_f8 = np.float64
INCREMENT: list[tuple[str, Any, tuple[int, ...]]] = [  # fields of a step's record
    ("dR", _f8, (3, 3)),  # ΔR
    ("dv", _f8, (3,)),  # Δv, m/s
    ("J_R", _f8, (3, 3)),  # ΔR is followed by exp(J_R b_g), s
    ("J_vg", _f8, (3, 3)),  # ∂Δv/∂b_g, m
    ("J_va", _f8, (3, 3)),  # ∂Δv/∂b_a: −∫ΔR dt, s
]


@part
def begin(step):
    """A step of no length."""
    for i in range(3):
        step.dv[i] = 0.0
        for j in range(3):
            step.dR[i, j] = 1.0 if i == j else 0.0
            step.J_R[i, j], step.J_vg[i, j], step.J_va[i, j] = 0.0, 0.0, 0.0


@part
def accumulate(step, angle, velocity, T, turn, scratch):
    """Lengthen a step by one increment of T s; `turn` and `scratch` are (3, 3)."""
    x, y, z = angle[0], angle[1], angle[2]
    a, b, c = velocity[0], velocity[1], velocity[2]
    u0 = a + 0.5 * (y * c - z * b)
    u1 = b + 0.5 * (z * a - x * c)
    u2 = c + 0.5 * (x * b - y * a)
    for i in range(3):
        r0, r1, r2 = step.dR[i, 0], step.dR[i, 1], step.dR[i, 2]
        step.dv[i] += r0 * u0 + r1 * u1 + r2 * u2
        # a turn J_R b_g before it moves u by J_R b_g × u = −[u×] J_R b_g; within it, by half of T
        w0, w1, w2 = r1 * u2 - r2 * u1, r2 * u0 - r0 * u2, r0 * u1 - r1 * u0
        for j in range(3):
            step.J_vg[i, j] -= w0 * step.J_R[0, j] + w1 * step.J_R[1, j] + w2 * step.J_R[2, j]
            step.J_va[i, j] -= step.dR[i, j] * T
        step.J_vg[i, 0] += 0.5 * T * w0
        step.J_vg[i, 1] += 0.5 * T * w1
        step.J_vg[i, 2] += 0.5 * T * w2
        # and a bias of the accelerometers turns with half of dθ
        step.J_va[i, 0] -= 0.5 * T * (r1 * z - r2 * y)
        step.J_va[i, 1] -= 0.5 * T * (r2 * x - r0 * z)
        step.J_va[i, 2] -= 0.5 * T * (r0 * y - r1 * x)
    exponential(x, y, z, turn)
    for i in range(3):
        for j in range(3):
            scratch[i, j] = (
                turn[0, i] * step.J_R[0, j]
                + turn[1, i] * step.J_R[1, j]
                + turn[2, i] * step.J_R[2, j]
            )
    # right Jacobian of the exponential, to the second order in dθ
    for i in range(3):
        for j in range(3):
            step.J_R[i, j] = scratch[i, j] - (T if i == j else 0.0)
    s = x * x + y * y + z * z
    h = 0.5 * T
    step.J_R[0, 1] -= h * z
    step.J_R[0, 2] += h * y
    step.J_R[1, 0] += h * z
    step.J_R[1, 2] -= h * x
    step.J_R[2, 0] -= h * y
    step.J_R[2, 1] += h * x
    h = T / 6.0
    step.J_R[0, 0] -= h * (x * x - s)
    step.J_R[1, 1] -= h * (y * y - s)
    step.J_R[2, 2] -= h * (z * z - s)
    step.J_R[0, 1] -= h * x * y
    step.J_R[1, 0] -= h * x * y
    step.J_R[0, 2] -= h * x * z
    step.J_R[2, 0] -= h * x * z
    step.J_R[1, 2] -= h * y * z
    step.J_R[2, 1] -= h * y * z
    multiply(step.dR, turn, scratch)
    for i in range(3):
        for j in range(3):
            step.dR[i, j] = scratch[i, j]


@kernel
def preintegrate(angle, velocity, T, per, steps):
    """Fill `steps` (K,) from increments (≥ K · per, 3) of T s each."""
    turn, scratch = np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(steps)):
        step = steps[k]
        begin(step)
        for i in range(k * per, (k + 1) * per):
            accumulate(step, angle[i], velocity[i], T, turn, scratch)
