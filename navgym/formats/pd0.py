"""RDI PD0: bottom track of a Doppler log, its heading and clock.

By a parser of our own: the packages that read PD0 are made for current profiles, are not kept, or
bring xarray and more with them, and what is needed here is four numbers of an ensemble. Velocities
along the beams (EX00xxx) and in the instrument's axes (EX01xxx) are turned to the ship's by the
geometry that the fixed leader tells, levelled by the tilts of the variable leader: after Teledyne
RDI, ADCP Coordinate Transformation: Formulas and Calculations (2008), 5.3 to 5.6.
"""

from __future__ import annotations

import datetime as dt
import math
import mmap
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from navgym.core.checks import Array
from navgym.core.units import DEGREE
from navgym.formats.channels import SECOND, Gatherer

HEADER = b"\x7f\x7f"
FIXED, VARIABLE, BOTTOM = 0x0000, 0x0080, 0x0600  # ids of the blocks
LOST = -32768
MILLIMETRE = 1e-3
# bits of the fixed leader's coordinate transformation
AXES = {0: "beam", 1: "instrument", 2: "ship", 3: "earth"}
NAN = math.nan
BEAM_ANGLES = {0: 15.0, 1: 20.0, 2: 30.0}  # degrees, by bits of the configuration
STEEPEST, FLATTEST = 5, 45  # degrees from the vertical that a beam may point
CONVEX, UPWARDS = 1 << 3, 1 << 7  # of the configuration's first byte
OWN_PITCH = 1 << 3  # of the sensors' sources: by the tilt sensor within, which is no gimbal
# of beams that see one velocity the weighted sum is none
JANUS = np.array([1.0, 1.0, -1.0, -1.0])
THREE_BEAMS = 1 << 1  # of EX: three beams do
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
    stamp = _stamp(variable)
    # velocities of the bottom, seen from the vehicle: its own are the opposite
    told = struct.unpack_from("<4h", bottom, 24)
    four = np.array([NAN if value == LOST else -value * MILLIMETRE for value in told])
    if axes == "beam":
        four = _instrument(leader, four)
    if axes in ("beam", "instrument"):
        four = levelled(four[:3], *_tilts(leader, variable))
    a, b, up = four[:3].tolist()
    # starboard, forward, mast; or east, north, up
    kind = "velocity" if axes == "earth" else "body_velocity"
    g.rows_of("bottom_track", kind).add(stamp, b, a, -up)
    (heading,) = struct.unpack_from("<H", variable, 18)
    if heading >= 36_000:
        raise ValueError(f"a heading of {heading / 100} degrees")
    # ship axes that were levelled need the heading only, and others are nearly level
    g.rows_of("variable_leader", "attitude").add(stamp, NAN, NAN, heading / 100 * DEGREE)


def _instrument(leader: bytes, beams: Array) -> Array:
    """Velocities x, y, z of the instrument and their misfit, m/s, (4,), from those along four beams."""
    if leader[8] < 4:
        raise ValueError(f"velocities are along {leader[8]} beams, of which no velocity can be made: log in ship or earth axes (EX11111)")  # fmt: skip
    angle = float(leader[58]) if len(leader) > 58 else 0.0  # of older firmware another block's
    if not STEEPEST <= angle <= FLATTEST:
        angle = BEAM_ANGLES.get(leader[5] & 3, 0.0)
    if not angle:
        raise ValueError("velocities are along the beams, and the angle of these is not in the file: log in ship or earth axes (EX11111)")  # fmt: skip
    lost = np.isnan(beams)
    if lost.sum() == 1 and leader[25] & THREE_BEAMS:
        beams = np.where(lost, 0.0, beams)
        beams = beams + lost * (JANUS @ beams) / -(JANUS @ lost)  # so that there is no misfit
    return matrix(angle, bool(leader[4] & CONVEX)) @ beams


def matrix(angle: float, convex: bool) -> Array:
    """(4, 4) from velocities along beams, towards the instrument, to x, y, z and their misfit.

    x is away from beam 1 and towards beam 2, y away from beam 4 and towards beam 3 where beams
    diverge (convex), z towards the instrument.

    Args:
        angle: of the beams from the vertical, degrees.
        convex: whether they diverge.
    """
    flat, steep = 0.5 / math.sin(angle * DEGREE), 0.25 / math.cos(angle * DEGREE)
    c = flat if convex else -flat
    return np.array([[c, -c, 0.0, 0.0], [0.0, 0.0, -c, c], [steep] * 4, flat / math.sqrt(2.0) * JANUS])  # fmt: skip


def _tilts(leader: bytes, variable: bytes) -> tuple[float, float, float]:
    """Pitch, roll and alignment of beam 3 clockwise from the bow, rad."""
    pitch, roll = (value / 100 * DEGREE for value in struct.unpack_from("<2h", variable, 20))
    if leader[30] & OWN_PITCH:
        pitch = math.atan(math.tan(pitch) * math.cos(roll))
    if leader[4] & UPWARDS:
        roll += math.pi
    (alignment,) = struct.unpack_from("<h", leader, 26)
    return pitch, roll, alignment / 100 * DEGREE


def levelled(velocity: ArrayLike, pitch: float, roll: float, alignment: float) -> Array:
    """(3,) starboard, forward, up, level, from x, y, z of an instrument.

    Args:
        velocity: (3,).
        pitch: rad, y up.
        roll: rad, x down; π more where the instrument looks up.
        alignment: of y clockwise from the bow, seen from above, rad.
    """
    (cp, sp), (cr, sr), (ca, sa) = ((math.cos(a), math.sin(a)) for a in (pitch, roll, alignment))
    rolled = np.array([[cr, 0.0, sr], [0.0, 1.0, 0.0], [-sr, 0.0, cr]])
    pitched = np.array([[1.0, 0.0, 0.0], [0.0, cp, -sp], [0.0, sp, cp]])
    aligned = np.array([[ca, sa, 0.0], [-sa, ca, 0.0], [0.0, 0.0, 1.0]])
    found: Array = aligned @ pitched @ rolled @ np.asarray(velocity)
    return found


def _stamp(variable: bytes) -> int:
    """ns since 1970, of the clock with a century where there is one."""
    year, month, day, hour, minute, second, hundredth = variable[4:11]
    year += 2000 if year < 80 else 1900
    if len(variable) >= 65 and variable[57] in (19, 20):
        year = variable[57] * 100 + variable[58]
        month, day, hour, minute, second, hundredth = variable[59:65]
    moment = dt.datetime(year, month, day, hour, minute, second, tzinfo=dt.UTC)
    return int(moment.timestamp()) * SECOND + hundredth * SECOND // 100
