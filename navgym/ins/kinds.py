"""Kinds of aiding sensors, declared once; numbers are frozen into kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Kind:
    """A kind of aiding sensor.

    Args:
        name: what users call it.
        rows: numbers per measurement.
        unit: of each.
        meaning: in a few words.
    """

    name: str
    rows: int
    unit: str
    meaning: str


KINDS = (
    Kind("dvl", 3, "m/s", "velocity over ground in body axes, at the sensor"),
    Kind("depth", 1, "m", "depth of the sensor below the recording's origin"),
    Kind("fix", 3, "m", "position of the sensor, north, east, down of the recording's origin"),
    Kind("magnetometer", 3, "µT", "magnetic field in body axes"),
    Kind("heading", 1, "rad", "magnetic heading corrected for declination: true heading"),
    Kind("water", 3, "m/s", "velocity through water in body axes, at the sensor"),
)
NAMES = tuple(k.name for k in KINDS)
DVL_KIND, DEPTH_KIND, FIX_KIND, MAGNETOMETER_KIND, HEADING_KIND, WATER_KIND = range(len(KINDS))
FIRST = tuple(int(n) for n in np.cumsum([0, *(k.rows for k in KINDS)]))  # innovation of each kind
FIRST_ROW = np.array(FIRST[:-1])
INNOVATIONS = FIRST[-1]
