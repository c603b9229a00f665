"""ArduPilot's dataflash logs, NAME.bin, over pymavlink; stamps since boot.

The library finds the messages and knows their formats; all of one type are turned into columns at
once, as a message object of the library for each takes a hundred times as long.
"""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.DFReader import FORMAT_TO_STRUCT, DFReader_binary

from navgym.core.checks import Array
from navgym.formats.channels import ESTIMATE, FURTHER, SENSOR, Gatherer, Stamps

US = 1000  # ns
LATEST = 1 << 53  # us
MESSAGES = ("GPS", "GPS2", "GPA", "GPA2", "IMU", "IMU2", "IMU3", "ATT", "XKF1", "NKF1")
ESTIMATORS = ("XKF1", "NKF1")
TWO_D, THREE_D = 2, 3  # kinds of fix
HEAD = 3  # bytes before the fields of a message
PADDING = 528  # bytes of a page that may follow the last message
AT_ONCE = 10_000  # messages

Columns = dict[str, Array]  # fields of a message type, or of one instance of it
Accuracies = dict[int, tuple[Stamps, Columns]]  # by receiver


def read(path: Path, gatherer: Gatherer) -> None:
    """Every channel of a log whose message is known."""
    said = io.StringIO()  # it prints its doubts
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        log = _Log(str(path))
    try:
        unread = log.data_len - sum(
            count * log.formats[kind].len for kind, count in enumerate(log.counts) if count
        )
        accuracy: Accuracies = {}
        for name in sorted(MESSAGES):  # GPA before GPS
            gatherer.progress.at(sorted(MESSAGES).index(name) / len(MESSAGES))
            for instance, time, columns in _instances(log, name):
                _take(gatherer, accuracy, name, instance, time, columns)
    finally:
        log.close()
    if unread < 0:
        gatherer.doubts.append("the last message was cut off: left out")
    elif unread > PADDING:
        gatherer.doubts.append(f"{unread} bytes are in no message that is known: left out")
    elif unread:
        gatherer.said.append(f"{unread} bytes, as at the end of a log, are left out")


class _Log(DFReader_binary):  # type: ignore[misc]
    """The library's reader by its index in Python: the compiled one prints past Python's streams."""

    def init_arrays_fast(self, progress_callback: Any = None) -> None:
        """Find the messages."""
        self.init_arrays(progress_callback)


def _instances(log: Any, name: str) -> list[tuple[int, Stamps, Columns]]:
    """Messages of a type for each of several sensors alike, with stamps, ns since boot.

    Logs since 4.0 tell the instance in a field, older ones in the name.
    """
    columns = _columns(log, name)
    if not columns:
        return []
    stamps = _since_boot(name, columns)
    wrong = ~((stamps >= 0) & (stamps < LATEST))
    if wrong.any():
        raise ValueError(f"a {name} of {stamps[np.argmax(wrong)]:g} us after boot")
    time = stamps.astype(np.int64) * US
    told = columns.get("I", columns.get("C"))
    if told is None:
        last = name[-1]
        number = int(last) - 1 if last.isdigit() and name not in ESTIMATORS else 0
        return [(number, time, columns)]
    found = []
    for each in np.unique(told):
        rows = told == each
        found.append((int(each), time[rows], {k: v[rows] for k, v in columns.items()}))
    return found


def _since_boot(name: str, columns: Columns) -> Array:
    """us; before ArduPilot 3.3 there were ms, those of a receiver beside the week's."""
    if "TimeUS" in columns:
        return columns["TimeUS"]
    for old in ("T", "TimeMS"):
        if old in columns:
            return columns[old] * 1e3
    raise ValueError(f"{name} tells no TimeUS, T or TimeMS: no time is known")


