"""Rotations as matrices, compiled: exponential and logarithm of rotation vectors, products, upkeep.

C turns from the body's axes into the frame; each part fills an output that it is given.
"""

from __future__ import annotations

import math

from navgym.core.compile import part

SMALL = 1e-4  # rad², below which series are exact to rounding


@part
def exponential(x, y, z, C):
    """C = exp([r×]) of the rotation vector (x, y, z), rad."""
    square = x * x + y * y + z * z
    if square < SMALL:
        a = 1.0 - square / 6.0 + square * square / 120.0
        b = 0.5 - square / 24.0 + square * square / 720.0
    else:
        size = math.sqrt(square)
        half = math.sin(0.5 * size) / size
        a, b = math.sin(size) / size, 2.0 * half * half
    C[0, 0] = 1.0 - b * (y * y + z * z)
    C[0, 1] = b * x * y - a * z
    C[0, 2] = b * x * z + a * y
    C[1, 0] = b * x * y + a * z
    C[1, 1] = 1.0 - b * (x * x + z * z)
    C[1, 2] = b * y * z - a * x
    C[2, 0] = b * x * z - a * y
    C[2, 1] = b * y * z + a * x
    C[2, 2] = 1.0 - b * (x * x + y * y)


@part
def logarithm(C):
    """The rotation vector of C, rad; for turns below half a circle."""
    x, y, z = C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]
    sine = 0.5 * math.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (C[0, 0] + C[1, 1] + C[2, 2] - 1.0)
    angle = math.atan2(sine, cosine)
    factor = 0.5 * angle / sine if sine > 1e-8 else 0.5 + sine * sine / 12.0
    return factor * x, factor * y, factor * z


@part
def multiply(A, B, out):
    """out = A B, three by three."""
    for i in range(3):
        a, b, c = A[i, 0], A[i, 1], A[i, 2]
        for j in range(3):
            out[i, j] = a * B[0, j] + b * B[1, j] + c * B[2, j]


@part
def multiply_transposed(A, B, out):
    """out = A Bᵀ, three by three."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[j, 0] + A[i, 1] * B[j, 1] + A[i, 2] * B[j, 2]


@part
def orthonormalise(C):
    """One Newton step towards the nearest rotation, C (3 I − CᵀC) / 2: rounding does not add up."""
    g00 = C[0, 0] * C[0, 0] + C[1, 0] * C[1, 0] + C[2, 0] * C[2, 0]
    g11 = C[0, 1] * C[0, 1] + C[1, 1] * C[1, 1] + C[2, 1] * C[2, 1]
    g22 = C[0, 2] * C[0, 2] + C[1, 2] * C[1, 2] + C[2, 2] * C[2, 2]
    g01 = C[0, 0] * C[0, 1] + C[1, 0] * C[1, 1] + C[2, 0] * C[2, 1]
    g02 = C[0, 0] * C[0, 2] + C[1, 0] * C[1, 2] + C[2, 0] * C[2, 2]
    g12 = C[0, 1] * C[0, 2] + C[1, 1] * C[1, 2] + C[2, 1] * C[2, 2]
    for i in range(3):
        a, b, c = C[i, 0], C[i, 1], C[i, 2]
        C[i, 0] = 0.5 * (a * (3.0 - g00) - b * g01 - c * g02)
        C[i, 1] = 0.5 * (b * (3.0 - g11) - a * g01 - c * g12)
        C[i, 2] = 0.5 * (c * (3.0 - g22) - a * g02 - b * g12)


@part
def euler_matrix(roll, pitch, heading, C):
    """C = R_z(heading) R_y(pitch) R_x(roll), body (forward, starboard, down) to NED."""
    sr, cr = math.sin(roll), math.cos(roll)
    sp, cp = math.sin(pitch), math.cos(pitch)
    sh, ch = math.sin(heading), math.cos(heading)
    C[0, 0] = cp * ch
    C[0, 1] = sr * sp * ch - cr * sh
    C[0, 2] = cr * sp * ch + sr * sh
    C[1, 0] = cp * sh
    C[1, 1] = sr * sp * sh + cr * ch
    C[1, 2] = cr * sp * sh - sr * ch
    C[2, 0] = -sp
    C[2, 1] = sr * cp
    C[2, 2] = cr * cp


@part
def euler_angles(C):
    """Roll, pitch and heading of C, rad; heading in −π … π."""
    pitch = math.asin(min(max(-C[2, 0], -1.0), 1.0))
    return math.atan2(C[2, 1], C[2, 2]), pitch, math.atan2(C[1, 0], C[0, 0])
