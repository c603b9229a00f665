"""Tests of navgym.metrics."""
