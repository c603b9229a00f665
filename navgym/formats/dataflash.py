"""ArduPilot's dataflash logs, NAME.bin, over pymavlink; stamps since boot."""

from __future__ import annotations

import contextlib
import io
import math
from pathlib import Path
from typing import Any

from pymavlink.DFReader import DFReader_binary

from navgym.formats.channels import ESTIMATE, FURTHER, KINDS, SENSOR, Gathered, Gatherer

NAN = math.nan
US = 1000  # ns
LATEST = 1 << 53  # us
MESSAGES = ("GPS", "GPS2", "GPA", "GPA2", "IMU", "IMU2", "IMU3", "ATT", "XKF1", "NKF1")
TWO_D, THREE_D = 2, 3  # kinds of fix
PADDING = 528  # bytes of a page that may follow the last message
EVERY = 5000  # messages between two reports of progress


def read(path: Path, gatherer: Gatherer) -> None:
    """Every channel of a log whose message is known."""
    said = io.StringIO()  # it prints its doubts
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        log = DFReader_binary(str(path))
    unread = log.data_len - sum(
        count * log.formats[kind].len for kind, count in enumerate(log.counts) if count
    )
    accuracy: dict[str, dict[int, tuple[float, float, float]]] = {}
    count = 0
    try:
        while True:
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                message = log.recv_match(type=list(MESSAGES))
            if message is None:
                break
            _take(gatherer, accuracy, message)
            count += 1
            if count % EVERY == 0:
                gatherer.progress.at(log.percent / 100.0)
    finally:
        log.close()
    for name, sigmas in accuracy.items():
        _put(gatherer, name, sigmas)
    if unread > PADDING:
        gatherer.doubts.append(f"{unread} bytes are in no message that is known: left out")
    elif unread:
        gatherer.said.append(f"{unread} bytes, as at the end of a log, are left out")


def _take(g: Gatherer, accuracy: dict[str, dict[int, tuple[float, float, float]]], m: Any) -> None:
    kind = m.get_type()
    if not 0 <= m.TimeUS < LATEST:
        raise ValueError(f"a {kind} of {m.TimeUS} us after boot")
    base, stamp = kind.rstrip("123") if kind not in ("XKF1", "NKF1") else kind, int(m.TimeUS) * US
    instance = _instance(kind, base, m)
    name, rank = f"{base}[{instance}]", SENSOR if instance == 0 else FURTHER
    if base == "GPS":
        _gps(g, name, rank, stamp, m)
    elif base == "GPA":
        accuracy.setdefault(f"GPS[{instance}]", {})[stamp] = (m.HAcc, m.VAcc, m.SAcc)
    elif base == "IMU":
        g.rows_of(name, "imu", rank).add(stamp, m.GyrX, m.GyrY, m.GyrZ, m.AccX, m.AccY, m.AccZ)
    elif base == "ATT":
        turned = (math.radians(value) for value in (m.Roll, m.Pitch, m.Yaw))
        g.rows_of("ATT", "attitude", ESTIMATE).add(stamp, *turned)
    elif instance == 0:  # the estimate of the first core
        g.rows_of(kind, "position", ESTIMATE).add(stamp, m.PN, m.PE, m.PD)
        g.rows_of(kind, "velocity", ESTIMATE).add(stamp, m.VN, m.VE, m.VD)


def _instance(kind: str, base: str, m: Any) -> int:
    """Which of several alike: logs since 4.0 say so in a field, older ones in the name."""
    fields = m.get_fieldnames()
    told = next((int(getattr(m, name)) for name in ("I", "C") if name in fields), None)
    return told if told is not None else int(kind[len(base) :] or 1) - 1


def _gps(g: Gatherer, name: str, rank: int, stamp: int, m: Any) -> None:
    fix, velocity = g.rows_of(name, "fix", rank), g.rows_of(name, "velocity", rank)
    if m.Status < TWO_D:
        fix.add(stamp)
        velocity.add(stamp)
        return
    solid = m.Status >= THREE_D
    fix.add(stamp, m.Lat, m.Lng, m.Alt if solid else NAN)
    course = math.radians(m.GCrs)
    down = m.VZ if "VZ" in m.get_fieldnames() and solid else NAN
    velocity.add(stamp, m.Spd * math.cos(course), m.Spd * math.sin(course), down)


def _put(g: Gatherer, name: str, sigmas: dict[int, tuple[float, float, float]]) -> None:
    """Put a receiver's accuracies, told in messages of their own, to its rows."""
    for kind in ("fix", "velocity"):
        rows = g.rows.get((name, kind))
        for k, stamp in enumerate(rows.time if rows else ()):
            if rows and stamp in sigmas:
                across, along, speed = (value if value > 0.0 else NAN for value in sigmas[stamp])
                told = (across, across, along) if kind == "fix" else (speed,) * 3
                _fill(rows, k, told)


def _fill(rows: Gathered, k: int, told: tuple[float, ...]) -> None:
    width = len(KINDS[rows.kind])
    for j, sigma in enumerate(told):
        rows.values[k * width + 3 + j] = sigma
