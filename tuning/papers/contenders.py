"""Who runs in the AUV's demonstration and reproduction beside what is tuned there."""

from __future__ import annotations

import navgym
from navgym.auv.problem import PROBLEM
from navgym.core.checks import Array
from navgym.statespace.recording import Recording
from navgym.tuning.comparison import Entry

# what an untuned reader of the paper would type (it gives none of them)
UNTUNED = {
    "vb_iterations": 10, "prior_count": 5.0, "forgetting": 0.97, "initial_count": 5.0,
    "initial_scale": 1.0, "process_noise_scale": 1.0,
}  # fmt: skip


def linear_filters(simulated: bool) -> list[Entry]:
    """Every filter made for a linear model, at its defaults; the oracle only where truth is known."""
    return [
        Entry(f.name, f.name, bound=f.needs_scales)
        for f in PROBLEM.filters.values()
        if not f.nonlinear and (simulated or not f.needs_scales)
    ]


def nonlinear_filters() -> list[Entry]:
    """Every filter that takes a nonlinear model."""
    return [Entry(f.name, f.name) for f in PROBLEM.filters.values() if f.nonlinear]


def bank_beliefs(recording: Recording) -> dict[str, Array]:
    """The bank's probability (T,) of each of its three regimes."""
    weights = navgym.estimate("bank", recording).extras["weights"].sum(axis=1)
    return dict(zip(("nominal", "outlier", "manoeuvre"), weights.T, strict=True))
