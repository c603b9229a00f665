"""Numbers from and to delimited text; every error names the file, the line and the column."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from navgym.core.atomic import replacing
from navgym.core.checks import Array, one_of

FLAGS = {"0": False, "false": False, "1": True, "true": True}
LOST = ("", "nan")  # cells that stand for a lost measurement


@dataclass(frozen=True, eq=False)
class Table:
    """The cells of a delimited text file with a header row, by column.

    Args:
        path: where it was read.
        cells: text of each column, by its name in the header.
        lines: number of each row's line in the file, the header being line 1.
    """

    path: Path
    cells: Mapping[str, Sequence[str]]
    lines: Sequence[int]

    def __contains__(self, column: str) -> bool:
        return column in self.cells

    def find(self, column: str, remedy: str = "") -> Sequence[str]:
        """Cells of `column`; ValueError with the nearest name if the file has no such column."""
        try:
            return self.cells[one_of(f"column of {self.path.name}:", column, self.cells)]
        except ValueError as error:
            raise ValueError(f"{error} {remedy}".strip()) from None

    def renamed(self, columns: Mapping[str, str]) -> Table:
        """The table with column `columns[name]` of the file called `name`.

        A column of the file that already bears such a name gives way to it.
        """
        chosen = {name: self.find(column) for name, column in columns.items()}
        taken = set(columns.values()) | set(columns)
        rest = {name: cells for name, cells in self.cells.items() if name not in taken}
        return replace(self, cells=chosen | rest)

    def numbers(self, column: str, gaps: bool = False, remedy: str = "") -> Array:
        """Column as floats, (T,); `gaps` turns empty and "nan" cells into NaN instead of raising.

        Raises ValueError, naming line and column, for text, for infinity, and for gaps.
        """
        values = np.empty(len(self.lines))
        for i, cell in enumerate(self.find(column)):
            lost = gaps and cell.lower() in LOST
            values[i] = math.nan if lost else _number(cell)
            if not lost and not math.isfinite(values[i]):
                wanted = "a finite number, or nothing where lost" if gaps else "a finite number"
                raise self.error(i, column, f"must be {wanted}, got {cell!r}. {remedy}")
        return values

    def increasing(self, column: str, scale: float = 1.0, remedy: str = "") -> Array:
        """Column of times, multiplied by `scale`; ValueError where one does not come after the last.

        `remedy` is for a file that has no such column.
        """
        cells = self.find(column, remedy)
        time = scale * self.numbers(column)
        late = np.flatnonzero(np.diff(time) <= 0.0)
        if len(late):
            k = int(late[0]) + 1
            what = f"{cells[k]} does not come after {cells[k - 1]}: sort the rows, drop duplicates."
            raise self.error(k, column, what)
        return time

    def matrix(self, columns: Sequence[str], remedy: str = "") -> Array:
        """Columns of numbers side by side, (T, number of columns); see `numbers`."""
        return np.stack([self.numbers(name, remedy=remedy) for name in columns], axis=-1)

    def flags(self, column: str) -> NDArray[np.bool_]:
        """Column as booleans, (T,), from cells 0, 1, true or false."""
        values = np.empty(len(self.lines), dtype=np.bool_)
        for i, cell in enumerate(self.find(column)):
            if cell.lower() not in FLAGS:
                raise self.error(i, column, f"must be 0, 1, true or false, got {cell!r}.")
            values[i] = FLAGS[cell.lower()]
        return values

    def error(self, row: int, column: str, what: str) -> ValueError:
        """The error to raise about one cell."""
        place = f"{self.path.name}, line {self.lines[row]}, column {column!r}"
        return ValueError(f"{place}: {what}".strip())


def read_table(path: str | os.PathLike[str], delimiter: str = ",") -> Table:
    """Read a delimited text file (UTF-8) whose first line names the columns; blank lines are skipped.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a folder, a binary or empty file, a header without names or with duplicates, a
            row with too few or too many cells; the message names the line.
    """
    source = Path(path)
    rows, lines = read_rows(source, delimiter)
    if not rows:
        raise ValueError(f"{source.name} is empty: it needs a header line and a row per sample.")
    header = _header(source, rows[0])
    for line, row in zip(lines, rows, strict=True):
        if len(row) != len(header):
            raise ValueError(
                f"{source.name}, line {line}: {len(row)} cells, but the header names "
                f"{len(header)} columns: repair the row, or set delimiter= ({delimiter!r} now)."
            )
    if len(rows) == 1:
        raise ValueError(f"{source.name} has a header line but no rows: it needs one per sample.")
    return Table(source, dict(zip(header, zip(*rows[1:], strict=True), strict=True)), lines[1:])


def read_rows(source: Path, delimiter: str) -> tuple[list[list[str]], list[int]]:
    """Stripped cells of each line that is not blank, and the lines' numbers; raises as `read_table`."""
    if not isinstance(delimiter, str) or len(delimiter) != 1:
        raise ValueError(f"delimiter must be one character such as ',' or ';', got {delimiter!r}.")
    reader = csv.reader(io.StringIO(_text(source), newline=""), delimiter=delimiter, strict=True)
    rows, lines = [], []
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                rows.append([cell.strip() for cell in row])
                lines.append(reader.line_num)
    except csv.Error as error:
        raise ValueError(f"{source.name}, line {reader.line_num}: {error}.") from None
    return rows, lines


def write_table(path: str | os.PathLike[str], columns: Mapping[str, Iterable[object]]) -> Path:
    """Write columns of equal length as comma-separated text, atomically; NaN becomes an empty cell.

    Floats are written with the fewest digits that read back as the same float. FileNotFoundError
    if the folder does not exist.
    """
    target = Path(path)
    with replacing(target, text=True) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow(["" if value != value else value for value in row])  # noqa: PLR0124
    return target


def _text(source: Path) -> str:
    if source.is_dir():
        raise ValueError(f"{source} is a folder: name the file in it.")
    try:
        content = source.read_bytes()
    except FileNotFoundError:
        raise FileNotFoundError(f"{source} does not exist: check the path.") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{source.name} is not UTF-8 text ({error}): export it as CSV.") from None
    if "\0" in text:
        raise ValueError(f"{source.name} is a binary file, not text: export it as CSV.")
    return text


def _header(source: Path, names: list[str]) -> list[str]:
    other = [mark for mark in ";\t|," if len(names) == 1 and mark in names[0]]
    if other:
        raise ValueError(
            f"{source.name} has one column called {names[0]!r}: pass delimiter={other[0]!r}."
        )
    if all(math.isfinite(_number(name)) for name in names):
        raise ValueError(
            f"{source.name}: the first line must name the columns, but it holds only numbers "
            f"({', '.join(names[:4])}): put a header line such as time,px,py above it."
        )
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(
            f"{source.name} has several columns called {twice[0]!r}: rename all but one."
        )
    return names


def _number(cell: str) -> float:
    """`cell` as a float, NaN if it is none ("1_000" is one to Python, but not in a log)."""
    try:
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan
