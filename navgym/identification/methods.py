"""The ways to identify one axis: each finds (ln ζ, ln b) in what `correlate` made of a record.

Most of them smooth the empirical autocorrelation, or search in a way of their own, and end in the
same fit: a regressor of the autocorrelation (IDAM section 3.2) does not know μ, λ and σ.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from navgym.core.checks import Array, positive_int, within
from navgym.identification import search, shape
from navgym.identification.correlation import LEAST_LAGS, Correlation
from navgym.identification.rvm import RVM

EXTRA = 'pip install "navgym[identification]"'


@dataclass(frozen=True)
class Found:
    """What a method has found on one axis.

    Args:
        place: (2,) ln ζ and ln b.
        curve: (L,) the autocorrelation that it was found in: as measured, or smoothed, rad².
        evidence: log evidence, or NaN.
        covariance: (3, 3) of (ln 2μ, ln b², ln σ), where the method knows better than a fit.
        nearest: (2,) the least-squares fit, where the method may have ended elsewhere: its distance
            from `place` enters the deviation.
        sigma: rad, where the method has found it too.
        notes: what else there is to tell, a number per name.
    """

    place: Array
    curve: Array
    evidence: float = np.nan
    covariance: Array | None = None
    nearest: Array | None = None
    sigma: float | None = None
    notes: dict[str, float] = field(default_factory=dict)


def nls(data: Correlation, axis: int) -> Found:
    """Nonlinear least squares on the autocorrelation as it is."""
    return Found(shape.fit(data, data.values[:, axis]), data.values[:, axis])


def rvm(
    data: Correlation, axis: int, *, kernel_scale: float = 2.0, noise: float | None = None
) -> Found:
    """Fit to the autocorrelation as smoothed by a Gaussian-kernel RVM (IDAM section 3.2).

    Args:
        data: of the record.
        axis: 0, 1 or 2.
        kernel_scale: r of exp(−τ²/r²), s.
        noise: standard deviation of the autocorrelation's errors, as a share of lag 0, or None.
    """
    within("kernel_scale", kernel_scale, 0.0, above=True)
    machine = RVM("gaussian", scale=kernel_scale, bias=False, noise=noise)
    return _smoothed(data, axis, machine, data.lags)


def rvm_dictionary(data: Correlation, axis: int, *, noise: float | None = None) -> Found:
    """Fit to the autocorrelation as an RVM composes it from a dictionary of decaying sines.

    Args:
        data: of the record.
        axis: 0, 1 or 2.
        noise: standard deviation of the autocorrelation's errors, as a share of lag 0, or None.
    """
    places = shape.grid(*shape.region(data))
    atoms = shape.increment_autocorrelation(places, data.lags, data.step).T
    atoms = atoms / np.maximum(np.linalg.norm(atoms, axis=0), 1e-300)
    return _smoothed(data, axis, RVM("precomputed", bias=False, noise=noise), atoms)


def _smoothed(data: Correlation, axis: int, machine: RVM, points: Array) -> Found:
    """Let a machine learn the autocorrelation, relative to lag 0, and fit what it learnt."""
    unit = float(data.variance[axis])
    machine.fit(points, data.values[:, axis] / unit)
    curve = unit * machine.predict(points)
    notes = {"relevance_vectors": float(len(machine.relevance)), "noise": machine.sigma}
    if not len(machine.relevance):  # nothing but noise to this machine: no curve to fit
        return Found(shape.fit(data, data.values[:, axis]), curve, machine.evidence, notes=notes)
    return Found(shape.fit(data, curve), curve, machine.evidence, notes=notes)


def svr(
    data: Correlation,
    axis: int,
    *,
    kernel_scale: float = 2.0,
    penalty: float = 10.0,
    epsilon: float = 0.1,
) -> Found:
    """Fit to the autocorrelation as smoothed by support vector regression.

    Args:
        data: of the record.
        axis: 0, 1 or 2.
        kernel_scale: r of exp(−τ²/r²), s.
        penalty: C, of errors beyond the tube.
        epsilon: half width of the tube, as a share of the autocorrelation's rms.
    """
    try:
        from sklearn.svm import SVR
    except ImportError:
        raise ImportError(f"method 'svr' needs scikit-learn: {EXTRA}.") from None
    within("kernel_scale", kernel_scale, 0.0, above=True)
    within("penalty", penalty, 0.0, above=True)
    within("epsilon", epsilon, 0.0)
    values = data.values[:, axis]
    unit = float(np.sqrt(np.mean(values**2)))
    machine = SVR(kernel="rbf", gamma=kernel_scale**-2, C=penalty, epsilon=epsilon, tol=1e-6)
    machine.fit(data.lags[:, None], values / unit)
    curve = unit * np.asarray(machine.predict(data.lags[:, None]))
    notes = {"support_vectors": float(len(machine.support_))}
    return Found(shape.fit(data, curve), curve, notes=notes)


def whale(
    data: Correlation, axis: int, *, seed: int = 0, population: int = 30, epochs: int = 100
) -> Found:
    """Search for (ζ, b, σ) by the whale optimiser (Mirjalili & Lewis 2016), on the raw values.

    Args:
        data: of the record.
        axis: 0, 1 or 2.
        seed: of the search, the same on each axis.
        population: number of whales.
        epochs: number of generations.
    """
    return _searched(search.whale, data, axis, seed, population, epochs)


def swarm(
    data: Correlation, axis: int, *, seed: int = 0, population: int = 30, epochs: int = 100
) -> Found:
    """Search for (ζ, b, σ) by particle swarm optimisation, on the raw values.

    Args:
        data: of the record.
        axis: 0, 1 or 2.
        seed: of the search, the same on each axis.
        population: number of particles.
        epochs: number of generations.
    """
    return _searched(search.swarm, data, axis, seed, population, epochs)


def _searched(
    method: Callable[..., tuple[Array, float]],
    data: Correlation,
    axis: int,
    seed: int,
    population: int,
    epochs: int,
) -> Found:
    """Least squares over (ln ζ, ln b, ln σ) by a search."""
    positive_int("seed", seed, 0)
    positive_int("population", population, 5)
    positive_int("epochs", epochs)
    values = data.values[:, axis]
    rms = float(np.sqrt(data.variance[axis]))
    scale = float(np.mean(values**2))
    low, high = shape.region(data)

    def cost(places: Array) -> Array:
        unit = shape.increment_autocorrelation(places[:, :2], data.lags, data.step)
        error = values - (rms * np.exp(places[:, 2:])) ** 2 * unit
        return np.asarray(np.mean(error**2, axis=-1) / scale)

    # θ̇ has std bσ, so that σ is about rms/(b t0); b ranges over the region. Relative to rms, since
    # whales are drawn to the origin, and the search should not depend on the unit.
    least = np.append(low, np.log(0.25))
    most = np.append(high, np.log(2.0 / data.step) - low[1])
    place, left = method(cost, least, most, seed=seed, population=population, epochs=epochs)
    return Found(
        place[:2], values, nearest=shape.fit(data, values), sigma=rms * float(np.exp(place[2])),
        notes={"cost": left},
    )  # fmt: skip


def tufts_kumaresan(data: Correlation, axis: int, *, share: float = 0.75) -> Found:
    """Poles of the autocorrelation by backward linear prediction with a truncated SVD.

    Tufts & Kumaresan (1982): with a predictor much longer than the two poles, and its data matrix
    cut to rank two, the two poles e^{s t0} of the signal lie outside the unit circle and the others
    inside.

    Args:
        data: of the record.
        axis: 0, 1 or 2.
        share: length of the predictor, as a share of the lags; 3/4 is their advice.
    """
    order = round(within("share", share, 0.1, 0.9) * len(data.lags))
    values = data.values[:, axis]
    windows = np.lib.stride_tricks.sliding_window_view(values, order + 1)
    left, singular, right = np.linalg.svd(windows[:, 1:], full_matrices=False)
    inverse = right[:2].T @ (left[:, :2].T @ windows[:, 0] / singular[:2])
    roots = np.roots(np.concatenate(([1.0], -inverse)))
    exponents = np.log(_signal(roots[np.abs(roots) > 0.0], values)) / data.step
    place = _place(exponents.sum().real, exponents.prod().real, data)
    return Found(place, values, nearest=shape.fit(data, values))


def _signal(roots: Array, values: Array) -> Array:
    """(2,) the pair of poles, conjugate or real and positive, that explains the values best."""
    upper = roots[roots.imag > 1e-9]
    pairs = [np.array([z, z.conj()]) for z in upper if abs(z) > 1.0]
    real = np.sort(roots[(np.abs(roots.imag) <= 1e-9) & (roots.real > 1.0)].real)
    pairs += [np.array([a, b], complex) for a, b in itertools.pairwise(real)]
    if not pairs:  # nothing decays: take the slowest oscillation for a signal that hardly does
        nearest = roots[np.argmin(np.abs(np.abs(roots) - 1.0))]
        z = 1.001 * np.exp(1j * max(abs(np.angle(nearest)), 1e-3))
        return np.array([z, z.conj()])
    n = np.arange(1.0, len(values) + 1.0)[:, None]

    def left_over(pair: Array) -> float:
        waves = pair**-n
        return float(np.linalg.norm(values - waves @ np.linalg.lstsq(waves, values, rcond=None)[0]))

    return min(pairs, key=left_over)


def regression(data: Correlation, axis: int, *, instruments: bool = True) -> Found:
    """Regress θ̈ on [1, θ, θ̇], with θ the sum of the increments.

    Plain least squares of (v_{k+1} − v_k)/t0 on θ_k and v_k = (θ_k − θ_{k−1})/t0 finds b well and
    only 2/3 of the damping, since v is a mean over t0, not a rate at an instant. With θ_{k−1} and
    v_{k−1} as instruments, which share no noise with the equation (θ at steps of t0 is exactly
    ARMA(2,1)) and no gyro noise with v_k, both are consistent at any t0. What gyro noise sums up to
    in θ is left in: this method is for gyros whose random walk over 1/b stays well below σ.

    Args:
        data: of the record.
        axis: 0, 1 or 2.
        instruments: whether to use them; False is plain least squares.
    """
    X, Z, change = _equation(data, axis)
    coefficients = np.linalg.lstsq(Z.T @ X, Z.T @ change, rcond=None)[0]
    place = _exact(np.asarray(coefficients, dtype=float), data) if instruments else None
    used = place is not None
    if place is None:
        on_theta, on_step = np.linalg.lstsq(X, change, rcond=None)[0]
        place = _place(-on_step / data.step, -on_theta / data.step**2, data)
    limit = shape.sampling_limit(place, data)
    return Found(place, data.values[:, axis], covariance=limit, notes={"instruments": float(used)})


def _exact(coefficients: Array, data: Correlation) -> Array | None:
    """(2,) the place whose exact steps have these coefficients; None where no decaying pair has.

    θ_{k+1} = (2 + on_step + on_theta) θ_k − (1 + on_step) θ_{k−1} + noise, with poles e^{−s t0}.
    """
    on_theta, on_step = coefficients
    poles = np.roots([1.0, -2.0 - on_step - on_theta, 1.0 + on_step]).astype(complex)
    if len(poles) < 2 or (poles.real <= 0.0).any():
        return None
    s = -np.log(poles) / data.step
    if s.sum().real <= 0.0 or s.prod().real <= 0.0:
        return None
    return _place(s.sum().real, s.prod().real, data)


def _equation(data: Correlation, axis: int) -> tuple[Array, Array, Array]:
    """Regressors (K, 2), instruments (K, 2), change of the increment (K,).

    Each stretch between gaps has its own constant: its means are taken off.
    """
    parts = []
    for increments in _stretches(data.increments[:, axis]):
        theta = np.cumsum(increments)
        rows = np.column_stack(
            (theta[1:-1], increments[1:-1], theta[:-2], increments[:-2], np.diff(increments)[1:])
        )
        parts.append(rows - rows.mean(axis=0))
    if not parts:
        raise ValueError(
            f"increments hold no {LEAST_LAGS} steps of {data.step:g} s without a gap, which "
            "method 'regression' needs: choose another method, for example 'nls'."
        )
    rows = np.vstack(parts)
    return rows[:, :2], rows[:, 2:4], rows[:, 4]


def _stretches(increments: Array) -> list[Array]:
    """The runs without a gap that are long enough to be worth a constant of their own."""
    edges = np.flatnonzero(np.diff(np.isfinite(increments)))
    runs = np.split(increments, edges + 1)
    return [run for run in runs if np.isfinite(run[0]) and len(run) >= LEAST_LAGS]


def _place(damping: float, stiffness: float, data: Correlation) -> Array:
    """(ln ζ, ln b) of 2μ and b², brought into the region where they are outside or negative."""
    low, high = shape.region(data)
    b = np.sqrt(max(stiffness, np.exp(2.0 * low[1])))
    zeta = max(damping, 2.0 * b * np.exp(low[0])) / (2.0 * b)
    return np.clip(np.log([zeta, b]), low, high)
