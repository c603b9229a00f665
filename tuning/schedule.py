"""Parameters by true regime: the bound of what steering a filter can win (SCIENCE A4)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from navgym._checks import Array
from navgym.estimation import parameter_space
from navgym.parameters import ParameterSpace
from tuning.cases import Cases


class RegimeTable:
    """Error of a filter whose parameters follow a table by the true regime, sample by sample.

    The regime is truth, so this bounds schedules and is no filter. Each scheduled parameter is
    free once per regime, under the name "forgetting [outlier]".

    Args:
        filter_name: a name of `navgym.filters()`.
        scheduled: names of the parameters that follow the regime.
        cases: simulated recordings of one scenario.
        fixed: the other parameters.

    Raises ValueError for recordings without regimes.
    """

    def __init__(
        self,
        filter_name: str,
        scheduled: Iterable[str],
        cases: Cases,
        fixed: Mapping[str, Any] | None = None,
    ) -> None:
        if not cases.recordings or any(r.regime is None for r in cases.recordings):
            raise ValueError("cases must hold simulated recordings, which know their regimes.")
        self.filter_name = filter_name
        self.scheduled = parameter_space(filter_name).subset(scheduled)
        self.cases = cases
        self.fixed = dict(fixed or {})
        self.regimes = tuple(cases.recordings[0].meta["regimes"])
        self.space = ParameterSpace(
            tuple(
                dataclasses.replace(p, name=f"{p.name} [{regime}]")
                for p in self.scheduled
                for regime in self.regimes
            )
        )
        self._plain = cases.plain_errors()

    @property
    def about(self) -> dict[str, Any]:
        """Filter, fixed parameters and recordings."""
        return {
            "filter": f"{self.filter_name}, parameters by true regime",
            "fixed": parameter_space(self.filter_name).defaults | self.fixed,
            "metric": "mean of the runs' position RMSE",
            "recordings": dict(self.cases.about),
        }

    def same_everywhere(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """`values` of the scheduled parameters as a table that is alike in every regime."""
        return {f"{p.name} [{g}]": values[p.name] for p in self.scheduled for g in self.regimes}

    def schedules(
        self, values: Mapping[str, Any], cases: Cases | None = None
    ) -> list[dict[str, Any]]:
        """One dict of parameters per recording; the scheduled ones with a number per sample.

        Args:
            values: of the free parameters.
            cases: other recordings of the same scenario; the table's own by default.
        """
        checked = dict(zip(self.space.names, self.space.array(values)[0], strict=True))
        tables = {
            p.name: np.array([checked[f"{p.name} [{g}]"] for g in self.regimes])
            for p in self.scheduled
        }
        return [
            self.fixed | {name: table[r.regime] for name, table in tables.items()}
            for r in (cases or self.cases).recordings
        ]

    def errors(self, values: Mapping[str, Any]) -> Array:
        """Bounded position RMSE of each run (N,) in m."""
        return self.cases.bounded_errors(
            self.filter_name, self.schedules(values), self._plain, decision_interval=1
        )

    def __call__(self, values: Mapping[str, Any]) -> float:
        """Mean over runs of the position RMSE, m."""
        return float(self.errors(values).mean())
