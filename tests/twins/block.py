"""The update of a block of rows under each rule, dense and by the formulas of its source."""

import numpy as np
from scipy.stats import multivariate_normal

from navgym.inertial import block_update as b


def correct(P, H, r, R):
    """dx and P of a Kalman update in Joseph form."""
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    I_KH = np.eye(len(P)) - K @ H
    return K @ r, I_KH @ P @ I_KH.T + K @ R @ K.T


def judge(P, H, r, R):
    """NIS and log-likelihood."""
    S = H @ P @ H.T + R
    return r @ np.linalg.solve(S, r), multivariate_normal(np.zeros(len(r)), S).logpdf(r)


def expected_misfit(P, H, r, R):
    """E[vᵀ R⁻¹ v] after an update, v = r − H x."""
    dx, after = correct(P, H, r, R)
    e = r - H @ dx
    return np.trace(np.linalg.solve(R, np.outer(e, e) + H @ after @ H.T))


def student(P, H, r, R, freedom, iterations):
    """Student-t noise by the variational fixed point."""
    w = 1.0
    for _ in range(iterations):
        # the misfit is in units of R, the update is by R/w
        w = (freedom + len(r)) / (freedom + expected_misfit(P, H, r, R / w) / w)
    return *correct(P, H, r, R / w), w


def correntropy(P, H, r, R, width):
    """R divided by a Gaussian kernel of the NIS."""
    w = np.exp(-judge(P, H, r, R)[0] / (2.0 * width**2))
    return *correct(P, H, r, R / w), w


def variational(P, H, r, R, count, total, keep, iterations):
    """λR with λ inverse-gamma: mean ⟨1/λ⟩⁻¹ = total / count."""
    count, total = keep * count, keep * total
    scale = total / count
    for _ in range(iterations):
        scale = (total + scale * expected_misfit(P, H, r, scale * R)) / (count + len(r))
    return *correct(P, H, r, scale * R), scale


def bank(P, H, r, R, chance):
    """A mixture of updates over scales of R, moment-matched."""
    prior = b.STAY * chance + (1.0 - b.STAY) / len(chance)
    weights, means, after = [], [], []
    for p, s in zip(prior, b.SCALES, strict=True):
        for share, factor in ((1.0 - b.OUTLIER_RATE, 1.0), (b.OUTLIER_RATE, b.OUTLIER)):
            weights.append(p * share * np.exp(judge(P, H, r, s * factor * R)[1]))
            dx, P_j = correct(P, H, r, s * factor * R)
            means.append(dx)
            after.append(P_j)
    w = np.array(weights)
    log = np.log(w.sum())
    w /= w.sum()
    mean = w @ np.array(means)
    spread = sum(
        p * (P_j + np.outer(m - mean, m - mean)) for p, P_j, m in zip(w, after, means, strict=True)
    )
    return mean, spread, w.reshape(-1, 2).sum(axis=1), log
