"""MAVLink telemetry logs, NAME.tlog, over pymavlink; stamps since the vehicle's boot.

The stamps of the ground station, which no checksum guards and which hold the delays of the link,
serve only where a message tells no time of its own.
"""

from __future__ import annotations

import contextlib
import io
import math
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink import mavutil

from navgym.formats.channels import ESTIMATE, FURTHER, SENSOR, Gatherer
from navgym.inertial.earth import GRAVITY

NAN = math.nan
UNKNOWN = 65535  # of 16 bits: not known
TWO_D, THREE_D = 2, 3  # kinds of fix
BOOT = 10**14  # us: later times are dates
ALL_BAD = 0.5  # share of bad packets from which the file is no log
EVERY = 5000  # messages between two reports of progress


def read(path: Path, gatherer: Gatherer) -> None:
    """Every channel of a log whose message is known, by message and system, such as ATTITUDE@1."""
    said = io.StringIO()  # it prints its doubts
    count, bad, clock = 0, 0, _Clock()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        log = mavutil.mavlogfile(str(path))
    try:
        while (message := log.recv_msg()) is not None:
            kind = message.get_type()
            count += 1
            bad += kind == "BAD_DATA"
            if kind in TAKERS:
                stamp = clock.stamp(message)
                TAKERS[kind](gatherer, f"{kind}@{message.get_srcSystem()}", stamp, message)
            if count % EVERY == 0:
                gatherer.progress.at(log.percent / 100.0)
    finally:
        log.close()
    clock.settle(gatherer)
    if bad > ALL_BAD * count:
        raise ValueError(f"{bad} of {count} packets are damaged")
    if bad:
        gatherer.doubts.append(f"{bad} of {count} packets are damaged: left out")


class _Clock:
    """When messages were made, ns since boot."""

    def __init__(self) -> None:
        self.ahead = array("d")  # ns, by which the ground's clock is
        self.untimed = 0

    def stamp(self, m: Any) -> int:
        """ns since boot; negative, of the ground's clock, where the message does not tell."""
        received: int = round(m._timestamp * 1e6) * 1000
        told = m.time_boot_ms * 1000 if hasattr(m, "time_boot_ms") else m.time_usec
        if not 0 < told < BOOT:
            self.untimed += 1
            return -received
        self.ahead.append(received - told * 1000)
        return int(told) * 1000

    def settle(self, g: Gatherer) -> None:
        """Turn stamps of the ground's clock into those since boot."""
        if not self.untimed:
            return
        ahead = int(np.median(self.ahead)) if self.ahead else 0
        for rows in g.rows.values():
            for k, stamp in enumerate(rows.time):
                if stamp < 0:
                    rows.time[k] = -stamp - ahead
        g.said.append(
            f"{self.untimed} messages tell no time since boot: taken when they were received"
        )


def _gps(g: Gatherer, name: str, stamp: int, m: Any) -> None:
    rank = FURTHER if name.startswith("GPS2") else SENSOR
    fix, velocity = g.rows_of(name, "fix", rank), g.rows_of(name, "velocity", rank)
    if m.fix_type < TWO_D:
        fix.add(stamp)
        velocity.add(stamp)
        return
    solid = m.fix_type >= THREE_D
    across, along, speed = (_told(getattr(m, n, 0)) for n in ("h_acc", "v_acc", "vel_acc"))
    # over the sea where only that is told
    height = (getattr(m, "alt_ellipsoid", 0) or m.alt) * 1e-3
    fix.add(stamp, m.lat * 1e-7, m.lon * 1e-7, height if solid else NAN, across, across, along)
    if UNKNOWN in (m.vel, m.cog):
        velocity.add(stamp)
        return
    v, course = m.vel * 1e-2, math.radians(m.cog * 1e-2)
    velocity.add(stamp, v * math.cos(course), v * math.sin(course), NAN, speed, speed, speed)


def _told(millimetres: float) -> float:
    """0 stands for not known."""
    return millimetres * 1e-3 if millimetres > 0 else NAN


def _global(g: Gatherer, name: str, stamp: int, m: Any) -> None:
    g.rows_of(name, "fix", ESTIMATE).add(stamp, m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3)
    g.rows_of(name, "velocity", ESTIMATE).add(stamp, m.vx * 1e-2, m.vy * 1e-2, m.vz * 1e-2)


def _local(g: Gatherer, name: str, stamp: int, m: Any) -> None:
    g.rows_of(name, "position", ESTIMATE).add(stamp, m.x, m.y, m.z)
    g.rows_of(name, "velocity", ESTIMATE).add(stamp, m.vx, m.vy, m.vz)


def _attitude(g: Gatherer, name: str, stamp: int, m: Any) -> None:
    g.rows_of(name, "attitude", ESTIMATE).add(stamp, m.roll, m.pitch, m.yaw)


def _scaled(g: Gatherer, name: str, stamp: int, m: Any) -> None:
    rank = SENSOR if name.startswith("SCALED_IMU@") else FURTHER
    rate = (m.xgyro * 1e-3, m.ygyro * 1e-3, m.zgyro * 1e-3)  # mrad/s
    force = (m.xacc * 1e-3 * GRAVITY, m.yacc * 1e-3 * GRAVITY, m.zacc * 1e-3 * GRAVITY)  # mg
    g.rows_of(name, "imu", rank).add(stamp, *rate, *force)


def _high(g: Gatherer, name: str, stamp: int, m: Any) -> None:
    g.rows_of(name, "imu").add(stamp, m.xgyro, m.ygyro, m.zgyro, m.xacc, m.yacc, m.zacc)


TAKERS: dict[str, Callable[[Gatherer, str, int, Any], None]] = {
    "GPS_RAW_INT": _gps,
    "GPS2_RAW": _gps,
    "GLOBAL_POSITION_INT": _global,
    "LOCAL_POSITION_NED": _local,
    "ATTITUDE": _attitude,
    "SCALED_IMU": _scaled,
    "SCALED_IMU2": _scaled,
    "SCALED_IMU3": _scaled,
    "HIGHRES_IMU": _high,
}
