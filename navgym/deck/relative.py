"""The attitude of one IMU in the axes of another, from two better units beside them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from navgym.core.checks import Array, real_array
from navgym.deck.public_logs import fitted
from navgym.deck.recording import turning

WINDOW = 1.0  # s: rates and forces of both references are compared as means over this long
REWEIGHTINGS = 4  # of rates against forces; their residuals settle in two or three


def relative_attitude(
    time: Array,
    rate1: Array,
    force1: Array,
    rate2: Array,
    force2: Array,
    lever_arm: ArrayLike,
    side1: Rotation | None = None,
    side2: Rotation | None = None,
) -> Rotation:
    """Attitude of the sub in the main IMU's axes from two better units, one beside each, (T,).

    See `read_deck_csv`.

    Args:
        time: (T,) s, even steps.
        rate1: (T, 3) rad/s of the unit beside the main IMU, mean over each interval.
        force1: (T, 3) m/s², likewise.
        rate2: (T, 3), of the unit beside the sub IMU.
        force2: (T, 3).
        lever_arm: (3,) m, from the first unit to the second, in the first one's axes.
        side1: attitude of the main IMU in the first unit's axes; the same by default.
        side2: attitude of the sub IMU in the second unit's axes.
    """  # fmt: skip
    h = (time[-1] - time[0]) / (len(time) - 1)
    turned = [turning(rate * h) for rate in (rate1, rate2)]
    first = _start(h, turned, (rate1, rate2), (force1, force2), real_array("lever_arm", lever_arm))
    between = turned[0].inv() * first * turned[1]
    here, there = (Rotation.identity() if s is None else s for s in (side1, side2))
    moved: Rotation = here.inv() * between * there
    return moved


def _start(
    h: float,
    turned: Sequence[Rotation],
    rates: Sequence[Array],
    forces: Sequence[Array],
    lever_arm: Array,
) -> Rotation:
    """Attitude of unit 2 in unit 1 before the first sample: Wahba's problem in inertial axes.

    Means over `WINDOW` of both kinds of vectors weigh by the variance of what disagreement they
    leave (flexure rates, lever-arm errors), which is found in turns.
    """  # fmt: skip
    count = min(max(1, round(WINDOW / h)), len(rates[0]))
    spun = [_means(a.apply(w), count) for a, w in zip(turned, rates, strict=True)]
    # velocity of unit 2 relative to 1 is ω × r in unit 1: its gain is what forces differ by
    swing = turned[0].apply(np.cross(rates[0], lever_arm))
    pushed = [_means(a.apply(f), count) for a, f in zip(turned, forces, strict=True)]
    pushed[0] = pushed[0] + _means(np.gradient(swing, h, axis=0), count)
    kinds, first = (spun, pushed), Rotation.identity()
    weights = [1.0 / max(float(np.square(one).sum()), 1e-300) for one, _ in kinds]
    for _ in range(REWEIGHTINGS):
        roots = np.sqrt(weights)
        there, here = (
            np.concatenate([r * kind[i] for r, kind in zip(roots, kinds, strict=True)])
            for i in (0, 1)
        )
        first = fitted(there, here)
        left = [np.square(one - first.apply(two)).mean() for one, two in kinds]
        floors = [1e-12 * np.square(one).mean() + 1e-300 for one, _ in kinds]
        weights = [1.0 / (a + b) for a, b in zip(left, floors, strict=True)]
    return first


def _means(values: Array, count: int) -> Array:
    """Means over successive `count` rows of `values` (T, 3), the last rows left out if fewer."""
    whole = len(values) // count * count
    means: Array = values[:whole].reshape(-1, count, 3).mean(axis=1)
    return means
