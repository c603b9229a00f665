"""Latitude and longitude to metres north and east on a plane that touches the Earth, and back."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from navgym.core.checks import Array, real_array, within

if TYPE_CHECKING:
    from navgym.statespace.recording import Recording

LIMITS = {"lat": 90.0, "lon": 360.0}
TURNS = 4  # of the fixed point of the height over the plane
_ANGLE = re.compile(
    r"\s*(?P<sign>[-+]?)(?P<degrees>\d+(?:[.,]\d+)?)\s*(?:[°ºd:]\s*|\s+|(?=[NSEWnsew]))"
    r"(?:(?P<minutes>\d+(?:[.,]\d+)?)\s*(?:['′’m:]\s*|\s+|(?=[NSEWnsew])|$))?"
    r"(?:(?P<seconds>\d+(?:[.,]\d+)?)\s*(?:\"|″|''|”|s)?\s*)?"
    r"(?P<side>[NSEWnsew]?)\s*",
    re.ASCII,
)
_SIDED = re.compile(r"\s*(\d+(?:\.\d+)?)\s*([NSEWnsew])\s*", re.ASCII)


def to_plane(
    latitude: ArrayLike, longitude: ArrayLike, origin: Sequence[float], height: ArrayLike | None
) -> Array:
    """Metres north, east and down of `origin` on the plane that touches the ellipsoid there, (T, 3).

    Args:
        latitude: (T,) degrees, WGS-84.
        longitude: (T,) degrees.
        origin: latitude, longitude, degrees, and height, m.
        height: (T,) m over the ellipsoid; None or NaN: that of the origin.
    """
    import pymap3d

    up = np.full(np.shape(latitude), origin[2]) if height is None else np.asarray(height)
    up = np.where(np.isnan(up), origin[2], up)
    found = pymap3d.geodetic2ned(latitude, longitude, up, *origin)
    return np.stack([np.asarray(axis, dtype=np.float64) for axis in found], axis=-1)


def from_plane(north: ArrayLike, east: ArrayLike, origin: Sequence[float]) -> tuple[Array, Array]:
    """Latitude and longitude, degrees, of points at the origin's height; undoes `to_plane`."""
    import pymap3d

    n, e = real_array("north", north, finite=False), real_array("east", east, finite=False)
    down = np.zeros(np.shape(n))
    for _ in range(TURNS):
        latitude, longitude, height = pymap3d.ned2geodetic(n, e, down, *origin)
        down = down + (height - origin[2])
    return np.asarray(latitude), np.asarray(longitude)


def geographic(recording: Recording, states: ArrayLike) -> tuple[Array, Array]:
    """Latitude and longitude, degrees, of positions in the plane of a log that came in degrees.

    Args:
        recording: what `navgym.read("csv", ...)` gave; its `meta["origin"]` is the plane's.
        states: (..., n) states of its model, such as those of an estimate, or (..., 2) metres
            north and east.

    Returns:
        Latitude and longitude, (...) each, at the height of the origin.

    Raises ValueError for a recording without an origin, or states of another size.
    """
    origin = recording.meta.get("origin")
    if origin is None:
        raise ValueError(
            "the recording has no origin: read it from latitude and longitude, or with origin=."
        )
    x = real_array("states", states, finite=False)
    size = x.shape[-1] if x.ndim else 0
    if size not in (2, recording.model.n):
        raise ValueError(
            f"states must hold 2 positions or {recording.model.n} states in their last axis, got "
            f"{x.shape}."
        )
    i, j = (0, 1) if size == 2 else recording.model.position[:2]
    return from_plane(x[..., i], x[..., j], origin)


def checked_origin(origin: object) -> tuple[float, float, float]:
    """Latitude, longitude and height as floats; ValueError naming what is wrong."""
    given = tuple(origin) if isinstance(origin, Iterable) else ()
    if len(given) not in (2, 3):
        raise ValueError(
            f"origin must be latitude and longitude, °, and height, m, got {origin!r}."
        )
    return (
        within("origin latitude", given[0], -90.0, 90.0),
        within("origin longitude", given[1], -360.0, 360.0),
        within("origin height", given[2] if len(given) > 2 else 0.0, -1e5, 1e5),
    )


def degrees_of(text: str) -> float:
    """Degrees of text such as 59°12.345'N, 59 12 20.7 N or 18.5 W; NaN if it is none."""
    found = _ANGLE.fullmatch(text[:60])
    if found is None:
        return math.nan
    parts = [float((found[p] or "0").replace(",", ".")) for p in ("degrees", "minutes", "seconds")]
    if max(parts[1:]) >= 60.0 or (found["sign"] == "-" and found["side"].upper() in ("S", "W")):
        return math.nan
    minus = found["sign"] == "-" or found["side"].upper() in ("S", "W")
    size = parts[0] + parts[1] / 60.0 + parts[2] / 3600.0
    return -size if minus else size


def signed(text: str) -> float:
    """The number of a text such as 5912.345S, negative for S and W; NaN if it is none."""
    found = _SIDED.fullmatch(text[:60])
    if found is None:
        return math.nan
    return -float(found[1]) if found[2].upper() in ("S", "W") else float(found[1])


def degrees_of_nmea(value: Array) -> Array:
    """Degrees of ddmm.mmmm or dddmm.mmmm, NaN where minutes are 60 or more."""
    whole = np.trunc(value / 100.0)
    minutes = value - 100.0 * whole
    degrees: Array = whole + np.where(np.abs(minutes) < 60.0, minutes, np.nan) / 60.0
    return degrees
