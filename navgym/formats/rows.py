"""Channels as a table of cells, which readers of text take up: rows in the order of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.clocks import date_of
from navgym.core.tables import Cells, Table
from navgym.formats.channels import KINDS, SECOND, Channel

TIME = "time (ns)"
LATEST = 1.0  # s, by which a row may come late


def rows_of(path: Path, channels: Sequence[Channel], said: Sequence[str] = (), more: Mapping[str, Sequence[Array]] | None = None) -> Table:  # fmt: skip
    """A row for each row of each channel, with cells in its columns only.

    A channel's own order stays: where its times go back, so do the table's, and whoever reads
    the table finds it.

    Args:
        path: of the log.
        channels: at least one.
        said: sentences about the reading.
        more: further columns, for each channel its values.
    """
    time = np.concatenate([c.time for c in channels])
    index = _index(channels)
    bounds = np.cumsum([0, *map(len, channels)])
    cells: dict[str, Sequence[str]] = {TIME: Cells.of_numbers(time[index])}
    for k, channel in enumerate(channels):
        for quantity, values in zip(KINDS[channel.kind], channel.values.T, strict=True):
            if not np.isnan(values).all():
                whole = np.full(len(time), np.nan)
                whole[bounds[k] : bounds[k + 1]] = values
                cells[channel.column(quantity)] = Cells.of_numbers(whole[index])
    for name, parts in (more or {}).items():
        cells[name] = Cells.of_numbers(np.concatenate(parts)[index])
    return Table(path, cells, index + 1, said=said)


def _index(channels: Sequence[Channel]) -> NDArray[np.intp]:
    """Which row of the channels, one after the other, each row of their table is."""
    highest = np.concatenate([np.maximum.accumulate(c.time) for c in channels])
    return np.argsort(highest, kind="stable")


def begun(stamp: int | str) -> dict[str, str]:
    """What a recording keeps of the time from which its own count: a date, where the clock tells one.

    Args:
        stamp: ns, of the first row.
    """
    date = date_of(str(stamp), 1.0 / SECOND)
    return {} if date is None else {"start": date}


def owners(channels: Sequence[Channel]) -> NDArray[np.intp]:
    """Of which channel each row of the table of `rows_of` is, (T,)."""
    own: NDArray[np.intp] = np.repeat(np.arange(len(channels)), [len(c) for c in channels])
    return own[_index(channels)]


def ordered(channel: Channel, said: list[str]) -> Channel:
    """The channel with times that increase strictly; what was done about it is said.

    Raises ValueError where times go back by over `LATEST` s, as where a clock is set.
    """
    steps = np.diff(channel.time)
    if (steps < -LATEST * SECOND).any():
        k = int(np.argmax(steps < -LATEST * SECOND)) + 1
        raise ValueError(
            f"{channel.name}, row {k + 1}: the time goes back by {-steps[k - 1] / SECOND:g} s, as where "
            "a clock is set: cut the log there."
        )
    time, index = np.unique(channel.time, return_index=True)
    late, twice = int((steps < 0).sum()), len(channel) - len(time)
    if late:
        said.append(f"{channel.name}: rows sorted by time ({late} came late)")
    if twice:
        said.append(f"{channel.name}: {twice} rows left out, of times that stand there before")
    return replace(channel, time=time, values=channel.values[index])


def alone(path: Path, channel: Channel, columns: Mapping[str, Array], start: int) -> Table:
    """A table of one channel.

    Args:
        path: of the log.
        channel: with times that increase.
        columns: its columns.
        start: ns, from which the table's times count.
    """
    time = (channel.time - start) / SECOND
    cells = {name: Cells.of_numbers(values) for name, values in columns.items()}
    return Table(path, {"time": Cells.of_numbers(time), **cells}, np.arange(1, len(time) + 1))
