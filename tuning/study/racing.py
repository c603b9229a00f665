"""Candidates against the best one, instance by instance, until they are surely worse."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.trial import FrozenTrial, TrialState

from navgym.core.checks import Array
from navgym.tuning.objectives import Evaluation, Goal, InstanceGoal

# Shares of the instances after which a candidate is looked at. Three looks at 5 % each give up about
# one candidate in ten that is as good as the best (Pocock's correction for three looks at 10 %).
LOOKS = (0.2, 0.4, 0.7)
P_VALUE = 0.05

Order = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Leader:
    """The best candidate so far.

    Args:
        value: its metric.
        losses: (N,) of every instance.
    """

    value: float
    losses: Array


def evaluate(goal: Goal, values: Mapping[str, Any], which: Order | None) -> Any:
    """One evaluation, wherever it is made: a number, or an `Evaluation` of the instances `which`."""
    if isinstance(goal, InstanceGoal):
        return goal.evaluate(values, which)  # type: ignore[arg-type]
    return goal(values)


def order(instances: int, seed: int, trial: int, shuffle: bool) -> Order:
    """The order in which a trial sees the instances: its own, so that no few of them rule."""
    if not shuffle:
        return np.arange(instances)
    return np.random.default_rng([seed, trial, instances]).permutation(instances)


def race(
    goal: InstanceGoal,
    sets: Sequence[Mapping[str, Any]],
    orders: Sequence[Order],
    leader: Leader | None,
    run: Callable[[Sequence[tuple[Any, ...]]], list[Any]],
) -> list[tuple[Evaluation, Order]]:
    """Evaluate parameter sets side by side, look by look, giving up those that are surely worse.

    Args:
        goal: what to evaluate.
        sets: parameter sets.
        orders: the order of instances of each.
        leader: what they are held against; None: nobody is given up.
        run: evaluates many calls of `evaluate`.

    Returns the evaluation of each, and the instances that it has seen, in order.
    """
    ends = [round(x * len(goal)) for x in LOOKS] if leader is not None else []
    edges = sorted({0, *ends, len(goal)})
    parts: list[list[Evaluation]] = [[] for _ in sets]
    seen = [order_[:0] for order_ in orders]
    alive = list(range(len(sets)))
    for first, last in itertools.pairwise(edges):
        found = run([(goal, sets[i], orders[i][first:last]) for i in alive])
        for i, part in zip(alive, found, strict=True):
            parts[i].append(part)
            seen[i] = orders[i][:last]
        if leader is not None and last < len(goal):
            alive = [
                i
                for i in alive
                if not hopeless(leader, seen[i], Evaluation.joined(parts[i]).losses)
            ]
    return [(Evaluation.joined(p), s) for p, s in zip(parts, seen, strict=True)]


def hopeless(leader: Leader, seen: Order, losses: Array) -> bool:
    """Whether a candidate with these losses on the instances `seen` is surely worse than the leader.

    The judgement is that of Optuna's WilcoxonPruner, in a study of its own with the two of them: in
    the real one, a write per instance would cost more than the evaluation.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        pruner = optuna.pruners.WilcoxonPruner(p_threshold=P_VALUE)
        judge = optuna.create_study()
        # the same instances of both: the pruner compares means too, and easy ones would flatter
        best = dict(zip(seen.tolist(), leader.losses[seen].tolist(), strict=True))
        judge.add_trial(_trial(best, leader.value))
        rival = dict(zip(seen.tolist(), losses.tolist(), strict=True))
        return pruner.prune(judge, _trial(rival, None))


def _trial(values: Mapping[int, float], result: float | None) -> FrozenTrial:
    return optuna.create_trial(
        state=TrialState.RUNNING if result is None else TrialState.COMPLETE,
        value=result,
        intermediate_values=dict(values),
    )
