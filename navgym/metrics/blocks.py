"""Intervals along one recording: a circular block bootstrap of time series.

Errors of a filter are correlated in time, so samples of a log cannot be drawn one by one; blocks of
neighbours can (Künsch 1989; circular, Politis & Romano 1992). What comes out speaks of this log, not of
the next one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navgym.core.checks import Array, positive_int, real_array

LEAST_BLOCKS = 8  # fewer say nothing about how blocks differ


@dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks to draw of a series of n samples; the same for all series that are compared.

    Args:
        size: n.
        length: samples per block.
        starts: (R, blocks) first samples.
    """

    size: int
    length: int
    starts: NDArray[np.int64]

    @classmethod
    def drawn(cls, size: int, resamples: int, seed: int = 0) -> Blocks | None:
        """Blocks of √n samples, as many as make up the series; None where that is less than eight.

        Args:
            size: samples of the series.
            resamples: how often to draw.
            seed: of the draws.
        """
        positive_int("size", size)
        length = math.isqrt(size)
        count = -(-size // length)
        if count < LEAST_BLOCKS:
            return None
        starts = np.random.default_rng(seed).integers(0, size, (resamples, count))
        return cls(size, length, starts)

    def means(self, series: ArrayLike) -> Array:
        """Mean of each redrawn series (R,); NaN if the series (n,) is not finite throughout.

        Raises ValueError for a series of another length.
        """
        values = real_array("series", series, finite=False)
        if values.shape != (self.size,):
            raise ValueError(f"series must have shape ({self.size},), got {values.shape}.")
        if not np.isfinite(values).all():
            return np.full(len(self.starts), np.nan)
        total = np.cumsum(np.concatenate([[0.0], values, values[: self.length]]))
        sums = total[self.starts + self.length] - total[self.starts]
        found: Array = sums.sum(axis=1) / (self.starts.shape[1] * self.length)
        return found
