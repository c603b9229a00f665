"""The error state of an inertial navigator in NED, and how a filter step moves it, compiled.

QIVBF eq. 3-4, corrected (docs/science/ins.md): Ẋ = F X + G W, with IMU biases in body axes, and position and
depth among the measurements. Errors of navigation are δ = nominal − true, with Ĉ = (I − [φ×]) C; biases and
other constants are true − nominal. The loop is closed: after each measurement the nominal takes the error
over and the error is zero again, so a lane holds a nominal and a covariance, and `x` is what it answers.

Over a step of T s, with Δv, J_R, J_vg and J_va of its increments (`navgym.inertial.preintegration`) and
D = exp(−½ω_in T) C:

    δv⁺ = (I + T V_v + ½T A N_v) δv + (A (I − ½T[ω_in×]) + ½T V_v A) φ + T V_r δr − D J_vg δb_g − D J_va δb_a
    φ⁺  = (I − T[ω_in×]) φ + C⁺ J_R δb_g + T N_v ½(δv + δv⁺) + T N_r δr
    δr⁺ = δr + T (½(δv + δv⁺) + R_r δr)            A = [D Δv ×],  N = ∂ω_in,  V = ∂v̇,  R = ∂ṙ

which is I + F T + ½(F T)² up to terms without effect, with F's integrals over the step exact.
"""

from __future__ import annotations

import math

import numpy as np

from navgym.core.compile import part
from navgym.inertial.block_update import block_fields
from navgym.inertial.earth import EARTH_RATE
from navgym.inertial.ellipsoid import transport_rate
from navgym.inertial.mechanization import local_frame, move
from navgym.inertial.rotation import euler_angles, exponential, multiply, orthonormalise
from navgym.ins.layout import (
    AT,
    COLUMNS,
    MOVING,
    STATES,
    TOUCHED,
    TOUCHING,
)

f8, i8 = np.float64, np.int64
HELD = 3  # body velocities that a fill looks back on
LANE = np.dtype(
    [
        ("x", f8, (STATES,)),  # the answer: position, velocity, roll pitch heading, and constants
        *block_fields(STATES, TOUCHED),
        ("row", f8, (len(COLUMNS),)),
        # nominal
        ("place", f8, (3,)),  # latitude, longitude (rad), height (m)
        ("v", f8, (3,)),
        ("attitude", f8, (3, 3)),
        ("bg", f8, (3,)),
        ("ba", f8, (3,)),
        ("M", f8, (3,)),
        ("s", f8),
        ("alpha", f8),
        ("c", f8, (2,)),
        # what a step says
        ("nis", f8),
        ("log_likelihood", f8),
        ("components", i8),
        ("power", f8),
        ("diverged", i8),
        ("k", i8),
        ("length", i8),
        # the Doppler log's silence
        ("held", f8, (HELD, 3)),  # its last body velocities, the last one first
        ("held_time", f8, (HELD,)),  # s; NaN: none yet
        ("held_attitude", f8, (3, 3)),  # C at the last one
        ("turned", f8),  # rad, the furthest that the vehicle has turned since then
        ("silence", f8),  # s since then
        # for who goes back over a recording
        ("keeps", i8),  # whether the next two are kept
        ("P_prior", f8, (STATES, STATES)),  # before the step's measurements
        ("removed", f8, (STATES,)),  # of the error, by all of them
        # scratch
        ("Phi", f8, (MOVING, TOUCHING)),
        ("Y", f8, (MOVING, STATES)),
        ("D", f8, (3, 3)),
        ("turn", f8, (3, 3)),
        ("product", f8, (3, 3)),
        ("A", f8, (3, 3)),
        ("Nv", f8, (3, 3)),
        ("Nr", f8, (3, 3)),
        ("Vv", f8, (3, 3)),
        ("Vr", f8, (3, 3)),
        ("before", f8, (3,)),
        ("middle", f8, (3,)),
        ("body", f8, (3,)),
        ("event_attitude", f8, (3, 3)),
        ("event_v", f8, (3,)),
    ]
)
MODEL = np.dtype(
    [
        ("T", f8),  # s per filter step
        ("origin", f8, (3,)),  # latitude, longitude, height of x = 0
        ("metres", f8, (2,)),  # per rad of latitude and longitude there
        ("start", f8, (15,)),  # place, v, attitude row by row
        ("deviation", f8, (STATES,)),  # standard deviations at the start
        ("gyro", f8),  # densities: rad²/s
        ("accelerometer", f8),  # m²/s³
        ("gyro_walk", f8),  # of the biases' random walks: rad²/s³
        ("accelerometer_walk", f8),  # m²/s⁵
        ("field", f8, (3,)),  # magnetic field in NED, µT
        ("current_memory", f8),  # what a step keeps of the current
        ("current_noise", f8),  # variance that it adds, m²/s²
    ]
)
GAP_RATE, GAP_FORCE = 2e-2, 0.5  # errors of IMU samples that were filled in: rad/s, m/s²


