"""Compiled core of the INS environment: what a lane sees, does and earns in one decision.

A *station* is what one lane keeps between decisions beside its filter. The reference filter runs over a
recording once, and so does its *twin*, for which nothing stands in: the squared errors of the one, and
what the other says while the Doppler log is silent, do not depend on the agent.
"""

from __future__ import annotations

import math

import numpy as np

from navgym.core.compile import kernel, part
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
from navgym.inertial.update import LOG_2PI
from navgym.ins import spaces
from navgym.ins.filtering import SKIP, advance
from navgym.ins.layout import AT, COLUMNS, FILL, STATES

PARAMETERS = len(spaces.KF)  # of the environment's space
DECAYS = np.array([0.8, 0.97])  # per received step
LOSS_DECAY = 0.98  # per step
VELOCITY_UNIT, CHANGE_UNIT, RATE_UNIT = 0.05, 0.3, 0.1  # m/s, m/s, rad/s: observations of about 1
JOLT_TIME = 30.0  # s, in which a change that the accelerometers foretell is forgotten
QUIET = 1.5  # s: a log that has spoken since is not silent
SIGNALS = 13
TWIN = 4  # of them what the twin says
RELATIVE, ABSOLUTE, LIKELIHOOD, POSITION = range(4)
SCORES = 3  # of the reference: squared errors of position and velocity, log-likelihood
(
    POSITION_RMSE, REFERENCE_POSITION, VELOCITY_RMSE, REFERENCE_VELOCITY, NIS, SILENCE, REGIME, TERM,
) = range(INFORMATION, INFORMATION + 8)  # fmt: skip
PHYSICAL = INFORMATION + 8

f8, i8 = np.float64, np.int64
RULE = np.dtype(
    [
        ("interval", i8), ("kind", i8), ("clip", f8),
        ("columns", i8, (len(COLUMNS),)),  # where the filter's parameters stand in a row
        ("off", f8, (len(COLUMNS),)),  # values of those that stand nowhere
        ("no_gate", f8),  # from which on a gate is off
    ]
)  # fmt: skip
STATION = np.dtype(
    [
        ("active", i8), ("which", i8), ("k", i8), ("length", i8), ("row", f8, (PARAMETERS,)),
        ("mean", f8, (len(DECAYS),)),  # log NIS per degree of freedom
        ("lost", f8),  # share of steps in which the Doppler log should have spoken and did not, lately
        ("rate", f8),  # rad/s
        ("shake", f8),  # half the logarithm of the vibration meter over the model
        ("twin", f8, (TWIN,)),
        ("twin_body", f8, (2,)),  # the twin's horizontal body velocity, m/s
        ("jolt", f8, (2,)),  # by how much that has changed lately, while the log is silent
    ]
)  # fmt: skip


@part
def inform(lane, station, rule, gate):
    """Put a station's parameters into the lane's row; `gate` is that column."""
    for p in range(len(COLUMNS)):
        at = rule.columns[p]
        lane.row[p] = station.row[at] if at >= 0 else rule.off[p]
    if lane.row[gate] >= rule.no_gate:
        lane.row[gate] = math.inf


@part
def change_of_velocity(lane):
    """By how much the body velocity differs from what the Doppler log last said, m/s; 0 before it has."""
    if math.isnan(lane.held_time[0]):
        return 0.0
    C, v, total = lane.attitude, lane.v, 0.0
    for i in range(2):
        d = C[0, i] * v[0] + C[1, i] * v[1] + C[2, i] * v[2] - lane.held[0, i]
        total += d * d
    return math.sqrt(total)


@part
def spread_of_velocity(lane):
    """Half the logarithm of the horizontal velocity's variance over that of a usual one."""
    variance = 0.5 * (lane.P[AT.V, AT.V] + lane.P[AT.V + 1, AT.V + 1])
    return bounded(0.5 * math.log(variance / VELOCITY_UNIT**2 + 1e-9))


