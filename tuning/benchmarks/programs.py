"""What tuning a program is worth and costs: intervals that hold, parameter sets that it takes, overhead.

Kills are a campaign of their own: `navgym.tuning.benchmarks.kills`.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.tuning.benchmarks.timing import Row, measured
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
STUDIES = 100
Series = tuple[Array, Array]


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
    parts = study.judged(tool, runs, logs, rulers, contract.space.defaults, measure, (0.0, 1.0), {})
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


def started(number: int) -> dict[str, float]:
    """A start somewhere in the ranges."""
    draw = np.random.default_rng(100 + number)
    return {n: float(np.exp(draw.uniform(np.log(0.02), np.log(50.0)))) for n in TRUE}


def evaluations(repeats: int = 8) -> dict[str, Any]:
    """Parameter sets until the mean negative log-likelihood is within 1 % of the gain to the optimum."""
    rows = []
    for i in range(repeats):
        start = started(i)
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


# ---- beside kalman-py, whose fit_noise learns covariances of a linear system


def expectations(repeats: int = 8) -> tuple[list[int | None], list[int | None]] | None:
    """Sets until within 1 % of the optimum of one log: ours, and covariances of kalman-py's EM.

    A covariance of EM costs a filter and a smoother, and its Q is any (2, 2). None without the package.
    """
    try:
        from kalman_py.learning import fit_noise
    except ImportError:
        return None
    F = np.array([[1.0, 1.0], [0.0, 1.0]])
    back = np.linalg.inv(F)
    shape = np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]])
    ours, theirs = list[int | None](), list[int | None]()
    for i in range(repeats):
        goal, z = goal_over(range(900 + i, 901 + i), started(i)), simulated(900 + i)[1]
        best = fitted(goal, TRUE, _serial)
        assert best is not None
        least = goal(best.values)
        wanted = least + 0.01 * abs(least)
        counted = _Counted(goal, wanted)
        study_until(counted, i)
        ours.append(counted.reached or None)
        start = started(i)
        found = fit_noise(
            F, [[1.0, 0.0]], z[:, None], np.zeros(2), 100.0 * back @ back.T, method="em", max_iter=200,
            Q0=start["acceleration"] ** 2 * shape, R0=[[start["position"] ** 2]],
        )  # fmt: skip
        good = -found.history / len(z) <= wanted
        theirs.append(int(np.argmax(good)) + 1 if good.any() else None)
    return ours, theirs


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


# ---- the table


def _coverage(rounds: int) -> Row:  # noqa: ARG001 - a share needs many
    found = coverage(STUDIES)
    held = ", ".join(f"{n} {k}" for n, k in found["intervals that hold the truth"].items())
    what = f"{STUDIES} studies of one log each: 95 % intervals that hold the truth"
    return Row(what, "95 %", f"{held}, both {found['both at once']}")


def _sets(found: Sequence[int | None]) -> str:
    return ", ".join("never" if each is None else str(each) for each in found)


def _evaluations(rounds: int) -> list[Row]:
    what, found = "1 % of the optimum", evaluations(rounds)
    rows = [
        Row(f"parameter sets until within {what}, two logs, {name}", "told", _sets([r[what][k] for r in found["rows"]]))
        for k, name in enumerate(("a study", "a coordinate search"))
    ]  # fmt: skip
    both = expectations(rounds)
    if both is None:
        return [*rows, Row("beside kalman-py", "told", "not installed")]
    names = "a study", "EM of kalman-py (a full Q, a smoother per set)"
    return rows + [
        Row(f"parameter sets until within {what}, one log, {name}", "told", _sets(each))
        for name, each in zip(names, both, strict=True)
    ]


def _overhead(rounds: int) -> Row:
    found = overhead(10 * rounds)
    alone = found["program alone, ms"]
    return Row(
        f"overhead per run of a program of {alone:.0f} ms",
        "told",
        f"{found['overhead, ms']:.0f} ms",
    )


def programs(rounds: int) -> list[Row]:
    """Everything, in the order of the table."""
    return measured((_coverage, _evaluations, _overhead), rounds)
