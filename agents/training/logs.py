"""Real logs to train on and to judge by: read alike, drawn anew where the format draws, told apart."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from navgym.core.seeds import seeds
from navgym.core.typed import options_of
from navgym.problem import Problem
from navgym.readers import ReaderOptions, read, reader_of
from navgym.tuning.cases import Cases

RATES = (0.1, 0.3, 0.5)  # of losses that are drawn where the reader is told none
SEED, LOSS = "seed", "loss"  # options of formats that draw noise and losses
EARLIER = 0.7  # share of a log that comes before what judges, where logs are cut in time
LEAST = 20  # rows that either part of a log needs

Span = tuple[float, float]
WHOLE: Span = (0.0, 1.0)


@dataclass(frozen=True)
class Logs:
    """Logs of one problem, and how they are read.

    Args:
        paths: files, or folders of public data sets.
        words: what the reader is told; see `navgym.readers.ReaderOptions`.
        format: of the logs; what they look like by default.

    Raises:
        FileNotFoundError: there is no such log.
        ValueError: no logs, logs of different problems, words that the reader does not know.
    """

    paths: tuple[Path, ...]
    words: tuple[str, ...] = ()
    format: str | None = None

    def __post_init__(self) -> None:
        if not self.paths:
            raise ValueError("logs must be named: give --log and at least one file.")
        for path in self.paths:
            if not path.exists():
                raise FileNotFoundError(f"no log at {path}: give the path of a file.")
            self.reading.options(self.reading.format_of(path))
            if self.reading.problem(path) is not self.problem:
                raise ValueError(f"{self.paths[0]} and {path} are logs of different problems.")
        twice = [p for p in self.paths if self.paths.count(p) > 1]
        if twice:
            raise ValueError(f"each log must be named once, got {twice[0]} twice.")

    def __len__(self) -> int:
        return len(self.paths)

    @property
    def reading(self) -> ReaderOptions:
        """How they are read."""
        return ReaderOptions.parsed(self.words, self.format)

    @property
    def problem(self) -> Problem:
        """What they are logs of."""
        return self.reading.problem(self.paths[0])

    def draws(self, path: Path) -> bool:
        """Whether the log's format draws noise and losses by a seed, so that each reading is another."""
        known = options_of(reader_of(self.reading.format_of(path)))
        return SEED in known and LOSS in known

    @property
    def drawn(self) -> bool:
        """Whether every log is drawn anew at each reading."""
        return all(self.draws(path) for path in self.paths)

    def name(self, path: Path) -> str:
        """What a log is called: its file, with its folder's name where several are called alike."""
        alike = [p for p in self.paths if p.name == path.name]
        return path.name if len(alike) == 1 else f"{path.parent.name}/{path.name}"

    def only(self, which: Sequence[int]) -> Logs:
        """Some of them."""
        return dataclasses.replace(self, paths=tuple(self.paths[i] for i in which))

    def by_rate(self, split: str, draws: int, span: Span = WHOLE) -> dict[str, Cases]:
        """The logs as cases by rate of losses; under one name where the reader draws none.

        Args:
            split: whose seeds noise and losses are drawn from.
            draws: of each log and rate.
            span: shares of each log between which it is scored.
        """
        found: dict[str, list[Any]] = {}
        for path in self.paths:
            for label, recording in self._read(path, split, draws):
                found.setdefault(label, []).append(recording)
        about = {"logs": [self.name(p) for p in self.paths], "split": split, "draws": draws}
        return {label: Cases.of(each, about, span) for label, each in found.items()}

    def recordings(self, split: str, draws: int) -> list[tuple[int, Any]]:
        """(number of the log, recording) of every log, rate and draw."""
        return [
            (i, recording)
            for i, path in enumerate(self.paths)
            for _, recording in self._read(path, split, draws)
        ]

    def _read(self, path: Path, split: str, draws: int) -> list[tuple[str, Any]]:
        """A log's recordings, each with its rate of losses in words; marked with the log's name."""
        if not self.draws(path):
            return [("as recorded", _marked(self.reading.read(path), self.name(path)))]
        name = self.reading.format_of(path)
        options = self.reading.options(name)
        told = options.pop(LOSS, None)
        rates = RATES if told is None else (told,)
        return [
            (_rate(rate), _marked(_drawn(name, path, options, rate, seed), self.name(path)))
            for rate in rates
            for seed in seeds(split, draws)
        ]


def _drawn(name: str, path: Path, options: Mapping[str, Any], rate: Any, seed: int) -> Any:
    return read(name, path, **{**options, LOSS: rate, SEED: seed})


def _rate(rate: Any) -> str:
    return f"{rate:.0%} lost" if isinstance(rate, float) else "losses as told"


def _marked(recording: Any, name: str) -> Any:
    """The recording, its log's name in `meta`."""
    return dataclasses.replace(recording, meta={**recording.meta, "log": name})


def judging(logs: Logs, paths: tuple[Path, ...]) -> Logs | None:
    """Validation logs read as `logs` are; None for none.

    Raises ValueError for one of `logs` among them, and for one of another problem.
    """
    if not paths:
        return None
    both = {p.resolve() for p in paths} & {p.resolve() for p in logs.paths}
    if both:
        raise ValueError(
            f"{min(both).name} is trained on and judges at once: name it in one of the two."
        )
    found = dataclasses.replace(logs, paths=paths)
    if found.problem is not logs.problem:
        raise ValueError(f"{logs.paths[0]} and {paths[0]} are logs of different problems.")
    return found


def earlier(recording: Any, share: float = EARLIER) -> Any:
    """The first rows of a recording, `share` of them.

    Raises ValueError for one that is too short to be cut.
    """
    steps = round(share * len(recording))
    if steps < LEAST or len(recording) - steps < LEAST:
        raise ValueError(
            f"log {recording.meta.get('log', '')} has {len(recording)} rows, too few to be cut in time: "
            f"each part needs {LEAST}. Name another log to judge by (--validation-log)."
        )
    return first_rows(recording, steps)


def first_rows(recording: Any, steps: int) -> Any:
    """The first `steps` rows of a recording of a state-space model."""
    model, changes = recording.model, {}
    if model.steps is not None:
        arrays = {n: getattr(model, n, None) for n in ("F", "H", "Q", "R", "dt")}
        cut = {
            n: a[:steps]
            for n, a in arrays.items()
            if a is not None and getattr(a, "ndim", 0) > 0 and len(a) == model.steps and a.ndim != 2
        }
        changes["model"] = dataclasses.replace(model, **cut)
    for name in ("time", "measurements", "lost", "truth", "regime", "process_scale", "measurement_scale"):  # fmt: skip
        if getattr(recording, name) is not None:
            changes[name] = getattr(recording, name)[:steps]
    return dataclasses.replace(recording, **changes)
