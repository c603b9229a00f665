"""Compiled core of the deck environment: what a lane sees, does and earns in one decision.

A *station* is what one lane keeps between decisions beside its filter. *Scores* are the squared errors of
the reference filter at each step of a recording; they do not depend on the agent, so they are
computed once.
"""

from __future__ import annotations

import math

import numpy as np

from navgym.core.compile import kernel, part
from navgym.deck import alignment, spaces
from navgym.deck.alignment import AT, MEASUREMENTS, STATES
from navgym.deck.mechanization import mechanize_next
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
from navgym.inertial.flexure import ARCMIN

PARAMETERS = len(spaces.IDAM)  # of the environment's space
DECAYS = np.array([0.8, 0.97, 0.995])  # per filter step: .2, 1.6 and 10 s at 20 Hz
EVENT_DECAY = 0.8  # per event, of the persistence of large innovations
SEA_DECAYS = np.array([0.995, 0.99917])  # 10 and 60 s at 20 Hz
POWER_FLOOR = 1e-4  # velocity noise is often set a hundred times wider than what is seen
ALARM = 4.0  # |innovation| over its standard deviation that counts as an event
GROUP = len(DECAYS) + 3  # signals of one group of channels: velocity, rate
SEA = 2
MEAN_SECONDS = 60.0  # memory of the running mean of θ's error that theta_ac takes off

COMPOSITE, ABSOLUTE, LIKELIHOOD = range(3)
SCORES = 3  # squared errors of θ̇, of θ less its running mean, and of θ: arcmin²/s², arcmin²
LOG_LIKELIHOOD = SCORES  # a fourth column of the reference's scores
(
    RATE_RMSE, REFERENCE_RATE, AC_RMSE, REFERENCE_AC, THETA_RMSE, REFERENCE_THETA, WEIGHT, POWER,
    REGIME, TERM,
) = range(INFORMATION, INFORMATION + 10)  # fmt: skip
PHYSICAL = INFORMATION + 10

f8, i8 = np.float64, np.int64
RULE = np.dtype(
    [
        ("interval", i8), ("kind", i8), ("clip", f8), ("ac_weight", f8), ("theta_price", f8),
        ("first_group", i8),  # 0: velocity and rate channels are observed, 1: the rates only
        ("columns", i8, (len(alignment.COLUMNS),)),  # where the filter's parameters stand in a row
    ]
)  # fmt: skip
STATION = np.dtype(
    [
        ("active", i8),
        ("which", i8),
        ("k", i8),
        ("length", i8),
        ("row", f8, (PARAMETERS,)),
        ("mean", f8, (2, GROUP)),
        ("sea", f8, (SEA,)),
        ("event", f8, (MEASUREMENTS,)),  # the last innovation where it was an alarm, else 0
        ("drift", f8, (3,)),  # running mean of θ's error, arcmin
    ]
)


@part
def watch(station, lane, model):
    """Move the features by what the filter says of its last step."""
    for g in range(2):
        square, alarms, weight, count = 0.0, 0.0, 0.0, 0.0
        for c in range(3 * g, 3 * g + 3):
            if not lane.used[c]:
                station.event[c] = 0.0
                continue
            e = lane.innovation[c] / math.sqrt(lane.variance[c])
            if station.event[c] != 0.0:
                ratio = min(max(e / station.event[c], -1.0), 1.0)
                if math.isfinite(ratio):
                    station.mean[g, 4] += (1.0 - EVENT_DECAY) * (ratio - station.mean[g, 4])
            loud = abs(e) > ALARM
            station.event[c] = e if loud else 0.0
            square += e * e
            alarms += 1.0 if loud else 0.0
            weight += lane.weight[c]
            count += 1.0
        if count > 0.0:
            value = bounded(0.5 * math.log(square / count + POWER_FLOOR))
            for d in range(DECAYS.shape[0]):
                station.mean[g, d] += (1.0 - DECAYS[d]) * (value - station.mean[g, d])
            station.mean[g, 3] += (1.0 - DECAYS[1]) * (alarms / count - station.mean[g, 3])
            station.mean[g, 5] += (1.0 - DECAYS[1]) * (1.0 - weight / count - station.mean[g, 5])
    motion = 0.0
    for a in range(3):
        motion += (lane.x[AT.RATE + a] / model.start[AT.RATE + a]) ** 2 / 3.0
    for d in range(SEA):
        station.sea[d] += (1.0 - SEA_DECAYS[d]) * (min(motion, 1e6) - station.sea[d])


