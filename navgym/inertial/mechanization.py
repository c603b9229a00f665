"""Strapdown mechanisation on the ellipsoid, compiled, and its exact inverse (SCIENCE E2).

Per increment, dθ and dv free of the sensor's errors, T seconds long:

    v⁺ = v + exp(−½ω_in T) C (dv + ½ dθ×dv) + [0, 0, g] T − (2ω_ie + ω_en) × v T
    L⁺ = L + ½T (v_N + v_N⁺)/(R_N + h)      λ⁺ = λ + ½T (v_E + v_E⁺)/((R_E + h) cos L_mid)
    h⁺ = h − ½T (v_D + v_D⁺)                C⁺ = exp(−ω_in T) C exp(dθ)

Rates, radii and gravity are those at the increment's start. The inverse takes attitudes and velocities
and gives the increments that reproduce them, to rounding: a simulated vehicle moves as it was told to.
"""

from __future__ import annotations

import math

import numpy as np

from navgym.core.compile import kernel, part
from navgym.inertial.ellipsoid import curvature, earth_rate, normal_gravity, transport_rate
from navgym.inertial.rotation import exponential, logarithm, multiply, orthonormalise


@part
def local_frame(position, velocity):
    """What the Earth does to NED at a place: ω_ie north and down, ω_en, gravity, radii with height."""
    sine, cosine = math.sin(position[0]), math.cos(position[0])
    meridian, across = curvature(sine)
    meridian, across = meridian + position[2], across + position[2]
    n, d = earth_rate(sine, cosine)
    tn, te, td = transport_rate(sine / cosine, velocity[0], velocity[1], meridian, across)
    return n, d, tn, te, td, normal_gravity(sine, position[2]), meridian, across


@part
def move(position, v0, v1, T, meridian, across):
    """Latitude, longitude and height after T seconds at the mean of two velocities."""
    step = 0.5 * T * (v0[0] + v1[0]) / meridian
    middle = math.cos(position[0] + 0.5 * step)
    position[0] += step
    position[1] += 0.5 * T * (v0[1] + v1[1]) / (across * middle)
    position[2] -= 0.5 * T * (v0[2] + v1[2])


@kernel
def mechanise(angle, velocity, T, place, speed, attitude, positions, velocities, attitudes):
    """Dead reckoning from increments (K, 3) of T s each.

    Args:
        angle: rad.
        velocity: m/s.
        T: s.
        place: (3,) latitude, longitude (rad) and height (m) at the start; moves on to the end.
        speed: (3,) NED velocity there, m/s; moves on.
        attitude: (3, 3) C there; moves on.
        positions: (K, 3) to be filled with what follows each increment.
        velocities: (K, 3) likewise.
        attitudes: (K, 3, 3) likewise.
    """
    turn, product, before = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for k in range(len(angle)):
        n, d, tn, te, td, g, meridian, across = local_frame(place, speed)
        x, y, z = angle[k, 0], angle[k, 1], angle[k, 2]
        a, b, c = velocity[k, 0], velocity[k, 1], velocity[k, 2]
        u0 = a + 0.5 * (y * c - z * b)
        u1 = b + 0.5 * (z * a - x * c)
        u2 = c + 0.5 * (x * b - y * a)
        wn, we, wd = (n + tn) * T, te * T, (d + td) * T
        exponential(-0.5 * wn, -0.5 * we, -0.5 * wd, turn)
        multiply(turn, attitude, product)
        wn, we, wd = (2.0 * n + tn) * T, te * T, (2.0 * d + td) * T
        vn, ve, vd = speed[0], speed[1], speed[2]
        for i in range(3):
            before[i] = speed[i]
            speed[i] += product[i, 0] * u0 + product[i, 1] * u1 + product[i, 2] * u2
        speed[0] -= we * vd - wd * ve
        speed[1] -= wd * vn - wn * vd
        speed[2] -= wn * ve - we * vn - g * T
        move(place, before, speed, T, meridian, across)
        exponential(-(n + tn) * T, -te * T, -(d + td) * T, turn)
        multiply(turn, attitude, product)
        exponential(x, y, z, turn)
        multiply(product, turn, attitude)
        orthonormalise(attitude)
        for i in range(3):
            positions[k, i], velocities[k, i] = place[i], speed[i]
            for j in range(3):
                attitudes[k, i, j] = attitude[i, j]


@kernel
def increments(velocities, attitudes, T, place, angle, velocity, positions):
    """The inverse of `mechanise`: increments (K, 3) between K + 1 velocities and attitudes.

    Args:
        velocities: (K + 1, 3) NED, m/s.
        attitudes: (K + 1, 3, 3).
        T: s between them.
        place: (3,) latitude, longitude, height at the first; moves on to the last.
        angle: (K, 3) to be filled, rad.
        velocity: (K, 3) to be filled, m/s.
        positions: (K, 3) to be filled with latitude, longitude, height after each increment.
    """
    turn, product, between = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    e = np.empty(3)
    for k in range(len(angle)):
        v0, v1, C0, C1 = velocities[k], velocities[k + 1], attitudes[k], attitudes[k + 1]
        n, d, tn, te, td, g, meridian, across = local_frame(place, v0)
        exponential((n + tn) * T, te * T, (d + td) * T, turn)
        multiply(turn, C1, product)
        for i in range(3):
            for j in range(3):
                between[i, j] = (
                    C0[0, i] * product[0, j] + C0[1, i] * product[1, j] + C0[2, i] * product[2, j]
                )
        x, y, z = logarithm(between)
        wn, we, wd = (2.0 * n + tn) * T, te * T, (2.0 * d + td) * T
        e[0] = v1[0] - v0[0] + we * v0[2] - wd * v0[1]
        e[1] = v1[1] - v0[1] + wd * v0[0] - wn * v0[2]
        e[2] = v1[2] - v0[2] + wn * v0[1] - we * v0[0] - g * T
        exponential(-0.5 * (n + tn) * T, -0.5 * te * T, -0.5 * (d + td) * T, turn)
        multiply(turn, C0, product)
        a = product[0, 0] * e[0] + product[1, 0] * e[1] + product[2, 0] * e[2]
        b = product[0, 1] * e[0] + product[1, 1] * e[1] + product[2, 1] * e[2]
        c = product[0, 2] * e[0] + product[1, 2] * e[1] + product[2, 2] * e[2]
        # (I + ½[dθ×]) dv = (a, b, c), solved
        along = 0.25 * (x * a + y * b + z * c)
        scale = 1.0 / (1.0 + 0.25 * (x * x + y * y + z * z))
        velocity[k, 0] = (a - 0.5 * (y * c - z * b) + along * x) * scale
        velocity[k, 1] = (b - 0.5 * (z * a - x * c) + along * y) * scale
        velocity[k, 2] = (c - 0.5 * (x * b - y * a) + along * z) * scale
        angle[k, 0], angle[k, 1], angle[k, 2] = x, y, z
        move(place, v0, v1, T, meridian, across)
        for i in range(3):
            positions[k, i] = place[i]
