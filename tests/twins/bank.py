"""The interacting-multiple-model filter of the textbooks, with a J x J transition matrix.

Blom & Bar-Shalom 1988: mix, predict, update, combine. Modes multiply Q and R; a mode with outliers
updates twice, under R and 100 R, and is collapsed to the moments of the two. Where the modes say how
their regimes lose samples, losing one or not is a likelihood like any other, and every row is a step.
Otherwise a step leads from one received sample to the next, by all the motion in between, and a row
without a measurement is where a step from the last received sample would lead.
"""

import math

import numpy as np
from scipy.special import logsumexp

from tests.twins.gaussian import Log, at, judge

OUTLIER_SCALE = 100.0
LOST_LEAK = 0.2
LOST_BEFORE = (1.0, 19.0)


def transition(modes, scale_stay, regime_stay):
    """P(mode j now | mode i before), modes in row-major order of (R scale, regime)."""
    A, B = modes.shape
    scale = scale_stay * np.eye(A) + (1 - scale_stay) * (1 - modes.near) / A
    for i in range(A):
        neighbours = [j for j in (i - 1, i + 1) if 0 <= j < A]
        for j in neighbours:
            scale[i, j] += (1 - scale_stay) * modes.near / len(neighbours)
    prior = np.array(modes.prior) / sum(modes.prior)
    regime = regime_stay * np.eye(B) + (1 - regime_stay) * np.tile(prior, (B, 1))
    return np.kron(scale, regime)


def listed(modes):
    """(R scale, Q scale, outliers, first weight) of each mode."""
    A, B = modes.shape
    prior = np.array(modes.prior) / sum(modes.prior)
    return [
        (modes.scales[a], modes.process[a][b], modes.outliers[b], prior[b] / A)
        for a in range(A)
        for b in range(B)
    ]


def aged(seconds):
    """Time by which the chains move: once a second has passed without a sample, a fifth of it."""
    return min(seconds, 1.0) + LOST_LEAK * max(seconds - 1.0, 0.0)


def bank(
    model, time, y, lost, modes, q=1.0, r=1.0, scale_stay=0.995, regime_stay=0.985, rate=0.2,
    axes=1,
):  # fmt: skip
    """The bank; with axes = 2 each mode keeps one covariance for both halves of the state.

    A mode is a list of means, one per axis, and one covariance C of a single axis. Where textbooks
    add a spread d dᵀ to C, two axes add the mean of their two.
    """
    table = listed(modes)
    J, n = len(table), model.n // axes
    weight = np.array([mode[3] for mode in table])
    means = np.tile(model.x0.reshape(axes, n), (J, 1, 1))
    C = np.tile(model.P0[:n, :n], (J, 1, 1))
    log, weights = Log(), []
    history, rate_of_loss = [False], Rate()
    before, since = (weight, means, C), time[0] - 1.0  # as the last step's start left the modes
    F, Q = np.eye(model.n), np.zeros((model.n, model.n))  # of the motion since then
    for k, t in enumerate(time):
        H, R = at(model.H, k), at(model.R, k)
        F, Q = at(model.F, k) @ F, at(model.F, k) @ Q @ at(model.F, k).T + q * at(model.Q, k)
        f, g = F[:n, :n], Q[:n, :n]
        s = model.m // axes
        h, noise = H[:s, :n], R[:s, :s]
        got, here = ~lost[k], ~lost[k, :s]
        x, P = combined(*before)

        age = aged(t - since)
        T = transition(modes, scale_stay**age, regime_stay**age)
        weight, means, C = mixed(T, *before)
        if modes.losses:
            chances = rate_of_loss.chances(modes.losses, history[-1], not got.any())
            weight = weight * np.tile(chances, len(modes.scales))
            weight = weight / weight.sum()
            rate_of_loss.learn(modes.losses, weight.reshape(modes.shape), not got.any())
            history.append(not got.any())
        means = means @ f.T
        C = np.array([f @ c @ f.T + mode[1] * g for c, mode in zip(C, table, strict=True)])

        mean_q = sum(w * mode[1] for w, mode in zip(weight, table, strict=True))
        outlying = [1 + mode[2] * rate * (OUTLIER_SCALE - 1) for mode in table]
        mean_r = sum(w * mode[0] * o for w, mode, o in zip(weight, table, outlying, strict=True))
        P_prior = F @ P @ F.T + mean_q * Q
        innovation, nis, likelihood = judge(F @ x, P_prior, y[k], H, r * mean_r * R, got)

        if got.any():
            evidence = np.empty(J)
            for j, mode in enumerate(table):
                odds = [1.0 - rate, rate] if mode[2] and rate > 0 else [1.0]
                branches = [
                    axis_update(
                        means[j], C[j], y[k].reshape(axes, s), h, here, r * mode[0] * c * noise
                    )
                    for c in (1.0, OUTLIER_SCALE)[: len(odds)]
                ]
                shares = np.array([math.log(o) + b[2] for o, b in zip(odds, branches, strict=True)])
                evidence[j] = logsumexp(shares)
                shares = np.exp(shares - evidence[j])
                means[j] = sum(p * b[0] for p, b in zip(shares, branches, strict=True))
                C[j] = sum(
                    p * (b[1] + spread(b[0] - means[j]))
                    for p, b in zip(shares, branches, strict=True)
                )
            likelihood = logsumexp(np.log(weight) + evidence)
            weight = np.exp(np.log(weight) + evidence - likelihood)
        if got.any() or modes.losses:
            before, since = (weight, means, C), t
            F, Q = np.eye(model.n), np.zeros((model.n, model.n))
        log.add(*combined(weight, means, C), innovation, nis, likelihood)
        weights.append(weight.reshape(modes.shape))
    return log.arrays() | {"weights": np.stack(weights)}


