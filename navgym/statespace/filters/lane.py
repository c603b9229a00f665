"""What every linear filter's lane carries, and the steps that all of them share.

A lane is one record (a numpy structured scalar): the state between two samples and the scratch of
one step, with sizes fixed by its type. Kernels take whole lanes; see `navgym.core.compile`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import inline, inner, part
from navgym.core.health import NUMERICAL, POWER_MEMORY, RUNAWAY
from navgym.core.linalg import correct_state, innovate, joseph, observe_vector
from navgym.core.sizes import sample_size, state_size
from navgym.statespace.batch import StateSpaceBatch, outputs

LOG_2PI = math.log(2.0 * math.pi)
NO_LIMIT = 2**62
# Memory is in seconds: what a filter forgets, or a mode leaks, is told per this long. So an
# estimate depends neither on the rate of a log nor on rows without a measurement.
PERIOD = 1.0
# A filter has lost the track where its innovations are, for a while, this many times larger in the
# mean than those of someone who repeats the last measurement, or extends the last two.
BEHIND = math.log(25.0)


def fields(n: int, m: int) -> list[tuple[str, Any, tuple[int, ...]]]:
    """Fields common to the lanes of all linear filters with n states and m measurements."""
    f8, i8 = np.float64, np.int64
    return [
        ("x", f8, (n,)),
        ("P", f8, (n, n)),
        ("y", f8, (m,)),
        ("use", i8, (m,)),
        ("innovation", f8, (m,)),
        ("nis", f8, ()),
        ("log_likelihood", f8, ()),
        ("behind", f8, ()),  # mean log-ratio of squared innovations, its own over naive ones
        ("heard", f8, ()),  # time at which something was last received, s
        # the last two received values of each component, older first: what a naive guess rests on
        ("last", f8, (m, 2)),
        ("last_time", f8, (m, 2)),
        ("last_count", i8, (m,)),
        ("angle", i8, (m,)),  # 1 where a component wraps
        ("diverged", i8, ()),
        ("n", i8, ()),
        ("m", i8, ()),
        ("k", i8, ()),  # samples done: `run` goes on from here ...
        ("length", i8, ()),  # ... to here, or to the end of the data
        # the last three received values of each component, oldest first
        ("past", f8, (m, 3)),
        ("past_time", f8, (m, 3)),
        ("past_count", i8, (m,)),
        # scratch
        ("x_prior", f8, (n,)),
        ("P_prior", f8, (n, n)),
        ("R_used", f8, (m, m)),
        ("z", f8, (m,)),
        ("S", f8, (m, m)),
        ("W", f8, (m, n)),
        ("A", f8, (n, n)),
        ("T", f8, (n, n)),
    ]


def start(lanes: NDArray[Any], models: NDArray[Any]) -> None:
    """Put lanes (N,) at x0, P0 of models (N, K), one step before the first measurement."""
    lanes[...] = np.zeros((), lanes.dtype)
    lanes["x"] = models["x0"][:, 0]
    lanes["P"] = models["P0"][:, 0]
    lanes["heard"] = np.nan
    lanes["n"], lanes["m"] = lanes["x"].shape[1], lanes["y"].shape[1]
    lanes["length"] = NO_LIMIT


def estimate_lanes(
    family: Any, batch: StateSpaceBatch, table: Array, interval: int, option: int, everything: bool
) -> dict[str, Any]:
    """Run a family of filters (a module with `lane_type`, `begin`, `run`) over a batch."""
    n, m = batch.models.dtype["x0"].shape[0], batch.y.shape[2]
    lanes = np.zeros(len(batch), family.lane_type(n, m))
    family.begin(lanes, batch.models, table)
    scales = np.ones((len(batch), 1, 2)) if batch.scales is None else batch.scales
    lanes["length"] = batch.lengths
    found: dict[str, Any] = outputs(batch, n, m, everything)
    family.run(
        lanes, batch.models, batch.y, batch.lost, batch.time, scales, table, interval, option,
        *found.values(),
    )  # fmt: skip
    found["diverged"] = lanes["diverged"] > 0
    return found


def padded(table: Array, defaults: tuple[float, ...]) -> Array:
    """`table` (·, ·, k) with the columns that the filter does not expose, at `defaults`."""
    missing = defaults[table.shape[2] :]
    tail = np.broadcast_to(np.array(missing), (*table.shape[:2], len(missing)))
    return np.ascontiguousarray(np.concatenate([table, tail], axis=2))


@inner
def receive(lane, y, lost, i, k):
    """Copy sample k of series i into the lane; returns how many components were received."""
    count = 0
    for j in range(sample_size(lane)):
        lane.y[j] = y[i, k, j]
        lane.use[j] = 0 if lost[i, k, j] else 1
        count += lane.use[j]
    return count


@part
def remember(lane, t):
    """Append the received components of the lane's sample, taken at `t`, to its history."""
    for i in range(sample_size(lane)):
        if lane.use[i]:
            for j in range(2):
                lane.past[i, j] = lane.past[i, j + 1]
                lane.past_time[i, j] = lane.past_time[i, j + 1]
            lane.past[i, 2] = lane.y[i]
            lane.past_time[i, 2] = t
            lane.past_count[i] += 1


