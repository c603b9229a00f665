"""A study from beginning to end: tune, choose among the leaders, compare on fresh data, keep it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from tqdm import tqdm

from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.metrics.measures import Measure, Quantity
from navgym.problem import Amount
from navgym.simulation import find_scenario
from navgym.statespace.filters.spaces import PROCESS
from navgym.tuned import as_model, read_tuned
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Comparison, Entry, compare
from navgym.tuning.objectives import (
    Costed,
    InstanceGoal,
    Objective,
    Pooled,
    find_measure,
    plain_quantities,
)
from navgym.tuning.settings import ALL_SENSORS, NOISE, StudySettings
from navgym.tuning.stages import Stages, stages
from navgym.tuning.study import racing
from navgym.tuning.study.executors import workers
from navgym.tuning.study.run import Interrupted, Outcome, Search, Trial, search
from navgym.tuning.study.selection import TOP, confirm
from navgym.tuning.study.sensitivity import Sweep, importances, sweeps

DEFAULT, TUNED = "{}, default", "{}, tuned"
KNOWN, TRUTH = "{}, best known", "{}, tuned with the truth"
# A common factor on all noises that moves the one-step error by more than this share moves estimates
MOVES = 0.005


class Asked(Protocol):
    """What reports read of a study's settings."""

    @property
    def filter(self) -> str:
        """What is tuned."""

    @property
    def out(self) -> Path:
        """Folder of everything that is written."""

    @property
    def storage(self) -> str | None:
        """Where trials are kept."""

    @property
    def seed(self) -> int:
        """Of the sampler."""

    @property
    def sampler(self) -> str:
        """Its name."""

    @property
    def cost(self) -> bool:
        """Whether time is minimised too."""

    def fixed(self, space: Any, /) -> dict[str, Any]:
        """Parameters that are not tuned, at values of their own."""

    @property
    def amount(self) -> Amount:
        """How much is run."""


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
        held: whether the winner holds on recordings that nobody tuned on.
        calibrated: the factor on all noise scales by which NIS became 1; None where there is none.
    """

    settings: Asked
    goal: InstanceGoal
    outcome: Outcome
    chosen: Trial
    stages: Stages
    reports: Mapping[str, Comparison]
    sweeps: Sequence[Sweep]
    importances: Mapping[str, float]
    held: Held
    calibrated: float | None = None

    @property
    def space(self) -> ParameterSpace:
        """What can be tuned in the filter on these recordings."""
        return next(iter(self.stages.train.values())).space(self.settings.filter)

    @property
    def winner(self) -> dict[str, Any]:
        """The winner's parameters, the fixed ones included."""
        return self.settings.fixed(self.space) | dict(self.chosen.values)

    @property
    def values(self) -> dict[str, Any]:
        """The parameters to use: the winner's, or the defaults where it does not hold."""
        if not self.held.kept_default:
            return self.winner
        return self.settings.fixed(self.space) | {
            n: self.space.defaults[n] for n in self.chosen.values
        }

    @property
    def measure(self) -> Measure:
        """What the study minimised."""
        return measure_of(self.goal)

    @property
    def model(self) -> dict[str, Any]:
        """What the recordings' model believed of noise, which scales among the parameters refer to."""
        cases = next(iter(self.stages.train.values()))
        return as_model(cases.problem.noises(cases.batch))

    def time(self, name: str) -> tuple[Array, str]:
        """Where traces over time of a report stand, (T,), and what that axis is."""
        batch = self.stages.report[name].batch
        return np.asarray(batch.time_of(int(np.argmax(batch.lengths)))), "time, s"

    @property
    def usage(self) -> str:
        """How the file of tuned parameters is used, as code."""
        return f'navgym.estimate("{self.settings.filter}", recording, "tuned.toml")'

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
        for line in doubts(settings, next(iter(made.train.values()))):
            tqdm.write(line)
        goal, fresh = goal_of(settings, made.train), goal_of(settings, made.select)
        for cases in made.report.values():  # what cannot be judged is said before the study
            if is_blind(settings, cases):
                plain_quantities(cases, find_measure(settings.problem, cases.foretold.name))
        outcome = _study(settings, goal, executor, "tuning", _storage(settings))
        chosen, factor = calibrated(settings, made.select, choose(outcome, fresh, executor), fresh)
        found = _sweep(fresh, chosen, executor)
        extra = _with_truth(settings, made, executor)
        reports = {
            name: _report(settings, name, cases, chosen, extra)
            for name, cases in made.report.items()
        }
        shares = importances(outcome, goal.space)
        return Findings(
            settings, goal, outcome, chosen, made, reports, found, shares,
            how_it_held(settings, reports, made.report), factor,
        )  # fmt: skip


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
    members = [
        Objective(
            settings.filter, settings.parameters(each.space(settings.filter)), each, settings.metric,
            settings.fixed(each.space(settings.filter)), measure or minimised(settings, each),
        )
        for each in cases.values()
    ]  # fmt: skip
    goal: InstanceGoal = members[0] if len(members) == 1 else Pooled(members)
    return Costed(goal) if settings.cost and measure is None else goal


