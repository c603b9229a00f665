"""MAVLink telemetry logs, NAME.tlog, over pymavlink; stamps since the vehicle's boot.

The stamps of the ground station, which no checksum guards and which hold the delays of the link,
serve only where a message tells no time of its own.
"""

from __future__ import annotations

import contextlib
import io
import math
import mmap
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from navgym.core.text import opened
from navgym.formats.channels import ESTIMATE, FURTHER, SENSOR, Gatherer
from navgym.inertial.earth import GRAVITY

NAN = math.nan
UNKNOWN = 65535  # of 16 bits: not known
TWO_D, THREE_D = 2, 3  # kinds of fix
BOOT = 10**14  # us: later times are dates
LATEST = 1 << 53  # us
MARKERS = (mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2)  # first bytes of packets
STAMP = 8  # bytes
ALL_BAD = 0.5  # share of bad packets from which the file is no log
EVERY = 5000  # messages between two reports of progress


def read(path: Path, gatherer: Gatherer) -> None:
    """Every channel of a log whose message is known, by message and system, such as ATTITUDE@1."""
    clock = _Clock()
    with _content(path) as data:
        packets = _Packets(data)
        for count, (received, message) in enumerate(packets):
            kind = message.get_type()
            stamp = clock.stamp(message, received)
            TAKERS[kind](gatherer, f"{kind}@{message.get_srcSystem()}", stamp, message)
            if count % EVERY == 0:
                gatherer.progress.at(packets.at / len(data))
    clock.settle(gatherer)
    if packets.bad > ALL_BAD * packets.count:
        raise ValueError(f"{packets.bad} of {packets.count} packets are damaged")
    if packets.bad:
        gatherer.doubts.append(f"{packets.bad} of {packets.count} packets are damaged: left out")
    if packets.missing:
        whole = packets.count - packets.bad + packets.missing
        gatherer.said.append(f"by their numbers {packets.missing} of {whole} packets ({packets.missing / whole:.1%}) were lost on the link")  # fmt: skip


@contextlib.contextmanager
def _content(path: Path) -> Iterator[bytes | mmap.mmap]:
    """The bytes of a file, by pages as they are looked at; one that gzip packed is unpacked whole."""
    with opened(path) as file:
        if not isinstance(file, io.BufferedReader) or not path.stat().st_size:
            yield file.read()
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data


class _Packets:
    """The wanted messages of a log, each after 8 bytes that say when it was received.

    A packet of another type is stepped over by its length, without decoding, which takes most of
    the time. Where no packet begins as it should, the next one with a right checksum is looked for.
    """

    def __init__(self, data: bytes | mmap.mmap) -> None:
        self.data = data
        self.at = 0  # where the next 8 bytes are
        self.count = self.bad = self.missing = 0
        self.numbers: dict[tuple[int, int], int] = {}  # the last one's, by system and component
        self.link = mavlink.MAVLink(None)

    def __iter__(self) -> Iterator[tuple[int, Any]]:
        """When it was received, us, and what."""
        lost = False
        while self.at + STAMP < len(self.data):
            begin = self.at + STAMP
            end, wanted = self._extent(begin)
            whole = 0 < end <= len(self.data)
            if whole and not wanted and not lost:
                self.count += 1
                self._numbered(begin)
                self.at = end
                continue
            message = self._decoded(begin, end) if whole else None
            if message is None:
                self.count += not lost
                self.bad += not lost
                lost = True
                self.at = self._next(begin + 1) - STAMP
                continue
            self.count += 1
            self._numbered(begin)
            lost, self.at = False, end
            if message.get_type() in TAKERS:
                yield int.from_bytes(self.data[begin - STAMP : begin], "big"), message

    def _numbered(self, begin: int) -> None:
        """Count the packets that are missing before one, which counts its sender's packets to 255."""
        at = begin + (2 if self.data[begin] == MARKERS[0] else 4)
        number, *sender = self.data[at : at + 3]
        last = self.numbers.get((sender[0], sender[1]), number - 1)
        gone = (number - last - 1) % 256
        self.missing += gone if gone < 240 else 0  # else it came twice, or late
        self.numbers[sender[0], sender[1]] = number

    def _extent(self, begin: int) -> tuple[int, bool]:
        """Where a packet ends, 0 where none begins, and whether its type is wanted."""
        head = self.data[begin : begin + 10]
        if len(head) < 10 or head[0] not in MARKERS:
            return 0, False
        if head[0] == MARKERS[0]:
            return begin + head[1] + 8, head[5] in WANTED
        signed = bool(head[2] & mavlink.MAVLINK_IFLAG_SIGNED)
        end = begin + head[1] + 12 + signed * mavlink.MAVLINK_SIGNATURE_BLOCK_LEN
        return end, int.from_bytes(head[7:10], "little") in WANTED

    def _decoded(self, begin: int, end: int) -> Any:
        """A message, None without a right checksum or of a type whose checksum nobody knows."""
        flags = self.data[begin + 2] if self.data[begin] == MARKERS[1] else 0
        if flags & ~mavlink.MAVLINK_IFLAG_SIGNED:
            return None
        try:
            found = self.link.decode(bytearray(self.data[begin:end]))
        except mavlink.MAVError:
            return None
        return None if found.get_msgId() < 0 else found

    def _next(self, begin: int) -> int:
        found = [k for mark in MARKERS if (k := self.data.find(mark, begin)) >= 0]
        return min(found, default=len(self.data))


class _Clock:
    """When messages were made, ns since boot."""

    def __init__(self) -> None:
        self.ahead = array("d")  # ns, by which the ground's clock is
        self.untimed = 0

    def stamp(self, m: Any, us: int) -> int:
        """ns since boot; negative, of the ground's clock, where the message does not tell."""
        received = min(us, LATEST) * 1000
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
WANTED = {number for number, each in mavlink.mavlink_map.items() if each.msgname in TAKERS}
