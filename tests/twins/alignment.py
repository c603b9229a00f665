"""The 24-state deck filter, dense and from the equations: IDAM eq. 34-78, corrected.

Errata: docs/science/idam.md#errata.

Letters: C turns from the sub's axes into `is`, D from the main's into `im`; L0 θ = θ × r0;
V_r = B (θ, θ̇) less its value at the start, B = D [(ω×) L0, L0] (eq. 70 without derivatives of ω).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

l_, DV, PHI, EPS, NABLA, V_R, THETA, RATE = (slice(i, i + 3) for i in range(0, 24, 3))
GAP_RATE, GAP_FORCE = 2e-3, 0.3  # errors of filled samples, rad/s and m/s²


@dataclass(frozen=True)
class Rules:
    """Settings of the filter; those of the plain extended Kalman filter by default."""

    width: float = np.inf
    velocity_noise: float = 0.2
    weight: float = np.inf
    process: float = 1.0
    iterations: int = 1
    by_noise: bool = False
    cross: bool = True
    floor: float = 1e-12
    own_channels: bool = False


def cross(v):
    """v×, a matrix."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def attitude(q):
    """Rotation matrix of a quaternion, scalar first."""
    return Rotation.from_quat(np.array(q), scalar_first=True).as_matrix()


def flexure_step(flexure, dt):
    """Φ, Γ and Qd of (θ, θ̇) (6, 6), (6, 3), (6, 6) by van Loan's matrix exponential."""
    A, W = np.zeros((6, 6)), np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3:, :3], A[3:, 3:] = -np.diag(flexure.stiffness), -np.diag(flexure.damping)
    W[3:, 3:] = np.diag(2.0 * flexure.damping * flexure.stiffness * flexure.sigma**2)
    big = expm(np.block([[-A, W], [np.zeros((6, 6)), A.T]]) * dt)
    transition = big[6:, 6:].T
    noise = transition @ big[:6, 6:]
    gain = np.linalg.solve(A, transition - np.eye(6))[:, 3:]
    return transition, gain, (noise + noise.T) / 2.0


def lever_part(D, omega, L0):
    """B of V_r = B (θ, θ̇) − const."""
    return D @ np.hstack([cross(omega) @ L0, L0])


def predicted(x, tape):
    """h(x): velocity and rate differences (eq. 78)."""
    C, D, lx = attitude(tape["q_mid"]), attitude(tape["q_m"]), cross(x[l_])
    up, down = np.eye(3) + lx, np.eye(3) - lx
    V, w = tape["V_s"] + tape["V_m"], tape["w_s"] + tape["w_m"]
    drift = cross(tape["w_s"]) @ x[PHI] + C @ x[EPS]
    return np.concatenate(
        [
            np.cross(V, x[l_]) + up @ x[DV] + down @ x[V_R],
            np.cross(w, x[l_]) + up @ drift + down @ D @ x[RATE],
        ]
    )


def jacobian(x, tape):
    """∂h/∂x (6, 24)."""
    C, D, lx = attitude(tape["q_mid"]), attitude(tape["q_m"]), cross(x[l_])
    up, down = np.eye(3) + lx, np.eye(3) - lx
    V, w = tape["V_s"] + tape["V_m"], tape["w_s"] + tape["w_m"]
    drift = cross(tape["w_s"]) @ x[PHI] + C @ x[EPS]
    H = np.zeros((6, 24))
    H[:3, l_] = cross(V - x[DV] + x[V_R])
    H[:3, DV], H[:3, V_R] = up, down
    H[3:, l_] = cross(w - drift + D @ x[RATE])
    H[3:, PHI], H[3:, EPS], H[3:, RATE] = up @ cross(tape["w_s"]), up @ C, down @ D
    return H


def own(x, tape):
    """V_s and ω_s as the state foretells them, nothing measured of them used."""
    A = np.linalg.solve(np.eye(3) + cross(x[l_]), np.eye(3) - cross(x[l_]))
    V = x[DV] + A @ (tape["V_m"] + x[V_R])
    w = A @ (tape["w_m"] + attitude(tape["q_m"]) @ x[RATE]) + attitude(tape["q_mid"]) @ x[EPS]
    return np.concatenate([V, w + np.cross(w, x[PHI])])


def looked(x, P, tape, rules):
    """Innovation and H (6, 24) at x; by the sub's own channels with H by central differences."""
    if not (rules.own_channels and np.trace(P[l_, l_]) < 4e-6):
        z = np.concatenate([tape["V_s"] - tape["V_m"], tape["w_s"] - tape["w_m"]])
        return z - predicted(x, tape), jacobian(x, tape)
    H = [slope(lambda d, e=e: own(x + d * e, tape)) for e in np.eye(24)]
    return np.concatenate([tape["V_s"], tape["w_s"]]) - own(x, tape), np.array(H).T


def slope(f, h=1e-3):
    """f'(0) by five points: to h⁴."""
    return (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)


def transition(tape, dt, flexing, before, after):
    """F (24, 24); V_r moves on by B Φ (θ, θ̇) − B_before (θ, θ̇)."""
    F, C = np.eye(24), attitude(tape["q_mid"])
    F[DV, PHI], F[DV, NABLA] = cross(tape["dV"]), dt * C
    F[PHI, EPS] = -dt * C
    F[V_R, 18:] = after @ flexing - before
    F[18:, 18:] = flexing
    return F


