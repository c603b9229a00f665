"""The one Earth: WGS-84, its rotation, its gravity.

These constants are frozen into kernels.
"""

from __future__ import annotations

import math

GRAVITY = 9.80665  # m/s², the standard one
MICRO_G = 9.80665e-6  # m/s²; a literal, since GRAVITY * 1e-6 differs in its last bit
EARTH_RATE = 7.292115e-5  # rad/s
EQUATORIAL_RADIUS = 6378137.0  # m
ECCENTRICITY_SQUARED = 6.69437999014e-3  # first eccentricity


def radii_of_curvature(latitude: float) -> tuple[float, float]:
    """Of the ellipsoid at `latitude` (rad): along the meridian and across it, m."""
    flatness = 1.0 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
    across = EQUATORIAL_RADIUS / math.sqrt(flatness)
    return across * (1.0 - ECCENTRICITY_SQUARED) / flatness, across
