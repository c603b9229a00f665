"""A vehicle's own logs as a folder of text files: one for the IMU, and one for each other sensor."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from navgym.core.checks import Array, one_of, within
from navgym.core.notes import Notes
from navgym.core.tables import Table, read_table, write_table
from navgym.ins.layout import STATES
from navgym.ins.model import AidingModel, InsModel
from navgym.ins.plausible import axes, concerns
from navgym.ins.recording import Aiding, InertialRecording, nine_digits
from navgym.ins.simulation import local

GYRO_UNITS = {"rad/s": 1.0, "deg/s": np.pi / 180.0}
XYZ = ("x", "y", "z")
GYROS, ACCELEROMETERS = (tuple(f"{n}_{a}" for a in XYZ) for n in ("gyro", "acc"))
# columns of each sensor's file, and the deviation of its numbers where nothing is told
COLUMNS: dict[str, tuple[tuple[str, ...], Any]] = {
    "dvl": (("vx", "vy", "vz"), 0.02),
    "depth": (("depth",), 0.1),
    "fix": (("latitude", "longitude", "depth"), 2.0),
    "magnetometer": (("mx", "my", "mz"), 0.3),
    "heading": (("heading",), np.radians(2.0)),
    "water": (("vx", "vy", "vz"), 0.05),
}
REFERENCE = ("latitude", "longitude", "depth", "vn", "ve", "vd", "roll", "pitch", "heading")
ROUNDED = (
    0.1  # of an IMU's step: by how much stamps may miss even ones before samples count as missing
)
LONGEST_GRID = 100  # times the rows: a log that even steps would make longer has a wrong time in it


def read_ins_csv(
    path: str | os.PathLike[str],
    *,
    gyro_unit: str = "rad/s",
    model: Mapping[str, Any] | InsModel | None = None,
    sensors: Mapping[str, Mapping[str, Any]] | None = None,
    time_offsets: Mapping[str, float] | None = None,
    turn: Mapping[str, str] | None = None,
    silent_after: float = 1.5,
    check_units: bool = True,
) -> InertialRecording:
    """A folder of text files, each with a header line and a row per sample, times in s on one clock.

    ================  ====================================================================================
    file              columns
    ================  ====================================================================================
    imu.csv           time, gyro_x, gyro_y, gyro_z (in `gyro_unit`), acc_x, acc_y, acc_z (m/s²): means over
                      the interval before, axes forward, starboard, down; at rest acc_z is -9.8
    dvl.csv           time, vx, vy, vz: m/s over ground in body axes; nan where the bottom was lost
    depth.csv         time, depth: m, positive down
    fix.csv           time, latitude, longitude (°), depth (m)
    magnetometer.csv  time, mx, my, mz: µT, body axes
    heading.csv       time, heading: °, true
    water.csv         time, vx, vy, vz: m/s through water in body axes
    reference.csv     time, latitude, longitude (°), depth (m), vn, ve, vd (m/s), roll, pitch, heading (°)
    ================  ====================================================================================

    All but imu.csv may be absent. Missing IMU samples become NaN. A Doppler log that is silent for longer than
    `silent_after` of its usual interval gets a lost measurement for each that should have come. The filter
    starts from the model's `latitude`, `longitude`, `velocity` and `attitude`; what it is not told it takes
    from the first row of reference.csv, else from the first fix and Doppler velocity, level, with the heading
    of heading.csv. What was found and done stands as sentences in `meta["reading"]`.

    Args:
        path: the folder.
        gyro_unit: "rad/s" or "deg/s".
        model: what a filter is to believe: an `InsModel`, or its fields as a dict.
        sensors: fields of `AidingModel` by sensor, such as {"dvl": {"noise": 0.01, "lever_arm": [1, 0, 0]}}.
        time_offsets: s by which a sensor's stamps are late, by its name: taken off.
        turn: axes of the IMU that point the other way or are another's, for example
            {"gyro_y": "-gyro_y", "acc_x": "acc_y"}: column of our axis to that of the file, with a sign.
        silent_after: usual intervals after which a Doppler log counts as silent.
        check_units: whether to refuse data whose units or axes cannot be, to hold the IMU's axes against the other
            sensors, with a warning where another way round fits far better, and to leave out samples at a sensor's stop.

    Raises:
        FileNotFoundError: there is no imu.csv.
        ValueError: naming file, line and column, for text, infinity and times that do not increase; unknown
            sensors or axes; data whose units or axes cannot be.
    """
    folder = Path(path)
    if not (folder / "imu.csv").exists():
        raise FileNotFoundError(f"{folder} holds no imu.csv: name the folder of a set of logs.")
    there = [n for n in ("imu", *COLUMNS, "reference") if (folder / f"{n}.csv").exists()]
    return recording_of(
        {name: read_table(folder / f"{name}.csv") for name in there}, Notes(folder.name),
        gyro_unit=gyro_unit, model=model, sensors=sensors, time_offsets=time_offsets, turn=turn,
        silent_after=silent_after, check_units=check_units,
        meta={"format": "ins_csv", "source": folder.name},
    )  # fmt: skip


def recording_of(
    tables: Mapping[str, Table],
    said: Notes,
    *,
    gyro_unit: str = "rad/s",
    model: Mapping[str, Any] | InsModel | None = None,
    sensors: Mapping[str, Mapping[str, Any]] | None = None,
    time_offsets: Mapping[str, float] | None = None,
    turn: Mapping[str, str] | None = None,
    silent_after: float = 1.5,
    check_units: bool = True,
    meta: Mapping[str, Any] | None = None,
) -> InertialRecording:
    """A recording from tables by sensor, wherever these come from; options and errors of `read_ins_csv`."""
    factor = GYRO_UNITS[one_of("gyro_unit", gyro_unit, GYRO_UNITS)]
    within("silent_after", silent_after, 1.0)
    clock, rate, force = _imu(tables["imu"], factor, dict(turn or {}), said)
    offsets, told = dict(time_offsets or {}), dict(sensors or {})
    for name in (*offsets, *told):
        one_of("sensor", name, (*COLUMNS, "reference"))
    values = {n: _numbers(tables[n], ("time", *COLUMNS[n][0])) for n in COLUMNS if n in tables}
    for name, shift in offsets.items():
        if name in values:
            values[name][:, 0] -= shift
            said.say(f"{name}: {shift:g} s were taken off its times.")
    reference = None
    if "reference" in tables:
        reference = _numbers(tables["reference"], ("time", *REFERENCE))
        reference[:, 0] -= offsets.get("reference", 0.0)
    believed = {
        name: AidingModel(**({"kind": name, "noise": COLUMNS[name][1]} | dict(told.get(name, {}))))
        for name in values
    }
    own = _model(model, believed, values, reference, said)
    aiding = {
        name: _aiding(name, rows, own.origin, silent_after, said) for name, rows in values.items()
    }
    recording = InertialRecording.from_rates(
        clock, rate, force, aiding=aiding, model=own, check_units=check_units,
        meta={**(meta or {}), "reading": said.sentences},
    )  # fmt: skip
    if check_units:
        recording = _doubted(recording, said)
    if reference is None:
        return recording
    truth = _truth(recording, reference)
    return dataclasses.replace(recording, truth=truth, check_units=False)


def _doubted(recording: InertialRecording, said: Notes) -> InertialRecording:
    """The same with what looks wrong among its sentences; warns (UserWarning) of axes that are turned over."""
    for text in concerns(recording):
        said.say(text)
    for text in axes(recording):
        said.doubt(text)
    meta = dict(recording.meta) | {"reading": said.sentences}
    return dataclasses.replace(recording, meta=meta, check_units=False)


def write_ins_csv(recording: InertialRecording, path: str | os.PathLike[str]) -> Path:
    """Write a recording as the folder that `read_ins_csv` reads; the reference too, where there is one."""
    folder, r, h = Path(path), recording, recording.interval
    folder.mkdir(parents=True, exist_ok=True)
    imu = dict(zip(GYROS, r.angle.T / h, strict=True)) | dict(zip(ACCELEROMETERS, r.velocity.T / h, strict=True))  # fmt: skip
    write_table(folder / "imu.csv", {"time": r.time, **imu})
    for name, sensor in r.aiding.items():
        kind = r.model.sensors[name].kind
        rows = sensor.values.copy()
        if kind == "fix":
            rows = _places(rows, r.model.origin)
        elif kind == "heading":
            rows = np.degrees(rows)
        write_table(folder / f"{kind}.csv", {"time": sensor.time, **dict(zip(COLUMNS[kind][0], rows.T, strict=True))})  # fmt: skip
    if r.truth is not None:
        good = np.isfinite(r.truth[:, :9]).all(axis=1)
        known = r.truth[good]
        columns = [
            *_places(known[:, :3], r.model.origin).T,
            *known[:, 3:6].T,
            *np.degrees(known[:, 6:9]).T,
        ]
        write_table(folder / "reference.csv", {"time": r.step_time[good], **dict(zip(REFERENCE, columns, strict=True))})  # fmt: skip
    return folder


def _numbers(table: Table, columns: tuple[str, ...]) -> Array:
    """Columns of a table (T, n), the first of them increasing times, gaps in the others NaN."""
    time = table.increasing(columns[0])
    return np.column_stack([time, *(table.numbers(c, gaps=True) for c in columns[1:])])


def _imu(
    table: Table, factor: float, turn: dict[str, str], said: Notes
) -> tuple[Array, Array, Array]:
    """Even times, rates and forces of the IMU; samples that are missing are NaN."""
    file = table.path
    for name in turn:
        one_of("axis", name, (*GYROS, *ACCELEROMETERS))
    columns, signs = [], []
    for name in (*GYROS, *ACCELEROMETERS):
        source = turn.get(name, name)
        signs.append(-1.0 if source.startswith("-") else 1.0)
        columns.append(source.lstrip("+-"))
    if turn:
        said.say("axes of the IMU were turned: " + ", ".join(f"{k} is {v}" for k, v in turn.items()) + ".")  # fmt: skip
    rows = _numbers(table, ("time", *columns))
    time, data = rows[:, 0], rows[:, 1:] * signs
    if len(time) < 2:
        raise ValueError(f"{file.name} must hold at least two samples, got {len(time)}.")
    step = float(np.median(np.diff(time)))
    place = np.rint((time - time[0]) / step).astype(np.int64)
    count = int(place[-1]) + 1
    if count > LONGEST_GRID * len(time):
        raise ValueError(
            f"{file.name}: even steps of {step:g} s from {time[0]} to {time[-1]} s are {count} samples where there "
            f"are {len(time)}: repair the times."
        )
    if count == len(time) and (np.diff(place) == 1).all():
        even = nine_digits((time[-1] - time[0]) / (count - 1))
    else:
        even = step
        said.say(f"imu: {count - len(np.unique(place))} of {count} samples are missing.")
    drift = np.abs(time - time[0] - even * place)
    if drift.max() > ROUNDED * even:
        k = int(np.argmax(drift))
        said.say(
            f"imu: times miss even steps of {even:.6g} s by up to {drift.max():.3g} s, at {time[k]} s."
        )
    whole = np.full((count, 6), np.nan)
    whole[place] = data
    return time[0] + even * np.arange(count), factor * whole[:, :3], whole[:, 3:]


def _model(
    given: Mapping[str, Any] | InsModel | None, sensors: dict[str, AidingModel], values: dict[str, Array],
    reference: Array | None, said: Notes,
) -> InsModel:  # fmt: skip
    """The model with the sensors that there are, and a start from what there is."""
    if isinstance(given, InsModel):
        known = {n: s for n, s in given.sensors.items() if n in sensors}
        return given.replace(sensors=sensors | known)
    fields = dict(given or {})
    known_fields = [f.name for f in dataclasses.fields(InsModel)]
    for name in fields:
        one_of("field of the model", name, known_fields)
    start: dict[str, Any] = {}
    if reference is not None:
        first = reference[np.isfinite(reference).all(axis=1)][0]
        lat, lon = np.radians(first[1:3])
        start = {
            "latitude": lat, "longitude": lon, "height": -first[3], "velocity": first[4:7],
            "attitude": np.radians(first[7:10]),
        }  # fmt: skip
        said.say("the filter starts from the first row of reference.csv.")
    elif "fix" in values:
        lat, lon, depth = values["fix"][np.isfinite(values["fix"]).all(axis=1)][0, 1:]
        start = {"latitude": np.radians(lat), "longitude": np.radians(lon), "height": -depth}
        heading = np.radians(values["heading"][0, 1]) if "heading" in values else 0.0
        start["attitude"] = (0.0, 0.0, heading)
        if "dvl" in values:
            u, v = values["dvl"][np.isfinite(values["dvl"]).all(axis=1)][0, 1:3]
            c, s = np.cos(heading), np.sin(heading)
            start["velocity"] = (c * u - s * v, s * u + c * v, 0.0)
        wide = {"position_deviation": 5.0, "velocity_deviation": 0.5, "tilt_deviation": 0.05}
        wide["heading_deviation"] = 0.2 if "heading" in values else 1.0
        start |= wide
        said.say("the filter starts from the first fix, level, and does not know its heading well.")
    if "origin" not in fields and "height" not in fields and start:
        fields.setdefault("origin", (start["latitude"], start["longitude"], 0.0))
    return InsModel(**(start | fields | {"sensors": sensors}))


def _places(ned: Array, origin: Array) -> Array:
    """Latitude, longitude (°) and depth (m) of metres north, east, down (T, 3) of an origin."""
    metres = _metres(origin)
    return np.column_stack([*np.degrees(ned[:, :2] / metres + origin[:2]).T, ned[:, 2] - origin[2]])


def _metres(origin: Array) -> Array:
    found: Array = local(np.add(origin, [1e-6, 1e-6, 0.0])[None], origin)[0, :2] / 1e-6
    return found


def _ned(places: Array, origin: Array) -> Array:
    """Metres north, east, down of an origin from latitude, longitude (°) and depth (T, 3)."""
    ned: Array = np.column_stack(
        [(np.radians(places[:, :2]) - origin[:2]) * _metres(origin), places[:, 2] + origin[2]]
    )
    return ned


def _aiding(name: str, rows: Array, origin: Array, silent_after: float, said: Notes) -> Aiding:
    """A sensor's rows as measurements; silence of a Doppler log as lost ones."""
    time, values = rows[:, 0], rows[:, 1:].copy()
    if name == "fix":
        values = _ned(values, origin)
    elif name == "depth":
        values += origin[2]
    elif name == "heading":
        values = np.radians(values)
    if name != "dvl" or len(time) < 3:
        return Aiding(time, values)
    usual = float(np.median(np.diff(time)))
    gaps = np.flatnonzero(np.diff(time) > silent_after * usual)
    more = [time[k] + usual * np.arange(1, round((time[k + 1] - time[k]) / usual)) for k in gaps]
    silent = np.concatenate([np.zeros(0), *more])
    if len(silent):
        said.say(f"dvl: {len(silent)} measurements did not come, in {len(gaps)} gaps.")
    order = np.argsort(np.concatenate([time, silent]), kind="stable")
    whole = np.concatenate([values, np.full((len(silent), 3), np.nan)])
    return Aiding(np.concatenate([time, silent])[order], whole[order])


def _truth(recording: InertialRecording, reference: Array) -> Array:
    """The filters' states (K, 22) where a reference row lies within a fifth of a step, else NaN."""
    time, step = recording.step_time, recording.step
    known = np.column_stack([
        _ned(reference[:, 1:4], recording.model.origin), reference[:, 4:7], np.radians(reference[:, 7:10])
    ])  # fmt: skip
    nearest = np.clip(np.searchsorted(reference[:, 0], time), 1, len(reference) - 1)
    nearest -= time - reference[nearest - 1, 0] < reference[nearest, 0] - time
    close = np.abs(reference[nearest, 0] - time) < 0.2 * step
    truth = np.full((len(time), STATES), np.nan)
    truth[close, :9] = known[nearest[close]]
    return truth