@part
def score(station, lane, tape, dt, out):
    """Squared errors of the lane after a step, into out (3,): θ̇, θ_ac, θ."""
    keep = math.exp(-dt / MEAN_SECONDS)
    out[0], out[1], out[2] = 0.0, 0.0, 0.0
    for a in range(3):
        rate = (lane.x[AT.RATE + a] - tape.theta_rate[a]) / ARCMIN
        theta = (lane.x[AT.THETA + a] - tape.theta[a]) / ARCMIN
        station.drift[a] = keep * station.drift[a] + (1.0 - keep) * theta
        out[0] += rate * rate
        out[1] += (theta - station.drift[a]) ** 2
        out[2] += theta * theta


@part
def filter_step(station, lane, model, tape, filter_rule, rule):
    """The filter on one step, with the parameters in force."""
    for p in range(lane.row.shape[0]):
        lane.row[p] = station.row[rule.columns[p]]
    alignment.step(lane, model, tape, filter_rule)
    watch(station, lane, model)


@kernel
def rehearse(
    lanes, stations, models, tapes, filter_rules, rules, start, checkpoints, starts, scores, means
):
    """Run the reference filter over whole recordings.

    Args:
        lanes: (R,) at the start of each.
        stations: (R,) with the reference's parameters.
        models: (R, 1).
        tapes: (R, K).
        filter_rules: (1,).
        rules: (1,).
        start: (R,) steps after which lanes of the environment begin.
        checkpoints: (R,) to be filled with the lane as it is then.
        starts: (R,) to be filled with the station as it is then.
        scores: (R, K, 4) to be filled; the last is the log-likelihood, if the filter judges itself.
        means: (R, 3) to be filled with the mean scores from `start` on.
    """
    for i in range(len(lanes)):
        lane, station, model = lanes[i], stations[i], models[i, 0]
        for k in range(station.length):
            if k == start[i]:
                station.k = k
                checkpoints[i] = lanes[i]
                starts[i] = stations[i]
            filter_step(station, lane, model, tapes[i, k], filter_rules[0], rules[0])
            score(station, lane, tapes[i, k], model.dt, scores[i, k])
            scores[i, k, LOG_LIKELIHOOD] = lane.log_likelihood
            for s in range(SCORES):
                if k >= start[i]:
                    means[i, s] += scores[i, k, s] / (station.length - start[i])


@part
def observe(station, rule, table, obs, i):
    """Write lane i's observation."""
    c = 0
    for g in range(rule.first_group, 2):
        for s in range(GROUP):
            obs[i, c] = bounded(station.mean[g, s])
            c += 1
    for d in range(SEA):
        obs[i, c] = log_square(station.sea[d])
        c += 1
    for a in range(table.shape[0]):
        obs[i, c + a] = place(station, table, a)


@part
def relative(own, reference, mean):
    """By how much of the reference's mean an error exceeds the reference's."""
    return (own - reference) / max(mean, 1e-12)


