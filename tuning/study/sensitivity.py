"""Which parameters matter, from data: importances of the trials, and sweeps around the winner."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna

from navgym.core.checks import Array
from navgym.core.parameters import Parameter, ParameterSpace
from navgym.metrics.measures import METRICS
from navgym.tuning.comparison import LEAST
from navgym.tuning.objectives import InstanceGoal
from navgym.tuning.study.run import Outcome
from navgym.tuning.study.search_space import distribution, distributions, to_optuna

POINTS = 13  # of a sweep
FLAT = 0.01  # losses that differ by less than this share, or so many nats, are alike
# A flat stretch worth telling is at least this share of the parameter's range, on its own scale
STRETCH = 0.25
LEAST_TRIALS = 20  # for importances: fewer say nothing


@dataclass(frozen=True, eq=False)
class Sweep:
    """The metric along one parameter, the others held at the winner's.

    Args:
        parameter: what is varied.
        chosen: its value in the winner.
        values: (n,) as numbers, the winner's among them.
        change: (n,) metric over the winner's, less 1; of logarithms metric less the winner's.
        low: (n,) lower ends of 95 % intervals, from paired runs.
        high: (n,) upper ends.
        relative: whether changes are shares.
    """

    parameter: Parameter
    chosen: float
    values: Array
    change: Array
    low: Array
    high: Array
    relative: bool = True

    @property
    def span(self) -> float:
        """Largest less smallest metric, as a share of the winner's or as it is."""
        return float(self.change.max() - self.change.min())

    @property
    def dead(self) -> bool:
        """Whether no value makes a difference."""
        return self.span < FLAT

    @property
    def flat(self) -> tuple[float, float] | None:
        """The longest stretch of values that are alike, if it is worth telling; its two ends."""
        places = np.array([self.parameter.warp(v) for v in self.values])
        whole = places[-1] - places[0]
        best, ends = STRETCH * whole, None
        for i in range(len(places)):
            for j in range(i + 1, len(places)):
                piece = self.change[i : j + 1]
                if piece.max() - piece.min() < FLAT and places[j] - places[i] >= best:
                    best, ends = places[j] - places[i], (i, j)
        return None if ends is None else (float(self.values[ends[0]]), float(self.values[ends[1]]))

    @property
    def at_edge(self) -> bool:
        """Whether the winner sits in an outer fiftieth of the range of a knob that matters."""
        p = self.parameter
        place = (p.warp(self.chosen) - p.warp(p.low)) / (p.warp(p.high) - p.warp(p.low))
        return not self.dead and not p.choices and not 0.02 < place < 0.98


def sweeps(
    goal: InstanceGoal,
    winner: Mapping[str, Any],
    run: Callable[[Sequence[tuple[Any, ...]]], list[Any]],
    points: int = POINTS,
    relative: bool = True,
) -> list[Sweep]:
    """A sweep per free parameter, on the goal's instances.

    Args:
        goal: on recordings that were not tuned on.
        winner: values of the free parameters.
        run: evaluates many calls of `navgym.tuning.study.racing.evaluate`.
        points: values per parameter, evenly spaced on its scale.
        relative: whether losses may be told as shares: not so of logarithms.
    """
    grids = [_grid(p, float(p.check(winner[p.name])), points) for p in goal.space]
    calls = [
        (goal, {**winner, p.name: p.show(v)}, None)
        for p, grid in zip(goal.space, grids, strict=True)
        for v in grid
    ]
    (base, *found) = [e.losses for e in run([(goal, dict(winner), None), *calls])]
    metric, done, made = METRICS[goal.metric], 0, []
    for p, grid in zip(goal.space, grids, strict=True):
        losses = np.array(found[done : done + len(grid)])
        done += len(grid)
        made.append(_sweep(p, float(p.check(winner[p.name])), grid, losses, base, metric, relative))
    return made


def _grid(p: Parameter, chosen: float, points: int) -> Array:
    """Evenly spaced values on the parameter's scale, whole ones where it is whole."""
    if p.choices:
        return np.arange(len(p.choices), dtype=np.float64)
    even = np.linspace(p.warp(p.low), p.warp(p.high), points)
    values = [min(max(p.unwarp(u), p.low), p.high) for u in even] + [chosen]
    return np.unique([float(round(v)) if p.integer else v for v in values])


def _sweep(
    p: Parameter,
    chosen: float,
    grid: Array,
    losses: Array,
    base: Array,
    metric: Any,
    relative: bool,
) -> Sweep:
    """Change of the metric with the interval of a paired mean (of runs) at each value."""
    reference = float(metric(base))
    scale = abs(reference) if reference and relative else 1.0
    change = np.array([float(metric(each)) - reference for each in losses]) / scale
    around = np.zeros(len(grid))
    if len(base) >= LEAST:
        around = 1.96 * (losses - base).std(axis=1, ddof=1) / np.sqrt(len(base)) / scale
    return Sweep(p, chosen, grid, change, change - around, change + around, relative)


def importances(outcome: Outcome, space: ParameterSpace) -> dict[str, float]:
    """PED-ANOVA importances of the free parameters, shares of 1, the largest first.

    How much each parameter sets the best tenth of the trials apart from all of them. Empty where there
    are too few trials to say.
    """
    if len(outcome.trials) < LEAST_TRIALS or len(space) < 2:
        return {}
    study = _replayed(outcome, space)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        evaluator = optuna.importance.PedAnovaImportanceEvaluator()
        found = optuna.importance.get_param_importances(study, evaluator=evaluator)
    names = {distribution(p)[0]: p.name for p in space}
    return {names[n]: float(v) for n, v in sorted(found.items(), key=lambda item: -item[1])}


def _replayed(outcome: Outcome, space: ParameterSpace) -> optuna.Study:
    """The trials as a study in memory: whatever storage they came from."""
    study = optuna.create_study()
    study.add_trials(
        [
            optuna.create_trial(
                params=to_optuna(space, t.values),
                distributions=distributions(space),
                value=t.result,
            )
            for t in outcome.trials
        ]
    )
    return study
