"""Recordings made ready for the kernels: tapes of increments, events of sensors, packed models."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import kernel
from navgym.inertial.blocks import SENSORS
from navgym.inertial.earth import radii_of_curvature
from navgym.inertial.preintegration import preintegrate
from navgym.inertial.rotation import euler_matrix, exponential, multiply
from navgym.ins.error_state import MODEL
from navgym.ins.filtering import NAVIGATION
from navgym.ins.kinds import KINDS, NAMES
from navgym.ins.layout import LAYOUT
from navgym.ins.measurements import EVENT, SENSOR
from navgym.ins.model import InsModel
from navgym.ins.recording import InertialRecording

AROUND = 2  # samples on each side of an event that its rate is the mean of
EARLY = 1e-6  # of a sample: rounding of times


def write_tape(recording: InertialRecording, tape: NDArray[Any]) -> NDArray[Any]:
    """Fill `tape` (K,) from one recording; returns its events (E,), in the order of their moments.

    Events before the first IMU sample or after the last filter step are left out.
    """
    r, per, h = recording, recording.model.samples_per_step, recording.interval
    (angle, velocity), made_up = filled(r)
    preintegrate(angle, velocity, h, per, tape)
    shake(velocity, h, per, tape["shake"])
    K = r.steps
    tape["gap"] = h * made_up[: K * per].reshape(K, per).sum(axis=1)
    tape["time"] = r.step_time
    tape["imu_scale"] = np.nan if r.imu_scale is None else r.imu_scale
    tape["truth"] = np.nan if r.truth is None else r.truth[:, :NAVIGATION]
    tape["regime"] = np.nan if r.regime is None else r.regime
    events, sample = events_of(r)
    step = (sample - 1) // per
    tape["first"] = np.searchsorted(step, np.arange(K), "left")
    tape["count"] = np.searchsorted(step, np.arange(K), "right") - tape["first"]
    look_back(angle, velocity, sample, (step + 1) * per, h, events)
    return events


def filled(recording: InertialRecording) -> tuple[list[Array], NDArray[np.bool_]]:
    """Increments without NaN, and which samples (T,) were filled in: the last one received is held."""
    made_up = recording.gaps
    streams = [recording.angle, recording.velocity]
    if not made_up.any():
        return streams, made_up
    first = int(np.argmin(made_up))  # before it, the first one received is held backwards
    last = np.maximum.accumulate(np.where(made_up, first, np.arange(len(made_up))))
    return [np.ascontiguousarray(s[last]) for s in streams], made_up


def events_of(recording: InertialRecording) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Events (E,) of a recording without their increments, and the IMU sample at whose end each was."""
    r, per, h = recording, recording.model.samples_per_step, recording.interval
    parts = []
    for i, name in enumerate(r.model.sensors):
        if name not in r.aiding:
            continue
        sensor = r.aiding[name]
        part = np.zeros(len(sensor), EVENT)
        part["sensor"], part["lost"], part["time"] = i, sensor.lost, sensor.time
        part["z"][:, : sensor.values.shape[1]] = np.where(
            np.isnan(sensor.values), 0.0, sensor.values
        )
        part["scale"] = np.nan if r.noise_scales is None else r.noise_scales[name]
        parts.append(part)
    events = np.concatenate(parts) if parts else np.zeros(0, EVENT)
    begin = r.time[0] - h
    sample = np.rint((events["time"] - begin) / h - EARLY).astype(np.int64)
    inside = (sample > 0) & (sample <= r.steps * per)
    events, sample = events[inside], sample[inside]
    order = np.lexsort((events["sensor"], sample))
    return events[order], sample[order]


@kernel
def shake(velocity, h, per, out):
    """White noise of the accelerometers in each step (K,), m²/s³, from second differences of increments.

    A second difference of white increments of variance v has 6 v; what a vehicle does between three
    samples hardly shows in it.
    """
    for k in range(len(out)):
        total = 0.0
        for i in range(k * per + 1, (k + 1) * per - 1):
            for a in range(3):
                d = velocity[i + 1, a] - 2.0 * velocity[i, a] + velocity[i - 1, a]
                total += d * d
        out[k] = total / (18.0 * max(per - 2, 1) * h)


