"""What a study minimises: parameters in, one number out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

from navgym._checks import Array, one_of
from navgym.batch import Batch
from navgym.estimation import parameter_space
from navgym.parameters import ParameterSpace
from tuning.cases import Cases

METRICS: Mapping[str, Callable[[Array], float]] = MappingProxyType(
    {
        "mean": lambda errors: float(errors.mean()),
        "median": lambda errors: float(np.median(errors)),
        "quantile 95 %": lambda errors: float(np.quantile(errors, 0.95)),
    }
)


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


class Objective:
    """Position error of one filter over a set of recordings, as a function of free parameters.

    Args:
        filter_name: a name of `navgym.filters()`.
        free: names of the parameters to vary; the order is the study's.
        cases: the recordings, as `Cases` or as a plain `Batch` whose position states are 0 and 2.
        metric: of the per-run RMSE: a name of `METRICS`.
        fixed: parameters held at values of their own; the others stay at their defaults.

    Raises:
        ValueError: unknown filter, parameter or metric; no free parameter, or one that is fixed
            as well; recordings without truth.

    A diverged run counts as ten times the error of the plain filter on the same recording
    (`Cases.bounded_errors`), so the result is finite for any parameters.
    """

    def __init__(
        self,
        filter_name: str,
        free: Iterable[str],
        cases: Cases | Batch,
        metric: str = "mean",
        fixed: Mapping[str, Any] | None = None,
    ) -> None:
        whole = parameter_space(filter_name)
        self.filter_name = filter_name
        self.space = whole.subset(free)
        self.fixed = dict(fixed or {})
        self.cases = Cases(cases) if isinstance(cases, Batch) else cases
        self.metric = one_of("metric", metric, METRICS)
        _check_names(self.space, self.fixed)
        whole.array(self.fixed)
        self._plain = self.cases.plain_errors()

    @property
    def about(self) -> dict[str, Any]:
        """Filter, fixed parameters, metric and recordings."""
        whole = parameter_space(self.filter_name)
        rest = [name for name in whole.names if name not in self.space.names]
        held = whole.defaults | self.fixed
        return {
            "filter": self.filter_name,
            "fixed": {name: held[name] for name in rest},
            "metric": f"{self.metric} of the runs' position RMSE",
            "recordings": dict(self.cases.about),
        }

    def errors(self, values: Mapping[str, Any]) -> Array:
        """Bounded position RMSE of each run (N,) in m."""
        parameters = self.fixed | dict(values)
        return self.cases.bounded_errors(self.filter_name, parameters, self._plain)

    def share_beyond(self, values: Mapping[str, Any], limit: float) -> float:
        """Share of runs that are more than `limit` times worse than the plain filter's."""
        return float((self.errors(values) > limit * self._plain).mean())

    def __call__(self, values: Mapping[str, Any]) -> float:
        """The metric, m, at `values` of the free parameters."""
        return METRICS[self.metric](self.errors(values))


def _check_names(space: ParameterSpace, fixed: Mapping[str, Any]) -> None:
    if len(space) == 0:
        raise ValueError("free must name at least one parameter to vary, got none.")
    both = sorted(set(space.names) & set(fixed))
    if both:
        raise ValueError(f"{both[0]!r} is free and fixed at once: name it in one of the two.")


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
    more than `limit` times worse than the plain filter's. A mean hardly notices one run in a
    hundred that locks out; whoever sails in it does.

    Args:
        goal: what to minimise.
        guards: objectives over the same space; take many recordings, rare failures are the point.
        limit: a run's error over the plain filter's, above which it failed.
        price: what a failing share of 1 costs, in goals.
    """

    goal: Goal
    guards: Sequence[Objective]
    limit: float = 2.0
    price: float = 20.0

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
        }

    def failing(self, values: Mapping[str, Any]) -> float:
        """Largest share, over the guards, of runs beyond the limit."""
        return max((g.share_beyond(values, self.limit) for g in self.guards), default=0.0)

    def __call__(self, values: Mapping[str, Any]) -> float:
        """The guarded value at `values`."""
        return self.goal(values) * (1.0 + self.price * self.failing(values))
