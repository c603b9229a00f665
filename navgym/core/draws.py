"""Numbers that conditions are drawn from."""

from __future__ import annotations

import math

import numpy as np

Range = tuple[float, float]


def log_uniform(ends: Range, rng: np.random.Generator) -> float:
    """A number whose logarithm is uniform between those of `ends`."""
    return math.exp(rng.uniform(math.log(ends[0]), math.log(ends[1])))


def pair(ends: Range, rng: np.random.Generator) -> tuple[float, float]:
    """Two log-uniform numbers in order."""
    first, second = log_uniform(ends, rng), log_uniform(ends, rng)
    return min(first, second), max(first, second)
