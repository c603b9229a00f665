"""Kalman filters under loss: predict only, and three ways of filling the gap.

`kf` predicts only; `kf_zero` takes a lost measurement for a zero (QIVBF eq. 2 fed to a filter as
printed: the straw man of its figures); `kf_hold` repeats the last received value; `kf_extrapolate`
uses the parabola through the last three with its true variance (`lane.fill_correct`). `oracle` is
`kf` with the true scales of Q and R at each sample.
"""

from __future__ import annotations

import functools
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import kernel, part
from navgym.core.health import settle
from navgym.core.linalg import predict
from navgym.core.sizes import sample_size
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters.lane import (
    apply_innovation,
    estimate_lanes,
    expect,
    fields,
    fill_correct,
    kalman_correct,
    keep_prediction,
    padded,
    receive,
    remember,
    report,
    start,
    watch,
)

if TYPE_CHECKING:
    from navgym.problem import Filter

SKIP, EXTRAPOLATE, HOLD, ZERO = 0, 1, 2, 3


@functools.cache
def lane_type(n: int, m: int) -> np.dtype[Any]:
    """Record of one Kalman filter lane."""
    return np.dtype(fields(n, m))


def estimate(
    chosen: Filter, batch: StateSpaceBatch, table: Array, interval: int, everything: bool
) -> dict[str, Array]:
    """Run the filter `chosen` over a batch; see `navgym.estimation.run`."""
    if not chosen.needs_scales:
        batch = batch.without_scales()
    table = padded(table, (1.0, 1.0, 1.0))
    return estimate_lanes(sys.modules[__name__], batch, table, interval, chosen.option, everything)


def begin(lanes: NDArray[Any], models: NDArray[Any], parameters: NDArray[Any]) -> None:
    """Put the lanes (N,) at the start of their recordings."""
    start(lanes, models)


@kernel
def step(lane, model, t, received, q, r, fill, inflation):
    """One sample: predict, judge, correct, fill. The sample lies in the lane (`receive`)."""
    m = sample_size(lane)
    predict(lane, model, q)
    for i in range(m):
        for j in range(m):
            lane.R_used[i, j] = r * model.R[i, j]
    expect(lane, model, received)
    watch(lane, model, t, received)
    if fill >= HOLD:
        substitute(lane, fill)
        received = m
    if fill >= HOLD and received > 0:
        kalman_correct(lane, model)
    elif received > 0:
        apply_innovation(lane, model)
    else:
        keep_prediction(lane)
    if fill < HOLD:
        remember(lane, t)
        if fill == EXTRAPOLATE and received < m:
            fill_correct(lane, model, t, inflation)
    settle(lane)


@part
def substitute(lane, fill):
    """Put a zero, or the last received value, in place of each lost component.

    Before anything was received there is nothing to hold: the component stays lost.
    """
    for i in range(sample_size(lane)):
        if lane.use[i]:
            lane.past[i, 2] = lane.y[i]
            lane.past_count[i] += 1
        elif fill == ZERO:
            lane.y[i] = 0.0
            lane.use[i] = 1
        elif lane.past_count[i] > 0:
            lane.y[i] = lane.past[i, 2]
            lane.use[i] = 1


@kernel
def run(
    lanes, models, y, lost, time, scales, parameters, interval, fill,
    states, covariances, innovations, nis, log_likelihoods,
):  # fmt: skip
    """Filter every series: parameters (·, ·, 3) are q, r and the fill's inflation."""
    for i in range(lanes.shape[0]):
        lane = lanes[i]
        p = min(i, parameters.shape[0] - 1)
        for k in range(lane.k, min(lane.length, y.shape[1])):
            model = models[i, min(k, models.shape[1] - 1)]
            s = min(k, scales.shape[1] - 1)
            j = min(k // interval, parameters.shape[1] - 1)
            received = receive(lane, y, lost, i, k)
            step(
                lane, model, time[i, k], received,
                parameters[p, j, 0] * scales[i, s, 0], parameters[p, j, 1] * scales[i, s, 1],
                fill, parameters[p, j, 2],
            )  # fmt: skip
            report(lane, i, k, states, covariances, innovations, nis, log_likelihoods)
