"""What a study minimises: parameters in, one number out."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np

from navgym.core.checks import Array, one_of
from navgym.core.parameters import Parameter, ParameterSpace
from navgym.metrics.measures import METRICS, Measure, bounded
from navgym.problem import Batch, Problem, problem_of
from navgym.tuning.cases import Cases


class Goal(Protocol):
    """Anything that a study can minimise."""

    @property
    def space(self) -> ParameterSpace:
        """The free parameters."""

    @property
    def about(self) -> Mapping[str, Any]:
        """What else the number depends on, as JSON can hold it: two goals that differ here or in
        their space must not share a study.
        """

    def __call__(self, values: Mapping[str, Any]) -> float:
        """The number to minimise; always finite."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What some instances (recordings) said of a parameter set.

    Args:
        losses: (n,) one number per instance, finite, the smaller the better.
        limits: quantities that may not grow, as (n,) shares of what is allowed: above 1 in the mean
            the parameter set is not feasible.
        microseconds: per filter step, as measured.
        failed: what went wrong, a line for each instance that could not be evaluated.
    """

    losses: Array
    limits: Mapping[str, Array] = field(default_factory=dict)
    microseconds: float = math.nan
    failed: tuple[str, ...] = ()

    @classmethod
    def joined(cls, parts: Sequence[Evaluation]) -> Evaluation:
        """Evaluations of different instances as one."""
        names = parts[0].limits
        sizes = [len(p.losses) for p in parts]
        return cls(
            np.concatenate([p.losses for p in parts]),
            {name: np.concatenate([p.limits[name] for p in parts]) for name in names},
            float(np.average([p.microseconds for p in parts], weights=sizes)),
            tuple(line for p in parts for line in p.failed),
        )

    @property
    def constraints(self) -> dict[str, float]:
        """Per limit, by how much its mean is beyond what is allowed: feasible at 0 or less."""
        return {name: float(each.mean()) - 1.0 for name, each in self.limits.items()}


@runtime_checkable
class InstanceGoal(Goal, Protocol):
    """A goal that is a statistic of losses over instances, which can be looked at in parts."""

    @property
    def metric(self) -> str:
        """Of the instances' losses: a name of `navgym.metrics.measures.METRICS`."""

    def __len__(self) -> int:
        """Number of instances."""

    def evaluate(self, values: Mapping[str, Any], which: Sequence[int] | None = None) -> Evaluation:
        """Losses of the instances `which`, in one batch; of all of them for None."""


