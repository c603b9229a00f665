"""Errors of deck filters by axis, as the reproduction of IDAM tells them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.deck.errors import DeckErrors, deck_errors
from navgym.deck.recording import DualIMURecording
from navgym.inertial.flexure import FlexureModel
from navgym.metrics import PairedDifference, paired_difference
from navgym.problem import Filter
from navgym.tuning.cases import Cases

AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class Performance:
    """What one filter did on the cases.

    Args:
        errors: by quantity, axis and run.
        diverged: (N,) flags.
        flexures: models identified on the way, per run.
        microseconds: per filter step, everything included.
        first: (K, 24) states on the first recording, for figures over time.
    """

    errors: DeckErrors
    diverged: NDArray[np.bool_]
    flexures: Sequence[Any]
    microseconds: float
    first: Array

    def mean(self, quantity: str, axis: int | None = None) -> float:
        """Mean over runs of the RMSE of a quantity: of its length, or of one axis."""
        return float(self.each(quantity, axis).mean())

    def half(self, quantity: str, axis: int | None = None) -> float:
        """Half-width of the mean's 95 % interval."""
        each = self.each(quantity, axis)
        return float(1.96 * each.std(ddof=1) / np.sqrt(len(each))) if len(each) > 1 else np.inf

    def each(self, quantity: str, axis: int | None = None) -> Array:
        """(N,) RMSE of every run."""
        chosen = self.errors.norm[quantity] if axis is None else self.errors.axes[quantity][:, axis]
        found: Array = np.asarray(chosen)
        return found

    def against(
        self, other: Performance, quantity: str, axis: int | None = None
    ) -> PairedDifference:
        """Paired difference of this filter less another one on the same recordings."""
        return paired_difference(self.each(quantity, axis), other.each(quantity, axis))


def try_out(
    cases: Cases,
    filter_name: str | Filter,
    parameters: Any = None,
    decision_interval: int | None = None,
    attitude: bool = True,
) -> Performance:
    """Run a filter over every recording and score it; `attitude` takes longer."""
    began = time.perf_counter()
    run = cases.problem.run(filter_name, cases.batch, parameters, decision_interval)
    spent = time.perf_counter() - began
    errors = deck_errors(cases.batch, run.states, attitude=attitude)
    first = run.states[0, : cases.batch.lengths[0]].copy()
    pace = 1e6 * spent / cases.samples
    return Performance(errors, run.diverged, run.extras["flexures"], pace, first)


def with_flexure(recording: DualIMURecording, flexure: FlexureModel) -> DualIMURecording:
    """The same recording for a filter that believes another flexure."""
    model = replace(recording.model, flexure=flexure)
    return replace(recording, model=model, check_units=False)


# ---- as text and JSON


def shown(trial: Performance, quantity: str, axis: int | None = None) -> str:
    """Mean with half its interval."""
    return f"{trial.mean(quantity, axis):.2f} ± {trial.half(quantity, axis):.2f}"


def gain(trial: Performance, base: Performance, quantity: str) -> str:
    """Paired gain over `base` in per cent, with its 95 % interval."""
    if trial is base:
        return "–"
    g = trial.against(base, quantity)
    return f"{100 * g.relative_gain:+.1f} ({100 * g.gain_low:+.1f} to {100 * g.gain_high:+.1f})"


def summary(trial: Performance) -> dict[str, Any]:
    """A trial as JSON."""
    return {
        "runs": len(trial.diverged),
        "diverged": float(np.mean(trial.diverged)),
        "microseconds": trial.microseconds,
        "mean": {q: _number(trial.mean(q)) for q in trial.errors.norm},
        "axes": {q: [_number(trial.mean(q, a)) for a in range(3)] for q in trial.errors.axes},
    }


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None
