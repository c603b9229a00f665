"""Units in the names of columns, and what one of them is in m, s, rad and their quotients."""

from __future__ import annotations

import math
import re

DEGREE = math.pi / 180.0
SIZES: dict[str, dict[str, float]] = {
    "time": {
        "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0,
        "ms": 1e-3, "msec": 1e-3, "msecs": 1e-3, "millisecond": 1e-3, "milliseconds": 1e-3,
        "us": 1e-6, "usec": 1e-6, "microsecond": 1e-6, "microseconds": 1e-6,
        "ns": 1e-9, "nsec": 1e-9, "nanosecond": 1e-9, "nanoseconds": 1e-9,
        "min": 60.0, "minute": 60.0, "minutes": 60.0, "h": 3600.0, "hr": 3600.0, "hour": 3600.0,
        "hours": 3600.0,
    },
    "length": {
        "m": 1.0, "meter": 1.0, "meters": 1.0, "metre": 1.0, "metres": 1.0, "km": 1e3,
        "cm": 1e-2, "mm": 1e-3, "ft": 0.3048, "feet": 0.3048, "foot": 0.3048, "nmi": 1852.0,
    },
    "speed": {
        "m/s": 1.0, "mps": 1.0, "m/sec": 1.0, "ms-1": 1.0, "ms^-1": 1.0, "cm/s": 1e-2,
        "mm/s": 1e-3, "km/h": 1 / 3.6, "kmh": 1 / 3.6, "kph": 1 / 3.6, "km/hr": 1 / 3.6,
        "kn": 1852 / 3600, "kt": 1852 / 3600, "kts": 1852 / 3600, "knot": 1852 / 3600,
        "knots": 1852 / 3600, "ft/s": 0.3048, "fps": 0.3048,
    },
    "angle": {
        "rad": 1.0, "rads": 1.0, "radian": 1.0, "radians": 1.0, "deg": DEGREE, "degs": DEGREE,
        "degree": DEGREE, "degrees": DEGREE, "°": DEGREE, "dd": DEGREE, "1e-7deg": 1e-7 * DEGREE,
        "dege7": 1e-7 * DEGREE, "ddmm.mmmm": math.nan,  # degrees and minutes in one number
    },
}  # fmt: skip
# in brackets, but no unit: clocks, frames, formats
NO_UNITS = {
    "", "-", "1", "utc", "gps", "gpst", "tai", "local", "iso", "iso8601", "iso-8601", "unix",
    "epoch", "posix", "wgs84", "wgs-84", "ned", "enu", "north", "east", "n", "e", "std", "1sigma",
    "hh:mm:ss", "hh:mm:ss.sss", "yyyy-mm-dd", "datetime",
}  # fmt: skip
_KNOWN = {name for sizes in SIZES.values() for name in sizes}
_BRACKETS = re.compile(r"^(.*?)\s*[\[({<]\s*([^\[\](){}<>]*?)\s*[\])}>]\s*$")
# without brackets, a unit of one letter or two must stand after an underscore, a slash or a blank
_SUFFIX = re.compile(r"^(.+?)[_\s/,]+(\S+?)$")


def plain(unit: str) -> str:
    """`unit` as the table above has it: "µs" is "us", "M / s" is "m/s", "[m]" is "m"."""
    word = unit.strip().strip("[](){}<>").lower().replace("μ", "u").replace("µ", "u")
    return re.sub(r"[\s*·]", "", word).replace("º", "°")


def is_unit(text: str) -> bool:
    """Whether a cell is a unit that is known, in brackets or not."""
    return plain(text) in _KNOWN


def split(name: str) -> tuple[str, str | None]:
    """A column's name without its unit, and that unit, or None: "vx_m/s" is ("vx", "m/s")."""
    bracketed = _BRACKETS.match(name)
    if bracketed and bracketed[1]:
        unit = plain(bracketed[2])
        return bracketed[1], None if unit in NO_UNITS else unit
    for pattern in (_SUFFIX, re.compile(r"^(.+?)[_\s]+(\S+/\S+)$")):
        found = pattern.match(name)
        if found and is_unit(found[2]):
            base = re.match(r"^(.+?)[_\s,]+(\S+)$", found[1])
            both = f"{base[2]}/{found[2]}" if base else ""
            if base and is_unit(both):  # vx_m/s: the slash is the unit's
                return base[1], plain(both)
            return found[1], plain(found[2])
    return name, None


def size(unit: str, kind: str) -> float:
    """What one `unit` of `kind` (a key of `SIZES`) is in m, s, rad; ValueError naming the unit."""
    word = plain(unit)
    if word not in SIZES[kind]:
        known = ", ".join(SIZES[kind])
        raise ValueError(f"unit {unit!r} is not one of {kind}. Known: {known}.")
    return SIZES[kind][word]
