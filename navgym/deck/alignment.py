"""The 24-state deck filter in Rodrigues parameters (IDAM eq. 34-78, corrected), compiled.

Its own physics: how the states move, and what they make the six measurements, velocity and rate
differences of the two IMUs in their frozen frames (eq. 78). The update is that of
`navgym.inertial.update`. The transition is sparse and its blocks are written out.

Corrections, where the code stands: the flexure's transition and noise are exact for any damping
(eq. 80, 76); V_r follows from θ and θ̇ by C (ω × L0 θ + L0 θ̇) without derivatives of ω (eq. 70);
Q keeps the cross block between V_r and θ̇ (eq. 77); the model error is predicted with the weight
outside the normal matrix (eq. 40); weights divide R and not the innovation's covariance (eq. 52),
and are judged by S by default (eq. 53).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import kernel, part
from navgym.inertial import update
from navgym.inertial.states import Layout, State
from navgym.inertial.strapdown import matrix

LAYOUT = Layout(
    State("L", "l", "1", "Rodrigues parameters of C_im^is"),
    State("DV", "δV", "m/s", "error of the sub IMU's velocity"),
    State("PHI", "φ", "rad", "error of the sub IMU's attitude"),
    State("EPS", "ε", "rad/s", "bias of the sub IMU's gyros"),
    State("NABLA", "∇", "m/s²", "bias of the sub IMU's accelerometers"),
    State("VR", "V_r", "m/s", "velocity of the lever arm that flexes"),
    State("THETA", "θ", "rad", "dynamic deformation"),
    State("RATE", "θ̇", "rad/s", "its rate"),
)
STATES, MEASUREMENTS = LAYOUT.size, 6
AT = LAYOUT.first  # for kernels: AT.THETA is the first state of θ
L, DV, PHI, EPS, NABLA, VR, THETA, RATE = LAYOUT.slices
FLEXING = slice(THETA.start, RATE.stop)  # θ and θ̇
ROWS = (LAYOUT.indices("L", "DV", "VR"),) * 3 + (LAYOUT.indices("L", "PHI", "EPS", "RATE"),) * 3
TOUCHED = max(map(len, ROWS))

# columns of the kernel's parameter row
WIDTH, VELOCITY, WEIGHT, PROCESS = range(4)
COLUMNS = ("kernel_width", "velocity_noise", "model_error_weight", "process_noise_scale")
WEIGHT_OFF = 1e6 - 1e-3  # a model error that costs this much or more stays zero; 1e6, to rounding
OFF = np.array([50.0, 0.2, 1e6, 1.0])  # where a filter does not expose a column

SURE = 4e-6  # trace of P_l from which on l may turn predictions into the sub's own axes

GAP_RATE, GAP_FORCE = 2e-3, 0.3  # errors of samples that were filled in: rad/s, m/s²

f8, i8 = np.float64, np.int64
RULE = np.dtype(
    [
        *update.RULE,
        ("no_cross", i8),  # 1: Q without the cross block of V_r and θ̇, as printed
        ("judged", i8),  # 1: report NIS and likelihood
        ("own_channels", i8),  # 1: innovations of V_s and ω_s alone, once l is known
    ]
)
LANE = np.dtype(
    [
        *update.fields(STATES, MEASUREMENTS, TOUCHED),
        ("row", f8, (len(COLUMNS),)),
        ("model_error", f8, (3,)),
        ("k", i8),
        ("length", i8),
        # scratch
        ("B", f8, (3, 6)),  # V_r = B (θ, θ̇) − const, at the last step
        ("M", f8, (3, 6)),
        ("C_s", f8, (3, 3)),
        ("C_m", f8, (3, 3)),
        ("A", f8, (3, 3)),  # C_im^is
        ("G", f8, (3, 3)),  # (I + l×)⁻¹
        ("own", f8, (2, 3)),  # V_s and ω_s, foretold
    ]
)
REPORT = np.dtype(  # what a step says beside its state
    [
        ("innovation", f8, (MEASUREMENTS,)),  # NaN where not used
        ("weights", f8, (MEASUREMENTS,)),
        ("model_error", f8, (3,)),
        ("nis", f8),
        ("log_likelihood", f8),
        ("innovation_variance", f8, (MEASUREMENTS,)),
    ]
)


def begin(lanes: NDArray[Any], models: NDArray[Any], rows: Array) -> None:
    """Put lanes (N,) at the start of recordings with models (N, M); rows (N, 4) of parameters."""
    lanes[...] = np.zeros((), LANE)
    lanes["row"] = rows
    diagonal = np.arange(STATES)
    lanes["P"][:, diagonal, diagonal] = models["start"][:, 0] ** 2
    lever, w = models["lever"][:, 0], models["omega"][:, 0]
    lanes["B"][:, :, :3] = np.cross(w[:, None, :], lever.transpose(0, 2, 1)).transpose(0, 2, 1)
    lanes["B"][:, :, 3:] = lever
    lanes["length"] = 2**62
    update.touch(lanes, ROWS)


@part
def lever_step(lane, model, tape):
    """B of this step, and M, which carries V_r along with (θ, θ̇): eq. 70 without ω̇."""
    matrix(tape.q_m, lane.C_m)
    w = tape.omega
    for a in range(3):
        x, y, z = model.lever[0, a], model.lever[1, a], model.lever[2, a]
        c0, c1, c2 = w[1] * z - w[2] * y, w[2] * x - w[0] * z, w[0] * y - w[1] * x
        F = model.transition
        for i in range(3):
            b = lane.C_m[i, 0] * c0 + lane.C_m[i, 1] * c1 + lane.C_m[i, 2] * c2
            d = lane.C_m[i, 0] * x + lane.C_m[i, 1] * y + lane.C_m[i, 2] * z
            lane.M[i, a] = b * F[a, 0, 0] + d * F[a, 1, 0] - lane.B[i, a]
            lane.M[i, 3 + a] = b * F[a, 0, 1] + d * F[a, 1, 1] - lane.B[i, 3 + a]
            lane.B[i, a] = b
            lane.B[i, 3 + a] = d


@part
def move_state(lane, model, tape):
    """x⁻ = F x (eq. 75)."""
    x, C, v = lane.x, lane.C_s, tape.dV
    dt = model.dt
    for i in range(3):
        n, m = (i + 1) % 3, (i + 2) % 3
        x[AT.DV + i] += v[n] * x[AT.PHI + m] - v[m] * x[AT.PHI + n]
        for j in range(3):
            x[AT.DV + i] += dt * C[i, j] * x[AT.NABLA + j]
    for i in range(3):
        for j in range(3):
            x[AT.PHI + i] -= dt * C[i, j] * x[AT.EPS + j]
        for j in range(6):
            x[AT.VR + i] += lane.M[i, j] * x[AT.THETA + j]
    for a in range(3):
        F = model.transition
        p, r = x[AT.THETA + a], x[AT.RATE + a]
        x[AT.THETA + a] = F[a, 0, 0] * p + F[a, 0, 1] * r
        x[AT.RATE + a] = F[a, 1, 0] * p + F[a, 1, 1] * r


@part
def move_rows(lane, model, tape):
    """P ← F P, block by block."""
    P, C, v = lane.P, lane.C_s, tape.dV
    dt = model.dt
    for i in range(3):
        n, m = (i + 1) % 3, (i + 2) % 3
        c0, c1, c2 = dt * C[i, 0], dt * C[i, 1], dt * C[i, 2]
        for j in range(P.shape[0]):
            P[AT.DV + i, j] += (
                v[n] * P[AT.PHI + m, j] - v[m] * P[AT.PHI + n, j]
                + c0 * P[AT.NABLA, j] + c1 * P[AT.NABLA + 1, j] + c2 * P[AT.NABLA + 2, j]
            )  # fmt: skip
    for i in range(3):
        c0, c1, c2 = dt * C[i, 0], dt * C[i, 1], dt * C[i, 2]
        for j in range(P.shape[0]):
            P[AT.PHI + i, j] -= c0 * P[AT.EPS, j] + c1 * P[AT.EPS + 1, j] + c2 * P[AT.EPS + 2, j]
        m0, m1, m2 = lane.M[i, 0], lane.M[i, 1], lane.M[i, 2]
        m3, m4, m5 = lane.M[i, 3], lane.M[i, 4], lane.M[i, 5]
        for j in range(P.shape[0]):
            P[AT.VR + i, j] += (
                m0 * P[AT.THETA, j] + m1 * P[AT.THETA + 1, j] + m2 * P[AT.THETA + 2, j]
                + m3 * P[AT.RATE, j] + m4 * P[AT.RATE + 1, j] + m5 * P[AT.RATE + 2, j]
            )  # fmt: skip
    for a in range(3):
        f00, f01 = model.transition[a, 0, 0], model.transition[a, 0, 1]
        f10, f11 = model.transition[a, 1, 0], model.transition[a, 1, 1]
        for j in range(P.shape[0]):
            p, r = P[AT.THETA + a, j], P[AT.RATE + a, j]
            P[AT.THETA + a, j] = f00 * p + f01 * r
            P[AT.RATE + a, j] = f10 * p + f11 * r


@part
def drive(lane, a, q00, q01, q11, cross):
    """P ← P + what drives θ and θ̇ of axis a with covariance q, and V_r with them (eq. 77)."""
    P, B = lane.P, lane.B
    P[AT.THETA + a, AT.THETA + a] += q00
    P[AT.THETA + a, AT.RATE + a] += q01
    P[AT.RATE + a, AT.THETA + a] += q01
    P[AT.RATE + a, AT.RATE + a] += q11
    for i in range(3):
        left, right = B[i, a] * q00 + B[i, 3 + a] * q01, B[i, a] * q01 + B[i, 3 + a] * q11
        if cross:
            P[AT.VR + i, AT.THETA + a] += left
            P[AT.THETA + a, AT.VR + i] += left
            P[AT.VR + i, AT.RATE + a] += right
            P[AT.RATE + a, AT.VR + i] += right
        for j in range(3):
            P[AT.VR + i, AT.VR + j] += left * B[j, a] + right * B[j, 3 + a]


@part
def add_sensor_noise(lane, model, tape):
    """P ← P + what the sub IMU's own noise adds to φ and δV, more where samples were filled in."""
    gap = tape.gap * model.interval
    for i in range(3):
        lane.P[AT.PHI + i, AT.PHI + i] += model.gyro + (gap * GAP_RATE) ** 2
        lane.P[AT.DV + i, AT.DV + i] += model.accelerometer + (gap * GAP_FORCE) ** 2