class Objective:
    """One filter over a set of recordings, as a function of free parameters.

    Args:
        filter_name: one of the recordings' problem's.
        free: names of the parameters to vary, or parameters with ranges of their own; the order is
            the study's.
        cases: the recordings, as `Cases` or as a batch that holds what was stacked.
        metric: of the runs' losses: a name of `navgym.metrics.measures.METRICS`.
        fixed: parameters held at values of their own; the others stay at their defaults.
        measure: the loss of a run: one of the problem's measures, the first by default.

    Raises:
        ValueError: unknown filter, parameter, metric or measure; no free parameter, or one that is
            fixed as well; recordings without the truth that the measure needs.

    A diverged run counts at a ceiling over the plain filter's on the same recording (see
    `navgym.metrics.measures.bounded`), so the result is finite for any parameters.
    """

    def __init__(
        self,
        filter_name: str,
        free: Iterable[str | Parameter],
        cases: Cases | Batch,
        metric: str = "mean",
        fixed: Mapping[str, Any] | None = None,
        measure: str | None = None,
    ) -> None:
        self.cases = cases if isinstance(cases, Cases) else _stacked(cases)
        whole = self.cases.space(filter_name)
        self.filter_name = filter_name
        self.space = _space(whole, free)
        self.fixed = dict(fixed or {})
        self.metric = one_of("metric", metric, METRICS)
        self.measure = checked_measure(self.cases, measure)
        _check_names(self.space, self.fixed)
        whole.array(self.fixed)
        self.plain = plain_quantities(self.cases, self.measure)
        self._allowed = self._limits()

    def on(self, cases: Cases) -> Objective:
        """The same objective on other recordings."""
        return Objective(
            self.filter_name, self.space, cases, self.metric, self.fixed, self.measure.name
        )

    def __len__(self) -> int:
        return len(self.cases)

    @property
    def about(self) -> dict[str, Any]:
        """Filter, fixed parameters, metric and recordings."""
        whole = self.cases.space(self.filter_name)
        rest = [name for name in whole.names if name not in self.space.names]
        held = whole.defaults | self.fixed
        return {
            "filter": self.filter_name,
            "fixed": {name: held[name] for name in rest},
            "metric": f"{self.metric} of the runs' {self.measure.label}",
            "recordings": dict(self.cases.about),
        }

    def _limits(self) -> dict[str, float]:
        """What each limited quantity may come to in the mean."""
        shares = {quantity.name: share for quantity, share in self.measure.limits}
        if not shares:
            return {}
        found = self.cases.judge(self.filter_name, self.fixed, tuple(shares)).quantities
        return {q: float(found[q].mean()) * (1.0 + share) for q, share in shares.items()}

    def evaluate(self, values: Mapping[str, Any], which: Sequence[int] | None = None) -> Evaluation:
        """Losses of the recordings `which`, in one call of the kernel."""
        cases = self.cases if which is None else self.cases.take(which)
        plain = self.plain if which is None else {q: p[which] for q, p in self.plain.items()}
        found = cases.judge(
            self.filter_name, self.fixed | dict(values), tuple(self.measure.quantities)
        )
        kept = bounded(found, plain, self.measure.quantities)
        limits = {q: kept[q] / allowed for q, allowed in self._allowed.items()}
        return Evaluation(self.measure.losses(kept, self.plain), limits, found.microseconds)

    def errors(self, values: Mapping[str, Any]) -> Array:
        """Loss of each run (N,), bounded."""
        return self.evaluate(values).losses

    def share_beyond(self, values: Mapping[str, Any], limit: float) -> float:
        """Share of runs that are more than `limit` times worse than the plain filter's."""
        plain = self.measure.losses(self.plain, self.plain)
        return float((self.errors(values) > limit * plain).mean())

    def __call__(self, values: Mapping[str, Any]) -> float:
        """The metric at `values` of the free parameters."""
        return float(METRICS[self.metric](self.errors(values)))


def _stacked(batch: Batch) -> Cases:
    """A batch as cases without provenance; ValueError if it does not hold its recordings."""
    if not batch.recordings:
        raise ValueError("a batch must hold its recordings: stack them with the problem's `stack`.")
    return Cases(problem_of(batch.recordings[0]), batch)


def find_measure(problem: Problem, name: str | None) -> Measure:
    """The problem's measure of that name, its first for None; ValueError if unknown."""
    known = problem.scoring.measures
    return next(iter(known.values())) if name is None else known[one_of("measure", name, known)]


def checked_measure(cases: Cases, name: str | None) -> Measure:
    """The measure called `name` if these recordings have what it needs; ValueError if not."""
    measure = find_measure(cases.problem, name)
    if measure.needs_truth and not cases.has_truth:
        raise ValueError(
            f"measure {measure.name!r} needs the truth, which these recordings lack: use "
            f"{cases.foretold.name!r}, which judges a filter by what it foretells."
        )
    return measure


def plain_quantities(cases: Cases, measure: Measure) -> dict[str, Array]:
    """The measure's quantities (N,) of the filter that needs no tuning.

    Raises ValueError where it has none: there is nothing to hold other filters against.
    """
    found = dict(cases.judge(cases.plain, None, tuple(measure.quantities)).quantities)
    for name, each in found.items():
        bad = np.flatnonzero(~np.isfinite(each))
        if len(bad):
            what, part = measure.quantities[name].label, cases.about.get("scored")
            where = f" between {part[0]:.0%} and {part[1]:.0%} of its length" if part else ""
            raise ValueError(
                f"recording {bad[0]}{where} gives the plain filter {cases.plain!r} no {what}: it holds "
                "nothing to judge by there, or the filter fails on it. Use a longer recording, another "
                "measure, or a model that fits what was measured."
            )
    return found


