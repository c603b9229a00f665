"""RDI PD0: bottom track of a Doppler log, its heading and clock.

By a parser of our own: the packages that read PD0 are made for current profiles, are not kept, or
bring xarray and more with them, and what is needed here is four numbers of an ensemble. Velocities
must have been logged in ship or earth axes (EX11111): those of beams and of the instrument need
what the file does not hold, how it is mounted.
"""

from __future__ import annotations

import datetime as dt
import math
import mmap
import struct
from collections.abc import Iterator
from pathlib import Path

from navgym.core.units import DEGREE
from navgym.formats.channels import SECOND, Gatherer

HEADER = b"\x7f\x7f"
FIXED, VARIABLE, BOTTOM = 0x0000, 0x0080, 0x0600  # ids of the blocks
LOST = -32768
MILLIMETRE = 1e-3
AXES = {0: "beam", 1: "instrument", 2: "ship", 3: "earth"}
NAN = math.nan
LENGTHS = {FIXED: 42, VARIABLE: 40, BOTTOM: 32}  # bytes of a block that are looked at
EVERY = 1000  # ensembles between two reports of progress


def read(path: Path, gatherer: Gatherer) -> None:
    """Velocities over the bottom and headings of every ensemble whose checksum is right."""
    if path.stat().st_size < 6:
        raise ValueError("it is shorter than a header")
    count = empty = 0
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for end, blocks in _ensembles(data, gatherer):
            count += 1
            if BOTTOM in blocks and VARIABLE in blocks and FIXED in blocks:
                _take(gatherer, blocks)
            else:
                empty += 1
            if count % EVERY == 0:
                gatherer.progress.at(end / len(data))
    if not count:
        raise ValueError("no ensemble has a right checksum")
    if empty:
        gatherer.said.append(f"{empty} of {count} ensembles have no bottom track: left out")


def _ensembles(data: mmap.mmap, gatherer: Gatherer) -> Iterator[tuple[int, dict[int, bytes]]]:
    """End and blocks, by id, of each ensemble; bytes that are in none are counted."""
    at = skipped = 0
    while True:
        begin = data.find(HEADER, at)
        if begin < 0 or begin + 6 > len(data):
            skipped += len(data) - at
            break
        skipped += begin - at
        (size,) = struct.unpack_from("<H", data, begin + 2)
        end = begin + size + 2
        if size < 6 or end > len(data) or not _sound(data, begin, size):
            skipped += 1
            at = begin + 1
            continue
        yield end, _blocks(data[begin : begin + size])
        at = end
    if skipped:
        gatherer.doubts.append(f"{skipped} bytes are in no sound ensemble: left out")


def _sound(data: mmap.mmap, begin: int, size: int) -> bool:
    (told,) = struct.unpack_from("<H", data, begin + size)
    return bool(sum(data[begin : begin + size]) & 0xFFFF == told)


def _blocks(ensemble: bytes) -> dict[int, bytes]:
    """Blocks of an ensemble by id, those that are too short left out."""
    count, found = ensemble[5], {}
    if 6 + 2 * count > len(ensemble):
        return {}
    offsets = struct.unpack_from(f"<{count}H", ensemble, 6)
    for offset in offsets:
        if offset + 2 <= len(ensemble):
            (name,) = struct.unpack_from("<H", ensemble, offset)
            if len(ensemble) - offset >= LENGTHS.get(name, 2):
                found[name] = ensemble[offset:]
    return found


def _take(g: Gatherer, blocks: dict[int, bytes]) -> None:
    leader, variable, bottom = blocks[FIXED], blocks[VARIABLE], blocks[BOTTOM]
    axes = AXES[leader[25] >> 3 & 3]
    if axes in ("beam", "instrument"):
        raise ValueError(
            f"velocities are in {axes} axes, and how the instrument is mounted is not in the file: "
            "log in ship or earth axes (EX11111), or convert with the maker's tool"
        )
    stamp = _stamp(variable)
    # velocities of the bottom, seen from the vehicle: its own are the opposite
    four = struct.unpack_from("<4h", bottom, 24)
    a, b, up = (NAN if value == LOST else -value * MILLIMETRE for value in four[:3])
    if axes == "ship":  # starboard, forward, mast
        g.rows_of("bottom_track", "body_velocity").add(stamp, b, a, -up)
    else:  # east, north, up
        g.rows_of("bottom_track", "velocity").add(stamp, b, a, -up)
    (heading,) = struct.unpack_from("<H", variable, 18)
    if heading >= 36_000:
        raise ValueError(f"a heading of {heading / 100} degrees")
    # ship axes that were levelled need the heading only, and others are nearly level
    g.rows_of("variable_leader", "attitude").add(stamp, NAN, NAN, heading / 100 * DEGREE)


def _stamp(variable: bytes) -> int:
    """ns since 1970, of the clock with a century where there is one."""
    year, month, day, hour, minute, second, hundredth = variable[4:11]
    year += 2000 if year < 80 else 1900
    if len(variable) >= 65 and variable[57] in (19, 20):
        year = variable[57] * 100 + variable[58]
        month, day, hour, minute, second, hundredth = variable[59:65]
    moment = dt.datetime(year, month, day, hour, minute, second, tzinfo=dt.UTC)
    return int(moment.timestamp()) * SECOND + hundredth * SECOND // 100
