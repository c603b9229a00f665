"""One step of the INS filters, and runs over recordings, compiled: move, then each measurement in turn.

All filters are this one; they differ in what a block of rows is worth (`navgym.inertial.block_update`) and
in what stands in for a Doppler log that is silent.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import kernel, part
from navgym.core.health import SPIKE, settle, watch_power
from navgym.inertial.block_update import (
    apply_block,
    judge_block,
    project_block,
    remember_nothing,
    take_solution,
    weigh_bank,
    weigh_correntropy,
    weigh_gate,
    weigh_student,
    weigh_variational,
)
from navgym.inertial.preintegration import INCREMENT
from navgym.ins.error_state import (
    HELD,
    LANE,
    answer,
    keep_prior,
    navigate,
    spread_errors,
    take_over,
)
from navgym.ins.kinds import DVL_KIND, FIRST_ROW, INNOVATIONS, KINDS
from navgym.ins.layout import (
    FILL,
    FILL_GROWTH,
    FILL_TURN,
    FILL_VARIANCE,
    FORGET,
    FREEDOM,
    GATE,
    IMU,
    ITERATIONS,
    METER,
    STATES,
    WIDTH,
)
from navgym.ins.measurements import linearise, radii, scale_of

f8, i8 = np.float64, np.int64
NAVIGATION = 9  # columns of the truth: position, velocity, roll, pitch, heading
TAPE = np.dtype(
    [
        *INCREMENT,
        ("gap", f8),  # s of the step that were filled in
        ("shake", f8),  # white noise seen in the accelerometers, m²/s³
        (
            "imu_scale",
            f8,
        ),  # true variance of the IMU's white noise over the model's; NaN: not known
        ("first", i8),  # events of the step
        ("count", i8),
        ("time", f8),
        ("truth", f8, (NAVIGATION,)),
        ("regime", f8),
    ]
)
TRUST, STUDENT, CORRENTROPY, VARIATIONAL, BANK, ORACLE = range(6)
RULE = np.dtype([("kind", i8), ("judged", i8)])
REPORT = np.dtype(
    [
        ("innovation", f8, (INNOVATIONS,)),  # measured − predicted, of each kind's last; NaN: none
        ("weights", f8, (len(KINDS),)),  # by what R was divided
        ("nis", f8),
        ("log_likelihood", f8),
        ("components", i8),
    ]
)
SKIP, HOLD, EXTRAPOLATE = range(3)
STUDENT_ITERATIONS = 4
METER_MOST = 1e4  # the vibration meter multiplies the IMU's noise at most so much


def begin(lanes: NDArray[Any], models: NDArray[Any], rows: Array) -> None:
    """Put lanes (N,) at the start of recordings with models (N,); rows (N, columns) of parameters."""
    lanes[...] = np.zeros((), LANE)
    lanes["row"] = rows
    start = models["start"]
    lanes["place"], lanes["v"] = start[:, :3], start[:, 3:6]
    lanes["attitude"] = start[:, 6:].reshape(-1, 3, 3)
    diagonal = np.arange(STATES)
    lanes["P"][:, diagonal, diagonal] = models["deviation"] ** 2
    lanes["held_time"] = np.nan
    lanes["length"] = 2**62
    remember_nothing(lanes)


@part
def use(lane, rule, event):
    """What the block is worth, by the filter's rule."""
    judge_block(lane)
    kind = rule.kind
    if kind == STUDENT:
        weigh_student(lane, lane.row[FREEDOM], STUDENT_ITERATIONS)
    elif kind == CORRENTROPY:
        weigh_correntropy(lane, lane.row[WIDTH])
    elif kind == VARIATIONAL:
        weigh_variational(lane, event.sensor, lane.row[FORGET], int(lane.row[ITERATIONS]))
    elif kind == BANK:
        weigh_bank(lane, event.sensor)
    else:
        weigh_gate(lane, lane.row[GATE])


@part
def remember_velocity(lane, event):
    """The Doppler log has spoken: what a fill will look back on."""
    for a in range(HELD - 1, 0, -1):
        lane.held_time[a] = lane.held_time[a - 1]
        for i in range(3):
            lane.held[a, i] = lane.held[a - 1, i]
    lane.held_time[0] = event.time
    lane.turned = 0.0
    for i in range(3):
        lane.held[0, i] = event.z[i]
        for j in range(3):
            lane.held_attitude[i, j] = lane.attitude[i, j]


@part
def watch_turn(lane, time):
    """How far the vehicle has turned since the Doppler log last spoke, and for how long it has not."""
    trace = 0.0
    for i in range(3):
        for j in range(3):
            trace += lane.held_attitude[i, j] * lane.attitude[i, j]
    angle = math.acos(min(max(0.5 * (trace - 1.0), -1.0), 1.0))
    lane.turned = max(lane.turned, angle)
    lane.silence = time - lane.held_time[0]