@part
def watch(station, lane, model, tape):
    """Move the features by what the filter says of its last step."""
    if lane.components > 0:
        value = log_square(lane.nis / lane.components)
        for d in range(DECAYS.shape[0]):
            station.mean[d] += (1.0 - DECAYS[d]) * (value - station.mean[d])
    silent = 1.0 if lane.silence > 2.0 else 0.0
    station.lost += (1.0 - LOSS_DECAY) * (silent - station.lost)
    trace = tape.dR[0, 0] + tape.dR[1, 1] + tape.dR[2, 2]
    station.rate = math.acos(min(max(0.5 * (trace - 1.0), -1.0), 1.0)) / model.T
    station.shake = log_square(min(tape.shake / model.accelerometer, 1e6))


@part
def observe(station, lane, table, obs, i):
    """Write lane i's observation."""
    heard = 0.0 if math.isnan(lane.held_time[0]) else 1.0
    since = lane.silence if heard > 0.0 else 0.0
    obs[i, 0] = bounded(math.log1p(max(since, 0.0)))
    obs[i, 1] = bounded(heard * lane.turned / (0.5 * math.pi))
    obs[i, 2] = bounded(change_of_velocity(lane) / CHANGE_UNIT)
    obs[i, 3] = station.twin[0]
    obs[i, 4] = spread_of_velocity(lane)
    obs[i, 5] = station.twin[1]
    obs[i, 6] = station.twin[2]
    obs[i, 7] = station.twin[3]
    for d in range(DECAYS.shape[0]):
        obs[i, 8 + d] = bounded(station.mean[d])
    obs[i, 10] = station.lost
    obs[i, 11] = bounded(station.rate / RATE_UNIT)
    obs[i, 12] = station.shake
    for a in range(table.shape[0]):
        obs[i, SIGNALS + a] = place(station, table, a)


@part
def score(lane, tape, out):
    """Squared errors of the horizontal position and velocity after a step, into out; NaN without truth."""
    out[0], out[1] = 0.0, 0.0
    for a in range(2):
        out[0] += (lane.x[AT.R + a] - tape.truth[a]) ** 2
        out[1] += (lane.x[AT.V + a] - tape.truth[3 + a]) ** 2


@part
def ahead(lane, tapes, scores, k):
    """By how much the squared error of the position is larger than the reference's after k steps; 0 where
    that is not known.
    """
    if k == 0 or not math.isfinite(tapes[k - 1].truth[0]):
        return 0.0
    error = -scores[k - 1, 0]
    for a in range(2):
        error += (lane.x[AT.R + a] - tapes[k - 1].truth[a]) ** 2
    return error


@part
def jolt(station, twin, T):
    """What the accelerometers say of a change of speed: biases drift, and are forgotten; a change is not
    at once.
    """
    silent, keep, total = twin.silence > QUIET, math.exp(-T / JOLT_TIME), 0.0
    C, v = twin.attitude, twin.v
    for i in range(2):
        now = C[0, i] * v[0] + C[1, i] * v[1] + C[2, i] * v[2]
        change = now - station.twin_body[i]
        station.jolt[i] = keep * station.jolt[i] + change if silent else 0.0
        station.twin_body[i] = now
        total += station.jolt[i] ** 2
    station.twin[2] = bounded(math.sqrt(total) / CHANGE_UNIT)
    station.twin[3] = max(station.twin[3], station.twin[2]) if silent else 0.0


@part
def reckon(twin, lane, model, sensors, tape, events, rule, report, station):
    """A step of the twin of the reference filter `lane`: nothing stands in. Fills the station's `twin`.

    What it says is what the IMU alone says of a silent log. A twin that fails goes on from the other.
    """
    for p in range(len(COLUMNS)):
        twin.row[p] = lane.row[p]
    twin.row[FILL] = SKIP
    advance(twin, model, sensors, tape, events, rule, report)
    station.twin[0] = bounded(change_of_velocity(twin) / CHANGE_UNIT)
    station.twin[1] = spread_of_velocity(twin)
    jolt(station, twin, model.T)


