"""The interacting-multiple-model filter of the textbooks, with a J x J transition matrix.

Blom & Bar-Shalom 1988: mix, predict, update, combine; a step leads from one received sample to the
next, by all the motion in between, and a row without a measurement is where a step from the last
received sample would lead. A mode whose velocity sensor has an error carries it as further states; in a
mode with outliers every kind of outlier is an update of its own, and all are collapsed to their moments.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from navgym.statespace.filters.modes import Modes, Structure
from tests.twins.gaussian import Log, at, judge

LOST_LEAK = 0.2
DEFAULT = (1.0, 1.0, 0.995, 0.985, 0.2)


@dataclass
class Mode:
    """One mode: scales of R by row, of Q, its regime, and whether it has outliers or a bias."""

    node: int
    regime: int
    rows: np.ndarray
    q: float
    motion: str
    outliers: bool


def listed(modes):
    return [
        Mode(
            a, b, modes.scales[a], modes.regimes[b].process * modes.process[a],
            modes.regimes[b].motion, modes.regimes[b].outliers,
        )
        for a, b in zip(modes.node, modes.regime, strict=True)
    ]  # fmt: skip


def chains(chosen, modes, scale_stay, regime_stay, age):
    """Transition matrices of the nodes and of the regimes over `age` seconds, and what stays."""
    A = len(modes.prior)
    spread = np.tile(modes.prior, (A, 1))
    for a in range(A):
        near = [
            other
            for other in (a - 1, a + 1)
            if 0 <= other < A and modes.process[a] == modes.process[other]
            and np.abs(np.log(modes.scales[a] / modes.scales[other])).max() <= 1.25
        ]  # fmt: skip
        if near:
            spread[a] *= 1.0 - chosen.near
            spread[a, near] += chosen.near / len(near)
    node_stay = scale_stay**age
    regime_stays = np.array(
        [max(1.0 - r.leak * (1.0 - regime_stay), 0.0) ** age for r in modes.regimes]
    )
    prior = np.array([r.prior for r in modes.regimes])
    nodes = node_stay * np.eye(A) + (1.0 - node_stay) * spread
    regimes = np.diag(regime_stays) + np.outer(1.0 - regime_stays, prior / prior.sum())
    assert np.allclose(nodes.sum(1), 1.0)
    assert np.allclose(regimes.sum(1), 1.0)
    return nodes, regimes, node_stay * regime_stays


def transition(chosen, modes, scale_stay, regime_stay, age=1.0):
    """P(mode j now | mode i before), and of each mode the chance that neither chain has leaked."""
    nodes, regimes, stays = chains(chosen, modes, scale_stay, regime_stay, age)
    T = nodes[np.ix_(modes.node, modes.node)] * regimes[np.ix_(modes.regime, modes.regime)]
    total = T.sum(1)
    return T / total[:, None], stays[modes.regime] / total


def aged(seconds):
    """Time by which the chains move: once a second has passed without a sample, a fifth of it."""
    return min(seconds, 1.0) + LOST_LEAK * max(seconds - 1.0, 0.0)


class World:
    """One axis of a model at a sample, as a mode sees it: its states, then velocity sensors' errors."""

    def __init__(self, chosen, structure, model, k, axes, F, Q, dt):
        self.n, self.s = model.n // axes, model.m // axes
        pairs = len(structure.velocity) // axes
        self.velocity = list(structure.velocity[:pairs])
        self.position = list(structure.position[:pairs])
        self.F, self.Q = F[: self.n, : self.n], Q[: self.n, : self.n]
        self.H, self.R = at(model.H, k)[: self.s, : self.n], at(model.R, k)[: self.s, : self.s]
        self.fade = math.exp(-dt / chosen.memory)
        self.T = np.eye(self.n)
        self.T[self.position, self.velocity] = chosen.lag
        rows = [i for i in range(self.s) if structure.velocities[i]]
        h = self.H[np.ix_(rows, self.velocity)]
        if self.velocity:
            self.B = np.linalg.inv(h.T @ np.linalg.inv(self.R[np.ix_(rows, rows)]) @ h)

    def size(self, mode):
        return self.n + (len(self.velocity) if mode.motion == "bias" else 0)

    def moved(self, mode, mean, C):
        """Mean (size, axes) and covariance after the motion."""
        Q = mode.q * (self.T @ self.Q @ self.T.T if mode.motion == "late" else self.Q)
        F = self.F
        if mode.motion == "bias":
            F, Q = block(F, self.fade * np.eye(len(self.B))), block(Q, (1 - self.fade**2) * self.B)
        return F @ mean, F @ C @ F.T + Q

    def seen(self, mode):
        """What the rows measure."""
        H = self.H
        return np.hstack([H, H[:, self.velocity]]) if mode.motion == "bias" else H


