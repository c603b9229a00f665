"""The variational-Bayes filter with quadratic fill: QIVBF, corrected.

At each received sample P_{k|k-1} and R carry inverse-Wishart laws whose scale matrices are kept as
estimates and effective counts (see QIVBF eq. 34-38, corrected): P̂ = (τ P⁻ + A)/(τ + 1),
R̂ = (ν⁻ R⁻ + B)/(ν⁻ + 1). A sweep is one round of coordinate ascent over q(P), q(R), q(x). A lost
sample is predicted, or filled by the parabola through the last three received samples.
"""

from __future__ import annotations

import functools
import math
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import inner, kernel, part
from navgym.core.health import NUMERICAL, settle
from navgym.core.linalg import (
    cholesky,
    correct,
    innovate,
    joseph,
    observe_entry,
    observe_rows,
    observe_vector,
    predict,
)
from navgym.core.sizes import sample_size, state_size
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters.lane import (
    PERIOD,
    estimate_lanes,
    expect,
    fields,
    fill_correct,
    keep_prediction,
    padded,
    receive,
    remember,
    report,
    silence,
    start,
    watch,
)

if TYPE_CHECKING:
    from navgym.problem import Filter

LEAST_COUNT = 1.0  # floor of ν⁻
# Losses alone never forget R below this count: with less, the wide P⁻ after a long outage passes for
# noise, and the first measurements are distrusted (13-18 m for 20 samples where 0.8 m are possible).
LEAST_COUNT_LOST = 10.0
# R̂ stays between these multiples of the model's R. Measurements that are redundant and agree would
# shrink it without end along what they have in common, until it is singular; a filter that has lost
# the track would take the whole way for noise, and never come back.
LEAST_NOISE, MOST_NOISE = 1e-6, 1e4
# One sample multiplies what is remembered of R̂ by no more than this: within the step an outlier of
# a kilometre is rejected by as much as it takes, but it must not blind the filter for what follows.
MOST_RISE = 6.0
EXTRAPOLATE = 1

# columns of a parameter array, in the order of the declared parameter space
SWEEPS, TAU, RHO, COUNT0, SCALE0, PROCESS, FILL, INFLATION = range(8)


@functools.cache
def lane_type(n: int, m: int) -> np.dtype[Any]:
    """Record of one variational-Bayes filter lane."""
    f8 = np.float64
    extra = [
        ("R", f8, (m, m)),
        ("count", f8, ()),
        ("variances", f8, (m,)),  # the model's own, at the last sample
        ("change", f8, ()),
        ("P_predicted", f8, (n, n)),
        ("P_adapted", f8, (n,)),  # the diagonal of P̂ after the last sweep
        ("B", f8, (m, m)),
        ("residual", f8, (m,)),
        ("G", f8, (m, m)),
    ]
    return np.dtype(extra + fields(n, m))


def estimate(
    chosen: Filter, batch: StateSpaceBatch, table: Array, interval: int, everything: bool
) -> dict[str, Array]:
    """Run the filter `chosen` over a batch; see `navgym.estimation.run`."""
    table = padded(table, (*table[0, 0, :6], 0.0, 1.0))
    return estimate_lanes(sys.modules[__name__], batch, table, interval, 0, everything)


def begin(lanes: NDArray[Any], models: NDArray[Any], parameters: NDArray[Any]) -> None:
    """Put the lanes (N,) at the start: R̂ = r0 R with ν0 counts, from parameters (N or 1, ·, 8)."""
    start(lanes, models)
    lanes["count"] = parameters[:, 0, COUNT0]
    lanes["R"] = parameters[:, 0, SCALE0, None, None] * models["R"][:, 0]
    lanes["variances"] = np.diagonal(models["R"][:, 0], axis1=1, axis2=2)


@part
def follow_model(lane, model):
    """Where the model's R changes over time, R̂ keeps its ratio to the model's variances."""
    m = sample_size(lane)
    for i in range(m):
        if model.R[i, i] != lane.variances[i]:
            d = math.sqrt(model.R[i, i] / lane.variances[i])
            lane.variances[i] = model.R[i, i]
            for j in range(m):
                lane.R[i, j] *= d
                lane.R[j, i] *= d


