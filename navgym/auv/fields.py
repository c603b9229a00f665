"""Which column of a log holds what: names, usual other names, units."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from navgym.core import units as U
from navgym.core.checks import one_of
from navgym.core.notes import Notes
from navgym.core.tables import Table

GEOGRAPHIC = ("lat", "lon")
SENSORS = {"position": ("px", "py", "pz"), "velocity": ("vx", "vy", "vz")}
ANNOTATIONS = ("regime", "process_scale", "measurement_scale")  # optional fields of Recording
_NORTH, _EAST, _DOWN = ("north", "n", "x"), ("east", "e", "y"), ("down", "d", "z")


def _positions(axis: Sequence[str]) -> set[str]:
    word, letter, plain = axis
    whats = ("pos", "position", "p", "local", "localposition", "poselocal", "posepositionlocal")
    mixed = {f"{w}{a}" for w in whats for a in axis} | {f"{a}{w}" for w in whats[:2] for a in axis}
    return mixed | {word, letter, plain, f"{word}ing"}


def _velocities(axis: Sequence[str]) -> set[str]:
    whats = ("v", "vel", "velocity", "speed", "twistlinear", "velocityned", "velned")
    mixed = {f"{w}{a}" for w in whats for a in axis}
    return mixed | {f"{a}{w}" for w in whats[1:4] for a in axis} | {f"{axis[2]}dot"}


def _sigmas(names: Sequence[str]) -> set[str]:
    before = ("sigma", "std", "sd", "stddev", "stdev")
    after = ("accuracy", "acc", "std", "sigma", "sd", "stddev")
    return {f"{b}{n}" for b in before for n in names} | {f"{n}{a}" for a in after for n in names}


# by quantity: names in lower case, letters and digits only
SYNONYMS: dict[str, set[str]] = {
    "time": {
        "time", "t", "timestamp", "stamp", "sec", "secs", "seconds", "datetime", "utc", "utctime",
        "timeutc", "gpstime", "gpst", "epoch", "unixtime", "headerstamp", "elapsed", "elapsedtime",
        "timesec", "times", "dateandtime", "timeofday", "tow", "unixtimestamp", "posixtime",
    },
    "date": {"date", "day", "utcdate", "dateutc"},
    "px": _positions(_NORTH) - {"d"}, "py": _positions(_EAST), "pz": {"pz", "posdown", "pdown"},
    "vx": _velocities(_NORTH), "vy": _velocities(_EAST), "vz": _velocities(_DOWN),
    "lat": {"lat", "latitude", "gpslat", "gpslatitude", "latdeg", "latrad"},
    "lon": {"lon", "lng", "long", "longitude", "gpslon", "gpslng", "gpslongitude"},
    "height": {
        "height", "alt", "altitude", "hgt", "ellipsoidheight", "gpsalt", "gpsaltitude", "elevation",
    },
    "depth": {"depth", "waterdepth", "pressuredepth"},
    "heading": {"heading", "hdg", "yaw", "psi", "trueheading", "headingtrue"},
    "sigma_px": _sigmas(("px", "n", "north", "x", "lat", "latitude", "northing")),
    "sigma_py": _sigmas(("py", "e", "east", "y", "lon", "longitude", "easting")),
    "sigma_vx": _sigmas(("vx", "vn", "velnorth", "veln", "velx")),
    "sigma_vy": _sigmas(("vy", "ve", "veleast", "vele", "vely")),
    "sigma_position": {
        *_sigmas(("position", "pos", "horizontal", "p")), "hacc", "haccuracy", "eph",
        "estimatedhorizontalaccuracy",
    },
    "sigma_velocity": {*_sigmas(("velocity", "vel", "speed", "v")), "sacc"} - {"vacc", "vstd"},
}  # fmt: skip
KINDS = {
    "time": "time", "lat": "angle", "lon": "angle", "heading": "angle", "height": "length",
    "depth": "length", "px": "length", "py": "length", "pz": "length", "position": "length",
    "vx": "speed", "vy": "speed", "vz": "speed", "velocity": "speed",
}  # fmt: skip
SCALES = {"time": 1.0, "length": 1.0, "speed": 1.0, "angle": U.DEGREE}  # where no unit is named


@dataclass(frozen=True)
class Field:
    """A column that holds a quantity.

    Args:
        quantity: such as "px".
        column: its name in the file.
        unit: as its name, the row below or the user told it; None where nobody did.
        chosen: whether the user named the column.
    """

    quantity: str
    column: str
    unit: str | None
    chosen: bool

    @property
    def kind(self) -> str | None:
        """Of its units, a key of `navgym.core.units.SIZES`; None for numbers without a unit."""
        return KINDS.get(re.sub(r"^(truth|sigma)_", "", self.quantity))

    def scale(self, file: str) -> float:
        """What one unit of the column is in s, m, m/s or rad; ValueError naming a strange unit."""
        if self.kind is None:
            return 1.0
        if self.unit is None:
            return SCALES[self.kind]
        try:
            return U.size(self.unit, self.kind)
        except ValueError as error:
            raise ValueError(
                f"{file}, column {self.column!r}, taken for {self.quantity}: {error} Say it with "
                f"units={{{self.quantity!r}: ...}}."
            ) from None


def assign(
    table: Table,
    quantities: Sequence[str],
    columns: Mapping[str, str],
    units: Mapping[str, str],
) -> dict[str, Field]:
    """Columns that hold `quantities`, by quantity.

    A column goes by the user's word, else by a quantity's own name, else by the names of
    `SYNONYMS`.

    Args:
        table: the file.
        quantities: what may be in it.
        columns: the user's word: column by quantity.
        units: unit by quantity or by column.

    Raises ValueError for a column that does not exist, and where two columns could be meant.
    """
    file = table.path.name
    for quantity in columns:
        one_of("name in columns:", quantity, quantities)
    for name in units:
        one_of("name in units:", name, (*quantities, *table.cells))
    taken = {c: q for q, c in columns.items() if table.find(c) is not None}
    found = {}
    for quantity in quantities:
        free = [name for name in table.cells if name not in taken]
        column = columns.get(quantity) or _named(file, quantity, free)
        if column is not None:
            unit = units.get(quantity, units.get(column, _unit(table, column)))
            found[quantity] = Field(quantity, column, unit, quantity in columns)
    _settle(file, found)
    return found


def means(column: str, quantity: str) -> bool:
    """Whether a column's name is one of the names of a quantity."""
    return bool(_words(column) & SYNONYMS.get(quantity, {_plain(quantity)}))


