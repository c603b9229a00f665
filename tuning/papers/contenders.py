"""Who runs in the AUV's demonstration and reproduction beside what is tuned there."""

from __future__ import annotations

import numpy as np

import navgym
from navgym.auv.problem import PROBLEM
from navgym.core.checks import Array
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters.modes import MODE_SETS, Modes, Structure
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
    """The bank's probability (T,) of what it takes for nominal, for outliers and for a manoeuvre.

    A manoeuvre that has outliers, too, counts as a manoeuvre.
    """
    weights = navgym.estimate("bank", recording).extras["regimes"]
    regimes = Modes.of(MODE_SETS["bank"], Structure.of(StateSpaceBatch.of([recording]))).regimes
    pushed = np.array([r.process > 1.0 for r in regimes])
    outlying = np.array([r.outliers for r in regimes]) & ~pushed
    kinds = {"nominal": ~pushed & ~outlying, "outlier": outlying, "manoeuvre": pushed}
    return {name: weights[:, own].sum(axis=1) for name, own in kinds.items()}
