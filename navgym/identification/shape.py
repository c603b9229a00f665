"""Autocorrelations of one axis, and the fit of a flexure model to one.

An axis is described by (ln ζ, ln b) with ζ = μ/b, which differ from (ln 2μ, ln b²) by a linear map
and make the region of search a box: everything is regular through critical damping (ζ = 1, λ = 0).
σ² enters linearly: it is found in closed form, which leaves a search over two numbers.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.identification.correlation import Correlation

DAMPING = (0.02, 8.0)  # ζ searched; beyond it, one of the two decays is too slow or fast to be seen
APART = 1e-10  # least |1 − ζ²|; R is smooth there, and closer the difference of exponents cancels
STARTS = 3  # best points of a grid from which the fit begins
LOGARITHMS = np.array([[1.0, 1.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
# ln 2μ, ln b², ln σ from ln ζ, ln b, ln σ, but for a constant
ROUNDS, SETTLED = 100, 1e-7  # of the fit, and the change of a logarithm that ends it
SMALL = 1e-6  # difference quotients of logarithms
GRID = (9, 24)  # points along ln ζ and ln b


def increment_autocorrelation(place: Array, lags: Array, step: float) -> Array:
    """(..., L) autocorrelation at lags ≥ t0 of increments over t0 of an axis with σ = 1.

    IDAM eq. 23 with both exponents, corrected: with s± = μ ± jλ,
    R(τ) = [s₊ e^{−s₋τ} − s₋ e^{−s₊τ}]/(s₊ − s₋), and differencing multiplies each exponential by
    2 (1 − cosh s t0). λ may be imaginary.

    Args:
        place: (..., 2) ln ζ and ln b.
        lags: (L,) s, none below `step`.
        step: t0, s.
    """
    zeta, b = np.exp(place[..., :1]), np.exp(place[..., 1:])
    square = 1.0 - zeta**2
    square = np.where(np.abs(square) < APART, APART, square)
    root = 1j * np.sqrt(square.astype(complex))
    fast, slow = b * (zeta + root), b * (zeta - root)
    first = fast * _wave(slow, lags, step)
    second = first.conj()  # which it is where λ is real: exponentials are most of the time
    still = square[..., 0] < 0.0
    second[still] = slow[still] * _wave(fast[still], lags, step)
    return np.asarray(((first - second) / (fast - slow)).real)


def _wave(s: Array, lags: Array, step: float) -> Array:
    """2 (1 − cosh s t0) e^{−s τ} = −(e^{s t0/2} − e^{−s t0/2})² e^{−s τ}."""
    return np.asarray(-np.exp(-s * (lags - step)) * (1.0 - np.exp(-s * step)) ** 2)


def region(correlation: Correlation) -> tuple[Array, Array]:
    """Least and largest (ln ζ, ln b) that a record can tell: half a radian in it, up to π per t0."""
    low = np.log([DAMPING[0], 0.5 / correlation.duration])
    return low, np.log([DAMPING[1], np.pi / correlation.step])


def amplitude(unit: Array, values: Array) -> Array:
    """(...,) the σ² with which σ² · `unit` is nearest to `values` (least squares), never negative."""
    return np.asarray(np.maximum(unit @ values, 0.0) / np.einsum("...l,...l->...", unit, unit))


def misfit(place: Array, correlation: Correlation, values: Array) -> Array:
    """(..., L) residuals of the best σ², in units of the root mean square of `values`."""
    unit = increment_autocorrelation(place, correlation.lags, correlation.step)
    scale = np.sqrt(np.mean(values**2))
    return np.asarray((values - amplitude(unit, values)[..., None] * unit) / scale)


def fit(correlation: Correlation, values: Array) -> Array:
    """(2,) (ln ζ, ln b) whose autocorrelation is nearest to `values` (L,) at the lags.

    Levenberg-Marquardt within `region`, from the lowest minima of a grid side by side.
    """
    low, high = region(correlation)
    table = _table(len(correlation.lags), correlation.step, correlation.duration)
    left = values @ values - amplitude(table, values) ** 2 * np.einsum("gl,gl->g", table, table)
    place = grid(low, high)[_minima(left)]
    cost, gradient, curvature = _expansion(place, correlation, values, low, high)
    damping = np.full(len(place), 1e-2)
    for _ in range(ROUNDS):
        lift = damping[:, None, None] * curvature * np.eye(2)
        step = np.linalg.solve(curvature + lift, gradient[..., None])[..., 0]
        trial = np.clip(place - step, low, high)
        expansion = _expansion(trial, correlation, values, low, high)
        better = expansion[0] < cost
        moved = np.abs(trial - place).max(axis=-1)
        place = np.where(better[:, None], trial, place)
        cost = np.where(better, expansion[0], cost)
        gradient = np.where(better[:, None], expansion[1], gradient)
        curvature = np.where(better[:, None, None], expansion[2], curvature)
        damping = np.clip(np.where(better, damping / 5.0, damping * 4.0), 1e-9, 1e9)
        if (moved < SETTLED).all():
            break
    return np.asarray(place[np.argmin(cost)])


def _expansion(
    place: Array, correlation: Correlation, values: Array, low: Array, high: Array
) -> tuple[Array, Array, Array]:
    """Squared misfit (S,), its gradient/2 (S, 2) and Gauss-Newton curvature/2 (S, 2, 2).

    A number that stands at its bound and would cross it is held there.
    """
    around = place[:, None, :] + SMALL * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    residuals = misfit(around, correlation, values)
    r = residuals[:, 0]
    slope = (residuals[:, 1:] - residuals[:, :1]) / SMALL
    gradient = np.einsum("sil,sl->si", slope, r)
    held = ((place <= low) & (gradient > 0.0)) | ((place >= high) & (gradient < 0.0))
    slope = np.where(held[..., None], 0.0, slope)
    curvature = np.einsum("sil,sjl->sij", slope, slope) + 1e-12 * np.eye(2)
    return np.einsum("sl,sl->s", r, r), np.where(held, 0.0, gradient), curvature


@functools.lru_cache(maxsize=4)
def _table(lags: int, step: float, duration: float) -> Array:
    """(G, L) autocorrelations on the grid; alike for all records of the same make."""
    times = step * np.arange(1.0, lags + 1.0)
    empty = np.zeros((0, 3))
    like = Correlation(step, duration, times, empty, empty, empty)
    return increment_autocorrelation(grid(*region(like)), times, step)


def grid(low: Array, high: Array) -> Array:
    """(G, 2) points inside the region."""
    axes = [np.linspace(a, b, n + 2)[1:-1] for a, b, n in zip(low, high, GRID, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def _minima(cost: Array) -> NDArray[np.int64]:
    """Indices of the lowest local minima on the grid, at most `STARTS`."""
    table = np.pad(cost.reshape(GRID), 1, constant_values=np.inf)
    inner = table[1:-1, 1:-1]
    least = np.minimum.reduce(
        [table[:-2, 1:-1], table[2:, 1:-1], table[1:-1, :-2], table[1:-1, 2:]]
    )
    places = np.flatnonzero((inner <= least).ravel())
    return np.asarray(places[np.argsort(cost[places])[:STARTS]], dtype=np.int64)


def deviation(place: Array, sigma: float, correlation: Correlation, variance: float) -> Array:
    """(3, 3) covariance of (ln 2μ, ln b², ln σ) from a fit at `place`, not below the sampling limit.

    Gauss-Newton with the covariance of an empirical autocorrelation (Bartlett 1946),
    cov(R̂ₚ, R̂_q) = t0/W Σₘ [Rₘ Rₘ₊ₚ₋q + Rₘ₊ₚ Rₘ₋q], whose errors at neighbouring lags are alike:
    the residuals alone would promise far too much.

    Args:
        place: (2,) ln ζ and ln b.
        sigma: rad.
        correlation: of the record.
        variance: of the increments at lag 0, rad², gyro noise included.
    """
    limit = sampling_limit(place, correlation)
    with np.errstate(all="ignore"):
        slope = _jacobian(place, sigma, correlation) / sigma**2
    if not np.isfinite(slope).all():  # an axis without flexure: σ is next to nothing
        return limit
    inverse = np.linalg.pinv(slope, rcond=1e-6) / sigma**2
    own = inverse @ _bartlett(place, sigma, correlation, variance) @ inverse.T
    return _raised(LOGARITHMS @ own @ LOGARITHMS.T, limit)


def sampling_limit(place: Array, correlation: Correlation) -> Array:
    """(3, 3) covariance of (ln 2μ, ln b², ln σ) that no estimate from W seconds can go below.

    Were θ and θ̇ seen continuously, the regression of θ̈ on both, with noise of density
    q = 4μb²σ², would have var 2μ = q/(W var θ̇) = 4μ/W and var b² = q/(W var θ) = 4μb²/W. Hence the
    relative variances 1/(μW) and 4μ/(b²W), and std ln b = 1/√(bW) at critical damping. q itself
    shows in the roughness of θ̇, up to the W/t0 increments; σ follows from it.
    """
    zeta, b = np.exp(place)
    W = correlation.duration
    damping, stiffness = 1.0 / (zeta * b * W), 4.0 * zeta / (b * W)
    roughness = 2.0 * correlation.step / W
    limit = np.diag([damping, stiffness, (damping + stiffness + roughness) / 4.0])
    limit[0, 2] = limit[2, 0] = -damping / 2.0
    limit[1, 2] = limit[2, 1] = -stiffness / 2.0
    return limit


def _raised(covariance: Array, limit: Array) -> Array:
    """The covariance scaled so that no standard deviation is below that of `limit`."""
    own, least = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(limit))
    if not np.isfinite(own).all() or not (own > 0.0).all():
        return limit
    scale = np.maximum(least / own, 1.0)
    return np.asarray(covariance * np.outer(scale, scale))


def _jacobian(place: Array, sigma: float, correlation: Correlation) -> Array:
    """(L, 3) derivatives of the autocorrelation by ln ζ, ln b, ln σ."""
    h = 1e-4
    steps = place + h * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [0.0, 0.0]])
    up, down, right, left, here = increment_autocorrelation(
        steps, correlation.lags, correlation.step
    )
    slope = [(up - down) / (2.0 * h), (right - left) / (2.0 * h), 2.0 * here]
    return np.asarray(sigma**2 * np.stack(slope, axis=-1))


def _bartlett(place: Array, sigma: float, correlation: Correlation, variance: float) -> Array:
    """(L, L) covariance of the empirical autocorrelation at the lags, rad⁴."""
    count = len(correlation.lags)
    lags = correlation.step * np.arange(1.0, 3 * count + 1.0)
    right = sigma**2 * increment_autocorrelation(place, lags, correlation.step)
    R = np.concatenate((right[::-1], [variance], right))
    products = np.correlate(R, R, mode="full")[len(R) - 1 :]
    n = np.arange(1, count + 1)
    total = products[np.abs(n[:, None] - n)] + products[n[:, None] + n]
    return np.asarray(total * correlation.step / correlation.duration)
