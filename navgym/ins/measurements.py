"""What each aiding sensor measures, compiled: a function per kind that fills z's residual, H and R of a block.

Residuals are predicted − measured. A measurement that was valid `lag` s before the step's end is predicted
for its own moment, by the IMU's increments in between: v_e = v − C_e(Δv_e − b_a lag) − g lag, and an error
φ turns all of the velocity change but gravity's, so that v_e + C_e Δv_e stands beside [φ×] (docs/science/ins.md).

A new kind is a function here, a line in `navgym.ins.kinds`, `linearise` and `scale_of`.
"""

from __future__ import annotations

import math

import numpy as np

from navgym.core.compile import part
from navgym.inertial.ellipsoid import curvature, normal_gravity
from navgym.inertial.rotation import exponential, multiply_transposed
from navgym.ins.kinds import DEPTH_KIND, DVL_KIND, FIX_KIND, HEADING_KIND, MAGNETOMETER_KIND
from navgym.ins.layout import AT, DVL, FIX, MAGNETIC

_f8, _i8 = np.float64, np.int64
SENSOR = np.dtype([("kind", _i8), ("rows", _i8), ("variance", _f8, (3,)), ("lever", _f8, (3,))])
EVENT = np.dtype(
    [
        ("sensor", _i8),
        ("lost", _i8),  # 1: it should have come, and did not
        ("z", _f8, (3,)),
        ("lag", _f8),  # s before the end of its step
        ("dR", _f8, (3, 3)),  # ΔR and Δv of the increments in the lag
        ("dv", _f8, (3,)),
        ("rate", _f8, (3,)),  # gyro rate around it, rad/s
        ("scale", _f8),  # true variance over that of the sensor's noise; NaN: not known
        ("time", _f8),
    ]
)


@part
def look_back(lane, event, T_gravity):
    """Attitude and velocity at the event's own moment; `event_v` and `event_attitude`."""
    lag = event.lag
    if lag <= 0.0:
        for i in range(3):
            lane.event_v[i] = lane.v[i]
            for j in range(3):
                lane.event_attitude[i, j] = lane.attitude[i, j]
        return
    exponential(-lag * lane.bg[0], -lag * lane.bg[1], -lag * lane.bg[2], lane.turn)
    for i in range(3):
        for j in range(3):
            lane.product[i, j] = (
                event.dR[i, 0] * lane.turn[0, j] + event.dR[i, 1] * lane.turn[1, j] + event.dR[i, 2] * lane.turn[2, j]
            )  # fmt: skip
    multiply_transposed(lane.attitude, lane.product, lane.event_attitude)
    C = lane.event_attitude
    for i in range(3):
        s = 0.0
        for j in range(3):
            s += C[i, j] * (event.dv[j] - lag * lane.ba[j])
        lane.event_v[i] = lane.v[i] - s - (T_gravity if i == 2 else 0.0)


@part
def touch(lane, first, count, at):
    """Let the block's columns `at` onwards stand for `count` states from `first` on."""
    for i in range(count):
        lane.index[at + i] = first + i


@part
def velocity_rows(lane, event, sensor, gravity, current):
    """Body velocity at the sensor, over ground or (`current` 1) through water: r, and H without scales."""
    look_back(lane, event, event.lag * gravity)
    C, v = lane.event_attitude, lane.event_v
    arm, w = sensor.lever, event.rate
    for i in range(3):
        # what turns with φ: all of v_e + C_e Δv_e, which is v less gravity's part
        lane.middle[i] = lane.v[i] - (event.lag * gravity if i == 2 else 0.0)
    if current:
        for i in range(2):
            v[i] -= lane.c[i]
            lane.middle[i] -= lane.c[i]
    x, y, z = lane.middle[0], lane.middle[1], lane.middle[2]
    for i in range(3):
        n, m = (i + 1) % 3, (i + 2) % 3
        wn, wm = w[n] - lane.bg[n], w[m] - lane.bg[m]
        lane.body[i] = C[0, i] * v[0] + C[1, i] * v[1] + C[2, i] * v[2] + wn * arm[m] - wm * arm[n]
        a, b, c = C[0, i], C[1, i], C[2, i]
        lane.H[i, 0], lane.H[i, 1], lane.H[i, 2] = a, b, c
        # −Cᵀ[v×]
        lane.H[i, 3], lane.H[i, 4], lane.H[i, 5] = y * c - z * b, z * a - x * c, x * b - y * a
        # δb_g × l
        lane.H[i, 6 + i], lane.H[i, 6 + n], lane.H[i, 6 + m] = 0.0, arm[m], -arm[n]
    touch(lane, AT.V, 3, 0)
    touch(lane, AT.PHI, 3, 3)
    touch(lane, AT.BG, 3, 6)