def minimised(settings: StudySettings, cases: Cases) -> str | None:
    """Name of the measure that a study on `cases` minimises; None for the problem's first."""
    blind = settings.akit is not None or not cases.has_truth
    return settings.measure or (cases.foretold.name if blind else None)


def is_blind(settings: StudySettings, cases: Cases) -> bool:
    """Whether a study on `cases` sees no truth."""
    return not find_measure(settings.problem, minimised(settings, cases)).needs_truth


def measure_of(goal: InstanceGoal) -> Measure:
    """What a study's goal judges runs by."""
    if isinstance(goal, Costed):
        return measure_of(goal.goal)
    if isinstance(goal, Pooled):
        return goal.members[0].measure
    found: Measure = goal.measure  # type: ignore[attr-defined]
    return found


def _study(
    settings: StudySettings, goal: InstanceGoal, executor: Executor | None, label: str, where: Any
) -> Outcome:
    how = Search(
        settings.amount.trials, settings.seed, settings.sampler, settings.batch,
        settings.prune and not settings.cost and settings.metric != "quantile 95 %", settings.study,
    )  # fmt: skip
    outcome = search(
        goal, how, journal=where, first=_first(settings, goal.space), label=label, executor=executor
    )
    if outcome.interrupted:
        raise Interrupted(outcome)
    return outcome


def doubts(settings: StudySettings, cases: Cases) -> list[str]:
    """Where the file to start from refers to another model's noise, in words."""
    if settings.start is None:
        return []
    found = read_tuned(settings.start)
    return [f"{settings.start}: {d}" for d in found.doubts(cases.problem.noises(cases.batch))]


def _first(settings: StudySettings, space: ParameterSpace) -> list[dict[str, Any]]:
    """The earlier result to try right after the defaults, if one was given."""
    if settings.start is None:
        return []
    found = read_tuned(settings.start)
    if found.filter != settings.filter:
        raise ValueError(
            f"{settings.start} holds parameters of {found.filter!r}, not of {settings.filter!r}: "
            "start from another file."
        )
    return [_inside(settings, found.parameters, space)]


def _inside(
    settings: StudySettings, values: Mapping[str, Any], space: ParameterSpace
) -> dict[str, Any]:
    """`values` of the free parameters, moved inside their ranges."""
    moved = {}
    for p in settings.parameters(space):
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
    run_all = functools.partial(evaluated, executor, "sweeping")
    return sweeps(goal, chosen.values, run_all, relative=measure_of(goal).relative)


# ---- noise levels that a one-step error cannot see


