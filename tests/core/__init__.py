"""Tests of navgym.core."""