@part
def dvl(lane, event, sensor, gravity):
    """(1 + ŝ)(v_b − α̂ e_z×v_b), v_b = Ĉᵀv̂ + ω̂×l."""
    velocity_rows(lane, event, sensor, gravity, 0)
    k, a = 1.0 + lane.s, lane.alpha
    x, y, z = lane.body[0], lane.body[1], lane.body[2]
    for j in range(9):
        h0, h1, h2 = lane.H[0, j], lane.H[1, j], lane.H[2, j]
        lane.H[0, j], lane.H[1, j], lane.H[2, j] = k * (h0 + a * h1), k * (h1 - a * h0), k * h2
    p0, p1 = x + a * y, y - a * x
    lane.H[0, 9], lane.H[1, 9], lane.H[2, 9] = -p0, -p1, -z
    lane.H[0, 10], lane.H[1, 10], lane.H[2, 10] = -k * y, k * x, 0.0
    touch(lane, AT.S, 1, 9)
    touch(lane, AT.ALPHA, 1, 10)
    lane.touched, lane.rows = 11, 3
    lane.r[0], lane.r[1], lane.r[2] = k * p0 - event.z[0], k * p1 - event.z[1], k * z - event.z[2]


@part
def water(lane, event, sensor, gravity):
    """Ĉᵀ(v̂ − ĉ) + ω̂×l."""
    velocity_rows(lane, event, sensor, gravity, 1)
    for i in range(3):
        lane.H[i, 9], lane.H[i, 10] = lane.H[i, 0], lane.H[i, 1]
        lane.r[i] = lane.body[i] - event.z[i]
    touch(lane, AT.C, 2, 9)
    lane.touched, lane.rows = 11, 3


@part
def lever_in_ned(lane, event, sensor, gravity):
    """Cl, into `middle`, at the event's moment."""
    look_back(lane, event, event.lag * gravity)
    C, arm = lane.event_attitude, sensor.lever
    for i in range(3):
        lane.middle[i] = C[i, 0] * arm[0] + C[i, 1] * arm[1] + C[i, 2] * arm[2]


@part
def depth(lane, event, sensor, model, gravity):
    """−ĥ + (Ĉl)_D."""
    lever_in_ned(lane, event, sensor, gravity)
    back = 0.5 * event.lag * (lane.v[2] + lane.event_v[2])
    lane.H[0, 0], lane.H[0, 1] = 1.0, -event.lag
    # Ĉl = (I − [φ×]) C l: the error is l × φ
    lane.H[0, 2], lane.H[0, 3] = -lane.middle[1], lane.middle[0]
    lane.index[0], lane.index[1], lane.index[2], lane.index[3] = (
        AT.R + 2,
        AT.V + 2,
        AT.PHI,
        AT.PHI + 1,
    )
    lane.touched, lane.rows = 4, 1
    lane.r[0] = model.origin[2] - lane.place[2] - back + lane.middle[2] - event.z[0]