def calibrated(
    settings: StudySettings, cases: Mapping[str, Cases], chosen: Trial, goal: InstanceGoal
) -> tuple[Trial, float | None]:
    """The winner with all its noise scales times the factor that makes NIS 1, and the factor.

    Where every covariance of a model is multiplied by one number, a linear filter's estimates stay and
    its own covariance is multiplied too: a one-step error cannot choose the factor, and NIS can. It is
    left out where not all noise scales may be moved, where it would leave what is admissible, or where it
    moves the one-step error after all. Returns the winner itself and None then.
    """
    some = next(iter(cases.values()))
    whole = some.space(settings.filter)
    fixed = settings.fixed(whole)
    names = _all_noises(whole, goal.space.names, tuple(fixed))
    blind = all(is_blind(settings, c) for c in cases.values())
    if settings.measure in _NOISE_LEVELS or not blind or not names:
        return chosen, None
    told = [c.consistency(settings.filter, fixed | dict(chosen.values))[0] for c in cases.values()]
    factor = float(np.mean([math.nan if t is None else t.mean for t in told]))
    usual = {**whole.defaults, **chosen.values}
    values = {**chosen.values, **{name: float(usual[name]) * factor for name in names}}
    ends = {name: whole[name].admissible for name in names}
    if not all(low <= values[name] <= high for name, (low, high) in ends.items()):
        return chosen, None
    result = goal(values)
    if not abs(result - chosen.result) <= MOVES * abs(chosen.result):
        return chosen, None
    return replace(chosen, values=values, result=result), factor


_NOISE_LEVELS = ("likelihood", "consistency")  # measures that choose the level by themselves


def _all_noises(whole: ParameterSpace, free: Sequence[str], fixed: Sequence[str]) -> list[str]:
    """Parameters that together scale the whole of Q and R; none if there is not all of it to move."""
    if PROCESS.name not in free:
        return []
    if ALL_SENSORS in whole.names and ALL_SENSORS not in fixed:
        return [PROCESS.name, ALL_SENSORS]
    others = (PROCESS.name, ALL_SENSORS)
    sensors = [n for n in whole.names if n.endswith(NOISE) and n not in others]
    return [PROCESS.name, *sensors] if sensors and set(sensors) <= set(free) else []


def _with_truth(
    settings: StudySettings, made: Stages, executor: Executor | None
) -> dict[str, dict[str, Any]]:
    """For logs that were tuned blind though their truth is known: what the truth would have found."""
    some = next(iter(made.train.values()))
    if settings.akit is None or not is_blind(settings, some):
        return {}
    seeing = find_measure(settings.problem, None).name
    usual = goal_of(settings, made.train, seeing)
    where = _storage(settings)
    beside = where.with_name(f"truth-{where.name}") if isinstance(where, Path) else None
    outcome = _study(settings, usual, executor, "tuning with the truth, to compare", beside)
    best = choose(outcome, goal_of(settings, made.select, seeing), executor)
    fixed = settings.fixed(some.space(settings.filter))
    return {TRUTH.format(settings.filter): fixed | dict(best.values)}


# ---- the report's comparison


