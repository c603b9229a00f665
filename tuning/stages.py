"""The recordings of a study's three stages: to tune on, to choose among leaders, to report on."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from navgym.problem import Amount, Problem
from navgym.readers import ReaderOptions
from navgym.tuning.cases import Cases
from navgym.tuning.experiments import real_cases
from navgym.tuning.settings import StudySettings
from navgym.tuning.smoothed import SMOOTHER, caveat, judged_by_smoother
from navgym.tuning.study.recipes import KEPT, travelling

# shares of a log that is tuned on up to here, and chosen among leaders up to there
TUNED, CHOSEN = 0.5, 0.7


@dataclass(frozen=True, eq=False)
class Stages:
    """Recordings by stage; no two stages share a recording, a seed, or a stretch of a log.

    Args:
        train: what trials are evaluated on, by name.
        select: what the leaders are evaluated on again, by name.
        report: what the winner is compared on, by name.
        split: how the three are kept apart, in words.
        caveat: what is to be known of every figure; "" for nothing.
    """

    train: Mapping[str, Cases]
    select: Mapping[str, Cases]
    report: Mapping[str, Cases]
    split: str
    caveat: str = ""


def stages(settings: StudySettings) -> Stages:
    """The recordings that `settings` ask for.

    Raises:
        ValueError: a log that cannot be read, or two kinds of logs at once.
        OSError: a file that is not there.
    """
    if settings.akit is not None:
        return _tracks(settings.problem, settings.akit, settings.amount)
    return _logs(settings) if settings.log else _simulated(settings)


# ---- simulation


def _simulated(settings: StudySettings) -> Stages:
    amount = settings.amount
    made = {
        split: {
            name: _scenario(settings, name, split, count) for name in settings.scenario
        }
        for split, count in (
            ("train", amount.runs), ("validation", amount.select_runs), ("test", amount.report_runs)
        )
    }  # fmt: skip
    return Stages(
        made["train"], made["validation"], made["test"],
        "tuned on training seeds, chosen among the leaders on validation seeds, reported on test seeds",
    )  # fmt: skip


def _scenario(settings: StudySettings, name: str, split: str, count: int) -> Cases:
    overrides: dict[str, Any] = dict(settings.overrides)
    if settings.steps is not None:
        overrides["steps"] = settings.steps
    return Cases.simulated(name, split, count, **overrides)


# ---- logs


def _logs(settings: StudySettings) -> Stages:
    own, other = settings.log, settings.report_log
    if other:
        spans = [(own, (0.0, CHOSEN)), (own, (CHOSEN, 1.0)), (other, (0.0, 1.0))]
        how = f"the last {1 - CHOSEN:.0%} of each log chose among the leaders, other logs are reported on"
    else:
        spans = [(own, (0.0, TUNED)), (own, (TUNED, CHOSEN)), (own, (CHOSEN, 1.0))]
        how = (
            f"the first {TUNED:.0%} of each log was tuned on, the samples up to {CHOSEN:.0%} chose "
            "among the leaders, the rest is reported on"
        )
    made = [{"logs": logged(settings.reading, p, span, settings.truth)} for p, span in spans]
    some = made[0]["logs"].recordings[0]
    return Stages(made[0], made[1], made[2], how, caveat(some) if settings.truth else "")


@travelling
def logged(
    reading: ReaderOptions,
    paths: tuple[Path, ...],
    span: tuple[float, float],
    truth: str | None = None,
) -> Cases:
    """Logs as cases that are scored between two shares of their samples, smoothed for a truth if asked."""
    about: dict[str, Any] = {"logs": [_printed(path) for path in paths]}
    told = _told(reading)
    about |= {"read": told} if told else {}
    if truth is not None:
        about["truth"] = truth if truth == SMOOTHER else _printed(Path(truth))
    prints = zip(paths, about["logs"], strict=True)
    asked = (truth, about.get("truth"))
    recordings = [_read(reading, path, (own, *told), asked) for path, own in prints]
    return Cases.of(recordings, about | {"scored": list(span)}, span)


@lru_cache(maxsize=KEPT)
def _read(
    reading: ReaderOptions, path: Path, _prints: tuple[str, ...], asked: tuple[str | None, Any]
) -> Any:
    """A log, which serves up to three stages; one whose files have changed is read again."""
    recording, truth = reading.read(path), asked[0]
    if truth is None:
        return recording
    return judged_by_smoother(recording, None if truth == SMOOTHER else truth)


def _printed(path: Path) -> str:
    """A log's name and fingerprint; a folder has its files' names and sizes for one."""
    if path.is_dir():
        files = sorted(p for p in path.rglob("*") if p.is_file())
        content = "\n".join(f"{p.relative_to(path)} {p.stat().st_size}" for p in files).encode()
    else:
        content = path.read_bytes()
    return f"{path.name} ({hashlib.sha256(content).hexdigest()[:8]})"


def _told(reading: ReaderOptions) -> list[str]:
    """What the reader was told; of files, such as mappings, their fingerprints too."""
    files = {word: Path(word) for word in reading.words if word.endswith((".toml", ".npz"))}
    words = [_printed(files[w]) if w in files and files[w].is_file() else w for w in reading.words]
    return words if reading.format is None else [f"format {reading.format}", *words]


# ---- real tracks


def _tracks(problem: Problem, folder: Path, amount: Amount) -> Stages:
    assert problem.tracks is not None
    tuned, reported = problem.tracks.folds
    rates = problem.tracks.rates
    made = []
    for split, tracks, draws in (
        ("train", tuned, amount.runs),
        ("validation", tuned, amount.select_runs),
        ("test", reported, amount.report_runs),
    ):
        made.append(
            {f"{r:.0%} lost": real_cases(problem, folder, r, draws, split, tracks) for r in rates}
        )
    return Stages(
        made[0], made[1], made[2],
        f"tuned on tracks {tuned[0]} to {tuned[-1]}, leaders chosen there under other noise and losses, "
        f"reported on tracks {reported[0]} to {reported[-1]}",
    )  # fmt: skip
