"""Tests of navgym.statespace."""
