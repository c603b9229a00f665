"""A study from beginning to end: tune, choose among the leaders, compare on fresh data, keep it."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from navgym.metrics.measures import CONSISTENCY, LIKELIHOOD
from navgym.simulation import find_scenario
from navgym.tuned import read_tuned
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Comparison, Entry, compare
from navgym.tuning.objectives import Costed, InstanceGoal, Objective, Pooled, find_measure
from navgym.tuning.settings import StudySettings
from navgym.tuning.stages import Stages, stages
from navgym.tuning.study import racing
from navgym.tuning.study.executors import workers
from navgym.tuning.study.run import Interrupted, Outcome, Search, Trial, search
from navgym.tuning.study.selection import TOP, confirm
from navgym.tuning.study.sensitivity import Sweep, importances, sweeps

DEFAULT, TUNED = "{}, default", "{}, tuned"
KNOWN, TRUTH = "{}, best known", "{}, tuned with the truth"
NEED_NO_TRUTH = (LIKELIHOOD.name, CONSISTENCY.name)


@dataclass(frozen=True, eq=False)
class Findings:
    """Everything that a study and its report found.

    Args:
        settings: what was asked for.
        goal: what was minimised.
        outcome: the trials.
        chosen: the winner; its result is that on the recordings that chose it.
        stages: the recordings.
        reports: comparisons on fresh recordings, by name; the tuned filter is one of the entries.
        sweeps: around the winner, on the recordings that chose it.
        importances: of the free parameters, from the trials.
    """

    settings: StudySettings
    goal: InstanceGoal
    outcome: Outcome
    chosen: Trial
    stages: Stages
    reports: Mapping[str, Comparison]
    sweeps: Sequence[Sweep]
    importances: Mapping[str, float]

    @property
    def values(self) -> dict[str, Any]:
        """The winner's parameters, the fixed ones included."""
        return self.settings.fixed() | dict(self.chosen.values)

    @property
    def tuned(self) -> str:
        """Label of the tuned filter."""
        return TUNED.format(self.settings.filter)

    @property
    def default(self) -> str:
        """Label of the filter at its defaults."""
        return DEFAULT.format(self.settings.filter)


def run(settings: StudySettings) -> Findings:
    """The whole of it.

    Raises:
        Interrupted: Ctrl-C during the study; its finished trials are kept.
        ValueError: settings that do not fit together, a study of another search.
        OSError: files or storage that cannot be read or written.
    """
    with workers(settings.processes, settings.scheduler) as executor:
        made = stages(settings)
        goal = goal_of(settings, made.train)
        outcome = _study(settings, goal, executor, "tuning", _storage(settings))
        fresh = goal_of(settings, made.select)
        chosen = choose(outcome, fresh, executor)
        found = _sweep(fresh, chosen, executor)
        extra = _with_truth(settings, made, executor)
        reports = {
            name: _report(settings, name, cases, chosen, extra)
            for name, cases in made.report.items()
        }
        shares = importances(outcome, goal.space)
        return Findings(settings, goal, outcome, chosen, made, reports, found, shares)


def _storage(settings: StudySettings) -> Path | str:
    if settings.storage is None:
        return settings.out / "study.log"
    return settings.storage if "://" in settings.storage else Path(settings.storage)


# ---- the goal


def goal_of(
    settings: StudySettings, cases: Mapping[str, Cases], measure: str | None = None
) -> InstanceGoal:
    """What `settings` ask to minimise, over some recordings.

    Args:
        settings: of the study.
        cases: recordings by name; several are pooled.
        measure: another one than the settings'.
    """
    blind = settings.akit is not None or any(not c.has_truth for c in cases.values())
    usual = LIKELIHOOD.name if blind else None
    members = [
        Objective(
            settings.filter, settings.parameters(), each, settings.metric, settings.fixed(),
            measure or settings.measure or usual,
        )
        for each in cases.values()
    ]  # fmt: skip
    goal: InstanceGoal = members[0] if len(members) == 1 else Pooled(members)
    return Costed(goal) if settings.cost and measure is None else goal


def _study(
    settings: StudySettings, goal: InstanceGoal, executor: Executor | None, label: str, where: Any
) -> Outcome:
    how = Search(
        settings.amount.trials, settings.seed, settings.sampler, settings.batch,
        settings.prune and not settings.cost and settings.metric != "quantile 95 %", settings.study,
    )  # fmt: skip
    outcome = search(
        goal, how, journal=where, first=_first(settings), label=label, executor=executor
    )
    if outcome.interrupted:
        raise Interrupted(outcome)
    return outcome


