"""How cost grows as work grows: time and memory at many sizes, each in a process of its own.

`navgym benchmark scaling` measures every point of `growths`, and `growth_page` tells them.
"""

from __future__ import annotations

import contextlib
import functools
import json
import math
import multiprocessing
import re
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import navgym
from navgym.auv.csv_log import read_csv, write_csv
from navgym.auv.problem import PROBLEM, STEERED
from navgym.simulation import simulate_many
from navgym.statespace.batch import StateSpaceBatch
from navgym.tuning.benchmarks.auv import stepping
from navgym.tuning.benchmarks.timing import seconds

DECISIONS, INTERVAL = 160, 5  # of an episode of the environment; filter steps in each
FILTERS = ("kf", "qivbf", "bank")
STEPS = 500  # samples of a recording
TRIALS = 200  # of a study, on 40 recordings of 800 samples
BATCH = 8  # trials at once, so that eight workers have one each
BOUND = 300.0  # s for a point, what comes before it included
LONG = 15.0  # s of a turn that is the only one
ENOUGH = 2.0  # s of turns, after which there is no further one
OWN = Path("/proc/self")  # where Linux tells of this process


@dataclass(frozen=True)
class Work:
    """Something of one size, made ready and warm.

    Args:
        task: does it once.
        units: that it consists of, such as filter steps.
        memory: peak bytes so far of everything that has worked on it.
    """

    task: Callable[[], Any]
    units: int
    memory: Callable[[], float]


@dataclass(frozen=True)
class Series:
    """One line of a plot: something done at growing sizes.

    Args:
        label: what it is.
        prepare: makes it of a size ready.
        sizes: in growing order.
    """

    label: str
    prepare: Callable[[int], Work]
    sizes: tuple[int, ...]


@dataclass(frozen=True)
class Growth:
    """What is done at growing sizes.

    Args:
        name: of its picture.
        title: of its part of the page.
        size: what a size counts.
        unit: what the time is told by.
        scale: name of the plot's unit of time, and how many make a second.
        series: what is compared.
        why: where its cost is not proportional to its size, and for which reason.
        each: whether units per second are told for each of a size as well.
    """

    name: str
    title: str
    size: str
    unit: str
    scale: tuple[str, float]
    series: tuple[Series, ...]
    why: str
    each: bool = False


@dataclass(frozen=True)
class Point:
    """What one size took.

    Args:
        size: of the work.
        seconds: median wall time.
        units: that it consists of.
        memory: peak, bytes.
        trouble: why there are no figures; "" where there are.
    """

    size: int
    seconds: float = math.nan
    units: int = 0
    memory: float = math.nan
    trouble: str = ""


Found = list[tuple[Series, list[Point]]]


# ---- what is done


def lanes(size: int, **arguments: Any) -> Work:
    """An episode of the vector environment."""
    return Work(stepping(size, DECISIONS, **arguments), size * DECISIONS * INTERVAL, peak)


def stacking(size: int) -> Work:
    """Recordings made one batch."""
    recordings = simulate_many("auv/switch-D", navgym.seeds("train", size), steps=STEPS)
    return Work(lambda: StateSpaceBatch.of(recordings), size * STEPS, peak)


def filtering(size: int, name: str) -> Work:
    """A filter over a batch of recordings."""
    recordings = simulate_many("auv/switch-D", navgym.seeds("train", size), steps=STEPS)
    batch = StateSpaceBatch.of(recordings)
    PROBLEM.run(name, batch.take([0]))
    return Work(lambda: PROBLEM.run(name, batch), size * STEPS, peak)


def estimating(size: int) -> Work:
    """`navgym.estimate` of one recording: states, covariances, innovations and all."""
    navgym.estimate("kf", navgym.simulate("auv/nominal", 0, steps=100))
    recording = navgym.simulate("auv/nominal", 0, steps=size)
    return Work(lambda: navgym.estimate("kf", recording), size, peak)


def reading(size: int) -> Work:
    """A text file with measurements and truth, as a recording."""
    folder = tempfile.TemporaryDirectory()
    path = Path(folder.name) / "log.csv"

    def task() -> None:
        assert folder  # it goes when the task does
        read_csv(path)

    for rows in (100, size):
        write_csv(navgym.simulate("auv/nominal", 0, steps=rows), path)
        if rows < size:
            task()
    return Work(task, size, peak)


