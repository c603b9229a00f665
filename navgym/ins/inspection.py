"""What a recording of an IMU and other sensors shows when looked over."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.inertial.earth import GRAVITY, MICRO_G
from navgym.inertial.imu import DEGREE_PER_HOUR, DEGREE_PER_ROOT_HOUR
from navgym.ins.imu_grades import GRADES
from navgym.ins.kinds import KINDS, NAMES
from navgym.ins.recording import CHANNELS, InertialRecording
from navgym.inspection import noise, timing
from navgym.inspection.findings import Channel, Evidence, Finding

XYZ = ("x", "y", "z")
OFF = 0.03  # share of gravity by which the usual specific force may miss it
IN_G = 0.1  # share by which the usual force of accelerometers in g may miss 1
FASTER, FEWEST = 1.25, 8  # fixes against the Doppler log's speed; stretches between fixes
_KIND = {
    "dvl": ("velocity", ("vx", "vy", "vz")), "water": ("velocity", ("vx", "vy", "vz")),
    "depth": ("depth", ("",)), "fix": ("position", ("north", "east", "down")),
    "magnetometer": ("field", ("x", "y", "z")), "heading": ("angle", ("",)),
}  # fmt: skip


def evidence(recording: InertialRecording, log: Path, options: Mapping[str, Any]) -> Evidence:  # noqa: ARG001
    """Channels, findings and the noise of a log of an IMU and other sensors."""
    r = recording
    channels = [*_imu(r), *_aiding(r)]
    findings = [*_gravity(r), *_speeds(r)]
    for name, sensor in r.aiding.items():
        findings += timing.gaps(sensor.time, name)
        findings += timing.outage(sensor.time[~sensor.lost], name, timing.long_steps(sensor.time))
        findings += timing.rate(sensor.time, name)
    lines, words = _noise(r)
    fixes = [a.values for n, a in r.aiding.items() if r.model.sensors[n].kind == "fix"]
    track = (fixes[0][:, 0], fixes[0][:, 1]) if fixes else None
    return Evidence(channels, findings, lines, words, track)


def _imu(r: InertialRecording) -> Iterator[Channel]:
    units = {"angle": ("rate", "rad/s"), "velocity": ("force", "m/s²")}
    for field, names in CHANNELS.items():
        kind, unit = units[field]
        for name, x in zip(names, (getattr(r, field) / r.interval).T, strict=True):
            yield Channel(name, "imu", kind, unit, r.time, x, frozenset({"saturation"}))


def _aiding(r: InertialRecording) -> Iterator[Channel]:
    for name, sensor in r.aiding.items():
        sort = r.model.sensors[name].kind
        unit = KINDS[NAMES.index(sort)].unit
        kind, parts = _KIND[sort]
        for part, x in zip(parts, sensor.values.T, strict=True):
            yield Channel(f"{name}_{part}".rstrip("_"), name, kind, unit, sensor.time, x)


def _gravity(r: InertialRecording) -> Iterator[Finding]:
    size = float(np.nanmedian(np.linalg.norm(r.velocity / r.interval, axis=1)))
    unit = next((u for u, one in (("g", 1.0), ("mg", 1e3)) if abs(size / one - 1.0) < IN_G), None)
    if unit is not None:
        yield Finding(
            "gravity", "imu", f"the usual specific force is {size:.4g}: the accelerometers are in {unit}, not m/s²",
            f"multiply them by {GRAVITY if unit == 'g' else GRAVITY / 1e3:.6g}",
        )  # fmt: skip
    elif abs(size / GRAVITY - 1.0) > OFF:
        yield Finding(
            "gravity", "imu",
            f"the usual specific force is {size:.4g} m/s², {size / GRAVITY - 1.0:+.1%} from gravity",
            "check the scale of the accelerometers, and whether gravity was taken off",
        )  # fmt: skip


def _speeds(r: InertialRecording) -> Iterator[Finding]:
    """Fixes that move farther than the Doppler log lets them: no path is shorter than the straight line."""
    by_kind = {r.model.sensors[n].kind: (n, a) for n, a in r.aiding.items()}
    if not {"dvl", "fix"} <= by_kind.keys():
        return
    (name, dvl), (_, fix) = by_kind["dvl"], by_kind["fix"]
    heard, there = ~dvl.lost, ~fix.lost
    if heard.sum() < FEWEST or there.sum() < FEWEST:
        return
    t, speed = dvl.time[heard], np.linalg.norm(dvl.values[heard][:, :2], axis=1)
    path = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t))])
    every = max(int(there.sum()) // (2 * FEWEST), 1)
    at, p = fix.time[there][::every], fix.values[there][::every, :2]
    inside = (at >= t[0]) & (at <= t[-1])
    if inside.sum() < FEWEST:
        return
    straight = np.linalg.norm(np.diff(p[inside], axis=0), axis=1)
    told = np.diff(np.interp(at[inside], t, path))
    scatter = 3.0 * float(np.max(r.model.sensors[by_kind["fix"][0]].noise[:2]))
    far = straight > 2.0 * scatter
    if far.sum() >= FEWEST // 2:
        ratio = float(np.median(straight[far] / np.maximum(told[far], 1e-9)))
        if ratio > FASTER:
            yield Finding(
                "units", name,
                f"fixes move {ratio:.3g} times as far as the Doppler log's speed lets them",
                "check the unit and the scale of the Doppler log",
            )  # fmt: skip


def _noise(r: InertialRecording) -> tuple[list[tuple[str, str]], tuple[str, ...]]:
    """The IMU's noise in the numbers of data sheets, and the grade that is nearest."""
    found = {}
    for field, units in (
        ("angle", (DEGREE_PER_ROOT_HOUR, DEGREE_PER_HOUR)),
        ("velocity", (MICRO_G, MICRO_G)),
    ):
        pairs = [noise.densities(x, r.interval) for x in (getattr(r, field) / r.interval).T]
        white, lowest = (max(p[i] for p in pairs) for i in (0, 1))
        found[field] = white / units[0], lowest / units[1]
    gyro, force = found["angle"], found["velocity"]
    lines = [
        ("gyros", f"at most {gyro[0]:.3g} °/√h white, lowest Allan deviation {gyro[1]:.3g} °/h, motion included"),
        ("accelerometers", f"at most {force[0]:.3g} µg/√Hz white, lowest Allan deviation {force[1]:.3g} µg, motion included"),
    ]  # fmt: skip
    near = {n: abs(np.log(max(gyro[0], 1e-9) / g.gyro_noise)) + abs(np.log(max(force[0], 1e-9) / g.accelerometer_noise)) for n, g in GRADES.items()}  # fmt: skip
    grade = min(near, key=lambda n: near[n])
    lines.append(("nearest grade", f"{grade}: --read model.imu {grade}"))
    told = r.meta.get("format") == "ins_csv"
    lines += _aiding_noise(r)
    return lines, ("model.imu", grade) if told and GRADES[grade] != r.model.grade else ()


def _aiding_noise(r: InertialRecording) -> Iterator[tuple[str, str]]:
    for name, sensor in r.aiding.items():
        x: Array = sensor.values[~sensor.lost]
        if len(x) < 50:
            continue
        scatter = max(
            noise.of_bends(np.unwrap(c) if r.model.sensors[name].kind == "heading" else c)
            for c in x.T
        )
        unit = KINDS[NAMES.index(r.model.sensors[name].kind)].unit
        believed = float(np.max(r.model.sensors[name].noise))
        yield (name, f"at most {scatter:.3g} {unit} by third differences, believed {believed:.3g}")
