"""The columns of a deck's log: what they are called, in which unit, and their numbers in SI units."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from navgym.core import units as U
from navgym.core.checks import Array, one_of
from navgym.core.clocks import Times, date_of, read_times
from navgym.core.layout import LOST
from navgym.core.notes import Notes
from navgym.core.tables import Table
from navgym.inertial.earth import GRAVITY
from navgym.inertial.imu import DEGREE_PER_HOUR

UNITS = ("main", "sub", "ref1", "ref2")
QUATERNION = ("qx", "qy", "qz", "qw")
FIX = {"latitude": 90.0, "longitude": 180.0}  # largest magnitudes, °


def names_of(unit: str, sensor: str) -> list[str]:
    """The three columns of a sensor."""
    return [f"{unit}_{sensor}_{axis}" for axis in "xyz"]


IMU_COLUMNS = tuple(
    n for unit in UNITS for sensor in ("gyro", "acc") for n in names_of(unit, sensor)
)
COLUMNS = ("time", *IMU_COLUMNS, *QUATERNION, *FIX)

DEGREE = U.DEGREE
GYRO_UNITS: Mapping[str, float] = {
    "deg/h": DEGREE_PER_HOUR,
    "deg/s": float(DEGREE),
    "rad/s": 1.0,
}
# by what a unit measures: rad/s, m/s², rad
SIZES: Mapping[str, Mapping[str, float]] = {
    "gyro": {**GYRO_UNITS, "deg/hr": DEGREE_PER_HOUR, "dph": DEGREE_PER_HOUR, "°/h": DEGREE_PER_HOUR,
             "°/hr": DEGREE_PER_HOUR, "°/s": DEGREE, "dps": DEGREE, "deg/sec": DEGREE,
             "rad/sec": 1.0, "mrad/s": 1e-3, "rad/h": 1.0 / 3600.0},
    "acc": {"m/s2": 1.0, "m/s^2": 1.0, "m/s²": 1.0, "m/s/s": 1.0, "m/sec2": 1.0, "ms-2": 1.0,
            "g": GRAVITY, "mg": 1e-3 * GRAVITY, "ft/s2": 0.3048, "ft/s^2": 0.3048},
    "fix": U.SIZES["angle"],
    "time": U.SIZES["time"],
}  # fmt: skip
_SPELLINGS = (
    (r"[^a-z0-9]+", "_"), (r"gyro(scope)?s?|omega|(?<![a-z])rate", "gyro"),
    (r"accel(eration|erometer)?s?|(?<![a-z])force", "acc"), (r"reference_?", "ref"),
    (r"^lat$", "latitude"), (r"^lon(g)?$", "longitude"), (r"^(t|timestamp|times)$", "time"),
    (r"^_|_$", ""),
)  # fmt: skip
MOST = {"gyro": 100.0, "acc": 1000.0}  # rad/s, m/s²: more is a sentinel, or another unit
LATEST = 1e14  # s: three million years
RARE, FEW = 0.05, 2  # share of values that may be faults; different values that are sentinels


class Column(NamedTuple):
    """A column of the file: its name there, and its unit if it tells one."""

    name: str
    unit: str | None


@dataclass(frozen=True, eq=False)
class Columns:
    """The columns of a log that hold something.

    Args:
        table: the file.
        found: its columns by quantity.
        gyro_unit: of gyros that tell none.
        missing: words, in lower case, that stand for a lost value.
        most: rad/s of "gyro" and m/s² of "acc" that can be; more is refused.
        notes: told of what was found and done.
    """

    table: Table
    found: Mapping[str, Column]
    gyro_unit: str
    missing: frozenset[str]
    notes: Notes
    most: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        table: Table,
        columns: Mapping[str, str],
        units: Mapping[str, str],
        gyro_unit: str,
        missing: Sequence[str | float],
        extra: str,
        notes: Notes,
    ) -> Columns:
        """Find the columns, by what the user says, else by their names.

        Raises ValueError for columns that are not there, two that could be meant, groups that are
        not whole, and, as `extra` says, for columns of unknown meaning.
        """
        for name in columns:
            one_of("name in columns:", name, COLUMNS)
        for name in units:
            one_of("name in units:", name, (*COLUMNS, *table.cells))
        found = _found(table, columns, units)
        _refuse_parts(table, found)
        strangers = [n for n in table.cells if n not in {c.name for c in found.values()}]
        if strangers and extra == "raise":
            _refuse(table, strangers[0])
        if strangers and extra == "say":
            notes.say(f"left out, of no use here: {', '.join(map(repr, strangers))}")
        words = frozenset(str(word).strip().lower() for word in missing)
        return cls(table, found, gyro_unit, LOST | words, notes)

    def __contains__(self, quantity: str) -> bool:
        return quantity in self.found

    def error(self, row: int, quantity: str, what: str) -> ValueError:
        """The error to raise about one cell."""
        return self.table.error(row, self.found[quantity].name, what)

    def size(self, quantity: str) -> float:
        """What one unit of a column is in SI units."""
        kind = "fix" if quantity in FIX else "gyro" if "_gyro_" in quantity else "acc"
        if quantity == "time":
            kind = "time"
        usual = {"fix": "deg", "gyro": self.gyro_unit, "acc": "m/s2", "time": "s"}[kind]
        column = self.found[quantity]
        unit = U.plain(column.unit or usual)
        place = f"unit of {self.table.path.name}, column {column.name!r}:"
        return SIZES[kind][one_of(place, unit, SIZES[kind])]

    def numbers(self, quantity: str, gaps: bool, remedy: str = "") -> Array:
        """A column in the file's own unit, (T,)."""
        name = self.found[quantity].name
        values = self.table.numbers(name, gaps, remedy, lost=self.missing, infinite=True)
        for word in self.missing if gaps else ():
            try:  # -9999 is also -9999.0
                values[values == float(word)] = np.nan
            except ValueError:
                continue
        if np.isinf(values).any():
            k = int(np.argmax(np.isinf(values)))
            wanted = "a finite number" + (", or nothing where lost" if gaps else "")
            raise self.error(k, quantity, f"must be {wanted}, got {values[k]}. {remedy}")
        return values

    def measured(self, quantity: str, gaps: bool) -> Array:
        """A gyro's or accelerometer's column in SI units, unless it holds what cannot be."""
        values = self.numbers(quantity, gaps)
        scaled = values * self.size(quantity)
        sensor = "gyro" if "_gyro_" in quantity else "acc"
        large = np.abs(scaled)
        wild = large > self.most.get(sensor, np.inf)
        # where many different values are as large, it is the unit, which the recording checks
        if wild.any() and (wild.mean() < RARE or len(np.unique(values[wild])) <= FEW):
            k = int(np.nanargmax(large))
            unit, limit = ("rad/s", "gyro") if sensor == "gyro" else ("m/s²", "force")
            what = (
                f"{values[k]:g} is {large[k]:.3g} {unit}, which no ship's IMU measures: leave such "
                f"cells empty, name them with missing=, or pass {limit}_limit= or check_units=False."
            )
            raise self.error(k, quantity, what)
        return scaled

    def times(self, scale: float | None) -> Times:
        """Times of the rows, s."""
        if "time" not in self:
            self.table.find("time", "Say which it is with columns={'time': ...}.")
        if scale is None and self.found["time"].unit is not None:
            scale = self.size("time")
        found = read_times(self.table, self.found["time"].name, scale)
        wild = np.abs(found.seconds) > LATEST
        if wild.any():
            k = int(np.argmax(wild))
            raise self.error(k, "time", f"{found.seconds[k]:g} s is no time: repair the row.")
        if found.guessed:
            self.notes.doubt(f"{found.guessed}: time_scale= or units= says otherwise")
        if found.nights:
            self.notes.say(f"the clock passed midnight {found.nights} times: days added")
        if found.start is not None:
            date = date_of(found.start, found.scale) if found.kind == "number" else None
            self.notes.say(
                f"times are s since the first row's, {found.start}{f' ({date})' if date else ''}"
            )
        return found

    def fix(self) -> dict[str, float]:
        """Mean latitude and longitude, °, of the rows that have a fix."""
        means = {}
        for name, limit in FIX.items():
            if name in self:
                values = self.numbers(name, gaps=True) * (self.size(name) / DEGREE)
                wrong = np.abs(values) > limit
                if wrong.any():
                    k = int(np.argmax(wrong))
                    raise self.error(k, name, f"must be in degrees, ±{limit:g}, got {values[k]:g}.")
                if not np.isnan(values).all():
                    means[name] = float(np.nanmean(values))
        return means


