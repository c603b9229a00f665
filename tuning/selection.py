"""From a study's trials to parameters that can be shipped: fresh seeds, round numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from navgym.parameters import ParameterSpace
from tuning.objective import Goal
from tuning.study import Outcome, Trial

TOP = 8  # trials that are looked at again


def confirm(outcome: Outcome, fresh: Goal, top: int = TOP) -> Trial:
    """The best of the `top` trials on recordings that the study has not seen.

    The first of a hundred trials is the luckiest as well as one of the best; the result carried by
    the returned trial is that on the fresh recordings.
    """
    leaders = sorted(outcome.trials, key=lambda t: t.result)[:top]
    again = [Trial(t.number, t.values, fresh(t.values)) for t in leaders]
    return min(again, key=lambda t: t.result)


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
