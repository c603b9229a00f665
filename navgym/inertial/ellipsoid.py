"""Navigation on the rotating ellipsoid, compiled: curvature, normal gravity, and rates of the local frame.

WGS-84, axes north, east, down (NED). `navgym.inertial.strapdown.local_rate` has the sphere that a deck
moves on for minutes; this is the Earth that a vehicle crosses.
"""

from __future__ import annotations

import math

from navgym.core.compile import part
from navgym.inertial.earth import EARTH_RATE, ECCENTRICITY_SQUARED, EQUATORIAL_RADIUS

EQUATORIAL_GRAVITY = 9.7803253359  # m/s², normal gravity on the equator
SOMIGLIANA = 1.93185265241e-3
FLATTENING = 1.0 / 298.257223563
GRAVITY_RATIO = 3.449786506841e-3  # of centrifugal to gravitational acceleration: ω² a² b / GM


@part
def curvature(sine):
    """Radii of curvature along the meridian and across it, m, from the sine of the latitude."""
    flat = 1.0 - ECCENTRICITY_SQUARED * sine * sine
    across = EQUATORIAL_RADIUS / math.sqrt(flat)
    return across * (1.0 - ECCENTRICITY_SQUARED) / flat, across


@part
def normal_gravity(sine, height):
    """Normal gravity (Somigliana, to the second order in height), m/s², down."""
    s = sine * sine
    ground = EQUATORIAL_GRAVITY * (1.0 + SOMIGLIANA * s) / math.sqrt(1.0 - ECCENTRICITY_SQUARED * s)
    h = height / EQUATORIAL_RADIUS
    fall = 2.0 * (1.0 + FLATTENING + GRAVITY_RATIO - 2.0 * FLATTENING * s)
    return ground * (1.0 - fall * h + 3.0 * h * h)


@part
def earth_rate(sine, cosine):
    """Rate of the Earth in NED, rad/s: north and down; it has no part to the east."""
    return EARTH_RATE * cosine, -EARTH_RATE * sine


@part
def transport_rate(tangent, north, east, meridian, across):
    """Rate of NED over the Earth, rad/s; velocities in m/s, radii with the height added, m."""
    return east / across, -north / meridian, -east * tangent / across
