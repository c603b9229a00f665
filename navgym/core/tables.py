"""Numbers from and to delimited text; every error names the file, the line and the column."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from navgym.core.atomic import replacing
from navgym.core.checks import Array, one_of
from navgym.core.layout import COMMENTS, DATE_BLANK_CLOCK, LOST, Layout
from navgym.core.layout import find as find_layout
from navgym.core.text import LARGEST, read_text

FLAGS = {"0": False, "false": False, "1": True, "true": True}
ROWS = 1 << 16  # that are turned into numbers at a time: bounds memory
WIDEST = 100  # characters of a cell that may be a number or a time
HIGHEST = 1e30  # of a number: squares and cubes of it must still be numbers
PAD = b"\0" * WIDEST
DIGITS, STRANGE = np.zeros(256, np.bool_), np.ones(256, np.bool_)  # letters of plain numbers
DIGITS[list(b"0123456789")] = True
STRANGE[list(b"0123456789+-.eE\0 ")] = False

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]


class Cells(Sequence[str]):
    """Cells of one column, cut out of the file's text when they are asked for.

    Args:
        text: UTF-8 bytes of the file, and `WIDEST` zeros after them.
        starts: (T,) where each cell begins.
        ends: (T,) where it ends.
    """

    def __init__(self, text: Bytes, starts: Places, ends: Places) -> None:
        self._text, self._starts, self._ends = text, starts, ends

    def __len__(self) -> int:
        return len(self._starts)

    @overload
    def __getitem__(self, index: int) -> str: ...
    @overload
    def __getitem__(self, index: slice) -> Cells: ...
    def __getitem__(self, index: int | slice) -> str | Cells:
        if isinstance(index, slice):
            return Cells(self._text, self._starts[index], self._ends[index])
        cell = self._text[self._starts[index] : self._ends[index]].tobytes()
        return cell.decode("utf-8", errors="replace").strip()

    @property
    def widths(self) -> Places:
        """Bytes of each cell, (T,)."""
        return self._ends - self._starts

    def spelled(self) -> Bytes:
        """Bytes of the cells, (T, W), zeros after each; W is at most `WIDEST`."""
        widths = np.minimum(self.widths, WIDEST)
        width = max(int(widths.max(initial=0)), 3)
        windows = np.lib.stride_tricks.sliding_window_view(self._text, width)
        found = windows[self._starts]
        found[np.arange(width) >= widths[:, None]] = 0
        return found

    @classmethod
    def of(cls, words: Sequence[str]) -> Cells:
        """Cells from a list of text."""
        if isinstance(words, Cells):
            return words
        spelled = [word.encode() for word in words]
        ends = np.cumsum([len(word) for word in spelled], dtype=np.int64)
        starts = ends - np.array([len(word) for word in spelled], dtype=np.int64)
        return cls(np.frombuffer(b"".join(spelled) + PAD, np.uint8), starts, ends)

    @classmethod
    def of_numbers(cls, values: NDArray[Any]) -> Cells:
        """Cells from numbers (T,), spelled so that they read back as the same; NaN is an empty one."""
        spelled, widths = [], [np.zeros(0, np.int64)]
        for first in range(0, len(values), ROWS):
            words = map(repr, values[first : first + ROWS].tolist())
            part = [b"" if word == "nan" else word.encode() for word in words]
            spelled.append(b"".join(part))
            widths.append(np.fromiter(map(len, part), np.int64, len(part)))
        sizes = np.concatenate(widths)
        ends = np.cumsum(sizes)
        return cls(np.frombuffer(b"".join(spelled) + PAD, np.uint8), ends - sizes, ends)


@dataclass(frozen=True, eq=False)
class Table:
    """The cells of a delimited text file with a header row, by column.

    Args:
        path: where it was read.
        cells: text of each column, by its name in the header.
        lines: number of each row's line in the file, the file's first being 1.
        decimal: mark in its numbers, "." or ",".
        units: of columns, where a row below the header tells them.
        said: sentences about how the file was read.
    """

    path: Path
    cells: Mapping[str, Sequence[str]]
    lines: Sequence[int] | Places
    decimal: str = "."
    units: Mapping[str, str] | None = None
    said: Sequence[str] = ()

    def __contains__(self, column: str) -> bool:
        return column in self.cells

    def __len__(self) -> int:
        return len(self.lines)

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

    def pieces(self, column: str) -> Iterator[tuple[int, Cells]]:
        """The column in pieces of `ROWS` rows, each with the number of its first row."""
        cells = Cells.of(self.find(column))
        for first in range(0, len(cells), ROWS):
            yield first, cells[first : first + ROWS]

    def numbers(
        self,
        column: str,
        gaps: bool = False,
        remedy: str = "",
        *,
        lost: frozenset[str] = LOST,
        infinite: bool = False,
        number: Callable[[str], float] | None = None,
    ) -> Array:
        """Column as floats, (T,); `gaps` turns cells such as "", "nan" and "NA" into NaN.

        Args:
            column: its name.
            gaps: whether a number may be missing.
            remedy: for the error.
            lost: words, in lower case, that stand for a missing number.
            infinite: whether "inf" is let through.
            number: what turns a cell that is no plain number into one, NaN where it cannot.

        Raises ValueError, naming line and column, for text, for infinity or a number beyond
        `HIGHEST`, and for gaps.
        """
        self.find(column, remedy)
        wanted = "a finite number, or nothing where lost" if gaps else "a finite number"
        values = np.empty(len(self.lines))
        for first, cells in self.pieces(column):
            part = values[first : first + len(cells)]
            wrong = _parsed(cells, part, self.decimal, lost if gaps else frozenset(), number)
            if not infinite:
                wrong |= np.isinf(part)
            if wrong.any():
                k = int(np.argmax(wrong))
                what = f"must be {wanted}, got {_shown(cells[k])}. {remedy}"
                raise self.error(first + k, column, what)
            huge = (np.abs(part) > HIGHEST) & ~np.isinf(part)
            if huge.any():
                k = int(np.argmax(huge))
                what = f"no quantity is as large as {_shown(cells[k])}: repair or remove the row."
                raise self.error(first + k, column, what)
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
                raise self.error(i, column, f"must be 0, 1, true or false, got {_shown(cell)}.")
            values[i] = FLAGS[cell.lower()]
        return values

    def error(self, row: int, column: str, what: str) -> ValueError:
        """The error to raise about one cell."""
        place = f"{self.path.name}, line {self.lines[row]}, column {column!r}"
        return ValueError(f"{place}: {what}".strip())


def read_table(
    path: str | os.PathLike[str],
    delimiter: str | None = None,
    *,
    decimal: str | None = None,
    encoding: str | None = None,
    largest: float = LARGEST,
) -> Table:
    """Read a delimited text file whose header names the columns.

    Blank lines, comments (`COMMENTS`), lines above the header and a row of units below it are no
    rows; a last row that was cut off is left out. See `navgym.core.text.read_text` for what text
    may be.

    Args:
        path: the file.
        delimiter: between cells, " " for any run of blanks; found in the file by default.
        decimal: "." or ","; found in the file by default.
        encoding: of the text; found in the file by default.
        largest: bytes of text that are read at most.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a folder, a binary or empty file, a header without names or with duplicates, a
            row with too few or too many cells; the message names the line.
    """
    source = Path(path)
    text, said = read_text(source, encoding, largest)
    layout = find_layout(source.name, text, delimiter, decimal)
    said = [*said, *layout.said]
    body, lines = _body(source, text, layout)
    starts, ends, lines = _grid(source, body, lines, layout, said)
    buffer = np.frombuffer(body + PAD, np.uint8)
    columns = {n: Cells(buffer, starts[:, j], ends[:, j]) for j, n in enumerate(layout.names)}
    units = {n: u for n, u in zip(layout.names, layout.units, strict=False) if u}
    return Table(source, columns, lines, layout.decimal, units, tuple(said))


def read_rows(source: Path, delimiter: str) -> tuple[list[list[str]], list[int]]:
    """Stripped cells of each line that is not blank, and the lines' numbers; raises as `read_table`."""
    if not isinstance(delimiter, str) or len(delimiter) != 1:
        raise ValueError(f"delimiter must be one character such as ',' or ';', got {delimiter!r}.")
    text, _ = read_text(source)
    return _quoted(source, text.decode("utf-8", errors="replace"), delimiter, 0)


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