def _first(settings: StudySettings) -> list[dict[str, Any]]:
    """The earlier result to try right after the defaults, if one was given."""
    if settings.start is None:
        return []
    found = read_tuned(settings.start)
    if found.filter != settings.filter:
        raise ValueError(
            f"{settings.start} holds parameters of {found.filter!r}, not of {settings.filter!r}: "
            "start from another file."
        )
    return [_inside(settings, found.parameters)]


def _inside(settings: StudySettings, values: Mapping[str, Any]) -> dict[str, Any]:
    """`values` of the free parameters, moved inside their ranges."""
    moved = {}
    for p in settings.parameters():
        if p.name in values:
            given = values[p.name]
            number = p.check(given) if isinstance(given, str) else float(given)
            moved[p.name] = p.show(min(max(number, p.low), p.high))
    return moved


# ---- the choice, and what it rests on


def choose(outcome: Outcome, fresh: InstanceGoal, executor: Executor | None = None) -> Trial:
    """The best of the leaders on recordings that the study has not seen; feasible ones first."""
    run_all = functools.partial(evaluated, executor, "choosing among the leaders")
    return confirm(outcome, fresh, TOP, run_all)


def evaluated(executor: Executor | None, label: str, calls: Sequence[tuple[Any, ...]]) -> list[Any]:
    """`racing.evaluate` of every call, with a progress bar."""
    if executor is None:
        return [racing.evaluate(*call) for call in tqdm(calls, desc=label)]
    futures = [executor.submit(racing.evaluate, *call) for call in calls]
    return [f.result() for f in tqdm(futures, desc=label)]


def _sweep(fresh: InstanceGoal, chosen: Trial, executor: Executor | None) -> list[Sweep]:
    goal = fresh.goal if isinstance(fresh, Costed) else fresh
    return sweeps(goal, chosen.values, functools.partial(evaluated, executor, "sweeping"))


def _with_truth(
    settings: StudySettings, made: Stages, executor: Executor | None
) -> dict[str, dict[str, Any]]:
    """For logs that were tuned blind though their truth is known: what the truth would have found."""
    blind = settings.akit is not None and settings.measure in (None, *NEED_NO_TRUTH)
    if not blind:
        return {}
    seeing = find_measure(settings.problem, None).name
    usual = goal_of(settings, made.train, seeing)
    where = _storage(settings)
    beside = where.with_name(f"truth-{where.name}") if isinstance(where, Path) else None
    outcome = _study(settings, usual, executor, "tuning with the truth, to compare", beside)
    best = choose(outcome, goal_of(settings, made.select, seeing), executor)
    return {TRUTH.format(settings.filter): settings.fixed() | dict(best.values)}


# ---- the report's comparison


def _report(
    settings: StudySettings, name: str, cases: Cases, chosen: Trial, extra: Mapping[str, Any]
) -> Comparison:
    """The tuned filter among others on fresh recordings, judged by the truth where there is one."""
    own = settings.filter
    values = settings.fixed() | dict(chosen.values)
    entries = [
        Entry(DEFAULT.format(own), own),
        Entry(TUNED.format(own), own, values),
        *(Entry(label, own, v) for label, v in extra.items()),
        *_known(settings, name),
        *_others(settings, cases),
    ]
    usual = None if cases.has_truth else LIKELIHOOD.name
    measure = settings.measure if settings.measure and cases.has_truth else usual
    if measure in NEED_NO_TRUTH and cases.has_truth:
        measure = None
    keep = (DEFAULT.format(own), TUNED.format(own))
    return compare(
        entries, cases, DEFAULT.format(own), cases.plain, keep=keep, progress=f"report: {name}",
        measure=measure,
    )  # fmt: skip


def _known(settings: StudySettings, name: str) -> list[Entry]:
    """The scenario's reference parameters, if they are for this filter."""
    if not settings.simulated or settings.overrides:
        return []
    own, study = settings.filter, settings.problem.study
    values = dict(find_scenario(name).reference)
    space = settings.problem.find(own).space
    fits = values and set(values) <= set(space.names) and own in study.referred
    return [Entry(KNOWN.format(own), own, values)] if fits else []


def _others(settings: StudySettings, cases: Cases) -> list[Entry]:
    """What stands beside it: the plain filter, what needs no tuning, and the bound."""
    problem, linear = settings.problem, cases.batch.linear
    names = [n for n in problem.study.beside if problem.filters[n].nonlinear != linear]
    others = [Entry(n, n) for n in names if n != settings.filter or n == cases.plain]
    if settings.simulated and (linear or problem.filters[problem.bound].nonlinear):
        others.append(Entry(problem.bound, problem.bound, bound=True))
    return others