@part
def navigate(lane, model, tape):
    """Move the nominal by a step's increments; leaves `D`, `middle` and the frame for `transition`."""
    T = model.T
    for i in range(3):
        r, w = 0.0, tape.dv[i]
        for j in range(3):
            r += tape.J_R[i, j] * lane.bg[j]
            w += tape.J_vg[i, j] * lane.bg[j] + tape.J_va[i, j] * lane.ba[j]
        lane.before[i], lane.body[i] = r, w
    exponential(lane.before[0], lane.before[1], lane.before[2], lane.turn)
    multiply(tape.dR, lane.turn, lane.product)  # ΔR without the biases
    n, d, tn, te, td, g, meridian, across = local_frame(lane.place, lane.v)
    h = -0.5 * T
    exponential(h * (n + tn), h * te, h * (d + td), lane.turn)
    multiply(lane.turn, lane.attitude, lane.D)
    for i in range(3):
        a = lane.D[i, 0] * lane.body[0] + lane.D[i, 1] * lane.body[1] + lane.D[i, 2] * lane.body[2]
        lane.event_v[i] = a  # Δv in NED
        lane.before[i] = lane.v[i]
        lane.middle[i] = lane.v[i] + 0.5 * a + (0.5 * T * g if i == 2 else 0.0)
    wn, we, wd = 2.0 * n + tn, te, 2.0 * d + td
    x, y, z = lane.middle[0], lane.middle[1], lane.middle[2]
    lane.v[0] += lane.event_v[0] - T * (we * z - wd * y)
    lane.v[1] += lane.event_v[1] - T * (wd * x - wn * z)
    lane.v[2] += lane.event_v[2] - T * (wn * y - we * x) + T * g
    tn, te, td = transport_rate(
        -d / n, x, y, meridian, across
    )  # at the middle: Euler's error is T/t
    transition_blocks(lane, n, d, tn, te, td, g, meridian, across)
    move(lane.place, lane.before, lane.v, T, meridian, across)
    exponential(-T * (n + tn), -T * te, -T * (d + td), lane.turn)
    multiply(lane.turn, lane.attitude, lane.A)
    multiply(lane.A, lane.product, lane.attitude)
    orthonormalise(lane.attitude)
    transition(lane, tape, T, n + tn, te, d + td, meridian, across)


@part
def transition_blocks(lane, n, d, tn, te, td, g, meridian, across):
    """N_v, N_r, V_v, V_r: derivatives of ω_in and of v̇ by δv and δr, at the middle of the step."""
    vn, ve, vd = lane.middle[0], lane.middle[1], lane.middle[2]
    sine = -d / EARTH_RATE
    cosine = n / EARTH_RATE
    tangent = sine / cosine
    for i in range(3):
        for j in range(3):
            lane.Nv[i, j], lane.Nr[i, j] = 0.0, 0.0
    lane.Nv[0, 1], lane.Nv[1, 0], lane.Nv[2, 1] = 1.0 / across, -1.0 / meridian, -tangent / across
    en_n = -ve / (cosine * cosine * across * meridian)
    ie_n, ie_d = d / meridian, -n / meridian
    lane.Nr[0, 2] = ve / (across * across)
    lane.Nr[1, 2] = -vn / (meridian * meridian)
    lane.Nr[2, 2] = -ve * tangent / (across * across)
    lane.Nr[0, 0], lane.Nr[2, 0] = ie_n, ie_d + en_n
    for j in range(3):  # v × N
        a, b, c = lane.Nv[0, j], lane.Nv[1, j], lane.Nv[2, j]
        lane.Vv[0, j] = ve * c - vd * b
        lane.Vv[1, j] = vd * a - vn * c
        lane.Vv[2, j] = vn * b - ve * a
        a, b, c = lane.Nr[0, j], lane.Nr[1, j], lane.Nr[2, j]
        if j == 0:
            a, c = a + ie_n, c + ie_d
        lane.Vr[0, j] = ve * c - vd * b
        lane.Vr[1, j] = vd * a - vn * c
        lane.Vr[2, j] = vn * b - ve * a
    lane.Vr[2, 2] += 2.0 * g / math.sqrt(meridian * across)
    wn, we, wd = 2.0 * n + tn, te, 2.0 * d + td
    lane.Vv[0, 1] += wd
    lane.Vv[0, 2] -= we
    lane.Vv[1, 0] -= wd
    lane.Vv[1, 2] += wn
    lane.Vv[2, 0] += we
    lane.Vv[2, 1] -= wn


