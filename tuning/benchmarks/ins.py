"""How fast the INS is: against a plain numpy EKF, pyins and navlib, in the same run."""

from __future__ import annotations

import importlib.util
import statistics
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import navgym
from navgym.ins.batch import InsBatch
from navgym.ins.problem import PROBLEM
from navgym.ins.recording import InertialRecording
from navgym.simulation import simulate_many
from navgym.tuning.benchmarks.dense_ins import dense_ins
from navgym.tuning.benchmarks.timing import Row, compiled, measured, paired, seconds

HOUR = 3600.0
# every sensor at each filter step
ALL = {"dvl_period": 0.2, "magnetometer_period": 0.2, "fix_period": 0.2, "water_period": 0.2}
# seconds of the processor, so that a busy machine says the same
COMPILE = """
import navgym
from navgym.problem import PROBLEMS
from navgym.warm import brief
recording = brief(PROBLEMS["ins"], "ins/nominal")
navgym.estimate("ins_kf", recording)
"""


def _median(task: Callable[[], Any], rounds: int) -> float:
    task()
    return statistics.median(seconds(task) for _ in range(rounds))


def _batch(count: int, **overrides: Any) -> InsBatch:
    found: InsBatch = PROBLEM.stack(
        simulate_many("ins/nominal", navgym.seeds("test", count), **overrides)
    )
    return found