def _space(whole: ParameterSpace, free: Iterable[str | Parameter]) -> ParameterSpace:
    """The free parameters; ranges of their own must lie inside what the filter admits."""
    chosen = []
    for each in free:
        name = each if isinstance(each, str) else each.name
        known = whole[name]
        own = known if isinstance(each, str) else each
        low, high = known.admissible
        if own.low < low or own.high > high:
            raise ValueError(
                f"range of {name} must lie inside {low:g}..{high:g}, got {own.low:g}..{own.high:g}."
            )
        chosen.append(own)
    names = [p.name for p in chosen]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"free must name each parameter once, got {twice[0]!r} twice.")
    return ParameterSpace(tuple(chosen))


def narrowed(parameter: Parameter, low: float, high: float) -> Parameter:
    """`parameter` with a range of its own, its default moved inside.

    Raises ValueError for an empty range, and for one that is not inside what is admissible.
    """
    least, most = parameter.admissible
    if not least <= low < high <= most:
        raise ValueError(
            f"range of {parameter.name} must be low < high inside {least:g}..{most:g}, got "
            f"{low:g}..{high:g}."
        )
    default = min(max(parameter.default, low), high)
    return dataclasses.replace(parameter, low=low, high=high, default=default)


def _check_names(space: ParameterSpace, fixed: Mapping[str, Any]) -> None:
    if len(space) == 0:
        raise ValueError("free must name at least one parameter to vary, got none.")
    both = sorted(set(space.names) & set(fixed))
    if both:
        raise ValueError(f"{both[0]!r} is free and fixed at once: name it in one of the two.")


class Pooled:
    """Several objectives as one: every run's loss over the mean of the plain filter's there, or, of
    logarithms, less it.

    A set of scenarios weighs by how much the filter gains in each, not by metres; runs of all of
    them are the instances.

    Args:
        members: objectives over one space and one metric.
    """

    def __init__(self, members: Sequence[Objective]) -> None:
        if not members or len({m.space.fingerprint for m in members}) > 1:
            raise ValueError("members must be at least one objective, all over one space.")
        self.members = tuple(members)
        self.space = members[0].space
        self.metric = members[0].metric
        self._plain = [float(m.measure.losses(m.plain, m.plain).mean()) for m in members]
        ends = np.cumsum([0, *map(len, members)])
        self._spans = list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))

    def __len__(self) -> int:
        return sum(map(len, self.members))

    @property
    def about(self) -> dict[str, Any]:
        """What every member depends on."""
        return {"pooled over": [dict(m.about) for m in self.members]}

    def evaluate(self, values: Mapping[str, Any], which: Sequence[int] | None = None) -> Evaluation:
        """Losses of the instances `which`, a call of the kernel per member."""
        wanted = np.arange(len(self)) if which is None else np.asarray(which)
        losses, spent = np.empty(len(wanted)), []
        limits: dict[str, Array] = {}
        for member, plain, (first, last) in zip(
            self.members, self._plain, self._spans, strict=True
        ):
            here = (wanted >= first) & (wanted < last)
            if here.any():
                found = member.evaluate(values, wanted[here] - first)
                whole = member.measure.relative
                losses[here] = found.losses / plain if whole else found.losses - plain
                spent.append(found.microseconds)
                for name, each in found.limits.items():
                    limits.setdefault(name, np.empty(len(wanted)))[here] = each
        return Evaluation(losses, limits, float(np.mean(spent)))

    def __call__(self, values: Mapping[str, Any]) -> float:
        """The metric of the pooled losses."""
        return float(METRICS[self.metric](self.evaluate(values).losses))


