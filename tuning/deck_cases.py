"""Deck recordings that candidates are tried on, and the errors that they make there."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym._checks import Array
from navgym.deck_batch import DeckBatch
from navgym.deck_estimation import run_deck
from navgym.dual_imu import DualIMURecording
from navgym.filters.catalogue import Filter
from navgym.metrics import PairedDifference, paired_difference
from navgym.metrics.deck import START, DeckErrors, deck_errors
from navgym.scenarios import seeds
from navgym.simulation import simulate_many
from tuning.measures import QUANTITIES, innovation_quantities
from tuning.recipes import Recipe, remake, travelling


@dataclass(frozen=True, eq=False)
class DeckCases:
    """Mechanised recordings, and where they come from.

    Args:
        batch: the recordings.
        about: provenance as JSON can hold it: scenario, seeds, overrides.
        recipe: how they were made, if they can be made again; see `tuning.recipes`.
    """

    batch: DeckBatch
    about: Mapping[str, Any] = field(default_factory=dict)
    recipe: Recipe | None = None

    half = "deck"
    plain = "alignment"  # needs no tuning: without correntropy
    bound_filter = "oracle"

    def __reduce_ex__(self, protocol: Any) -> Any:
        return super().__reduce_ex__(protocol) if self.recipe is None else (remake, (self.recipe,))

    @classmethod
    def of(
        cls, recordings: Sequence[DualIMURecording], about: Mapping[str, Any] | None = None
    ) -> DeckCases:
        """Mechanise `recordings`, which share one filter step."""
        return cls(DeckBatch.of(recordings), dict(about or {}))

    @classmethod
    def simulated(
        cls, scenario: str, split: str, count: int, start: int = 0, **overrides: Any
    ) -> DeckCases:
        """`count` recordings of `scenario` from the seeds of `split`, from its `start`-th on."""
        return _simulated(scenario, split, count, start, **overrides)

    def __len__(self) -> int:
        return len(self.batch)

    @property
    def samples(self) -> int:
        """Filter steps of one pass over all recordings."""
        return int(self.batch.lengths.sum())

    @property
    def has_truth(self) -> bool:
        """Whether errors can be computed."""
        return self.batch.truth is not None

    @property
    def regimes(self) -> tuple[str, ...]:
        """Names of the true regimes; empty where they are not known."""
        known = all(r.regime is not None for r in self.recordings)
        return tuple(self.recordings[0].meta.get("regimes", ())) if known else ()

    def take(self, which: Sequence[int] | NDArray[np.int64]) -> DeckCases:
        """Some of the recordings, in the order of `which`."""
        return DeckCases(self.batch.take(which), self.about)

    def quantities(
        self,
        filter_name: str,
        parameters: Any,
        names: Sequence[str],
        decision_interval: int | None = None,
    ) -> tuple[dict[str, Array], NDArray[np.bool_]]:
        """Quantities (see `tuning.measures`) of each run (N,), and the filter's flags (N,)."""
        blind = [name for name in names if not QUANTITIES[name].needs_truth]
        made: dict[str, Array] = {}
        flags = np.zeros(len(self), dtype=np.bool_)
        if len(blind) < len(names):
            found = run_deck(filter_name, self.batch, parameters, decision_interval)
            errors = deck_errors(self.batch, found["states"], attitude="attitude" in names)
            made |= errors.norm
            flags |= found["diverged"]
        if blind:
            own, failed = self._innovations(filter_name, parameters, decision_interval)
            made |= own
            flags |= failed
        return {name: made[name] for name in names}, flags

    def _innovations(
        self, filter_name: str, parameters: Any, decision_interval: int | None
    ) -> tuple[dict[str, Array], NDArray[np.bool_]]:
        """What innovations say, run by run: with their covariances all runs would fill gigabytes."""
        first = round(START / self.batch.step)
        rows, flags = [], []
        for i in range(len(self)):
            own = parameters[i] if isinstance(parameters, list) else parameters
            one = self.batch.take([i])
            found = run_deck(filter_name, one, own, decision_interval, everything=True)
            wide = found["wide"][:, first:]
            components = np.isfinite(wide[..., :6]).sum(axis=-1)
            rows.append(innovation_quantities(wide[..., 16], wide[..., 15], components))
            flags.append(bool(found["diverged"][0]))
        joined = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
        return joined, np.array(flags)

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
        """A parameter's schedule (N, K): `values` by the true regime of each step, `delay` s late.

        For runs of `decision_interval` 1.
        """
        regime = np.nan_to_num(self.batch.tapes["regime"]).astype(np.int64)
        late = np.maximum(np.arange(regime.shape[1]) - round(delay / self.batch.step), 0)
        chosen: Array = np.asarray(values, dtype=np.float64)[regime[:, late]]
        return chosen


@travelling
def _simulated(scenario: str, split: str, count: int, start: int, **overrides: Any) -> DeckCases:
    chosen = seeds(split, count, start)
    about: dict[str, Any] = {
        "scenario": scenario, "split": split, "seeds": [chosen.start, chosen.stop - 1],
    }  # fmt: skip
    if overrides:
        about["overrides"] = {name: repr(value) for name, value in overrides.items()}
    return DeckCases.of(simulate_many(scenario, chosen, **overrides), about)


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