# ---- from text to cells ------------------------------------------------------------------------


def _quoted(
    source: Path, text: str, delimiter: str, before: int
) -> tuple[list[list[str]], list[int]]:
    """Rows of a text by the csv module, and their lines' numbers, `before` lines being above."""
    lines_of = io.StringIO(text, newline="")
    reader = csv.reader(lines_of, delimiter=delimiter, strict=True, skipinitialspace=True)
    rows, lines = [], []
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                rows.append([cell.strip() for cell in row])
                lines.append(before + reader.line_num)
    except csv.Error as error:
        place = f"{source.name}, line {before + reader.line_num}"
        raise ValueError(f"{place}: {error}: check its quotes.") from None
    return rows, lines


def _body(source: Path, text: bytes, layout: Layout) -> tuple[bytes, Places]:
    """The rows as plain text, cells divided by the layout's delimiter, and each one's line."""
    body = text[layout.begins :]
    if b'"' in body:
        rows, numbers = _quoted(
            source, body.decode("utf-8", errors="replace"), layout.delimiter, layout.line - 1
        )
        forbidden = {ord(layout.delimiter): "\x1f", ord("\n"): " "}
        plain = "\n".join(
            layout.delimiter.join(cell.translate(forbidden) for cell in row) for row in rows
        )
        return plain.encode(errors="replace"), np.array(numbers, dtype=np.int64)
    lines = np.arange(layout.line, layout.line + body.count(b"\n") + 1, dtype=np.int64)
    if layout.delimiter == " ":
        return _single_blanks(body), lines
    return body, lines