@part
def transition(lane, tape, T, wn, we, wd, meridian, across):
    """Φ of δr, δv, φ by δr, δv, φ, δb_g, δb_a; `attitude` is that of the step's end."""
    F, A, h = lane.Phi, lane.A, 0.5 * T
    x, y, z = lane.event_v[0], lane.event_v[1], lane.event_v[2]
    A[0, 0], A[0, 1], A[0, 2] = 0.0, -z, y
    A[1, 0], A[1, 1], A[1, 2] = z, 0.0, -x
    A[2, 0], A[2, 1], A[2, 2] = -y, x, 0.0
    for i in range(3):
        a, b, c = A[i, 0], A[i, 1], A[i, 2]
        for j in range(3):
            F[3 + i, j] = T * lane.Vr[i, j]
            one = 1.0 if i == j else 0.0
            s = a * lane.Nv[0, j] + b * lane.Nv[1, j] + c * lane.Nv[2, j]
            F[3 + i, 3 + j] = one + T * lane.Vv[i, j] + h * s
            s = lane.Vv[i, 0] * A[0, j] + lane.Vv[i, 1] * A[1, j] + lane.Vv[i, 2] * A[2, j]
            F[3 + i, 6 + j] = A[i, j] + h * s
            g, f, e = 0.0, 0.0, 0.0
            for k in range(3):
                g -= lane.D[i, k] * tape.J_vg[k, j]
                f -= lane.D[i, k] * tape.J_va[k, j]
                e += lane.attitude[i, k] * tape.J_R[k, j]
            F[3 + i, 9 + j], F[3 + i, 12 + j] = g, f
            F[6 + i, j] = T * lane.Nr[i, j]
            F[6 + i, 3 + j] = 0.0
            F[6 + i, 6 + j] = one
            F[6 + i, 9 + j] = e
            F[6 + i, 12 + j] = 0.0
        F[3 + i, 6] -= h * (b * wd - c * we)
        F[3 + i, 7] -= h * (c * wn - a * wd)
        F[3 + i, 8] -= h * (a * we - b * wn)
    for j in range(12, TOUCHING):  # what the accelerometers' biases have done, carried on
        x, y, z = F[3, j], F[4, j], F[5, j]
        for i in range(3):
            F[3 + i, j] += h * (lane.Vv[i, 0] * x + lane.Vv[i, 1] * y + lane.Vv[i, 2] * z)
    F[6, 7] += T * wd
    F[6, 8] -= T * we
    F[7, 6] -= T * wd
    F[7, 8] += T * wn
    F[8, 6] += T * we
    F[8, 7] -= T * wn
    for j in range(TOUCHING):
        for i in range(3):
            lane.middle[i] = h * (F[3 + i, j] + (1.0 if j == 3 + i else 0.0))
        for i in range(3):
            F[6 + i, j] += (
                lane.Nv[i, 0] * lane.middle[0] + lane.Nv[i, 1] * lane.middle[1] + lane.Nv[i, 2] * lane.middle[2]
            )  # fmt: skip
            F[i, j] = lane.middle[i] + (1.0 if j == i else 0.0)
    vn, ve, vd = lane.before[0], lane.before[1], lane.before[2]
    tangent = -lane.Nv[2, 1] * across
    F[0, 0] -= T * vd / meridian
    F[0, 2] += T * vn / meridian
    F[1, 0] += T * ve * tangent / meridian
    F[1, 1] -= T * (vd + vn * tangent) / across
    F[1, 2] += T * ve / across


@part
def carry(P, F, Y):
    """P ← Φ P Φᵀ, a function of arrays: see `navgym.inertial.update`."""
    for i in range(MOVING):
        for j in range(STATES):
            Y[i, j] = 0.0
        for k in range(TOUCHING):
            f, row = F[i, k], P[k]
            for j in range(STATES):
                Y[i, j] += f * row[j]
    for i in range(MOVING):
        for j in range(i + 1):
            s = 0.0
            for k in range(TOUCHING):
                s += Y[i, k] * F[j, k]
            P[i, j] = s
            P[j, i] = s
        for j in range(MOVING, STATES):
            P[i, j] = Y[i, j]
            P[j, i] = Y[i, j]


