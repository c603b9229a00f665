"""The columns of a log as measurements: units, words for nothing, held values, degrees to metres."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navgym.auv.fields import GEOGRAPHIC, SENSORS, Field, means
from navgym.auv.geodesy import LIMITS, degrees_of, degrees_of_nmea, signed, to_plane
from navgym.auv.rows import sentinel
from navgym.core.checks import Array, one_of
from navgym.core.clocks import Times, date_of, read_times
from navgym.core.layout import LOST
from navgym.core.notes import Notes
from navgym.core.repeats import is_held, quantum, repeats
from navgym.core.tables import Table
from navgym.core.units import DEGREE

INFINITE = "inf"
HELD = ("auto", "lost", "keep")
SPELLED = 500  # cells of a column whose digits are counted
FINE_DEGREES = 5  # decimals: fewer are no position
STILL = 10  # rows: of fewer, nothing is said about degrees
NARROW = 0.1  # extent of a log that may be in degrees
WHOLE_STEPS = 10.0  # of times without a unit: from here they may be ms
SIGMAS = 1e-9, 1e9  # m, m/s: what is beyond, 0 among it, is no accuracy
FACTOR = 3.0  # by which distances may miss what velocities say


@dataclass(frozen=True, eq=False)
class Columns:
    """The columns of a log that hold something.

    Args:
        table: the file.
        fields: its columns by quantity.
        notes: told of what was found and done.
        missing: the user's words and numbers for a lost value.
    """

    table: Table
    fields: Mapping[str, Field]
    notes: Notes
    missing: Sequence[str | float]

    @property
    def file(self) -> str:
        """Name of the file."""
        return self.table.path.name

    def error(self, row: int, quantity: str, what: str) -> ValueError:
        """The error to raise about one cell."""
        return self.table.error(row, self.fields[quantity].column, what)

    # ---- times -------------------------------------------------------------------------------

    def times(self, scale: float | None) -> Times:
        """Times of the rows; see `navgym.core.clocks.read_times`."""
        table, field = self._dated()
        if scale is None and field is not None and field.unit is not None:
            scale = field.scale(self.file)
        column = "time" if field is None else field.column
        found = read_times(table, column, scale, "Say which it is with columns={'time': ...}.")
        if found.guessed:
            self.notes.doubt(
                f"{found.guessed}: time_scale= or units={{'time': ...}} says otherwise"
            )
        if found.nights:
            self.notes.say(f"the clock passed midnight {found.nights} times: days added")
        if found.start is not None:
            date = date_of(found.start, found.scale) if found.kind == "number" else None
            self.notes.say(
                f"times are s since the first row's, {found.start}{f' ({date})' if date else ''}"
            )
        return found

    def _dated(self) -> tuple[Table, Field | None]:
        """The table, with dates and clocks of two columns as one."""
        date, time = self.fields.get("date"), self.fields.get("time")
        if date is None or time is None:
            return self.table, time or date
        days, clocks = self.table.find(date.column), self.table.find(time.column)
        if ":" not in clocks[0] or "T" in clocks[0] or " " in clocks[0]:
            return self.table, time
        self.notes.say(f"columns {date.column!r} and {time.column!r} are the times together")
        joined = [f"{day} {clock}" for day, clock in zip(days, clocks, strict=True)]
        cells = {**self.table.cells, time.column: joined}
        table = Table(self.table.path, cells, self.table.lines, self.table.decimal)
        return table, time

    # ---- numbers -----------------------------------------------------------------------------

    def raw(self, quantity: str) -> Array:
        """Numbers of a column as they stand in the file, (T,), NaN where lost."""
        field = self.fields[quantity]
        words = {str(word).strip().lower() for word in self.missing} | LOST
        minutes = field.unit == "ddmm.mmmm"
        values = self.table.numbers(
            field.column,
            gaps=True,
            lost=frozenset(words),
            infinite=True,
            number=(signed if minutes else degrees_of) if quantity in GEOGRAPHIC else None,
        )
        endless = np.isinf(values)
        if endless.any():
            self.notes.say(f"{field.column!r}: {endless.sum()} infinite values are lost")
        for mark in self.missing:
            endless |= values == _number(mark)
        values[endless] = np.nan
        return degrees_of_nmea(values) if minutes else values

    def numbers(self, quantity: str) -> Array:
        """Numbers of a column in s, m, m/s or rad, (T,), NaN where lost."""
        return self.raw(quantity) * self._scale(quantity)

    def whole(self, quantity: str, remedy: str) -> Array:
        """The same, for a column that must have a number in every row."""
        values = self.table.numbers(self.fields[quantity].column, remedy=remedy)
        return values * self.fields[quantity].scale(self.file)

    def _scale(self, quantity: str) -> float:
        scale = self.fields[quantity].scale(self.file)
        return DEGREE if math.isnan(scale) else scale  # ddmm.mmmm

    # ---- sensors -----------------------------------------------------------------------------

    def sensor(self, names: Sequence[str], held: str) -> Array:
        """Columns of one sensor, (T, k), in m and m/s (latitude and longitude in rad), NaN where lost.

        Numbers that stand for none, and repeats of the last value, count as lost.
        """
        one_of("held", held, HELD)
        raw = np.stack([self.raw(name) for name in names], axis=-1)
        for name, values in zip(names, raw.T, strict=True):
            mark = sentinel(values)
            if mark is not None:
                self.notes.doubt(
                    f"{self.fields[name].column!r}: {(values == mark).sum()} values of {mark:g} are "
                    "taken for lost ones"
                )
                values[values == mark] = np.nan
        self._drop_held(raw, names, held)
        return raw * [self._scale(name) for name in names]

    def _drop_held(self, raw: Array, names: Sequence[str], held: str) -> None:
        repeated = repeats(raw)
        if held == "keep" or not repeated.any():
            return
        share = f"{repeated.sum() / max((~np.isnan(raw).any(axis=1)).sum(), 1):.0%}"
        what = f"{share} of the rows with {' and '.join(names)} repeat the values before them"
        digits = [max(self._quantum(n), quantum(x)) for n, x in zip(names, raw.T, strict=True)]
        decided = held == "lost" or is_held(raw, repeated, digits)
        if decided:
            self.notes.doubt(f"{what}: taken for held, not new, so lost; held='keep' keeps them")
            raw[repeated] = np.nan
        elif decided is None:
            self.notes.doubt(
                f"{what}: kept, since their last digits are coarse; if the receiver holds its last "
                "value, pass held='lost'"
            )

    def decimals(self, quantity: str) -> int:
        """Most digits after the point in the first cells of a column, zeros at the end left out."""
        cells = self.table.find(self.fields[quantity].column)[:SPELLED]
        mark = self.table.decimal
        tails = (cell.lower().partition("e")[0].partition(mark)[2] for cell in cells)
        found = (sum(letter.isdigit() for letter in tail.rstrip("0")) for tail in tails)
        return max(found, default=0)

    def _quantum(self, quantity: str) -> float:
        return float(10.0 ** -min(self.decimals(quantity), 300))

    def digit(self, quantity: str) -> float:
        """The step of which all values of a column are multiples, in s, m, m/s or rad; 0 for none."""
        own = max(self._quantum(quantity), quantum(self.raw(quantity)))
        return own * self._scale(quantity)

    def refuse_degrees(self, positions: Array) -> None:
        """ValueError where px and py, (T, 2), named in metres by nobody, must be degrees."""
        fields = [self.fields[name] for name in ("px", "py")]
        fine = min(self.decimals("px"), self.decimals("py")) >= FINE_DEGREES
        if not fine or any(field.unit for field in fields):
            return
        there = positions[~np.isnan(positions).any(axis=1)]
        if len(there) < STILL:
            return
        low, high = there.min(axis=0), there.max(axis=0)
        extent, size = high - low, np.maximum(np.abs(low), np.abs(high))
        near = 0.0 < extent.max() < NARROW and size.max() > 1.0
        if near and size[0] <= LIMITS["lat"] and size[1] <= LIMITS["lon"]:
            north, east = (field.column for field in fields)
            raise ValueError(
                f"{self.file}: {north!r} and {east!r} look like degrees ({there[0, 0]:.6f}, "
                f"{there[0, 1]:.6f}, all within {extent.max():.2g}): pass columns={{'lat': {north!r}, "
                f"'lon': {east!r}}}, or units={{'px': 'm', 'py': 'm'}} if they are metres."
            )

    # ---- latitude and longitude ----------------------------------------------------------------

    def plane(
        self, held: str, origin: tuple[float, float, float] | None
    ) -> tuple[Array, tuple[float, float, float]]:
        """Metres north, east and down, (T, 3), and the origin: latitude, longitude, height."""
        degrees = self.sensor(GEOGRAPHIC, held) / DEGREE
        self._drop_zeros(degrees)
        self._check_degrees(degrees)
        there = np.flatnonzero(~np.isnan(degrees).any(axis=1))
        if not len(there):
            raise ValueError(f"{self.file}: no row has both latitude and longitude.")
        height = self.numbers("height") if "height" in self.fields else None
        if origin is None:
            first = degrees[there[0]].tolist()
            up = 0.0 if height is None or np.isnan(height[there[0]]) else float(height[there[0]])
            origin = (first[0], first[1], up)
        found = np.full((len(degrees), 3), np.nan)
        heights = None if height is None else height[there]
        found[there] = to_plane(degrees[there, 0], degrees[there, 1], origin, heights)
        where = ", ".join(f"{value:.9g}" for value in origin)
        self.notes.say(f"latitude and longitude became metres north and east of ({where})")
        if np.abs(found[there, :2]).max() > 1e5:
            self.notes.doubt("the positions are up to more than 100 km from the origin, where a "
                             "plane is not the Earth: pass origin= nearer")  # fmt: skip
        return found, origin

    def _drop_zeros(self, degrees: Array) -> None:
        """(0, 0) is what a receiver writes without a fix: lost, a doubt where it had one before."""
        nowhere = (degrees == 0.0).all(axis=1)
        later = nowhere & np.maximum.accumulate(~nowhere & ~np.isnan(degrees).any(axis=1))
        degrees[nowhere] = np.nan
        if nowhere.sum() > later.sum():
            self.notes.say(
                f"{nowhere.sum() - later.sum()} rows before the first fix hold (0, 0): lost"
            )
        if later.any():
            lat, lon = (self.fields[name].column for name in GEOGRAPHIC)
            self.notes.doubt(
                f"{lat!r} and {lon!r}: {later.sum()} fixes at (0, 0) are taken for lost ones"
            )

    def truth_plane(self, origin: tuple[float, float, float]) -> Array:
        """True metres north and east from truth_lat and truth_lon, (T, 2)."""
        remedy = "Truth is needed in every row: fill it in, or remove the truth columns."
        lat, lon = (self.whole(f"truth_{name}", remedy) / DEGREE for name in GEOGRAPHIC)
        return to_plane(lat, lon, origin, None)[:, :2]

    def _check_degrees(self, degrees: Array) -> None:
        for j, name in enumerate(GEOGRAPHIC):
            wrong = np.abs(degrees[:, j]) > LIMITS[name]
            if wrong.any():
                k = int(np.argmax(wrong))
                what = (
                    f"must be within ±{LIMITS[name]:g}°, got {degrees[k, j]:g}. If it is in 1e-7 "
                    f"degrees or ddmm.mmmm, say so: units={{{name!r}: '1e-7deg'}}."
                )
                raise self.error(k, name, what)
        size = np.nanmax(np.abs(degrees), axis=0, initial=0.0)
        unnamed = all(self.fields[name].unit is None for name in GEOGRAPHIC)
        if unnamed and 0.0 < size[0] <= np.pi / 2 and size[1] <= np.pi:
            self.notes.doubt("latitude and longitude are small enough to be radians, and read as "
                             "degrees: units={'lat': 'deg', 'lon': 'deg'} or 'rad' decides")  # fmt: skip

    def say_degrees_for_metres(self) -> bool:
        """Whether px and py were named as columns of latitude and longitude, which is said."""
        pair = [self.fields.get(name) for name in ("px", "py")]
        named = [f is not None and f.unit is None for f in pair]
        meant = all(named) and all(
            f is not None and means(f.column, q) for f, q in zip(pair, GEOGRAPHIC, strict=True)
        )
        if meant:
            self.notes.doubt("px and py are columns of latitude and longitude: read as degrees")
        return meant

    # ---- accuracy ------------------------------------------------------------------------------

    def sigmas(self, measured: Sequence[str], floor: float) -> Array:
        """The receiver's own standard deviations, (T, m), NaN where it tells none."""
        found = np.full((len(self.table), len(measured)), np.nan)
        for j, name in enumerate(measured):
            sensor = next((s for s, names in SENSORS.items() if name in names), "")
            told = [q for q in (f"sigma_{name}", f"sigma_{sensor}") if q in self.fields]
            if told and not (told[0] == "sigma_position" and name == "pz"):
                values = self.numbers(told[0])
                low, high = SIGMAS
                values[~((values >= low) & (values <= high))] = np.nan
                found[:, j] = np.maximum(values, floor)
        return found


