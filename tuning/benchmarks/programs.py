"""What tuning a program is worth and costs: `python -m navgym.tuning.benchmarks.programs WHAT`.

coverage     known noises of a simulated system: in how many of 100 studies do the intervals hold them
evaluations  parameter sets until within 1 % of the optimum, beside a coordinate search
overhead     ms per run beside the program's own time
kills        a study that is killed 20 times: are finished runs lost, do processes stay
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.tuning.programs import look, study
from navgym.tuning.programs.contract import Contract
from navgym.tuning.programs.intervals import fitted
from navgym.tuning.programs.objective import ProgramGoal
from navgym.tuning.programs.runner import Command
from navgym.tuning.programs.scoring import chosen
from navgym.tuning.programs.tools import Function, Log, Program, Runs
from navgym.tuning.study.run import Search, search

TRUE = {"acceleration": 0.5, "position": 2.0}
FAR = {"acceleration": 20.0, "position": 0.1}  # where searches start
Series = tuple[Array, Array]

FILTER = """BEGIN { FS = ","; q = 1; r = 1; P = 100; x = 0; print "time,innovation,variance" > out }
FILENAME != log_ { split($0, w, " = "); if (w[1] == "walk") q = w[2]^2; if (w[1] == "meter") r = w[2]^2; next }
FNR > 1 { if (seen) P += q * ($1 - t); S = P + r; nu = $2 - x; K = P / S; x += K * nu; P *= 1 - K; t = $1; seen = 1
  printf "%.9g,%.12g,%.12g\\n", t, nu, S > out }
