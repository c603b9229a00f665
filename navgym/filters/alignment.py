"""The 24-state deck filter in Rodrigues parameters (IDAM eq. 34-78, corrected), compiled.

States: l (Rodrigues parameters of C_im^is), δV, φ, ε, ∇, V_r, θ, θ̇, three axes each. Measurements:
velocity and rate differences of the two IMUs in their frozen frames (eq. 78). The transition is
sparse and its blocks are written out; the six measurements are used one by one, linearised at the
prediction, which equals the block update since their noises are independent.

Corrections, where the code stands: the flexure's transition and noise are exact for any damping
(eq. 80, 76); V_r follows from θ and θ̇ by C (ω × L0 θ + L0 θ̇) without derivatives of ω (eq. 70);
Q keeps the cross block between V_r and θ̇ (eq. 77); the model error is predicted with the weight
outside the normal matrix (eq. 40); weights divide R and not the innovation's covariance (eq. 52),
and are judged by S by default (eq. 53).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym._checks import Array
from navgym._compile import kernel, part
from navgym.deck_model import DeckModel, lever_matrix
from navgym.dual_imu import DualIMURecording
from navgym.filters.mechanization import filled
from navgym.flexure import FlexureModel
from navgym.inertial.strapdown import matrix

STATES, MEASUREMENTS = 24, 6
L, DV, PHI, EPS, NABLA, VR, THETA, RATE = range(0, 24, 3)  # first state of each triple

# columns of the kernel's parameter row
WIDTH, VELOCITY, WEIGHT, PROCESS = range(4)
COLUMNS = ("kernel_width", "velocity_noise", "model_error_weight", "process_noise_scale")
WIDTH_OFF = 50.0 - 1e-9  # a kernel of this width or more is a Kalman filter; 50, to rounding
WEIGHT_OFF = 1e6 - 1e-3  # a model error that costs this much or more stays zero; 1e6, to rounding
OFF = np.array([50.0, 0.2, 1e6, 1.0])  # where a filter does not expose a column

FLOOR = 1e-12  # of a weight: R/C stays finite
NUMERICAL, RUNAWAY = 2, 1  # `diverged`
RUNAWAY_POWER = 1e4  # mean squared innovation over S that counts as running away
POWER_MEMORY = 0.95
GAP_RATE, GAP_FORCE = 2e-3, 0.3  # errors of samples that were filled in: rad/s, m/s²
LOG_2PI = math.log(2.0 * math.pi)

f8, i8 = np.float64, np.int64
MODEL = np.dtype(
    [
        ("dt", f8),
        ("interval", f8),
        ("transition", f8, (3, 2, 2)),
        ("noise", f8, (3, 2, 2)),
        ("gain", f8, (3, 2)),  # what a constant acceleration adds to (θ, θ̇) in a step
        ("density", f8, (3,)),
        ("lever", f8, (3, 3)),
        ("gyro", f8),  # variance that a step adds to φ
        ("accelerometer", f8),  # and to δV
        ("rate", f8),  # variance of a rate difference
        ("start", f8, (STATES,)),  # standard deviations at the start
        ("omega", f8, (3,)),  # the main IMU's rate at the start
    ]
)
RULE = np.dtype(
    [
        ("iterations", i8),  # fixed-point iterations of the weights; 1: from the innovation alone
        ("by_noise", i8),  # 1: weights are judged by R, as printed
        ("no_cross", i8),  # 1: Q without the cross block of V_r and θ̇, as printed
        ("printed_covariance", i8),  # 1: eq. 51 as printed
        ("judged", i8),  # 1: report NIS and likelihood
    ]
)
LANE = np.dtype(
    [
        ("x", f8, (STATES,)),
        ("P", f8, (STATES, STATES)),
        ("row", f8, (len(COLUMNS),)),
        ("innovation", f8, (MEASUREMENTS,)),
        ("variance", f8, (MEASUREMENTS,)),  # diagonal of S
        ("weight", f8, (MEASUREMENTS,)),
        ("model_error", f8, (3,)),
        ("nis", f8),
        ("log_likelihood", f8),
        ("power", f8),
        ("diverged", i8),
        ("k", i8),
        ("length", i8),
        # scratch
        ("B", f8, (3, 6)),  # V_r = B (θ, θ̇) − const, at the last step
        ("M", f8, (3, 6)),
        ("C_s", f8, (3, 3)),
        ("C_m", f8, (3, 3)),
        ("Hv", f8, (3, 9)),  # rows of H over l, δV, V_r
        ("Hw", f8, (3, 12)),  # rows of H over l, φ, ε, θ̇
        ("R", f8, (MEASUREMENTS,)),
        ("used", i8, (MEASUREMENTS,)),
        ("x_prior", f8, (STATES,)),
        ("P_prior", f8, (STATES, STATES)),
        ("column", f8, (STATES,)),
        ("PH", f8, (MEASUREMENTS, STATES)),
        ("S", f8, (MEASUREMENTS, MEASUREMENTS)),
    ]
)
V_STATES = np.array([0, 1, 2, 3, 4, 5, 15, 16, 17])
W_STATES = np.array([0, 1, 2, 6, 7, 8, 9, 10, 11, 21, 22, 23])


def pack(
    recording: DualIMURecording, flexures: Sequence[FlexureModel] | None = None
) -> NDArray[Any]:
    """What a lane believes: MODEL records, one per flexure model (the recording's by default)."""
    first = filled(recording)[0][0][:3]
    return pack_model(recording.model, recording.interval, first, flexures)


def pack_model(
    model: DeckModel, interval: float, first: Array, flexures: Sequence[FlexureModel] | None = None
) -> NDArray[Any]:
    """MODEL records without a recording.

    Args:
        model: what is believed.
        interval: s between IMU samples.
        first: (3, 3) rad, the main IMU's first three angle increments.
        flexures: a record for each of these; the model's own by default.
    """
    chosen = [model.flexure] if flexures is None else list(flexures)
    packed = np.zeros(len(chosen), MODEL)
    dt = interval * model.samples_per_step
    packed["dt"], packed["interval"] = dt, interval
    packed["lever"] = lever_matrix(model.lever_arm)
    packed["gyro"] = model.gyro_noise**2 * dt
    packed["accelerometer"] = model.accelerometer_noise**2 * dt
    packed["rate"] = model.rate_noise**2
    packed["start"] = _start(model)
    packed["omega"] = (11.0 * first[0] - 7.0 * first[1] + 2.0 * first[2]) / (6.0 * interval)
    for record, flexure in zip(packed, chosen, strict=True):
        write_flexure(record, flexure)
    return packed


def write_flexure(record: Any, flexure: FlexureModel) -> None:
    """Put a flexure model into a MODEL record."""
    dt = float(record["dt"])
    record["transition"] = flexure.transition(dt)
    record["noise"] = flexure.process_noise(dt)
    record["gain"][:, 0] = (1.0 - record["transition"][:, 0, 0]) / flexure.stiffness
    record["gain"][:, 1] = record["transition"][:, 0, 1]
    record["density"] = flexure.noise_density
    record["start"][THETA:RATE] = flexure.sigma
    record["start"][RATE:] = flexure.rate_sigma


def _start(model: DeckModel) -> Array:
    """Standard deviations at the start (SCIENCE B1)."""
    each = (
        model.misalignment, 1e-6, 1e-8, model.gyro_bias, model.accelerometer_bias, 1e-6, 0.0, 0.0,
    )  # fmt: skip
    return np.repeat(np.array(each), 3)


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
        x[DV + i] += v[n] * x[PHI + m] - v[m] * x[PHI + n]
        for j in range(3):
            x[DV + i] += dt * C[i, j] * x[NABLA + j]
    for i in range(3):
        for j in range(3):
            x[PHI + i] -= dt * C[i, j] * x[EPS + j]
        for j in range(6):
            x[VR + i] += lane.M[i, j] * x[THETA + j]
    for a in range(3):
        F = model.transition
        p, r = x[THETA + a], x[RATE + a]
        x[THETA + a] = F[a, 0, 0] * p + F[a, 0, 1] * r
        x[RATE + a] = F[a, 1, 0] * p + F[a, 1, 1] * r


@part
def move_rows(lane, model, tape):
    """P ← F P, block by block."""
    P, C, v = lane.P, lane.C_s, tape.dV
    dt = model.dt
    for i in range(3):
        n, m = (i + 1) % 3, (i + 2) % 3
        c0, c1, c2 = dt * C[i, 0], dt * C[i, 1], dt * C[i, 2]
        for j in range(STATES):
            P[DV + i, j] += (
                v[n] * P[PHI + m, j] - v[m] * P[PHI + n, j]
                + c0 * P[NABLA, j] + c1 * P[NABLA + 1, j] + c2 * P[NABLA + 2, j]
            )  # fmt: skip
    for i in range(3):
        c0, c1, c2 = dt * C[i, 0], dt * C[i, 1], dt * C[i, 2]
        for j in range(STATES):
            P[PHI + i, j] -= c0 * P[EPS, j] + c1 * P[EPS + 1, j] + c2 * P[EPS + 2, j]
        m0, m1, m2 = lane.M[i, 0], lane.M[i, 1], lane.M[i, 2]
        m3, m4, m5 = lane.M[i, 3], lane.M[i, 4], lane.M[i, 5]
        for j in range(STATES):
            P[VR + i, j] += (
                m0 * P[THETA, j] + m1 * P[THETA + 1, j] + m2 * P[THETA + 2, j]
                + m3 * P[RATE, j] + m4 * P[RATE + 1, j] + m5 * P[RATE + 2, j]
            )  # fmt: skip
    for a in range(3):
        f00, f01 = model.transition[a, 0, 0], model.transition[a, 0, 1]
        f10, f11 = model.transition[a, 1, 0], model.transition[a, 1, 1]
        for j in range(STATES):
            p, r = P[THETA + a, j], P[RATE + a, j]
            P[THETA + a, j] = f00 * p + f01 * r
            P[RATE + a, j] = f10 * p + f11 * r


@part
def transpose(lane):
    """P ← Pᵀ."""
    for i in range(STATES):
        for j in range(i):
            p = lane.P[i, j]
            lane.P[i, j] = lane.P[j, i]
            lane.P[j, i] = p


@part
def add_noise(lane, model, tape, rule, impulse):
    """P ← P + Q; Q with the cross block of V_r and θ̇, since w_f drives both (eq. 77)."""
    P, B, scale = lane.P, lane.B, lane.row[PROCESS]
    gap = tape.gap * model.interval
    for i in range(3):
        P[PHI + i, PHI + i] += model.gyro + (gap * GAP_RATE) ** 2
        P[DV + i, DV + i] += model.accelerometer + (gap * GAP_FORCE) ** 2
    for a in range(3):
        q00, q01 = scale * model.noise[a, 0, 0], scale * model.noise[a, 0, 1]
        q11 = scale * model.noise[a, 1, 1] + impulse[a]
        P[THETA + a, THETA + a] += q00
        P[THETA + a, RATE + a] += q01
        P[RATE + a, THETA + a] += q01
        P[RATE + a, RATE + a] += q11
        for i in range(3):
            left, right = B[i, a] * q00 + B[i, 3 + a] * q01, B[i, a] * q01 + B[i, 3 + a] * q11
            if not rule.no_cross:
                P[VR + i, THETA + a] += left
                P[THETA + a, VR + i] += left
                P[VR + i, RATE + a] += right
                P[RATE + a, VR + i] += right
            for j in range(3):
                P[VR + i, VR + j] += left * B[j, a] + right * B[j, 3 + a]


@part
def linearize(lane, tape):
    """Innovation z − h(x⁻) and the nonzero elements of H there (eq. 78 and its Jacobian)."""
    x, C, D = lane.x, lane.C_s, lane.C_m
    V, w = tape.V_s, tape.w_s
    for i in range(3):
        n, m = (i + 1) % 3, (i + 2) % 3
        lane.column[i] = w[n] * x[PHI + m] - w[m] * x[PHI + n]
        lane.column[3 + i] = 0.0
        for j in range(3):
            lane.column[i] += C[i, j] * x[EPS + j]
            lane.column[3 + i] += D[i, j] * x[RATE + j]
    for i in range(3):
        n, m = (i + 1) % 3, (i + 2) % 3
        ln, lm = x[L + n], x[L + m]
        # velocity: a = V_s + V_m, d = δV, r = V_r
        dn, dm, rn, rm = x[DV + n], x[DV + m], x[VR + n], x[VR + m]
        an, am = V[n] + tape.V_m[n], V[m] + tape.V_m[m]
        h = an * lm - am * ln + x[DV + i] + ln * dm - lm * dn + x[VR + i] - ln * rm + lm * rn
        lane.innovation[i] = V[i] - tape.V_m[i] - h
        lane.Hv[i, i] = 0.0
        lane.Hv[i, n] = -(am - dm + rm)
        lane.Hv[i, m] = an - dn + rn
        # rate: a = ω_s + ω_m, d = ω_s × φ + C_s ε, r = C_m θ̇
        dn, dm, rn, rm = lane.column[n], lane.column[m], lane.column[3 + n], lane.column[3 + m]
        an, am = w[n] + tape.w_m[n], w[m] + tape.w_m[m]
        h = an * lm - am * ln + lane.column[i] + ln * dm - lm * dn
        h += lane.column[3 + i] - ln * rm + lm * rn
        lane.innovation[3 + i] = w[i] - tape.w_m[i] - h
        lane.Hw[i, i] = 0.0
        lane.Hw[i, n] = -(am - dm + rm)
        lane.Hw[i, m] = an - dn + rn
        # (I + l×) over δV, φ, ε and (I − l×) over V_r, θ̇
        lane.Hv[i, 3 + i], lane.Hv[i, 6 + i] = 1.0, 1.0
        lane.Hv[i, 3 + n], lane.Hv[i, 6 + n] = -lm, lm
        lane.Hv[i, 3 + m], lane.Hv[i, 6 + m] = ln, -ln
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
            lane.Hw[i, 3 + j] = s + ln * sm - lm * sn
            lane.Hw[i, 6 + j] = C[i, j] + ln * C[m, j] - lm * C[n, j]
            lane.Hw[i, 9 + j] = D[i, j] - ln * D[m, j] + lm * D[n, j]


@part
def project(lane, c):
    """column = P H_cᵀ for measurement c, and H_c P H_cᵀ, which is returned."""
    P, total = lane.P, 0.0
    for i in range(STATES):
        lane.column[i] = 0.0
    if c < 3:
        for a in range(9):
            h, j = lane.Hv[c, a], V_STATES[a]
            for i in range(STATES):
                lane.column[i] += h * P[j, i]
        for a in range(9):
            total += lane.Hv[c, a] * lane.column[V_STATES[a]]
    else:
        for a in range(12):
            h, j = lane.Hw[c - 3, a], W_STATES[a]
            for i in range(STATES):
                lane.column[i] += h * P[j, i]
        for a in range(12):
            total += lane.Hw[c - 3, a] * lane.column[W_STATES[a]]
    return total


@part
def spread(lane, c):
    """H_c P H_cᵀ from the few states that the measurement touches."""
    total = 0.0
    if c < 3:
        for a in range(9):
            s = 0.0
            for b in range(9):
                s += lane.Hv[c, b] * lane.P[V_STATES[a], V_STATES[b]]
            total += lane.Hv[c, a] * s
    else:
        for a in range(12):
            s = 0.0
            for b in range(12):
                s += lane.Hw[c - 3, b] * lane.P[W_STATES[a], W_STATES[b]]
            total += lane.Hw[c - 3, a] * s
    return total


@part
def shift(lane, c):
    """H_c (x − x⁻): by how much the updates so far have moved the prediction of measurement c."""
    total = 0.0
    if c < 3:
        for a in range(9):
            j = V_STATES[a]
            total += lane.Hv[c, a] * (lane.x[j] - lane.x_prior[j])
    else:
        for a in range(12):
            j = W_STATES[a]
            total += lane.Hw[c - 3, a] * (lane.x[j] - lane.x_prior[j])
    return total


@part
def predict_error(lane, model):
    """Model error D̂ on the flexure's acceleration (eq. 40, corrected), added to x⁻ (eq. 41).

    D̂ = {[ΛS]ᵀ R⁻¹ [ΛS] + A}⁻¹ [ΛS]ᵀ R⁻¹ (z − h(x⁻)), A = weight · diag(dt/q). The same
    datum is used again by the update, as in the paper; SCIENCE B1 says why that hurts.
    """
    G, N = np.zeros((6, 3)), np.zeros((3, 4))
    for a in range(3):
        g0, g1 = model.gain[a, 0], model.gain[a, 1]
        for c in range(3):
            for i in range(3):
                G[c, a] += lane.Hv[c, 6 + i] * (lane.B[i, a] * g0 + lane.B[i, 3 + a] * g1)
            G[3 + c, a] = lane.Hw[c, 9 + a] * g1
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
        lane.x[THETA + a] += g0 * D
        lane.x[RATE + a] += g1 * D
        for i in range(3):
            lane.x[VR + i] += (lane.B[i, a] * g0 + lane.B[i, 3 + a] * g1) * D


@part
def weigh(lane, rule, iteration):
    """Weights of the measurements by the correntropy criterion (eq. 45, 53).

    Judged by S = H P Hᵀ + R, or by R alone as printed, where a predictable innovation is rejected
    as soon as H P Hᵀ ≫ R. Beyond the first iteration the residual stands for the innovation.
    """
    width = lane.row[WIDTH]
    for c in range(MEASUREMENTS):
        lane.weight[c] = 1.0
        if width < WIDTH_OFF and lane.used[c]:
            e = lane.innovation[c]
            if iteration > 0:
                e -= shift(lane, c)
            scale = lane.R[c] if rule.by_noise else lane.variance[c]
            lane.weight[c] = max(math.exp(-0.5 * e * e / (width * width * scale)), FLOOR)


@part
def correct(lane, rule):
    """x and P by the six measurements in turn, each with R/C (eq. 50-52, corrected)."""
    for c in range(MEASUREMENTS):
        if not lane.used[c]:
            continue
        R = lane.R[c] / lane.weight[c]
        S = project(lane, c) + R
        if not S > 0.0:
            lane.diverged = NUMERICAL
            S = math.nan
        e = (lane.innovation[c] - shift(lane, c)) / S
        root = 1.0 / math.sqrt(S)
        if rule.printed_covariance:  # Pzz = H P Hᵀ C + R there: too little by the factor C
            root *= math.sqrt(lane.weight[c])
        for i in range(STATES):
            lane.x[i] += lane.column[i] * e
        for i in range(STATES):
            lane.column[i] *= root
        for i in range(STATES):
            a = lane.column[i]
            for j in range(STATES):
                lane.P[i, j] -= a * lane.column[j]


@part
def judge(lane):
    """NIS and log-likelihood of the innovation under S = H P⁻ Hᵀ + R, unweighted."""
    S, count, log_det, nis = lane.S, 0, 0.0, 0.0
    for c in range(MEASUREMENTS):
        project(lane, c)
        for i in range(STATES):
            lane.PH[c, i] = lane.column[i]
        for d in range(c + 1):
            s = 0.0
            if d < 3:
                for a in range(9):
                    s += lane.Hv[d, a] * lane.PH[c, V_STATES[a]]
            else:
                for a in range(12):
                    s += lane.Hw[d - 3, a] * lane.PH[c, W_STATES[a]]
            S[c, d] = s
        S[c, c] += lane.R[c]
    for c in range(MEASUREMENTS):  # Cholesky factor in place, innovation whitened on the way
        if not lane.used[c]:
            for d in range(c):
                S[c, d] = 0.0
            S[c, c] = 1.0
        for d in range(c + 1):
            s = S[c, d]
            if not lane.used[d] and d < c:
                s = 0.0
            for a in range(d):
                s -= S[c, a] * S[d, a]
            S[c, d] = math.sqrt(s) if d == c else s / S[d, d]
        z = lane.innovation[c] if lane.used[c] else 0.0
        for d in range(c):
            z -= S[c, d] * lane.column[d]
        lane.column[c] = z / S[c, c]
        if lane.used[c]:
            count += 1
            nis += lane.column[c] ** 2
            log_det += 2.0 * math.log(S[c, c])
    lane.nis = nis if count > 0 else math.nan
    lane.log_likelihood = -0.5 * (nis + log_det + count * LOG_2PI) if count > 0 else math.nan


@part
def settle(lane):
    """Flag a lane that failed or ran away; a failed one answers NaN from then on."""
    total, power, count = 0.0, 0.0, 0
    for i in range(STATES):
        total += lane.x[i] + lane.P[i, i]
        if not lane.P[i, i] >= 0.0:
            total = math.nan
    for c in range(MEASUREMENTS):
        if lane.used[c]:
            power += min(lane.innovation[c] ** 2 / lane.variance[c], 10.0 * RUNAWAY_POWER)
            count += 1
    if count > 0:
        lane.power = POWER_MEMORY * lane.power + (1.0 - POWER_MEMORY) * power / count
    if not math.isfinite(total):
        lane.diverged = NUMERICAL
    if lane.power >= RUNAWAY_POWER and lane.diverged == 0:
        lane.diverged = RUNAWAY
    if lane.diverged == NUMERICAL:
        for i in range(STATES):
            lane.x[i] = math.nan
            for j in range(STATES):
                lane.P[i, j] = math.nan


@part
def step(lane, model, tape, rule, impulse, disturbance):
    """One filter step on a tape's record; the truth of the oracle adds to Q and R."""
    matrix(tape.q_mid, lane.C_s)
    lever_step(lane, model, tape)
    move_state(lane, model, tape)
    move_rows(lane, model, tape)
    transpose(lane)
    move_rows(lane, model, tape)
    add_noise(lane, model, tape, rule, impulse)
    linearize(lane, tape)
    scale = lane.row[PROCESS]
    for i in range(3):
        lane.R[i] = lane.row[VELOCITY] ** 2 + disturbance[i]
        # a mean rate over the step measures the rate at its end: the difference has variance q dt/3
        lane.R[3 + i] = model.rate + scale * model.density[i] * model.dt / 3.0 + disturbance[3 + i]
        lane.used[i] = 1
        lane.used[3 + i] = 1 if tape.gap == 0 else 0
    if rule.judged:
        judge(lane)
    for i in range(3):
        lane.model_error[i] = 0.0
    if lane.row[WEIGHT] < WEIGHT_OFF:
        predict_error(lane, model)
        linearize(lane, tape)
    for c in range(MEASUREMENTS):
        lane.variance[c] = spread(lane, c) + lane.R[c]
    for i in range(STATES):
        lane.x_prior[i] = lane.x[i]
    if rule.iterations > 1:
        for i in range(STATES):
            for j in range(STATES):
                lane.P_prior[i, j] = lane.P[i, j]
    weigh(lane, rule, 0)
    correct(lane, rule)
    for iteration in range(1, rule.iterations):
        weigh(lane, rule, iteration)
        for i in range(STATES):
            lane.x[i] = lane.x_prior[i]
            for j in range(STATES):
                lane.P[i, j] = lane.P_prior[i, j]
        correct(lane, rule)
    settle(lane)
    lane.k += 1


@kernel
def run(
    lanes, models, tapes, rules, table, interval, impulse, disturbance, outputs, wide, covariances
):
    """Filter each lane to its `length` or its tape's end.

    Args:
        lanes: (N,) as `begin` or an earlier run left them.
        models: (N, M) MODEL records.
        tapes: (N, K).
        rules: (1,) RULE.
        table: (N or 1, intervals, 4) parameters; row k // interval holds in step k, the last to the end.
        interval: steps per row of `table`.
        impulse: (N, K, 3) variance to add to θ̇, or (N, 0, 3).
        disturbance: (N, K, 6) variance to add to R, or (N, 0, 6).
        outputs: (N, K, 24) states.
        wide: (N, K or 0, 23): innovations, weights, model error, NIS, log-likelihood, S diagonal.
        covariances: (N, K or 0, 24, 24).
    """
    rule = rules[0]
    no_impulse, no_disturbance = np.zeros(3), np.zeros(6)
    for i in range(len(lanes)):
        lane = lanes[i]
        for k in range(lane.k, min(lane.length, tapes.shape[1])):
            row = min(k // interval, table.shape[1] - 1)
            for p in range(table.shape[2]):
                lane.row[p] = table[min(i, table.shape[0] - 1), row, p]
            tape = tapes[i, k]
            jump = impulse[i, k] if impulse.shape[1] > 0 else no_impulse
            extra = disturbance[i, k] if disturbance.shape[1] > 0 else no_disturbance
            step(lane, models[i, tape.model], tape, rule, jump, extra)
            for a in range(STATES):
                outputs[i, k, a] = lane.x[a]
            if wide.shape[1] > 0:
                for a in range(MEASUREMENTS):
                    wide[i, k, a] = lane.innovation[a] if lane.used[a] else math.nan
                    wide[i, k, 6 + a] = lane.weight[a]
                    wide[i, k, 17 + a] = lane.variance[a]
                for a in range(3):
                    wide[i, k, 12 + a] = lane.model_error[a]
                wide[i, k, 15] = lane.nis
                wide[i, k, 16] = lane.log_likelihood
            if covariances.shape[1] > 0:
                for a in range(STATES):
                    for b in range(STATES):
                        covariances[i, k, a, b] = lane.P[a, b]
