"""Where a text file's table stands: delimiter, decimal mark, names, units, the first row."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice

from navgym.core import units

LOST = frozenset(
    ("", "nan", "-nan", "+nan", "na", "n/a", "#n/a", "null", "none", "nil", "-", "--", "---", "?",
     "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "missing", "<na>", "nat")
)  # fmt: skip
DELIMITERS = (",", ";", "\t", "|", " ")
COMMENTS = ("#", "%", "//")
SAMPLE = 400  # lines that are looked at
JUDGED = 100  # of them, by which the delimiter is found
WIDEST = 20_000  # bytes of such a line
LONGEST_VALUE = 60  # characters
_NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?", re.ASCII)
_DATE = r"\d{4}[-/]\d\d?[-/]\d\d?|\d\d?[./]\d\d?[./]\d{4}"
_CLOCK = r"\d{1,2}:\d\d(:\d\d([.,]\d*)?)?"
_TIME = rf"({_DATE})([T ]+{_CLOCK}\s*(Z|UTC|[-+]\d\d:?(\d\d)?)?)?|{_CLOCK}"
_DEGREES = r"[-+]?\d+([.,]\d+)?\s*[°º].*|\d+(\.\d+)?\s*[NSEW]"
_VALUE = re.compile("|".join((_NUMBER.pattern, _COMMA.pattern, _TIME, _DEGREES)), re.ASCII)
_INK = re.compile(rb"\S")
DATE_BLANK_CLOCK = re.compile(rb"(?<!\S)(\d{4}[-/]\d\d?[-/]\d\d?)[ \t]+(?=\d\d?:\d\d)")


@dataclass(frozen=True)
class Layout:
    """Where the table of a text stands.

    Args:
        delimiter: between cells, " " for any run of blanks.
        decimal: "." or ",".
        names: of the columns.
        units: of the columns, "" where a row of units below the names tells none.
        begins: bytes before the first row.
        line: number of the first row's line, the file's first being 1.
        said: sentences about what was found.
    """

    delimiter: str
    decimal: str
    names: Sequence[str]
    units: Sequence[str]
    begins: int
    line: int
    said: Sequence[str]


@dataclass(frozen=True)
class _Line:
    number: int
    ends: int  # bytes up to its end
    text: str
    cells: list[str]

    @property
    def values(self) -> int:
        """How many cells are numbers or times."""
        return sum(is_value(cell) for cell in self.cells)


def find(
    name: str, text: bytes, delimiter: str | None = None, decimal: str | None = None
) -> Layout:
    """Layout of the text of file `name`; raises ValueError where it holds no table with names."""
    _check(delimiter, decimal)
    lines = _sampled(text)
    rows = [line for line in lines if not line[2].startswith(COMMENTS)]
    if not rows:
        raise ValueError(f"{name} is empty: it needs a header line and a row per sample.")
    delimiter = delimiter or _delimiter([line[2] for line in rows])
    split = [_Line(*line, cells(line[2], delimiter)) for line in rows]
    width = _width(split)
    first = next((i for i, row in enumerate(split) if _is_row(row, width)), None)
    if first is None:
        first = next((i for i, row in enumerate(split) if row.values), None)
    if first is None:
        first = min(1, len(split))
    said: list[str] = []
    names, below, start = _header(name, split[:first], split[first:], lines, delimiter, said)
    found = decimal or _decimal(split[first:], delimiter)
    if found == ",":
        said.append("decimal commas")
    said.append(f"cells are divided by {'blanks' if delimiter == ' ' else repr(delimiter)}")
    return Layout(delimiter, found, names, below, start.ends, start.number + 1, said)


def cells(line: str, delimiter: str) -> list[str]:
    """Stripped cells of one line."""
    if delimiter == " ":
        line = DATE_BLANK_CLOCK.sub(rb"\1T", line.encode()).decode()
    if '"' in line:
        try:
            reader = csv.reader([line.strip()], delimiter=delimiter, skipinitialspace=True)
            found = next(reader, [])
        except csv.Error:
            found = line.split(delimiter)
        found = [cell for cell in found if cell or delimiter != " "]
    else:
        found = line.split() if delimiter == " " else line.split(delimiter)
    return [cell.strip() for cell in found]


@lru_cache(maxsize=1 << 16)
def is_value(cell: str) -> bool:
    """Whether a cell is a number, a time or an angle (a missing one is none)."""
    return len(cell) <= LONGEST_VALUE and _VALUE.fullmatch(cell) is not None


def _check(delimiter: str | None, decimal: str | None) -> None:
    strange = isinstance(delimiter, str) and (delimiter.isalnum() or delimiter in '".-+\r\n')
    if delimiter is not None and (
        not isinstance(delimiter, str) or len(delimiter) != 1 or strange or ord(delimiter) > 127
    ):
        raise ValueError(f"delimiter must be one character such as ',' or ';', got {delimiter!r}.")
    if decimal not in (None, ".", ","):
        raise ValueError(f"decimal must be '.' or ',', got {decimal!r}.")
    if decimal == delimiter == ",":
        raise ValueError("decimal and delimiter are both ',': say which it is.")


def _sampled(text: bytes) -> list[tuple[int, int, str]]:
    """Number, end in bytes and text of the first lines that are not blank."""

    def each() -> Iterator[tuple[int, int, str]]:
        end, number = 0, 1
        while (found := _INK.search(text, end)) is not None:
            start = text.rfind(b"\n", end, found.start()) + 1 or end
            number += text.count(b"\n", end, start)
            stop = text.find(b"\n", start)
            before, end = number, len(text) if stop < 0 else stop + 1
            line = text[start : min(end, start + WIDEST)].decode("utf-8", errors="replace")
            number += 1
            yield before, end, line.strip("\n")

    return list(islice(each(), SAMPLE))


def _delimiter(lines: Sequence[str]) -> str:
    """The delimiter by which most cells of rows of one width are values."""
    best, most = ",", 0.0
    for delimiter in DELIMITERS:
        split = [cells(line, delimiter) for line in lines[:JUDGED]]
        tally: Counter[int] = Counter()
        for row in split:
            values = sum(is_value(cell) or (cell.lower() in LOST) for cell in row)
            if len(row) > 1 and any(is_value(cell) for cell in row):
                tally[len(row)] += values * values * 1000 // len(row)
        score = max(tally.values(), default=0)
        if score > most:
            best, most = delimiter, score
    if not most and lines:  # names alone
        best = max(DELIMITERS[:-1], key=lines[0].count)
    return best


def _width(rows: Sequence[_Line]) -> int:
    widths = Counter(_filled(row.cells) for row in rows if row.values)
    return widths.most_common(1)[0][0] if widths else 0


def _filled(row: Sequence[str]) -> int:
    """Cells of a row, but for an empty one after a last delimiter."""
    return len(row) - (len(row) > 1 and not row[-1])


def _is_row(row: _Line, width: int) -> bool:
    filled = [cell for cell in row.cells if cell]
    values = sum(is_value(cell) or cell.lower() in LOST for cell in filled)
    return row.values > 0 and 2 * values >= len(filled) and abs(len(row.cells) - width) <= 1


def _header(
    name: str,
    above: Sequence[_Line],
    body: Sequence[_Line],
    lines: Sequence[tuple[int, int, str]],
    delimiter: str,
    said: list[str],
) -> tuple[list[str], list[str], _Line]:
    """Names, units, and the line after which rows begin."""
    width = _width(body) or (len(above[-1].cells) if above else 0)
    if not above:
        return *_from_comment(name, body[0], lines, delimiter, width, said), _before(body[0], lines)
    below: list[str] = []
    head = above[-1]
    if len(above) > 1 and _is_units(head.cells):
        below, head = head.cells, above[-2]
        said.append(f"line {above[-1].number} holds units")
    row = _fitting(head, delimiter, width)
    if head.number > 1:
        said.append(f"the names stand in line {head.number}")
    return _checked(name, row, body), below, above[-1]


def _before(row: _Line, lines: Sequence[tuple[int, int, str]]) -> _Line:
    """The line before a row, whose end is where rows begin."""
    earlier = [line for line in lines if line[0] < row.number]
    number, ends, text = earlier[-1] if earlier else (0, 0, "")
    return _Line(number, ends, text, [])


def _from_comment(
    name: str,
    row: _Line,
    lines: Sequence[tuple[int, int, str]],
    delimiter: str,
    width: int,
    said: list[str],
) -> tuple[list[str], list[str]]:
    """Names that stand in the last comment above the rows, as numpy.savetxt writes them."""
    comments = [line for line in lines if line[0] < row.number]
    if comments:
        number, ends, text = comments[-1]
        text = text.lstrip("#%/ \t")
        names = _fitting(_Line(number, ends, text, cells(text, delimiter)), delimiter, width)
        if len(names) == width and not any(is_value(cell) for cell in names):
            said.append(f"the names stand in a comment, line {number}")
            return _checked(name, names, [row]), []
    raise ValueError(
        f"{name}: the first line must name the columns, but it holds only numbers "
        f"({', '.join(row.cells[:4])}): put a header line such as time,px,py above it."
    )


def _fitting(head: _Line, delimiter: str, width: int) -> list[str]:
    """Cells of the names' line; between blanks, names may hold single blanks and brackets."""
    ways = [head.cells]
    if delimiter == " ":
        ways.append(re.sub(r"\s+([\[(])", r"\1", head.text).split())
        ways.append(re.split(r"\s{2,}|\t", head.text.strip()))
    ways += [way[:-1] for way in ways if way and not way[-1]]
    return next((way for way in ways if len(way) == width), _trimmed(head.cells))


