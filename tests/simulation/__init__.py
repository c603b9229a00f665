"""Tests of navgym.simulation."""
