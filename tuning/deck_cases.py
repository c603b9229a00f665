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
from navgym.metrics.deck import START, DeckErrors, deck_errors, run_errors
from navgym.scenarios import seeds
from navgym.simulation import simulate_many
from tuning.measures import QUANTITIES, Judged, innovation_quantities
from tuning.recipes import Recipe, remake, travelling


@dataclass(frozen=True, eq=False)
class DeckCases:
    """Mechanised recordings, and where they come from.

    Args:
        batch: the recordings.
        about: provenance as JSON can hold it: scenario, seeds, overrides.
        span: shares of each recording's steps between which innovations are judged; errors against
            the truth always count whole.
        recipe: how they were made, if they can be made again; see `tuning.recipes`.
    """

    batch: DeckBatch
    about: Mapping[str, Any] = field(default_factory=dict)
    span: tuple[float, float] = (0.0, 1.0)
    recipe: Recipe | None = None

    half = "deck"
    plain = "alignment"  # needs no tuning: without correntropy
    bound_filter = "oracle"

    def __reduce_ex__(self, protocol: Any) -> Any:
        return super().__reduce_ex__(protocol) if self.recipe is None else (remake, (self.recipe,))

    @classmethod
    def of(
        cls,
        recordings: Sequence[DualIMURecording],
        about: Mapping[str, Any] | None = None,
        span: tuple[float, float] = (0.0, 1.0),
    ) -> DeckCases:
        """Mechanise `recordings`, which share one filter step."""
        return cls(DeckBatch.of(recordings), dict(about or {}), span)

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
        return DeckCases(self.batch.take(which), self.about, self.span)

    def judge(
        self,
        filter_name: str,
        parameters: Any,
        names: Sequence[str],
        decision_interval: int | None = None,
    ) -> Judged:
        """Run a filter over every recording; its quantities (see `tuning.measures`) by `names`."""
        made: dict[str, Array] = {}
        flags = np.zeros(len(self), dtype=np.bool_)
        spent = 0.0
        if any(QUANTITIES[name].needs_truth for name in names):
            tried = self.try_out(
                filter_name, parameters, decision_interval, attitude="attitude" in names
            )
            made |= tried.errors.norm
            flags |= tried.diverged.astype(np.bool_)
            spent += tried.microseconds
        if not all(QUANTITIES[name].needs_truth for name in names):
            own = self._innovations(filter_name, parameters, decision_interval)
            made |= own.quantities
            flags |= own.flags
            spent += own.microseconds
        return Judged({name: made[name] for name in names}, flags, spent)

    def _innovations(
        self, filter_name: str, parameters: Any, decision_interval: int | None
    ) -> Judged:
        """What innovations say, run by run: with their covariances all runs would fill gigabytes."""
        rows, flags = [], []
        began = time.perf_counter()
        for i in range(len(self)):
            report, diverged = self._report(i, filter_name, parameters, decision_interval)
            judged = report[:, self._scored(i)]
            components = np.isfinite(judged["innovation"]).sum(axis=-1)
            rows.append(innovation_quantities(judged["log_likelihood"], judged["nis"], components))
            flags.append(diverged)
        spent = 1e6 * (time.perf_counter() - began) / self.samples
        joined = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
        return Judged(joined, np.array(flags), spent)

    def _report(
        self, i: int, filter_name: str, parameters: Any, decision_interval: int | None
    ) -> tuple[NDArray[Any], bool]:
        """What belongs to each innovation of recording i, `alignment.REPORT` (1, K), and whether the filter diverged."""
        own = [parameters[i]] if isinstance(parameters, list) else parameters
        found = run_deck(filter_name, self.batch.take([i]), own, decision_interval, everything=True)
        return found["report"], bool(found["diverged"][0])

    def _scored(self, i: int) -> slice:
        """The steps of recording i whose innovations are judged, its alignment left out."""
        length = int(self.batch.lengths[i])
        first, last = (round(share * length) for share in self.span)
        first = max(first, round(START / self.batch.step))
        if first >= last:
            raise ValueError(
                f"recordings must be longer than the {START:g} s that are not scored, got "
                f"{last * self.batch.step:g} s."
            )
        return slice(first, last)

    def trace(
        self, filter_name: str, parameters: Any, name: str, decision_interval: int | None = None
    ) -> Array:
        """A quantity over time, (N, K): squared lengths of errors in arcmin² (of θ̇: (arcmin/s)²), or
        what each step's innovation adds to "nll" or its NIS, per component; NaN past an end.
        """
        count, steps = self.batch.tapes.shape
        found = np.full((count, steps), np.nan)
        states: Array | None = None
        if QUANTITIES[name].needs_truth:
            states = run_deck(filter_name, self.batch, parameters, decision_interval)["states"]
        for i, length in enumerate(self.batch.lengths):
            if states is None:
                report, _ = self._report(i, filter_name, parameters, decision_interval)
                told = report[0, :length]
                heard = np.isfinite(told["innovation"]).sum(axis=-1)
                each = -told["log_likelihood"] if name == "nll" else told["nis"]
                found[i, :length] = each / np.where(heard > 0, heard, np.nan)
            else:
                errors = run_errors(self.batch, i, states[i, :length], name == "attitude")
                found[i, :length] = (errors[name] ** 2).sum(axis=1)
        return found

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
