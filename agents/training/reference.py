"""The tuned parameters that an agent starts from and is measured against."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from navgym.agents.training.logs import LEAST, WHOLE, Logs, Span
from navgym.core.atomic import replacing
from navgym.problem import Problem
from navgym.tuned import as_model, read_tuned
from navgym.tuning import declared
from navgym.tuning.cases import Cases
from navgym.tuning.objectives import Objective, Pooled
from navgym.tuning.study.run import search
from navgym.tuning.study.selection import confirm

DRAWS = 5  # of noise and losses per log and rate


class Asked(Protocol):
    """What a training says of its start."""

    @property
    def start(self) -> Path | None:
        """A tuned.toml."""

    @property
    def filter(self) -> str:
        """What is tuned without one."""

    @property
    def trials(self) -> int:
        """Of that study."""

    @property
    def seed(self) -> int:
        """Of its sampler."""


@dataclass(frozen=True)
class Start:
    """Tuned parameters.

    Args:
        filter: whose.
        parameters: as `navgym.estimate` takes them.
        about: what they rest on, as JSON holds it.
        model: the noise that the logs' model believes, as the table `[model]` of tuned.toml.
    """

    filter: str
    parameters: Mapping[str, Any]
    about: Mapping[str, Any]
    model: Mapping[str, Any]

    def save(self, path: Path, command: str = "") -> None:
        """Write a tuned.toml."""
        provenance = {"command": command, **self.about}
        whole = {
            "filter": self.filter, "parameters": dict(self.parameters), "model": dict(self.model),
            "provenance": provenance,
        }  # fmt: skip
        with replacing(path, text=True) as file:
            file.write(declared.to_toml(declared.plain(whole)))


def found_start(asked: Asked, logs: Logs, sees: bool, report: Callable[[str], None]) -> Start:
    """The parameters of `asked.start`, or tuned on `logs` by the truth or, if not `sees`, by the fixes.

    Raises ValueError for a file of a filter that the logs' problem lacks, logs without anything to judge by.
    """
    problem = logs.problem
    some = next(iter(logs.by_rate("train", 1).values()))
    checked(some, logs)
    believed = as_model(problem.noises(some.batch))
    if asked.start is not None:
        given = read_tuned(asked.start)
        problem.find(given.filter)
        some.space(given.filter).array(dict(given.parameters))
        about = {"file": asked.start.name, **_of_file(given.provenance)}
        report(f"starting from {asked.start.name}: {given.filter}")
        return Start(given.filter, dict(given.parameters), about, believed)
    measure = next(iter(problem.scoring.quantities)) if sees else some.foretold.name
    report(f"tuning {asked.filter} by {measure}, {asked.trials} trials")
    values = tuned(logs, asked.filter, measure, asked.trials, asked.seed)
    about = {"measure": measure, "trials": asked.trials, "logs": [logs.name(p) for p in logs.paths]}
    return Start(asked.filter, values, about, believed)


def _of_file(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Of a file's provenance what is short enough to be told on."""
    return {n: v for n, v in provenance.items() if isinstance(v, (str, int, float)) and n != "file"}


def checked(cases: Cases, logs: Logs) -> None:
    """ValueError where logs hold no fixes to judge by, or are too short."""
    if "fixes" in cases.problem.scoring.foretold and "fixes" not in cases.rows:
        raise ValueError(
            f"log {logs.name(logs.paths[0])} holds no position fixes, by which an agent is judged: name "
            "logs with fixes, or say which columns hold them (--read columns.px NAME)."
        )
    short = int(cases.batch.lengths.min())
    if short < 2 * LEAST:
        raise ValueError(f"a log has {short} rows, and {2 * LEAST} are needed: name a longer one.")


def free(problem: Problem, filter_name: str) -> list[str]:
    """Parameters that are tuned: the filter's own, but for numbers of sweeps, which cost time."""
    return [p.name for p in problem.find(filter_name).space if p.choices or not p.integer]


def tuned(
    logs: Logs, filter_name: str, measure: str, trials: int, seed: int = 0, span: Span = WHOLE
) -> dict[str, Any]:
    """The parameters that suit logs best by a measure, rates of losses weighed alike.

    Trials run on training seeds of noise and losses; validation seeds choose among the leaders.
    """
    made = [
        Pooled([
            Objective(filter_name, free(c.problem, filter_name), c, "mean", None, measure)
            for c in logs.by_rate(split, DRAWS, span).values()
        ])
        for split in ("train", "validation")
    ]  # fmt: skip
    outcome = search(made[0], trials, seed, progress=False).complete()
    return dict(confirm(outcome, made[1]).values)
