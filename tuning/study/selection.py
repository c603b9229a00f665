"""From a study's trials to parameters that can be shipped: fresh seeds, round numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from navgym.core.parameters import ParameterSpace
from navgym.metrics.measures import METRICS
from navgym.tuning.objectives import Evaluation, Goal, InstanceGoal
from navgym.tuning.study.racing import evaluate
from navgym.tuning.study.run import Outcome, Trial

TOP = 8  # trials that are looked at again


def confirm(
    outcome: Outcome,
    fresh: Goal,
    top: int = TOP,
    run: Callable[[Sequence[tuple[Any, ...]]], list[Any]] | None = None,
) -> Trial:
    """The best of the `top` trials on recordings that the study has not seen.

    The first of a hundred trials is the luckiest as well as one of the best; the result carried by
    the returned trial is that on the fresh recordings. A trial that breaks a limit there is chosen only
    if all do.

    Args:
        outcome: of the study.
        fresh: the goal on other recordings.
        top: how many leaders.
        run: evaluates many calls of `navgym.tuning.study.racing.evaluate`; here, by default.
    """
    leaders = sorted(outcome.trials, key=lambda t: (not t.feasible, t.given_up, t.result))[:top]
    calls = [(fresh, dict(t.values), None) for t in leaders]
    found = [evaluate(*call) for call in calls] if run is None else run(calls)
    again = [_again(t, fresh, f) for t, f in zip(leaders, found, strict=True)]
    return min(again, key=lambda t: (not t.feasible, t.result))


def _again(trial: Trial, fresh: Goal, found: Any) -> Trial:
    if not isinstance(found, Evaluation):
        return Trial(trial.number, trial.values, found)
    assert isinstance(fresh, InstanceGoal)
    result = float(METRICS[fresh.metric](found.losses))
    feasible = all(v <= 0.0 for v in found.constraints.values())
    cost = found.microseconds if getattr(fresh, "costed", False) else None
    return Trial(trial.number, trial.values, result, cost, feasible=feasible)


def rounded(space: ParameterSpace, values: Mapping[str, Any], digits: int = 2) -> dict[str, Any]:
    """`values` to `digits` significant ones on each parameter's own scale, inside its range."""
    return {p.name: _round(space, p.name, values[p.name], digits) for p in space}


def _round(space: ParameterSpace, name: str, value: Any, digits: int) -> Any:
    p = space[name]
    if p.integer:
        return value
    if p.scale == "log-complement":
        near = 1.0 - _significant(1.0 - float(value), digits)
    else:
        near = _significant(float(value), digits)
    return p.show(round(min(max(near, p.low), p.high), 10))


def _significant(value: float, digits: int) -> float:
    if value == 0.0:
        return 0.0
    return round(value, digits - 1 - math.floor(math.log10(abs(value))))
