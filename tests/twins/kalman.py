"""The Kalman filter under loss, and what may stand in for a lost measurement."""

import numpy as np

from tests.twins.gaussian import Log, at, judge, parabola, rows, update


def kalman(model, time, y, lost, q=1.0, r=1.0, fill="skip", inflation=1.0):
    """KF with fill "skip", "zero", "hold" or "extrapolate"; q and r are numbers or one per sample.

    The fill is judged by nobody: innovations, NIS and likelihood are those of what was received.
    An extrapolated value corrects in a second stage, after what was received has corrected.
    """
    q, r = np.broadcast_to(q, len(time)), np.broadcast_to(r, len(time))
    x, P, log = model.x0, model.P0, Log()
    past = [[] for _ in range(model.m)]
    for k, t in enumerate(time):
        F, H, Q, R = (at(M, k) for M in (model.F, model.H, model.Q, model.R))
        got, R = ~lost[k], r[k] * R
        x, P = F @ x, F @ P @ F.T + q[k] * Q
        verdict = judge(x, P, y[k], H, R, got)
        held = got | (fill == "zero") | ([len(p) > 0 and fill == "hold" for p in past])
        last = [p[-1][1] if p and fill == "hold" else 0.0 for p in past]
        value = np.where(got, y[k], last)
        if held.any():
            x, P = update(x, P, value[held], *rows(H, R, held))
        for i in np.flatnonzero(got):
            past[i].append((t, y[k, i]))
        if fill == "extrapolate":
            x, P = corrected_by_fill(x, P, H, R, past, t, ~got, inflation)
        log.add(x, P, *verdict)
    return log.arrays()


def corrected_by_fill(x, P, H, R, past, t, lost, inflation):
    """Correct by the parabola of each lost component that has three past samples."""
    filled = lost & [len(p) >= 3 for p in past]
    if not filled.any():
        return x, P
    value, growth = np.array([parabola(past[i], t) for i in np.flatnonzero(filled)]).T
    H_l, R_l = rows(H, R, filled)
    D = np.diag(np.sqrt(inflation * growth))
    return update(x, P, value, H_l, D @ R_l @ D)


def conditioned(model, y, lost):
    """States of all samples given all received measurements up to each: no recursion at all.

    The states are linear in (x0, w_1, ..., w_T), so states and measurements are jointly Gaussian;
    the estimate at k is a conditional mean (Bayes' rule, written once).
    """
    T, n = len(y), model.n
    noise = np.zeros((n * (T + 1), n * (T + 1)))
    noise[:n, :n] = model.P0
    reach = np.zeros((T, n, n * (T + 1)))  # x_k - mean = reach[k] @ (x0 - mean, w_1, ...)
    row = np.eye(n, n * (T + 1))
    mean, means = model.x0, np.empty((T, n))
    for k in range(T):
        F, Q = at(model.F, k), at(model.Q, k)
        block = slice(n * (k + 1), n * (k + 2))
        noise[block, block] = Q
        row, mean = F @ row, F @ mean
        row[:, block] += np.eye(n)
        reach[k], means[k] = row, mean
    states, covariances = np.empty((T, n)), np.empty((T, n, n))
    for k in range(T):
        pairs = [(j, i) for j in range(k + 1) for i in np.flatnonzero(~lost[j])]
        states[k] = means[k]
        prior = reach[k] @ noise @ reach[k].T
        covariances[k] = prior
        if pairs:
            C = np.array([at(model.H, j)[i] @ reach[j] for j, i in pairs])
            v = np.array([y[j, i] - at(model.H, j)[i] @ means[j] for j, i in pairs])
            S = C @ noise @ C.T
            for a, (j, i) in enumerate(pairs):
                for b, (g, h) in enumerate(pairs):
                    S[a, b] += at(model.R, j)[i, h] if j == g else 0.0
            gain = np.linalg.solve(S, C @ noise @ reach[k].T).T
            states[k] = means[k] + gain @ v
            covariances[k] = prior - gain @ C @ noise @ reach[k].T
    return states, covariances