@part
def add_noise(lane, model, tape, rule):
    """P ← P + Q; Q with the cross block of V_r and θ̇, since w_f drives both (eq. 77)."""
    scale = lane.row[PROCESS]
    add_sensor_noise(lane, model, tape)
    for a in range(3):
        q00, q01 = scale * model.noise[a, 0, 0], scale * model.noise[a, 0, 1]
        drive(lane, a, q00, q01, scale * model.noise[a, 1, 1], not rule.no_cross)


@part
def linearize(lane, tape, rate):
    """Innovation z − h(x⁻) and the nonzero elements of H there (eq. 78 and its Jacobian).

    `rate` is the first of the states that the rate rows match: θ̇, or its mean over the step.
    """
    x, C, D = lane.x, lane.C_s, lane.C_m
    V, w = tape.V_s, tape.w_s
    for i in range(3):
        n, m = (i + 1) % 3, (i + 2) % 3
        lane.column[i] = w[n] * x[AT.PHI + m] - w[m] * x[AT.PHI + n]
        lane.column[3 + i] = 0.0
        for j in range(3):
            lane.column[i] += C[i, j] * x[AT.EPS + j]
            lane.column[3 + i] += D[i, j] * x[rate + j]
    for i in range(3):
        n, m = (i + 1) % 3, (i + 2) % 3
        ln, lm = x[AT.L + n], x[AT.L + m]
        # velocity: a = V_s + V_m, d = δV, r = V_r
        dn, dm, rn, rm = x[AT.DV + n], x[AT.DV + m], x[AT.VR + n], x[AT.VR + m]
        an, am = V[n] + tape.V_m[n], V[m] + tape.V_m[m]
        h = an * lm - am * ln + x[AT.DV + i] + ln * dm - lm * dn + x[AT.VR + i] - ln * rm + lm * rn
        lane.innovation[i] = V[i] - tape.V_m[i] - h
        lane.H[i, i] = 0.0
        lane.H[i, n] = -(am - dm + rm)
        lane.H[i, m] = an - dn + rn
        # rate: a = ω_s + ω_m, d = ω_s × φ + C_s ε, r = C_m θ̇
        dn, dm, rn, rm = lane.column[n], lane.column[m], lane.column[3 + n], lane.column[3 + m]
        an, am = w[n] + tape.w_m[n], w[m] + tape.w_m[m]
        h = an * lm - am * ln + lane.column[i] + ln * dm - lm * dn
        h += lane.column[3 + i] - ln * rm + lm * rn
        lane.innovation[3 + i] = w[i] - tape.w_m[i] - h
        lane.H[3 + i, i] = 0.0
        lane.H[3 + i, n] = -(am - dm + rm)
        lane.H[3 + i, m] = an - dn + rn
        # (I + l×) over δV, φ, ε and (I − l×) over V_r, θ̇
        lane.H[i, 3 + i], lane.H[i, 6 + i] = 1.0, 1.0
        lane.H[i, 3 + n], lane.H[i, 6 + n] = -lm, lm
        lane.H[i, 3 + m], lane.H[i, 6 + m] = ln, -ln
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            # column j of ω_s×: e_{j+1} ω_{j+2} − e_{j+2} ω_{j+1}
            s = 0.0
            if i == j1:
                s = w[j2] + 0.0
            elif i == j2:
                s = -w[j1]
            sn = w[j2] if n == j1 else (-w[j1] if n == j2 else 0.0)
            sm = w[j2] if m == j1 else (-w[j1] if m == j2 else 0.0)
            lane.H[3 + i, 3 + j] = s + ln * sm - lm * sn
            lane.H[3 + i, 6 + j] = C[i, j] + ln * C[m, j] - lm * C[n, j]
            lane.H[3 + i, 9 + j] = D[i, j] - ln * D[m, j] + lm * D[n, j]