@inner
def expected_noise(lane, model):
    """B = E[(y − Hx)(y − Hx)ᵀ] = (y − Hx)(y − Hx)ᵀ + H P Hᵀ over the used components (eq. 36)."""
    m = sample_size(lane)
    observe_rows(model, lane.P, lane.W)
    for i in range(m):
        if lane.use[i]:
            lane.residual[i] = lane.y[i] - observe_vector(model, i, lane.x)
    for i in range(m):
        for j in range(i + 1):
            if lane.use[i] and lane.use[j]:
                s = lane.residual[i] * lane.residual[j]
                s += observe_entry(model, j, lane.W, i)
                lane.B[i, j] = s
                lane.B[j, i] = s


@part
def complete_noise(lane):
    """Fill B where components were lost: their noise has its expectation given the others' noise.

    v_lost | v_used ~ N(G v_used, R_ll − G R_ul), G = R_lu R_uu⁻¹ under the current R_used: the
    exact coordinate update with the lost measurement as one more latent variable. With nothing
    lost it does nothing; with a diagonal R it leaves R of the lost components as it is.
    """
    m = sample_size(lane)
    for i in range(m):
        for j in range(i + 1):
            both = lane.use[i] and lane.use[j]
            lane.S[i, j] = lane.R_used[i, j] if both else (1.0 if i == j else 0.0)
    if not cholesky(lane):
        lane.diverged = NUMERICAL
    for a in range(m):
        if not lane.use[a]:
            for i in range(m):
                s = lane.R_used[i, a] if lane.use[i] else 0.0
                for k in range(i):
                    s -= lane.S[i, k] * lane.G[a, k]
                lane.G[a, i] = s / lane.S[i, i]
            for i in range(m - 1, -1, -1):
                s = lane.G[a, i]
                for k in range(i + 1, m):
                    s -= lane.S[k, i] * lane.G[a, k]
                lane.G[a, i] = s / lane.S[i, i]
    for a in range(m):
        if not lane.use[a]:
            for j in range(m):
                if lane.use[j]:
                    s = 0.0
                    for k in range(m):
                        if lane.use[k]:
                            s += lane.G[a, k] * lane.B[k, j]
                    lane.B[a, j] = s
                    lane.B[j, a] = s
    for a in range(m):
        for b in range(a + 1):
            if not lane.use[a] and not lane.use[b]:
                s = lane.R_used[a, b]
                for k in range(m):
                    if lane.use[k]:
                        s += lane.B[a, k] * lane.G[b, k] - lane.G[a, k] * lane.R_used[k, b]
                lane.B[a, b] = s
                lane.B[b, a] = s


@part
def forget(lane, rho, silent):
    """ν⁻ after `silent` seconds in which nothing was received: ρ per second, with floors."""
    fresh = rho ** min(silent, PERIOD) * min(lane.count, LEAST_COUNT_LOST)
    lane.count = max(rho**silent * lane.count, fresh, LEAST_COUNT)


@inner
def sweep(lane, model, tau_weight, count_weight, complete):
    """One round over q(P), q(R), q(x) (QIVBF eq. 34-41, corrected); returns `innovate`'s ok.

    tau_weight = s/(τ+s) and count_weight = s/(ν⁻+s) are the shares that one sample has in P̂, R̂,
    where s is what it counts. The prior stays fixed over sweeps (eq. 34-35), x restarts from x⁻
    (eq. 40).
    """
    n = state_size(lane)
    m = sample_size(lane)
    for i in range(n):
        for j in range(i + 1):
            a = lane.P[i, j] + (lane.x[i] - lane.x_prior[i]) * (lane.x[j] - lane.x_prior[j])
            s = (1.0 - tau_weight) * lane.P_predicted[i, j] + tau_weight * a
            lane.P_prior[i, j] = s
            lane.P_prior[j, i] = s
    expected_noise(lane, model)
    if complete:
        complete_noise(lane)
    for i in range(m):
        for j in range(m):
            s = (1.0 - count_weight) * lane.R[i, j]
            s += count_weight * (lane.B[i, j] + LEAST_NOISE * model.R[i, j])
            lane.R_used[i, j] = s
    ok, _, _ = innovate(lane, model)
    return ok


