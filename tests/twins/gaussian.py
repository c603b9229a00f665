"""The Gaussian steps that all twins share."""

import math

import numpy as np


def at(matrix, k):
    """The matrix that holds at sample k, whether or not it has a time axis."""
    return matrix[k] if matrix.ndim == 3 else matrix


def judge(x, P, y, H, R, got):
    """Innovation of the received components, its NIS and log-density under N(0, H P Hᵀ + R)."""
    innovation = np.where(got, y - H @ x, np.nan)
    if not got.any():
        return innovation, np.nan, np.nan
    v = innovation[got]
    S = (H @ P @ H.T + R)[np.ix_(got, got)]
    nis = v @ np.linalg.solve(S, v)
    return innovation, nis, -0.5 * (nis + np.linalg.slogdet(2 * math.pi * S)[1])


def update(x, P, y, H, R):
    """Posterior of x ~ N(x, P) given y = H x + v, v ~ N(0, R), with the received rows only."""
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    rest = np.eye(len(x)) - K @ H
    return x + K @ (y - H @ x), rest @ P @ rest.T + K @ R @ K.T


def rows(H, R, which):
    """The rows of H, and rows and columns of R, of some measurement components."""
    return H[which], R[np.ix_(which, which)]


def parabola(past, t):
    """Value at t of the parabola through the last three (time, value) pairs, and Σ l²."""
    (a, ya), (b, yb), (c, yc) = past[-3:]
    # Lagrange weights from the moment conditions Σ l = 1, Σ l s = t, Σ l s² = t² about t = 0
    nodes = np.array([a, b, c]) - t
    weights = np.linalg.solve(np.vander(nodes, 3, increasing=True).T, [1.0, 0.0, 0.0])
    return weights @ [ya, yb, yc], weights @ weights


class Log:
    """Collects one row per sample."""

    names = ("states", "covariances", "innovations", "nis", "log_likelihood")

    def __init__(self):
        self.entries = []

    def add(self, *values):
        self.entries.append([np.array(v) for v in values])

    def arrays(self):
        columns = zip(*self.entries, strict=True)
        return {name: np.stack(column) for name, column in zip(self.names, columns, strict=True)}
