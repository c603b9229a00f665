"""Values that come again bit for bit: those that a receiver holds, and what may be a measurement of its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array

Flags = NDArray[np.bool_]

HELD_SHARE = 0.05  # of received values: fewer repeats do no harm
HELD_COUNT = 5  # how often a value must change, and repeat, before that says anything
FINE, FAIR = 10.0, 3.0  # quanta by which values change; see `is_held`
WIDE = 50.0  # quanta: longer steps are not looked at
# least steps, and of a quantum by which they may miss multiples: few have to be exact
ON_GRID = ((8, 0.05), (3, 1e-3), (2, 1e-6))


def repeats(values: Array) -> Flags:
    """Where the values of a sensor, (T, k), are those that were received last, bit for bit."""
    found = np.zeros(len(values), np.bool_)
    there = ~np.isnan(values).any(axis=1)
    y = values if there.all() else values[there]
    same = np.ones(max(len(y) - 1, 0), np.bool_)
    for column in y.T:
        same &= column[1:] == column[:-1]
    found[np.flatnonzero(there)[1:]] = same
    return found


def is_held(values: Array, repeated: Flags, quanta: Sequence[float]) -> bool | None:
    """Whether repeats of a sensor's values are a receiver's, which holds its last one.

    A receiver that measures anew repeats itself in all digits only where its noise and its motion
    are of the size of the last digit. So repeats are held values where, when the values change, one
    of them does so by ten units of its last digit or more; by three or more, if hardly any value
    stands once only. They are not where changes are smaller: a vehicle at rest, coarsely rounded.

    Args:
        values: (T, k), NaN where lost.
        repeated: what `repeats` found.
        quanta: the last digit's unit of each column.

    Returns:
        None if it is open: enough repeats to matter, but fine digits do not decide.
    """
    there = ~np.isnan(values).any(axis=1)
    if repeated.sum() < max(HELD_COUNT, HELD_SHARE * there.sum()):
        return False
    fresh = there & ~repeated
    changes = np.abs(np.diff(values[fresh], axis=0))
    if len(changes) < HELD_COUNT:
        return False
    sizes = [np.median(c[c > 0.0]) if (c > 0.0).any() else 0.0 for c in changes.T]
    size = max(s / q for s, q in zip(sizes, quanta, strict=True))
    runs = np.diff(np.flatnonzero(fresh[there]))
    if size >= FINE or (size >= FAIR and np.mean(runs > 1) > 0.9):
        return True
    return None if np.mean(runs > 1) > 0.9 else False


def quantum(values: Array) -> float:
    """The step of which all steps between values (T,) are multiples; 0 where there is none.

    So digits show that went through other units, such as minutes of a degree.
    """
    levels = np.unique(values[np.isfinite(values)])
    steps = np.diff(levels)
    steps = steps[steps > 1e-12 * max(float(np.abs(levels).max(initial=0.0)), 1e-300)]
    if not len(steps):
        return 0.0
    counts = steps / steps.min()
    near = counts[counts < WIDE]
    miss = float(np.abs(near - np.round(near)).max())
    fits = any(len(near) >= max(least, len(steps) // 2) and miss < m for least, m in ON_GRID)
    return float(steps.min()) if fits else 0.0
