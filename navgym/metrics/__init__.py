"""Errors, consistency, bounds and comparisons: what estimates are judged by.

A run whose filter failed counts as infinitely wrong: it enters medians and quantiles at its rank,
while means become infinite instead of flattering. Where means are reported, the median and the
rate of divergence stand beside them.
"""

from navgym.metrics.bounds import (
    LossBounds,
    SteadyState,
    critical_arrival_rate,
    loss_bounds,
    rms,
    steady_state,
)
from navgym.metrics.comparison import PairedDifference, holm, paired_difference
from navgym.metrics.consistency import (
    Consistency,
    consistency,
    degrees_of_freedom,
    mean_nis_band,
    nees,
    nis_band,
    per_degree,
)
from navgym.metrics.errors import (
    DIVERGED_MULTIPLE,
    ErrorSummary,
    divergence,
    run_rmse,
    score,
    squared_error,
    summarize,
    time_rmse,
)
from navgym.metrics.whiteness import Whiteness, whiteness

__all__ = [
    "DIVERGED_MULTIPLE", "Consistency", "ErrorSummary", "LossBounds", "PairedDifference",
    "SteadyState", "Whiteness", "consistency", "critical_arrival_rate", "degrees_of_freedom", "divergence",
    "holm", "loss_bounds", "mean_nis_band", "nees", "nis_band", "paired_difference", "per_degree", "rms",
    "run_rmse", "score", "squared_error", "steady_state", "summarize", "time_rmse",
    "whiteness",
]  # fmt: skip
