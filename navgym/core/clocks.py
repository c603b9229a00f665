"""Columns of times, in numbers, dates or clocks, as exact seconds.

Stamps since 1970 in ns have more digits than a float holds, so whole numbers and decimals are
taken as integers, and the first is subtracted before anything is scaled.
"""

from __future__ import annotations

import datetime as dt
import math
import re
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.tables import Bytes, Table

PLACES = 9  # decimals that are kept of a number
LARGEST = (2**63 - 10) // 10  # what may still be followed by a digit
ROUNDING = 1e-6  # of the usual step: a larger rounding of stamps is avoided
EPOCH = (1e8, 5e9)  # s: stamps within are dates since 1970
UNITS = {1.0: "s", 1e-3: "ms", 1e-6: "us", 1e-9: "ns"}
HALF_A_DAY, LATE_ROW = 43_200.0, 82_800.0  # s
_ISO = re.compile(
    r"(?P<year>\d{4})-(?P<month>\d\d?)-(?P<day>\d\d?)"
    r"([Tt ]+(?P<clock>\d{1,2}:\d\d(:\d\d)?)([.,](?P<fraction>\d*))?"
    r"\s*(?P<offset>Z|z|UTC|[+-]\d\d:?(\d\d)?)?)?",
    re.ASCII,
)
_DAY_FIRST = re.compile(r"(\d\d?)\.(\d\d?)\.(\d{4})(.*)")
_CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:\.\d*)?)", re.ASCII)
_YEARS = ("1700", "2250")  # what 64 bits of nanoseconds hold

Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Times:
    """Times of a table's rows.

    Args:
        seconds: (T,), since `start` where that is known, in the order of the file.
        start: date or number from which `seconds` are counted, None: they stand as in the file.
        kind: "number", "date" or "clock".
        scale: s in a unit of the numbers.
        guessed: why `scale` was guessed, or "".
        nights: how often a clock passed midnight.
    """

    seconds: Array
    start: str | None
    kind: str
    scale: float = 1.0
    guessed: str = ""
    nights: int = 0


def read_times(table: Table, column: str, scale: float | None = None, remedy: str = "") -> Times:
    """Times of a column.

    Args:
        table: where it stands.
        column: its name.
        scale: s in a unit of it; None: s, or ms, us or ns where the numbers are dates since 1970.
        remedy: for a file without such a column.

    Raises ValueError, naming line and column, where a cell is no time, or of another kind.
    """
    cells = table.find(column, remedy)
    first = next((cell for cell in cells if cell), "")
    if ":" in first and not re.match(r"\d{1,4}[-/.]\d", first):
        seconds, nights = _clocks(table, column)
        return Times(seconds, None, "clock", nights=nights)
    if re.match(r"\d{4}[-/]\d\d?[-/]\d|\d\d?[./]\d\d?[./]\d{4}", first):
        stamps = _dates(table, column)
        start = f"{np.datetime64(int(stamps[0]), 'ns')}Z"
        return Times((stamps - stamps[0]) / 1e9, start, "date")
    return _numbers(table, column, scale)


def date_of(number: str, scale: float) -> str | None:
    """ISO 8601, UTC, of a number of units of `scale` s since 1970; None where it is no such number."""
    try:
        stamp = int(Decimal(number) * Decimal(repr(scale)) * 10**9)
    except (InvalidOperation, ValueError, OverflowError):
        return None
    dated = EPOCH[0] * 1e9 < stamp < EPOCH[1] * 1e9
    return f"{np.datetime64(stamp, 'ns')}Z" if dated else None


def _numbers(table: Table, column: str, scale: float | None) -> Times:
    found = table.numbers(column)
    guess, why = (1.0, "") if scale is None else (scale, "")
    size = float(np.median(np.abs(found)))
    if scale is None:
        for unit in (1e-3, 1e-6, 1e-9):
            if EPOCH[0] < size * unit < EPOCH[1] and size > EPOCH[1]:
                guess = unit
                why = f"the times are taken for {UNITS[unit]} since 1970"
    seconds = guess * found
    steps = np.diff(np.sort(seconds))
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    dated = EPOCH[0] < size * guess < EPOCH[1]
    far = float(np.spacing(np.abs(found).max()) * guess)
    if not dated and (far <= ROUNDING * usual or len(found) < 2):
        return Times(seconds, None, "number", guess, why)
    exact = _decimals(table, column)
    start = table.find(column)[0]
    if exact is None:
        return Times(guess * (found - found[0]), start, "number", guess, why)
    whole, part = (values - values[0] for values in exact)
    inverse = round(1.0 / guess)
    if guess < 1.0 and math.isclose(guess * inverse, 1.0, rel_tol=1e-15):
        return Times(whole / inverse + part / 10.0**PLACES / inverse, start, "number", guess, why)
    return Times(whole * guess + part * (guess / 10.0**PLACES), start, "number", guess, why)


def _decimals(table: Table, column: str) -> tuple[Integers, Integers] | None:
    """Numbers as integers before the point, and after it in units of its ninth place.

    None where a number is written otherwise, such as 1e9.
    """
    found = np.empty((2, len(table)), np.int64)
    for first, cells in table.pieces(column):
        spelled = cells.spelled()
        spelled[spelled == ord(",")] = ord(".")
        fields, good = _scanned(spelled, ord("."))
        if not good.all():
            return None
        found[:, first : first + len(cells)] = fields
    return found[0], found[1]


