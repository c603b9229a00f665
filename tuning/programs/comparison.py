"""The defaults, the winner and what was started from, on logs that nobody tuned on."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.metrics import Consistency, nis_band
from navgym.metrics.blocks import Blocks
from navgym.tuning.comparison import LEAST, RESAMPLES, Comparison, Entry, rows_of
from navgym.tuning.programs.contract import Contract
from navgym.tuning.programs.objective import Part, ProgramGoal
from navgym.tuning.programs.runner import Failed
from navgym.tuning.programs.scoring import BLOCKS, SUMS, Run, measures, traces, value
from navgym.tuning.study.run import Trial

START = "{}, started from"
Map = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], list[Any]]


class _Named:
    """The program as a filter by name, for the comparison's rows."""

    def __init__(self, space: ParameterSpace) -> None:
        self.space = space

    def find(self, _name: str, /) -> Any:
        """Itself: there is but one."""
        return self


def compared(
    own: str, goal: ProgramGoal, contract: Contract, winner: Trial,
    first: Sequence[Mapping[str, Any]], run: Map,
) -> Comparison:  # fmt: skip
    """Defaults, winner and what was started from, on the same parts of logs.

    Args:
        own: what reports call the program.
        goal: on the parts that are reported on.
        contract: of the program.
        winner: of the study.
        first: parameters that it started from.
        run: (function, arguments) to results.
    """
    usual = {n: contract.space.defaults[n] for n in goal.space.names}
    sets = {f"{own}, default": usual, f"{own}, tuned": dict(winner.values)}
    sets |= {START.format(own): {**usual, **v} for v in first}
    calls = [(goal, part, values) for values in sets.values() for part in goal.parts]
    found = iter(run(_attempt, calls))
    runs = {label: [next(found) for _ in goal.parts] for label in sets}
    entries = [Entry(label, own, {**goal.fixed, **values}) for label, values in sets.items()]
    errors = {
        label: np.array([_loss(goal, p, r) for p, r in zip(goal.parts, each, strict=True)])
        for label, each in runs.items()
    }
    flags = {label: ~np.isfinite(each) for label, each in errors.items()}
    redrawn = _redrawn(goal, runs, errors)
    reference = f"{own}, default"
    rows = rows_of(
        entries,
        errors,
        flags,
        reference,
        (reference, ""),
        goal.measure,
        _Named(contract.space),
        redrawn=redrawn,
    )
    beside = _beside(goal, runs)
    return Comparison(
        rows, reference, {"logs": [p.about for p in goal.parts]}, errors,
        {label: _each_row(each) for label, each in runs.items()},
        {label: np.array([_trace(goal, p, r) for p, r in zip(goal.parts, each, strict=True)]) for label, each in runs.items()},
        goal.measure, beside,
        {n: measures(contract.columns.unit)[n].parts[0] for n in next(iter(beside.values()))},
        {label: _nis(goal, each) for label, each in runs.items()}, {}, redrawn,
    )  # fmt: skip


def _attempt(goal: ProgramGoal, part: Part, values: Mapping[str, Any]) -> Run | None:
    try:
        return goal.run(part, values)
    except Failed:
        return None


def _loss(goal: ProgramGoal, part: Part, run: Run | None, measure: str = "") -> float:
    try:
        return (
            math.inf
            if run is None
            else run.loss(measure or goal.measure.name, part.ruler, part.span)
        )
    except Failed:
        return math.inf


def _each_row(runs: Sequence[Run | None]) -> float:
    """µs per row of output."""
    done = [r for r in runs if r is not None]
    return (
        1e6 * sum(r.seconds for r in done) / max(sum(r.rows for r in done), 1) if done else math.nan
    )


def _trace(goal: ProgramGoal, part: Part, run: Run | None) -> Array:
    return np.full(BLOCKS, np.nan) if run is None else traces(run, goal.measure.name, part.span)


def _beside(
    goal: ProgramGoal, runs: Mapping[str, Sequence[Run | None]]
) -> dict[str, dict[str, float]]:
    """Means of what else the output tells."""
    heard = goal.parts[0].ruler.rows
    names = [
        n for n, s in SUMS.items() if s in heard and n not in (goal.measure.name, "consistency")
    ]
    return {
        label: {n: float(np.mean([_loss(goal, p, r, n) for p, r in zip(goal.parts, each, strict=True)])) for n in names}
        for label, each in runs.items()
    }  # fmt: skip


def _nis(goal: ProgramGoal, runs: Sequence[Run | None]) -> Consistency | None:
    """Mean NIS per component, and the band of as many independent ones."""
    told = [
        (r, p) for r, p in zip(runs, goal.parts, strict=True) if r is not None and "nis" in r.sums
    ]
    count = sum(float(r.counts["nis"][slice(*p.span)].sum()) for r, p in told)
    if not told or len(told) < len(runs) or count == 0:
        return None
    total = sum(float(r.sums["nis"][slice(*p.span)].sum()) for r, p in told)
    low, high = nis_band(count)
    return Consistency(int(count), total / count, float(low) / count, float(high) / count, math.nan)


def _redrawn(
    goal: ProgramGoal, runs: Mapping[str, Sequence[Run | None]], errors: Mapping[str, Array]
) -> dict[str, Array]:
    """Means of the measure over logs redrawn in blocks of stretches, where logs are few."""
    if len(goal.parts) >= LEAST:
        return {}
    name, drawn = SUMS[goal.measure.name], []
    for i, part in enumerate(goal.parts):
        blocks = Blocks.drawn(part.span[1] - part.span[0], RESAMPLES, i)
        if blocks is None:
            return {}
        drawn.append((slice(*part.span), blocks))
    found = {}
    for label, each in runs.items():
        if not np.isfinite(errors[label]).all():
            continue
        pairs = [(r, *b) for r, b in zip(each, drawn, strict=True) if r is not None]
        found[label] = np.mean(
            [
                value(goal.measure.name, b.means(r.sums[name][s]), b.means(r.counts[name][s]))
                for r, s, b in pairs
            ],
            axis=0,
        )
    return found