def studying(size: int, trials: int = TRIALS, dask: bool = False) -> Work:
    """A study from nothing to its end, its journal and the start of `size` workers included."""
    from navgym.tuning.cases import Cases
    from navgym.tuning.objectives import Objective
    from navgym.tuning.study.executors import workers
    from navgym.tuning.study.run import Search, search

    goal = Objective("qivbf", STEERED, Cases.simulated("auv/switch-D", "train", 40))
    goal(goal.space.defaults)
    others = 0.0

    def task() -> None:
        nonlocal others
        with (
            tempfile.TemporaryDirectory() as folder,
            _scheduler(size, dask) as address,
            workers(1 if dask else size, address) as executor,
        ):
            how, where = Search(trials, batch=BATCH), Path(folder) / "study.log"
            search(goal, how, journal=where, executor=executor, progress=False)
            children = multiprocessing.active_children()
            others = sum((peak(child.pid) for child in children if child.pid), 0.0)

    return Work(task, trials, lambda: peak() + others)


@contextlib.contextmanager
def _scheduler(count: int, dask: bool) -> Iterator[str | None]:
    """Address of a dask scheduler with `count` workers on this machine, if there is to be one."""
    if not dask:
        yield None
        return
    from distributed import LocalCluster

    how: dict[str, Any] = {"threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(n_workers=count, **how) as cluster:  # type: ignore[no-untyped-call]
        yield cluster.scheduler_address


WHY_LANES = (
    "A step of the environment is one call for all lanes: what it costs Python is paid once, so "
    "that a single lane is dear, while among a hundred the filter is what takes the time. Lanes "
    "share the recordings of a pool and then take next to no memory. Without a pool each lane "
    "simulates a recording when it restarts, one lane after the other, runs the filters that it "
    "is compared with over it, and keeps it."
)
WHY_RECORDINGS = (
    "Filters take one recording after the other, so a sample costs the same among many as among "
    "few; what a call costs besides is seen where there is one. A sample stands in memory in "
    "its recording and in the batch, and its state beside it: covariances and innovations are "
    "not asked for here. Stacking copies and computes nothing, so it is as quick as memory."
)
WHY_ROWS = (
    "`navgym.estimate` keeps state, covariance, innovation, NIS and likelihood of every row, "
    "208 bytes; about as many again are the row in the recording and in the batch. With the "
    "last sizes memory itself counts: what the system has not given to anybody for long takes a "
    "first call up to twice as long, which is not in the table. A CSV file is looked through "
    "for its layout before it is read, which is what a short one pays for. Its memory is the "
    "text, where each cell begins and ends, and the numbers: some five times the file."
)
WHY_WORKERS = (
    "A worker imports, loads kernels and makes the recordings before its first trial: some 1.5 "
    "s of processor time. Asking for trials and telling them is one process's work, and a batch "
    "ends with its slowest trial. So workers pay up to the number of cores that are free, and "
    "where a study is much longer than their start; more of them than cores only cost. Memory "
    "is the sum over all processes, libraries that they share counted in each; a single worker "
    "is the study's own process, two are two more. Dask workers are such processes with a guard "
    "each, and a scheduler between them and the study."
)


def growths(quick: bool = False) -> tuple[Growth, ...]:
    """Everything that is measured; `quick`: the least of each kind."""
    tens = tuple(10**k for k in range(5))
    rows = tuple(10**k for k in range(3, 8))
    trials = BATCH if quick else TRIALS
    found = (
        Growth(
            "lanes", "Lanes of the vector environment", "lanes", "filter step", ("µs", 1e6),
            (
                Series("new recordings", lanes, tens),
                Series("pool of 256 recordings", functools.partial(lanes, pool=256), tens),
            ),
            WHY_LANES, each=True,
        ),
        Growth(
            "recordings", f"Recordings of {STEPS} samples", "recordings", "sample", ("µs", 1e6),
            (
                *(Series(n, functools.partial(filtering, name=n), tens) for n in FILTERS),
                Series("stacking", stacking, tens),
            ),
            WHY_RECORDINGS,
        ),
        Growth(
            "rows", "Rows of one log", "rows", "row", ("µs", 1e6),
            (
                Series('navgym.estimate("kf")', estimating, rows),
                Series("reading a CSV file", reading, rows[:-1]),
            ),
            WHY_ROWS,
        ),
        Growth(
            "workers", f"Workers of a study of {trials} trials", "workers", "trial", ("ms", 1e3),
            (
                Series("processes", functools.partial(studying, trials=trials), (1, 2, 4, 8)),
                Series("dask workers", functools.partial(studying, trials=trials, dask=True), (2,)),
            ),
            WHY_WORKERS,
        ),
    )  # fmt: skip
    return tuple(map(_least, found)) if quick else found


def _least(growth: Growth) -> Growth:
    """The first size of its first series."""
    first = growth.series[0]
    return replace(growth, series=(replace(first, sizes=first.sizes[:1]),))


# ---- a point, in a process of its own


def peak(process: int | str = "self") -> float:
    """Most bytes that a process has held in memory, NaN where the system does not tell.

    Not `resource.getrusage`: its maximum begins with what the process that started this one held.
    """
    return _told(Path(f"/proc/{process}/status"), "VmHWM")


def _told(path: Path, name: str) -> float:
    """A size that Linux tells in such a file, bytes."""
    with contextlib.suppress(OSError):
        found = re.search(rf"^{name}:\s+(\d+) kB", path.read_text(), re.MULTILINE)
        if found:
            return 1024.0 * int(found[1])
    return math.nan


def measured_here(work: Work, turns: int) -> dict[str, float]:
    """Median time of up to `turns` turns, and the memory of them and of what they work on.

    One turn goes before, if there is time for more than one: it takes from the system what the
    others are given again, and for gigabytes that takes as long as the work.
    """
    with contextlib.suppress(OSError):  # what was only needed to make it ready does not count
        (OWN / "clear_refs").write_text("5")
    times = [seconds(work.task)]
    while times[0] < LONG and len(times) <= turns and sum(times[1:]) < ENOUGH:
        times.append(seconds(work.task))
    typical = statistics.median(times[1:] or times)
    return {"seconds": typical, "units": work.units, "memory": work.memory()}


def _hold_to_free_memory() -> None:
    """Memory that is not there is an error of this process, instead of the whole machine's."""
    free, own = _told(Path("/proc/meminfo"), "MemAvailable"), _told(OWN / "status", "VmSize")
    if not math.isnan(free + own):
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (int(own + 0.9 * free), most))