@part
def stand_in(lane, event):
    """A velocity for a lost one, into r and R; returns whether there is one.

    It is the sensor's own body velocity that is held or extrapolated (QIVBF eq. 27-28, corrected): INS −
    DVL holds the INS's error, which is the state.
    """
    if lane.row[FILL] == SKIP or math.isnan(lane.held_time[0]):
        return False
    if lane.turned > lane.row[FILL_TURN] * math.pi / 180.0:
        return False
    variance = lane.row[FILL_VARIANCE] + lane.row[FILL_GROWTH] * (event.time - lane.held_time[0])
    if lane.row[FILL] == HOLD:
        for i in range(3):
            lane.r[i] -= lane.held[0, i]
    else:
        if math.isnan(lane.held_time[HELD - 1]):
            return False
        total = 0.0
        for a in range(HELD):
            share = 1.0
            for b in range(HELD):
                if b != a:
                    share *= (event.time - lane.held_time[b]) / (
                        lane.held_time[a] - lane.held_time[b]
                    )
            total += share * share
            for i in range(3):
                lane.r[i] -= share * lane.held[a, i]
        variance *= total
    for i in range(3):
        lane.R[i] = variance
    return True


@part
def hear(lane, model, sensors, event, rule, meridian, across):
    """One measurement, or the lack of one; returns its NIS, or NaN."""
    sensor = sensors[event.sensor]
    if event.lost and (sensor.kind != DVL_KIND or lane.row[FILL] == SKIP):
        return math.nan
    linearise(lane, model, event, sensor)
    if event.lost:
        if not stand_in(lane, event):
            return math.nan
        project_block(lane)
        judge_block(lane)
        take_solution(lane)
    else:
        scale = scale_of(lane, sensor.kind)
        if rule.kind == ORACLE and event.scale > 0.0:
            scale = event.scale
        for i in range(lane.rows):
            lane.R[i] *= scale
        project_block(lane)
        use(lane, rule, event)
    apply_block(lane)
    take_over(lane, meridian, across)
    if event.lost:
        return math.nan
    if sensor.kind == DVL_KIND:
        remember_velocity(lane, event)
    return lane.block_nis


@kernel
def advance(lane, model, sensors, tape, events, rule, report):
    """One filter step on a tape's record and its events.

    Args:
        lane: LANE.
        model: MODEL.
        sensors: (SENSORS,).
        tape: TAPE.
        events: (E,) of the recording.
        rule: RULE.
        report: REPORT to be filled where the rule says so.
    """
    scale = lane.row[IMU]
    if rule.kind == ORACLE and tape.imu_scale > 0.0:
        scale = tape.imu_scale
    elif lane.row[METER] > 0.0:
        scale *= min(max(tape.shake / model.accelerometer, 1.0), METER_MOST)
    navigate(lane, model, tape)
    spread_errors(lane, model, tape, scale)
    if lane.keeps > 0:
        keep_prior(lane)
    watch_turn(lane, tape.time)
    nis, log, count, power = 0.0, 0.0, 0, 0.0
    if rule.judged:
        for c in range(INNOVATIONS):
            report.innovation[c] = math.nan
        for c in range(report.weights.shape[0]):
            report.weights[c] = math.nan
    if tape.count > 0:
        meridian, across = radii(lane)
        for e in range(tape.first, tape.first + tape.count):
            event = events[e]
            found = hear(lane, model, sensors, event, rule, meridian, across)
            if math.isnan(found):
                if not event.lost:
                    lane.diverged = 2
                continue
            nis += found
            log += lane.block_log
            count += lane.rows
            power += min(found, SPIKE)
            if rule.judged:
                kind = sensors[event.sensor].kind
                report.weights[kind] = lane.weight
                for c in range(lane.rows):
                    report.innovation[FIRST_ROW[kind] + c] = -lane.r[c]
    lane.components = count
    lane.nis = nis if count > 0 else math.nan
    lane.log_likelihood = log if count > 0 else math.nan
    answer(lane, model)
    if count > 0:
        watch_power(lane, power, count)
    settle(lane)
    lane.k += 1
    if rule.judged:
        report.nis, report.log_likelihood = lane.nis, lane.log_likelihood
        report.components = count


@kernel
def run(
    lanes, models, sensors, tapes, events, rules, table, interval, outputs, reports, covariances
):
    """Filter each lane to its `length` or its tape's end.

    Args:
        lanes: (N,) as `begin` or an earlier run left them.
        models: (N,) MODEL.
        sensors: (N, SENSORS).
        tapes: (N, K).
        events: (N, E).
        rules: (1,).
        table: (N or 1, intervals, columns) parameters; row k // interval holds in step k, the last to the end.
        interval: steps per row of `table`.
        outputs: (N, K, STATES).
        reports: (N, K) REPORT, or (N, 1), of which nothing is kept.
        covariances: (N, K or 0, STATES, STATES).
    """
    rule = rules[0]
    for i in range(len(lanes)):
        lane = lanes[i]
        for k in range(lane.k, min(lane.length, tapes.shape[1])):
            row = min(k // interval, table.shape[1] - 1)
            for p in range(table.shape[2]):
                lane.row[p] = table[min(i, table.shape[0] - 1), row, p]
            report = reports[i, min(k, reports.shape[1] - 1)]
            advance(lane, models[i], sensors[i], tapes[i, k], events[i], rule, report)
            for a in range(STATES):
                outputs[i, k, a] = lane.x[a]
            if covariances.shape[1] > 0:
                for a in range(STATES):
                    for b in range(STATES):
                        covariances[i, k, a, b] = lane.P[a, b]
