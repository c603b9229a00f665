"""Errors of estimates against truth, one run or many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navgym.core.checks import Array, real_array

DIVERGED_MULTIPLE = 10.0  # a run this many times worse than its reference counts as diverged


def squared_error(states: ArrayLike, truth: ArrayLike, indices: Sequence[int]) -> Array:
    """Squared distance between estimate and truth over some states, (..., T).

    Args:
        states: (..., T, n) estimates; where one is not finite, its error is infinite.
        truth: (..., T, n) or any shape that broadcasts with it; NaN marks samples that are not
            scored (recordings of unequal length in one batch), and so does NaN in the result.
        indices: the states to compare, such as `model.position` or `model.velocity`.

    Raises:
        ValueError: shapes that do not match, no index or one that is out of range.
    """
    x, true = real_array("states", states, finite=False), real_array("truth", truth, finite=False)
    chosen = list(indices)
    if not chosen or x.ndim < 2 or not all(0 <= i < x.shape[-1] for i in chosen):
        raise ValueError(
            f"indices must name at least one of the states of {x.shape}, got {chosen}: "
            "use model.position or model.velocity."
        )
    if true.ndim < 2 or true.shape[-2:] != x.shape[-2:]:
        raise ValueError(f"truth must have the shape of states, {x.shape}, got {true.shape}.")
    with np.errstate(over="ignore", invalid="ignore"):
        squared: Array = ((x - true)[..., chosen] ** 2).sum(axis=-1)
    failed = ~np.isfinite(squared) & ~np.isnan(true[..., chosen]).any(axis=-1)
    return np.where(failed, np.inf, squared)


def run_rmse(squared: ArrayLike) -> Array:
    """Root mean square over time of each run, (...,), from `squared_error` (..., T)."""
    error = _squared(squared)
    return np.sqrt(_mean_scored(error, axis=-1))


def time_rmse(squared: ArrayLike) -> Array:
    """Root mean square over runs at each time, (T,), from `squared_error` (N, T)."""
    return np.sqrt(_mean_scored(_squared(squared, runs=True), axis=0))


@dataclass(frozen=True)
class ErrorSummary:
    """Errors of one filter over many runs, in the unit of the state.

    Args:
        runs: number of runs.
        mean: mean over runs of each run's RMSE over time; infinite if a run failed.
        pooled: RMSE over all samples of all runs; infinite if a run failed.
        time_mean: mean over time of the RMSE over runs ("ARMSE"); infinite if a run failed.
        median: median over runs of the RMSE.
        quantile_95: what 95 % of the runs stay below.
        divergence_rate: share of runs that diverged (`divergence`).
    """

    runs: int
    mean: float
    pooled: float
    time_mean: float
    median: float
    quantile_95: float
    divergence_rate: float


def summarize(
    squared: ArrayLike, diverged: ArrayLike | None = None, reference: ArrayLike | None = None
) -> ErrorSummary:
    """Summary of `squared_error` (N, T).

    Args:
        squared: N runs; NaN is not scored.
        diverged: (N,) flags of the filter (`Estimate.diverged`), or None.
        reference: see `divergence`.

    Raises:
        ValueError: no runs, negative errors, flags of another length.
    """
    error = _squared(squared, runs=True)
    each = run_rmse(error)
    return ErrorSummary(
        runs=len(each),
        mean=float(each.mean()),
        pooled=float(np.sqrt(_mean_scored(error, axis=None))),
        time_mean=float(time_rmse(error).mean()),
        median=float(np.median(each)),
        # an order statistic: interpolating towards an infinite neighbour would give NaN
        quantile_95=float(np.quantile(each, 0.95, method="higher")),
        divergence_rate=float(divergence(each, diverged, reference).mean()),
    )


def divergence(
    rmse: ArrayLike, diverged: ArrayLike | None = None, reference: ArrayLike | None = None
) -> NDArray[np.bool_]:
    """Which runs diverged, (N,): flagged, not finite, or ten times worse than a reference.

    Args:
        rmse: (N,) of each run.
        diverged: (N,) flags of the filter, or None.
        reference: RMSE to hold against, a number or (N,), such as the oracle's on the same
            recordings: above DIVERGED_MULTIPLE times it a run counts as diverged. None: no limit.
    """
    each = runs_of("rmse", rmse)
    flags = ~np.isfinite(each)
    if diverged is not None:
        flags |= per_run("diverged", diverged, each).astype(np.bool_)
    if reference is not None:
        flags |= each > DIVERGED_MULTIPLE * per_run("reference", reference, each)
    return flags


def score(value: ArrayLike, nominal: ArrayLike, oracle: ArrayLike) -> Array:
    """Share of the headroom that was won: 0 = nominal predict-only KF, 1 = oracle, (...,).

    Below 0 is worse than doing nothing. NaN where the oracle is no better than the nominal filter
    (as when the model is right): there is nothing to win. All are errors, the smaller the better.
    """
    fields = {"value": value, "nominal": nominal, "oracle": oracle}
    v, n, o = (real_array(name, a, finite=name != "value") for name, a in fields.items())
    for name, array in zip(fields, (v, n, o), strict=True):
        if (array < 0.0).any():
            raise ValueError(f"{name} must be an error of at least 0, got {array.min()}.")
    headroom = np.where(n > o, n - o, np.nan)
    return (n - v) / headroom


def _squared(value: ArrayLike, runs: bool = False) -> Array:
    error = real_array("squared", value, finite=False)
    if error.ndim == 0 or error.size == 0 or (runs and error.ndim != 2):
        raise ValueError(
            f"squared must have shape {'(N, T)' if runs else '(..., T)'} and hold at least one "
            f"error, got {error.shape}: pass what squared_error returns."
        )
    if (error < 0.0).any():
        raise ValueError(
            f"squared must not be negative, got {np.nanmin(error)}: pass squared_error."
        )
    return error


def _mean_scored(error: Array, axis: int | None) -> Array:
    """Mean over what is scored (not NaN)."""
    scored = ~np.isnan(error)
    count = scored.sum(axis=axis)
    if not (count > 0).all():
        raise ValueError(
            "squared holds a run or a time without a single scored sample: leave it out."
        )
    return np.asarray(np.where(scored, error, 0.0).sum(axis=axis) / count)


def runs_of(field: str, value: ArrayLike) -> Array:
    """`value` as (N,), N at least 1: one number per run, not necessarily finite."""
    array = real_array(field, value, finite=False)
    if array.ndim != 1 or len(array) == 0:
        raise ValueError(f"{field} must have shape (N,), one number per run, got {array.shape}.")
    return array


def per_run(field: str, value: ArrayLike, runs: Array) -> Array:
    """`value` as a number or (N,), as long as `runs`."""
    array = real_array(field, value, finite=False)
    if array.shape not in ((), runs.shape):
        raise ValueError(f"{field} must have one entry per run, {runs.shape}, got {array.shape}.")
    return array


def share(field: str, value: float) -> float:
    """`value` as a float; ValueError unless it lies in 0..1."""
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"{field} must lie in 0..1, got {value}.")
    return float(value)