@kernel
def rehearse(
    lanes, twins, stations, models, sensors, tapes, events, filter_rules, rules, gate, start, reports,
    checkpoints, starts, scores, told, means,
):  # fmt: skip
    """Run the reference filter and its twin over whole recordings.

    Args:
        lanes: (R,) at the start of each.
        twins: (R,) likewise.
        stations: (R,) with the reference's parameters.
        models: (R,).
        sensors: (R, SENSORS).
        tapes: (R, K).
        events: (R, E).
        filter_rules: (1,).
        rules: (1,).
        gate: column of the gate.
        start: (R,) steps after which lanes of the environment begin.
        reports: (1,) scratch.
        checkpoints: (R,) to be filled with the lane as it is then.
        starts: (R,) to be filled with the station as it is then.
        scores: (R, K, SCORES) to be filled.
        told: (R, K, TWIN) to be filled with what the twin says.
        means: (R, 2) to be filled with the mean squared errors of position and velocity from `start` on.
    """
    for i in range(len(lanes)):
        lane, station = lanes[i], stations[i]
        inform(lane, station, rules[0], gate)
        count = 0.0
        for k in range(station.length):
            if k == start[i]:
                station.k = k
                checkpoints[i] = lanes[i]
                starts[i] = stations[i]
            advance(
                lane, models[i], sensors[i], tapes[i, k], events[i], filter_rules[0], reports[0]
            )
            watch(station, lane, models[i], tapes[i, k])
            reckon(
                twins[i], lane, models[i], sensors[i], tapes[i, k], events[i], filter_rules[0],
                reports[0], station,
            )  # fmt: skip
            if twins[i].diverged > 0:
                twins[i] = lanes[i]
            score(lane, tapes[i, k], scores[i, k])
            scores[i, k, 2] = lane.log_likelihood
            for s in range(TWIN):
                told[i, k, s] = station.twin[s]
            if k >= start[i] and math.isfinite(scores[i, k, 1]):
                for s in range(2):
                    means[i, s] += scores[i, k, s]
                count += 1.0
        for s in range(2):
            means[i, s] = means[i, s] / count if count > 0.0 else 1.0


