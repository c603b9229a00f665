"""Candidates against the best one, instance by instance, until they are surely worse."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from navgym.core.checks import Array
from navgym.tuning.objectives import Evaluation, Goal, InstanceGoal

# Shares of the instances after which a candidate is looked at. Three looks at 5 % each give up about
# one candidate in ten that is as good as the best (Pocock's correction for three looks at 10 %).
LOOKS = (0.2, 0.4, 0.7)
P_VALUE = 0.05
EXACT = 50  # instances up to which SciPy counts all signs, where it finds no ties

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

    The judgement is that of Optuna's WilcoxonPruner on the instances that both have seen (it compares
    means too, and easy ones would flatter): a signed-rank test, unless the mean is no worse, or some
    loss is not finite. In a study a write per instance would cost more than the evaluation.
    """
    best = leader.losses[seen]
    if len(seen) < 2 or not (np.isfinite(best).all() and np.isfinite(losses).all()):
        return False
    return bool(sum(best) < sum(losses)) and _greater(losses - best)


def _greater(changes: Array) -> bool:
    """Whether Wilcoxon's signed-rank test finds changes (N,) greater than zero, at `P_VALUE`.

    Where ranks are clear, a few microseconds instead of SciPy's millisecond.
    """
    sizes = np.sort(np.abs(changes))
    if len(changes) > EXACT or sizes[0] == 0.0 or (sizes[1:] == sizes[:-1]).any():
        found = stats.wilcoxon(changes, alternative="greater", zero_method="zsplit")
        return bool(found.pvalue < P_VALUE)
    ranks = np.searchsorted(sizes, changes[changes > 0.0]) + 1
    return int(ranks.sum()) >= _enough(len(changes))


@functools.cache
def _enough(count: int) -> int:
    """The least sum of the positive changes' ranks, of `count`, that chance reaches less often."""
    ways = np.ones(1)  # by the sum, to choose the ranks so far
    for rank in range(1, count + 1):
        ways = np.pad(ways, (0, rank)) + np.pad(ways, (rank, 0))
    reached = np.cumsum(ways[::-1])[::-1] / 2.0**count
    return int(np.argmax(reached < P_VALUE)) if reached[-1] < P_VALUE else len(ways)
