"""The recordings of a study's three stages: to tune on, to choose among leaders, to report on."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from navgym.dual_imu import DualIMURecording
from navgym.readers import read
from tuning.cases import Cases
from tuning.deck_cases import DeckCases
from tuning.experiments import FOLDS, RATES, real_cases
from tuning.objective import AnyCases
from tuning.recipes import travelling
from tuning.settings import Amount, Settings

# shares of a log that is tuned on up to here, and chosen among leaders up to there
TUNED, CHOSEN = 0.5, 0.7


@dataclass(frozen=True, eq=False)
class Material:
    """Recordings by stage; no two stages share a recording, a seed, or a stretch of a log.

    Args:
        train: what trials are evaluated on, by name.
        select: what the leaders are evaluated on again, by name.
        report: what the winner is compared on, by name.
        split: how the three are kept apart, in words.
    """

    train: Mapping[str, AnyCases]
    select: Mapping[str, AnyCases]
    report: Mapping[str, AnyCases]
    split: str


def material(settings: Settings) -> Material:
    """The recordings that `settings` ask for.

    Raises:
        ValueError: a log that cannot be read, or two kinds of logs at once.
        OSError: a file that is not there.
    """
    if settings.akit is not None:
        return _tracks(settings.akit, settings.amount)
    return _logs(settings) if settings.log else _simulated(settings)


# ---- simulation


def _simulated(settings: Settings) -> Material:
    amount = settings.amount
    stages = {
        split: {
            name: _scenario(settings, name, split, count) for name in settings.scenario
        }
        for split, count in (
            ("train", amount.runs), ("validation", amount.select_runs), ("test", amount.report_runs)
        )
    }  # fmt: skip
    return Material(
        stages["train"], stages["validation"], stages["test"],
        "tuned on training seeds, chosen among the leaders on validation seeds, reported on test seeds",
    )  # fmt: skip


def _scenario(settings: Settings, name: str, split: str, count: int) -> AnyCases:
    overrides: dict[str, Any] = dict(settings.overrides)
    if settings.half == "deck":
        return DeckCases.simulated(name, split, count, **overrides)
    return Cases.simulated(name, split, count, steps=settings.steps, **overrides)


# ---- logs


def _logs(settings: Settings) -> Material:
    own, other = settings.log, settings.report_log
    if other:
        stages = [(own, (0.0, CHOSEN)), (own, (CHOSEN, 1.0)), (other, (0.0, 1.0))]
        how = f"the last {1 - CHOSEN:.0%} of each log chose among the leaders, other logs are reported on"
    else:
        stages = [(own, (0.0, TUNED)), (own, (TUNED, CHOSEN)), (own, (CHOSEN, 1.0))]
        how = (
            f"the first {TUNED:.0%} of each log was tuned on, the samples up to {CHOSEN:.0%} chose "
            "among the leaders, the rest is reported on"
        )
    made = [{"logs": logged(settings.format, paths, span)} for paths, span in stages]
    return Material(made[0], made[1], made[2], how)


@travelling
def logged(format_name: str, paths: tuple[Path, ...], span: tuple[float, float]) -> AnyCases:
    """Logs as cases that are scored between two shares of their samples."""
    recordings = [read(format_name, path) for path in paths]
    about = {
        "logs": [f"{p.name} ({hashlib.sha256(p.read_bytes()).hexdigest()[:8]})" for p in paths],
        "scored": list(span),
    }
    kind: Any = DeckCases if isinstance(recordings[0], DualIMURecording) else Cases
    cases: AnyCases = kind.of(recordings, about, span)
    return cases


# ---- A-KIT


def _tracks(folder: Path, amount: Amount) -> Material:
    tuned, reported = FOLDS
    stages = []
    for split, tracks, draws in (
        ("train", tuned, amount.runs),
        ("validation", tuned, amount.select_runs),
        ("test", reported, amount.report_runs),
    ):
        stages.append(
            {f"{rate:.0%} lost": real_cases(folder, rate, draws, split, tracks) for rate in RATES}
        )
    return Material(
        stages[0], stages[1], stages[2],
        f"tuned on tracks {tuned[0]} to {tuned[-1]}, leaders chosen there under other noise and losses, "
        f"reported on tracks {reported[0]} to {reported[-1]}",
    )  # fmt: skip
