"""Tiny dense linear algebra for one filter lane, in the letters of every text on Kalman filters.

The functions read and write the fields of a lane (see `lane.fields`) in place; nothing is
allocated, and a matrix that is not positive definite is answered by False, never by a raise.
Measurement rows that copy one state (`rows[i] >= 0`) are read instead of multiplied.
"""

from __future__ import annotations

import math

from navgym.core.compile import inline, inner, part
from navgym.core.sizes import model_rows, model_size, sample_size, state_size


@part
def predict(lane, model, q):
    """x⁻ = F x, P⁻ = F P Fᵀ + q Q."""
    n = state_size(lane)
    for i in range(n):
        s = 0.0
        for j in range(n):
            s += model.F[i, j] * lane.x[j]
        lane.x_prior[i] = s
    for i in range(n):
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += model.F[i, k] * lane.P[k, j]
            lane.T[i, j] = s
    for i in range(n):
        for j in range(i + 1):
            s = q * model.Q[i, j]
            for k in range(n):
                s += lane.T[i, k] * model.F[j, k]
            lane.P_prior[i, j] = s
            lane.P_prior[j, i] = s


@inline
def observe_vector(model, i, x):
    """(H x)_i."""
    r = model.rows[i]
    s = 0.0
    if r >= 0:
        s = x[r]
    else:
        for k in range(model_size(model)):
            s += model.H[i, k] * x[k]
    return s


@inline
def observe_rows(model, P, W):
    """W = H P."""
    n = model_size(model)
    for i in range(model_rows(model)):
        r = model.rows[i]
        for j in range(n):
            if r >= 0:
                W[i, j] = P[r, j]
            else:
                s = 0.0
                for k in range(n):
                    s += model.H[i, k] * P[k, j]
                W[i, j] = s


@inline
def observe_entry(model, j, W, i):
    """(W Hᵀ)_ij."""
    r = model.rows[j]
    s = 0.0
    if r >= 0:
        s = W[i, r]
    else:
        for k in range(model_size(model)):
            s += W[i, k] * model.H[j, k]
    return s


@inline
def factorise(S, m):
    """Overwrite the lower triangle of S (m, m) by L, S = L Lᵀ; False if it is not positive definite."""
    ok = True
    for j in range(m):
        s = S[j, j]
        for k in range(j):
            s -= S[j, k] * S[j, k]
        if not s > 0.0:
            ok = False
        d = math.sqrt(max(s, 1e-300))
        S[j, j] = d
        d = 1.0 / d
        for i in range(j + 1, m):
            s = S[i, j]
            for k in range(j):
                s -= S[i, k] * S[j, k]
            S[i, j] = s * d
    return ok


@inner
def cholesky(lane):
    """`factorise` the lane's S."""
    return factorise(lane.S, sample_size(lane))


@inner
def innovate(lane, model):
    """z = L⁻¹(y − H x⁻), W = L⁻¹ H P⁻, S = L with L Lᵀ = H P⁻ Hᵀ + R_used, over the used rows.

    A row that is not used becomes an identity row of S with z = 0 and W = 0, which leaves the
    other rows exactly as they would be without it. Returns (ok, NIS, log |S|).
    """
    n = state_size(lane)
    m = sample_size(lane)
    S, W, z, use = lane.S, lane.W, lane.z, lane.use
    observe_rows(model, lane.P_prior, W)
    for i in range(m):
        if use[i]:
            z[i] = lane.y[i] - observe_vector(model, i, lane.x_prior)
            for j in range(i + 1):
                if use[j]:
                    S[i, j] = lane.R_used[i, j] + observe_entry(model, j, W, i)
                else:
                    S[i, j] = 0.0
        else:
            z[i] = 0.0
            for j in range(i):
                S[i, j] = 0.0
            S[i, i] = 1.0
            for j in range(n):
                W[i, j] = 0.0
    return whiten(lane)


@inner
def whiten(lane):
    """Overwrite S by its factor L, z by L⁻¹ z, W by L⁻¹ W; returns (ok, NIS, log |S|)."""
    n = state_size(lane)
    m = sample_size(lane)
    S, W, z = lane.S, lane.W, lane.z
    ok = cholesky(lane)
    nis = 0.0
    determinant = 1.0
    for i in range(m):
        d = 1.0 / S[i, i]
        determinant *= d
        s = z[i]
        for k in range(i):
            s -= S[i, k] * z[k]
        s *= d
        z[i] = s
        nis += s * s
        for j in range(n):
            s = W[i, j]
            for k in range(i):
                s -= S[i, k] * W[k, j]
            W[i, j] = s * d
    return ok, nis, -2.0 * math.log(determinant)


@inner
def correct_state(lane):
    """x = x⁻ + K ν, from what `innovate` left in W and z: K ν = Wᵀz."""
    for i in range(state_size(lane)):
        s = lane.x_prior[i]
        for k in range(sample_size(lane)):
            s += lane.W[k, i] * lane.z[k]
        lane.x[i] = s


@inner
def correct(lane):
    """x = x⁻ + K ν, P = (I − K H) P⁻.

    P = P⁻ − WᵀW is symmetric as written; `joseph` is its form that survives cancellation.
    """
    n = state_size(lane)
    m = sample_size(lane)
    W = lane.W
    correct_state(lane)
    for i in range(n):
        for j in range(i + 1):
            s = lane.P_prior[i, j]
            for k in range(m):
                s -= W[k, i] * W[k, j]
            lane.P[i, j] = s
            lane.P[j, i] = s


@part
def joseph(lane, model):
    """P = (I − K H) P⁻ (I − K H)ᵀ + K R_used Kᵀ, with S and W as `innovate` left them.

    Positive definite for any gain, however ill-conditioned S is. Overwrites W by Kᵀ = L⁻ᵀ W.
    """
    n = state_size(lane)
    m = sample_size(lane)
    S, W, A, T, P = lane.S, lane.W, lane.A, lane.T, lane.P
    for i in range(m - 1, -1, -1):
        d = 1.0 / S[i, i]
        for j in range(n):
            s = W[i, j]
            for k in range(i + 1, m):
                s -= S[k, i] * W[k, j]
            W[i, j] = s * d
    for i in range(n):
        for j in range(n):
            A[i, j] = 0.0
        A[i, i] = 1.0
    for k in range(m):
        if model.rows[k] >= 0:
            for i in range(n):
                A[i, model.rows[k]] -= W[k, i]
        else:
            for i in range(n):
                for j in range(n):
                    A[i, j] -= W[k, i] * model.H[k, j]
    for i in range(n):
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += A[i, k] * lane.P_prior[k, j]
            T[i, j] = s
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(n):
                s += T[i, k] * A[j, k]
            P[i, j] = s
    for k in range(m):
        if lane.use[k]:
            for i in range(n):
                s = 0.0
                for j in range(m):
                    if lane.use[j]:
                        s += W[j, i] * lane.R_used[j, k]
                for j in range(i + 1):
                    P[i, j] += s * W[k, j]
    for i in range(n):
        for j in range(i):
            P[j, i] = P[i, j]