@kernel
def look_back(angle, velocity, sample, end, h, events):
    """Fill each event's lag, the increments in it, and the rate around it.

    Args:
        angle: (T, 3) increments.
        velocity: (T, 3).
        sample: (E,) number of IMU samples before each event.
        end: (E,) number of IMU samples before the end of its step.
        h: s per sample.
        events: (E,) to be filled.
    """
    turn, product = np.empty((3, 3)), np.empty((3, 3))
    for e in range(len(events)):
        event = events[e]
        event.lag = (end[e] - sample[e]) * h
        for i in range(3):
            event.dv[i] = 0.0
            for j in range(3):
                event.dR[i, j] = 1.0 if i == j else 0.0
        for k in range(sample[e], end[e]):
            x, y, z = angle[k, 0], angle[k, 1], angle[k, 2]
            a, b, c = velocity[k, 0], velocity[k, 1], velocity[k, 2]
            u0 = a + 0.5 * (y * c - z * b)
            u1 = b + 0.5 * (z * a - x * c)
            u2 = c + 0.5 * (x * b - y * a)
            for i in range(3):
                event.dv[i] += event.dR[i, 0] * u0 + event.dR[i, 1] * u1 + event.dR[i, 2] * u2
            exponential(x, y, z, turn)
            multiply(event.dR, turn, product)
            for i in range(3):
                for j in range(3):
                    event.dR[i, j] = product[i, j]
        # never beyond the step's end: a filter at sea knows no more
        first, last = max(sample[e] - AROUND, 0), min(sample[e] + AROUND, end[e])
        for i in range(3):
            total = 0.0
            for k in range(first, last):
                total += angle[k, i]
            event.rate[i] = total / ((last - first) * h)


def pack_model(model: InsModel, interval: float) -> NDArray[Any]:
    """What a lane believes, (1,) MODEL."""
    packed = np.zeros(1, MODEL)
    m = packed[0]
    T = interval * model.samples_per_step
    latitude, _, height = (float(x) for x in model.origin)
    meridian, across = radii_of_curvature(latitude)
    m["T"], m["origin"] = T, model.origin
    m["metres"] = meridian + height, (across + height) * math.cos(latitude)
    C = np.empty((3, 3))
    roll, pitch, heading = (float(x) for x in model.attitude)
    attitude_of(roll, pitch, heading, C)
    m["start"] = [
        model.latitude, model.longitude, model.height, *model.velocity, *C.ravel()
    ]  # fmt: skip
    gyro, angle_walk, accelerometer, velocity_walk, drift, sway = model.grade.si
    m["gyro"], m["accelerometer"] = angle_walk**2, velocity_walk**2
    m["gyro_walk"], m["accelerometer_walk"] = drift**2, sway**2
    kinds = {s.kind for s in model.sensors.values()}
    on = {
        "R": (model.position_deviation,) * 3,
        "V": (model.velocity_deviation,) * 3,
        "PHI": (model.tilt_deviation, model.tilt_deviation, model.heading_deviation),
        "BG": (gyro,) * 3,
        "BA": (accelerometer,) * 3,
        "M": (model.hard_iron if "magnetometer" in kinds else 0.0,) * 3,
        "S": (model.dvl_scale if "dvl" in kinds else 0.0,),
        "ALPHA": (model.dvl_misalignment if "dvl" in kinds else 0.0,),
        "C": (model.current if "water" in kinds else 0.0,) * 2,
    }
    for name, deviations in on.items():
        m["deviation"][list(LAYOUT.indices(name))] = deviations
    m["field"] = model.magnetic_field
    keep = math.exp(-T / model.current_time)
    m["current_memory"] = keep
    m["current_noise"] = on["C"][0] ** 2 * (1.0 - keep**2)
    return packed


def pack_sensors(model: InsModel) -> NDArray[Any]:
    """The model's sensors, (SENSORS,) SENSOR."""
    packed = np.zeros(SENSORS, SENSOR)
    for record, sensor in zip(packed, model.sensors.values(), strict=False):
        kind = NAMES.index(sensor.kind)
        record["kind"], record["rows"] = kind, KINDS[kind].rows
        record["variance"][: sensor.rows] = sensor.noise**2
        record["lever"] = sensor.lever_arm
    return packed


@kernel
def attitude_of(roll, pitch, heading, C):
    """C (3, 3) of Euler angles, rad."""
    euler_matrix(roll, pitch, heading, C)