def _columns(log: Any, name: str) -> Columns:
    """Numbers of all whole messages of a type, in the order of the file; none where there is none."""
    if name not in log.name_to_id:
        return {}
    form = log.formats[log.name_to_id[name]]
    codes = [FORMAT_TO_STRUCT[letter][0] for letter in form.msg_fmts]
    if struct.calcsize(form.msg_struct) != form.len - HEAD:
        raise ValueError(f"the fields of {name} do not fill its {form.len} bytes")
    fields = [
        (column, f"<{code}", struct.calcsize("<" + "".join(codes[:k])), scale)
        for k, (column, code, scale) in enumerate(zip(form.columns, codes, form.msg_mults, strict=False))
        if not code.endswith("s")
    ]  # fmt: skip
    names, formats, offsets, scales = zip(*fields, strict=True) if fields else ((),) * 4
    row = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": form.len - HEAD})  # fmt: skip
    starts = np.asarray(log.offsets[form.type], np.int64)
    starts = starts[starts + form.len <= log.data_len]
    rows = np.concatenate([np.zeros(0, row), *_rows(log, starts + HEAD, row)])
    return {
        column: rows[column].astype(np.float64) / (1.0 if scale is None else 1.0 / scale)
        for column, scale in zip(names, scales, strict=True)
    } if len(rows) else {}  # fmt: skip


def _rows(log: Any, starts: Stamps, row: np.dtype[Any]) -> Iterator[NDArray[Any]]:
    data = np.frombuffer(log.data_map, np.uint8)
    for k in range(0, len(starts), AT_ONCE):
        index = starts[k : k + AT_ONCE, None] + np.arange(row.itemsize)
        yield np.ascontiguousarray(data[index]).view(row)[:, 0]


def _take(g: Gatherer, accuracy: Accuracies, name: str, instance: int, time: Stamps, m: Columns) -> None:  # fmt: skip
    base = name if name in ESTIMATORS else name.rstrip("123")
    label, rank = f"{base}[{instance}]", SENSOR if instance == 0 else FURTHER
    if base == "GPS":
        _gps(g, label, rank, time, m, accuracy.get(instance))
    elif base == "GPA":
        accuracy[instance] = time, m
    elif base == "IMU":
        rates = {f"gyro_{axis.lower()}": m[f"Gyr{axis}"] for axis in "XYZ"}
        g.add(label, "imu", time, rates | {f"acc_{axis.lower()}": m[f"Acc{axis}"] for axis in "XYZ"}, rank)  # fmt: skip
    elif base == "ATT":
        turned = {"roll": m["Roll"], "pitch": m["Pitch"], "heading": m["Yaw"]}
        g.add("ATT", "attitude", time, {k: np.radians(v) for k, v in turned.items()}, ESTIMATE)
    elif instance == 0:  # the estimate of the first core
        place = {"north": m["PN"], "east": m["PE"], "down": m["PD"]}
        g.add(name, "position", time, place, ESTIMATE)
        g.add(name, "velocity", time, {"vn": m["VN"], "ve": m["VE"], "vd": m["VD"]}, ESTIMATE)


def _gps(g: Gatherer, label: str, rank: int, time: Stamps, m: Columns, told: tuple[Stamps, Columns] | None) -> None:  # fmt: skip
    flat, solid = m["Status"] >= TWO_D, m["Status"] >= THREE_D
    across, along, speed = (_at(time, told, name) for name in ("HAcc", "VAcc", "SAcc"))
    fix = {
        "lat": m["Lat"], "lon": m["Lng"], "height": np.where(solid, m["Alt"], np.nan),
        "sigma_north": across, "sigma_east": across, "sigma_down": along,
    }  # fmt: skip
    g.add(label, "fix", time, {k: np.where(flat, v, np.nan) for k, v in fix.items()}, rank)
    course = np.radians(m["GCrs"])
    velocity = {"vn": m["Spd"] * np.cos(course), "ve": m["Spd"] * np.sin(course)}
    if "VZ" in m:
        velocity["vd"] = np.where(solid, m["VZ"], np.nan)
    velocity |= dict.fromkeys(("sigma_vn", "sigma_ve", "sigma_vd"), speed)
    g.add(
        label, "velocity", time, {k: np.where(flat, v, np.nan) for k, v in velocity.items()}, rank
    )


def _at(time: Stamps, told: tuple[Stamps, Columns] | None, name: str) -> Array:
    """A receiver's accuracy at its rows, told in messages of their own of the same stamps."""
    if told is None:
        return np.full(len(time), np.nan)
    stamps, index = np.unique(told[0], return_index=True)
    at = np.clip(np.searchsorted(stamps, time), 0, len(stamps) - 1)
    sigma = told[1][name][index[at]]
    return np.where((stamps[at] == time) & (sigma > 0.0), sigma, np.nan)
