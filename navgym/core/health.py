"""Whether a filter's lane is sound: the one rule, compiled, for every kind of filter.

A lane has `x`, `P`, `diverged` and `power`, the exponential mean of its innovations' mean square over
what they should be. What they should be differs on purpose, and so does what a spike counts: linear
filters divide by R, and by H P⁻ Hᵀ only while their prior is wide (`filters.lane.judge`), since an
adapted P could explain anything, and cap the mean of a sample; error-state filters divide by
S (`inertial.update.watch`), and cap each row, since their sensors have nothing to do with one another.
"""

from __future__ import annotations

import math

from navgym.core.compile import part

NUMERICAL = 2  # `diverged`: a covariance lost its definiteness or a value stopped being finite
RUNAWAY = 1  # `diverged`: innovations far beyond anything that the filter can explain
RUNAWAY_POWER = 1e4  # mean square that counts as running away: 100 sigma
SPIKE = 10.0 * RUNAWAY_POWER  # what one sample can at most count: a spike is no runaway
POWER_MEMORY = 0.95  # of the exponential mean: about 20 received samples


@part
def watch_power(lane, total, count):
    """Let the mean square total / count enter `power`; flag a lane that has run away."""
    lane.power = POWER_MEMORY * lane.power + (1.0 - POWER_MEMORY) * total / count
    if lane.power >= RUNAWAY_POWER and lane.diverged == 0:
        lane.diverged = RUNAWAY


@part
def settle(lane):
    """Flag a lane whose numbers have failed; from then on its answer is NaN."""
    total = 0.0
    for i in range(lane.x.shape[0]):
        total += lane.x[i] + lane.P[i, i]
        if not lane.P[i, i] >= 0.0:
            total = math.nan
    if not math.isfinite(total):
        lane.diverged = NUMERICAL
    if lane.diverged == NUMERICAL:
        for i in range(lane.x.shape[0]):
            lane.x[i] = math.nan
            for j in range(lane.x.shape[0]):
                lane.P[i, j] = math.nan
