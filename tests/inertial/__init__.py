"""Tests of navgym.inertial."""