"""


def simulated(seed: int, steps: int = 400) -> Series:
    """Times and measured positions of a mass that is pushed at random."""
    draw = np.random.default_rng(seed)
    push = TRUE["acceleration"] * draw.standard_normal((steps, 2))
    velocity = np.concatenate([[0.0], np.cumsum(push[:-1, 0])])
    moved = np.cumsum(
        np.concatenate([[0.0], velocity[:-1] + push[:-1, 0] / 2.0 + push[:-1, 1] / np.sqrt(12.0)])
    )
    return np.arange(steps, dtype=np.float64), moved + TRUE["position"] * draw.standard_normal(
        steps
    )


def kalman(series: Series, parameters: Mapping[str, float]) -> dict[str, Array]:
    """Position and velocity from positions; root densities and deviations in metres and seconds."""
    time_, z = series
    q, r = parameters["acceleration"] ** 2, parameters["position"] ** 2
    x, v, a, b, c = 0.0, 0.0, 100.0, 0.0, 100.0
    nu, s = np.empty(len(z)), np.empty(len(z))
    for k in range(len(z)):
        if k:
            x += v
            a, b, c = a + 2.0 * b + c + q / 3.0, b + c + q / 2.0, c + q
        nu[k], s[k] = z[k] - x, a + r
        gain, other = a / s[k], b / s[k]
        x, v = x + gain * nu[k], v + other * nu[k]
        a, b, c = a * (1.0 - gain), b * (1.0 - gain), c - other * b
    return {"time": time_, "innovation": nu, "variance": s}


def declared(start: Mapping[str, float]) -> dict[str, Any]:
    """Tables of the parameters, from `start`."""
    return {n: {"range": [0.01, 100.0], "default": v} for n, v in start.items()}


def _serial(function: Callable[..., Any], calls: Any) -> list[Any]:
    return [function(*call) for call in calls]


def goal_over(seeds: range, start: Mapping[str, float] = FAR) -> ProgramGoal:
    """The likelihood over simulated logs."""
    contract, tool, runs = (
        Contract.of_dict({"parameters": declared(start)}),
        Function(kalman),
        Runs(None),
    )
    logs = [Log.of(simulated(seed), i) for i, seed in enumerate(seeds)]
    rulers, _ = look.rulers(tool, runs, logs, contract.space.defaults, _serial)
    measure = chosen("likelihood", rulers[logs[0].digest].kinds)
    parts = study._parts(tool, runs, logs, rulers, contract.space.defaults, measure, (0.0, 1.0), {})
    return ProgramGoal(tool, contract.space, {}, parts, measure, "mean", runs)


# ---- coverage


def coverage(runs: int = 100) -> dict[str, Any]:
    """In how many studies of one fresh log each the 95 % intervals hold the true noises."""
    held = dict.fromkeys(TRUE, 0)
    both = 0
    for i in range(runs):
        goal = goal_over(range(5000 + i, 5001 + i))
        found = search(goal, Search(30, i, batch=4), progress=False)
        fit = fitted(goal, found.best.values, _serial)
        assert fit is not None
        inside = {
            n: n in fit.intervals and fit.intervals[n][0] <= v <= fit.intervals[n][1]
            for n, v in TRUE.items()
        }
        held = {n: held[n] + inside[n] for n in TRUE}
        both += all(inside.values())
    return {"studies": runs, "intervals that hold the truth": held, "both at once": both}


# ---- evaluations


class _Counted:
    """A goal that counts parameter sets until one is within a share of the optimum."""

    def __init__(self, goal: ProgramGoal, wanted: float) -> None:
        self.goal, self.wanted, self.count, self.reached = goal, wanted, 0, 0

    def __call__(self, values: Mapping[str, Any]) -> float:
        found = self.goal(values)
        self.count += 1
        if found <= self.wanted and not self.reached:
            self.reached = self.count
        return found


def coordinate_search(goal: _Counted, start: Mapping[str, float], most: int = 1000) -> None:
    """One parameter after the other, times 1.1 or times .5, whatever is better, until nothing is."""
    best, value = dict(start), goal(start)
    while goal.count < most and not goal.reached:
        moved = False
        for name in start:
            for step in (1.1, 0.5):
                tried = {**best, name: min(max(best[name] * step, 0.01), 100.0)}
                found = goal(tried)
                if found < value:
                    best, value, moved = tried, found, True
                    break
        if not moved:
            return


def study_until(goal: _Counted, seed: int, trials: int = 24) -> None:
    """A study, then the refinement that follows it; every parameter set that is evaluated counts."""
    found = search(goal.goal, Search(trials, seed, batch=4), progress=False)
    for trial in found.trials:
        goal.count += 1
        if trial.result <= goal.wanted and not goal.reached:
            goal.reached = goal.count
    if goal.reached:
        return
    counted = [0]

    def run(function: Callable[..., Any], calls: Any) -> list[Any]:
        results = []
        for called, values in calls:
            counted[0] += 1
            goal(values)
            results.append(function(called, values))
        return results

    fitted(goal.goal, found.best.values, run)


def evaluations(repeats: int = 8) -> dict[str, Any]:
    """Parameter sets until the mean negative log-likelihood is within 1 % of the gain to the optimum."""
    rows = []
    for i in range(repeats):
        draw = np.random.default_rng(100 + i)
        start = {n: float(np.exp(draw.uniform(np.log(0.02), np.log(50.0)))) for n in TRUE}
        goal = goal_over(range(900 + 2 * i, 902 + 2 * i), start)
        best = fitted(goal, TRUE, _serial)
        assert best is not None
        least, usual = goal(best.values), goal(start)
        row: dict[str, Any] = {"start": start}
        for name, wanted in (
            ("1 % of the optimum", least + 0.01 * abs(least)),
            ("1 % of the gain", least + 0.01 * (usual - least)),
        ):
            ours, other = _Counted(goal, wanted), _Counted(goal, wanted)
            study_until(ours, i)
            coordinate_search(other, start)
            row[name] = [ours.reached or None, other.reached or None]
        rows.append(row)
    return {"rows": rows} | {
        name: {
            which: {"median": float(np.median([r[name][k] or 1000 for r in rows])), "failed": sum(r[name][k] is None for r in rows)}
            for k, which in enumerate(("study", "coordinate search"))
        }
        for name in ("1 % of the optimum", "1 % of the gain")
    }  # fmt: skip


# ---- overhead


def overhead(repeats: int = 100) -> dict[str, Any]:
    """ms per run of a program that does next to nothing, beside the program started alone."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        log = folder / "log.csv"
        log.write_text(
            "time,innovation,variance\n" + "".join(f"{k},{k % 7 - 3},4\n" for k in range(400))
        )
        contract = Contract.of_dict({"parameters": {"q": {"range": [0.01, 100.0], "default": 1.0}}})
        words = "sh -c 'test -r $0 && exec cat $1 > $2' {parameters} {log} {out}"
        tool, runs = Program.of(Command.parsed(words), contract), Runs(folder / "runs")
        what = Log.of(log, 1)
        ruler = runs.ruler(tool, what, {"q": 1.0})
        alone, ours = [], []
        for i in range(repeats):
            began = time.perf_counter()
            subprocess.run(
                [
                    "sh",
                    "-c",
                    "test -r $0 && exec cat $1 > $2",
                    str(log),
                    str(log),
                    str(folder / "out"),
                ],
                check=True,
            )
            alone.append(time.perf_counter() - began)
            began = time.perf_counter()
            runs.of(tool, what, {"q": 1.0 + i / 1000.0}, ruler)
            ours.append(time.perf_counter() - began)
        medians = [1e3 * float(np.median(each)) for each in (alone, ours)]
    return {
        "program alone, ms": medians[0],
        "with everything, ms": medians[1],
        "overhead, ms": medians[1] - medians[0],
        "load": os.getloadavg(),
    }


