"""QIVBF as table 1 prints it: the named baseline that shows why the corrections are needed.

Kept from the print: P_{k|k-1} of rank one plus Q, counts that grow with every sweep (eq. 34-35), a
correction from x^(l) instead of x⁻ (eq. 40), E[·] with d - p - 1 (eq. 37-38), a point in place of an
expectation (eq. 36), an extrapolated value taken for a measurement of full weight, and filled
values fed back as nodes of the next parabola.

Added, because the print gives nothing: M^(0) = τ P_{k|k-1} with m^(0) = τ + n + 1 and
U^(0) = ν0 R with u^(0) = ν0 + m + 1, fresh at each sample, so that both expectations start at
P_{k|k-1} and R; a lost sample before the third is predicted only; a component that is lost is
filled on its own.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import kernel, part
from navgym.core.health import NUMERICAL, settle
from navgym.core.linalg import correct, innovate, observe_vector
from navgym.core.sizes import sample_size, state_size
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters.lane import (
    estimate_lanes,
    expect,
    fields,
    quadratic,
    receive,
    remember,
    report,
    start,
    watch,
)

if TYPE_CHECKING:
    from navgym.problem import Filter

SWEEPS, TAU, COUNT0 = range(3)


def lane_type(n: int, m: int) -> np.dtype[Any]:
    """Record of one lane of the printed filter."""
    f8 = np.float64
    extra = [("x_first", f8, (n,)), ("P_first", f8, (n, n)), ("M", f8, (n, n)), ("U", f8, (m, m))]
    return np.dtype(extra + fields(n, m))


def estimate(
    chosen: Filter,
    batch: StateSpaceBatch,
    table: Array,
    interval: int,
    everything: bool,
) -> dict[str, Array]:
    """Run the printed filter over a batch; see `navgym.estimation.run`."""
    return estimate_lanes(sys.modules[__name__], batch, table, interval, 0, everything)


def begin(
    lanes: NDArray[Any],
    models: NDArray[Any],
    parameters: NDArray[Any],
) -> None:
    """Put the lanes (N,) at the start of their recordings."""
    start(lanes, models)


@part
def predict_printed(lane, model):
    """x⁻ = F x and, as printed, P_{k|k-1} = (x⁻ − x)(x⁻ − x)ᵀ + Q."""
    n = state_size(lane)
    for i in range(n):
        s = 0.0
        for j in range(n):
            s += model.F[i, j] * lane.x[j]
        lane.x_prior[i] = s
    for i in range(n):
        for j in range(n):
            step = (lane.x_prior[i] - lane.x[i]) * (lane.x_prior[j] - lane.x[j])
            lane.P_prior[i, j] = step + model.Q[i, j]


@part
def fill_printed(lane, t):
    """Put the parabola through the last three samples, filled ones included, in place of a loss."""
    received = 0
    for i in range(sample_size(lane)):
        if not lane.use[i] and lane.past_count[i] >= 3:
            lane.y[i], _ = quadratic(lane, i, t)
            lane.use[i] = 1
        received += lane.use[i]
    return received


@part
def sweep_printed(lane, model, m_count, u_count):
    """One sweep as printed; m_count and u_count are the degrees of freedom after it."""
    n = state_size(lane)
    m = sample_size(lane)
    for i in range(n):
        for j in range(n):
            d = (lane.x[i] - lane.x_first[i]) * (lane.x[j] - lane.x_first[j])
            lane.M[i, j] += lane.P_first[i, j] + d
            lane.P_prior[i, j] = lane.M[i, j] / (m_count - n - 1.0)
        lane.x_prior[i] = lane.x[i]
    for i in range(m):
        lane.z[i] = lane.y[i] - observe_vector(model, i, lane.x) if lane.use[i] else 0.0
    for i in range(m):
        for j in range(m):
            lane.U[i, j] += lane.z[i] * lane.z[j]
            lane.R_used[i, j] = lane.U[i, j] / (u_count - m - 1.0)
    ok, _, _ = innovate(lane, model)
    correct(lane)
    return ok


@kernel
def step(lane, model, t, received, sweeps, tau, count0):
    """One sample. The sample lies in the lane (`receive`)."""
    n = state_size(lane)
    m = sample_size(lane)
    predict_printed(lane, model)
    for i in range(m):
        for j in range(m):
            lane.R_used[i, j] = model.R[i, j]
            lane.U[i, j] = count0 * model.R[i, j]
    expect(lane, model, received)
    watch(lane, model, t, received)
    for i in range(n):
        lane.x[i] = lane.x_prior[i]
        lane.x_first[i] = lane.x_prior[i]
        for j in range(n):
            lane.P[i, j] = lane.P_prior[i, j]
            lane.P_first[i, j] = lane.P_prior[i, j]
            lane.M[i, j] = tau * lane.P_prior[i, j]
    if fill_printed(lane, t) > 0:
        for k in range(sweeps):
            if not sweep_printed(lane, model, tau + n + 2.0 + k, count0 + m + 2.0 + k):
                lane.diverged = NUMERICAL
    remember(lane, t)
    settle(lane)


@kernel
def run(
    lanes, models, y, lost, time, scales, parameters, interval, option,
    states, covariances, innovations, nis, log_likelihoods,
):  # fmt: skip
    """Filter every series with parameters (N or 1, intervals, 3)."""
    for i in range(lanes.shape[0]):
        lane = lanes[i]
        p = min(i, parameters.shape[0] - 1)
        for k in range(lane.k, min(lane.length, y.shape[1])):
            model = models[i, min(k, models.shape[1] - 1)]
            row = parameters[p, min(k // interval, parameters.shape[1] - 1)]
            received = receive(lane, y, lost, i, k)
            step(lane, model, time[i, k], received, int(row[SWEEPS]), row[TAU], row[COUNT0])
            report(lane, i, k, states, covariances, innovations, nis, log_likelihoods)