def plain(name: str) -> str:
    """A column's name as navgym spells it: "Main Accel X" is "main_acc_x"."""
    word = name.strip().lower()
    for pattern, spelled in _SPELLINGS:
        word = re.sub(pattern, spelled, word)
    return word


def _found(table: Table, columns: Mapping[str, str], units: Mapping[str, str]) -> dict[str, Column]:
    """Columns by quantity: as told, then by their own names, then by names that mean the same."""
    chosen = {quantity: name for quantity, name in columns.items() if table.find(name)}
    taken = set(chosen.values())
    for alike in (lambda name: name, lambda name: plain(U.split(name)[0])):
        here: dict[str, list[str]] = {}
        for name in table.cells:
            quantity = alike(name)
            if name not in taken and quantity in COLUMNS and quantity not in chosen:
                here.setdefault(quantity, []).append(name)
        for quantity, names in here.items():
            if len(names) > 1:
                raise ValueError(
                    f"{table.path.name} has several columns that may be {quantity}: "
                    f"{', '.join(map(repr, names))}. Say which with columns={{{quantity!r}: ...}}."
                )
            chosen[quantity] = names[0]
        taken = set(chosen.values())
    return {q: Column(n, units.get(q, units.get(n, _unit(table, n)))) for q, n in chosen.items()}


def _unit(table: Table, name: str) -> str | None:
    """The unit that a column's name, or a row below it, tells."""
    named = U.split(name)[1]
    below = U.plain((table.units or {}).get(name, ""))
    return named or (below if below not in U.NO_UNITS else None)


def _refuse_parts(table: Table, found: Mapping[str, Column]) -> None:
    """ValueError for IMUs that are missing, and for groups of columns that are not whole."""
    groups = [[n for n in IMU_COLUMNS if n.startswith(unit)] for unit in UNITS]
    for needed, group in zip(
        (True, True, False, False, False), [*groups, [*QUATERNION]], strict=True
    ):
        gone = [name for name in group if name not in found]
        if gone and (needed or len(gone) < len(group)):
            raise ValueError(
                f"{table.path.name} lacks {', '.join(gone)}: name the columns so, or say which "
                f"they are with columns={{{gone[0]!r}: ...}}. It holds: {', '.join(table.cells)}."
            )


def _refuse(table: Table, name: str) -> None:
    try:
        one_of(f"column of {table.path.name}:", name, COLUMNS)
    except ValueError as error:
        raise ValueError(
            f"{error} Say what it holds with columns={{'main_gyro_x': {name!r}}} or the like, or "
            "leave such columns out with extra='ignore'."
        ) from None
