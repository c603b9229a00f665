"""The maximum of a likelihood, found to its own precision, and how surely it is known.

Near its maximum a log-likelihood is a parabola whose width is the uncertainty of the parameters. The
parabola is measured by runs at steps that change the likelihood by about a nat, so that neither rounding
nor curvature beyond the second order matters. The covariance is the sandwich of White (1982), with
scores summed over stretches of the logs: it holds where the filter's model is wrong too, as far as
stretches are independent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.parameters import Parameter
from navgym.tuning.programs.objective import ProgramGoal

WIDTH = 1.96  # deviations of a 95 % interval
FIRST_STEP = 0.02  # of a parameter's range, on its own scale
NATS = (0.2, 5.0)  # what a step should change the likelihood by
ROUNDS = 15  # of Newton's method
DAMPED = (0.0, 0.03, 0.3, 3.0)  # of the largest curvature, Levenberg's way
NEAR = 0.05  # deviations from the maximum at which it counts as found
LEAST_STRETCHES = 20  # for the sandwich

Map = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], list[Any]]


@dataclass(frozen=True, eq=False)
class Fit:
    """The maximum of a likelihood.

    Args:
        values: of the free parameters there.
        intervals: (low, high) by name, 95 %; of those that the logs tell.
        untold: parameters that they do not tell.
        evaluations: parameter sets that were looked at.
    """

    values: Mapping[str, Any]
    intervals: Mapping[str, tuple[float, float]]
    untold: tuple[str, ...]
    evaluations: int


def nats(goal: ProgramGoal, values: Mapping[str, Any]) -> Array:
    """Negative log-likelihood of each stretch; the prior's part is the last."""
    prior = goal.penalty(values) * goal.components if goal.priors else 0.0
    return np.append(goal.sums(values), prior)


class _Surface:
    """The negative log-likelihood over some parameters on their own scales, evaluated in parallel."""

    def __init__(
        self, goal: ProgramGoal, start: Mapping[str, Any], names: Sequence[str], run: Map
    ) -> None:
        self.goal, self.start, self.run = goal, dict(start), run
        self.axes: list[Parameter] = [goal.space[name] for name in names]
        self.low = np.array([p.warp(p.low) for p in self.axes])
        self.high = np.array([p.warp(p.high) for p in self.axes])
        self.seen: dict[tuple[float, ...], Array] = {}

    def values(self, place: Array) -> dict[str, Any]:
        """Parameters at a place."""
        own = {
            p.name: min(max(p.unwarp(float(u)), p.low), p.high)
            for p, u in zip(self.axes, place, strict=True)
        }
        return self.start | own

    def at(self, places: Sequence[Array]) -> list[Array]:
        """Stretches' nats at each place."""
        keys = [tuple(map(float, place)) for place in places]
        new = [k for k in dict.fromkeys(keys) if k not in self.seen]
        found = self.run(nats, [(self.goal, self.values(np.array(k))) for k in new])
        self.seen |= dict(zip(new, found, strict=True))
        return [self.seen[k] for k in keys]


def fitted(goal: ProgramGoal, start: Mapping[str, Any], run: Map) -> Fit | None:
    """The maximum of the likelihood near `start`; None where there is none to be seen.

    Args:
        goal: whose measure is the likelihood.
        start: values of the free parameters, near the best.
        run: (function, arguments) to results, in parallel or not.
    """
    smooth = [p.name for p in goal.space if not p.choices and not p.integer]
    if not smooth:
        return None
    surface = _Surface(goal, start, smooth, run)
    place = np.array([p.warp(float(start[p.name])) for p in surface.axes])
    steps = FIRST_STEP * (surface.high - surface.low)
    steps, told = _steps(surface, place, steps)
    untold = tuple(n for n, known in zip(smooth, told, strict=True) if not known)
    if not told.any():
        return Fit(dict(start), {}, untold, len(surface.seen))
    if untold:  # held where they are: they say nothing of the others
        names = [n for n in smooth if n not in untold]
        inner = _Surface(goal, start, names, run)
        inner.seen = {}
        surface, place, steps = inner, place[told], steps[told]
    for _ in range(ROUNDS):
        gradient, hessian = _derivatives(surface, place, steps)
        if not np.isfinite(hessian).all() or not np.isfinite(gradient).all():
            return None  # the program fails on the way
        sizes, axes = np.linalg.eigh(hessian)
        moves = [
            -axes @ ((axes.T @ gradient) / (np.maximum(np.abs(sizes), 1e-9) + damped))
            for damped in np.abs(sizes).max() * np.array(DAMPED)
        ]
        if sizes[0] > 0.0 and math.sqrt(max(float(-gradient @ moves[0]), 0.0)) < NEAR:
            break
        place, moved = _moved(surface, place, moves)
        if not moved:
            break
        steps, _ = _steps(surface, place, steps)
    return _told(surface, place, steps, untold)


