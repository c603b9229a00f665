"""Parameters by true regime: the bound of what steering a filter can win.

docs/science/qivbf.md#scenarios-and-headroom, docs/science/idam.md#scenarios-and-headroom.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.metrics.measures import METRICS, bounded
from navgym.tuning.cases import Cases
from navgym.tuning.objectives import Evaluation, checked_measure, plain_quantities


class RegimeTable:
    """Loss of a filter whose parameters follow a table by the true regime, sample by sample.

    The regime is truth, so this bounds schedules and is no filter. Each scheduled parameter is
    free once per regime, under the name "forgetting [outlier]".

    Args:
        filter_name: one of the recordings' problem's.
        scheduled: names of the parameters that follow the regime.
        cases: simulated recordings of one scenario.
        fixed: the other parameters.
        measure: the loss of a run, as for `navgym.tuning.objectives.Objective`.

    Raises ValueError for recordings without regimes.
    """

    metric = "mean"

    def __init__(
        self,
        filter_name: str,
        scheduled: Iterable[str],
        cases: Cases,
        fixed: Mapping[str, Any] | None = None,
        measure: str | None = None,
    ) -> None:
        if not cases.regimes:
            raise ValueError("cases must hold simulated recordings, which know their regimes.")
        self.filter_name = filter_name
        self._whole = cases.problem.find(filter_name).space
        self.scheduled = self._whole.subset(scheduled)
        self.cases = cases
        self.fixed = dict(fixed or {})
        self.measure = checked_measure(cases, measure)
        self.space = ParameterSpace(
            tuple(
                dataclasses.replace(p, name=f"{p.name} [{regime}]")
                for p in self.scheduled
                for regime in cases.regimes
            )
        )
        self._plain = plain_quantities(cases, self.measure)

    def on(self, cases: Cases) -> RegimeTable:
        """The same table on other recordings of the scenario."""
        names = self.scheduled.names
        return RegimeTable(self.filter_name, names, cases, self.fixed, self.measure.name)

    def __len__(self) -> int:
        return len(self.cases)

    @property
    def about(self) -> dict[str, Any]:
        """Filter, fixed parameters and recordings."""
        return {
            "filter": f"{self.filter_name}, parameters by true regime",
            "fixed": self._whole.defaults | self.fixed,
            "metric": f"mean of the runs' {self.measure.label}",
            "recordings": dict(self.cases.about),
        }

    def same_everywhere(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """`values` of the scheduled parameters as a table that is alike in every regime."""
        return {
            f"{p.name} [{g}]": values[p.name] for p in self.scheduled for g in self.cases.regimes
        }

    def schedules(
        self, values: Mapping[str, Any], cases: Cases | None = None
    ) -> list[dict[str, Any]]:
        """One dict of parameters per recording; the scheduled ones with a number per filter step.

        Args:
            values: of the free parameters.
            cases: other recordings of the same scenario; the table's own by default.
        """
        checked = dict(zip(self.space.names, self.space.array(values)[0], strict=True))
        chosen = self.cases if cases is None else cases
        rows = {
            p.name: chosen.by_regime([checked[f"{p.name} [{g}]"] for g in chosen.regimes])
            for p in self.scheduled
        }
        return [
            self.fixed | {name: each[i] for name, each in rows.items()} for i in range(len(chosen))
        ]

    def evaluate(self, values: Mapping[str, Any], which: Sequence[int] | None = None) -> Evaluation:
        """Losses of the recordings `which`, in one call of the kernel."""
        cases = self.cases if which is None else self.cases.take(which)
        plain = self._plain if which is None else {q: p[which] for q, p in self._plain.items()}
        schedules = self.schedules(values, cases)
        quantities = self.measure.quantities
        found = cases.judge(self.filter_name, schedules, tuple(quantities), 1)
        kept = bounded(found, plain, quantities)
        return Evaluation(self.measure.losses(kept, self._plain), {}, found.microseconds)

    def errors(self, values: Mapping[str, Any]) -> Array:
        """Loss of each run (N,), bounded."""
        return self.evaluate(values).losses

    def __call__(self, values: Mapping[str, Any]) -> float:
        """Mean over runs of the loss."""
        return float(METRICS[self.metric](np.asarray(self.errors(values))))
