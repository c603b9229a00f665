"""One problem as a place for contests: who takes part, in which conditions, and what it comes to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.agents.combiner.combiner import BANK, Combiner, combines
from navgym.agents.evaluation.baselines import Random, TrueRegime, hand_rule, whole_filters
from navgym.agents.evaluation.contest import (
    AS_TRAINED,
    BEST_FIXED,
    DEFAULT,
    HAND_RULE,
    OTHER,
    OWN,
    RANDOM,
    REAL,
    SHIFT,
    TRUE_REGIME,
    Condition,
    Contender,
    Extent,
    Labels,
    choosing,
    deployed,
    short,
)
from navgym.agents.evaluation.regime_tables import tables
from navgym.agents.evaluation.rollout import Learnt, problem_in
from navgym.agents.mixture.mixture import Mixture
from navgym.agents.policies.policy import Policy
from navgym.core.checks import Array
from navgym.metrics import consistency
from navgym.problem import Problem, Run, Tracks
from navgym.simulation import find_scenario, simulate_many
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Entry
from navgym.tuning.experiments import cross_tuned, per_track, real_cases

TRACK_TRIALS, QUICK_TRIALS = 40, 5  # of the study on the other fold of the tracks


class League:
    """Policies of one environment among everybody else who estimates.

    Args:
        environment: its id.
        policies: of that environment, by label.
        own: conditions that policies are judged in: those that they were trained for.
        extent: how much is run.
        fallback: whether policies also run with their fallback.
        folder: of real tracks; None leaves them out.
        combiners: learned combiners of the bank, and mixtures, by label; they run where the problem has
            the bank.
        answers: names of the own conditions that each policy answers for; by default all.
    """

    def __init__(
        self,
        environment: str,
        policies: Mapping[str, Policy],
        own: Sequence[Condition],
        extent: Extent,
        fallback: bool = True,
        folder: Path | None = None,
        combiners: Mapping[str, Combiner | Mixture] = MappingProxyType({}),
        answers: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        everything = [c.name for c in own]
        self.answers = dict.fromkeys(policies, everything) if answers is None else dict(answers)
        self.environment = environment
        self.policies, self.own, self.extent = dict(policies), tuple(own), extent
        self.fallback, self.folder, self.combiners = fallback, folder, dict(combiners)
        self._on_tracks: dict[str, list[Any]] = {}  # by variant

    @property
    def problem(self) -> Problem:
        """What is played; looked up, so that a league can travel to a worker."""
        return problem_in(self.environment)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Errors that are computed in own conditions; the first is what counts."""
        return self.problem.contest.quantities

    def measured(self, condition: Condition) -> tuple[str, ...]:
        """Quantities that are computed in a condition."""
        return self.quantities if condition.kind == OWN else self.problem.contest.everywhere

    @property
    def adapting(self) -> tuple[str, ...]:
        """Labels of what adapts without having learnt anything."""
        return tuple(r.label for r in self.problem.contest.rivals if r.adapts)

    # ---- conditions ------------------------------------------------------------------------

    def conditions(self) -> list[Condition]:
        """Own scenarios, their shifts, other scenarios, real tracks; quick ones may be shorter."""
        contest, quick = self.problem.contest, self.extent.quick
        more = dict(contest.quick) if quick else {}
        own = [replace(c, overrides={**c.overrides, **more}) for c in self.own]
        found = list(own)
        for condition in own:
            changes = self._changes(condition, first=condition is own[0])
            found += [
                Condition(
                    name, condition.scenario, {**condition.overrides, **each}, SHIFT, condition.name
                )
                for name, each in changes.items()
            ]
        others = [s for s in contest.others if s not in {c.scenario for c in own}]
        chosen = others[:1] if quick else others
        found += [Condition(short(s), s, dict(more), OTHER) for s in chosen]
        return found + self._real()

    def _changes(self, own: Condition, first: bool) -> dict[str, Mapping[str, Any]]:
        """Shifts of an own condition, and itself again where policies run with their fallback."""
        contest = self.problem.contest
        again = self.fallback and not contest.streams_own
        found: dict[str, Mapping[str, Any]] = {AS_TRAINED: {}} if again else {}
        if contest.shift_first_only and not first:
            return found
        shifts = contest.shifts(find_scenario(own.scenario, **own.overrides))
        names = contest.quick_shifts if self.extent.quick else tuple(shifts)
        return found | {name: shifts[name] for name in names}

    def _real(self) -> list[Condition]:
        tracks = self.problem.tracks
        if self.folder is None or tracks is None:
            return []
        rates = tracks.rates[1:2] if self.extent.quick else tracks.rates
        variants = () if self.extent.quick else tuple(tracks.variants)
        found = [Condition(f"tracks, {100 * r:.0f} % lost", kind=REAL, loss=r) for r in rates]
        return found + [Condition(f"tracks, {v}", kind=REAL, variant=v) for v in variants]

    def count(self, condition: Condition) -> int:
        """Recordings of a condition; of tracks, the draws of each."""
        contest = self.problem.contest
        if condition.kind == REAL:
            return len(self._tracks.numbers) * self.extent.of_track
        return self.extent.own(contest) if condition.kind == OWN else self.extent.other(contest)

    @property
    def _tracks(self) -> Tracks:
        found = self.problem.tracks
        assert found is not None
        return found

    def cases(self, condition: Condition, start: int, count: int) -> Cases:
        """Recordings `start` to `start + count` of a condition, of test seeds."""
        if condition.kind == REAL:
            every = real_cases(
                self.problem, self.folder, condition.loss, self.extent.of_track, "test",
                variant=condition.variant,
            )  # fmt: skip
            return every.take(range(start, start + count))
        return Cases.simulated(
            condition.scenario, "test", count, start, **dict(condition.overrides)
        )

    # ---- contenders ------------------------------------------------------------------------

    def contenders(self, condition: Condition, cases: Cases) -> list[Contender]:
        """Everybody who runs, in the order of the ladder: from the plain filter to the bounds."""
        real = condition.kind == REAL
        contest = self.problem.contest
        whole = {
            e.label: self._whole(e, condition, cases) for e in whole_filters(self.problem, real)
        }
        found = [whole.pop(contest.plain)]
        found += [whole.pop(r.label) for r in contest.rivals if r.real_only and r.label in whole]
        if condition.kind == OWN:
            found.append(choosing(RANDOM, Random(self.environment), cases))
        found.append(Contender(Entry(DEFAULT, contest.default)))
        rule = hand_rule(self.environment)
        found += [] if rule is None else [choosing(HAND_RULE, rule, cases)]
        found += self._fixed(condition, cases)
        found += self._learners(condition, cases)
        found += [self._table(condition, cases)] if condition.scenario in tables() else []
        bounds = [whole.pop(r.label) for r in contest.rivals if r.bound and r.label in whole]
        combined = self.combiners if combines(self.problem) else {}
        combining = [Contender(Entry(k, BANK), runs=c) for k, c in combined.items()]
        return [*found, *whole.values(), *combining, *self._seers(cases), *bounds]

    def _whole(self, entry: Entry, condition: Condition, cases: Cases) -> Contender:
        """A filter that needs no choice of parameters, where it says so with other sensors on board."""
        rival = next(r for r in self.problem.contest.rivals if r.label == entry.label)
        if not rival.overrides:
            return Contender(entry)

        def states() -> tuple[Array, NDArray[Any]]:
            other = {**condition.overrides, **rival.overrides}
            seeds = [r.meta["seed"] for r in cases.recordings]
            batch = self.problem.stack(simulate_many(condition.scenario, seeds, **other))
            run = self.problem.run(entry.filter, batch, entry.parameters)
            return run.states, run.diverged

        return Contender(entry, states=states)

    def _seers(self, cases: Cases) -> list[Contender]:
        """Rules that know the truth, where there is one."""
        contest, recordings = self.problem.contest, cases.recordings
        if not contest.seers or cases.batch.truth is None:
            return []
        return [
            Contender(
                Entry(
                    s.label, contest.default, [dict(s.schedule(r)) for r in recordings], bound=True,
                    interval=1,
                )
            )
            for s in contest.seers
        ]  # fmt: skip

    def _fixed(self, condition: Condition, cases: Cases) -> list[Contender]:
        """The best fixed parameters here, and the policies' own where they are others."""
        own = self.problem.environment
        here = None
        if condition.kind != REAL:
            here = dict(find_scenario(condition.scenario).reference)
        best = self._tuned_on_tracks(condition.variant, cases) if here is None else here
        found = [Contender(Entry(BEST_FIXED, self.problem.contest.default, best))]
        for label, values in self._references(here).items():
            entry = Entry(label, own.settings.FILTER, values)
            found.append(Contender(entry, runs=own.replayed({})))
        return found

    def _tuned_on_tracks(self, variant: str, cases: Cases) -> list[Any]:
        """Per recording, the default filter's parameters tuned on the other fold of the tracks."""
        if variant not in self._on_tracks:
            name = self.problem.contest.default
            draws = max(self.extent.of_track // 2, 1)
            trials = QUICK_TRIALS if self.extent.quick else TRACK_TRIALS
            self._on_tracks[variant] = list(
                cross_tuned(
                    self.problem, Entry(name, name), self.folder, draws, trials, variant=variant
                )
            )
        return per_track(cases, self._on_tracks[variant])

    def fixed_label(self, policy: str) -> str:
        """What the fixed parameters are called that a policy starts from; some share theirs."""
        first = next(k for k in self.policies if self._row(k) == self._row(policy))
        return f"fixed, as for {first}"

    def _row(self, policy: str) -> tuple[float, ...]:
        return self._values(self.policies[policy].manifest.reference)

    def _values(self, parameters: Mapping[str, Any]) -> tuple[float, ...]:
        return tuple(self.problem.environment.settings.SPACE.array(parameters)[0])

    def _references(self, here: Mapping[str, Any] | None) -> dict[str, dict[str, Any]]:
        """Fixed parameters that policies start from, by label, but for those that `here` holds."""
        row = None if here is None else self._values(here)
        return {
            self.fixed_label(label): dict(policy.manifest.reference)
            for label, policy in self.policies.items()
            if self._row(label) != row
        }

    def _learners(self, condition: Condition, cases: Cases) -> list[Contender]:
        """The policies, each followed by itself with its fallback."""
        streams = self.fallback and (self.problem.contest.streams_own or condition.kind != OWN)
        found = []
        for label, policy in self.policies.items():
            found.append(choosing(label, Learnt(policy), cases))
            if streams:
                found.append(deployed(label, policy, cases))
        return found

    def _table(self, condition: Condition, cases: Cases) -> Contender:
        reference = find_scenario(condition.scenario).reference
        known, names = cases.batch.regimes(), cases.regimes
        table = TrueRegime(self.environment, condition.scenario, known, names, reference)
        name = self.problem.contest.default
        return Contender(Entry(TRUE_REGIME, name, table.schedules(), bound=True, interval=1))

    # ---- what runs come to -----------------------------------------------------------------

    def run(self, contender: Contender, cases: Cases) -> tuple[Array, NDArray[Any]]:
        """States (N, T, n) and flags (N,) of a contender that is a filter run."""
        found = self._run(contender, cases, contender.entry.parameters, everything=False)
        return found.states, found.diverged

    def _run(self, contender: Contender, cases: Cases, parameters: Any, everything: bool) -> Run:
        """What a contender says of each filter step."""
        if isinstance(contender.runs, (Combiner, Mixture)):
            return contender.runs.run(cases.batch, everything, fallback=True)
        entry = contender.entry
        chosen = contender.runs or entry.filter
        return self.problem.run(chosen, cases.batch, parameters, entry.interval, everything)

    def errors(self, cases: Cases, states: Array, names: Sequence[str]) -> dict[str, Array]:
        """Quantities per run, (N,), by name."""
        return self.problem.scoring.errors(cases.batch, states, names, cases.span)

    def seconds(self, cases: Cases, states: Array) -> Array:
        """Squared errors of the first quantity, mean over each second that counts, (N, S)."""
        per, first = self._grid(cases)
        each = self.problem.scoring.squared(cases.batch, states, self.quantities[0], cases.span)
        whole = each[:, : each.shape[1] // per * per]
        found: Array = whole.reshape(len(each), -1, per).mean(axis=2)[:, first:]
        return found

    def _grid(self, cases: Cases) -> tuple[int, int]:
        """Filter steps per second, and the second from which on errors count."""
        return max(1, round(1.0 / cases.batch.step)), round(self.problem.scoring.settling)

    def labels(self, cases: Cases) -> list[Labels]:
        """The true regimes, once per second; nothing where there is one or none."""
        if len(cases.regimes) < 2:
            return []
        per, first = self._grid(cases)
        meta = {"regimes": cases.regimes}
        return [
            Labels(row[: len(row) // per * per : per][first:], meta)
            for row in cases.batch.regimes()
        ]

    def times(self, cases: Cases) -> Array:
        """(K,) s of the filter steps of the first recording."""
        found: Array = cases.batch.time_of(0)
        return found

    def consistency(self, contender: Contender, cases: Cases) -> dict[str, float]:
        """NIS and NEES per degree of freedom, and how often NIS lies in its 95 % band.

        Of as many recordings as the problem says.
        """
        problem = self.problem
        some = cases.take(range(min(problem.contest.judged, len(cases))))
        parameters = contender.entry.parameters
        if isinstance(parameters, list):
            parameters = parameters[: len(some)]
        found = self._run(contender, some, parameters, everything=True)
        judged = problem.scoring.scored(some.batch, some.span)
        nis, dof = found.nis[judged], found.components[judged]
        report = consistency(nis, dof)
        heard = dof[np.isfinite(nis) & (dof > 0)]
        return {
            "nis": report.mean * report.samples / float(heard.sum()),
            "inside": report.inside,
            "nees": float(np.nanmean(problem.scoring.nees(some.batch, found)[judged])),
        }
