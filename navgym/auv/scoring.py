"""What an AUV's estimates are judged by: position, or what is measured next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.metrics.consistency import nees as normalised
from navgym.metrics.errors import run_rmse, squared_error
from navgym.problem import Run, Span
from navgym.statespace.batch import StateSpaceBatch

WHOLE: Span = (0.0, 1.0)


def errors(
    batch: StateSpaceBatch, states: Array, names: Sequence[str], span: Span = WHOLE
) -> dict[str, Array]:
    """Position RMSE of each run (N,), m, infinite after a failure; see `Scoring.errors`."""
    each = run_rmse(squared(batch, states, "rmse", span))
    return dict.fromkeys(names, each)


def squared(batch: StateSpaceBatch, states: Array, name: str, span: Span = WHOLE) -> Array:  # noqa: ARG001
    """Squared position error (N, T) in m² of states (N, T, n); NaN where not scored.

    Raises ValueError for recordings without truth.
    """
    if batch.truth is None:
        raise ValueError(
            "errors need recordings with truth to score against: set truth=, or measure "
            "by likelihood, which needs none."
        )
    each = squared_error(states, batch.truth, batch.position)
    return each if span == WHOLE else np.where(scored(batch, span), each, np.nan)


def scored(batch: StateSpaceBatch, span: Span) -> NDArray[np.bool_]:
    """Which samples (N, T) are judged."""
    first, last = (np.round(share * batch.lengths)[:, None] for share in span)
    k = np.arange(batch.steps)
    return (k >= first) & (k < last)


def nees(batch: StateSpaceBatch, run: Run) -> Array:
    """Normalised error squared of all states per degree of freedom, (N, T)."""
    assert batch.truth is not None
    found: Array = normalised(run.states, run.covariances, batch.truth) / run.states.shape[-1]
    return found


def rows(batch: StateSpaceBatch) -> dict[str, Array]:
    """Innovations (N, m) that are of position fixes, and of velocities, by name; see `Scoring.rows`.

    A row is of a position if it sees a state that is one, and of a velocity if it sees velocities only.
    A nonlinear model's ranges and bearings are neither.
    """
    if not batch.linear:
        return {}
    seen = (batch.models["H"] != 0.0).any(axis=1)  # (N, m, n)
    moving = list(batch.recordings[0].model.velocity) if batch.recordings else []
    fixes = seen[..., list(batch.position)].any(axis=-1)
    found = {"fixes": fixes, "velocities": seen[..., moving].any(axis=-1) & ~fixes}
    received = ~batch.lost.all(axis=1)
    return {
        name: mask.astype(np.float64)
        for name, mask in found.items()
        if (mask & received).any(axis=1).all()
    }
