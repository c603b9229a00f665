"""Before a study of a program: what it says at its defaults, on which logs, and whether it says it twice."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from navgym.tuning.programs.runner import Failed
from navgym.tuning.programs.scoring import BLOCKS, Ruler, chosen
from navgym.tuning.programs.tools import Log, Runs, Tool

REPEATED = 5  # logs that are run again
WIDTH = 1.96  # deviations of a 95 % interval
Map = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], list[Any]]


@dataclass(frozen=True)
class Repeatability:
    """How much runs differ that should be the same.

    Args:
        runs: of the same parameters on each of the logs looked at.
        deviation: of the mean loss over the tuned logs, from run to run.
        unit: of the loss.
        mean: of it.
    """

    runs: int = 1
    deviation: float = 0.0
    unit: str = ""
    mean: float = math.nan

    @property
    def seen(self) -> float:
        """The least difference of two parameter sets that shows through."""
        return WIDTH * math.sqrt(2.0) * self.deviation

    @property
    def said(self) -> str:
        """That, in words."""
        if self.runs < 2:
            return (
                "The defaults were run once: whether the program says the same twice is not known."
            )
        if self.deviation == 0.0:
            return f"The program is deterministic: {self.runs} runs of the defaults agree in every digit."
        share = f" ({100 * self.seen / abs(self.mean):.2g} %)" if self.mean else ""
        return (
            f"The program is not deterministic: over {self.runs} runs of the defaults the loss varies by "
            f"{self.deviation:.2g} {self.unit}".rstrip()
            + f" (one deviation). Differences below {self.seen:.2g}{share} cannot be told from chance here."
        )


def rulers(
    tool: Tool, runs: Runs, logs: Sequence[Log], values: Mapping[str, Any], run: Map
) -> tuple[dict[str, Ruler], dict[str, str]]:
    """Rulers by a log's digest, of the logs on which the defaults run, and what is wrong on the others.

    Raises ValueError where they run on no log, and where logs are of different kinds.
    """
    found = run(_measured, [(tool, runs, log, dict(values)) for log in logs])
    made = {
        log.digest: each for log, each in zip(logs, found, strict=True) if isinstance(each, Ruler)
    }
    lost = {log.name: each for log, each in zip(logs, found, strict=True) if isinstance(each, str)}
    if not made:
        name, why = next(iter(lost.items()))
        raise ValueError(
            f"the program gives nothing to judge at its default parameters, on any log. {name}: {why}"
        )
    kinds = {log.name: made[log.digest].kinds for log in logs if log.digest in made}
    first = next(iter(kinds))
    for name, each in kinds.items():
        if each != kinds[first]:
            raise ValueError(
                f"{first} and {name} are logs of different kinds: the program writes {', '.join(kinds[first])} "
                f"of one and {', '.join(each)} of the other. Tune them apart."
            )
    return made, lost


def _measured(tool: Tool, runs: Runs, log: Log, values: Mapping[str, Any]) -> Ruler | str:
    try:
        return runs.ruler(tool, log, values)
    except Failed as error:
        return str(error)


def repeatability(
    tool: Tool, runs: Runs, logs: Sequence[Log], rulers_: Mapping[str, Ruler], values: Mapping[str, Any],
    measure: str | None, repeats: int, run: Map,
) -> Repeatability:  # fmt: skip
    """Run the defaults again, on a few of the logs."""
    some = list(logs)[:REPEATED]
    unit = chosen(measure, rulers_[some[0].digest].kinds).parts[0]
    name = chosen(measure, rulers_[some[0].digest].kinds).name
    calls = [
        (tool, runs, log, dict(values), rulers_[log.digest], i, name)
        for log in some
        for i in range(repeats)
    ]
    table = np.array(run(_again, calls), dtype=np.float64).reshape(len(some), repeats)
    mean = float(np.nanmean(table)) if np.isfinite(table).any() else math.nan
    if repeats < 2 or not np.isfinite(table).all():
        return Repeatability(1, 0.0, unit.unit, mean)
    same = (table == table[:, :1]).all()
    variance = 0.0 if same else float(table.var(axis=1, ddof=1).mean()) / len(logs)  # of their mean
    return Repeatability(repeats, math.sqrt(variance), unit.unit, mean)


def _again(
    tool: Tool,
    runs: Runs,
    log: Log,
    values: Mapping[str, Any],
    ruler: Ruler,
    number: int,
    measure: str,
) -> float:
    try:
        found = runs.of(tool, log, values, ruler, number)
        return found.loss(measure, ruler, (0, BLOCKS))
    except Failed:
        return math.nan