def _single_blanks(body: bytes) -> bytes:
    """Each run of blanks and tabs as one blank, none at either end of a line; dates with clocks as one cell."""
    if DATE_BLANK_CLOCK.search(body, 0, 10_000):
        body = DATE_BLANK_CLOCK.sub(rb"\1T", body)
    text = np.frombuffer(body.replace(b"\t", b" "), np.uint8)
    for shift in (-1, 1):  # a blank before another or an end, then one after a beginning
        beside = np.full(len(text), ord("\n"), np.uint8)
        near = slice(1, None) if shift < 0 else slice(None, -1)
        far = slice(None, -1) if shift < 0 else slice(1, None)
        beside[far] = text[near]
        text = text[(text != ord(" ")) | ((beside != ord(" ")) & (beside != ord("\n")))]
    return text.tobytes()


def _grid(
    source: Path, body: bytes, lines: Places, layout: Layout, said: list[str]
) -> tuple[Places, Places, Places]:
    """Where the cells of each row start and end, (T, columns) each, and the rows' lines, (T,)."""
    whole = body.endswith(b"\n")
    text = np.frombuffer(body if whole else body + b"\n", np.uint8)
    stops = np.flatnonzero((text == ord(layout.delimiter)) | (text == ord("\n")))
    width = len(layout.names)
    even = stops.reshape(-1, width) if len(stops) % width == 0 else stops[:0]
    ends_of_lines = np.flatnonzero(text == ord("\n"))
    begins = np.append(0, ends_of_lines[:-1] + 1)
    kept = ~_comments(text, begins)
    if len(even) == len(begins) and np.array_equal(even[:, -1], ends_of_lines) and kept.all():
        ends, lines = even, lines[: len(begins)]
        starts = np.append(0, stops[:-1] + 1).reshape(even.shape)
    else:
        starts, ends, lines = _uneven(source, text, stops, kept, lines, layout, not whole, said)
    starts, ends = _stripped(text, starts, ends)
    filled = (ends > starts).any(axis=1)
    if not filled.any():
        raise ValueError(f"{source.name} has a header line but no rows: it needs one per sample.")
    if filled.all():
        return starts, ends, lines
    return starts[filled], ends[filled], lines[filled]


def _uneven(
    source: Path,
    text: Bytes,
    stops: Places,
    kept: NDArray[np.bool_],
    lines: Places,
    layout: Layout,
    open_end: bool,
    said: list[str],
) -> tuple[Places, Places, Places]:
    """As `_grid`, of a text in which some lines are no rows; `kept` is False at comments."""
    last = np.flatnonzero(text[stops] == ord("\n"))  # of each line, among `stops`
    first = np.append(0, last[:-1] + 1)
    counts = last - first + 1
    width = len(layout.names)
    trailing = False
    for i in np.flatnonzero(kept & (counts != width)).tolist():
        line = text[stops[first[i] - 1] + 1 if first[i] else 0 : stops[last[i]]].tobytes()
        cut = open_end and i == len(last) - 1
        kept[i], more = _odd(source, line, layout, int(counts[i]), int(lines[i]), cut, said)
        trailing |= more
    if trailing:
        said.append("rows end in a delimiter")
    index = first[kept][:, None] + np.arange(width)
    starts = np.where(index > 0, stops[index - 1] + 1, 0)
    return starts, stops[index], lines[: len(last)][kept]