def _steps(surface: _Surface, place: Array, steps: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Steps that change the likelihood by about a nat, and along which axes anything does."""
    steps, told = steps.copy(), np.ones(len(steps), dtype=np.bool_)
    for _ in range(6):
        ends = _both(place, steps)
        middle, *around = (float(a.sum()) for a in surface.at([place, *ends]))
        curve = np.array(around[::2]) + np.array(around[1::2]) - 2.0 * middle  # twice the nats
        change = np.where(np.isfinite(curve), np.abs(curve) / 2.0, np.inf)
        whole = surface.high - surface.low
        told = ~((change < NATS[0]) & (steps >= 0.24 * whole))
        factor = np.where(change > NATS[1], 0.3, np.where(change < NATS[0], 3.0, 1.0))
        finer = (change > 0.0) & np.isfinite(change)
        factor = np.where(
            finer, np.clip(1.0 / np.sqrt(np.maximum(change, 1e-6)), 0.05, 20.0), factor
        )
        good = (change >= NATS[0]) & (change <= NATS[1])
        if (good | ~told).all():
            break
        steps = np.where(good, steps, np.clip(steps * factor, 1e-7 * whole, 0.25 * whole))
    return steps, told


def _both(place: Array, steps: Array) -> list[Array]:
    """Places a step below and above along each axis."""
    return [place + sign * step * axis for step, axis in zip(steps, np.eye(len(place)), strict=True) for sign in (-1, 1)]  # fmt: skip


def _derivatives(surface: _Surface, place: Array, steps: Array) -> tuple[Array, Array]:
    """Gradient (d,) and Hessian (d, d) of the negative log-likelihood."""
    d, axes = len(place), np.eye(len(place))
    pairs = [(i, j) for i in range(d) for j in range(i)]
    corners = [
        place + sign * (steps[i] * axes[i] + steps[j] * axes[j])
        for i, j in pairs
        for sign in (-1, 1)
    ]
    found = [float(a.sum()) for a in surface.at([place, *_both(place, steps), *corners])]
    middle, low, high, rest = found[0], np.array(found[1 : 2 * d + 1 : 2]), np.array(found[2 : 2 * d + 1 : 2]), found[2 * d + 1 :]  # fmt: skip
    with np.errstate(invalid="ignore"):
        gradient = (high - low) / (2.0 * steps)
        hessian = np.diag((high + low - 2.0 * middle) / steps**2)
        for n, (i, j) in enumerate(pairs):
            mixed = (
                rest[2 * n] + rest[2 * n + 1] - low[i] - high[i] - low[j] - high[j] + 2.0 * middle
            )
            hessian[i, j] = hessian[j, i] = mixed / (2.0 * steps[i] * steps[j])
    return gradient, hessian


def _moved(surface: _Surface, place: Array, moves: Sequence[Array]) -> tuple[Array, bool]:
    """The best of some moves, inside the ranges and a quarter of them at most; whether any is better."""
    most = 0.25 * (surface.high - surface.low)
    tries = [np.clip(place + np.clip(m, -most, most), surface.low, surface.high) for m in moves]
    here, *found = (float(a.sum()) for a in surface.at([place, *tries]))
    best = int(np.argmin(found))
    better = found[best] < here - 1e-9 * abs(here)
    return (tries[best], True) if better else (place, False)


def _told(surface: _Surface, place: Array, steps: Array, untold: tuple[str, ...]) -> Fit:
    """The maximum with the intervals of its parameters."""
    _, hessian = _derivatives(surface, place, steps)
    ends = surface.at(_both(place, steps))
    scores = np.column_stack(
        [(b - a) / (2.0 * h) for a, b, h in zip(ends[::2], ends[1::2], steps, strict=True)]
    )
    known, more = True, list[str]()
    intervals: dict[str, tuple[float, float]] = {}
    try:
        spread = np.linalg.inv(hessian)
    except np.linalg.LinAlgError:
        known = False
    if known and np.isfinite(hessian).all() and np.linalg.eigvalsh(hessian).min() > 0.0:
        stretches = scores[:-1][
            np.abs(scores[:-1]).max(axis=1) > 0.0
        ]  # the prior's score is no data
        if (
            len(stretches) >= LEAST_STRETCHES
            and np.isfinite(stretches).all()
            and not surface.goal.priors
        ):
            spread = (
                spread
                @ (len(stretches) * np.cov(stretches.T, ddof=1).reshape(spread.shape))
                @ spread
            )
        inside = (place - steps >= surface.low) & (place + steps <= surface.high)
        for p, u, variance, far in zip(surface.axes, place, np.diag(spread), inside, strict=True):
            if not far:  # at the end of its range the parabola is cut
                more.append(p.name)
                continue
            low, high = (p.unwarp(float(u + s * WIDTH * math.sqrt(variance))) for s in (-1, 1))
            intervals[p.name] = (low, high)
    else:
        more = [p.name for p in surface.axes]
    values = {
        n: surface.goal.space[n].show(surface.goal.space[n].check(v))
        for n, v in surface.values(place).items()
    }
    return Fit(values, intervals, (*untold, *more), len(surface.seen))
