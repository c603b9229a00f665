"""Rows of a log: in the order of their times, one for each, repeated values found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.notes import Notes

Flags = NDArray[np.bool_]

FEW = 5  # late rows one after the other: from here a clock was set back, below a row came late
JUMP = 3.0  # nine-tenths quantiles of a column's steps: from here it does not go on
MANY = 20  # steps that make one of them usual
EVEN = 0.2  # share of the usual step by which those about a clock that was set may miss it
COARSE = 1.5, 20  # rows per time, and conflicts: from here stamps are too coarse
SHORTEST = 1e-12  # s between rows: less is rounding, or a wrong unit
LONGEST_GAP = 30 * 86_400.0  # s: no voyage pauses longer, so the clock was set
LONG_GAP = 3_600.0, 1_000.0  # s and usual steps: from here a gap is worth a word
SENTINELS = (-9999.0, -999.0, -99999.0, -999999.0, 9999.0, 99999.0, 999999.0, -32768.0, 32767.0)
FAR = 10.0, 100.0  # extents of the other values, and units, between a sentinel and them


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of a log.

    Args:
        time: (T,) s.
        lines: (T,) of the file.
        y: (T, m) measurements, NaN where lost.
        sigma: (T, m) the receiver's own standard deviations, NaN where it tells none.
        truth: (T, n) or None.
        labels: (T,) further columns, by name.
    """

    time: Array
    lines: NDArray[np.int64]
    y: Array
    sigma: Array
    truth: Array | None
    labels: Mapping[str, Array]

    def __len__(self) -> int:
        return len(self.time)

    def take(self, index: NDArray[np.int64]) -> Rows:
        """Rows `index`."""
        return Rows(
            self.time[index], self.lines[index], self.y[index], self.sigma[index],
            None if self.truth is None else self.truth[index],
            {name: values[index] for name, values in self.labels.items()},
        )  # fmt: skip


def order(rows: Rows, sort: bool | None, notes: Notes) -> NDArray[np.int64]:
    """Index that sorts rows by time, those of one time as they stand in the file.

    Args:
        rows: as in the file.
        sort: see `navgym.auv.csv_log.read_csv`.
        notes: told of what was sorted.

    Raises ValueError, naming the line, where a clock was set, unless `sort` is True.
    """
    time, lines = rows.time, rows.lines
    steps = np.diff(time)
    falls = np.flatnonzero(steps < 0.0)
    index = np.argsort(time, kind="stable")
    if len(falls) and sort is not True:
        k = set_back(rows)
        if sort is False or k is not None:
            k = int(falls[np.argmin(steps[falls])]) + 1 if k is None else k
            remedy = "cut the file there, or pass sort=True, which sorts all rows by their times."
            if sort is None and _moves_on(rows.y, k):
                remedy = "the values go on over it: cut the file there, or mend the later times."
            raise ValueError(
                f"{notes.file}, line {lines[k]}, column 'time': {_fall(time, k)}, as where a clock is "
                f"set or another voyage begins: {remedy}"
            )
    if len(falls):
        worst = -float(steps[falls].min())
        told = f"rows sorted by time ({len(falls)} times one came late, by up to {worst:.6g} s)"
        (notes.doubt if worst > 60.0 else notes.say)(told)
    _check_gaps(time[index], lines[index], sort, notes)
    return index


def _fall(time: Array, k: int) -> str:
    top = float(time[:k].max())
    return f"the time goes back by {top - time[k]:.6g} s, from {top:.6g} s to {time[k]:.6g} s"


def _moves_on(y: Array, k: int) -> bool:
    """Whether each column of y, (T, m), goes on from row k - 1 to row k as between other rows."""
    for column in y.T:
        before, after = (part[~np.isnan(part)] for part in (column[:k], column[k:]))
        if len(before) < FEW or len(after) < FEW:
            return False
        steps = np.abs(np.concatenate([np.diff(before), np.diff(after)]))
        if abs(after[0] - before[-1]) > JUMP * float(np.quantile(steps, 0.9)):
            return False
    return True


def clock_set(rows: Rows) -> str:
    """Line and fall where a clock was set back, in words; "" where none was."""
    k = set_back(rows)
    return "" if k is None else f"line {rows.lines[k]}, column 'time': {_fall(rows.time, k)}"


