"""Compiled core of the AUV environments: what a lane sees, does and earns in one decision.

A *tape* is a recording made ready for an agent: beside each sample stand the squared error of the
reference filter, the variance of the oracle and the features of a nominal Kalman filter that runs
beside the controlled one. None of these depend on the agent, so they are computed once. A *station*
is what one lane of the environment keeps between decisions, beside its filter.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from navgym.core.compile import inline, kernel, part
from navgym.core.health import NUMERICAL
from navgym.envs.actions import bounded, foretold, log_square, place, set_parameters
from navgym.envs.columns import FREEDOM, HEARD, MISS, NIS_SUM, SCORE
from navgym.statespace.filters import kalman, qivbf
from navgym.statespace.filters.lane import LOG_2PI, quadratic

DECAYS = np.array([0.5, 0.8, 0.95])
SIGNALS = 5  # per stream: NIS, alarm, correlation, power of positions, power of velocities
STREAM = SIGNALS * len(DECAYS)
ALARM = 5.0  # NIS per received component that counts as an alarm (20 for four components)
COMMON = 2 * len(DECAYS) + 5  # observations that belong to neither stream

AGREEING = 5  # successive innovations that must agree before a live filter's track counts as lost
FAR = 5.0  # standard deviations of R that each of them must be at least
USUAL = 0.1  # share that a new innovation has in what is usual: about ten samples

LOST_TRACK = 1e12  # squared error, m², of a reference filter that failed numerically

DIFFERENCE, OVER_ORACLE, ABSOLUTE, LIKELIHOOD, RELATIVE = range(5)
# columns of a decision's outcome, the first three as in `base`; the physical parameters follow
REWARD, TERMINATED, TRUNCATED, RMSE, REFERENCE_RMSE, NIS, LOST, REGIME, TERM, INFO = range(10)
RULE = np.dtype([("interval", np.int64), ("kind", np.int64), ("clip", np.float64)])


@functools.cache
def tape_type(n: int, m: int) -> np.dtype[Any]:
    """Record of one sample of a prepared recording."""
    f8 = np.float64
    return np.dtype(
        [
            ("y", f8, (m,)),
            ("lost", np.int64, (m,)),
            ("time", f8),
            ("truth", f8, (n,)),
            ("regime", f8),
            ("reference_error", f8),
            ("oracle_variance", f8),
            ("frozen", f8, (STREAM,)),
            ("curvature", f8, (len(DECAYS),)),
        ]
    )


@functools.cache
def station_type(n: int, m: int, parameters: int) -> np.dtype[Any]:
    """Record of what a lane keeps between decisions."""
    f8, i8 = np.float64, np.int64
    return np.dtype(
        [
            ("active", i8),
            ("which", i8),
            ("k", i8),
            ("length", i8),
            ("since", f8),
            ("curvature", f8, (len(DECAYS),)),
            ("lost", f8, (len(DECAYS),)),
            ("noise", f8, (2,)),
            ("widening", f8),
            ("change", f8),
            ("row", f8, (parameters,)),
            ("scale", f8),  # m², what the relative reward measures errors by
            # one stream of features
            ("mean", f8, (STREAM,)),
            ("last", f8, (m,)),
            ("kind", i8, (m,)),  # 0: the measurement observes a position, 1: it does not
            ("position", i8, (n,)),  # 1 where the state is a position
        ]
    )


def doubt_type(m: int) -> np.dtype[Any]:
    """Record of what is kept of a live filter's innovations over √R."""
    f8 = np.float64
    return np.dtype(
        [
            ("last", f8, (m,)),
            ("run", np.int64, (m,)),  # how many in succession have been far off and near each other
            ("usual", f8, (m,)),  # exponential mean of the logarithm of their square
        ]
    )


@part
def take(lane, sample):
    """Put a tape's sample into the lane; returns how many components were received."""
    count = 0
    for j in range(lane.y.shape[0]):
        lane.y[j] = sample.y[j]
        lane.use[j] = 1 - sample.lost[j]
        count += lane.use[j]
    return count


@part
def curvature(lane, model, t):
    """Squared miss of the parabola through the last three samples over its variance, or -1.

    For three consecutive samples this is |y_k − 3y_{k−1} + 3y_{k−2} − y_{k−3}|² / 20 R per
    component: it tells measurement noise from process noise.
    """
    total, count = 0.0, 0
    for i in range(lane.y.shape[0]):
        if lane.use[i] and lane.past_count[i] >= 3:
            value, growth = quadratic(lane, i, t)
            d = lane.y[i] - value
            total += d * d / ((1.0 + growth) * model.R[i, i])
            count += 1
    return total / count if count > 0 else -1.0