def process_noise(model, tape, dt, rules, noise, B):
    """Q (24, 24): the flexure's noise drives θ, θ̇ and V_r together (eq. 77, corrected)."""
    Q, gap = np.zeros((24, 24)), tape["gap"] * dt / model.samples_per_step
    Q[PHI, PHI] = (model.gyro_noise**2 * dt + (gap * GAP_RATE) ** 2) * np.eye(3)
    Q[DV, DV] = (model.accelerometer_noise**2 * dt + (gap * GAP_FORCE) ** 2) * np.eye(3)
    driven = rules.process * noise
    G = np.zeros((24, 6))
    G[V_R], G[18:] = B, np.eye(6)
    if rules.cross:
        return Q + G @ driven @ G.T
    Q[V_R, V_R], Q[18:, 18:] = B @ driven @ B.T, driven
    return Q


def weights(residual, scale, rules):
    """Correntropy weights (eq. 45, 53); 1 where the criterion is off."""
    if rules.width == np.inf:
        return np.ones(len(residual))
    return np.maximum(np.exp(-(residual**2) / (2.0 * rules.width**2 * scale)), rules.floor)


def update(x, P, innovation, H, R, rules):
    """Robust update: K = P Hᵀ (H P Hᵀ + R C⁻¹)⁻¹ in Joseph form, iterated to a fixed point."""
    scale = R if rules.by_noise else np.diag(H @ P @ H.T) + R
    moved = x
    for _ in range(rules.iterations):
        C = weights(innovation - H @ (moved - x), scale, rules)
        R_C = np.diag(R / C)
        K = np.linalg.solve(H @ P @ H.T + R_C, H @ P).T
        moved = x + K @ innovation
    I_KH = np.eye(24) - K @ H
    P = I_KH @ P @ I_KH.T + K @ R_C @ K.T
    return moved, (P + P.T) / 2.0, C


def alignment(recording, tape, rules, flexures=None):
    """Run the filter over a tape (K,): states, covariances, innovations, weights, NIS and so on.

    Args:
        recording: what carries the believed model.
        tape: its matching quantities.
        rules: one `Rules`, or one per step.
        flexures: flexure model of each step; the believed one by default.
    """
    model, dt, steps = recording.model, recording.step, len(tape)
    flexures = [model.flexure] * steps if flexures is None else flexures
    rules = [rules] * steps if isinstance(rules, Rules) else rules
    L0 = -cross(model.lever_arm)
    a = recording.main_angle[:3]
    omega = (11.0 * a[0] - 7.0 * a[1] + 2.0 * a[2]) / (6.0 * recording.interval)
    B = lever_part(np.eye(3), omega, L0)
    x, P = np.zeros(24), np.diag(first_deviations(model, flexures[0]) ** 2)
    log = {name: [] for name in NAMES}
    known = {f: flexure_step(f, dt) for f in set(flexures)}
    for k, (now, rule) in enumerate(zip(tape, rules, strict=True)):
        flexing, gain, noise = known[flexures[k]]
        before, B = B, lever_part(attitude(now["q_m"]), now["omega"], L0)
        F = transition(now, dt, flexing, before, B)
        x, P = F @ x, F @ P @ F.T + process_noise(model, now, dt, rule, noise, B)
        density = 2.0 * flexures[k].damping * flexures[k].stiffness * flexures[k].sigma ** 2
        R = np.repeat([rule.velocity_noise**2, model.rate_noise**2], 3)
        R[3:] += rule.process * density * dt / 3.0
        used = np.repeat([True, now["gap"] == 0], 3)
        nu, H, R = (each[used] for each in (*looked(x, P, now, rule), R))
        S = H @ P @ H.T + np.diag(R)
        log["nis"].append(nu @ np.linalg.solve(S, nu))
        log["log_likelihood"].append(-0.5 * (log["nis"][-1] + np.linalg.slogdet(2 * np.pi * S)[1]))
        D = np.zeros(3)
        if rule.weight < np.inf:
            Gamma = np.zeros((24, 3))
            Gamma[V_R], Gamma[18:] = B @ gain, gain
            HG = H @ Gamma
            normal = HG.T @ np.diag(1.0 / R) @ HG + rule.weight * np.diag(dt / density)
            D = np.linalg.solve(normal, HG.T @ (nu / R))
            x = x + Gamma @ D
            nu, H = (each[used] for each in looked(x, P, now, rule))
        log["innovation_variance"].append(np.diag(H @ P @ H.T) + R)
        x, P, C = update(x, P, nu, H, R, rule)
        for name, value in zip(NAMES, (x, P, nu, C, D), strict=False):
            log[name].append(value)
    return log


NAMES = (
    "states", "covariances", "innovations", "weights", "model_error", "nis", "log_likelihood",
    "innovation_variance",
)  # fmt: skip


def first_deviations(model, flexure):
    """Standard deviations of the states at the start: docs/science/idam.md#start-and-noise."""
    each = [
        model.misalignment, 1e-6, 1e-8, model.gyro_bias, model.accelerometer_bias, 1e-6,
    ]  # fmt: skip
    rate = np.sqrt(flexure.stiffness) * flexure.sigma
    return np.concatenate([np.repeat(each, 3), flexure.sigma, rate])
