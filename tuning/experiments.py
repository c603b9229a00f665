"""The comparisons that the scripts show: who runs, on what, tuned how."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np

import navgym
from navgym._checks import Array
from navgym.estimation import parameter_space
from navgym.filters.catalogue import CATALOGUE
from navgym.models import LinearModel
from navgym.readers import read
from navgym.recording import Recording
from navgym.simulation import simulate_many
from tuning.cases import Cases
from tuning.comparison import Comparison, Entry
from tuning.deck_cases import DeckCases
from tuning.objective import AnyCases, Objective
from tuning.recipes import travelling
from tuning.schedule import RegimeTable
from tuning.selection import confirm
from tuning.study import Outcome, Search, Trial, search

TRACKS = (1, 2, 3, 4, 5, 6)
FOLDS = (TRACKS[:3], TRACKS[3:])  # tuned on one half of the tracks, reported on the other
RATES = (0.1, 0.3, 0.5)
# what matters in a variational filter (SCIENCE A3)
STEERED = ("vb_iterations", "prior_count", "forgetting", "process_noise_scale")
# what an untuned reader of the paper would type (it gives none of them)
UNTUNED = {
    "vb_iterations": 10, "prior_count": 5.0, "forgetting": 0.97, "initial_count": 5.0,
    "initial_scale": 1.0, "process_noise_scale": 1.0,
}  # fmt: skip
STAND_IN_STEPS = 400


def linear_filters(simulated: bool) -> list[Entry]:
    """Every filter made for a linear model, at its defaults; the oracle only where truth is known."""
    return [
        Entry(f.name, f.name, bound=f.needs_scales)
        for f in CATALOGUE.values()
        if not f.nonlinear and (simulated or not f.needs_scales)
    ]


def nonlinear_filters() -> list[Entry]:
    """Every filter that takes a nonlinear model."""
    return [Entry(f.name, f.name) for f in CATALOGUE.values() if f.nonlinear]


# ---- tuning


def simulated(
    scenario: str, split: str, runs: int, steps: int | None = None, **overrides: Any
) -> AnyCases:
    """`runs` recordings of a scenario of either half; `steps` are samples of an AUV's."""
    if scenario.startswith("deck/"):
        return DeckCases.simulated(scenario, split, runs, **overrides)
    return Cases.simulated(scenario, split, runs, steps=steps, **overrides)


def best_fixed(
    scenario: str,
    trials: int | Search,
    seed: int = 0,
    runs: int = 40,
    journal: Path | None = None,
    free: Sequence[str] = STEERED,
    first: Sequence[Mapping[str, Any]] = (),
    fixed: Mapping[str, Any] | None = None,
    steps: int | None = None,
    progress: bool = True,
    filter_name: str = "qivbf",
    executor: Executor | None = None,
) -> tuple[Objective, Outcome, Trial]:
    """Tune a filter on training seeds of `scenario`; the best of the leaders on validation seeds.

    Args:
        scenario: a name of `navgym.scenarios()`.
        trials: finished trials of the study, or how to search.
        seed: of the sampler.
        runs: recordings per trial, and again on the validation seeds.
        journal: keeps the study; see `tuning.study.search`.
        free: parameters to vary.
        first: parameter sets to try early.
        fixed: values of the others; their defaults where it says nothing.
        steps: samples per recording; the scenario's own by default.
        progress: whether to show a bar.
        filter_name: what to tune.
        executor: where trials are evaluated.
    """
    goal = Objective(filter_name, free, simulated(scenario, "train", runs, steps), "mean", fixed)
    fresh = goal.on(simulated(scenario, "validation", runs, steps))
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
    steps: int | None = None,
    progress: bool = True,
    filter_name: str = "qivbf",
    scheduled: Sequence[str] = ("forgetting", "process_noise_scale"),
    executor: Executor | None = None,
) -> tuple[RegimeTable, Trial]:
    """Tune parameters by true regime, from `start` in all of them; otherwise as `best_fixed`.

    Returns the table's goal on the training seeds and its best trial on validation seeds.
    """
    fixed = {k: v for k, v in start.items() if k not in scheduled}
    goal = RegimeTable(filter_name, scheduled, simulated(scenario, "train", runs, steps), fixed)
    first = [goal.same_everywhere(start), _guess(goal, start)]
    label = f"table by regime of {scenario}"
    outcome = search(goal, trials, seed, journal, first, label, progress, executor)
    fresh = goal.on(simulated(scenario, "validation", runs, steps))
    return goal, confirm(outcome.complete(), fresh)