@kernel
def decide(
    lanes, stations, models, sensors, tapes, events, scores, told, means, filter_rules, rules, gate, reports,
    table, actions, obs, out, trail,
):  # fmt: skip
    """One decision of every lane: set parameters, filter `interval` steps, look, earn.

    Writes a row of `out` per lane (see the column names above). Lanes whose station is not `active`
    are left alone. Returns False, having done nothing, if an action is not a number.
    """
    rule = rules[0]
    for i in range(lanes.shape[0]):
        for a in range(table.shape[0]):
            if stations[i].active and not math.isfinite(actions[i, a]):
                return False
    error = np.zeros(2)
    for i in range(lanes.shape[0]):
        lane, station = lanes[i], stations[i]
        if not station.active:
            continue
        w = station.which
        set_parameters(station, actions[i], table)
        inform(lane, station, rule, gate)
        position, velocity, reference_position, reference_velocity = 0.0, 0.0, 0.0, 0.0
        likelihood, nis, heard, count = 0.0, 0.0, 0.0, 0.0
        first, last = station.k, min(station.k + rule.interval, station.length)
        before = ahead(lane, tapes[w], scores[w], first)
        for k in range(first, last):
            tape = tapes[w, k]
            advance(lane, models[w], sensors[w], tape, events[w], filter_rules[0], reports[0])
            watch(station, lane, models[w], tape)
            for s in range(TWIN):
                station.twin[s] = told[w, k, s]
            score(lane, tape, error)
            if math.isfinite(tape.truth[0]):
                position += error[0]
                velocity += error[1]
                reference_position += scores[w, k, 0]
                reference_velocity += scores[w, k, 1]
                count += 1.0
            if lane.components > 0:
                likelihood += lane.log_likelihood - scores[w, k, 2]
                nis += lane.nis / lane.components
                heard += 1.0
            if trail.shape[1] > 0:
                for a in range(STATES):
                    trail[i, k, a] = lane.x[a]
                trail[i, k, STATES] = spread_of_velocity(lane)
        station.k = last
        observe(station, lane, table, obs, i)
        scale = 1.0 / count if count > 0.0 else 0.0
        if rule.kind == RELATIVE:
            term = scale * (reference_velocity - velocity) / max(means[w, 1], 1e-8)
        elif rule.kind == POSITION:
            grown = ahead(lane, tapes[w], scores[w], last) - before
            term = -grown / max(means[w, 0], 1e-6)
        elif rule.kind == ABSOLUTE:
            term = -math.sqrt(scale * velocity)
        else:
            term = likelihood / (last - first)
        failed = lane.diverged > 0
        sound = math.isfinite(term) and not failed
        out[i, REWARD] = min(max(term, -rule.clip), rule.clip) if sound else -rule.clip
        out[i, TERMINATED] = 1.0 if failed else 0.0
        out[i, TRUNCATED] = 1.0 if station.k >= station.length and not failed else 0.0
        out[i, POSITION_RMSE] = math.sqrt(position / count)  # NaN without truth
        out[i, REFERENCE_POSITION] = math.sqrt(reference_position / count)  # NaN without truth
        out[i, VELOCITY_RMSE] = math.sqrt(velocity / count)  # NaN without truth
        out[i, REFERENCE_VELOCITY] = math.sqrt(reference_velocity / count)  # NaN without truth
        out[i, NIS] = nis / heard if heard > 0.0 else math.nan
        out[i, SILENCE] = lane.silence
        out[i, REGIME] = tapes[w, last - 1].regime
        out[i, TERM] = term
        for p in range(PARAMETERS):
            out[i, PHYSICAL + p] = station.row[p]
    return True


@kernel
def first_look(stations, lanes, table, obs):
    """Observations (N, ·) before the first decision."""
    for i in range(stations.shape[0]):
        observe(stations[i], lanes[i], table, obs, i)


@kernel
def live(
    lanes,
    stations,
    models,
    sensors,
    tapes,
    events,
    filter_rules,
    rules,
    gate,
    reports,
    table,
    tally,
    look,
    obs,
):
    """One filter step of a voyage under way; returns which of the two lanes have diverged, as bits.

    Args:
        lanes: (3,) the controlled filter, the reference filter, and its twin.
        stations: (2,) of the first two.
        models: (1,).
        sensors: (SENSORS,).
        tapes: (1,) the step.
        events: (E,) of the step.
        filter_rules: (1,).
        rules: (1,).
        gate: column of the gate.
        reports: (1,) scratch.
        table: as `decide` takes it.
        tally: (7,) sums over the decision so far, of which this step becomes part.
        look: whether to write the observation.
        obs: (1, n) to write it to.
    """
    tape = tapes[0]
    for i in range(2):
        inform(lanes[i], stations[i], rules[0], gate)
        advance(lanes[i], models[0], sensors, tape, events, filter_rules[0], reports[0])
        watch(stations[i], lanes[i], models[0], tape)
    reckon(
        lanes[2],
        lanes[1],
        models[0],
        sensors,
        tape,
        events,
        filter_rules[0],
        reports[0],
        stations[0],
    )
    if lanes[2].diverged > 0:
        lanes[2] = lanes[1]
    received = lanes[0].components
    if received > 0:
        tally[HEARD] += 1.0
        tally[NIS_SUM] += lanes[0].nis
        tally[FREEDOM] += received
        for i in range(2):
            log_det = -2.0 * lanes[i].log_likelihood - lanes[i].nis - received * LOG_2PI
            tally[SCORE + i] += foretold(lanes[i].nis, log_det, received)
    if look:
        observe(stations[0], lanes[0], table, obs, 0)
    return (lanes[0].diverged > 0) + 2 * (lanes[1].diverged > 0)
