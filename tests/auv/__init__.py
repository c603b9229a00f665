"""Tests of navgym.auv."""
