"""Timing in turns: machines are noisy, so ratios of one run are what counts."""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium

import navgym
from navgym.core.kernel_cache import VARIABLE


@dataclass(frozen=True)
class Row:
    """One line of the table: what was measured, what it should be, and what it was."""

    what: str
    wanted: str
    found: str


def seconds(task: Callable[[], Any]) -> float:
    """Wall time of one call."""
    began = time.perf_counter()
    task()
    return time.perf_counter() - began


def paired(
    ours: Callable[[], Any], theirs: Callable[[], Any], rounds: int
) -> tuple[float, float, float]:
    """Median times of both, run in turns, and the median ratio theirs over ours."""
    ours(), theirs()
    times = [(seconds(ours), seconds(theirs)) for _ in range(rounds)]
    ratios = [b / a for a, b in times]
    mine, other = (statistics.median(column) for column in zip(*times, strict=True))
    return mine, other, statistics.median(ratios)


def episodes(env: gymnasium.Env[Any, Any], steps: int) -> Callable[[], None]:
    """A task: `steps` steps with random actions and resets in between."""
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(256)]

    def task() -> None:
        for k in range(steps):
            _, _, terminated, truncated, _ = env.step(actions[k & 255])
            if terminated or truncated:
                env.reset()

    return task


def python(code: str) -> float:
    """Wall time of `code` in a fresh interpreter, by its own clock."""
    script = f"import time; t = time.perf_counter()\n{code}\nprint(time.perf_counter() - t)"
    done = subprocess.run(  # noqa: S603 - this interpreter, words of our own
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return float(done.stdout)


def compiled(code: str) -> float:
    """Processor seconds that the last line of `code` takes in an interpreter without kernels on disk."""
    *before, last = code.strip().splitlines()
    lines = ["import time", *before, "began = time.process_time()", last]
    script = "\n".join([*lines, "print(time.process_time() - began)"])
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(  # noqa: S603 - this interpreter, words of our own
            [sys.executable, "-c", script],
            capture_output=True, text=True, check=True, env=dict(os.environ) | {VARIABLE: folder},
        )  # fmt: skip
    return float(done.stdout.split()[-1])


def measured(parts: Sequence[Callable[[int], Row | list[Row]]], rounds: int) -> list[Row]:
    """Every part's rows, told on standard error as they come."""
    rows: list[Row] = []
    for part in parts:
        print(f"measuring {part.__name__.replace('_', ' ')} ...", file=sys.stderr)
        found = part(rounds)
        more = found if isinstance(found, list) else [found]
        for row in more:
            print(f"  {row.what}: {row.found} (wanted: {row.wanted})", file=sys.stderr)
        rows += more
    return rows


def machine() -> str:
    """Versions, cores and the load of the last minute."""
    return (
        f"navgym {navgym.__version__}, Python {platform.python_version()}, "
        f"{os.cpu_count()} cores ({platform.machine()}), load {os.getloadavg()[0]:.1f}"
    )


def as_markdown(title: str, command: str, rows: Sequence[Row]) -> str:
    """The table with what is needed to read it."""
    lines = [
        f"# How fast: {title}",
        "",
        f"Written by `{command}`. Pairs were run in turns; a ratio is the median over the turns.",
        "",
        f"{machine()}.",
        "",
        "| what | wanted | found |",
        "|---|---|---|",
        *(f"| {r.what} | {r.wanted} | {r.found} |" for r in rows),
        "",
    ]
    return "\n".join(lines)
