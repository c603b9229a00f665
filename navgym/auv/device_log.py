"""A log of a robot, a receiver or an autopilot as an AUV's recording."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from navgym.auv.csv_log import recording_of
from navgym.auv.log import component_names
from navgym.core.checks import Array
from navgym.core.notes import Notes, Progress
from navgym.core.tables import Table
from navgym.formats.channels import ESTIMATE, Channel, Channels
from navgym.formats.choose import check_roles, chosen
from navgym.formats.frames import attitude_at, world_velocity
from navgym.formats.kinds import read_channels
from navgym.formats.rows import TIME, begun, rows_of
from navgym.statespace.recording import Model, Recording

ROLES = ("position", "velocity", "attitude")
HEADING = "heading (rad)"
# our quantities by what channels call them
QUANTITIES = {
    "fix": {"lat": "lat", "lon": "lon", "height": "height", "sigma_px": "sigma_north",
            "sigma_py": "sigma_east"},
    "position": {"px": "north", "py": "east", "pz": "down", "sigma_px": "sigma_north",
                 "sigma_py": "sigma_east"},
    "velocity": {"vx": "vn", "vy": "ve", "vz": "vd", "sigma_vx": "sigma_vn", "sigma_vy": "sigma_ve"},
}  # fmt: skip
UNITS = {"lat": "deg", "lon": "deg", "height": "m", "heading": "rad"}


def read_log(
    path: str | os.PathLike[str],
    *,
    kind: str | None = None,
    topics: Mapping[str, str] | None = None,
    model: Model | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    missing: Sequence[str | float] = (),
    sort: bool | None = None,
    held: str = "auto",
    origin: Sequence[float] | None = None,
    lever_arm: Sequence[float] | None = None,
    latency: Mapping[str, float] | None = None,
    accuracy_floor: float = 0.0,
    position_noise: float = 1.0,
    velocity_noise: float = 0.1,
    acceleration: float = 0.1,
) -> Recording:
    """Positions and velocities of a ROS bag, MCAP, ULog, dataflash log, tlog, NMEA 0183, SBET or PD0.

    What each kind of file holds, and which extra of navgym it needs: docs/formats.md. A sensor goes
    before what a filter made of sensors; a velocity in body axes is turned by the attitude that the
    log holds. Where two channels could each be meant, `topics` has to say which. Columns bear the
    names "TOPIC.QUANTITY", and "line" in an error is the number of a row of these.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        kind: "ros", "ulog", "ardupilot", "tlog", "nmea", "sbet" or "pd0"; by its content by default.
        topics: names of channels by "position", "velocity" and "attitude"; "none" leaves one out.
        model: what a filter is to believe, as for `navgym.auv.csv_log.read_csv`; so are the others.
        columns: columns by quantity, in place of those that the channels' kinds tell.
        units: of columns; those of channels are SI.
        missing: further numbers that stand for a lost measurement.
        sort: True sorts rows whatever their times, False refuses any that come late.
        held: "lost", "keep" or "auto": what is made of repeated last values.
        origin: latitude and longitude, °, and height, m, of px = py = 0; the first fix by default.
        lever_arm: forward and right, m, from the vehicle's centre to the position sensor.
        latency: s by which "position" or "velocity" are late.
        accuracy_floor: least standard deviation believed of the log's own, m and m/s.
        position_noise: standard deviation of a position in the default model, m.
        velocity_noise: of a velocity, m/s.
        acceleration: of the vehicle's white acceleration.

    Raises:
        FileNotFoundError: there is no such file.
        ImportError: naming the extra that reads such files.
        ValueError: a damaged or foreign file, several channels that could be meant, and as `read_csv`.
    """
    told = Told.of(path, kind, topics, model, lever_arm is not None)
    with Progress(f"reading {Path(path).name}") as progress:
        return recording_of(
            told.table, progress, model=model, columns={**told.columns, **(columns or {})},
            units={**told.units, **(units or {})}, missing=missing, extra="ignore",
            sort=sort, held=held, origin=origin, lever_arm=lever_arm, latency=latency,
            accuracy_floor=accuracy_floor, position_noise=position_noise,
            velocity_noise=velocity_noise, acceleration=acceleration,
            meta={"format": "log", "kind": told.kind} | begun(told.table.cells[TIME][0]),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Told:
    """What a log tells of positions and velocities.

    Args:
        kind: of the file.
        table: a row for each row of each channel.
        columns: of the table, by quantity.
        units: of columns, by quantity.
        channels: that measure: a position, a velocity, or both.
        attitude: which turns and moves them, or could, or None.
        turned: whether the velocity is of a sensor in the vehicle's axes.
    """

    kind: str
    table: Table
    columns: Mapping[str, str]
    units: Mapping[str, str]
    channels: Sequence[Channel]
    attitude: Channel | None
    turned: bool

    @classmethod
    def of(
        cls,
        path: str | os.PathLike[str],
        kind: str | None,
        topics: Mapping[str, str] | None,
        model: Model | None,
        levered: bool,
    ) -> Told:
        """What a file tells; arguments and errors of `read_log`."""
        told = check_roles(topics, ROLES)
        channels = read_channels(path, kind)
        notes = Notes(channels.path.name)
        channels.tell(notes)
        said = notes.sentences
        there, attitude, turned = _channels(channels, told, levered, said)
        heading = attitude if levered else None
        deep = {"pz", "vz"}.difference(() if model is None else component_names(model)[0])
        own = {
            quantity: channel.column(name)
            for channel in there
            for quantity, name in QUANTITIES[channel.kind].items()
            if not np.isnan(channel[name]).all() and quantity not in deep
        }
        more = {} if heading is None else {HEADING: [_headings(heading, c) for c in there]}
        table = rows_of(channels.path, there, said, more)
        own |= {"time": TIME} | ({} if heading is None else {"heading": HEADING})
        known = {q: unit for q, unit in UNITS.items() if q in own} | {"time": "ns"}
        if attitude is None:
            attitude = _only(channels)
        return cls(channels.format, table, own, known, there, attitude, turned)


def _channels(
    channels: Channels, topics: Mapping[str, str], levered: bool, said: list[str]
) -> tuple[list[Channel], Channel | None, bool]:
    """Those that measure, a velocity in our axes, the attitude if it is needed, and whether it turned."""
    position = chosen(channels, "position", ("fix", "position"), topics, said)
    estimated = position is not None and position.rank == ESTIMATE
    velocity = chosen(
        channels,
        "velocity",
        ("velocity", "body_velocity"),
        topics,
        said,
        position is None or estimated,
    )
    if position is None and velocity is None:
        names = ", ".join(f"{c.name} ({c.kind.replace('_', ' ')})" for c in channels.found)
        raise ValueError(
            f"{channels.path.name} holds no position and no velocity, but {names}: formats 'ins_log' "
            "and 'deck_log' take IMUs."
        )
    attitude = None
    if levered or (velocity is not None and velocity.kind == "body_velocity"):
        attitude = chosen(channels, "attitude", ("attitude",), topics, said)
    turned = velocity is not None and velocity.kind == "body_velocity"
    if velocity is not None and turned:
        velocity = _turned(channels, velocity, attitude, position is None, said)
    return [c for c in (position, velocity) if c is not None], attitude, turned


def _only(channels: Channels) -> Channel | None:
    """The attitude of a log that has one."""
    there = channels.of("attitude")
    return there[0] if len(there) == 1 else None


def _turned(
    channels: Channels, body: Channel, attitude: Channel | None, alone: bool, said: list[str]
) -> Channel | None:
    """A velocity in body axes turned north and east, or left out, which is said."""
    if attitude is None:
        what = f"{body.name} is in the vehicle's axes, and the log holds no attitude to turn it by"
        if alone:
            raise ValueError(f"{channels.path.name}: {what}.")
        said.append(f"{body.name} left out as velocity: {what}")
        return None
    found = world_velocity(body, attitude)
    lost = int((np.isnan(found["vn"]) & ~np.isnan(body["u"])).sum())
    said.append(f"{body.name} turned north and east by {attitude.name}")
    if lost:
        said.append(f"{lost} of {len(body)} velocities are lost: no attitude at their times")
    return replace(found, name=body.name)


def _headings(attitude: Channel, channel: Channel) -> Array:
    """Heading at the rows of a channel, rad, NaN where it is not known."""
    turned, known = attitude_at(attitude, channel.time)
    heading: Array = np.where(known, turned.as_euler("ZYX")[:, 0], np.nan)
    return heading
