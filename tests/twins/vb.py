"""The corrected variational-Bayes step, with its evidence lower bound.

docs/science/qivbf.md#the-corrected-step.

Model of one sample, x⁻, P⁻, ν⁻ and U⁻ given:

    x | P ~ N(x⁻, P),  P ~ IW(τ P⁻, τ),  v = (v_u, v_l) | R ~ N(0, R),  R ~ IW(U⁻, ν⁻),
    y_u = H_u x + v_u received;  v_l, the noise of the lost components, stays latent.

q(P) q(R) q(x, v_l) is refined by coordinate ascent. A sample that comes w seconds after the last one
has the weight w, at most 1 (a power of its likelihood, p(y, v_l, x | P, R)^w). With E[P⁻¹]⁻¹ = Ψ/dof
for IW(Ψ, dof):

    q(P) = IW(τ P⁻ + w A, τ + w),   A = E[(x - x⁻)(x - x⁻)ᵀ]
    q(R) = IW(U⁻ + w B, ν⁻ + w),    B = E[v vᵀ] + 1e-6 R of the model
    q(x): the Kalman update of N(x⁻, P̂) by the received rows under R̂, since v_l integrates out
    q(v_l | x) = N(G v_u, R̂_ll - G R̂_ul),  G = R̂_lu R̂_uu⁻¹
"""

import numpy as np

from tests.twins.gaussian import Log, at, judge, rows, update
from tests.twins.kalman import corrected_by_fill

LEAST_COUNT, LEAST_COUNT_LOST = 1.0, 10.0
LEAST_NOISE, MOST_NOISE, MOST_RISE = 1e-6, 1e4, 6.0


def expected_noise(x, P, y, H, R, got):
    """B = E[v vᵀ] under q(x) = N(x, P) and q(v_l | x) of the noise covariance R."""
    T = completion(R, got)
    v = y[got] - H[got] @ x
    B_u = np.outer(v, v) + H[got] @ P @ H[got].T
    B = T @ B_u @ T.T
    lost = ~got
    G = T[lost]
    B[np.ix_(lost, lost)] += R[np.ix_(lost, lost)] - G @ R[np.ix_(got, lost)]
    return B


def completion(R, got):
    """T with E[v | v_u] = T v_u."""
    T = np.zeros((len(R), got.sum()))
    T[got] = np.eye(got.sum())
    T[~got] = R[np.ix_(~got, got)] @ np.linalg.inv(R[np.ix_(got, got)])
    return T


def vb_step(x_prior, P_prior, R_prior, count, y, H, R_model, got, sweeps, tau, weight=1.0):
    """Posterior (x, P), and the estimates P̂ and R̂, after so many sweeps."""
    x, P, R = x_prior, P_prior, R_prior
    for _ in range(sweeps):
        A = P + np.outer(x - x_prior, x - x_prior)
        B = expected_noise(x, P, y, H, R, got)
        P_hat = (tau * P_prior + weight * A) / (tau + weight)
        R = (count * R_prior + weight * (B + LEAST_NOISE * R_model)) / (count + weight)
        x, P = update(x_prior, P_hat, y[got], *rows(H, R, got))
    return x, P, P_hat, R


def elbo(x, P, P_hat, R, x_prior, P_prior, R_prior, count, y, H, R_model, got, tau, weight=1.0):
    """Evidence lower bound of one sample, up to terms that no sweep changes.

    That R̂ gains 1e-6 R of the model is a prior U⁻ that has as much more.

    The terms dropped are the normalisers of the four inverse-Wishart laws, whose degrees of
    freedom are the same after every sweep; so the bound's rises are defined even where τ or ν⁻
    is too small for a proper law.
    """
    A = P + np.outer(x - x_prior, x - x_prior)
    v = y[got] - H[got] @ x
    B_u = np.outer(v, v) + H[got] @ P @ H[got].T
    T = completion(R, got)
    B = T @ B_u @ T.T
    R_ll = R[np.ix_(~got, ~got)] - T[~got] @ R[np.ix_(got, ~got)]
    B[np.ix_(~got, ~got)] += R_ll
    bound = 0.5 * weight * np.linalg.slogdet(P)[1]
    bound += 0.5 * weight * np.linalg.slogdet(R_ll)[1] if len(R_ll) else 0.0
    U_prior = count * R_prior + weight * LEAST_NOISE * R_model
    bound += inverse_wishart_part(tau * P_prior, tau, P_hat, A, weight)
    bound += inverse_wishart_part(U_prior, count, R, B, weight)
    return bound


def inverse_wishart_part(scale, dof, estimate, moment, w):
    """w E log p(e | M) + E log p(M) - E log q(M), e ~ N(0, M), M ~ IW(scale, dof), E[e eᵀ] known.

    q(M) = IW((dof + w) estimate, dof + w): E log |M| cancels because q has w counts more.
    """
    after = (dof + w) * estimate
    precision = np.linalg.inv(estimate)
    part = 0.5 * np.trace((after - scale - w * moment) @ precision)
    return part - 0.5 * (dof + w) * np.linalg.slogdet(after)[1]


def forgotten(count, rho, silent):
    """ν⁻ after `silent` seconds: ρ per second, but a silence forgets only down to ten counts."""
    fresh = rho ** min(silent, 1.0) * min(count, LEAST_COUNT_LOST)
    return max(rho**silent * count, fresh, LEAST_COUNT)


def bounded(R, R_model, R_before):
    """R̂ with each variance at most 1e4 of the model's and six times the last, correlations kept."""
    most = np.minimum(MOST_NOISE * np.diag(R_model), MOST_RISE * np.diag(R_before))
    excess = np.maximum(np.diag(R) / most, 1.0)
    D = np.diag(excess**-0.5)
    return D @ R @ D


def variational(
    model, time, y, lost, sweeps=5, tau=5.0, rho=0.97, count0=5.0, scale0=1.0, q=1.0,
    fill="skip", inflation=1.0,
):  # fmt: skip
    """The corrected filter; `noise` of the result is R̂ after each sample."""
    x, P, log = model.x0, model.P0, Log()
    R, count = scale0 * at(model.R, 0), count0
    past = [[] for _ in range(model.m)]
    noises, heard = [], time[0] - 1.0
    for k, t in enumerate(time):
        F, H, Q = (at(M, k) for M in (model.F, model.H, model.Q))
        got = ~lost[k]
        x, P = F @ x, F @ P @ F.T + q * Q
        R_model = at(model.R, k)
        ratio = np.diag(R_model) / np.diag(at(model.R, max(k - 1, 0)))
        R = R * np.sqrt(np.outer(ratio, ratio))
        verdict = judge(x, P, y[k], H, R, got)
        if got.any():
            silent, heard = t - heard, t
            weight = min(silent, 1.0)
            count = forgotten(count, rho, silent)
            before = R
            x, P, _, R = vb_step(x, P, R, count, y[k], H, R_model, got, sweeps, tau, weight)
            R, count = bounded(R, R_model, before), count + weight
        for i in np.flatnonzero(got):
            past[i].append((t, y[k, i]))
        if fill == "extrapolate":
            x, P = corrected_by_fill(x, P, H, R, past, t, ~got, inflation)
        log.add(x, P, *verdict)
        noises.append(R)
    return log.arrays() | {"noise": np.stack(noises)}