@part
def fix(lane, event, sensor, model, gravity):
    """p̂ + Ĉl."""
    lever_in_ned(lane, event, sensor, gravity)
    l0, l1, l2 = lane.middle[0], lane.middle[1], lane.middle[2]
    for i in range(3):
        for j in range(9):
            lane.H[i, j] = 0.0
        lane.H[i, i], lane.H[i, 3 + i] = 1.0, -event.lag
    lane.H[0, 7], lane.H[0, 8] = -l2, l1
    lane.H[1, 6], lane.H[1, 8] = l2, -l0
    lane.H[2, 6], lane.H[2, 7] = -l1, l0
    touch(lane, AT.R, 9, 0)
    lane.touched, lane.rows = 9, 3
    for i in range(3):
        back = 0.5 * event.lag * (lane.v[i] + lane.event_v[i])
        if i == 2:
            p = model.origin[2] - lane.place[2]
        else:
            p = (lane.place[i] - model.origin[i]) * model.metres[i]
        lane.r[i] = p - back + lane.middle[i] - event.z[i]


@part
def magnetometer(lane, event, model, gravity):
    """Ĉᵀm_n + M̂."""
    look_back(lane, event, event.lag * gravity)
    C, f = lane.event_attitude, model.field
    x, y, z = f[0], f[1], f[2]
    for i in range(3):
        a, b, c = C[0, i], C[1, i], C[2, i]
        lane.H[i, 0], lane.H[i, 1], lane.H[i, 2] = y * c - z * b, z * a - x * c, x * b - y * a
        for j in range(3):
            lane.H[i, 3 + j] = -1.0 if i == j else 0.0
        lane.r[i] = a * x + b * y + c * z + lane.M[i] - event.z[i]
    touch(lane, AT.PHI, 3, 0)
    touch(lane, AT.M, 3, 3)
    lane.touched, lane.rows = 6, 3


@part
def heading(lane, event, gravity):
    """ψ̂ − ψ: δψ = −φ_D − tanθ (cosψ φ_N + sinψ φ_E)."""
    look_back(lane, event, event.lag * gravity)
    C = lane.event_attitude
    flat = C[0, 0] * C[0, 0] + C[1, 0] * C[1, 0]
    lane.H[0, 0], lane.H[0, 1], lane.H[0, 2] = (
        C[0, 0] * C[2, 0] / flat,
        C[1, 0] * C[2, 0] / flat,
        -1.0,
    )
    touch(lane, AT.PHI, 3, 0)
    lane.touched, lane.rows = 3, 1
    r = math.atan2(C[1, 0], C[0, 0]) - event.z[0]
    lane.r[0] = r - 2.0 * math.pi * math.floor(r / (2.0 * math.pi) + 0.5)


@part
def linearise(lane, model, event, sensor):
    """r, H and R of an event's block, R as the sensor is believed to be."""
    g = normal_gravity(math.sin(lane.place[0]), lane.place[2])
    kind = sensor.kind
    if kind == DVL_KIND:
        dvl(lane, event, sensor, g)
    elif kind == DEPTH_KIND:
        depth(lane, event, sensor, model, g)
    elif kind == FIX_KIND:
        fix(lane, event, sensor, model, g)
    elif kind == MAGNETOMETER_KIND:
        magnetometer(lane, event, model, g)
    elif kind == HEADING_KIND:
        heading(lane, event, g)
    else:
        water(lane, event, sensor, g)
    for i in range(lane.rows):
        lane.R[i] = sensor.variance[i]


@part
def scale_of(lane, kind):
    """By what the lane's parameters multiply the R of a kind."""
    if kind == DVL_KIND:
        return lane.row[DVL]
    if kind == FIX_KIND:
        return lane.row[FIX]
    if kind in (MAGNETOMETER_KIND, HEADING_KIND):
        return lane.row[MAGNETIC]
    return 1.0


@part
def radii(lane):
    """Radii of curvature at the lane's place, height added."""
    meridian, across = curvature(math.sin(lane.place[0]))
    return meridian + lane.place[2], across + lane.place[2]
