"""The comparisons that studies and reports share: who runs, on what, tuned how."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np

import navgym
from navgym.core.checks import Array
from navgym.problem import Problem, Steering, Tracks, problem_of
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Comparison, Entry
from navgym.tuning.objectives import Objective
from navgym.tuning.schedule import RegimeTable
from navgym.tuning.study.recipes import travelling
from navgym.tuning.study.run import Outcome, Search, Trial, search
from navgym.tuning.study.selection import confirm

# ---- tuning


def best_fixed(
    scenario: str,
    trials: int | Search,
    seed: int = 0,
    runs: int = 40,
    journal: Path | None = None,
    free: Sequence[str] = (),
    first: Sequence[Mapping[str, Any]] = (),
    fixed: Mapping[str, Any] | None = None,
    progress: bool = True,
    filter_name: str = "",
    executor: Executor | None = None,
    **overrides: Any,
) -> tuple[Objective, Outcome, Trial]:
    """Tune a filter on training seeds of `scenario`; the best of the leaders on validation seeds.

    Args:
        scenario: a name of `navgym.scenarios()`.
        trials: finished trials of the study, or how to search.
        seed: of the sampler.
        runs: recordings per trial, and again on the validation seeds.
        journal: keeps the study; see `navgym.tuning.study.run.search`.
        free: parameters to vary; by default what a study of the problem varies.
        first: parameter sets to try early.
        fixed: values of the others; their defaults where it says nothing.
        progress: whether to show a bar.
        filter_name: what to tune; by default what the problem's studies tune.
        executor: where trials are evaluated.
        overrides: of the scenario.
    """
    study = problem_of(scenario).study
    cases = Cases.simulated(scenario, "train", runs, **overrides)
    goal = Objective(filter_name or study.filter, free or study.free, cases, "mean", fixed)
    fresh = goal.on(Cases.simulated(scenario, "validation", runs, **overrides))
    label = f"tuning on {scenario}"
    outcome = search(goal, trials, seed, journal, first, label, progress, executor)
    return goal, outcome, confirm(outcome, fresh)


def regime_table(
    scenario: str,
    start: Mapping[str, Any],
    trials: int | Search,
    seed: int = 0,
    runs: int = 40,
    journal: Path | None = None,
    progress: bool = True,
    executor: Executor | None = None,
    **overrides: Any,
) -> tuple[RegimeTable, Trial]:
    """Tune parameters by true regime, from `start` in all of them; otherwise as `best_fixed`.

    Filter and parameters are those that the problem's headroom is measured with. Returns the table's goal
    on the training seeds and its best trial on validation seeds.

    Raises ValueError for a scenario of a problem without regimes.
    """
    steering = steering_of(problem_of(scenario))
    fixed = {k: v for k, v in start.items() if k not in steering.scheduled}
    cases = Cases.simulated(scenario, "train", runs, **overrides)
    goal = RegimeTable(steering.filter, steering.scheduled, cases, fixed)
    first = [goal.same_everywhere(start), _guess(goal, start, steering)]
    label = f"table by regime of {scenario}"
    outcome = search(goal, trials, seed, journal, first, label, progress, executor)
    fresh = goal.on(Cases.simulated(scenario, "validation", runs, **overrides))
    return goal, confirm(outcome.complete(), fresh)


def steering_of(problem: Problem) -> Steering:
    """How the problem's headroom is measured; ValueError where no scenario has regimes."""
    if problem.study.steering is None:
        raise ValueError(
            f"no scenario of {problem.name!r} has regimes to follow: take one of a problem that has."
        )
    return problem.study.steering


def _guess(table: RegimeTable, start: Mapping[str, Any], steering: Steering) -> dict[str, Any]:
    """What one would try first, knowing the regimes."""
    guess, cases = table.same_everywhere(start), table.cases
    for name, values in steering.guess(cases.batch).items():
        by_regime = zip(cases.regimes, values, strict=True)
        guess |= {f"{name} [{regime}]": value for regime, value in by_regime}
    return guess


# ---- real tracks


def tracks_of(problem: Problem) -> Tracks:
    """The problem's real tracks; ValueError where it has none."""
    if problem.tracks is None:
        raise ValueError(f"problem {problem.name!r} has no real tracks.")
    return problem.tracks


@travelling
def real_cases(
    problem: Problem,
    folder: Path | None,
    rate: float,
    draws: int,
    split: str,
    tracks: Sequence[int] | None = None,
    variant: str = "",
) -> Cases:
    """Recordings of each track under independent losses, `draws` of noise and losses per track.

    Args:
        problem: whose tracks.
        folder: of the data; None makes the simulated stand-in.
        rate: share of lost samples.
        draws: noise and loss seeds per track.
        split: whose seeds.
        tracks: which; every one by default.
        variant: name of another condition there, which has no rate.
    """
    known = tracks_of(problem)
    numbers = known.numbers if tracks is None else tracks
    chosen = navgym.seeds(split, draws)
    each = [(track, seed) for track in numbers for seed in chosen]
    if variant:
        recordings = [known.variants[variant](folder, track, seed) for track, seed in each]
    else:
        recordings = [known.recording(folder, track, rate, seed) for track, seed in each]
    about = {
        "tracks": list(numbers),
        **({"variant": variant} if variant else {"loss": rate}),
        "split": split,
        "seeds": [chosen.start, chosen.stop - 1],
        "source": "simulated stand-in" if folder is None else known.title,
    }
    return Cases.of(recordings, about)


def cross_tuned(
    problem: Problem,
    entry: Entry,
    folder: Path | None,
    draws: int,
    trials: int,
    seed: int = 0,
    variant: str = "",
) -> Iterator[tuple[tuple[int, ...], dict[str, Any]]]:
    """Parameters of `entry.filter` for each half of the tracks, tuned on the other half.

    Tuning takes all loss rates together, or the variant, and the training seeds of noise and losses; so
    neither the tracks nor the seeds of a report were tuned on. Numbers of sweeps, which cost time and change little,
    stay as they are. Yields (tracks to report on, parameters).
    """
    known = tracks_of(problem)
    free = [p.name for p in problem.find(entry.filter).space if p.choices or not p.integer]
    for report_on, tune_on in (known.folds, known.folds[::-1]):
        recordings = [
            r
            for rate in (known.rates[:1] if variant else known.rates)
            for r in real_cases(problem, folder, rate, draws, "train", tune_on, variant).recordings
        ]
        losses = {"variant": variant} if variant else {"loss": list(known.rates)}
        about = {"tracks": list(tune_on), **losses, "seeds": "training"}
        goal = Objective(entry.filter, free, Cases.of(recordings, about))
        outcome = search(goal, trials, seed, progress=False).complete()
        yield report_on, dict(outcome.best.values)


def per_track(cases: Cases, found: Sequence[tuple[tuple[int, ...], dict[str, Any]]]) -> list[Any]:
    """One parameter dict per recording, by its track."""
    by_track = {track: values for tracks, values in found for track in tracks}
    return [by_track[r.meta["track"]] for r in cases.recordings]


# ---- views of a comparison


def error_by_regime(found: Comparison, cases: Cases) -> tuple[tuple[str, ...], dict[str, Array]]:
    """Names of the regimes, and per kept label the RMSE (regimes,) over all samples of each."""
    names = cases.regimes
    labels = np.stack(cases.batch.regimes())
    rms = {
        label: np.array([np.sqrt(square[labels == g].mean()) for g in range(len(names))])
        for label, square in found.squared.items()
    }
    return names, rms
