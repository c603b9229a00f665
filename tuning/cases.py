"""The recordings that candidates are tried on, and the errors that they make there."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.core.seeds import seeds
from navgym.metrics.consistency import Consistency, per_degree
from navgym.metrics.measures import (
    NIS,
    NLL,
    ONE_STEP,
    Judged,
    Quantity,
    bounded,
    cut_squares,
    innovation_quantities,
    one_step_error,
    spreads,
)
from navgym.problem import Filter, Problem, Run, problem_of
from navgym.simulation import find_scenario, simulate_many
from navgym.tuning.study.recipes import Recipe, remake, travelling

JUDGED = 8  # recordings whose covariances are looked at where few fit into memory


@dataclass(frozen=True, eq=False)
class Cases:
    """Recordings of one problem, stacked, and where they come from.

    Args:
        problem: what they are recordings of.
        batch: the stacked recordings.
        about: provenance as JSON can hold it: scenario, seeds, overrides.
        span: shares of each recording between which it is scored, 0 to 1.
        recipe: how they were made, if they can be made again; see `navgym.tuning.study.recipes`.
        spread: (N, m) robust deviation of each row's innovations of the plain filter, if it is known
            already.
    """

    problem: Problem
    batch: Any
    about: Mapping[str, Any] = field(default_factory=dict)
    span: tuple[float, float] = (0.0, 1.0)
    recipe: Recipe | None = None
    spread: Array | None = None

    def __reduce_ex__(self, protocol: Any) -> Any:
        return super().__reduce_ex__(protocol) if self.recipe is None else (remake, (self.recipe,))

    @classmethod
    def of(
        cls,
        recordings: Sequence[Any],
        about: Mapping[str, Any] | None = None,
        span: tuple[float, float] = (0.0, 1.0),
    ) -> Cases:
        """Stack `recordings` of one problem; ValueError if there is none, or if they do not fit together."""
        if not recordings:
            raise ValueError("recordings must hold at least one recording, got none.")
        problem = problem_of(recordings[0])
        return cls(problem, problem.stack(recordings), dict(about or {}), span)

    @classmethod
    def simulated(
        cls,
        scenario: str,
        split: str,
        count: int,
        start: int = 0,
        steps: int | None = None,
        **overrides: Any,
    ) -> Cases:
        """`count` recordings of `scenario` from the seeds of `split`, from its `start`-th on.

        `steps` is for scenarios whose length is counted in samples.
        """
        return _simulated(scenario, split, count, start, steps, **overrides)

    def __len__(self) -> int:
        return len(self.batch)

    @property
    def recordings(self) -> Sequence[Any]:
        """What was stacked, for regimes and plots."""
        found: Sequence[Any] = self.batch.recordings
        return found

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
        return tuple(self.recordings[0].meta.get("regimes", ())) if self.batch.regimes() else ()

    @property
    def plain(self) -> str:
        """The filter that needs no tuning, for these recordings' models."""
        return self.problem.plain_filter(self.batch)

    @property
    def first_quantity(self) -> str:
        """Name of the error that counts."""
        return next(iter(self.problem.scoring.quantities))

    def space(self, filter_name: str | Filter) -> ParameterSpace:
        """What can be tuned in a filter on these recordings: its own, and their sensors' noise."""
        return self.problem.space(filter_name, self.batch)

    def take(self, which: Sequence[int] | NDArray[np.int64]) -> Cases:
        """Some of the recordings, in the order of `which`."""
        known = self.__dict__.get("spreads", self.spread)
        part = None if known is None else known[np.asarray(which, dtype=np.int64)]
        return replace(self, batch=self.batch.take(which), recipe=None, spread=part)

    # ---- what recordings without truth are judged by

    @cached_property
    def rows(self) -> Mapping[str, Array]:
        """Factors (N, m) of innovations by one-step error, of those that these recordings have."""
        return self.problem.scoring.rows(self.batch)

    @property
    def foretold(self) -> Quantity:
        """The one-step error that counts where no truth is known."""
        known = self.problem.scoring.foretold
        return next((known[name] for name in known if name in self.rows), ONE_STEP)

    @cached_property
    def spreads(self) -> Array:
        """Robust deviation (N, m) of each row's innovations of the plain filter at its defaults, over the
        whole of each recording: the same for every filter, parameter and span.
        """
        if self.spread is not None:
            return self.spread
        scoring, found = self.problem.scoring, []
        for part, _ in self._parts(None):
            run = self.problem.run(part.plain, part.batch, None, everything=True)
            judged = scoring.scored(part.batch, (0.0, 1.0))[..., None]
            found.append(spreads(np.where(judged, run.innovations, np.nan)))
        return np.concatenate(found)

    def _step(self, name: str) -> tuple[Array, Array]:
        """Factors (N, m), and most that an innovation may count as, of a one-step error."""
        if name == ONE_STEP.name:
            factors = 1.0 / self.spreads  # a share of each row: 1 for normal innovations
            used = np.maximum((factors > 0.0).sum(axis=1, keepdims=True), 1)
            return factors / np.sqrt(used), ONE_STEP.clip * self.spreads
        quantity = self.problem.scoring.foretold[name]
        if name not in self.rows:
            raise ValueError(
                f"measure {name!r} needs {quantity.label.removeprefix('one-step error of ')}, of which "
                f"these recordings hold none: use {self.foretold.name!r}."
            )
        most = quantity.clip * self.spreads if np.isfinite(quantity.clip) else np.inf
        return self.rows[name], np.broadcast_to(most, self.rows[name].shape)

    def _is_blind(self, name: str) -> bool:
        """Whether a quantity needs no truth."""
        return name in (NLL.name, NIS.name, ONE_STEP.name) or name in self.problem.scoring.foretold

    def by_regime(self, values: Sequence[float], delay: float = 0.0) -> list[Array]:
        """A parameter's schedule per recording: `values` by the true regime of each step, `delay` s late.

        For runs of `decision_interval` 1.
        """
        late, table = round(delay / self.batch.step), np.asarray(values, dtype=np.float64)
        return [
            table[labels[np.maximum(np.arange(len(labels)) - late, 0)]]
            for labels in self.batch.regimes()
        ]

    # ---- judging

    def judge(
        self,
        filter_name: str,
        parameters: Any,
        names: Sequence[str],
        decision_interval: int | None = None,
    ) -> Judged:
        """Run a filter over every recording; its quantities by `names`.

        Args:
            filter_name: one of the problem's.
            parameters: as in `Problem.run`.
            names: of the problem's quantities, or such that need no truth.
            decision_interval: filter steps per row of a schedule; the batch's own by default.

        Raises ValueError where a quantity needs a truth that the recordings lack.
        """
        blind = [name for name in names if self._is_blind(name)]
        seen = [name for name in names if name not in blind]
        told = (filter_name, parameters, decision_interval)
        if self.problem.scoring.at_once is None:  # one run tells all
            parts = [self._judged(*told, seen, blind)]
        else:
            parts = [self._judged(*told, seen, [])] if seen else []
            parts += [self._a_few_at_a_time(*told, blind)] if blind else []
        made = {name: each for part in parts for name, each in part.quantities.items()}
        flags = np.any([part.flags for part in parts], axis=0)
        spent = sum(part.microseconds for part in parts)
        return Judged({name: made[name] for name in names}, flags, spent)

    def _judged(
        self,
        filter_name: str,
        parameters: Any,
        decision_interval: int | None,
        seen: Sequence[str],
        blind: Sequence[str],
    ) -> Judged:
        """Quantities of one run over all recordings: those that see the truth, and those that do not."""
        began = time.perf_counter()
        run = self.problem.run(
            filter_name, self.batch, parameters, decision_interval, everything=bool(blind)
        )
        spent = 1e6 * (time.perf_counter() - began) / self.samples
        made: dict[str, Array] = {}
        if seen:
            made |= self.problem.scoring.errors(self.batch, run.states, seen, self.span)
        if blind:
            made |= self._innovations(run, blind)
        return Judged(made, run.diverged.astype(np.bool_), spent)

    def _a_few_at_a_time(
        self,
        filter_name: str,
        parameters: Any,
        decision_interval: int | None,
        blind: Sequence[str],
    ) -> Judged:
        """What innovations say, `at_once` recordings at a time: all covariances would fill gigabytes."""
        rows = [
            (part.samples, part._judged(filter_name, own, decision_interval, (), blind))
            for part, own in self._parts(parameters)
        ]
        return Judged(
            {name: np.concatenate([r.quantities[name] for _, r in rows]) for name in blind},
            np.concatenate([r.flags for _, r in rows]),
            sum(samples * r.microseconds for samples, r in rows) / self.samples,
        )

    def _parts(self, parameters: Any) -> Iterator[tuple[Cases, Any]]:
        """As many recordings as may be in memory at once, with their parameters."""
        most = self.problem.scoring.at_once
        if most is None:
            yield self, parameters
            return
        for first in range(0, len(self), most):
            which = range(first, min(first + most, len(self)))
            listed = isinstance(parameters, list)
            yield self.take(which), [parameters[i] for i in which] if listed else parameters

    def _innovations(self, run: Run, names: Sequence[str]) -> dict[str, Array]:
        """What the innovations of a run say by `names`, where they are judged."""
        scoring = self.problem.scoring
        judged = scoring.scored(self.batch, self.span)
        made = {n: self._one_step(run, n, judged) for n in names if n not in (NLL.name, NIS.name)}
        if len(made) == len(names):
            return made
        logs, nis = (np.where(judged, each, np.nan) for each in (run.log_likelihood, run.nis))
        components = run.components
        if scoring.at_once is not None:  # few recordings: nothing is added up before and after
            inside = np.flatnonzero(judged.any(axis=0))
            cut = slice(inside[0], inside[-1] + 1)
            logs, nis, components = logs[:, cut], nis[:, cut], components[:, cut]
        found = made | innovation_quantities(logs, nis, components)
        return {name: found[name] for name in names}

    def _one_step(self, run: Run, name: str, judged: NDArray[np.bool_]) -> Array:
        """A one-step error of each run (N,), infinite where a filter failed on the way."""
        factors, most = self._step(name)
        heard = np.where(judged[..., None], run.innovations, np.nan)
        failed = (judged & ~np.isfinite(run.states).all(axis=-1)).any(axis=1)
        return np.where(failed, np.inf, one_step_error(cut_squares(heard, factors, most)))

    def trace(
        self, filter_name: str, parameters: Any, name: str, decision_interval: int | None = None
    ) -> Array:
        """A quantity over time, (N, T): squared errors, or what each step's innovation adds to "nll" or
        its NIS, per component; NaN where there is nothing to judge.
        """
        scoring = self.problem.scoring
        if not self._is_blind(name):
            run = self.problem.run(filter_name, self.batch, parameters, decision_interval)
            return scoring.squared(self.batch, run.states, name, self.span)
        rows = []
        for part, own in self._parts(parameters):
            run = self.problem.run(filter_name, part.batch, own, decision_interval, everything=True)
            if scoring.settling:  # how a filter settles is worth seeing, though it is not judged
                shown = np.arange(part.batch.steps) < part.batch.lengths[:, None]
            else:
                shown = scoring.scored(part.batch, self.span)
            rows.append(np.where(shown, part._each(run, name), np.nan))
        return np.concatenate(rows)

    def _each(self, run: Run, name: str) -> Array:
        """What each step adds to a quantity that needs no truth, (N, T); NaN where nothing was heard."""
        if name in (NLL.name, NIS.name):
            each = -run.log_likelihood if name == NLL.name else run.nis
            return np.where(run.components > 0, each, np.nan) / np.maximum(run.components, 1)
        squares = cut_squares(run.innovations, *self._step(name))
        known = np.isfinite(squares)
        return np.where(known.any(axis=-1), np.where(known, squares, 0.0).sum(axis=-1), np.nan)

    def foretold_errors(self, run: Run) -> Array:
        """One-step error (N,) of what counts where no truth is known, of a run with everything in it."""
        judged = self.problem.scoring.scored(self.batch, self.span)
        return self._one_step(run, self.foretold.name, judged)

    def true_errors(self, run: Run) -> Array:
        """The error that counts (N,) of a run, against the truth."""
        name = self.first_quantity
        found: Array = self.problem.scoring.errors(self.batch, run.states, (name,), self.span)[name]
        return found

    # ---- whether covariances tell the truth

    def consistency(
        self, filter_name: str, parameters: Any, decision_interval: int | None = None
    ) -> tuple[Consistency | None, Consistency | None]:
        """Mean NIS, and mean NEES where the truth is known, per degree of freedom with their bands.

        Of decks the first `JUDGED` recordings are looked at. None where a filter failed at once.
        """
        scoring, done = self.problem.scoring, 0
        told: list[tuple[Any, Any, Any, int]] = []
        for part, own in self._parts(parameters):
            if done >= JUDGED and scoring.at_once is not None:
                break
            run = self.problem.run(filter_name, part.batch, own, decision_interval, everything=True)
            judged = scoring.scored(part.batch, self.span)
            nis = np.where(judged & (run.components > 0), run.nis, np.nan)
            nees = np.full_like(nis, np.nan)
            if part.has_truth:
                nees = np.where(judged, scoring.nees(part.batch, run), np.nan)
            told.append((nis.ravel(), run.components.ravel(), nees.ravel(), len(part)))
            done += len(part)
        nis, dof, nees = (np.concatenate([t[i] for t in told]) for i in range(3))
        size = self._judged_states()
        return _judge(nis, dof), _judge(nees * size, np.full(len(nees), size), done * size)

    def _judged_states(self) -> int:
        """How many states the truth, and so NEES, is about."""
        return 1 if self.batch.truth is None else int(self.batch.truth.shape[-1])

    # ---- the error that counts

    def errors(
        self, filter_name: str, parameters: Any = None, decision_interval: int | None = None
    ) -> tuple[Array, NDArray[np.bool_]]:
        """The first quantity of each run (N,), infinite after a failure, and the filter's flags."""
        name = self.first_quantity
        found = self.judge(filter_name, parameters, (name,), decision_interval)
        return found.quantities[name], found.flags

    def bounded_errors(
        self,
        filter_name: str,
        parameters: Any,
        plain: Array,
        decision_interval: int | None = None,
    ) -> Array:
        """The first quantity of each run (N,), a diverged run at its ceiling: see `bounded`."""
        name = self.first_quantity
        found = self.judge(filter_name, parameters, (name,), decision_interval)
        return bounded(found, {name: plain}, self.problem.scoring.quantities)[name]

    def plain_errors(self) -> Array:
        """The first quantity of each run (N,) of the filter that needs no tuning."""
        return self.errors(self.plain)[0]


def _judge(squares: Array, dof: Any, independent: float | None = None) -> Consistency | None:
    known = np.isfinite(squares) & (np.asarray(dof) > 0)
    if not known.any():
        return None
    return per_degree(squares[known], np.asarray(dof)[known], independent=independent)


@travelling
def _simulated(
    scenario: str, split: str, count: int, start: int, steps: int | None, **overrides: Any
) -> Cases:
    chosen = seeds(split, count, start)
    found = find_scenario(scenario, **overrides)
    about: dict[str, Any] = {"scenario": scenario}
    if hasattr(found, "steps"):
        about["steps"] = found.steps if steps is None else steps
    about |= {"split": split, "seeds": [chosen.start, chosen.stop - 1]}
    if overrides:
        about["overrides"] = {name: repr(value) for name, value in overrides.items()}
    return Cases.of(simulate_many(scenario, chosen, steps, **overrides), about)
