"""Tests of navgym; the tree mirrors the package's."""