@kernel
def decide(
    lanes,
    stations,
    models,
    tapes,
    scores,
    means,
    filter_rules,
    rules,
    table,
    actions,
    obs,
    out,
    trail,
):
    """One decision of every lane: set parameters, filter `interval` steps, look, earn.

    Writes a row of `out` per lane (see the column names above). Lanes whose station is not `active`
    are left alone. Returns False, having done nothing, if an action is not a number.
    """
    rule = rules[0]
    for i in range(lanes.shape[0]):
        for a in range(table.shape[0]):
            if stations[i].active and not math.isfinite(actions[i, a]):
                return False
    error = np.zeros(SCORES)
    for i in range(lanes.shape[0]):
        lane, station, model = lanes[i], stations[i], models[i, 0]
        if not station.active:
            continue
        which = station.which
        set_parameters(station, actions[i], table)
        own, reference = np.zeros(SCORES), np.zeros(SCORES)
        likelihood, weight, power, heard = 0.0, 0.0, 0.0, 0.0
        last = min(station.k + rule.interval, station.length)
        count = last - station.k
        for k in range(station.k, last):
            tape = tapes[which, k]
            filter_step(station, lane, model, tape, filter_rules[0], rule)
            score(station, lane, tape, model.dt, error)
            for s in range(SCORES):
                own[s] += error[s] / count
                reference[s] += scores[which, k, s] / count
            gain = lane.log_likelihood - scores[which, k, LOG_LIKELIHOOD]
            if rule.kind == LIKELIHOOD and math.isfinite(gain):
                likelihood += gain / count
            for c in range(MEASUREMENTS):
                if lane.used[c]:
                    weight += lane.weight[c]
                    power += lane.innovation[c] ** 2 / lane.variance[c]
                    heard += 1.0
            if trail.shape[1] > 0:
                for a in range(STATES):
                    trail[i, k, a] = lane.x[a]
                for c in range(MEASUREMENTS):
                    trail[i, k, STATES + c] = lane.weight[c]
        station.k = last
        observe(station, rule, table, obs, i)
        if rule.kind == COMPOSITE:
            term = -relative(own[0], reference[0], means[which, 0])
            term -= rule.ac_weight * relative(own[1], reference[1], means[which, 1])
            term -= rule.theta_price * max(relative(own[2], reference[2], means[which, 2]), 0.0)
        elif rule.kind == ABSOLUTE:
            term = -math.sqrt(own[0])
        else:
            term = likelihood
        failed = lane.diverged > 0
        sound = math.isfinite(term) and not failed
        out[i, REWARD] = min(max(term, -rule.clip), rule.clip) if sound else -rule.clip
        out[i, TERMINATED] = 1.0 if failed else 0.0
        out[i, TRUNCATED] = 1.0 if station.k >= station.length and not failed else 0.0
        for s in range(SCORES):
            out[i, RATE_RMSE + 2 * s] = math.sqrt(own[s])
            out[i, RATE_RMSE + 2 * s + 1] = math.sqrt(reference[s])
        out[i, WEIGHT] = weight / heard if heard > 0.0 else math.nan
        out[i, POWER] = power / heard if heard > 0.0 else math.nan
        out[i, REGIME] = tapes[which, last - 1].regime
        out[i, TERM] = term
        for p in range(PARAMETERS):
            out[i, PHYSICAL + p] = station.row[p]
    return True


@kernel
def first_look(stations, rules, table, obs):
    """Observations (N, ·) before the first decision."""
    for i in range(stations.shape[0]):
        observe(stations[i], rules[0], table, obs, i)


@part
def rate_surprise(lane):
    """Sums over the used rate channels, each by itself: squared innovation over S, log S, count."""
    square, log_det, count = 0.0, 0.0, 0.0
    for c in range(3, MEASUREMENTS):
        if lane.used[c]:
            square += lane.innovation[c] ** 2 / lane.variance[c]
            log_det += math.log(lane.variance[c])
            count += 1.0
    return square, log_det, count


@kernel
def live(
    lanes, stations, models, tapes, filter_rules, rules, table, samples, filled, lever, moving,
    disturbance, tally, look, obs,
):  # fmt: skip
    """One filter step of a voyage under way; returns which of the two lanes have diverged, as bits.

    Args:
        lanes: (2,) the controlled filter and the reference filter.
        stations: (2,) of both.
        models: (1,).
        tapes: (1,) to be filled with what the step's samples amount to.
        filter_rules: (1,).
        rules: (1,).
        table: as `decide` takes it: what the observation tells of the parameters in force.
        samples: (4, HISTORY + per, 3) increments in the order of a recording's fields: the
            step's samples, and those before it.
        filled: (HISTORY + per,) whether a sample was filled in.
        lever: (3,) m.
        moving: (5, 4) what the mechanisation carries along.
        disturbance: (6,) errors of the step's transmitted quantities; zeros at sea.
        tally: (7,) sums over the decision so far, over the rate channels; this step becomes part.
        look: whether to write the observation.
        obs: (1, n) to write it to.
    """
    model, tape = models[0], tapes[0]
    mechanize_next(samples, filled, lever, model.interval, moving, disturbance, tape)
    for i in range(2):
        filter_step(stations[i], lanes[i], model, tape, filter_rules[0], rules[0])
    for i in range(2):
        square, log_det, count = rate_surprise(lanes[i])
        if count > 0.0:
            tally[SCORE + i] += foretold(square, log_det, count)
            if i == 0:
                tally[HEARD] += 1.0
                tally[NIS_SUM] += square
                tally[FREEDOM] += count
    if look:
        observe(stations[0], rules[0], table, obs, 0)
    return (lanes[0].diverged > 0) + 2 * (lanes[1].diverged > 0)
