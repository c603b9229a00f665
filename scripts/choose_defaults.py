"""Choose the parameters that navgym ships, by studies on training seeds.

    python scripts/choose_defaults.py                 both parts, about six minutes on one core
    python scripts/choose_defaults.py defaults        the default parameters of vbakf and qivbf
    python scripts/choose_defaults.py references      qivbf's best fixed parameters per scenario

`defaults` minimises the geometric mean, over all scenarios with a linear model, of the position
error over the plain Kalman filter's: one setting for every condition, for a user who sets nothing.
Where the vehicle does not move as the model says, adaptive filters may lock out, so runs twice as
bad as the plain filter's are priced there. And on real tracks (the first fold of A-KIT, --akit) it
may at no loss rate be worse than the plain filter: without them no defaults are chosen. `references` minimises the
error of each scenario alone: what a tuner reaches who knows the conditions, and the zero line of
the environments. The best trials are looked at again on validation seeds, rounded, and reported on
test seeds. The printed parameters belong into navgym/statespace/filters/spaces.py (defaults) and
navgym/auv/scenarios.py (references). Journals under --out resume an interrupted run.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from navgym.auv.problem import PROBLEM
from navgym.core.data import data_folder
from navgym.statespace.models import LinearModel
from navgym.tuning.cases import Cases
from navgym.tuning.experiments import real_cases
from navgym.tuning.objectives import GeometricMean, Guarded, Objective
from navgym.tuning.report.page import write_json
from navgym.tuning.study.run import search
from navgym.tuning.study.selection import confirm, rounded

FILTER = "qivbf"
# converged (docs/science/qivbf.md#parameters-that-matter), and what a step may cost
SWEEPS = {"vb_iterations": 5}
FREE = (
    "prior_count", "forgetting", "initial_count", "initial_scale", "process_noise_scale", "fill",
)  # fmt: skip
# where the motion is not the model's, and a filter that adapts R locks out
GUARDS = ("auv/mismatch", "auv/turn")
PAPER_LIKE = {
    "vb_iterations": 10, "prior_count": 5.0, "forgetting": 0.97, "initial_count": 5.0,
    "initial_scale": 1.0, "process_noise_scale": 1.0, "fill": "extrapolate",
}  # fmt: skip
# earlier finds: adaptive for everything, adaptive for switch-D, nearly the plain Kalman filter, the
# same for a vehicle that manoeuvres, and slow adaptation that holds on real tracks
FIRST = tuple(
    dict(zip(FREE, (*numbers, "skip"), strict=True))
    for numbers in (
        (1.0, 0.88, 10.0, 6.0, 30.0),
        (2.0, 0.85, 5.0, 1.0, 70.0),
        (300.0, 0.999, 100.0, 1.0, 1.0),
        (100.0, 0.997, 100.0, 1.0, 100.0),
        (3.0, 0.97, 30.0, 2.0, 10.0),
        (5.0, 0.985, 30.0, 2.0, 10.0),
        (3.0, 0.975, 30.0, 2.0, 15.0),
    )
)


@dataclass(frozen=True)
class Options:
    """What was asked for."""

    part: Annotated[Literal["both", "defaults", "references"], tyro.conf.Positional] = "both"
    """what to choose"""
    trials: int = 250
    """per study"""
    runs: int = 40
    """recordings per trial"""
    guard_runs: int = 200
    """recordings of a guard"""
    report_runs: int = 300
    """fresh ones"""
    track_runs: int = 10
    """noises and losses per track and rate"""
    akit: Path | None = field(default_factory=partial(data_folder, "akit"))
    """folder of the A-KIT data; by default where NAVGYM_DATA says"""
    seed: int = 0
    """of the samplers"""
    out: Path = Path("runs/defaults")
    """folder of journals and results"""


def scenarios() -> list[str]:
    """Names of the scenarios that the filter can run on."""
    return [
        PROBLEM.full_name(s) for s in PROBLEM.scenarios.values() if isinstance(s.model, LinearModel)
    ]


def mean_error(filter_name: str, values: Any, cases: Cases) -> float:
    """Mean position RMSE, diverged runs at their price."""
    return float(cases.bounded_errors(filter_name, values, cases.plain_errors()).mean())


def objective(name: str, split: str, runs: int) -> Objective:
    """Error of the filter in one scenario, over the parameters that have defaults."""
    return Objective(FILTER, FREE, Cases.simulated(name, split, runs), fixed=SWEEPS)


def overall(split: str, options: Options) -> Guarded:
    """The geometric mean over the catalogue, relative to the plain Kalman filter, guarded."""
    members = [objective(name, split, options.runs) for name in scenarios()]
    mean = GeometricMean(members, [mean_error("kf", None, m.cases) for m in members])
    guards = [objective(name, split, options.guard_runs) for name in GUARDS]
    bounds = [
        (Objective(FILTER, FREE, cases, fixed=SWEEPS), mean_error("kf", None, cases))
        for cases in tracks(split, 0, options).values()
    ]
    return Guarded(mean, guards, bounds=bounds)


def tracks(split: str, fold: int, options: Options) -> dict[float, Cases]:
    """Real tracks of a fold by loss rate."""
    if options.akit is None:
        raise ValueError("defaults must hold on real tracks: name the A-KIT folder with --akit.")
    assert PROBLEM.tracks is not None
    numbers = PROBLEM.tracks.folds[fold]
    return {
        rate: real_cases(PROBLEM, options.akit, rate, options.track_runs, split, numbers)
        for rate in PROBLEM.tracks.rates
    }


def choose_defaults(options: Options) -> dict[str, Any]:
    """The default parameters and what they do in each scenario on test seeds."""
    goal = overall("train", options)
    journal = options.out / "defaults.log"
    found = search(goal, options.trials, options.seed, journal, FIRST, label="defaults").complete()
    best = confirm(found, overall("validation", options))
    values = SWEEPS | rounded(goal.space, best.values)
    print(f"\ndefaults {values}: {best.result:.3f} of kf on validation seeds, geometric mean")
    for fold, name in enumerate(("tracks of the first fold", "and of the other")):
        for rate, cases in tracks("test", fold, options).items():
            found, plain = mean_error(FILTER, values, cases), mean_error("kf", None, cases)
            print(
                f"{name}, {rate:.0%} lost: {found:.3f} m, kf {plain:.3f} ({found / plain - 1:+.1%})"
            )
    return {"values": values, "errors": ladder({"best": (FILTER, values)}, options)}


def ladder(candidates: dict[str, tuple[str, Any]], options: Options) -> dict[str, dict[str, float]]:
    """Mean position RMSE in m by scenario of `candidates` and what stands beside them."""
    beside: dict[str, tuple[str, Any]] = {
        "oracle": ("oracle", None),
        "bank": ("bank", None),
        "kf": ("kf", None),
        "paper-like": (FILTER, PAPER_LIKE),
        "shipped": (FILTER, None),
    }
    rows = {}
    print("scenario".ljust(20), *(name.rjust(11) for name in beside | candidates))
    for name in scenarios():
        cases = Cases.simulated(name, "test", options.report_runs)
        rows[name] = {k: mean_error(*entry, cases) for k, entry in (beside | candidates).items()}
        print(name.ljust(20), *(f"{x:11.3f}" for x in rows[name].values()))
    kf = np.array([row["kf"] for row in rows.values()])
    for name in beside | candidates:
        mean = np.exp(np.mean(np.log([row[name] for row in rows.values()] / kf)))
        print(f"geometric mean over kf, {name}: {mean:.3f}")
    return rows


def choose_references(options: Options) -> dict[str, Any]:
    """Best fixed parameters of each scenario, and their error on test seeds."""
    found = {}
    for name in scenarios():
        goals = [objective(name, split, options.runs) for split in ("train", "validation")]
        journal = options.out / f"reference-{name.removeprefix('auv/')}.log"
        outcome = search(goals[0], options.trials, options.seed, journal, FIRST, label=name)
        outcome.complete()
        values = SWEEPS | rounded(goals[0].space, confirm(outcome, goals[1]).values)
        report = Cases.simulated(name, "test", options.report_runs)
        error, plain = mean_error(FILTER, values, report), mean_error("kf", None, report)
        print(f"{name}: {values} {error:.3f} m on test seeds (kf {plain:.3f})")
        found[name] = {"values": values, "error": error, "kf": plain}
    return found


def main() -> None:
    """Parse the command line and run."""
    options = tyro.cli(Options, prog="choose_defaults.py", description=__doc__)
    parts = {"defaults": choose_defaults, "references": choose_references}
    chosen = list(parts) if options.part == "both" else [options.part]
    for part in chosen:
        write_json(options.out / f"{part}.json", parts[part](options))
    assert set(SWEEPS) <= set(PROBLEM.find(FILTER).space.names)


if __name__ == "__main__":
    main()
