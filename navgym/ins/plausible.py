"""What sensors of one recording say of each other: axes that are turned over, clocks that differ, nothing to see.

Nothing here changes a recording; it is told. The filter itself is the judge, run on the recording as it is and as it would be with an axis turned or a clock
moved; where another way fits far better, that is said.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from navgym.core.checks import Array
from navgym.ins.batch import InsBatch
from navgym.ins.catalogue import CATALOGUE
from navgym.ins.estimation import run
from navgym.ins.recording import Aiding, InertialRecording

# columns and signs of (gyros, accelerometers) that make the axes of a recording out of its own
Turn = tuple[tuple[str, ...], Array, Array]
_X, _Y, _Z = np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0]), np.diag([1.0, 1.0, -1.0])
_NONE, _QUARTER = np.eye(3), np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TURNS: tuple[Turn, ...] = (
    (("gyro_x",), _X, _NONE), (("gyro_y",), _Y, _NONE), (("gyro_z",), _Z, _NONE),
    (("acc_x",), _NONE, _X), (("acc_y",), _NONE, _Y),
    (("gyro_x", "acc_x"), _X, _X), (("gyro_y", "acc_y"), _Y, _Y),
    (("a half turn about z",), _X @ _Y, _X @ _Y),
    (("a quarter turn to the right about z",), _QUARTER, _QUARTER),
    (("a quarter turn to the left about z",), _QUARTER.T, _QUARTER.T),
)  # fmt: skip
MOVING = (-1.0, -0.5, -0.2, -0.1, 0.1, 0.2, 0.5, 1.0)  # s, by which a sensor's clock is tried
LONGEST = 600.0  # s of a recording that are looked at
SHORTEST = 30.0
MOST = 50.0  # NIS per degree of freedom of a step counts at most as this
WORSE, BAD = 2.0, 2.0  # times the NIS of another way, and NIS, from which on axes are doubted
EARNED, SHARE = 60.0, 0.03  # NIS, and share of it, by which a moved clock must fit better
SLOW, STILL = 0.05, np.radians(0.2)  # m/s, rad/s: below it a vehicle stands


def concerns(recording: InertialRecording) -> list[str]:
    """What would spoil an estimate, as sentences that name the field, the value and a remedy; no filter is run."""
    return [*_outside(recording), *_unheard(recording), *_standing(recording)]


def _outside(recording: InertialRecording) -> list[str]:
    """Measurements of times that the IMU does not cover."""
    said, first = [], recording.time[0] - recording.interval
    last = recording.step_time[-1]
    for name, sensor in recording.aiding.items():
        early, late = int((sensor.time <= first).sum()), int((sensor.time > last + 1e-6).sum())
        for count, where in ((early, f"before the IMU's first sample ({first:g} s)"), (late, f"after its last whole step ({last:g} s)")):  # fmt: skip
            if count > 1:
                said.append(
                    f"{name}: {count} of {len(sensor)} measurements lie {where} and are left out: where that should not "
                    "be, bring both to one clock (time_offsets)."
                )
    return said


def _unheard(recording: InertialRecording) -> list[str]:
    """Nothing that shows the heading."""
    kinds = {
        recording.model.sensors[n].kind for n, a in recording.aiding.items() if not a.lost.all()
    }
    if kinds & {"magnetometer", "heading", "fix"}:
        return []
    return [
        "heading: no magnetometer, heading or position fix shows it; it stays as well known as at the start, and drifts "
        f"with the gyros ({recording.model.grade.gyro_bias:g} °/h): start from a known heading, or add one of them."
    ]  # fmt: skip


def _standing(recording: InertialRecording) -> list[str]:
    """A vehicle that neither moves nor turns."""
    speeds = [
        np.linalg.norm(a.values[~a.lost], axis=1) for n, a in recording.aiding.items() if recording.model.sensors[n].kind == "dvl"
    ]  # fmt: skip
    if not speeds or not len(speeds[0]) or np.median(speeds[0]) > SLOW:
        return []
    turning = np.abs(np.nanmedian(recording.angle[:, 2])) / recording.interval
    if turning > STILL:
        return []
    return [
        f"dvl: the median speed is {np.median(speeds[0]):.3f} m/s: the vehicle stands still for most of the recording, where "
        "neither the heading nor the log's scale and misalignment can be found."
    ]


# ---- the filter as judge


def axes(recording: InertialRecording) -> list[str]:
    """Whether the sensors agree far better with axes of the IMU turned over; which, and what to do.

    Gyros and accelerometers are held against the Doppler log, fixes, depth, magnetometer and heading that there
    are, over at most `LONGEST` s. Empty where they agree, or where there is too little to tell.
    """
    part = _short(recording)
    if part is None:
        return []
    own = _nis(part)
    if not own > BAD:
        return []
    found = [(_nis(_turned(part, gyros, forces)), names) for names, gyros, forces in TURNS]
    best, names = min(found, key=lambda each: each[0])
    if not own > WORSE * best:
        return []
    return [_doubt(names, own, best)]


def _doubt(names: Sequence[str], own: float, best: float) -> str:
    if "turn" in names[0]:
        what = f"the IMU is mounted with {names[0]}"
        remedy = "name its axes with turn="
    else:
        pairs = ", ".join(f'"{n}": "-{n}"' for n in names)
        what = f"{' and '.join(names)} point{'s' if len(names) == 1 else ''} the other way"
        remedy = f"pass turn={{{pairs}}}"
    return (
        f"axes: the other sensors fit far better if {what} (mean NIS per degree of freedom {best:.1f} instead of "
        f"{own:.1f}): {remedy}, or turn the data."
    )


def clocks(recording: InertialRecording) -> list[str]:
    """Sensors whose measurements fit better at other times than their stamps; none is moved.

    Each sensor's clock is moved against the others by up to a second either way. A steady motion does not show a
    delay: silence is no proof.
    """
    part = _short(recording)
    if part is None:
        return []
    dof = max(_heard(part), 1)
    own, said = _nis(part) * dof, []
    for name, sensor in part.aiding.items():
        if len(sensor) - int(sensor.lost.sum()) < 20:
            continue
        fits = {shift: _nis(_moved(part, name, shift)) * dof for shift in MOVING}
        shift, best = min(fits.items(), key=lambda each: each[1])
        # outliers that meet another sensor's measurements in one step spoil the fit there: then any move helps, either way
        other = min(nis for moved, nis in fits.items() if moved * shift < 0.0)
        if min(own, other) - best > EARNED + SHARE * own:
            said.append(
                f"{name}: its measurements fit better if they were made about {abs(shift):g} s "
                f"{'later' if shift > 0 else 'earlier'} than they are stamped (NIS {best:.0f} instead of {own:.0f} in all): "
                f'check its clock, and pass time_offsets={{"{name}": {-shift:g}}} if that is so. Nothing was moved.'
            )
    return said


def _short(recording: InertialRecording) -> InertialRecording | None:
    """The first `LONGEST` s of a recording, without truth; None where it is too short or nothing is heard."""
    per = recording.model.samples_per_step
    count = min(len(recording), round(LONGEST / recording.interval)) // per * per
    if count * recording.interval < SHORTEST or not _heard(recording):
        return None
    return InertialRecording(
        recording.time[:count], recording.angle[:count], recording.velocity[:count], recording.aiding,
        recording.model, check_units=False,
    )  # fmt: skip


def _heard(recording: InertialRecording) -> int:
    """Numbers that other sensors gave."""
    return sum(a.values.shape[1] * int((~a.lost).sum()) for a in recording.aiding.values())


def _turned(recording: InertialRecording, gyros: Array, forces: Array) -> InertialRecording:
    angle, velocity = recording.angle @ gyros.T, recording.velocity @ forces.T
    return dataclasses.replace(recording, angle=angle, velocity=velocity, check_units=False)


def _moved(recording: InertialRecording, name: str, shift: float) -> InertialRecording:
    sensor = recording.aiding[name]
    moved = Aiding(sensor.time + shift, np.array(sensor.values), np.array(sensor.lost))
    return dataclasses.replace(
        recording, aiding=dict(recording.aiding) | {name: moved}, check_units=False
    )


def _nis(recording: InertialRecording) -> float:
    """Mean NIS per degree of freedom of the plain filter, each step's at most `MOST`; infinite where it is lost."""
    chosen = CATALOGUE["ins_kf"]
    found = run(chosen, InsBatch.of([recording]), chosen.space.array()[None], 5, True)
    components = found.components[0].astype(float)
    heard = components > 0
    assert found.nis is not None
    each = np.nan_to_num(found.nis[0][heard] / components[heard], nan=MOST, posinf=MOST)
    weights = components[heard]
    return float((np.minimum(each, MOST) * weights).sum() / weights.sum()) if heard.any() else 0.0
