"""A log of a robot or an autopilot as an inertial recording: its IMU, and what else it measures."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.core.notes import Notes
from navgym.formats.channels import SENSOR, Channel, Channels
from navgym.formats.choose import check_roles, chosen
from navgym.formats.kinds import read_channels
from navgym.formats.rows import alone, begun, ordered
from navgym.ins.csv_set import ACCELEROMETERS, COLUMNS, GYROS, recording_of
from navgym.ins.model import InsModel
from navgym.ins.recording import InertialRecording

# kinds of channel that a sensor's measurements may come from
KINDS = {
    "dvl": "body_velocity", "fix": "fix", "depth": "depth", "heading": "attitude",
    "magnetometer": "magnetometer",
}  # fmt: skip
ROLES = ("imu", *KINDS)
SIGMAS = {"dvl": ("sigma_u", "sigma_v", "sigma_w"), "fix": ("sigma_north", "sigma_east", "sigma_down")}  # fmt: skip
NO_HEIGHT = 1e3  # m: deviation of the height of a fix that tells none


def read_ins_log(
    path: str | os.PathLike[str],
    *,
    kind: str | None = None,
    topics: Mapping[str, str] | None = None,
    model: Mapping[str, Any] | InsModel | None = None,
    sensors: Mapping[str, Mapping[str, Any]] | None = None,
    time_offsets: Mapping[str, float] | None = None,
    turn: Mapping[str, str] | None = None,
    silent_after: float = 1.5,
    check_units: bool = True,
) -> InertialRecording:
    """IMU, Doppler log, fixes, depth and heading of a ROS bag, MCAP, ULog, dataflash log or tlog.

    What each kind of file holds: docs/formats.md. Only sensors count, not what a filter made of
    them. Where the log tells accuracies, the median of a sensor's is its noise. An orientation that
    the IMU's own topic tells is made from the IMU, and no heading unless `topics` says so.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        kind: of the file, such as "ros"; by its content by default.
        topics: names of channels by "imu", "dvl", "fix", "depth", "heading" and "magnetometer";
            "none" leaves one out.
        model: what a filter is to believe, as for `navgym.ins.csv_set.read_ins_csv`; so are the others.
        sensors: fields of `AidingModel` by sensor: noise, lever_arm, latency.
        time_offsets: s by which a sensor's stamps are late.
        turn: axes of the IMU that point the other way or are another's, such as
            {"gyro_y": "-gyro_y", "acc_x": "acc_y"}.
        silent_after: usual intervals after which a Doppler log counts as silent.
        check_units: whether to refuse data whose units or axes cannot be.

    Raises:
        FileNotFoundError: there is no such file.
        ImportError: naming the extra that reads such files.
        ValueError: a damaged or foreign file, no IMU, several channels that could be meant.
    """
    told = check_roles(topics, ROLES)
    channels = read_channels(path, kind)
    notes = Notes(channels.path.name)
    channels.tell(notes)
    said = notes.sentences
    imu = chosen(channels, "imu", ("imu",), told, said)
    if imu is None:
        raise ValueError(f"{channels.path.name} holds no IMU: format 'log' takes positions and velocities.")  # fmt: skip
    found = {"imu": imu} | _sensors(channels, imu, told, said)
    try:
        there = {name: ordered(channel, said) for name, channel in found.items()}
    except ValueError as error:
        raise ValueError(f"{channels.path.name}: {error}") from None
    start = int(there["imu"].time[0])
    tables = {n: alone(channels.path, c, _columns(n, c), start) for n, c in there.items()}
    noises = {n: {"noise": noise} for n, c in there.items() if (noise := _noise(n, c)) is not None}
    believed = {
        n: {**noises.get(n, {}), **(sensors or {}).get(n, {})} for n in {*noises, *(sensors or {})}
    }
    return recording_of(
        tables, notes, model=model, sensors=believed, time_offsets=time_offsets, turn=turn,
        silent_after=silent_after, check_units=check_units,
        meta={
            "format": "ins_log", "kind": channels.format, "file": channels.path.name, **begun(start),
        },
    )  # fmt: skip


def _sensors(
    channels: Channels, imu: Channel, topics: Mapping[str, str], said: list[str]
) -> dict[str, Channel]:
    """The channel of each sensor that the log has."""
    found = {}
    for name, kind in KINDS.items():
        if name == "heading" and name not in topics:
            own = [c.name for c in channels.of(kind) if c.name == imu.name]
            others = [c for c in channels.of(kind) if c.name != imu.name and c.rank == SENSOR]
            if own:
                said.append(
                    f"the orientation of {own[0]} left out as heading: made from the IMU itself"
                )
            if not others:
                continue
        channel = chosen(channels, name, (kind,), topics, said, estimates=False)
        if channel is not None and not (name == "heading" and channel is imu):
            found[name] = channel
    return found


def _columns(name: str, c: Channel) -> dict[str, Array]:
    """Columns of a sensor's table."""
    if name == "imu":
        return {quantity: c[quantity] for quantity in (*GYROS, *ACCELEROMETERS)}
    if name == "fix":
        height = (
            c["height"]
            if not np.isnan(c["height"]).all()
            else np.where(np.isnan(c["lat"]), np.nan, 0.0)
        )
        return {"latitude": c["lat"], "longitude": c["lon"], "depth": -height}
    if name == "heading":
        return {"heading": np.degrees(c["heading"])}
    return dict(zip(COLUMNS[name][0], c.values.T, strict=False))


def _noise(name: str, c: Channel) -> Sequence[float] | None:
    """Medians of the accuracies that a log tells of a sensor, where it tells them of every axis."""
    if name not in SIGMAS:
        return None
    usual = [
        float(np.nanmedian(c[s])) if not np.isnan(c[s]).all() else np.nan for s in SIGMAS[name]
    ]
    if name == "fix" and np.isnan(c["height"]).all():
        usual = [*(2.0 if np.isnan(s) else s for s in usual[:2]), NO_HEIGHT]
    return None if np.isnan(usual).any() else usual
