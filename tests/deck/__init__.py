"""Tests of navgym.deck."""
