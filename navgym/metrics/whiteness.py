"""Whether innovations are white: what NIS and an adapted covariance cannot tell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from navgym.core.checks import Array, real_array

BLOCK = 20  # received samples
CUT = (
    3.0  # robust deviations, beyond which a value counts as that much: outliers are not correlation
)
LEAST_LAG = 0.1  # smallest correlation from one sample to the next that is worth a word
LEAST_BLOCK = 1.5  # likewise of the variance of blocks' sums over that of independent values
DEVIATIONS = 3.5  # of chance, that both must exceed


@dataclass(frozen=True, eq=False)
class Whiteness:
    """How much each innovation says of the next ones.

    Args:
        lag: (m,) correlation of each component's innovation with its next; NaN where too few came.
        block: (m,) variance of sums over blocks of `BLOCK` innovations over what it is if they are
            independent.
        correlated: (m,) whether one of the two is too large for chance, and large enough to matter.
    """

    lag: Array
    block: Array
    correlated: Array


def whiteness(innovations: ArrayLike) -> Whiteness:
    """Look for correlation in time in the innovations of a filter.

    A filter whose noise model is right has independent innovations (Kailath 1968). Noise that is
    correlated in time can be taken for motion, so that NIS stays where it should be and the covariance
    is far too small: lag and blocks show it. Values are cut at `CUT` robust deviations.

    Args:
        innovations: (T, m); NaN where nothing was received, which is left out.

    Raises:
        ValueError: another shape.
    """
    series = real_array("innovations", innovations, finite=False)
    if series.ndim != 2:
        raise ValueError(f"innovations must have shape (T, m), got {series.shape}.")
    found = [_component(column[np.isfinite(column)]) for column in series.T]
    lag, block, correlated = (np.array(each) for each in zip(*found, strict=True))
    return Whiteness(lag, block, correlated)


def _component(values: Array) -> tuple[float, float, bool]:
    """Lag correlation, block ratio and verdict of one component's received innovations."""
    blocks = len(values) // BLOCK
    spread = 1.4826 * np.median(np.abs(values)) if len(values) else 0.0
    if blocks < 3 or spread == 0.0:
        return np.nan, np.nan, False
    z = np.clip(values / spread, -CUT, CUT)
    power = float((z * z).mean())
    lag = float((z[1:] * z[:-1]).mean()) / power
    sums = z[: blocks * BLOCK].reshape(blocks, BLOCK).sum(axis=1)
    block = float((sums * sums).mean()) / (BLOCK * power)
    by_chance = DEVIATIONS / np.sqrt(len(z)), 1.0 + DEVIATIONS * np.sqrt(2.0 / blocks)
    off = abs(lag) > max(LEAST_LAG, by_chance[0]) or block > max(LEAST_BLOCK, by_chance[1])
    return lag, block, bool(off)