@part
def turn_over(lane):
    """G = (I + l×)⁻¹ = (I + l lᵀ − l×)/(1 + |l|²) and A = G (I − l×), which is C_im^is."""
    l0, l1, l2 = lane.x[AT.L], lane.x[AT.L + 1], lane.x[AT.L + 2]
    G, A = lane.G, lane.A
    d = 1.0 / (1.0 + l0 * l0 + l1 * l1 + l2 * l2)
    G[0, 0], G[0, 1], G[0, 2] = d * (1.0 + l0 * l0), d * (l0 * l1 + l2), d * (l0 * l2 - l1)
    G[1, 0], G[1, 1], G[1, 2] = d * (l0 * l1 - l2), d * (1.0 + l1 * l1), d * (l1 * l2 + l0)
    G[2, 0], G[2, 1], G[2, 2] = d * (l0 * l2 + l1), d * (l1 * l2 - l0), d * (1.0 + l2 * l2)
    for i in range(3):
        g0, g1, g2 = G[i, 0], G[i, 1], G[i, 2]
        A[i, 0] = g0 - (g1 * l2 - g2 * l1)
        A[i, 1] = g1 - (g2 * l0 - g0 * l2)
        A[i, 2] = g2 - (g0 * l1 - g1 * l0)


@part
def foretell(lane, tape, rate):
    """The sub's own V_s and ω_s from the rest of the state: `own`.

    z = h(x) says (I + l×)(V_s − δV) = (I − l×)(V_m + V_r), and the same of rates, so that
    V̂_s = δV + A (V_m + V_r) and ω̂_s = d + A (ω_m + C_m m) with d = ω̂_s × φ + C_s ε.
    """
    x, A = lane.x, lane.A
    for i in range(3):
        lane.column[i] = tape.w_m[i]
        for j in range(3):
            lane.column[i] += lane.C_m[i, j] * x[rate + j]
    for i in range(3):
        V, w = x[AT.DV + i], 0.0
        for j in range(3):
            V += A[i, j] * (tape.V_m[j] + x[AT.VR + j])
            w += A[i, j] * lane.column[j] + lane.C_s[i, j] * x[AT.EPS + j]
        lane.own[0, i] = V
        lane.column[3 + i] = w
    for i in range(3):
        n, m = (i + 1) % 3, (i + 2) % 3
        w = lane.column[3 + i]
        w += lane.column[3 + n] * x[AT.PHI + m] - lane.column[3 + m] * x[AT.PHI + n]
        lane.own[1, i] = w