@part
def quadratic(lane, i, t):
    """Value at `t` of the parabola through component i's three past samples, and Σ l².

    QIVBF eq. 27-28, corrected: an extrapolation through the last three *received* samples at
    their true times; Σ l² is the factor by which it magnifies the measurement noise.
    """
    a = lane.past_time[i, 0]
    b = lane.past_time[i, 1]
    c = lane.past_time[i, 2]
    la = (t - b) * (t - c) / ((a - b) * (a - c))
    lb = (t - a) * (t - c) / ((b - a) * (b - c))
    lc = (t - a) * (t - b) / ((c - a) * (c - b))
    value = la * lane.past[i, 0] + lb * lane.past[i, 1] + lc * lane.past[i, 2]
    return value, la * la + lb * lb + lc * lc


@part
def silence(lane, t):
    """Seconds since something was last received; `PERIOD` at the first sample.

    A time that is counted from what was received, not from the last row, is the same whether rows
    without a measurement are there or not.
    """
    if not lane.heard <= t:
        lane.heard = t - PERIOD
    return t - lane.heard


@part
def expect(lane, model, received):
    """Judge the sample by the prediction and R_used: innovation, NIS, log-likelihood.

    Leaves S, W and z of `innovate` in the lane.
    """
    expect_nothing(lane)
    if received > 0:
        for j in range(sample_size(lane)):
            if lane.use[j]:
                lane.innovation[j] = lane.y[j] - observe_vector(model, j, lane.x_prior)
        score(lane, received, innovate(lane, model))


@part
def expect_nothing(lane):
    """No innovation, NIS or log-likelihood yet: what a lost sample reports."""
    for j in range(sample_size(lane)):
        lane.innovation[j] = math.nan
    lane.nis = math.nan
    lane.log_likelihood = math.nan


@part
def score(lane, received, whitened):
    """NIS and log-likelihood of the lane's innovation, from what `whiten` returned."""
    ok, nis, log_det = whitened
    lane.nis = nis
    lane.log_likelihood = -0.5 * (nis + log_det + received * LOG_2PI)
    if not (ok and math.isfinite(nis)):
        lane.diverged = NUMERICAL


