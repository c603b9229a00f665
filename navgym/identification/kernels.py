"""The compiled loop of sparse Bayesian regression: fast marginal likelihood (Tipping & Faul 2003).

Each step adds, re-estimates or deletes the one basis function that raises the evidence most. The
posterior is then factorised anew: with some tens of relevant functions that is cheap, it takes a
new noise level in the same pass, and it gathers no rounding as updates of inverses do.
"""

from __future__ import annotations

import numpy as np

from navgym.core.compile import kernel, part

LEAST_GAIN = 1e-3  # nats; a function that adds less evidence is not worth a place
COLLINEAR = 1e-9  # share of a function outside the span of the relevant ones, below which it waits
ROUNDING = 1e-14  # least pivot, as a share of the diagonal
LEAST = 1e-12  # α/β: with less, Σ⁻¹ = βΦᵀΦ + A is singular to rounding where functions are alike
SPREAD = 1e-2  # α of the functions that are there from the start, in units of max |y|
PRUNE = 1e2  # α/β above which a function leaves the first phase
PATIENCE = 300  # steps without LEAST_GAIN in all after which the evidence is flat to rounding
SETTLED, TOGETHER = 0.3, 40  # |Δ log α| and number of steps that end the first phase


@part
def factorise(m, H, L):
    """Cholesky factor L of the leading m × m block of H, which is positive but for rounding."""
    for i in range(m):
        for j in range(i + 1):
            total = H[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = np.sqrt(max(total, ROUNDING * H[i, i]))
            else:
                L[i, j] = total / L[j, j]


@part
def invert(m, L, U):
    """U = L⁻¹ for the leading m × m block of a lower triangle."""
    for j in range(m):
        U[j, j] = 1.0 / L[j, j]
        for i in range(j + 1, m):
            total = 0.0
            for k in range(j, i):
                total -= L[i, k] * U[k, j]
            U[i, j] = total / L[i, i]


@part
def posterior(m, active, alpha, beta, G, t, H, L, U, w, mean, variance):
    """Mean and variances of the weights (IDAM eq. 29); leaves Σ⁻¹ = LLᵀ, U = L⁻¹ and w = U Φᵀy."""
    for i in range(m):
        for j in range(i + 1):
            H[i, j] = beta * G[i, active[j]]
        H[i, i] += alpha[i]
    factorise(m, H, L)
    invert(m, L, U)
    mean[:m] = 0.0
    variance[:m] = 0.0
    for k in range(m):
        w[k] = 0.0
        for j in range(k + 1):
            w[k] += U[k, j] * t[active[j]]
        for i in range(k + 1):
            mean[i] += beta * U[k, i] * w[k]
            variance[i] += U[k, i] ** 2


@part
def statistics(m, beta, G, t, L, w, V, S, Q):
    """S = φᵀC⁻¹φ and Q = φᵀC⁻¹y of every basis function (Tipping & Faul 2003, eq. 24 and 25)."""
    for n in range(len(t)):
        S[n] = beta
        Q[n] = beta * t[n]
    for i in range(m):
        row, given, pivot, weight = V[i], G[i], L[i, i], beta**2 * w[i]
        for n in range(len(t)):
            row[n] = given[n]
        for j in range(i):
            factor, other = L[i, j], V[j]
            for n in range(len(t)):
                row[n] -= factor * other[n]
        for n in range(len(t)):
            v = row[n] / pivot
            row[n] = v
            S[n] -= (beta * v) ** 2
            Q[n] -= weight * v


@part
def best_addition(beta, slot, S, Q):
    """The function outside the model whose entry raises the evidence most: (gain, which)."""
    largest, best = 1.0, -1
    for n in range(len(S)):  # the gain rises with the ratio: one logarithm will do
        if Q[n] ** 2 > largest * S[n] and slot[n] < 0 and S[n] > COLLINEAR * beta:
            largest, best = Q[n] ** 2 / S[n], n
    return 0.5 * (largest - 1.0 - np.log(largest)), best


@part
def best_change(m, alpha, mean, variance, least):
    """The relevant function to re-estimate or delete: (gain, its place, new α, largest |Δ log α|).

    s and q, what S and Q are without the function, follow from its own posterior: its precision is
    1/Σᵢᵢ = αᵢ + s, and its mean q Σᵢᵢ. A new α is `least` at least; one of infinity deletes it.
    """
    gain, best, chosen, largest = -np.inf, -1, 0.0, 0.0
    for i in range(m):
        s = 1.0 / variance[i] - alpha[i]
        q = mean[i] / variance[i]
        if q * q > s > 0.0:
            new = max(s * s / (q * q - s), least)
            ratio = new / alpha[i]
            difference = 1.0 / new - 1.0 / alpha[i]
            S, Q = alpha[i] * s * variance[i], alpha[i] * mean[i]
            g = 0.5 * (Q * Q * difference / (difference * S + 1.0) - np.log1p(S * difference))
            largest = max(largest, abs(np.log(ratio)))
        else:
            new = np.inf
            s = max(s, 0.0)
            g = 0.5 * (np.log1p(s / alpha[i]) - q * q / (s + alpha[i]))
            largest = np.inf
        if g > gain:
            gain, best, chosen = g, i, new
    return gain, best, chosen, largest


@part
def log_evidence(m, alpha, beta, free, L, mean, error):
    """Log p(y | α, β), given the `error` of the posterior mean, and the sum of the error's squares.

    y has `free` degrees of freedom.
    """
    squares = 0.0
    total = free * np.log(beta / (2.0 * np.pi))
    for i in range(m):
        total += np.log(alpha[i]) - 2.0 * np.log(L[i, i]) - alpha[i] * mean[i] ** 2
    for k in range(len(error)):
        total -= beta * error[k] ** 2
        squares += error[k] ** 2  # of the same passage: each sum waits for its own terms
    return 0.5 * total, squares


@part
def residual(m, mean, B, y, error):
    """y less the model's prediction."""
    error[:] = y
    for i in range(m):
        weight, function = mean[i], B[i]
        for k in range(len(y)):
            error[k] -= weight * function[k]


@part
def drop(place, m, active, alpha, slot, B, G):
    """Take one function out of the model, the last one into its place; returns how many are left."""
    m -= 1
    slot[active[place]] = -1
    if place < m:
        active[place], alpha[place] = active[m], alpha[m]
        slot[active[m]] = place
        B[place], G[place] = B[m], G[m]
    return m


@part
def noise_precision(m, alpha, variance, free, squares, most):
    """β of the noise by IDAM eq. 32, with γᵢ = 1 − αᵢΣᵢᵢ and N the `free` degrees of freedom."""
    left = float(free - m)
    for i in range(m):
        left += alpha[i] * variance[i]
    return min(most, max(left, 1e-3) / max(squares, 1e-300))


@part
def project(D, B, products):
    """Products of every function (a column of D) with each row of B, in one passage over D.

    D is read from memory, which is what takes time; BLAS would start threads for each product.
    """
    products[:] = 0.0
    for k in range(len(D)):
        row = D[k]
        for i in range(len(B)):
            b, product = B[i, k], products[i]
            for n in range(len(row)):
                product[n] += b * row[n]


@part
def among(m, active, B, G):
    """Products of the relevant functions with each other alone, into their places in G."""
    P = np.zeros((m, m))
    for k in range(B.shape[1]):
        column = B[:m, k].copy()
        for i in range(m):
            b, products = column[i], P[i]
            for j in range(i + 1):
                products[j] += b * column[j]
    for i in range(m):
        for j in range(i + 1):
            G[i, active[j]] = G[j, active[i]] = P[i, j]


@kernel
def fast_marginal_likelihood(D, y, free, first, beta, learn, most, tolerance, limit):
    """Sparse Bayesian regression of y on basis functions of unit length.

    Adding functions one by one to an empty model often ends in a poor local optimum: with the noise
    unknown, the first misfit passes for noise. So some functions spread over the basis are in the
    model from the start, and all their α move together (Tipping 2001, eq. 16-18) until those that
    are not needed have left. Only then does the greedy search begin.

    Args:
        D: (N, M) basis functions, one a column, each with Σ D² = 1.
        y: (N,) targets.
        free: degrees of freedom of y: N, or N − 1 where its mean was taken off it and off B.
        first: (K,) functions to begin with, at most min(M, free).
        beta: 1/σ² of the noise, where learning starts.
        learn: whether to estimate beta.
        most: largest beta that may be learnt.
        tolerance: of |Δ log α| and |Δ log β| at the end.
        limit: of steps.

    Returns:
        active (m,), alpha (m,), mean (m,), U = L⁻¹ (m, m) with Σ = UᵀU, beta, the log evidence
        after each step (steps,), and whether it converged.
    """
    N, M = D.shape
    room = min(M, free) + 1
    active, slot = np.empty(room, np.int64), np.full(M, -1)
    alpha, mean, variance, w = np.empty(room), np.empty(room), np.empty(room), np.empty(room)
    H, L, U = np.empty((room, room)), np.empty((room, room)), np.empty((room, room))
    B, G, V = np.empty((room, N)), np.empty((room, M)), np.empty((room, M))
    S, Q, error, trace = np.empty(M), np.empty(M), np.empty(N), np.empty(limit)
    t = np.empty(M)
    project(D, y.reshape(1, N), t.reshape(1, M))
    m, steps, converged, together = len(first), 0, False, True
    highest, since = -np.inf, 0
    for i in range(m):
        active[i], slot[first[i]] = first[i], i
        alpha[i] = max(SPREAD, LEAST * beta)
        B[i] = D[:, first[i]]
    among(m, active, B, G)  # the first phase needs no products with other functions
    while True:
        posterior(m, active, alpha, beta, G, t, H, L, U, w, mean, variance)
        residual(m, mean, B, y, error)
        evidence, squares = log_evidence(m, alpha, beta, free, L, mean, error)
        if steps > 0:
            trace[steps - 1] = evidence
            if trace[steps - 1] > highest + LEAST_GAIN:
                highest, since = trace[steps - 1], steps
        if steps == limit or converged:
            break
        steps += 1
        fresh = noise_precision(m, alpha, variance, free, squares, most) if learn else beta
        change = abs(np.log(fresh / beta))
        if together:
            largest = 0.0
            for i in range(m - 1, -1, -1):
                gamma = max(1.0 - alpha[i] * variance[i], 1e-12)
                new = max(gamma / max(mean[i] ** 2, 1e-300), LEAST * beta)
                largest = max(largest, abs(np.log(new / alpha[i])))
                alpha[i] = new
                if new > PRUNE * fresh:
                    m = drop(i, m, active, alpha, slot, B, G)
            together = largest > SETTLED and steps < TOGETHER
            beta = fresh
            if not together:
                project(D, B[:m], G[:m])
            continue
        statistics(m, beta, G, t, L, w, V, S, Q)
        gain, which = best_addition(beta, slot, S, Q)
        other, place, new, largest = best_change(m, alpha, mean, variance, LEAST * beta)
        full = m == room - 1
        if (gain < LEAST_GAIN or full) and largest < tolerance and change < tolerance:
            converged = True
        if steps > since + PATIENCE:  # functions that are alike may change places for ever
            converged = True
        if gain > other and gain >= LEAST_GAIN and not full:
            active[m], slot[which] = which, m
            alpha[m] = max(S[which] ** 2 / (Q[which] ** 2 - S[which]), LEAST * beta)
            B[m] = D[:, which]
            project(D, B[m : m + 1], G[m : m + 1])
            m += 1
        elif place >= 0 and new < np.inf:
            alpha[place] = new
        elif place >= 0:
            m = drop(place, m, active, alpha, slot, B, G)
        beta = fresh
    return (
        active[:m].copy(), alpha[:m].copy(), mean[:m].copy(), np.tril(U[:m, :m]), beta,
        trace[:steps].copy(), converged,
    )  # fmt: skip
