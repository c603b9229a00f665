"""One road from increments to a flexure model."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from navgym.core.checks import Array, one_of
from navgym.identification import methods, shape
from navgym.identification.correlation import Correlation, correlate
from navgym.identification.methods import Found
from navgym.inertial.flexure import FlexureModel

_FUNCTIONS: dict[str, Callable[..., Found]] = {
    "rvm": methods.rvm,
    "rvm_dictionary": methods.rvm_dictionary,
    "svr": methods.svr,
    "whale": methods.whale,
    "swarm": methods.swarm,
    "tufts_kumaresan": methods.tufts_kumaresan,
    "nls": methods.nls,
    "regression": methods.regression,
}
METHODS = {name: (f.__doc__ or "").splitlines()[0] for name, f in _FUNCTIONS.items()}
COMMON = ("step", "longest_lag", "fewest")
WIDENING = (
    4.0  # of a short record's deviations at most: calibrated on simulated ones of 17 and 30 s
)


def identify(method: str, increments: ArrayLike, interval: float, **options: Any) -> FlexureModel:
    """Identify the flexure of each axis in a record of relative-attitude increments.

    b is searched from half a radian per record to π per t0, ζ = μ/b from .02 to 8: a record cannot
    tell more. An axis that ends on the edge of that region says so in `diagnostics["at_bound"]`.

    Records of less than 40 s (from 24 increments on, such as a swing of 17 s) come with a
    UserWarning and `diagnostics["short"]`. Their deviations are widened by up to five, as
    1 + 4 √ζ e^{std ln 2μ}: two of them then hold b in over 90 % of simulated records of 17 and 30 s
    up to ζ = .3, in over 80 % at .6, in over 70 % at 1 ("nls"). For an oscillation that dies away
    take "nls": "regression" takes all motion for pushed by noise.

    Args:
        method: a key of `METHODS`.
        increments: (T, 3) rad, θ_k − θ_{k−1} plus gyro noise, in inertial axes (increments in body
            axes lock on to the ship's motion: IDAM eq. 16); NaN where missing.
        interval: s, that each of them spans.
        **options: `step` (t0; .5 s, or less in a short record) and `longest_lag` (a quarter of the
            record, at most 60 s), both in s; `fewest` (24) increments over t0, below which a record
            is refused; and the method's own: `kernel_scale` (rvm, svr; 2 s), `noise` (rvm,
            rvm_dictionary), `penalty`, `epsilon` (svr), `seed`, `population`, `epochs` (whale,
            swarm), `share` (tufts_kumaresan), `instruments` (regression).

    Returns:
        The model with `deviation`, for the RVM methods `evidence`, and as `diagnostics`:
        `method`, `step`, `duration` (s), `lags` (L,), `autocorrelation` (L, 3) and `smoothed`
        (L, 3), rad²; `residual` (3,), the fit's rms as a share of the autocorrelation's;
        `covariance` (3, 3, 3) of (ln 2μ, ln b², ln σ) per axis; `at_bound` (3,); `short`; and what the method
        has to tell, such as `relevance_vectors` (3,).

    Raises:
        ValueError: an unknown method or option; increments that are too few, all zero, or not (T, 3).
        ImportError: a method whose library is not installed.
    """
    function = _FUNCTIONS[one_of("method", method, _FUNCTIONS)]
    own = [
        p.name for p in inspect.signature(function).parameters.values() if p.kind is p.KEYWORD_ONLY
    ]
    for name in options:
        one_of(f"option of method {method!r}", name, (*COMMON, *own))
    shared = {name: options.pop(name) for name in COMMON if name in options}
    data = correlate(increments, interval, **shared)
    model = _model(method, data, [function(data, axis, **options) for axis in range(3)])
    if data.short:
        assert model.deviation is not None
        factors = ", ".join(
            f"{factor:.3g}" for factor in np.exp(np.minimum(model.deviation[:, 1], 10.0))
        )
        warnings.warn(
            f"{data.duration:.3g} s of increments are a short record: natural frequencies about x, y, "
            f"z are known to factors of {factors} only (two deviations). 40 s and more tell better.",
            UserWarning,
            stacklevel=2,
        )
    return model


def _model(method: str, data: Correlation, axes: list[Found]) -> FlexureModel:
    """Put three axes together."""
    zeta, b = np.exp([axis.place for axis in axes]).T
    sigma = np.array([_sigma(data, axis) for axis in axes])
    if not (sigma > 0.0).all():
        raise ValueError(
            f"method {method!r} finds no flexure about axis {int(np.argmin(sigma))} in these increments: its "
            "smoothing may be too wide for a quick motion (lower kernel_scale), or there is none (try "
            "method 'nls')."
        )
    covariance = np.array([_covariance(data, axes[i], i, sigma[i]) for i in range(3)])
    if data.short:
        covariance *= _widening(zeta, covariance[:, 0, 0])[:, None, None] ** 2
    evidence = np.array([axis.evidence for axis in axes])
    return FlexureModel(
        2.0 * zeta * b, b**2, sigma,
        deviation=np.sqrt(np.einsum("aii->ai", covariance)),
        evidence=evidence if np.isfinite(evidence).all() else None,
        diagnostics=_diagnostics(method, data, axes, sigma) | {"covariance": covariance},
    )  # fmt: skip


def _widening(zeta: Array, variance: Array) -> Array:
    """(3,) what a short record's deviations are multiplied by, by ζ and the variance of ln 2μ.

    The formulas of their errors hold for long records; strong damping, or a damping that is hardly
    known, is where a short one is furthest from them.
    """
    likely = np.sqrt(zeta) * np.exp(np.minimum(np.sqrt(variance), 1.0))
    return np.asarray(1.0 + WIDENING * np.minimum(likely, 1.0))


def _covariance(data: Correlation, found: Found, axis: int, sigma: float) -> Array:
    """(3, 3) of (ln 2μ, ln b², ln σ)."""
    if found.covariance is not None:
        return found.covariance
    if found.nearest is None:
        return shape.deviation(found.place, sigma, data, float(data.variance[axis]))
    nearest = _sigma(data, Found(found.nearest, found.curve))
    own = shape.deviation(found.nearest, nearest, data, float(data.variance[axis]))
    away = shape.LOGARITHMS @ np.append(found.place - found.nearest, np.log(sigma / nearest))
    return np.asarray(own + np.outer(away, away))


def _sigma(data: Correlation, found: Found) -> float:
    """Rad; at least a millionth of what the curve allows, where nothing of that form is in it."""
    if found.sigma is not None:
        return found.sigma
    unit = shape.increment_autocorrelation(found.place, data.lags, data.step)
    least = 1e-6 * float(np.abs(found.curve).max()) / float(np.abs(unit).max())
    return float(np.sqrt(max(float(shape.amplitude(unit, found.curve)), least)))


def _diagnostics(method: str, data: Correlation, axes: list[Found], sigma: Array) -> dict[str, Any]:
    places = np.array([axis.place for axis in axes])
    fitted = sigma[:, None] ** 2 * shape.increment_autocorrelation(places, data.lags, data.step)
    low, high = shape.region(data)
    edge = (places < low + 1e-3) | (places > high - 1e-3)
    error = np.sqrt(np.mean((fitted.T - data.values) ** 2, axis=0))
    notes = {name: np.array([axis.notes[name] for axis in axes]) for name in axes[0].notes}
    return notes | {
        "method": method, "step": data.step, "duration": data.duration, "lags": data.lags,
        "autocorrelation": data.values, "smoothed": np.stack([a.curve for a in axes], axis=-1),
        "residual": error / np.sqrt(np.mean(data.values**2, axis=0)),
        "at_bound": edge.any(axis=1), "short": data.short,
    }  # fmt: skip
