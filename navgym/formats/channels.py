"""Channels: what one sensor of a log measured, in one frame and in SI units, with whole-number stamps.

Frames are those of the rest of navgym: north, east, down outside; forward, starboard, down on board.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.notes import Notes, Progress

Stamps = NDArray[np.int64]

SECOND = 10**9  # ns
# by kind: what a row holds, then the largest magnitude that can be; accuracies are standard deviations
_ACCURACY = dict.fromkeys(("sigma_north", "sigma_east", "sigma_down"), 1e7)
KINDS: dict[str, dict[str, float]] = {
    "fix": {"lat": 90.0, "lon": 360.0, "height": 1e5, **_ACCURACY},  # °, °, m, m
    "position": {"north": 1e7, "east": 1e7, "down": 1e6, **_ACCURACY},  # m
    "velocity": {"vn": 1e3, "ve": 1e3, "vd": 1e3, "sigma_vn": 1e6, "sigma_ve": 1e6, "sigma_vd": 1e6},
    "body_velocity": {"u": 1e3, "v": 1e3, "w": 1e3, "sigma_u": 1e6, "sigma_v": 1e6, "sigma_w": 1e6},
    "attitude": {"roll": 7.0, "pitch": 7.0, "heading": 7.0},  # rad
    "imu": {**dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"), 200.0),  # rad/s
            **dict.fromkeys(("acc_x", "acc_y", "acc_z"), 5e3)},  # m/s²
    "magnetometer": dict.fromkeys(("mx", "my", "mz"), 1e5),  # µT
    "depth": {"depth": 1.2e4},  # m
}  # fmt: skip
# ranks: a sensor, one of several alike, what a filter made of others
SENSOR, FURTHER, ESTIMATE = 0, 1, 2
ESTIMATED = ", an estimate"
LOSSES = (
    "fix",
    "velocity",
    "body_velocity",
)  # kinds whose row without a number is a lost measurement


@dataclass(frozen=True, eq=False)
class Channel:
    """What one source measured of one kind.

    Args:
        name: of its topic, message or sentence.
        kind: a key of `KINDS`.
        time: (T,) ns, on the clock that all channels of a log share, in the order of the file.
        values: (T, c), a column for each name of `KINDS[kind]`, NaN where nothing is known.
        rank: `SENSOR`, `FURTHER` or `ESTIMATE`.
    """

    name: str
    kind: str
    time: Stamps
    values: Array
    rank: int = SENSOR

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, quantity: str) -> Array:
        found: Array = self.values[:, list(KINDS[self.kind]).index(quantity)]
        return found

    @property
    def pace(self) -> str:
        """How many rows in which time, and their usual rate."""
        span, steps = np.ptp(self.time) / SECOND, np.diff(np.unique(self.time))
        rate = f", {SECOND / float(np.median(steps)):.3g} Hz" if len(steps) else ""
        return f"{len(self)} rows in {span:.6g} s{rate}"

    def column(self, quantity: str) -> str:
        """What a column of it is called in tables, mapping files and errors."""
        return f"{self.name}.{quantity}"


@dataclass(frozen=True, eq=False)
class Channels:
    """What a log holds.

    Args:
        path: where it was read.
        format: what kind of file it is.
        found: its channels.
        said: sentences about the reading.
        doubts: those of them that may make a number wrong.
    """

    path: Path
    format: str
    found: Sequence[Channel]
    said: Sequence[str] = ()
    doubts: Sequence[str] = ()

    def of(self, *kinds: str) -> list[Channel]:
        """Channels of these kinds."""
        return [each for each in self.found if each.kind in kinds]

    @property
    def summary(self) -> list[str]:
        """A line for each channel: what it holds, how many rows, how often."""
        return [f"{c.name}: {c.kind.replace('_', ' ')}, {c.pace}{ESTIMATED * (c.rank == ESTIMATE)}" for c in self.found]  # fmt: skip

    def tell(self, notes: Notes) -> None:
        """Hand on what was said."""
        for sentence in self.said:
            notes.say(sentence)
        for sentence in self.doubts:
            notes.doubt(sentence)


@dataclass
class Gathered:
    """Rows of one channel as they are read: 8 bytes a number, and no object for any of them."""

    kind: str
    rank: int = SENSOR
    time: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def add(self, stamp: int, *numbers: float) -> None:
        """Add a row; what is not given at its end is NaN."""
        gone = len(KINDS[self.kind]) - len(numbers)
        self.values.extend(numbers)  # first: a number that is none must leave the two of a length
        self.values.extend((np.nan,) * gone)
        self.time.append(stamp)

    def keep(self, wanted: NDArray[np.bool_]) -> None:
        """Keep (T,) rows of those added."""
        time = np.frombuffer(self.time, np.int64)[wanted]
        values = np.frombuffer(self.values, np.float64).reshape(len(wanted), -1)[wanted]
        self.time, self.values = array("q", time.tobytes()), array("d", values.tobytes())


class Gatherer:
    """Collects the channels of one file.

    Args:
        path: the file.
        format_name: what kind it is.
        progress: to be told how much was read.
    """

    def __init__(self, path: Path, format_name: str, progress: Progress) -> None:
        self.path, self.format, self.progress = path, format_name, progress
        self.rows: dict[tuple[str, str], Gathered] = {}
        self.whole: list[Channel] = []
        self.said: list[str] = []
        self.doubts: list[str] = []

    def rows_of(self, name: str, kind: str, rank: int = SENSOR) -> Gathered:
        """The rows of a channel, begun when they are first asked for."""
        if (name, kind) not in self.rows:
            self.rows[name, kind] = Gathered(kind, rank)
        return self.rows[name, kind]

    def add(self, name: str, kind: str, time: Stamps, columns: Mapping[str, Array], rank: int = SENSOR) -> None:  # fmt: skip
        """Add a channel that a library made in one piece."""
        gone = np.full(len(time), np.nan)
        values = np.column_stack([columns.get(quantity, gone) for quantity in KINDS[kind]])
        self.whole.append(Channel(name, kind, np.asarray(time, np.int64), values, rank))

    def done(self) -> Channels:
        """What was read, unless a number of it cannot be.

        Raises ValueError naming channel and row.
        """
        found = [
            Channel(
                name, kind, np.frombuffer(rows.time, np.int64),
                np.frombuffer(rows.values, np.float64).reshape(len(rows.time), -1), rows.rank,
            )
            for (name, kind), rows in self.rows.items() if len(rows.time)
        ]  # fmt: skip
        kept = [_checked(each) for each in (*found, *self.whole)]
        silent = [each for each in kept if not len(each)]
        said = [*self.said, *(f"{'the estimate ' * (s.rank == ESTIMATE)}{s.name} holds no {s.kind.replace('_', ' ')}" for s in silent)]  # fmt: skip
        there = [each for each in kept if len(each)]
        return Channels(self.path, self.format, there, said, self.doubts)


def _checked(channel: Channel) -> Channel:
    """The channel without rows that hold nothing; ValueError for numbers that cannot be."""
    if len(channel) and (channel.time < 0).any():
        k = int(np.argmax(channel.time < 0))
        raise ValueError(f"{channel.name}, row {k + 1}: {channel.time[k]} ns is no time.")
    for j, (quantity, most) in enumerate(KINDS[channel.kind].items()):
        values = channel.values[:, j]
        wrong = np.abs(values) > most
        wrong |= values < 0.0 if quantity.startswith("sigma") else False
        if wrong.any():
            k = int(np.argmax(wrong))
            raise ValueError(
                f"{channel.name}, row {k + 1}: {quantity} is {values[k]:g}, which cannot be: the "
                "file is damaged, or of another kind."
            )
    told = ~np.isnan(channel.values).all(axis=1)
    if told.any() and channel.kind in LOSSES:
        return channel
    return replace(channel, time=channel.time[told], values=channel.values[told])