class Rate:
    """Rate of independent losses, from its Beta prior and the samples of regimes that share it."""

    def __init__(self):
        self.lost, self.received = LOST_BEFORE

    def chances(self, losses, before, now):
        """Likelihood, regime by regime, of losing the sample (`now`) after `before`."""
        mean = self.lost / (self.lost + self.received)
        chance = np.array([mean if pair is None else pair[int(before)] for pair in losses])
        return chance if now else 1 - chance

    def learn(self, losses, weight, now):
        share = sum(weight[:, b].sum() for b, pair in enumerate(losses) if pair is None)
        if now:
            self.lost += share
        else:
            self.received += share


def spread(d):
    """Mean over the axes of d dᵀ, for the offsets d (axes, n) of a mean."""
    return d.T @ d / len(d)


def mixed(T, weight, means, C):
    """Mixed initial conditions: μ_ij = P(mode i before | mode j now)."""
    now = weight @ T
    mu = weight[:, None] * T / now
    new_means = np.einsum("ij,iag->jag", mu, means)
    new_C = np.array([
        sum(mu[i, j] * (C[i] + spread(means[i] - new_means[j])) for i in range(len(C)))
        for j in range(len(C))
    ])  # fmt: skip
    return now, new_means, new_C


def axis_update(means, C, y, h, here, noise):
    """Update of each axis by its own measurements; the log-densities of the axes add up."""
    total, updated, posterior = 0.0, means.copy(), C
    if here.any():
        h, noise = h[here], noise[np.ix_(here, here)]
        S = h @ C @ h.T + noise
        K = C @ h.T @ np.linalg.inv(S)
        rest = np.eye(len(C)) - K @ h
        posterior = rest @ C @ rest.T + K @ noise @ K.T
        for g in range(len(means)):
            v = y[g, here] - h @ means[g]
            updated[g] = means[g] + K @ v
            total -= 0.5 * (v @ np.linalg.solve(S, v) + np.linalg.slogdet(2 * math.pi * S)[1])
    return updated, posterior, total


def combined(weight, means, C):
    """Mean and covariance of the mixture over the whole state."""
    flat = means.reshape(len(means), -1)
    x = weight @ flat
    P = np.kron(np.eye(means.shape[1]), np.einsum("j,jab->ab", weight, C))
    for w, mean in zip(weight, flat, strict=True):
        P = P + w * np.outer(mean - x, mean - x)
    return x, P