def _trimmed(row: list[str]) -> list[str]:
    return row[:-1] if len(row) > 1 and not row[-1] else row


def _is_units(row: Sequence[str]) -> bool:
    words = [cell for cell in row if cell]
    known = sum(units.is_unit(cell) for cell in words)
    return known > 0 and all(
        units.is_unit(cell) or units.plain(cell) in units.NO_UNITS for cell in words
    )


def _checked(name: str, names: list[str], body: Sequence[_Line]) -> list[str]:
    if not body:
        raise ValueError(f"{name} has a header line but no rows: it needs one per sample.")
    other = [mark for mark in ";\t|," if len(names) == 1 and mark in names[0]]
    if other:
        raise ValueError(f"{name} has one column called {names[0]!r}: pass delimiter={other[0]!r}.")
    twice = sorted({n for n in names if n and names.count(n) > 1})
    if twice:
        raise ValueError(f"{name} has several columns called {twice[0]!r}: rename all but one.")
    return [n or f"column {i + 1}" for i, n in enumerate(names)]


def _decimal(body: Sequence[_Line], delimiter: str) -> str:
    """A comma where numbers have one and none has a point."""
    if delimiter == ",":
        return "."
    found = [cell for row in body for cell in row.cells]
    commas = any(_COMMA.fullmatch(cell) for cell in found)
    points = any("." in cell and _NUMBER.fullmatch(cell) for cell in found)
    return "," if commas and not points else "."