class Costed:
    """A goal whose time per filter step is minimised beside it: a study of two objectives.

    Times are the least of a few measurements. They are the machine's, so such a study repeats as far
    as the clock does.

    Args:
        goal: what else to minimise.
    """

    costed = True
    REPEATS = 3

    def __init__(self, goal: InstanceGoal) -> None:
        self.goal = goal
        self.space, self.metric = goal.space, goal.metric

    def __len__(self) -> int:
        return len(self.goal)

    @property
    def about(self) -> dict[str, Any]:
        """What the goal depends on."""
        return {"and time per filter step": dict(self.goal.about)}

    def evaluate(self, values: Mapping[str, Any], which: Sequence[int] | None = None) -> Evaluation:
        """The goal's evaluation, its time measured a few times."""
        found = [self.goal.evaluate(values, which) for _ in range(self.REPEATS)]
        return dataclasses.replace(found[0], microseconds=min(f.microseconds for f in found))

    def __call__(self, values: Mapping[str, Any]) -> float:
        """The goal alone."""
        return self.goal(values)


@dataclass(frozen=True)
class GeometricMean:
    """Several objectives as one: the geometric mean of each over its reference.

    exp(mean of log(objective / reference)): a parameter set that is 10 % better on one and 10 %
    worse on another gains nothing, whatever the metres.

    Args:
        members: objectives over one space.
        references: what each is measured by, m, such as the error of another filter.
    """

    members: Sequence[Objective]
    references: Sequence[float]

    def __post_init__(self) -> None:
        if not self.members or len(self.members) != len(self.references):
            raise ValueError(
                f"members and references must be as many, at least one, got {len(self.members)} "
                f"and {len(self.references)}."
            )
        prints = {m.space.fingerprint for m in self.members}
        if len(prints) > 1:
            raise ValueError("members must share one space of free parameters.")

    @property
    def space(self) -> ParameterSpace:
        """The free parameters, which all members share."""
        return self.members[0].space

    @property
    def about(self) -> dict[str, Any]:
        """What every member depends on."""
        return {"geometric mean over": [dict(m.about) for m in self.members]}

    def __call__(self, values: Mapping[str, Any]) -> float:
        """The mean ratio at `values`."""
        pairs = zip(self.members, self.references, strict=True)
        return math.exp(sum(math.log(m(values) / r) for m, r in pairs) / len(self.members))


@dataclass(frozen=True)
class Guarded:
    """A goal whose value rises with the share of runs that a guard sees fail.

    value = goal · (1 + price · share), share being the largest, over the guards, of runs that are
    more than `limit` times worse than the plain filter's, and then the largest share by which an
    objective of `bounds` is above what it may come to. A mean hardly notices one run in a hundred
    that locks out; whoever sails in it does.

    Args:
        goal: what to minimise.
        guards: objectives over the same space; take many recordings, rare failures are the point.
        limit: a run's error over the plain filter's, above which it failed.
        price: what a failing share of 1 costs, in goals.
        bounds: objectives over the same space, and what each may come to.
    """

    goal: Goal
    guards: Sequence[Objective]
    limit: float = 2.0
    price: float = 20.0
    bounds: Sequence[tuple[Objective, float]] = ()

    @property
    def space(self) -> ParameterSpace:
        """The free parameters."""
        return self.goal.space

    @property
    def about(self) -> dict[str, Any]:
        """What the goal and every guard depend on."""
        guards = [dict(guard.about) for guard in self.guards]
        return {
            "goal": dict(self.goal.about),
            "guards": {"limit": self.limit, "price": self.price, "members": guards},
            "bounds": [{"most": most, **dict(bound.about)} for bound, most in self.bounds],
        }

    def failing(self, values: Mapping[str, Any]) -> float:
        """Largest share, over the guards, of runs beyond the limit."""
        return max((g.share_beyond(values, self.limit) for g in self.guards), default=0.0)

    def beyond(self, values: Mapping[str, Any]) -> float:
        """Largest share by which a bound is broken, 0 where none is."""
        return max([0.0, *(bound(values) / most - 1.0 for bound, most in self.bounds)])

    def __call__(self, values: Mapping[str, Any]) -> float:
        """The guarded value at `values`."""
        price = self.price * (self.failing(values) + self.beyond(values))
        return self.goal(values) * (1.0 + price)