@inner
def watch(lane, model, t, received):
    """Flag a lane that for a while foretells worse than who repeats or extends the last values.

    A filter that adapts P or R can explain anything, and one whose R is wrong may be sound, so
    neither its own covariance nor the model's R tells that it has lost the track. What the
    measurements themselves do from one to the next does: the model's R is only the scale below which
    differences are of no interest. A spike counts by its logarithm, and for the naive guess as well.
    """
    own, still, straight, judged = 0.0, 0.0, 0.0, 0
    for j in range(sample_size(lane)):
        if lane.use[j]:
            if lane.last_count[j] > 1:
                d = wrapped(lane, j, lane.y[j] - lane.last[j, 1])
                slope = wrapped(lane, j, lane.last[j, 1] - lane.last[j, 0])
                slope /= lane.last_time[j, 1] - lane.last_time[j, 0]
                still += d * d / model.R[j, j]
                d = wrapped(lane, j, d - slope * (t - lane.last_time[j, 1]))
                straight += d * d / model.R[j, j]
                own += lane.innovation[j] ** 2 / model.R[j, j]
                judged += 1
            lane.last[j, 0] = lane.last[j, 1]
            lane.last_time[j, 0] = lane.last_time[j, 1]
            lane.last[j, 1] = lane.y[j]
            lane.last_time[j, 1] = t
            lane.last_count[j] += 1
    if judged > 0:
        naive = min(still, straight) / judged
        ahead = math.log((1.0 + own / judged) / (1.0 + naive))
        lane.behind += (1.0 - POWER_MEMORY) * (ahead - lane.behind)
    if not lane.behind < BEHIND and lane.diverged == 0:
        lane.diverged = RUNAWAY
    if received > 0:
        lane.heard = t


@inline
def wrapped(lane, j, difference):
    """A difference in component j, in [−π, π) if it is an angle."""
    if lane.angle[j]:
        difference -= 2.0 * math.pi * math.floor(difference / (2.0 * math.pi) + 0.5)
    return difference


@part
def kalman_correct(lane, model):
    """One Joseph-form update of (x⁻, P⁻) by the used components under R_used."""
    ok, _, _ = innovate(lane, model)
    apply_innovation(lane, model)
    if not ok:
        lane.diverged = NUMERICAL


@part
def apply_innovation(lane, model):
    """The update, in Joseph form, by what `innovate` or `expect` left in the lane."""
    correct_state(lane)
    joseph(lane, model)


@part
def fill_correct(lane, model, t, inflation):
    """Correct (x, P) by the extrapolated values of the lost components (QIVBF eq. 28, corrected).

    The value is a function of past data, so it enters with R_used grown by inflation · Σ l² and
    teaches the filter nothing about its noise. Components with fewer than three past samples,
    and those received, are left alone. Overwrites `y` and `use`.
    """
    m = sample_size(lane)
    count = 0
    for i in range(m):
        lost = lane.use[i] == 0 and lane.past_count[i] >= 3
        lane.use[i] = 1 if lost else 0
        if lost:
            value, growth = quadratic(lane, i, t)
            lane.y[i] = value
            g = math.sqrt(inflation * growth)
            for j in range(m):
                lane.R_used[i, j] *= g
                lane.R_used[j, i] *= g
            count += 1
    if count > 0:
        for i in range(state_size(lane)):
            lane.x_prior[i] = lane.x[i]
            for j in range(state_size(lane)):
                lane.P_prior[i, j] = lane.P[i, j]
        kalman_correct(lane, model)


@part
def keep_prediction(lane):
    """Nothing was received: the prediction is the estimate."""
    for i in range(state_size(lane)):
        lane.x[i] = lane.x_prior[i]
        for j in range(state_size(lane)):
            lane.P[i, j] = lane.P_prior[i, j]


@inner
def report(lane, i, k, states, covariances, innovations, nis, log_likelihoods):
    """Write the lane's answer for sample k of series i; outputs of length 0 are not wanted."""
    lane.k = k + 1
    for a in range(state_size(lane)):
        states[i, k, a] = lane.x[a]
    if covariances.shape[1] > 0:
        for a in range(state_size(lane)):
            for b in range(state_size(lane)):
                covariances[i, k, a, b] = lane.P[a, b]
    if nis.shape[1] > 0:
        nis[i, k] = lane.nis
        log_likelihoods[i, k] = lane.log_likelihood
        for a in range(sample_size(lane)):
            innovations[i, k, a] = lane.innovation[a]
