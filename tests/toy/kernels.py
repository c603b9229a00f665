"""Everything compiled of the toy: the filter, its run over a batch, and what a lane does."""

import math

import numpy as np

from navgym.core.compile import kernel, part
from navgym.core.health import settle, watch_power
from navgym.envs.actions import bounded, foretold, log_square, place, set_parameters
from navgym.envs.columns import (
    FREEDOM,
    HEARD,
    INFORMATION,
    NIS_SUM,
    REWARD,
    SCORE,
    TERMINATED,
    TRUNCATED,
)
from navgym.statespace.filters.lane import LOG_2PI

f8, i8 = np.float64, np.int64
LANE = np.dtype(
    [
        ("x", f8, (1,)), ("P", f8, (1, 1)), ("innovation", f8), ("nis", f8), ("log_likelihood", f8),
        ("power", f8), ("diverged", i8),
    ]
)  # fmt: skip
MODEL = np.dtype([(name, f8) for name in ("Q", "R", "x0", "P0")])
# a sample made ready, with the squared error of the reference filter
TAPE = np.dtype([("time", f8), ("y", f8), ("truth", f8), ("regime", f8), ("reference_error", f8)])
STATION = np.dtype(
    [
        ("active", i8), ("which", i8), ("k", i8), ("length", i8), ("row", f8, (1,)), ("nis", f8, (2,)),
        ("lost", f8),
    ]
)  # fmt: skip
RULE = np.dtype([("interval", i8), ("kind", i8), ("clip", f8)])

DECAYS = np.array([0.5, 0.9])
SIGNALS = 3  # observations beside the parameters in force
DIFFERENCE, LIKELIHOOD = range(2)
RMSE, REFERENCE_RMSE, NIS, REGIME, TERM, ROW = range(INFORMATION, INFORMATION + 6)


@part
def step(lane, model, y, q):
    """One sample of the Kalman filter; returns how many components were received."""
    lane.P[0, 0] += q * model.Q
    lane.innovation = y - lane.x[0]
    lane.nis = math.nan
    lane.log_likelihood = math.nan
    received = 0 if math.isnan(y) else 1
    if received:
        S = lane.P[0, 0] + model.R
        K = lane.P[0, 0] / S
        lane.x[0] += K * lane.innovation
        lane.P[0, 0] *= 1.0 - K
        lane.nis = lane.innovation**2 / S
        lane.log_likelihood = -0.5 * (lane.nis + math.log(S) + LOG_2PI)
        watch_power(lane, lane.nis, 1)
    settle(lane)
    return received


@kernel
def begin(lanes, models):
    """Put lanes (N,) one step before the first sample."""
    for i in range(lanes.shape[0]):
        lanes[i].x[0] = models[i].x0
        lanes[i].P[0, 0] = models[i].P0
        lanes[i].power = 0.0
        lanes[i].diverged = 0


@kernel
def run(
    lanes, models, y, lengths, scales, table, interval, states, covariances, innovations, nis, logs
):
    """Filter every walk (N, T); `scales` (N, 1 or T) multiply Q beside the parameters' own."""
    for i in range(lanes.shape[0]):
        lane, p = lanes[i], min(i, table.shape[0] - 1)
        for k in range(lengths[i]):
            q = scales[i, min(k, scales.shape[1] - 1)]
            if table.shape[2] > 0:
                q *= table[p, min(k // interval, table.shape[1] - 1), 0]
            step(lane, models[i], y[i, k], q)
            states[i, k, 0] = lane.x[0]
            if nis.shape[1] > 0:
                covariances[i, k, 0, 0] = lane.P[0, 0]
                innovations[i, k, 0] = lane.innovation
                nis[i, k] = lane.nis
                logs[i, k] = lane.log_likelihood


@part
def control(lane, model, sample, station):
    """The controlled filter on a sample, and what is seen of it."""
    received = step(lane, model, sample.y, station.row[0])
    for d in range(DECAYS.shape[0]):
        if received:
            station.nis[d] += (1.0 - DECAYS[d]) * (log_square(lane.nis) - station.nis[d])
    station.lost += 0.1 * (1.0 - received - station.lost)
    return received


@part
def observe(station, table, obs, i):
    """Write lane i's observation."""
    for d in range(DECAYS.shape[0]):
        obs[i, d] = bounded(station.nis[d])
    obs[i, 2] = station.lost
    for a in range(table.shape[0]):
        obs[i, SIGNALS + a] = place(station, table, a)


@kernel
def first_look(stations, table, obs):
    """Observations (N, ·) before the first decision."""
    for i in range(stations.shape[0]):
        observe(stations[i], table, obs, i)


@kernel
def prepare(lanes, models, tapes, stations):
    """Run the reference filter: fill `reference_error` of the tapes (R, T)."""
    for i in range(lanes.shape[0]):
        for k in range(stations[i].length):
            step(lanes[i], models[i], tapes[i, k].y, stations[i].row[0])
            tapes[i, k].reference_error = (lanes[i].x[0] - tapes[i, k].truth) ** 2


@kernel
def decide(lanes, stations, models, tapes, table, rule, actions, obs, out, trail):
    """One decision of every lane; see `navgym.auv.kernels.decide`."""
    for i in range(lanes.shape[0]):
        for a in range(table.shape[0]):
            if stations[i].active and not math.isfinite(actions[i, a]):
                return False
    for i in range(lanes.shape[0]):
        lane, station = lanes[i], stations[i]
        if not station.active:
            continue
        set_parameters(station, actions[i], table)
        error, reference, likelihood, nis, heard, count = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        last = min(station.k + rule[0].interval, station.length)
        for k in range(station.k, last):
            sample = tapes[station.which, k]
            if control(lane, models[station.which], sample, station):
                likelihood += lane.log_likelihood
                nis += lane.nis
                heard += 1.0
            error += (lane.x[0] - sample.truth) ** 2
            reference += sample.reference_error
            count += 1.0
            if trail.shape[1] > 0:
                trail[i, k, 0] = lane.x[0]
        station.k = last
        observe(station, table, obs, i)
        clip = rule[0].clip
        term = (reference - error if rule[0].kind == DIFFERENCE else likelihood) / count
        failed = lane.diverged > 0
        paid = min(max(term, -clip), clip) if math.isfinite(term) else -clip
        out[i, REWARD] = -clip if failed else paid
        out[i, TERMINATED] = 1.0 if failed else 0.0
        out[i, TRUNCATED] = 1.0 if last >= station.length and not failed else 0.0
        out[i, RMSE] = math.sqrt(error / count)
        out[i, REFERENCE_RMSE] = math.sqrt(reference / count)
        out[i, NIS] = nis / heard if heard > 0.0 else math.nan
        out[i, REGIME] = tapes[station.which, last - 1].regime
        out[i, TERM] = term
        out[i, ROW] = station.row[0]
    return True


@kernel
def live(lanes, stations, models, samples, table, tally, look, obs):
    """One live sample; returns bits of the filters that failed, see `navgym.auv.kernels.live`."""
    received = control(lanes[0], models[0], samples[0], stations[0])
    step(lanes[1], models[0], samples[0].y, stations[1].row[0])
    if received:
        tally[HEARD] += 1.0
        tally[NIS_SUM] += lanes[0].nis
        tally[FREEDOM] += 1.0
        for i in range(2):
            log_det = -2.0 * lanes[i].log_likelihood - lanes[i].nis - LOG_2PI
            tally[SCORE + i] += foretold(lanes[i].nis, log_det, 1)
    if look:
        observe(stations[0], table, obs, 0)
    return (lanes[0].diverged > 0) + 2 * (lanes[1].diverged > 0)
