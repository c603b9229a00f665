"""WGS-84 by its other defining numbers."""

import numpy as np
import pytest

from navgym.inertial import earth

POLAR_RADIUS = 6356752.314245  # m


def test_the_radii_of_curvature_are_the_ellipses():
    a, b = earth.EQUATORIAL_RADIUS, POLAR_RADIUS
    assert earth.radii_of_curvature(0.0) == pytest.approx((b * b / a, a), rel=1e-11)
    assert earth.radii_of_curvature(np.pi / 2) == pytest.approx((a * a / b, a * a / b), rel=1e-11)


def test_a_day_against_the_stars():
    assert 2.0 * np.pi / earth.EARTH_RATE == pytest.approx(86164.1, abs=0.1)


def test_a_micro_g_is_a_millionth_of_gravity():
    assert pytest.approx(earth.GRAVITY, rel=1e-15) == earth.MICRO_G * 1e6