# ---- kills


def kills(count: int = 20) -> dict[str, Any]:
    """A study of a program that leaves children, killed again and again at random moments."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "walk.awk").write_text(FILTER)
        (folder / "walk.toml").write_text(
            "".join(
                f"[parameters.{n}]\nrange = [0.01, 100.0]\ndefault = 5.0\n"
                for n in ("walk", "meter")
            )
        )
        for i in range(6):
            t, z = simulated(i, 200)
            (folder / f"log{i}.csv").write_text(
                "time,z\n" + "".join(f"{a:g},{b:.9g}\n" for a, b in zip(t, z, strict=True))
            )
        mark = f"98{os.getpid()}"
        program = f"sh -c 'sleep {mark} & setsid sleep {mark} & exec awk -v out=$2 -v log_=$1 -f $3 $0 $1' {{parameters}} {{log}} {{out}} walk.awk"
        words = [
            sys.executable, "-m", "navgym.command", "tune", "--program", program, "--parameters", "walk.toml", "--log",
            *(f"log{i}.csv" for i in range(4)), "--trials", "16", "--workers", "1", "--out",
        ]  # fmt: skip
        draw, lost, left, killed = np.random.default_rng(1), 0, 0, 0
        before: set[str] = set()
        while killed < count:
            process = subprocess.Popen(
                [*words, "out"],
                cwd=folder,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            grown, until = _kept(folder), time.monotonic() + 60.0
            while time.monotonic() < until and _kept(folder) == grown and process.poll() is None:
                time.sleep(0.02)
            time.sleep(float(draw.uniform(0.0, 0.6)))
            if (
                process.poll() is not None
            ):  # it came to its end: the rest of the kills is of a new one
                for path in ("out/study.log", "out/results.json"):
                    (folder / path).unlink(missing_ok=True)
                subprocess.run(["rm", "-rf", str(folder / "out")], check=True)
                before = set()
                continue
            now = _kept(folder)
            process.send_signal(signal.SIGKILL)
            process.wait()
            killed += 1
            lost += len(before - _kept(folder)) + len(now - _kept(folder))
            before = _kept(folder)
            left += _left(mark, folder)
        ends = []
        for out in ("out", "whole"):
            subprocess.run(
                [*words, out],
                cwd=folder,
                check=True,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            found = json.loads((folder / out / "results.json").read_text())
            ends.append([(t["values"], t["result"]) for t in found["trials"]])
        return {
            "kills": killed,
            "finished runs lost": lost,
            "processes left after 3 s": left,
            "same trials as a study that was not killed": ends[0] == ends[1],
        }


def _kept(folder: Path) -> set[str]:
    return {str(p) for p in (folder / "out" / "runs").rglob("*.json")}


def _left(mark: str, folder: Path) -> int:
    """Processes of the study or the program that are there after three seconds."""
    until, found = time.monotonic() + 3.0, 1
    while found and time.monotonic() < until:
        found = 0
        for place in Path("/proc").glob("[0-9]*"):
            try:
                words = (place / "cmdline").read_bytes().decode("utf-8", "replace")
                state = (place / "stat").read_text().rsplit(")", 1)[1].split()[0]
            except OSError:
                continue
            own = mark in words or str(folder) in words
            found += own and state != "Z" and int(place.name) != os.getpid()
        time.sleep(0.05)
    return found


WHAT = {"coverage": coverage, "evaluations": evaluations, "overhead": overhead, "kills": kills}

if __name__ == "__main__":
    for name in sys.argv[1:] or WHAT:
        began = time.perf_counter()
        print(
            name,
            json.dumps(WHAT[name](), indent=1),
            f"{time.perf_counter() - began:.0f} s",
            flush=True,
        )
