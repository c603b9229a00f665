"""Tests of navgym.scenarios."""
