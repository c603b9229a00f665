"""The update of an error-state filter, dense: one block with K = P Hᵀ (H P Hᵀ + R C⁻¹)⁻¹, in Joseph form."""

import numpy as np


def dense(H, rows, n):
    """H (m, n) of sparse weights (m, w) on the states that `rows` names."""
    found = np.zeros((len(rows), n))
    for c, row in enumerate(rows):
        found[c, list(row)] = H[c, : len(row)]
    return found


def judge(P, innovation, H, R):
    """NIS and log-likelihood of an innovation."""
    S = H @ P @ H.T + np.diag(R)
    nis = innovation @ np.linalg.solve(S, innovation)
    return nis, -0.5 * (nis + np.linalg.slogdet(2.0 * np.pi * S)[1])


def correct(x, P, innovation, H, R):
    """x and P by one block."""
    K = np.linalg.solve(H @ P @ H.T + np.diag(R), H @ P).T
    I_KH = np.eye(len(x)) - K @ H
    return x + K @ innovation, I_KH @ P @ I_KH.T + K @ np.diag(R) @ K.T


def robust(x, P, innovation, H, R, width, iterations=1, by_noise=False):
    """x, P and weights by the correntropy criterion, iterated to a fixed point."""
    scale = R if by_noise else np.diag(H @ P @ H.T) + R
    moved = x
    for _ in range(iterations):
        residual = innovation - H @ (moved - x)
        C = np.exp(-(residual**2) / (2.0 * width**2 * scale))
        moved, after = correct(x, P, innovation, H, R / C)
    return moved, after, C