@inline
def blend(means, s, value):
    """Move signal s's exponential means towards `value`."""
    for d in range(DECAYS.shape[0]):
        means[s * DECAYS.shape[0] + d] += (1.0 - DECAYS[d]) * (
            value - means[s * DECAYS.shape[0] + d]
        )


@part
def watch(station, lane, model, received):
    """Move the features of one stream by the lane's innovation; nothing received moves nothing."""
    if received == 0:
        return
    positions, position_count, velocities, velocity_count = 0.0, 0.0, 0.0, 0.0
    product, now, before = 0.0, 0.0, 0.0
    for i in range(lane.y.shape[0]):
        if lane.use[i]:
            e = lane.innovation[i] / math.sqrt(model.R[i, i])
            if station.kind[i] == 0:
                positions += e * e
                position_count += 1.0
            else:
                velocities += e * e
                velocity_count += 1.0
            product += e * station.last[i]
            now += e * e
            before += station.last[i] * station.last[i]
            station.last[i] = e
    blend(station.mean, 0, log_square(lane.nis / received))
    blend(station.mean, 1, 1.0 if lane.nis > ALARM * received else 0.0)
    cosine = product / math.sqrt(now * before + 1e-30)
    blend(station.mean, 2, cosine if math.isfinite(cosine) else 0.0)
    if position_count > 0.0:
        blend(station.mean, 3, log_square(positions / position_count))
    if velocity_count > 0.0:
        blend(station.mean, 4, log_square(velocities / velocity_count))


@part
def square_error(lane, sample, station):
    """Squared position error of the lane, m²."""
    s = 0.0
    for i in range(lane.x.shape[0]):
        if station.position[i]:
            d = lane.x[i] - sample.truth[i]
            s += d * d
    return s


@part
def adaptive_step(lane, model, sample, station, received):
    """QIVBF on the sample in the lane, with the parameters in force at the station."""
    row = station.row
    qivbf.step(
        lane, model, sample.time, received, int(row[qivbf.SWEEPS]), row[qivbf.TAU],
        row[qivbf.RHO], row[qivbf.PROCESS], int(row[qivbf.FILL]), row[qivbf.INFLATION],
    )  # fmt: skip


@part
def accompany(sample, model, station, nominal, reference):
    """What runs beside the controlled filter: the frozen and the reference filter.

    The sample then carries the frozen one's features; the reference has the station's parameters.
    """
    received = take(nominal, sample)
    c = curvature(nominal, model, sample.time)
    kalman.step(nominal, model, sample.time, received, 1.0, 1.0, 0, 1.0)
    watch(station, nominal, model, received)
    if c >= 0.0:
        blend(station.curvature, 0, log_square(c))
    for j in range(STREAM):
        sample.frozen[j] = station.mean[j]
    for j in range(DECAYS.shape[0]):
        sample.curvature[j] = station.curvature[j]
    received = take(reference, sample)
    adaptive_step(reference, model, sample, station, received)


@kernel
def prepare(tapes, models, lengths, frozen, references, oracles, stations, scales):
    """Fill the tapes (R, T): reference error, frozen features and, given scales, oracle variance."""
    for i in range(tapes.shape[0]):
        station, nominal, reference = stations[i], frozen[i], references[i]
        for k in range(lengths[i]):
            sample = tapes[i, k]
            model = models[i, min(k, models.shape[1] - 1)]
            accompany(sample, model, station, nominal, reference)
            sample.reference_error = square_error(reference, sample, station)
            if reference.diverged == NUMERICAL:
                sample.reference_error = LOST_TRACK
            if scales.shape[1] > 0:
                oracle = oracles[i]
                received = take(oracle, sample)
                q, r = scales[i, k, 0], scales[i, k, 1]
                kalman.step(oracle, model, sample.time, received, q, r, 0, 1.0)
                sample.oracle_variance = 0.0
                for j in range(oracle.x.shape[0]):
                    if station.position[j]:
                        sample.oracle_variance += oracle.P[j, j]


@part
def count_loss(station, received, m):
    """Keep track of what was lost and for how long."""
    for d in range(DECAYS.shape[0]):
        station.lost[d] += (1.0 - DECAYS[d]) * (1.0 - received / m - station.lost[d])
    station.since = 0.0 if received > 0 else station.since + 1.0


