"""SBET, a smoothed trajectory: records of 17 doubles, without a header; times are s of a GPS week."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymap3d import rcurve

from navgym.core.checks import Array
from navgym.core.units import DEGREE
from navgym.formats.channels import ESTIMATE, SECOND, Gatherer

FIELDS = (
    "time", "lat", "lon", "height", "x", "y", "z", "roll", "pitch", "heading", "wander",
    "ax", "ay", "az", "wx", "wy", "wz",
)  # fmt: skip
RECORD = np.dtype([(name, "<f8") for name in FIELDS])
LIMITS = {"lat": np.pi / 2, "lon": 2 * np.pi, "roll": 7.0, "pitch": 7.0, "heading": 14.0, "wander": 14.0}  # fmt: skip
WEEK = 604_800.0  # s
FIT = 0.1, 0.05  # share of the speed and m/s by which velocities may miss what positions say
# signs a, b, d of north = x cos + a y sin and east = b x sin + d y cos of the wander angle: which
# way y points and the angle counts is told nowhere in the file
HANDS = {
    "y to port": (-1.0, -1.0, -1.0),
    "y to starboard": (-1.0, 1.0, 1.0),
    "y to starboard and wander angles the other way": (1.0, -1.0, 1.0),
}


def read(path: Path, gatherer: Gatherer) -> None:
    """Position, velocity and attitude of a trajectory."""
    whole, rest = divmod(path.stat().st_size, RECORD.itemsize)
    if not whole:
        raise ValueError("it is shorter than one record of 136 bytes")
    if rest:
        gatherer.doubts.append(f"the last record was cut off after {rest} bytes: left out")
    data = np.fromfile(path, RECORD, whole)
    for name in FIELDS:
        wrong = ~np.isfinite(data[name]) | (np.abs(data[name]) > LIMITS.get(name, 1e9))
        if wrong.any():
            k = int(np.argmax(wrong))
            raise ValueError(f"record {k + 1} holds a {name} of {data[name][k]:g}")
    if (data["time"] < 0.0).any() or (data["time"] > 2e9).any():
        raise ValueError(f"record 1 holds a time of {data['time'][0]:g} s")
    time = np.round(data["time"] * SECOND).astype(np.int64)
    place = {"lat": data["lat"] / DEGREE, "lon": data["lon"] / DEGREE, "height": data["height"]}
    gatherer.add("sbet", "fix", time, place, ESTIMATE)
    turned = {"roll": data["roll"], "pitch": data["pitch"]}
    turned["heading"] = np.mod(data["heading"] - data["wander"] + np.pi, 2 * np.pi) - np.pi
    gatherer.add("sbet", "attitude", time, turned, ESTIMATE)
    gatherer.said.append("headings are the platform's less the wander angle")
    velocity = _velocity(data, gatherer)
    if velocity is not None:
        gatherer.add("sbet", "velocity", time, velocity, ESTIMATE)


def _velocity(data: NDArray[Any], gatherer: Gatherer) -> dict[str, Array] | None:
    """Velocities north, east, down, by the hand of axes that agrees with the positions."""
    steps = np.diff(data["time"])
    if len(steps) < 10 or (steps <= 0.0).any():
        gatherer.doubts.append("velocities left out: positions cannot tell what their axes are")
        return None
    lat, height = data["lat"], data["height"]
    north = np.diff(lat) * (rcurve.meridian(lat, deg=False) + height)[1:] / steps
    across = (rcurve.transverse(lat, deg=False) + height) * np.cos(lat)
    east = np.diff(data["lon"]) * across[1:] / steps
    up = np.diff(data["height"]) / steps
    c, s, x, y = np.cos(data["wander"]), np.sin(data["wander"]), data["x"], data["y"]
    found, errors = {}, {}
    for name, (a, b, d) in HANDS.items():
        vn, ve = c * x + a * s * y, b * s * x + d * c * y
        found[name] = vn, ve
        misses = np.hypot(_middle(vn) - north, _middle(ve) - east)
        errors[name] = float(np.median(misses))
    best = min(errors, key=lambda name: errors[name])
    speed = float(np.median(np.hypot(north, east)))
    if errors[best] > FIT[0] * speed + FIT[1]:
        gatherer.doubts.append(
            f"velocities left out: they miss what positions say by {errors[best]:.3g} m/s"
        )
        return None
    down = -1.0 if np.abs(_middle(data["z"]) - up).sum() <= np.abs(_middle(data["z"]) + up).sum() else 1.0  # fmt: skip
    gatherer.said.append(
        f"velocities have {best}, z {'up' if down < 0 else 'down'}, as positions tell"
    )
    return {"vn": found[best][0], "ve": found[best][1], "vd": down * data["z"]}


def _middle(values: Array) -> Array:
    mean: Array = (values[1:] + values[:-1]) / 2
    return mean