@part
def remember_noise(lane, model):
    """R̂ after the sample: what the last sweep used, but for what no single sample may do to it."""
    m = sample_size(lane)
    for i in range(m):
        most = min(MOST_NOISE * model.R[i, i], MOST_RISE * lane.R[i, i])
        lane.residual[i] = min(1.0, math.sqrt(most / lane.R_used[i, i]))
    for i in range(m):
        for j in range(m):
            lane.R[i, j] = lane.residual[i] * lane.residual[j] * lane.R_used[i, j]


@part
def adapt(lane, model, sweeps, tau, weight, complete):
    """The measurement update: `sweeps` rounds from x = x⁻, P = P⁻; R̂ and its count move on.

    A sample counts for as many seconds as have passed since the last one, at most for `PERIOD`, so
    that memory is in seconds and ten samples that err together do not outvote everything else.
    """
    n = state_size(lane)
    m = sample_size(lane)
    tau_weight = weight / (tau + weight)
    count_weight = weight / (lane.count + weight)
    keep_prediction(lane)
    for i in range(n):
        for j in range(n):
            lane.P_predicted[i, j] = lane.P_prior[i, j]
    for _ in range(sweeps):
        if not sweep(lane, model, tau_weight, count_weight, complete):
            lane.diverged = NUMERICAL
        lane.change = 0.0
        for i in range(n):
            s = lane.x_prior[i] - lane.x[i]
            for k in range(m):
                s += lane.W[k, i] * lane.z[k]
            lane.change += s * s / lane.P_predicted[i, i]
        correct(lane)
    joseph(lane, model)
    for i in range(n):
        lane.P_adapted[i] = lane.P_prior[i, i]
    remember_noise(lane, model)
    lane.count += weight


@kernel
def step(lane, model, t, received, sweeps, tau, rho, process, fill, inflation):
    """One sample: predict, forget, judge, adapt, fill. The sample lies in the lane (`receive`)."""
    m = sample_size(lane)
    predict(lane, model, process)
    silent = silence(lane, t)
    if received > 0:
        forget(lane, rho, silent)
    follow_model(lane, model)
    for i in range(m):
        for j in range(m):
            lane.R_used[i, j] = lane.R[i, j]
    expect(lane, model, received)
    watch(lane, model, t, received)
    if received > 0:
        adapt(lane, model, sweeps, tau, min(silent, PERIOD), received < m)
    else:
        keep_prediction(lane)
    remember(lane, t)
    if fill == EXTRAPOLATE and received < m:
        for i in range(m):
            for j in range(m):
                lane.R_used[i, j] = lane.R[i, j]
        fill_correct(lane, model, t, inflation)
    settle(lane)


@kernel
def run(
    lanes, models, y, lost, time, scales, parameters, interval, fill,
    states, covariances, innovations, nis, log_likelihoods,
):  # fmt: skip
    """Filter every series with parameters (N or 1, intervals, 8); `scales` and `fill` are unused."""
    for i in range(lanes.shape[0]):
        lane = lanes[i]
        p = min(i, parameters.shape[0] - 1)
        for k in range(lane.k, min(lane.length, y.shape[1])):
            model = models[i, min(k, models.shape[1] - 1)]
            j = min(k // interval, parameters.shape[1] - 1)
            received = receive(lane, y, lost, i, k)
            step(
                lane, model, time[i, k], received, int(parameters[p, j, SWEEPS]),
                parameters[p, j, TAU], parameters[p, j, RHO], parameters[p, j, PROCESS],
                int(parameters[p, j, FILL]), parameters[p, j, INFLATION],
            )  # fmt: skip
            report(lane, i, k, states, covariances, innovations, nis, log_likelihoods)