def _child(quick: str, name: str, label: str, size: str, turns: str) -> None:
    """Print what a point took, as JSON."""
    _hold_to_free_memory()
    growth = next(g for g in growths(quick == "quick") if g.name == name)
    series = next(s for s in growth.series if s.label == label)
    try:
        found: dict[str, Any] = measured_here(series.prepare(int(size)), int(turns))
    except MemoryError as error:
        found = {"trouble": f"does not fit into the memory that is free ({error})"}
    print(json.dumps(found))


def point(growth: Growth, series: Series, size: int, turns: int, quick: bool) -> Point:
    """Measure one point in a new interpreter."""
    words = ["quick" if quick else "whole", growth.name, series.label, str(size), str(turns)]
    command = [sys.executable, "-m", __spec__.name, *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=BOUND, check=False)
    except subprocess.TimeoutExpired:
        return Point(size, trouble=f"not within {BOUND:.0f} s")
    if done.returncode:
        said = done.stderr.strip().splitlines()
        return Point(size, trouble=said[-1] if said else f"ended with status {done.returncode}")
    return Point(size, **json.loads(done.stdout.splitlines()[-1]))


def scaling(turns: int, quick: bool = False) -> list[tuple[Growth, Found]]:
    """Every point, told on standard error as it comes; no larger size after one that has failed."""
    found = []
    for growth in growths(quick):
        lines: Found = []
        for series in growth.series:
            print(f"measuring {growth.size}, {series.label} ...", file=sys.stderr)
            lines.append((series, list(_points(growth, series, turns, quick))))
        found.append((growth, lines))
    return found


def _points(growth: Growth, series: Series, turns: int, quick: bool) -> Iterator[Point]:
    trouble = ""
    for size in series.sizes:
        if trouble:
            yield Point(size, trouble="left out after the size before")
            continue
        made = point(growth, series, size, turns, quick)
        trouble = made.trouble
        told = trouble or f"{made.seconds:.4g} s, {made.memory / 2**20:,.0f} MiB"
        print(f"  {size:,} {growth.size}: {told}", file=sys.stderr)
        yield made


if __name__ == "__main__":
    _child(*sys.argv[1:])
