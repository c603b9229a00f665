"""Sensors at the stop of their range: the largest number a channel can say, again and again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array

REPEATED = 10  # samples at exactly the largest number of a channel, from which on it is a stop
FINE = 4.0  # steps of its resolution that a channel's noise must have for that to be told


def saturated(values: Array, names: Sequence[str]) -> tuple[NDArray[np.bool_], list[tuple[str, float, int]]]:  # fmt: skip
    """Samples (T,) at which a channel of `values` (T, 3) stands at its stop; name, stop and count of each.

    A channel stands at a stop where its largest or least number comes `REPEATED` times though its noise is many
    steps of its resolution: of noise the largest number comes once or twice. Channels too coarse or too
    quiet to tell are left alone.
    """
    at_stop, found = np.zeros(len(values), np.bool_), []
    for name, x in zip(names, values.T, strict=True):
        for extreme in (np.nanmax(x), np.nanmin(x)):
            hits = x == extreme
            if hits.sum() >= REPEATED and _noisy(x[~hits & np.isfinite(x)]):
                at_stop |= hits
                found.append((name, float(extreme), int(hits.sum())))
    return at_stop, found


def _noisy(x: Array) -> bool:
    """Whether a channel's noise, by its second differences, is many times its resolution."""
    if len(x) < 50:
        return False
    steps = np.abs(np.diff(np.unique(x)))
    return bool(np.median(np.abs(np.diff(x, 2))) >= FINE * float(np.min(steps, initial=np.inf)))