def refuse_strangers(
    table: Table, found: Mapping[str, Field], known: Sequence[str], extra: str, notes: Notes
) -> None:
    """Deal with columns that hold nothing known, as `extra` says.

    Raises ValueError for any, or (but for "ignore") for one whose name is nearly one that counts.
    """
    used = {field.column for field in found.values()}
    strangers = [name for name in table.cells if name not in used]
    if extra == "ignore" or not strangers:
        return
    for name in strangers:
        near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.8)
        typed = near and re.match(r"(?i)(truth|lost|sigma|process|measure)", name)
        if extra == "raise" or typed:
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise ValueError(
                f"unknown column of {table.path.name}: {name!r}.{hint} Known: {', '.join(known)}. "
                f"Say what it holds with columns={{'px': {name!r}}} or the like, or leave such "
                "columns out with extra='ignore'."
            )
    notes.say(f"left out, of no use here: {', '.join(map(repr, strangers))}")


def _unit(table: Table, column: str) -> str | None:
    named = U.split(column)[1]
    below = U.plain((table.units or {}).get(column, ""))
    return named or (below if below not in U.NO_UNITS else None)


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


@lru_cache(maxsize=1 << 12)
def _words(column: str) -> frozenset[str]:
    """A column's name in letters and digits, with and without what stands before its last dot."""
    base = U.split(column)[0]
    last = re.split(r"[./:]", base.strip("./: "))[-1]
    return frozenset(_plain(word) for word in (column, base, last)) - {""}


def _named(file: str, quantity: str, free: Sequence[str]) -> str | None:
    """The column among `free` that bears a quantity's name; ValueError where two do."""
    if quantity in free:
        return quantity
    own = [name for name in free if _plain(quantity) in _words(name)]
    others = [name for name in free if means(name, quantity)]
    for names in (own, own or others):
        if len(names) > 1:
            raise ValueError(
                f"{file}: {' and '.join(map(repr, names))} could each be {quantity}: say which "
                f"it is with columns={{{quantity!r}: {names[0]!r}}}."
            )
    return next(iter(own or others), None)


def _settle(file: str, found: dict[str, Field]) -> None:
    """Where positions stand in metres and in degrees, keep those that were named outright."""
    pairs = [tuple(found[q] for q in pair if q in found) for pair in (("px", "py"), GEOGRAPHIC)]
    flat, round_ = pairs
    if not flat or len(round_) < 2:
        for name in GEOGRAPHIC if flat else ():
            found.pop(name, None)
        return
    chosen = [any(field.chosen for field in pair) for pair in (flat, round_)]
    exact = all(field.column == field.quantity for field in flat)
    if chosen[0] == chosen[1] and not exact:
        raise ValueError(
            f"{file}: {' and '.join(repr(f.column) for f in (*flat, *round_))} all hold a position: "
            f"say which counts, with columns={{'px': {flat[0].column!r}, ...}} or "
            f"columns={{'lat': {round_[0].column!r}, ...}}."
        )
    for field in flat if chosen[1] and not chosen[0] else round_:
        del found[field.quantity]
