"""Channels as a table of cells, which readers of text take up: rows in the order of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from navgym.core.checks import Array
from navgym.core.tables import Cells, Table
from navgym.formats.channels import KINDS, Channel

TIME = "time (ns)"


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
    highest = np.concatenate([np.maximum.accumulate(c.time) for c in channels])
    index = np.argsort(highest, kind="stable")
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
