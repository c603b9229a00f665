"""Deck recordings that candidates are tried on, and the errors that they make there."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from navgym._checks import Array
from navgym.deck_batch import DeckBatch
from navgym.deck_estimation import run_deck
from navgym.dual_imu import DualIMURecording
from navgym.filters.catalogue import Filter
from navgym.metrics import PairedDifference, paired_difference
from navgym.metrics.deck import DeckErrors, deck_errors
from navgym.scenarios import seeds
from navgym.simulation import simulate_many


@dataclass(frozen=True, eq=False)
class DeckCases:
    """Mechanised recordings with truth, and where they come from.

    Args:
        batch: the recordings.
        about: provenance as JSON can hold it: scenario, seeds, overrides.
    """

    batch: DeckBatch
    about: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def simulated(
        cls, scenario: str, split: str, count: int, start: int = 0, **overrides: Any
    ) -> DeckCases:
        """`count` recordings of `scenario` from the seeds of `split`, from its `start`-th on."""
        chosen = seeds(split, count, start)
        about: dict[str, Any] = {
            "scenario": scenario, "split": split, "seeds": [chosen.start, chosen.stop - 1],
        }  # fmt: skip
        if overrides:
            about["overrides"] = {name: repr(value) for name, value in overrides.items()}
        return cls(DeckBatch.of(simulate_many(scenario, chosen, **overrides)), about)

    @property
    def recordings(self) -> Sequence[DualIMURecording]:
        """What the batch was made of."""
        return self.batch.recordings

    def try_out(
        self,
        filter_name: str | Filter,
        parameters: Any = None,
        decision_interval: int | None = None,
        attitude: bool = True,
    ) -> Trial:
        """Run a filter over every recording and score it."""
        began = time.perf_counter()
        found = run_deck(filter_name, self.batch, parameters, decision_interval)
        spent = time.perf_counter() - began
        errors = deck_errors(self.batch, found["states"], attitude=attitude)
        steps = int(self.batch.lengths.sum())
        return Trial(errors, found["diverged"], found["flexures"], 1e6 * spent / steps)

    def by_regime(self, values: Sequence[float], delay: float = 0.0) -> Array:
        """A parameter's schedule (N, K): `values` by the true regime of each step, `delay` s late."""
        regime = np.nan_to_num(self.batch.tapes["regime"]).astype(np.int64)
        late = np.maximum(np.arange(regime.shape[1]) - round(delay / self.batch.step), 0)
        chosen: Array = np.asarray(values, dtype=np.float64)[regime[:, late]]
        return chosen


@dataclass(frozen=True, eq=False)
class Trial:
    """What one filter did on the cases.

    Args:
        errors: by quantity, axis and run.
        diverged: (N,) flags.
        flexures: models identified on the way, per run.
        microseconds: per filter step, everything included.
    """

    errors: DeckErrors
    diverged: Array
    flexures: Sequence[Any]
    microseconds: float

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

    def against(self, other: Trial, quantity: str, axis: int | None = None) -> PairedDifference:
        """Paired difference of this trial less another one on the same recordings."""
        return paired_difference(self.each(quantity, axis), other.each(quantity, axis))