def set_back(rows: Rows) -> int | None:
    """The row from which on times are those of a clock that was set back; None where rows came late."""
    steps = np.diff(rows.time)
    falls = np.flatnonzero(steps < 0.0)
    if not len(falls):
        return None
    late = int((rows.time < np.maximum.accumulate(rows.time)).sum())
    if late >= FEW and late >= 3 * len(falls):
        return int(falls[np.argmin(steps[falls])]) + 1
    found = (each[k] for each in _by_sensor(rows) for k in _short_falls(rows.take(each)))
    return next((int(k) for k in found), None)


def _by_sensor(rows: Rows) -> list[NDArray[np.intp]]:
    """All rows, and where those of several sensors stand between each other, each one's."""
    kinds, of = np.unique(~np.isnan(rows.y), axis=0, return_inverse=True)
    mine = [np.flatnonzero(of.ravel() == j) for j, there in enumerate(kinds) if there.any()]
    return [np.arange(len(rows)), *(mine if len(mine) > 1 else [])]


def _short_falls(rows: Rows) -> list[int]:
    """Rows before which a clock was set back by a few steps."""
    steps = np.diff(rows.time)
    falls = np.flatnonzero(steps < 0.0) + 1
    if not len(falls) or len(falls) > FEW or len(steps) < MANY:
        return []
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    return [int(k) for k in falls if _runs_on(rows, int(k), usual)]


def _runs_on(rows: Rows, k: int, usual: float) -> bool:
    """Whether after the fall before row k times run on past the old ones without a missing row.

    A row that came late is missing where it belongs. Rows that were written twice repeat values.
    """
    time, old = rows.time, rows.time[k - 1]
    first = int(np.searchsorted(time[:k], time[k]))  # where the rows from k on would belong
    beyond = k + int(np.searchsorted(time[k:], old, side="right"))
    if old - time[k] < 0.5 * usual or first < 1 or beyond >= len(time):
        return False
    around = np.concatenate([np.diff(time[first - 1 : k]), np.diff(time[k : beyond + 1])])
    if (np.abs(around - usual) > EVEN * usual).any():
        return False
    _, here, there = np.intersect1d(time[k:beyond], time[first:k], return_indices=True)
    again = (rows.y[k:beyond][here] == rows.y[first:k][there]).any(axis=1)
    return not (len(again) and again.all())


def _check_gaps(time: Array, lines: NDArray[np.int64], sort: bool | None, notes: Notes) -> None:
    steps = np.diff(time)
    if not (steps > 0.0).any():
        return
    short = np.flatnonzero((steps > 0.0) & (steps < SHORTEST))
    if len(short):
        k = int(short[0]) + 1
        raise ValueError(
            f"{notes.file}, line {lines[k]}, column 'time': only {steps[k - 1]:.3g} s after another "
            "row: check the unit of the times, units={'time': ...}."
        )
    usual, k = float(np.median(steps[steps > 0.0])), int(np.argmax(steps))
    gap = float(steps[k])
    if gap > LONGEST_GAP and gap > LONG_GAP[1] * usual and sort is not True:
        raise ValueError(
            f"{notes.file}, line {lines[k + 1]}, column 'time': {gap:.6g} s ({gap / 86_400:.0f} "
            "days) after the row before, as where a clock is set: cut the file there, or pass "
            "sort=True to keep the gap."
        )
    if gap > LONG_GAP[0] and gap > LONG_GAP[1] * usual:
        notes.doubt(
            f"a gap of {gap / 3600:.3g} h before line {lines[k + 1]}: if a clock was set there, cut "
            "the file"
        )


# ---- values that stand for none ------------------------------------------------------------------


def sentinel(values: Array) -> float | None:
    """The number that stands for a lost value in `values` (T,): a usual one, far from all others."""
    there = values[~np.isnan(values)]
    ends = {float(there.min()), float(there.max())} if len(there) else set()
    for mark in ends.intersection(SENTINELS):
        others = there[(there != mark) & ~np.isin(there, SENTINELS)]
        if len(others) < len(there) and len(others) > 1:
            low, high = float(others.min()), float(others.max())
            away = max(low - mark, mark - high)
            if away > max(FAR[0] * (high - low), FAR[1]):
                return mark
    return None


# ---- one row for each time -----------------------------------------------------------------------


