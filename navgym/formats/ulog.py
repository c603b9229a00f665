"""PX4 ULog, over pyulog: GPS, IMU, attitude and the autopilot's own estimate, stamps since boot."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyulog import ULog

from navgym.core.checks import Array
from navgym.formats.channels import ESTIMATE, FURTHER, SENSOR, Gatherer
from navgym.formats.frames import angles

GPS = ("vehicle_gps_position", "sensor_gps")  # what the autopilot made of its receivers, or each
MESSAGES = (*GPS, "sensor_combined", "vehicle_attitude", "vehicle_local_position")
TWO_D, THREE_D = 2, 3  # types of fix
# of whole numbers, which these were before 1.15
SCALE = {"lat": 1e-7, "lon": 1e-7, "alt": 1e-3, "alt_ellipsoid": 1e-3}
US = 1000  # ns


def read(path: Path, gatherer: Gatherer) -> None:
    """Every channel of a log whose message is known."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):  # it prints its doubts
        log = ULog(str(path), list(MESSAGES), disable_str_exceptions=True)
    if log.file_corruption:
        gatherer.doubts.append("the file is damaged: what could not be read is left out")
    if log.dropouts:
        lost = sum(d.duration for d in log.dropouts)
        gatherer.said.append(f"the logger lost data {len(log.dropouts)} times, {lost} ms in all")
    names = {each.name for each in log.data_list}
    for told in log.data_list:
        if told.name == GPS[1] and GPS[0] in names:
            continue  # the same, before the receivers were blended
        _take(gatherer, told.name, told.multi_id, told.data)


def _take(g: Gatherer, message: str, instance: int, data: dict[str, NDArray[Any]]) -> None:
    name = f"{message}[{instance}]" if instance else message
    rank = FURTHER if instance else SENSOR
    time = _stamps(data)
    if message in GPS:
        _gps(g, name, rank, time, data)
    elif message == "sensor_combined":
        columns = {f"gyro_{a}": data[f"gyro_rad[{k}]"] for k, a in enumerate("xyz")}
        columns |= {f"acc_{a}": data[f"accelerometer_m_s2[{k}]"] for k, a in enumerate("xyz")}
        g.add(name, "imu", time, columns, rank)
    elif message == "vehicle_attitude":
        q = np.column_stack([data[f"q[{k}]"] for k in (1, 2, 3, 0)]).astype(np.float64)
        found = angles(q, enu=False, flu=False)
        g.add(name, "attitude", time, dict(zip(("roll", "pitch", "heading"), found.T, strict=True)), ESTIMATE)  # fmt: skip
    else:
        _local(g, name, time, data)


def _stamps(data: dict[str, NDArray[Any]]) -> NDArray[np.int64]:
    """ns since boot: when the data were taken, where that is told."""
    taken = data.get("timestamp_sample")
    stamps = data["timestamp"] if taken is None or (taken == 0).any() else taken
    if (stamps > 2**53).any():
        raise ValueError(f"a stamp of {stamps.max()} us is none")
    return np.asarray(stamps, np.int64) * US


def _gps(g: Gatherer, name: str, rank: int, time: NDArray[np.int64], data: dict[str, Any]) -> None:
    fixed = np.asarray(data["fix_type"])
    flat, solid = fixed >= TWO_D, fixed >= THREE_D
    place = {
        "lat": _either(data, "latitude_deg", "lat"),
        "lon": _either(data, "longitude_deg", "lon"),
        "height": _where(solid, _height(data)),
        "sigma_north": _accuracy(data, "eph"), "sigma_east": _accuracy(data, "eph"),
        "sigma_down": _accuracy(data, "epv"),
    }  # fmt: skip
    g.add(name, "fix", time, {k: _where(flat, v) for k, v in place.items()}, rank)
    moving = solid & (np.asarray(data["vel_ned_valid"]) != 0 if "vel_ned_valid" in data else True)
    speed = {q: np.asarray(data[f"vel_{a}_m_s"], np.float64) for q, a in (("vn", "n"), ("ve", "e"), ("vd", "d"))}  # fmt: skip
    speed |= dict.fromkeys(("sigma_vn", "sigma_ve", "sigma_vd"), _accuracy(data, "s_variance_m_s"))
    g.add(name, "velocity", time, {k: _where(moving, v) for k, v in speed.items()}, rank)


def _either(data: dict[str, Any], new: str, old: str) -> Array:
    """A field as versions since 1.15 or before have it."""
    if new in data:
        return np.asarray(data[new], np.float64)
    return np.asarray(data[old], np.float64) * SCALE[old]


def _height(data: dict[str, Any]) -> Array:
    """Over the ellipsoid where that is told, else over the sea."""
    if "altitude_ellipsoid_m" in data or "alt_ellipsoid" in data:
        return _either(data, "altitude_ellipsoid_m", "alt_ellipsoid")
    return _either(data, "altitude_msl_m", "alt")


def _accuracy(data: dict[str, Any], name: str) -> Array:
    """A standard deviation, NaN where there is none."""
    values = np.asarray(data.get(name, np.full(len(data["timestamp"]), np.nan)), np.float64)
    return np.where(values > 0.0, values, np.nan)


def _where(good: Any, values: Array) -> Array:
    return np.where(good, values, np.nan)


def _local(g: Gatherer, name: str, time: NDArray[np.int64], data: dict[str, Any]) -> None:
    """The estimate of position and velocity, north, east, down of where it started."""
    flat = np.asarray(data.get("xy_valid", np.ones(len(time)))) != 0
    moving = np.asarray(data.get("v_xy_valid", np.ones(len(time)))) != 0
    place = {q: _where(flat, data[a].astype(np.float64)) for q, a in (("north", "x"), ("east", "y"), ("down", "z"))}  # fmt: skip
    g.add(name, "position", time, place, ESTIMATE)
    speed = {q: _where(moving, data[a].astype(np.float64)) for q, a in (("vn", "vx"), ("ve", "vy"), ("vd", "vz"))}  # fmt: skip
    g.add(name, "velocity", time, speed, ESTIMATE)
