"""Strapdown arithmetic, compiled: quaternions, coning and sculling, rates from increments, the local frame.

Quaternions are unit ones, scalar first; C(q) turns from the body's axes into the frame of q.
"""

from __future__ import annotations

import math

import numpy as np

from navgym.core.compile import part
from navgym.inertial.earth import EARTH_RATE, EQUATORIAL_RADIUS


@part
def matrix(q, C):
    """Rotation matrix of a unit quaternion, scalar first."""
    C[0, 0] = 1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3])
    C[0, 1] = 2.0 * (q[1] * q[2] - q[0] * q[3])
    C[0, 2] = 2.0 * (q[1] * q[3] + q[0] * q[2])
    C[1, 0] = 2.0 * (q[1] * q[2] + q[0] * q[3])
    C[1, 1] = 1.0 - 2.0 * (q[1] * q[1] + q[3] * q[3])
    C[1, 2] = 2.0 * (q[2] * q[3] - q[0] * q[1])
    C[2, 0] = 2.0 * (q[1] * q[3] - q[0] * q[2])
    C[2, 1] = 2.0 * (q[2] * q[3] + q[0] * q[1])
    C[2, 2] = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])


@part
def turn(q, v, out):
    """out = C(q) v for a unit quaternion, scalar first."""
    a0 = 2.0 * (q[2] * v[2] - q[3] * v[1])
    a1 = 2.0 * (q[3] * v[0] - q[1] * v[2])
    a2 = 2.0 * (q[1] * v[1] - q[2] * v[0])
    out[0] = v[0] + q[0] * a0 + q[2] * a2 - q[3] * a1
    out[1] = v[1] + q[0] * a1 + q[3] * a0 - q[1] * a2
    out[2] = v[2] + q[0] * a2 + q[1] * a1 - q[2] * a0


@part
def advance(q, angle, velocity, last_angle, last_velocity, V, mean):
    """One sample of strapdown mechanisation: q, V and the sum of turned angle increments move on.

    The rotation vector and the velocity increment carry the two-sample coning and sculling
    corrections (Savage 1998), the latter with the rotation within the sample.
    """
    r, v = np.empty(3), np.empty(3)
    for i in range(3):
        n, m = (i + 1) % 3, (i + 2) % 3
        coning = last_angle[n] * angle[m] - last_angle[m] * angle[n]
        r[i] = angle[i] + coning / 12.0
        rotation = angle[n] * velocity[m] - angle[m] * velocity[n]
        sculling = last_angle[n] * velocity[m] - last_angle[m] * velocity[n]
        sculling += last_velocity[n] * angle[m] - last_velocity[m] * angle[n]
        v[i] = velocity[i] + 0.5 * rotation + sculling / 12.0
    turned = np.empty(3)
    turn(q, v, turned)
    for i in range(3):
        V[i] += turned[i]
    square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    # half-angle sine over angle, and cosine: series where they are exact to rounding
    if square < 1e-4:
        s = 0.5 - square / 48.0 + square * square / 3840.0
        c = 1.0 - square / 8.0 + square * square / 384.0
    else:
        size = math.sqrt(square)
        s, c = math.sin(0.5 * size) / size, math.cos(0.5 * size)
    x, y, z = s * r[0], s * r[1], s * r[2]
    a, b, d, e = q[0], q[1], q[2], q[3]
    q[0] = a * c - b * x - d * y - e * z
    q[1] = a * x + b * c + d * z - e * y
    q[2] = a * y - b * z + d * c + e * x
    q[3] = a * z + b * y - d * x + e * c
    scale = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] *= scale
    # the mean rate over the sample in inertial axes: turned by half the way, the coning term twice
    for i in range(3):
        n, m = (i + 1) % 3, (i + 2) % 3
        v[i] = 2.0 * r[i] - angle[i] - 0.5 * (angle[n] * r[m] - angle[m] * r[n])
    turn(q, v, turned)
    for i in range(3):
        mean[i] += turned[i]


@part
def end_rate(a, b, c, h, omega):
    """Rate at the end of the increment `a`, extrapolated through it and the two before, b and c."""
    for i in range(3):
        omega[i] = (11.0 * a[i] - 7.0 * b[i] + 2.0 * c[i]) / (6.0 * h)


@part
def cross(a, b, out):
    """out = a × b."""
    for i in range(3):
        n, m = (i + 1) % 3, (i + 2) % 3
        out[i] = a[n] * b[m] - a[m] * b[n]


@part
def local_rate(sl, cl, north, east):
    """Rate of the north-east-down frame in inertial space: Earth's rate and transport rate, rad/s.

    On a sphere of the equatorial radius; sine and cosine of the latitude, velocities in m/s.
    """
    wn = EARTH_RATE * cl + east / EQUATORIAL_RADIUS
    we = -north / EQUATORIAL_RADIUS
    wd = -EARTH_RATE * sl - east * sl / cl / EQUATORIAL_RADIUS
    return wn, we, wd