def delayed(rows: Rows, late: Array) -> Rows:
    """Rows with column j of y at its time less `late[j]` s; rows of other columns have none of it.

    Truth is interpolated, and rows before its first or after its last are left out.
    """
    parts = []
    for lag in np.unique(late):
        y = np.where(late == lag, rows.y, np.nan)
        # rows without any measurement stay, once
        index = np.flatnonzero((lag == late.min()) | ~np.isnan(y).all(axis=1))
        sigma = np.where(late == lag, rows.sigma, np.nan)
        moved = replace(rows, time=np.round(rows.time - lag, 9), y=y, sigma=sigma)
        parts.append(moved.take(index))
    joined = Rows(
        np.concatenate([p.time for p in parts]),
        np.concatenate([p.lines for p in parts]),
        np.concatenate([p.y for p in parts]),
        np.concatenate([p.sigma for p in parts]),
        None,  # below
        {n: np.concatenate([p.labels[n] for p in parts]) for n in rows.labels},
    )
    joined = joined.take(np.argsort(joined.time, kind="stable"))
    if rows.truth is None:
        return joined
    inside = (joined.time >= rows.time[0]) & (joined.time <= rows.time[-1])
    joined = joined.take(np.flatnonzero(inside))
    truth = [np.interp(joined.time, rows.time, column) for column in rows.truth.T]
    return replace(joined, truth=np.stack(truth, axis=-1))


def merged(rows: Rows, notes: Notes, clock: str = "") -> Rows:
    """One row for each time: what its rows hold together; where they differ, the mean.

    Args:
        rows: in the order of their times.
        notes: told of what was merged.
        clock: where a clock was set back, in words, "" where none was.

    Raises ValueError, naming lines, where truths differ, or so many values that stamps are coarse.
    """
    first = np.flatnonzero(np.diff(rows.time, prepend=-np.inf) > 0.0)
    if len(first) == len(rows):
        return rows
    counts = np.diff(np.append(first, len(rows)))
    y, several, differ = _joined(rows.y, first)
    sigma, *_ = _joined(rows.sigma, first)
    if rows.truth is not None:
        truth = rows.truth[first]
        wrong = (np.repeat(truth, counts, axis=0) != rows.truth).any(axis=1)
        if wrong.any():
            line = rows.lines[int(np.argmax(wrong))]
            raise ValueError(
                f"{notes.file}, line {line}: another truth at the time of a row before."
            )
    clash = np.asarray(differ.any(axis=1))
    _tell(rows, first, counts, np.asarray(several.any(axis=1)), clash, notes, clock)
    return replace(rows.take(first), y=y, sigma=sigma)


def _tell(
    rows: Rows, first: NDArray[np.int64], counts: NDArray[np.int64], several: Flags, clash: Flags,
    notes: Notes, clock: str,
) -> None:  # fmt: skip
    shared = counts > 1
    if clash.any():
        k = int(np.argmax(clash))
        where = f"lines {rows.lines[first[k]]} and {rows.lines[first[k] + counts[k] - 1]}"
        if len(rows) > COARSE[0] * len(first) and clash.sum() > COARSE[1]:
            if clock:
                raise ValueError(
                    f"{notes.file}, {clock}: a clock was set there, and sorting mixes {clash.sum()} "
                    "moments of before with others of after: cut the file there."
                )
            raise ValueError(
                f"{notes.file}, {where}: {clash.sum()} times stand in several rows with different "
                "values: name a column with finer times as columns={'time': ...}."
            )
        notes.doubt(f"{clash.sum()} times stand in rows with different values, first {where}: "
                    "their means are taken")  # fmt: skip
    same = int((shared & several & ~clash).sum())
    if same:
        notes.say(f"{same} times stand in rows that repeat each other: one of them is kept")
    parts = int((shared & ~several).sum())
    if parts:
        notes.say(f"{parts} times stand in several rows with different columns: merged")


def _joined(values: Array, first: NDArray[np.int64]) -> tuple[Array, Flags, Flags]:
    """Means over groups of rows of what is not NaN, where several are, and where those differ."""
    there = ~np.isnan(values)
    count = np.add.reduceat(there.astype(np.int64), first, axis=0)
    low = np.minimum.reduceat(np.where(there, values, np.inf), first, axis=0)
    high = np.maximum.reduceat(np.where(there, values, -np.inf), first, axis=0)
    total = np.add.reduceat(np.where(there, values, 0.0), first, axis=0)
    differ = (count > 1) & (low != high)
    mean = np.where(differ, total / np.maximum(count, 1), low)
    return np.where(count > 0, mean, np.nan), count > 1, differ