@part
def linearize_own(lane, tape, rate):
    """Innovations of V_s and ω_s alone, and H without what was measured of them.

    z − h holds (I + l×) V_s: there a wrong channel enters the other two by l. `rate` as in `linearize`.
    """
    turn_over(lane)
    foretell(lane, tape, rate)
    x, G, A, own = lane.x, lane.G, lane.A, lane.own
    for i in range(3):
        # a = V̂_s + V_m − δV + V_r, and ω̂_s + ω_m − d + C_m m, of which column holds ω_m + C_m m
        lane.column[3 + i] = own[0, i] + tape.V_m[i] - x[AT.DV + i] + x[AT.VR + i]
        w = lane.column[i]
        for j in range(3):
            w += A[i, j] * lane.column[j]
        lane.column[6 + i] = w
    for i in range(3):
        lane.innovation[i] = tape.V_s[i] - own[0, i]
        lane.innovation[3 + i] = tape.w_s[i] - own[1, i]
        for j in range(3):
            n, m = (j + 1) % 3, (j + 2) % 3
            # column j of a×: e_n a_m − e_m a_n
            lane.H[i, j] = G[i, n] * lane.column[3 + m] - G[i, m] * lane.column[3 + n]
            lane.H[3 + i, j] = G[i, n] * lane.column[6 + m] - G[i, m] * lane.column[6 + n]
            lane.H[i, 3 + j] = 1.0 if i == j else 0.0
            lane.H[i, 6 + j] = A[i, j]
            lane.H[3 + i, 3 + j] = own[1, m] if i == n else (-own[1, n] if i == m else 0.0)
            lane.H[3 + i, 6 + j] = lane.C_s[i, j]
            s = 0.0
            for b in range(3):
                s += A[i, b] * lane.C_m[b, j]
            lane.H[3 + i, 9 + j] = s


