"""A program over logs, as a goal that a study can minimise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.metrics.measures import METRICS, Measure
from navgym.tuning.objectives import Evaluation
from navgym.tuning.programs.runner import Failed
from navgym.tuning.programs.scoring import BLOCKS, SUMS, Ruler, Run, Span
from navgym.tuning.programs.tools import Log, Runs, Tool


@dataclass(frozen=True, eq=False)
class Part:
    """A stretch of a log that runs are judged on.

    Args:
        log: the log.
        ruler: its ruler.
        span: of its stretches.
        plain: loss of the defaults there.
    """

    log: Log
    ruler: Ruler
    span: Span
    plain: float

    @property
    def about(self) -> str:
        """For the record."""
        return f"{self.log.name} ({self.log.digest[:8]}) {self.span[0] / BLOCKS:g}..{self.span[1] / BLOCKS:g}"


@dataclass(frozen=True, eq=False)
class ProgramGoal:
    """The loss of a program over parts of logs; an `InstanceGoal`.

    A run that fails counts as the ceiling that the measure has over the defaults' run, so the result is
    finite for any parameters.

    Args:
        tool: what is run.
        space: free parameters.
        fixed: values of all others.
        parts: of logs.
        measure: a name of `scoring.measures`.
        metric: of the parts' losses.
        runs: where runs are kept.
        priors: deviations of free parameters on their own scales, around the defaults; added to a
            likelihood as so many nats.
        label: measure for reports.
    """

    tool: Tool
    space: ParameterSpace
    fixed: Mapping[str, Any]
    parts: tuple[Part, ...]
    measure: Measure
    metric: str = "mean"
    runs: Runs = field(default_factory=Runs)
    priors: Mapping[str, float] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.parts)

    @property
    def about(self) -> dict[str, Any]:
        """Program, fixed parameters, metric, logs."""
        priors = {"priors": dict(self.priors)} if self.priors else {}
        return {
            "program": dict(self.tool.identity), "fixed": dict(self.fixed),
            "metric": f"{self.metric} of the logs' {self.measure.label}",
            "logs": [part.about for part in self.parts], **priors,
        }  # fmt: skip

    def on(self, parts: tuple[Part, ...], priors: Mapping[str, float] | None = None) -> ProgramGoal:
        """The same on other parts."""
        return ProgramGoal(
            self.tool, self.space, self.fixed, parts, self.measure, self.metric, self.runs,
            self.priors if priors is None else priors,
        )  # fmt: skip

    def run(self, part: Part, values: Mapping[str, Any]) -> Run:
        """The run of one part's log; raises `Failed`."""
        return self.runs.of(self.tool, part.log, {**self.fixed, **values}, part.ruler)

    def evaluate(self, values: Mapping[str, Any], which: Sequence[int] | None = None) -> Evaluation:
        """Losses of the parts `which`, one run of the program each."""
        wanted = self.parts if which is None else [self.parts[int(i)] for i in which]
        losses, failed, spent, rows = np.empty(len(wanted)), [], 0.0, 0
        for i, part in enumerate(wanted):
            ceiling = float(self.measure.ceiling(np.array(part.plain)))
            try:
                run = self.run(part, values)
                spent, rows = spent + run.seconds, rows + run.rows
                found = run.loss(self.measure.name, part.ruler, part.span)
                losses[i] = found if math.isfinite(found) and found <= ceiling else ceiling
            except Failed as error:
                losses[i] = ceiling
                failed.append(f"{part.log.name}: {error}")
        each = 1e6 * spent / rows if rows else math.nan
        return Evaluation(losses + self.penalty(values), {}, each, tuple(failed))

    def penalty(self, values: Mapping[str, Any]) -> float:
        """What the prior adds per component of all parts: −ln of its density, less that at its middle."""
        if not self.priors:
            return 0.0
        total = 0.0
        for name, deviation in self.priors.items():
            p = self.space[name]
            away = p.warp(float(p.check(values[name]))) - p.warp(p.default)
            total += 0.5 * (away / deviation) ** 2
        return total / self.components

    @property
    def components(self) -> int:
        """What is heard of the quantity in all parts."""
        return sum(p.ruler.components(SUMS[self.measure.name], p.span) for p in self.parts)

    def sums(self, values: Mapping[str, Any]) -> Array:
        """What each stretch of each part adds to the measure's sum (parts x BLOCKS,); infinite where the
        run failed.
        """
        name, found = SUMS[self.measure.name], []
        for part in self.parts:
            inside = slice(*part.span)
            try:
                run = self.run(part, values)
                run.loss(self.measure.name, part.ruler, part.span)
                found.append(run.sums[name][inside])
            except Failed:
                found.append(np.full(part.span[1] - part.span[0], np.inf))
        return np.concatenate(found)

    def __call__(self, values: Mapping[str, Any]) -> float:
        """The metric of the losses."""
        return float(METRICS[self.metric](self.evaluate(values).losses))
