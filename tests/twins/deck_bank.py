"""The deck's bank, dense and from the equations: joint model of the mean rate, IMM of four modes.

Unlike the kernel it writes F, H, Q and the Markov chain as matrices, updates by whole blocks, takes
mixtures branch by branch, and gets the Jacobian of the sub's own channels by differences.
"""

from dataclasses import dataclass

import numpy as np

from tests.twins import alignment as plain
from tests.twins.alignment import DV, EPS, PHI, RATE, THETA, V_R, attitude, cross, l_

LEVER, LAGGED, LAGGED2, MEAN = (slice(i, i + 3) for i in range(24, 36, 3))
N = 36
LEFT = (1.0, 0.8, 0.6, 0.4, 0.2)


@dataclass(frozen=True)
class Beliefs:
    """Parameters of the bank, by their names."""

    velocity_noise: float = 0.2
    process: float = 1.0
    mode_stay: float = 0.99
    slam_rate: float = 0.2
    slam_size: float = 4.0
    glitch_rate: float = 0.1
    glitch_velocity: float = 1.0
    glitch_rate_size: float = 2e-3
    own_channels: bool = True
    lever_sd: float = 0.0
    negligible: float = 1e-3


def driven(B, dt):
    """T (36, 6): how (θ, θ̇) that a step adds enter the states: V_r by B, m by θ/dt."""
    T = np.zeros((N, 6))
    T[18:24], T[V_R] = np.eye(6), B
    T[MEAN, :3] = np.eye(3) / dt
    return T


def transition(tape, dt, flexing, before, after, moved):
    """F (36, 36); `moved` (3, 3) is what a constant error of the lever arm adds to V_r."""
    F = np.zeros((N, N))
    F[:24, :24] = plain.transition(tape, dt, flexing, before, after)
    F[V_R, LEVER], F[LEVER, LEVER] = moved, np.eye(3)
    F[LAGGED, RATE], F[LAGGED2, LAGGED] = np.eye(3), np.eye(3)
    F[MEAN, THETA] = (flexing[:3, :3] - np.eye(3)) / dt
    F[MEAN, RATE] = flexing[:3, 3:] / dt
    return F


def middle(tape, dt):
    """C_m in the middle of the step, to second order in half a step's turn."""
    W = cross(0.5 * dt * tape["w_m"])
    return (np.eye(3) - W + W @ W / 2.0) @ attitude(tape["q_m"])


def expected(x, tape, dt):
    """h(x) of IDAM eq. 78 with the mean rate in θ̇'s place."""
    C, lx = attitude(tape["q_mid"]), cross(x[l_])
    up, down = np.eye(3) + lx, np.eye(3) - lx
    V, w = tape["V_s"] + tape["V_m"], tape["w_s"] + tape["w_m"]
    drift = cross(tape["w_s"]) @ x[PHI] + C @ x[EPS]
    return np.concatenate(
        [
            np.cross(V, x[l_]) + up @ x[DV] + down @ x[V_R],
            np.cross(w, x[l_]) + up @ drift + down @ middle(tape, dt) @ x[MEAN],
        ]
    )


def own(x, tape, dt):
    """V_s and ω_s as the state foretells them, nothing measured of them used."""
    A = np.linalg.solve(np.eye(3) + cross(x[l_]), np.eye(3) - cross(x[l_]))
    V = x[DV] + A @ (tape["V_m"] + x[V_R])
    w = A @ (tape["w_m"] + middle(tape, dt) @ x[MEAN]) + attitude(tape["q_mid"]) @ x[EPS]
    return np.concatenate([V, w + np.cross(w, x[PHI])])


def looked(x, P, tape, dt, beliefs):
    """Innovation and H (6, 36) at x; both functions are at most quadratic in small steps."""
    measured = np.concatenate([tape["V_s"], tape["w_s"]])
    if beliefs.own_channels and np.trace(P[l_, l_]) < 4e-6:
        nu, h, step = measured - own(x, tape, dt), own, 1e-4
    else:
        main = np.concatenate([tape["V_m"], tape["w_m"]])
        nu, h, step = measured - main - expected(x, tape, dt), expected, 0.1
    H = [(h(x + step * e, tape, dt) - h(x - step * e, tape, dt)) / (2 * step) for e in np.eye(N)]
    return nu, np.array(H).T


def update(x, P, nu, H, R):
    """Kalman update in Joseph form; returns also the log-likelihood and the NIS."""
    S = H @ P @ H.T + np.diag(R)
    K = np.linalg.solve(S, H @ P).T
    I_KH = np.eye(N) - K @ H
    nis = nu @ np.linalg.solve(S, nu)
    told = -0.5 * (nis + np.linalg.slogdet(2.0 * np.pi * S)[1])
    return x + K @ nu, I_KH @ P @ I_KH.T + K @ np.diag(R) @ K.T, told, nis


def collapsed(weights, means, covariances):
    """One Gaussian with a mixture's moments."""
    x = np.average(means, axis=0, weights=weights)
    spread = [P + np.outer(m - x, m - x) for m, P in zip(means, covariances, strict=True)]
    return x, np.average(spread, axis=0, weights=weights)


def glitches(x, P, nu, H, R, rate, spike):
    """Row by row, each right or wrong."""
    total, nis, start = 0.0, 0.0, x
    for e, h, r, s in zip(nu, H, R, spike, strict=True):
        row, moved = h[None], e - h @ (x - start)
        pair = [update(x, P, np.array([moved]), row, np.array([v])) for v in (r, r + s)]
        odds = np.log([1.0 - rate, rate]) + [p[2] for p in pair]
        if pair[1][3] > 100.0:  # beyond ten deviations even of what is wrong
            pair[1] = x, P
        told = np.logaddexp(*odds)
        nis += moved**2 / (h @ P @ h + r + rate * s)
        x, P = collapsed(np.exp(odds - told), [p[0] for p in pair], [p[1] for p in pair])
        total += told
    return x, P, total, nis