@part
def look(lane, tape, rate, own_channels):
    """Innovations and H; by the sub's own channels, if asked for, once l is known."""
    spread = lane.P[AT.L, AT.L] + lane.P[AT.L + 1, AT.L + 1] + lane.P[AT.L + 2, AT.L + 2]
    if own_channels and spread < SURE:
        linearize_own(lane, tape, rate)
    else:
        linearize(lane, tape, rate)


@part
def predict_error(lane, model):
    """Model error D̂ on the flexure's acceleration (eq. 40, corrected), added to x⁻ (eq. 41).

    D̂ = {[ΛS]ᵀ R⁻¹ [ΛS] + A}⁻¹ [ΛS]ᵀ R⁻¹ (z − h(x⁻)), A = weight · diag(dt/q). The same
    datum is used again by the update, as in the paper, which hurts:
    docs/science/idam.md#correntropy-and-model-prediction.
    """
    G, N = np.zeros((6, 3)), np.zeros((3, 4))
    for a in range(3):
        g0, g1 = model.gain[a, 0], model.gain[a, 1]
        for c in range(3):
            for i in range(3):
                G[c, a] += lane.H[c, 6 + i] * (lane.B[i, a] * g0 + lane.B[i, 3 + a] * g1)
            G[3 + c, a] = lane.H[3 + c, 9 + a] * g1
    for a in range(3):
        N[a, a] = lane.row[WEIGHT] * model.dt / model.density[a]
        for c in range(MEASUREMENTS):
            if lane.used[c]:
                for b in range(3):
                    N[a, b] += G[c, a] * G[c, b] / lane.R[c]
                N[a, 3] += G[c, a] * lane.innovation[c] / lane.R[c]
    for a in range(3):  # Gauss elimination of a definite 3 x 3 system
        for b in range(a + 1, 3):
            factor = N[b, a] / N[a, a]
            for j in range(a, 4):
                N[b, j] -= factor * N[a, j]
    for a in range(2, -1, -1):
        s = N[a, 3]
        for b in range(a + 1, 3):
            s -= N[a, b] * lane.model_error[b]
        lane.model_error[a] = s / N[a, a]
    for a in range(3):
        D = lane.model_error[a]
        g0, g1 = model.gain[a, 0], model.gain[a, 1]
        lane.x[AT.THETA + a] += g0 * D
        lane.x[AT.RATE + a] += g1 * D
        for i in range(3):
            lane.x[AT.VR + i] += (lane.B[i, a] * g0 + lane.B[i, 3 + a] * g1) * D