@part
def spread_errors(lane, model, tape, scale):
    """P ← Φ P Φᵀ + Q; `scale` multiplies the variances of the IMU's white noise."""
    P, T = lane.P, model.T
    carry(P, lane.Phi, lane.Y)
    force = scale * model.accelerometer * T + (tape.gap * GAP_FORCE) ** 2
    turn = scale * model.gyro * T + (tape.gap * GAP_RATE) ** 2
    for i in range(3):
        P[AT.R + i, AT.R + i] += force * T * T / 3.0
        P[AT.R + i, AT.V + i] += 0.5 * force * T
        P[AT.V + i, AT.R + i] += 0.5 * force * T
        P[AT.V + i, AT.V + i] += force
        P[AT.PHI + i, AT.PHI + i] += turn
        P[AT.BG + i, AT.BG + i] += model.gyro_walk * T
        P[AT.BA + i, AT.BA + i] += model.accelerometer_walk * T
    keep = model.current_memory
    for a in range(2 if P[AT.C, AT.C] > 0.0 else 0):
        i = AT.C + a
        lane.c[a] *= keep
        for j in range(STATES):
            P[i, j] *= keep
        for j in range(STATES):
            P[j, i] *= keep
        P[i, i] += model.current_noise


@part
def keep_prior(lane):
    """Put P aside as foretold; nothing of the error is removed yet."""
    for i in range(STATES):
        lane.removed[i] = 0.0
        for j in range(STATES):
            lane.P_prior[i, j] = lane.P[i, j]


@part
def turn_with(lane):
    """P as it is about the velocity that `dx` leads to: v's errors += (v̂⁺ − v̂⁻) × φ.

    What a Doppler log measures is Ĉᵀv̂ − Cᵀv, to first order Cᵀ(δv − v × φ), whatever the heading. Which δv goes with which φ
    depends on v: left as it was about a velocity that is corrected by much, P would claim to know the
    heading from it, which nothing has shown.
    """
    P, dx = lane.P, lane.dx
    x, y, z = dx[AT.V], dx[AT.V + 1], dx[AT.V + 2]
    for j in range(STATES):
        a, b, c = P[AT.PHI, j], P[AT.PHI + 1, j], P[AT.PHI + 2, j]
        P[AT.V, j] -= y * c - z * b
        P[AT.V + 1, j] -= z * a - x * c
        P[AT.V + 2, j] -= x * b - y * a
    for i in range(AT.V, AT.V + 3):
        a, b, c = P[i, AT.PHI], P[i, AT.PHI + 1], P[i, AT.PHI + 2]
        P[i, AT.V] -= y * c - z * b
        P[i, AT.V + 1] -= z * a - x * c
        P[i, AT.V + 2] -= x * b - y * a
    for i in range(AT.V, AT.V + 3):
        for j in range(STATES):
            if j < AT.V or j > i:
                P[j, i] = P[i, j]


@part
def take_over(lane, meridian, across):
    """Let the nominal take the error `dx` over; radii with the height added."""
    dx = lane.dx
    if lane.keeps > 0:
        for i in range(STATES):
            lane.removed[i] += dx[i]
    turn_with(lane)
    lane.place[0] -= dx[AT.R] / meridian
    lane.place[1] -= dx[AT.R + 1] / (across * math.cos(lane.place[0]))
    lane.place[2] += dx[AT.R + 2]
    exponential(dx[AT.PHI], dx[AT.PHI + 1], dx[AT.PHI + 2], lane.turn)
    multiply(lane.turn, lane.attitude, lane.product)
    for i in range(3):
        lane.v[i] -= dx[AT.V + i]
        lane.bg[i] += dx[AT.BG + i]
        lane.ba[i] += dx[AT.BA + i]
        lane.M[i] += dx[AT.M + i]
        for j in range(3):
            lane.attitude[i, j] = lane.product[i, j]
    lane.s += dx[AT.S]
    lane.alpha += dx[AT.ALPHA]
    lane.c[0] += dx[AT.C]
    lane.c[1] += dx[AT.C + 1]


@part
def answer(lane, model):
    """Write the nominal to `x`: position in NED from the origin, velocity, angles, constants."""
    x = lane.x
    x[AT.R] = (lane.place[0] - model.origin[0]) * model.metres[0]
    x[AT.R + 1] = (lane.place[1] - model.origin[1]) * model.metres[1]
    x[AT.R + 2] = model.origin[2] - lane.place[2]
    roll, pitch, heading = euler_angles(lane.attitude)
    x[AT.PHI], x[AT.PHI + 1], x[AT.PHI + 2] = roll, pitch, heading
    for i in range(3):
        x[AT.V + i] = lane.v[i]
        x[AT.BG + i], x[AT.BA + i], x[AT.M + i] = lane.bg[i], lane.ba[i], lane.M[i]
    x[AT.S], x[AT.ALPHA] = lane.s, lane.alpha
    x[AT.C], x[AT.C + 1] = lane.c[0], lane.c[1]
