"""Paired comparison of two filters on the same recordings."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from navgym.core.checks import Array, positive_int, real_array
from navgym.metrics.errors import per_run, runs_of, share

RESAMPLES = 9999


@dataclass(frozen=True)
class PairedDifference:
    """Two filters on the same recordings; `a` is better where differences are negative.

    Args:
        pairs: number of recordings.
        mean_difference: mean of a − b.
        low: lower end of its confidence interval.
        high: upper end.
        relative_gain: 1 − mean(a) / mean(b), NaN unless mean(b) is positive.
        gain_low: lower end of its confidence interval.
        gain_high: upper end.
        p_value: of "a and b are exchangeable within pairs", two-sided, by permutation.
        median_difference: median of a − b; stays meaningful when runs fail.
        failed_a: share of runs in which a is not finite.
        failed_b: share of runs in which b is not finite.
    """

    pairs: int
    mean_difference: float
    low: float
    high: float
    relative_gain: float
    gain_low: float
    gain_high: float
    p_value: float
    median_difference: float
    failed_a: float
    failed_b: float


def paired_difference(
    a: ArrayLike,
    b: ArrayLike,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> PairedDifference:
    """Compare per-run errors of two filters on the same recordings.

    Intervals are bias-corrected and accelerated bootstraps over pairs (Efron 1987). The p-value
    comes from flipping the signs of the differences: all 2ⁿ ways for few pairs, else `resamples`
    random ones, counted with the observed one so that the test keeps its level. If a run failed
    (NaN or infinite), means have no meaning: they, their intervals and the p-value are NaN, and
    the median and the rates of failure tell the story.

    Args:
        a: (N,) one error per recording, such as `run_rmse`.
        b: (N,) the same of the filter to compare with, in the same order.
        confidence: of the intervals.
        resamples: of bootstrap and permutation.
        seed: of both; the same seed gives the same answer.

    Raises:
        ValueError: fewer than two pairs, or lists of different lengths.
    """
    x, y = runs_of("a", a), runs_of("b", b)
    per_run("b", y, x)
    if len(x) < 2:
        raise ValueError(f"a and b must hold at least 2 pairs for an interval, got {len(x)}.")
    share("confidence", confidence)
    positive_int("resamples", resamples, least=100)
    failed_a, failed_b = (float((~np.isfinite(v)).mean()) for v in (x, y))
    if failed_a or failed_b:
        unknown = (np.nan,) * 3
        return PairedDifference(
            len(x), *unknown, *unknown, np.nan, _median_difference(x, y), failed_a, failed_b
        )
    rng = np.random.default_rng(seed)
    difference = x - y
    mean = _interval(lambda d, axis: d.mean(axis=axis), (difference,), confidence, resamples, rng)
    gain = _interval(_gain, (x, y), confidence, resamples, rng)
    p = _sign_flip(difference, resamples, rng)
    return PairedDifference(len(x), *mean, *gain, p, float(np.median(difference)), 0.0, 0.0)


def _gain(a: Array, b: Array, axis: int = -1) -> Array:
    """1 − mean(a) / mean(b); 0 for two filters without any error, NaN where b has no scale."""
    above, below = a.mean(axis=axis), b.mean(axis=axis)
    ratio = np.where(above == below, 1.0, np.nan)
    return np.asarray(1.0 - np.divide(above, below, out=ratio, where=below > 0.0))


def _interval(
    statistic: Callable[..., Array],
    data: tuple[Array, ...],
    confidence: float,
    resamples: int,
    rng: np.random.Generator,
) -> tuple[float, float, float]:
    """A statistic of paired data with its BCa interval: (value, low, high)."""
    from scipy import stats  # heavy, and no environment needs it

    value = float(statistic(*data, axis=-1))
    if not np.isfinite(value):
        return np.nan, np.nan, np.nan
    with warnings.catch_warnings():
        # a statistic that no resample changes has no acceleration: it is handled below
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        found = stats.bootstrap(
            data, statistic, paired=True, confidence_level=confidence, n_resamples=resamples,
            method="BCa", batch=1000, rng=rng,
        )  # fmt: skip
    low, high = found.confidence_interval
    if not np.isfinite(low) or not np.isfinite(high):
        tail = (1.0 - confidence) / 2.0
        low, high = np.quantile(found.bootstrap_distribution, [tail, 1.0 - tail])
    return value, float(low), float(high)


def _sign_flip(difference: Array, resamples: int, rng: np.random.Generator) -> float:
    from scipy import stats  # heavy, and no environment needs it

    found = stats.permutation_test(
        (difference,), lambda d, axis: d.mean(axis=axis), permutation_type="samples",
        n_resamples=resamples, batch=1000, rng=rng,
    )  # fmt: skip
    return float(found.pvalue)


def _median_difference(a: Array, b: Array) -> float:
    """Median of a − b where a failure is an infinite error, and two failures are a draw."""
    x, y = (np.where(np.isfinite(v), v, np.inf) for v in (a, b))
    both = np.isinf(x) & np.isinf(y)
    difference = np.where(both, 0.0, np.where(both, 0.0, x) - np.where(both, 0.0, y))
    return float(np.quantile(difference, 0.5, method="lower"))


def holm(p_values: ArrayLike) -> Array:
    """P-values adjusted for making several comparisons, (N,): Holm's step-down procedure.

    Rejecting those below α keeps the chance of any false rejection below α (Holm 1979).
    """
    p = real_array("p_values", p_values)
    if p.ndim != 1 or len(p) == 0 or (p < 0.0).any() or (p > 1.0).any():
        raise ValueError(f"p_values must be a list of numbers in 0..1, got {p_values!r}.")
    order = np.argsort(p, kind="stable")
    stepped = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)), 1.0)
    adjusted = np.empty_like(p)
    adjusted[order] = stepped
    return adjusted