def doubt_unit(columns: Columns, times: Times, p: Array, v: Array) -> float:
    """Factor by which times without a named unit are too large, where velocities tell; else 1.

    Args:
        columns: of the log.
        times: of its rows.
        p: (T, k) positions, m.
        v: (T, k) velocities along the same axes, m/s.
    """
    index, notes = np.argsort(times.seconds, kind="stable"), columns.notes
    t, p, v = times.seconds[index], p[index], v[index]
    steps = np.diff(t)
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    if usual < WHOLE_STEPS or times.guessed or not (t == np.round(t)).all():
        return 1.0
    moved, told = np.abs(np.diff(p, axis=0)), np.abs(v[1:]) * steps[:, None]
    both = ~np.isnan(moved + told)
    if both.sum() > STILL and told[both].sum() > 0.0:
        ratio = moved[both].sum() / told[both].sum()
        for unit, name in ((1e-3, "ms"), (1e-6, "us"), (1e-9, "ns")):
            if unit / FACTOR < ratio < unit * FACTOR:
                notes.doubt(f"the times are taken for {name}, by what velocities say of distances: "
                            "time_scale= or units={'time': ...} decides")  # fmt: skip
                return unit
        if 1.0 / FACTOR < ratio < FACTOR:
            return 1.0
    notes.doubt(f"the usual step is {usual:g} s: if the times are ms, pass time_scale=1e-3, else "
                "time_scale=1 or units={'time': 's'}")  # fmt: skip
    return 1.0


def levered(p: Array, heading: Array, lever_arm: NDArray[np.float64]) -> Array:
    """Positions of the vehicle's centre, (T, 2), from those of a sensor at `lever_arm`.

    Args:
        p: (T, 2) m north and east, of the sensor.
        heading: (T,) rad from north to east; where NaN, the answer is.
        lever_arm: forward and right, m.
    """
    c, s = np.cos(heading), np.sin(heading)
    forward, right = lever_arm[:2]
    centre: Array = p - np.stack([c * forward - s * right, s * forward + c * right], axis=-1)
    return centre


def _number(mark: str | float) -> float:
    try:
        return float(mark)
    except ValueError:
        return math.nan