def _guess(table: RegimeTable, start: Mapping[str, Any]) -> dict[str, Any]:
    """What one would try first: the true Q of each regime; on decks, the kernel off but for glitches."""
    guess = table.same_everywhere(start)
    cases = table.cases
    for label, name in enumerate(cases.regimes):
        if isinstance(cases, DeckCases):
            guess[f"kernel_width [{name}]"] = 2.0 if "glitch" in name else 50.0
        else:
            here = [r.process_scale[r.regime == label] for r in cases.recordings]
            guess[f"process_noise_scale [{name}]"] = float(np.concatenate(here).mean())
    return guess


# ---- real tracks


@travelling
def real_cases(
    folder: Path | None, rate: float, draws: int, split: str, tracks: Sequence[int] = TRACKS
) -> Cases:
    """Recordings of each track under independent losses, `draws` of noise and losses per track.

    Args:
        folder: of the A-KIT data; None makes the simulated stand-in.
        rate: share of lost samples.
        draws: noise and loss seeds per track.
        split: whose seeds.
        tracks: which.
    """
    chosen = navgym.seeds(split, draws)
    recordings = [_track(folder, track, rate, seed) for track in tracks for seed in chosen]
    about = {
        "tracks": list(tracks),
        "loss": rate,
        "split": split,
        "seeds": [chosen.start, chosen.stop - 1],
        "source": "simulated stand-in" if folder is None else "A-KIT",
    }
    return Cases.of(recordings, about)


def _track(folder: Path | None, track: int, rate: float, seed: int) -> Recording:
    if folder is None:
        return stand_in(track, rate, seed)
    return read("akit", folder, track=track, loss=rate, seed=seed)


def stand_in(track: int, rate: float, seed: int) -> Recording:
    """A simulated track for machines without real ones: unmodelled turns, A-KIT's noise model.

    The way sailed belongs to `track`, noise and losses to `seed`, as with the real tracks.
    """
    (way,) = simulate_many("auv/turn", [track], STAND_IN_STEPS)
    model = LinearModel.white_acceleration(way.time[1] - way.time[0], x0=way.truth[0])
    noise, losses = (
        np.random.default_rng(words) for words in np.random.SeedSequence([track, seed]).spawn(2)
    )
    truth = way.truth[1:]
    v = noise.standard_normal(truth.shape) * np.sqrt(np.diag(model.R))
    return Recording(
        time=way.time[1:],
        measurements=truth + v,
        lost=losses.random(len(truth)) < rate,
        truth=truth,
        model=model,
        meta={"track": track, "seed": int(seed), "source": "simulated stand-in"},
    )


def cross_tuned(
    entry: Entry, folder: Path | None, draws: int, trials: int, seed: int = 0
) -> Iterator[tuple[tuple[int, ...], dict[str, Any]]]:
    """Parameters of `entry.filter` for each half of the tracks, tuned on the other half.

    Tuning takes all loss rates together and the training seeds of noise and losses; so neither the
    tracks nor the seeds of a report were tuned on. Yields (tracks to report on, parameters).
    """
    free = [n for n in parameter_space(entry.filter).names if n != "vb_iterations"]
    for report_on, tune_on in (FOLDS, FOLDS[::-1]):
        recordings = [
            r
            for rate in RATES
            for r in real_cases(folder, rate, draws, "train", tune_on).recordings
        ]
        about = {"tracks": list(tune_on), "loss": list(RATES), "seeds": "training"}
        goal = Objective(entry.filter, free, Cases.of(recordings, about))
        outcome = search(goal, trials, seed, progress=False).complete()
        yield report_on, dict(outcome.best.values)


def per_track(cases: Cases, found: Sequence[tuple[tuple[int, ...], dict[str, Any]]]) -> list[Any]:
    """One parameter dict per recording, by its track."""
    by_track = {track: values for tracks, values in found for track in tracks}
    return [by_track[r.meta["track"]] for r in cases.recordings]


# ---- views of a comparison


def error_by_regime(found: Comparison, cases: Cases) -> tuple[tuple[str, ...], dict[str, Array]]:
    """Names of the regimes, and per kept label the RMSE (regimes,) over all samples of each, m."""
    names = tuple(cases.recordings[0].meta["regimes"])
    labels = np.stack([r.regime for r in cases.recordings])
    rms = {
        label: np.array([np.sqrt(square[labels == g].mean()) for g in range(len(names))])
        for label, square in found.squared.items()
    }
    return names, rms


def bank_beliefs(recording: Recording) -> dict[str, Array]:
    """The bank's probability (T,) of each of its three regimes."""
    weights = navgym.estimate("bank", recording).extras["weights"].sum(axis=1)
    return dict(zip(("nominal", "outlier", "manoeuvre"), weights.T, strict=True))