def _scanned(spelled: Bytes, point: int) -> tuple[Integers, NDArray[np.bool_]]:
    """Digits before and after a point, (2, N), with their sign, and where there is nothing else."""
    count = len(spelled)
    whole, part = np.zeros(count, np.int64), np.zeros(count, np.int64)
    places = np.zeros(count, np.int64)
    behind, good = np.zeros(count, np.bool_), np.ones(count, np.bool_)
    signed = np.isin(spelled[:, 0], (ord("+"), ord("-")))
    for k, letters in enumerate(spelled.T):
        value = letters.astype(np.int64) - ord("0")
        digit = (value >= 0) & (value <= 9)
        marked = letters == point
        good &= digit | (marked & ~behind) | (letters == 0) | (signed if k == 0 else False)
        before = digit & ~behind
        after = digit & behind & (places < PLACES)
        good &= ~before | (whole <= LARGEST)
        whole = np.where(before & good, 10 * whole + value, whole)
        part = np.where(after, 10 * part + value, part)
        places += after
        behind |= marked
    part *= 10 ** (PLACES - places)
    sign = np.where(spelled[:, 0] == ord("-"), -1, 1)
    return np.stack([sign * whole, sign * part]), good


def _clocks(table: Table, column: str) -> tuple[Array, int]:
    """Seconds since the first midnight of HH:MM:SS(.fff), and how many midnights came after.

    A fall of over half a day is one.
    """
    seconds = np.empty(len(table))
    for first, cells in table.pieces(column):
        for k, cell in enumerate(cells):
            seconds[first + k] = _clock(cell)
            if math.isnan(seconds[first + k]):
                what = f"must be a clock HH:MM:SS as in the rows before, got {cell!r:.60}."
                raise table.error(first + k, column, what)
    steps = np.diff(seconds, prepend=seconds[0])
    back = steps > LATE_ROW  # of yesterday, after the first rows of today
    nights: Integers = np.cumsum(steps < -HALF_A_DAY) - np.cumsum(back)
    return seconds + 86_400.0 * nights, int(nights.max())


def _clock(cell: str) -> float:
    found = _CLOCK.fullmatch(cell[:40].replace(",", "."))
    if found is None:
        return math.nan
    h, m, s = int(found[1]), int(found[2]), float(found[3])
    return h * 3600 + m * 60 + s if h < 25 and m < 60 and s < 61 else math.nan


def _dates(table: Table, column: str) -> Integers:
    """Nanoseconds since 1970, UTC."""
    stamps = np.empty(len(table), np.int64)
    for first, cells in table.pieces(column):
        part = stamps[first : first + len(cells)]
        try:
            part[:] = _iso(cells.spelled())
        except ValueError:
            for k, cell in enumerate(cells):
                found = _date(cell)
                if found is None:
                    what = (
                        f"must be a date and time such as 2026-11-28T12:00:00Z, got {cell!r:.60}."
                    )
                    raise table.error(first + k, column, what) from None
                part[k] = found
    return stamps


def _iso(spelled: Bytes) -> Integers:
    """Dates of ISO 8601 that all end alike, by numpy; ValueError for others."""
    widths = (spelled != 0).sum(axis=1)
    last = np.take_along_axis(spelled, (widths - 1)[:, None], 1)[:, 0]
    if (widths == widths[0]).all() and (np.isin(last, (ord("Z"), ord("z")))).all():
        spelled[:, widths[0] - 1] = 0
    spelled[spelled == ord(",")] = ord(".")
    spelled[spelled == ord("/")] = ord("-")
    tail = spelled[:, 11:]
    strange = np.isin(tail, (ord("+"), ord("-"), ord("Z"), ord("z"))).any()
    years = spelled[:, :4].copy().view("S4")[:, 0]
    if strange or (years < _YEARS[0].encode()).any() or (years > _YEARS[1].encode()).any():
        raise ValueError("offsets are read one by one")
    dates = np.ascontiguousarray(spelled).view(f"S{spelled.shape[1]}")[:, 0]
    stamps = dates.astype("datetime64[ns]")
    if np.isnat(stamps).any():
        raise ValueError("not a time")
    return stamps.astype(np.int64)


def _date(cell: str) -> int | None:
    """Nanoseconds since 1970 of a date with or without an offset; None if it is none."""
    found = _ISO.fullmatch(_DAY_FIRST.sub(r"\3-\2-\1\4", cell[:60]).replace("/", "-"))
    if found is None or not _YEARS[0] < found["year"] < _YEARS[1]:
        return None
    clock, fraction, offset = found["clock"] or "", found["fraction"] or "", found["offset"]
    try:
        date = dt.date(int(found["year"]), int(found["month"]), int(found["day"]))
        of_day = dt.time.fromisoformat(clock.zfill(len(clock) + (clock[1:2] == ":")) or "00:00")
        zone = dt.datetime.fromisoformat(f"2000-01-01T00:00{_written(offset)}").utcoffset()
    except ValueError:
        return None
    days = (date - dt.date(1970, 1, 1)).days
    seconds = days * 86_400 + of_day.hour * 3600 + of_day.minute * 60 + of_day.second
    seconds -= round((zone or dt.timedelta()).total_seconds())
    return seconds * 10**9 + int((fraction + "0" * 9)[:9])


def _written(offset: str | None) -> str:
    return "" if offset is None else "+00:00" if offset in ("Z", "z", "UTC") else offset