def steps(rounds: int) -> list[Row]:
    """Cost of a step of .2 s with every sensor in it, and of an hour as sensors usually come."""
    full, hour = _batch(2, duration=600.0, **ALL), _batch(1, duration=HOUR, water_period=1.0)
    rows = []
    for name in PROBLEM.filters:
        cost = _median(partial(PROBLEM.run, name, full), rounds) / int(full.lengths.sum())
        wanted = "at most 5 µs" if name == "ins_kf" else "told"
        rows.append(Row(f"{name}, one .2 s step with all five sensors", wanted, f"{cost * 1e6:.2f} µs"))  # fmt: skip
    for name in ("ins_kf", "ins_bank"):
        cost = _median(partial(PROBLEM.run, name, hour), rounds)
        rows.append(Row(f"{name}, an hour, sensors as they come", "at most 100 ms", f"{1e3 * cost:.0f} ms"))  # fmt: skip
    ready = _median(lambda: InsBatch.of(hour.recordings), rounds)
    made = _median(lambda: simulate_many("ins/nominal", [0], duration=HOUR), max(rounds // 2, 1))
    return [
        *rows,
        Row("increments of an hour at 100 Hz summed up", "told", f"{1e3 * ready:.0f} ms"),
        Row("an hour simulated at 100 Hz", "told", f"{1e3 * made:.0f} ms"),
    ]


def against_numpy(rounds: int) -> Row:
    """`ins_kf` against the same states in dense numpy, on the same increments and measurements."""
    batch = _batch(1, duration=60.0, water_period=1.0)
    own, other = PROBLEM.run("ins_kf", batch).states[0, :, :3], dense_ins(batch)
    apart = float(np.abs(own - other).max())
    if apart > 0.5:
        raise RuntimeError(f"numpy and navgym are {apart:.2f} m apart: the comparison would be meaningless.")  # fmt: skip
    mine, theirs, ratio = paired(lambda: PROBLEM.run("ins_kf", batch), lambda: dense_ins(batch), max(rounds // 2, 2))  # fmt: skip
    count = int(batch.lengths.sum())
    return Row(
        "ins_kf against a dense numpy EKF, 22 states, 300 steps", "told",
        f"{ratio:,.0f}x ({mine / count * 1e6:.1f} against {theirs / count * 1e6:,.0f} µs per step; {apart:.2f} m apart)",
    )  # fmt: skip


def against_pyins(rounds: int) -> Row:
    """`ins_kf`, increments and all, against pyins's feedback filter on the same increments and measurements."""
    what = "ins_kf and its increments against pyins, 20 s at 100 Hz, log and fixes"
    if importlib.util.find_spec("pyins") is None:
        return Row(what, "told", "not measured: pip install python-ins pandas")
    full = simulate_many("ins/nominal", navgym.seeds("test", 1), duration=20.0, fix_period=5.0, calibrated=True)[0]  # fmt: skip
    model = full.model.replace(
        sensors={n: full.model.sensors[n] for n in ("dvl", "fix")}, hard_iron=0.0
    )
    aiding = {n: full.aiding[n] for n in ("dvl", "fix")}
    recording = InertialRecording(
        full.time, full.angle, full.velocity, aiding, model, check_units=False
    )
    theirs = pyins_of(recording)
    mine, other, ratio = paired(
        lambda: PROBLEM.run("ins_kf", InsBatch.of([recording])), theirs, max(rounds // 2, 2)
    )
    return Row(what, "told", f"{ratio:,.0f}x ({1e3 * mine:.1f} against {1e3 * other:,.0f} ms)")


def pyins_of(recording: InertialRecording) -> Callable[[], Any]:
    """pyins's feedback filter, ready to run on a recording with a Doppler log and fixes."""
    import pandas as pd
    from pyins import filters, measurements
    from pyins.inertial_sensor import EstimationModel

    r, m = recording, recording.model
    turned = r.velocity + 0.5 * np.cross(r.angle, r.velocity)
    names = ["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"]
    increments = pd.DataFrame(np.column_stack([np.full(len(r), r.interval), r.angle, turned]), index=r.time, columns=names)  # fmt: skip
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    start = pd.Series([*np.degrees([m.latitude, m.longitude]), m.height, *m.velocity, *np.degrees(m.attitude)], index=names, name=0.0)  # fmt: skip
    packed, fix, dvl = InsBatch.of([r]).models[0], r.aiding["fix"], r.aiding["dvl"]
    places = np.degrees(fix.values[:, :2] / packed["metres"] + packed["origin"][:2])
    fixes = np.column_stack([places, packed["origin"][2] - fix.values[:, 2]])
    seen = [
        measurements.BodyVelocity(pd.DataFrame(dvl.values, index=dvl.time, columns=["VX", "VY", "VZ"]), 0.01),
        measurements.Position(pd.DataFrame(fixes, index=fix.time, columns=["lat", "lon", "alt"]), 2.0),
    ]  # fmt: skip
    gyro, walk, accelerometer, shake, drift, sway = m.grade.si
    tilt, heading = np.degrees([m.tilt_deviation, m.heading_deviation])
    return lambda: filters.run_feedback_filter(
        start, m.position_deviation, m.velocity_deviation, tilt, heading, increments,
        EstimationModel(gyro, walk, drift), EstimationModel(accelerometer, shake, sway), seen, time_step=r.step,
    )  # fmt: skip


def against_navlib(rounds: int) -> Row:
    """`ins_kf` against navlib's UUV_EKF, which is another filter: 13 states, attitude from an AHRS, no IMU."""
    what = "ins_kf (22 states) against navlib's UUV_EKF (13, attitude given), 300 steps of .2 s"
    if importlib.util.find_spec("navlib") is None:
        return Row(what, "told", "not measured: pip install navlib")
    from navlib.nav import UUV_EKF

    batch = _batch(1, duration=60.0)
    r = batch.recordings[0]
    truth, times = np.asarray(r.truth), r.step_time
    quaternions = Rotation.from_euler("ZYX", truth[:, 8:5:-1]).as_quat()
    rates = np.asarray(r.angle).reshape(len(times), -1, 3).sum(axis=1) / r.step

    def theirs() -> None:
        ekf = UUV_EKF()
        ekf.initialize_state(0.0, truth[0, :3], quaternions[0], truth[0, 3:6], rates[0])
        for k, t in enumerate(times):
            ekf.predict(float(t), rates[k])
            ekf.correction_attitude(quaternions[k])
            ekf.correction_angular_rate(rates[k])
            ekf.correction_depth(float(truth[k, 2]))
            if k % 5 == 4:
                ekf.correction_velocity(r.aiding["dvl"].values[k // 5])

    mine, other, ratio = paired(lambda: PROBLEM.run("ins_kf", batch), theirs, max(rounds // 2, 2))
    count = len(times)
    return Row(what, "told", f"{ratio:,.0f}x ({mine / count * 1e6:.1f} against {other / count * 1e6:,.0f} µs per step)")  # fmt: skip


def compiling(rounds: int) -> Row:  # noqa: ARG001 - once: it takes long
    """From nothing on disk to a first estimate."""
    return Row("compiling what an estimate needs, from nothing", "at most 20 s", f"{compiled(COMPILE):.0f} s of processor time")  # fmt: skip


def ins(rounds: int) -> list[Row]:
    """Every figure of the INS."""
    return measured([steps, against_numpy, against_pyins, against_navlib, compiling], rounds)