@part
def control(lane, model, sample, station):
    """The controlled filter on a sample, and its features; returns how many components came in."""
    received = take(lane, sample)
    adaptive_step(lane, model, sample, station, received)
    take(lane, sample)  # a fill has overwritten it
    watch(station, lane, model, received)
    count_loss(station, received, lane.y.shape[0])
    return received


@part
def note(station, lane, model):
    """What the adaptive filter last said of itself: R̂ over R, P̂ over P⁻, the last sweep's change."""
    positions, position_count, velocities, velocity_count = 0.0, 0.0, 0.0, 0.0
    ever = 0
    for i in range(lane.y.shape[0]):
        ever += lane.past_count[i]
        ratio = lane.R[i, i] / model.R[i, i]
        if station.kind[i] == 0:
            positions += ratio
            position_count += 1.0
        else:
            velocities += ratio
            velocity_count += 1.0
    if position_count > 0.0:
        station.noise[0] = log_square(positions / position_count)
    if velocity_count > 0.0:
        station.noise[1] = log_square(velocities / velocity_count)
    if ever > 0:
        wide = 0.0
        for i in range(lane.x.shape[0]):
            wide += lane.P_adapted[i] / lane.P_predicted[i, i]
        station.widening = log_square(wide / lane.x.shape[0])
        station.change = bounded(0.1 * math.log(lane.change + 1e-20) + 2.0)


@part
def observe(station, sample, table, obs, i):
    """Write lane i's observation after `sample`."""
    D = DECAYS.shape[0]
    for j in range(STREAM):
        obs[i, j] = bounded(station.mean[j])
        obs[i, STREAM + j] = bounded(sample.frozen[j])
    c = 2 * STREAM
    for d in range(D):
        obs[i, c + d] = bounded(sample.curvature[d])
        obs[i, c + D + d] = station.lost[d]
    c += 2 * D
    obs[i, c] = bounded(0.5 * math.log1p(station.since))
    obs[i, c + 1] = station.noise[0]
    obs[i, c + 2] = station.noise[1]
    obs[i, c + 3] = station.widening
    obs[i, c + 4] = station.change
    for a in range(table.shape[0]):
        obs[i, c + 5 + a] = place(station, table, a)


@part
def earn(kind, clip, error, reference, relative, likelihood, count, scale):
    """The decision's reward from its sums over `count` samples."""
    if kind == DIFFERENCE:
        term = (reference - error) / count
    elif kind == RELATIVE:
        term = (reference - error) / (count * scale)
    elif kind == OVER_ORACLE:
        term = -relative / count
    elif kind == ABSOLUTE:
        term = -math.sqrt(error / count)
    else:
        term = likelihood / count
    if not math.isfinite(term):
        term = -clip
    return min(max(term, -clip), clip), term


@kernel
def decide(lanes, stations, models, tapes, table, rule, actions, obs, out, trail):
    """One decision of every lane: set parameters, filter `interval` samples, look, earn.

    Writes a row of `out` per lane (see the column names above): reward, whether the episode was
    terminated (the filter diverged) or truncated (the recording is over), and information. Lanes
    whose station is not `active` are left alone. Returns False, having
    done nothing, if an action is not a number.
    """
    interval, clip = rule[0].interval, rule[0].clip
    for i in range(lanes.shape[0]):
        for a in range(table.shape[0]):
            if stations[i].active and not math.isfinite(actions[i, a]):
                return False
    for i in range(lanes.shape[0]):
        lane, station = lanes[i], stations[i]
        if not station.active:
            continue
        which = station.which
        set_parameters(station, actions[i], table)
        error, reference, relative, likelihood = 0.0, 0.0, 0.0, 0.0
        nis, heard, lost, count = 0.0, 0.0, 0.0, 0.0
        last = min(station.k + interval, station.length)
        for k in range(station.k, last):
            sample = tapes[which, k]
            model = models[which, min(k, models.shape[1] - 1)]
            received = control(lane, model, sample, station)
            e = square_error(lane, sample, station)
            error += e
            reference += sample.reference_error
            relative += e / sample.oracle_variance
            if received > 0:
                likelihood += lane.log_likelihood
                nis += lane.nis / received
                heard += 1.0
            lost += 1.0 - received / lane.y.shape[0]
            count += 1.0
            if trail.shape[1] > 0:
                for a in range(lane.x.shape[0]):
                    trail[i, k, a] = lane.x[a]
        station.k = last
        sample = tapes[which, last - 1]
        note(station, lane, models[which, min(last - 1, models.shape[1] - 1)])
        observe(station, sample, table, obs, i)
        reward, term = earn(
            rule[0].kind, clip, error, reference, relative, likelihood, count, station.scale
        )
        failed = lane.diverged > 0
        out[i, REWARD] = -clip if failed else reward
        out[i, TERMINATED] = 1.0 if failed else 0.0
        out[i, TRUNCATED] = 1.0 if station.k >= station.length and not failed else 0.0
        out[i, RMSE] = math.sqrt(error / count)
        out[i, REFERENCE_RMSE] = math.sqrt(reference / count)
        out[i, NIS] = nis / heard if heard > 0.0 else math.nan
        out[i, LOST] = lost
        out[i, REGIME] = sample.regime
        out[i, TERM] = term
        for p in range(station.row.shape[0]):
            out[i, INFO + p] = station.row[p]
    return True