def slam(x, P, nu, H, R, T, dt, jump, rate, negligible):
    """No jump, or one that left a share of the step; `jump` (3,) its standard deviations."""
    chance = 1.0 - np.exp(-rate * dt)
    found, odds = [update(x, P, nu, H, R)], [np.log(1.0 - chance)]
    for f in LEFT:
        U = T @ np.vstack([f * dt * np.eye(3), np.eye(3)]) @ np.diag(jump)
        found.append(update(x, P + U @ U.T, nu, H, R))
        odds.append(np.log(chance / len(LEFT)))
    odds += np.array([f[2] for f in found])
    told = np.logaddexp.reduce(odds)
    w = np.exp(odds - told)
    w[w < negligible] = 0.0
    x, P = collapsed(w / w.sum(), [f[0] for f in found], [f[1] for f in found])
    return x, P, told, w @ [f[3] for f in found] / w.sum()


def bank(recording, tape, kinds, beliefs, flexures, impulse=None, left=None, disturbance=None):
    """Run the bank over a tape (K,).

    Args:
        recording: what carries the believed model.
        tape: its matching quantities.
        kinds: "plain", "slam" or "glitch" per mode.
        beliefs: parameters.
        flexures: (step, mode) to a flexure model.
        impulse: (K, 3) known variance of jumps, which left shares `left` (K,) of their steps.
        left: see there.
        disturbance: (K, 6) known variance that adds to R.
    """
    model, dt, J = recording.model, recording.step, len(kinds)
    L0, a = -cross(model.lever_arm), recording.main_angle[:3]
    omega = (11.0 * a[0] - 7.0 * a[1] + 2.0 * a[2]) / (6.0 * recording.interval)
    B, E = plain.lever_part(np.eye(3), omega, L0), cross(omega)
    modes = []
    for j in range(J):
        first = plain.first_deviations(model, flexures(0, j))
        sd = np.concatenate([first, np.repeat(beliefs.lever_sd, 3), np.zeros(9)])
        modes.append((np.zeros(N), np.diag(sd**2)))
    mu = np.full(J, 1.0 / J)
    stay = beliefs.mode_stay**dt if J > 1 else 1.0
    chain = np.full((J, J), (1.0 - stay) / max(J - 1, 1))
    np.fill_diagonal(chain, stay)
    spike = np.repeat([beliefs.glitch_velocity**2, beliefs.glitch_rate_size**2], 3)
    log = {name: [] for name in ("states", "covariances", "mode_weights", "nis", "log_likelihood")}
    for k, now in enumerate(tape):
        before, B = B, plain.lever_part(attitude(now["q_m"]), now["omega"], L0)
        E, moved = attitude(now["q_m"]) @ cross(now["omega"]), -E
        moved = moved + E
        forecast = chain.T @ mu
        old = list(modes)
        told, nis = np.zeros(J), np.zeros(J)
        for j in range(J):
            share = chain[:, j] * mu / forecast[j]
            x, P = collapsed(share, [m[0] for m in old], [m[1] for m in old])
            flexing, _, noise = plain.flexure_step(flexures(k, j), dt)
            F, T = transition(now, dt, flexing, before, B, moved), driven(B, dt)
            x, P = F @ x, F @ P @ F.T + beliefs.process * T @ noise @ T.T
            P[:24, :24] += sensors(model, now, dt)
            velocity = beliefs.velocity_noise**2
            if beliefs.lever_sd > 0.0:
                P[DV, DV] += 1e-6 * dt * np.eye(3)
                velocity += (0.2 * np.exp(-k * dt / 10.0)) ** 2
            if impulse is not None:
                U = T @ np.vstack([left[k] * dt * np.eye(3), np.eye(3)])
                P = P + U @ np.diag(impulse[k]) @ U.T
            R = np.repeat([velocity, model.rate_noise**2], 3)
            if disturbance is not None:
                R = R + disturbance[k]
            nu, H = looked(x, P, now, dt, beliefs)
            used = np.repeat([True, now["gap"] == 0], 3)
            given = x, P, nu[used], H[used], R[used]
            if kinds[j] == "slam":
                jump = beliefs.slam_size * flexures(k, j).rate_sigma
                found = slam(*given, T, dt, jump, beliefs.slam_rate, beliefs.negligible)
            elif kinds[j] == "glitch":
                found = glitches(*given, beliefs.glitch_rate, spike[used])
            else:
                found = update(*given)
            modes[j], told[j], nis[j] = found[:2], *found[2:]
        odds = np.log(forecast) + told
        total = np.logaddexp.reduce(odds)
        mu = np.exp(odds - total)
        x, P = collapsed(mu, [m[0] for m in modes], [m[1] for m in modes])
        for name, value in zip(log, (x, P, mu, forecast @ nis, total), strict=True):
            log[name].append(value)
    return {name: np.array(values) for name, values in log.items()}


def sensors(model, tape, dt):
    """Q (24, 24) of the sub IMU's own noise."""
    Q, gap = np.zeros((24, 24)), tape["gap"] * dt / model.samples_per_step
    Q[PHI, PHI] = (model.gyro_noise**2 * dt + (gap * plain.GAP_RATE) ** 2) * np.eye(3)
    Q[DV, DV] = (model.accelerometer_noise**2 * dt + (gap * plain.GAP_FORCE) ** 2) * np.eye(3)
    return Q