def _comments(text: Bytes, begins: Places) -> NDArray[np.bool_]:
    """Whether each line is a comment."""
    found = np.zeros(len(begins), dtype=np.bool_)
    padded = np.append(text, np.zeros(2, np.uint8))
    for mark in COMMENTS:
        same = np.ones(len(begins), dtype=np.bool_)
        for i, letter in enumerate(mark.encode()):
            same &= padded[begins + i] == letter
        found |= same
    return found


def _odd(
    source: Path,
    line: bytes,
    layout: Layout,
    count: int,
    number: int,
    cut: bool,
    said: list[str],
) -> tuple[bool, bool]:
    """Whether a line that has another number of cells is a row, and whether it ends in a delimiter."""
    text = line.decode("utf-8", errors="replace")
    width = len(layout.names)
    if not text.strip() or text.lstrip().startswith(COMMENTS):
        return False, False
    if count == width + 1 and not text.split(layout.delimiter)[-1].strip():
        return True, True
    if cut and count < width:
        said.append(f"line {number}, the last, was cut off: left out")
        return False, False
    raise ValueError(
        f"{source.name}, line {number}: {count} cells, but the header names {width} columns: "
        f"repair the row, or set delimiter= ({layout.delimiter!r} now)."
    )


def _stripped(text: Bytes, starts: Places, ends: Places) -> tuple[Places, Places]:
    """Cells without blanks at either end."""
    blank = np.zeros(256, dtype=np.bool_)
    blank[[9, 11, 12, 32]] = True
    for _ in range(WIDEST):
        more = blank[text[np.minimum(starts, len(text) - 1)]] & (starts < ends)
        if not more.any():
            break
        starts = starts + more
    for _ in range(WIDEST):
        more = blank[text[ends - 1]] & (starts < ends)
        if not more.any():
            break
        ends = ends - more
    return starts, ends


# ---- from cells to numbers ---------------------------------------------------------------------


def _parsed(
    cells: Cells,
    values: Array,
    decimal: str,
    lost: frozenset[str],
    number: Callable[[str], float] | None,
) -> NDArray[np.bool_]:
    """Fill `values` with the numbers of `cells`; returns where there is none and none is lost."""
    spelled, long = cells.spelled(), cells.widths > WIDEST
    if decimal == ",":
        spelled[spelled == ord(",")] = ord(".")
    flat = spelled.view(f"S{spelled.shape[1]}")[:, 0]
    if _all_plain(spelled, flat, values):
        return long
    odd = np.asarray(STRANGE[spelled].any(axis=1) | ~DIGITS[spelled].any(axis=1))
    try:
        values[:] = np.where(odd, b"0", flat).astype(np.float64)
    except ValueError:  # such as "1-2"
        odd[:] = True
    wrong = long.copy()
    if odd.any():
        words, which = np.unique(flat[odd], return_inverse=True)
        found = [_one(w.decode("utf-8", "replace").strip(), decimal, lost, number) for w in words]
        values[odd] = np.array([value for value, _ in found])[which]
        wrong[odd] |= np.array([bad for _, bad in found])[which]
    return wrong


def _all_plain(spelled: Bytes, flat: NDArray[np.bytes_], values: Array) -> bool:
    """Fill `values`, and say whether all are finite numbers, as nearly always they are."""
    if (spelled == ord("_")).any():
        return False
    try:
        values[:] = flat.astype(np.float64)
    except ValueError:
        return False
    return bool(np.isfinite(values).all())


def _one(
    cell: str, decimal: str, lost: frozenset[str], number: Callable[[str], float] | None
) -> tuple[float, bool]:
    """A cell as a number, and whether it is none although it is not lost."""
    if cell.lower() in lost:
        return math.nan, False
    value = _number(cell.replace(",", ".") if decimal == "," else cell)
    if math.isnan(value) and number is not None:
        value = number(cell)
    return value, math.isnan(value)


def _number(cell: str) -> float:
    """`cell` as a float, NaN if it is none ("1_000" is one to Python, but not in a log)."""
    try:
        return math.nan if "_" in cell or len(cell) > WIDEST else float(cell)
    except ValueError:
        return math.nan


def _shown(cell: Any) -> str:
    text = repr(cell)
    return text if len(text) <= 60 else f"{text[:50]}... ({len(cell)} characters)"