def block(a, b):
    n = len(a)
    whole = np.zeros((n + len(b), n + len(b)))
    whole[:n, :n], whole[n:, n:] = a, b
    return whole


def bank(model, time, y, lost, chosen, structure, parameters=DEFAULT, axes=1):
    """The bank; with axes = 2 each mode keeps one covariance for both halves of the state.

    A mode is a list of means, one per axis, and one covariance C of a single axis. Where textbooks
    add a spread d dᵀ to C, two axes add the mean of their two. `S` is the covariance that it foretells
    of a sample. From the first sample that the axes do
    not lose alike, the state is one.
    """
    q, r, scale_stay, regime_stay, rate = parameters
    modes = Modes.of(chosen, structure)
    table = listed(modes)
    n = model.n // axes
    start = World(chosen, structure, model, 0, axes, np.eye(model.n), np.eye(model.n), 0.0)
    means = [np.zeros((start.size(mode), axes)) for mode in table]
    Cs = []
    for mode, mean in zip(table, means, strict=True):
        mean[:n] = model.x0.reshape(axes, n).T
        P0 = model.P0[:n, :n]
        Cs.append(block(P0, start.B) if mode.motion == "bias" else P0)
    weight = modes.prior[modes.node] * modes.shares[modes.regime]
    weight = weight / weight.sum()
    log, weights, foreseen = Log(), [], []
    before, since = (weight, means, Cs), time[0] - 1.0
    F, Q = np.eye(model.n), np.zeros((model.n, model.n))  # of the motion since then
    for k, t in enumerate(time):
        R, got = at(model.R, k), ~lost[k]
        if axes == 2 and (got[: model.m // 2] != got[model.m // 2 :]).any():
            weight, means, Cs = before
            before = weight, [joined(m, n) for m in means], [doubled(C, n) for C in Cs]
            axes, n = 1, model.n
        F, Q = at(model.F, k) @ F, at(model.F, k) @ Q @ at(model.F, k).T + q * at(model.Q, k)
        here = World(chosen, structure, model, k, axes, F, Q, t - since)
        s = here.s
        x, P = combined(*before, n)
        T, stay = transition(chosen, modes, scale_stay, regime_stay, aged(t - since))
        weight, means, Cs = mixed(T, stay, *before, table, here)
        moved = [here.moved(*each) for each in zip(table, means, Cs, strict=True)]
        means, Cs = [m for m, _ in moved], [C for _, C in moved]

        wide = np.zeros((model.m, model.m))
        P_prior = F @ P @ F.T
        for w, mode, C in zip(weight, table, Cs, strict=True):
            root = np.sqrt(np.tile(mode.rows[:s], axes))
            grown = 1.0
            own = np.outer(root, root)
            if mode.outliers:
                grown = 1.0 - rate
                factors = [np.sqrt(kind(chosen, structure, b)) for b in range(len(chosen.outliers))]
                more = zip(chosen.outliers, factors, strict=True)
                grown = grown + rate * sum(o[0] * np.outer(f, f) for o, f in more)
            wide += w * r * R * own * grown
            motion = World.moved(here, mode, np.zeros((len(C), axes)), 0 * C)[1][:n, :n]
            P_prior = P_prior + w * np.kron(np.eye(axes), motion)
            if mode.motion == "bias":
                Hb = here.H[:, here.velocity]
                wide += w * np.kron(np.eye(axes), Hb @ C[n:, n:] @ Hb.T)
        foreseen.append(at(model.H, k) @ P_prior @ at(model.H, k).T + wide)
        innovation, nis, likelihood = judge(F @ x, P_prior, y[k], at(model.H, k), wide, got)

        if got.any():
            evidence = np.empty(len(table))
            for j, mode in enumerate(table):
                odds = [(1.0, np.ones(model.m))]
                if mode.outliers and rate > 0:
                    odds = [(1.0 - rate, np.ones(model.m))]
                    for b, outlier in enumerate(chosen.outliers):
                        odds.append((rate * outlier[0], kind(chosen, structure, b)))
                found = []
                for _, factor in odds:
                    root = np.sqrt(mode.rows[:s] * factor[:s])
                    noise = r * here.R * np.outer(root, root)
                    found.append(axis_update(
                        means[j], Cs[j], y[k].reshape(axes, s), here.seen(mode), got[:s], noise
                    ))  # fmt: skip
                shares = np.array([math.log(o[0]) + f[2] for o, f in zip(odds, found, strict=True)])
                evidence[j] = logsumexp(shares)
                shares = np.exp(shares - evidence[j])
                means[j] = sum(p * f[0] for p, f in zip(shares, found, strict=True))
                Cs[j] = sum(
                    p * (f[1] + spread(f[0] - means[j])) for p, f in zip(shares, found, strict=True)
                )
            likelihood = logsumexp(np.log(weight) + evidence)
            weight = np.exp(np.log(weight) + evidence - likelihood)
            before, since = (weight, means, Cs), t
            F, Q = np.eye(model.n), np.zeros((model.n, model.n))
            log.add(*combined(weight, means, Cs, n), innovation, nis, likelihood)
        else:  # what modes exchange changes no moment of the mixture; axes keep their own spreads
            log.add(F @ x, P_prior, innovation, nis, likelihood)
        weights.append(weight)
    return log.arrays() | {"weights": np.stack(weights), "S": np.stack(foreseen)}


def kind(chosen, structure, b):
    """Factors on the rows' R of the b-th kind of outlier."""
    _, position, velocity = chosen.outliers[b]
    return np.where(structure.velocities, velocity, position)


def spread(d):
    """Mean over the axes of d dᵀ, for the offsets d (size, axes) of a mean."""
    return d @ d.T / d.shape[1]


def mixed(T, stay, weight, means, Cs, table, here):
    """Mixed initial conditions: μ_ij = P(mode i before | mode j now).

    A velocity sensor's error belongs to the stay in a mode: who comes in has drawn a new one.
    """
    n = here.n
    now = weight @ T
    mixed_means, mixed_Cs = [], []
    for j, mode in enumerate(table):
        parts = []
        for i in range(len(table)):
            mu = weight[i] * T[i, j] / now[j]
            if i == j and mode.motion == "bias":
                kept = weight[j] * stay[j] / now[j]
                parts.append((kept, means[j], Cs[j]))
                mu -= kept
            mean, C = means[i][:n], Cs[i][:n, :n]
            if mode.motion == "bias":
                mean = np.vstack([mean, np.zeros((len(here.B), mean.shape[1]))])
                C = block(C, here.B)
            parts.append((mu, mean, C))
        mean = sum(mu * m for mu, m, _ in parts)
        mixed_means.append(mean)
        mixed_Cs.append(sum(mu * (C + spread(m - mean)) for mu, m, C in parts))
    return now, mixed_means, mixed_Cs


def axis_update(mean, C, y, h, here, noise):
    """Update of each axis by its own measurements; the log-densities of the axes add up."""
    total, updated, posterior = 0.0, mean.copy(), C
    if here.any():
        h, noise = h[here], noise[np.ix_(here, here)]
        S = h @ C @ h.T + noise
        K = C @ h.T @ np.linalg.inv(S)
        rest = np.eye(len(C)) - K @ h
        posterior = rest @ C @ rest.T + K @ noise @ K.T
        for g in range(mean.shape[1]):
            v = y[g, here] - h @ mean[:, g]
            updated[:, g] = mean[:, g] + K @ v
            total -= 0.5 * (v @ np.linalg.solve(S, v) + np.linalg.slogdet(2 * math.pi * S)[1])
    return updated, posterior, total


def combined(weight, means, Cs, n):
    """Mean and covariance of the mixture over the whole state."""
    flat = np.array([mean[:n].T.ravel() for mean in means])
    x = weight @ flat
    axes = means[0].shape[1]
    P = np.kron(np.eye(axes), sum(w * C[:n, :n] for w, C in zip(weight, Cs, strict=True)))
    for w, mean in zip(weight, flat, strict=True):
        P = P + w * np.outer(mean - x, mean - x)
    return x, P


def joined(mean, n):
    """Means (size, 2) of two axes as those (2 size, 1) of one state: states, then errors."""
    return np.concatenate([mean[:n].T.ravel(), mean[n:].T.ravel()])[:, None]


def doubled(C, n):
    """The covariance of one axis as that of both."""
    order = np.argsort([g * 0.1 + (i >= n) for g in range(2) for i in range(len(C))], kind="stable")
    return np.kron(np.eye(2), C)[np.ix_(order, order)]


def structure_of(model):
    """What a bank knows of a model: see `Structure`."""
    from navgym.statespace.batch import StateSpaceBatch
    from navgym.statespace.recording import Recording

    steps = model.steps or 1
    rows = np.zeros((steps, model.m))
    recording = Recording(np.arange(1.0, steps + 1.0), rows, rows == 0, model=model)
    return Structure.of(StateSpaceBatch.of([recording]))
