"""Fast marginal likelihood (Tipping & Faul 2003) in readable numpy, by the N × N covariance of y."""

import numpy as np


def evidence(B, y, alpha, beta):
    """log N(y; 0, C) with C = I/β + Σ φᵢφᵢᵀ/αᵢ (IDAM eq. 31)."""
    C = covariance(B, alpha, beta)
    return -0.5 * (np.linalg.slogdet(2 * np.pi * C)[1] + y @ np.linalg.solve(C, y))


def covariance(B, alpha, beta):
    return np.eye(B.shape[1]) / beta + sum(
        (np.outer(B[i], B[i]) / a for i, a in alpha.items()), np.zeros((B.shape[1],) * 2)
    )


def posterior(B, y, alpha, beta):
    """Mean and variances of the weights (IDAM eq. 29)."""
    Phi, A = B[list(alpha)].T, np.diag(list(alpha.values()))
    Sigma = np.linalg.inv(beta * Phi.T @ Phi + A)
    return beta * Sigma @ Phi.T @ y, np.diag(Sigma)


def noise(B, y, alpha, beta):
    """β by IDAM eq. 32."""
    mean, variance = posterior(B, y, alpha, beta)
    gamma = 1 - np.array(list(alpha.values())) * variance
    return (len(y) - gamma.sum()) / np.sum((y - B[list(alpha)].T @ mean) ** 2)


def all_together(B, y, first, beta, learn):
    """Tipping (2001), eq. 16-18, from α = .01 on, until no α moves much."""
    alpha = dict.fromkeys(first, 1e-2)
    for _ in range(40):
        mean, variance = posterior(B, y, alpha, beta)
        old = alpha
        if learn:
            beta = noise(B, y, alpha, beta)
        new = (1 - np.array(list(old.values())) * variance) / mean**2
        moved = np.abs(np.log(new / np.array(list(old.values()))))
        alpha = {i: a for i, a in zip(old, new, strict=True) if a <= 1e2 * beta}
        if moved.max() <= 0.3:
            break
    return alpha, beta


def one_by_one(B, y, alpha, beta, learn, tolerance, limit=10_000):
    """Change the one α that gains most evidence, until none would."""
    for _ in range(limit):
        fresh = noise(B, y, alpha, beta) if learn else beta
        inverse = np.linalg.inv(covariance(B, alpha, beta))
        S = np.einsum("mn,nk,mk->m", B, inverse, B)
        Q = B @ inverse @ y
        changes, moving = [], abs(np.log(fresh / beta)) >= tolerance
        for i in range(len(B)):
            a = alpha.get(i, np.inf)
            shrink = 1.0 if i not in alpha else a / (a - S[i])
            s, q = S[i] * shrink, Q[i] * shrink
            new = s**2 / (q**2 - s) if q**2 > s else np.inf
            if new == a or (i not in alpha and S[i] <= 1e-9 * beta):
                continue
            gain = likelihood(new, s, q) - likelihood(a, s, q)
            if i in alpha:
                moving |= abs(np.log(new) - np.log(a)) >= tolerance
            elif gain < 1e-3:
                continue
            else:
                moving = True
            changes.append((gain, i, new))
        if changes:
            _, i, new = max(changes)
            alpha = (
                {**alpha, i: new} if new < np.inf else {k: v for k, v in alpha.items() if k != i}
            )
        beta = fresh
        if not moving:
            break
    return alpha, beta


def likelihood(a, s, q):
    """ℓ(αᵢ), the part of the evidence that depends on it (Tipping & Faul 2003, eq. 20)."""
    return 0.0 if a == np.inf else 0.5 * (np.log(a / (a + s)) + q**2 / (a + s))