@kernel
def first_look(stations, table, obs):
    """Observations (N, ·) before the first decision: zeros, but for the parameters in force."""
    for i in range(stations.shape[0]):
        for a in range(table.shape[0]):
            obs[i, 2 * STREAM + COMMON + a] = place(stations[i], table, a)


@part
def suspect(doubt, lane, model, sample):
    """Watch a filter for a lost track; returns whether the innovations of a row agree on one.

    A row agrees where AGREEING innovations in succession are each FAR standard deviations of the
    model's R or more, and near the one before: noise and outliers scatter, the miss of a track that
    is lost does not. Beside it stands what the row's innovations usually are.
    """
    lost = False
    for j in range(lane.y.shape[0]):
        if not sample.lost[j]:
            e = lane.innovation[j] / math.sqrt(model.R[j, j])
            before = doubt.last[j]
            near = 2.0 * e * before > max(e * e, before * before)
            far = e * e > FAR * FAR
            doubt.run[j] = doubt.run[j] + 1 if near and far else (1 if far else 0)
            doubt.last[j] = e
            doubt.usual[j] += USUAL * (math.log(e * e + 1e-12) - doubt.usual[j])
            lost = lost or doubt.run[j] >= AGREEING
    return lost


@part
def missed(lane, model, sample, station):
    """How far a filter missed the fixes of a sample: a heavy-tailed cost, of the same scale for any filter."""
    s = 0.0
    for j in range(lane.y.shape[0]):
        if not sample.lost[j] and station.kind[j] == 0:
            s += math.log1p(lane.innovation[j] * lane.innovation[j] / model.R[j, j])
    return s


@kernel
def live(lanes, frozen, stations, models, samples, doubts, table, tally, look, obs):
    """One sample of a voyage under way; returns which filters have failed, as bits.

    1: the controlled filter has diverged, 2: the reference, 4: the frozen filter holds no numbers,
    8: the controlled filter seems to have lost the track (see `suspect`), 16: so does the reference.

    Args:
        lanes: (2,) the controlled filter and the reference filter.
        frozen: (1,) the frozen filter.
        stations: (2,) of the controlled filter, and of those beside it.
        models: (1,) for this sample.
        samples: (1,) a tape's record, of which y, lost and time are given.
        doubts: (3,) what is kept of the innovations of these three filters.
        table: as `decide` takes it: what the observation tells of the parameters in force.
        tally: (7,) sums over the decision so far, of which this sample becomes part.
        look: whether to write the observation.
        obs: (1, n) to write it to.
    """
    model, sample = models[0], samples[0]
    accompany(sample, model, stations[1], frozen[0], lanes[1])
    received = control(lanes[0], model, sample, stations[0])
    lost = 0
    if received > 0:
        tally[HEARD] += 1.0
        tally[NIS_SUM] += lanes[0].nis
        tally[FREEDOM] += received
        for i in range(2):
            lane = lanes[i]
            log_det = -2.0 * lane.log_likelihood - lane.nis - received * LOG_2PI
            tally[SCORE + i] += foretold(lane.nis, log_det, received)
            tally[MISS + i] += missed(lane, model, sample, stations[0])
            lost += suspect(doubts[i], lane, model, sample) << i
        suspect(doubts[2], frozen[0], model, sample)
    if look:
        note(stations[0], lanes[0], model)
        observe(stations[0], sample, table, obs, 0)
    failed = (lanes[0].diverged > 0) + 2 * (lanes[1].diverged > 0)
    return failed + 4 * (frozen[0].diverged == NUMERICAL) + 8 * lost