@part
def step(lane, model, tape, rule):
    """One filter step on a tape's record."""
    matrix(tape.q_mid, lane.C_s)
    lever_step(lane, model, tape)
    move_state(lane, model, tape)
    move_rows(lane, model, tape)
    update.transpose(lane)
    move_rows(lane, model, tape)
    add_noise(lane, model, tape, rule)
    look(lane, tape, AT.RATE, rule.own_channels > 0)
    scale = lane.row[PROCESS]
    for i in range(3):
        lane.R[i] = lane.row[VELOCITY] ** 2
        # a mean rate over the step measures the rate at its end: the difference has variance q dt/3
        lane.R[3 + i] = model.rate + scale * model.density[i] * model.dt / 3.0
        lane.used[i] = 1
        lane.used[3 + i] = 1 if tape.gap == 0 else 0
    if rule.judged:
        update.judge(lane)
    for i in range(3):
        lane.model_error[i] = 0.0
    if lane.row[WEIGHT] < WEIGHT_OFF:
        predict_error(lane, model)
        look(lane, tape, AT.RATE, rule.own_channels > 0)
    update.expect(lane)
    update.robust(lane, rule, lane.row[WIDTH])
    update.check(lane)
    lane.k += 1


@part
def write_report(lane, report):
    """What the lane says of its last step."""
    for c in range(MEASUREMENTS):
        report.innovation[c] = lane.innovation[c] if lane.used[c] else math.nan
        report.weights[c] = lane.weight[c]
        report.innovation_variance[c] = lane.variance[c]
    for a in range(3):
        report.model_error[a] = lane.model_error[a]
    report.nis = lane.nis
    report.log_likelihood = lane.log_likelihood


@kernel
def run(
    lanes,
    models,
    tapes,
    rules,
    table,
    interval,
    outputs,
    reports,
    covariances,
):
    """Filter each lane to its `length` or its tape's end.

    Args:
        lanes: (N,) as `begin` or an earlier run left them.
        models: (N, M) records `alignment_model.MODEL`.
        tapes: (N, K).
        rules: (1,) RULE.
        table: (N or 1, intervals, 4) parameters; row k // interval holds in step k, the last to the end.
        interval: steps per row of `table`.
        outputs: (N, K, 24) states.
        reports: (N, K or 0) REPORT.
        covariances: (N, K or 0, 24, 24).
    """
    rule = rules[0]
    for i in range(len(lanes)):
        lane = lanes[i]
        for k in range(lane.k, min(lane.length, tapes.shape[1])):
            row = min(k // interval, table.shape[1] - 1)
            for p in range(table.shape[2]):
                lane.row[p] = table[min(i, table.shape[0] - 1), row, p]
            tape = tapes[i, k]
            step(lane, models[i, tape.model], tape, rule)
            for a in range(STATES):
                outputs[i, k, a] = lane.x[a]
            if reports.shape[1] > 0:
                write_report(lane, reports[i, k])
            if covariances.shape[1] > 0:
                for a in range(STATES):
                    for b in range(STATES):
                        covariances[i, k, a, b] = lane.P[a, b]
