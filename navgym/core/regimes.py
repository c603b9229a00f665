"""The order in which regimes follow one another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def sequence(
    count: int, dwell: tuple[int, int], steps: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Label of the regime at each step: dwell uniform, the next uniform among the others."""
    labels = np.zeros(steps, dtype=np.int64)
    if count == 1:
        return labels
    now, k = int(rng.integers(count)), 0
    while k < steps:
        stay = int(rng.integers(dwell[0], dwell[1] + 1))
        labels[k : k + stay] = now
        k += stay
        now = (now + 1 + int(rng.integers(count - 1))) % count
    return labels
