"""Tests of navgym.filters."""