def _report(
    settings: StudySettings, name: str, cases: Cases, chosen: Trial, extra: Mapping[str, Any]
) -> Comparison:
    """The tuned filter among others on fresh recordings, judged by the truth where there is one."""
    own = settings.filter
    values = settings.fixed(cases.space(own)) | dict(chosen.values)
    entries = [
        Entry(DEFAULT.format(own), own),
        Entry(TUNED.format(own), own, values),
        *(Entry(label, own, v) for label, v in extra.items()),
        *_known(settings, name),
        *_others(settings, cases),
    ]
    blind = is_blind(settings, cases)
    measure = minimised(settings, cases)
    if blind and cases.has_truth:
        measure = None
    keep = (DEFAULT.format(own), TUNED.format(own))
    return compare(
        entries, cases, DEFAULT.format(own), cases.plain, keep=keep, progress=f"report: {name}",
        measure=measure, blind=blind,
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


# ---- whether it holds


@dataclass(frozen=True)
class Held:
    """How the winner did on what nobody tuned on.

    Args:
        kept_default: whether the defaults are kept in its place.
        said: that, in a sentence or two; "" where the choice on validation seeds has said it all.
    """

    kept_default: bool = False
    said: str = ""


def how_it_held(
    settings: StudySettings, reports: Mapping[str, Comparison], cases: Mapping[str, Cases]
) -> Held:
    """Whether real recordings that nobody tuned on speak for the winner or for the defaults.

    By what was foretold there, where the study saw no truth; else by the truth.
    """
    if settings.simulated:
        return Held()
    own, usual = TUNED.format(settings.filter), DEFAULT.format(settings.filter)
    pairs = {}
    for name, found in reports.items():
        quantity, values = _told(found, cases[name], is_blind(settings, cases[name]))
        pairs[name] = (values(own), values(usual))
    return held_by(pairs, quantity)


def held_by(found: Mapping[str, tuple[float, float]], quantity: Measure | Quantity) -> Held:
    """Whether what the tuned parameters and the defaults came to on held-out data speaks for the tuned.

    Args:
        found: (tuned, default) by the name of a report; infinite where a filter diverges.
        quantity: what they are; of logarithms differences count, else shares.
    """
    pairs, what, said = list(found.values()), quantity.label, []
    for name, pair in found.items():
        where = f"{name}: " if len(found) > 1 else ""
        said.append(f"{where}{pair[0]:.4g} {quantity.unit}, with the defaults {pair[1]:.4g} {quantity.unit}")  # fmt: skip
    told = "; ".join(said)
    lost, bad = (any(not math.isfinite(pair[i]) for pair in pairs) for i in (0, 1))
    if lost and bad:
        return Held(True, "Tuned or not, the filter diverges on the part never tuned on: the defaults are kept, and neither is to be trusted. Look at units, noise and model first.")  # fmt: skip
    if lost:
        return Held(True, "The tuned parameters diverge on the part never tuned on: the defaults are kept.")  # fmt: skip
    if bad:
        return Held(False, "The defaults diverge on the part never tuned on, the tuned parameters do not.")  # fmt: skip
    if all(a == b for a, b in pairs):
        return Held(False, "Nothing that was tried is better than the defaults.")  # fmt: skip
    parts = quantity.parts if isinstance(quantity, Measure) else (quantity,)
    worse = [a - b if parts[0].added else a / b - 1.0 for a, b in pairs]
    if float(np.mean(worse)) > 0.0:
        return Held(True, f"The tuned parameters do not hold on the part never tuned on, where they do worse in the {what} ({told}): the defaults are kept.")  # fmt: skip
    return Held(False, f"The tuned parameters hold on the part never tuned on: {what} {told}.")  # fmt: skip


def _told(
    found: Comparison, cases: Cases, blind: bool
) -> tuple[Measure | Quantity, Callable[[str], float]]:
    """What decides on a report's recordings, and its mean by label; infinite where a filter diverges."""
    name = cases.foretold.name
    beside = blind and name in found.quantities

    def value(label: str) -> float:
        mean = found.beside[label][name] if beside else found[label].mean
        return math.inf if found[label].diverges else mean

    return (cases.foretold if beside else found.measure), value


def _others(settings: StudySettings, cases: Cases) -> list[Entry]:
    """What stands beside it: the plain filter, what needs no tuning, and the bound."""
    problem, linear = settings.problem, cases.batch.linear
    names = [n for n in problem.study.beside if problem.filters[n].nonlinear != linear]
    others = [Entry(n, n) for n in names if n != settings.filter or n == cases.plain]
    if settings.simulated and (linear or problem.filters[problem.bound].nonlinear):
        others.append(Entry(problem.bound, problem.bound, bound=True))
    return others
