"""NMEA 0183: sentences of receivers and compasses, over pynmeagps.

A sentence whose checksum is wrong, or that stands without one, is left out and counted. Sentences
that tell no time (VTG, HDT, THS) have that of the last one that does, the first of each after it.
"""

from __future__ import annotations

import datetime as dt
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pynmeagps import NMEAReader
from pynmeagps.exceptions import NMEAMessageError, NMEAParseError, NMEATypeError

from navgym.core.text import opened
from navgym.core.units import SIZES
from navgym.formats.channels import SECOND, Gatherer

BEGUN = re.compile(rb"[$][A-Z]{2}(GGA|GNS|RMC|GLL|VTG|GST|HDT|THS|ZDA),")
SENTENCE = re.compile(BEGUN.pattern + rb"[^*$]*\*[0-9A-F]{2}(?=\s|\Z)")
LONGEST = 1000  # bytes of a line
HALF_A_DAY, DAY = 43_200 * SECOND, 86_400 * SECOND  # ns
KNOT = SIZES["speed"]["kn"]  # m/s
FIXES = ("GGA", "GNS", "RMC", "GLL")  # all hold one position: the first that is there counts
ALL_BAD = 0.5  # share of sentences with a wrong checksum from which the file is no log


def read(path: Path, gatherer: Gatherer) -> None:
    """Positions, velocities over ground, their accuracy, and headings of a file."""
    log = _Log(gatherer)
    for sentence in _sentences(path, log):
        try:
            log.take(NMEAReader.parse(sentence + b"\r\n"))
        except (NMEAParseError, NMEAMessageError, NMEATypeError, ValueError, TypeError, AttributeError):  # fmt: skip
            log.bad += 1
            log.told = False
    log.settle()


def _sentences(path: Path, log: _Log) -> Iterator[bytes]:
    """The sentences of a file that have a checksum; how many are damaged is counted."""
    size, done = max(path.stat().st_size, 1), 0
    with opened(path) as file:
        while line := file.readline(LONGEST):
            done += len(line)
            gatherer_share = min(done / size, 1.0)
            if not log.count % 1000:
                log.gatherer.progress.at(gatherer_share)
            found = SENTENCE.search(line)
            log.count += found is not None
            if found is not None:
                yield found[0]
            elif b"$" in line or line.strip():
                log.cut += BEGUN.search(line) is not None
                log.told = False


class _Log:
    """What the sentences said so far."""

    def __init__(self, gatherer: Gatherer) -> None:
        self.gatherer = gatherer
        self.count = self.bad = self.cut = 0
        self.clock = -1  # ns since the day of the first sentence
        self.told = False  # whether the clock is that of the sentences that follow
        self.seen: set[str] = set()  # kinds of sentences without a time since the clock ticked
        self.nights = 0
        self.accuracy: dict[int, tuple[float, float, float]] = {}
        self.dates: list[tuple[int, int]] = []  # clock, day
        self.gone = 0  # sentences whose time is not known

    def take(self, message: Any) -> None:
        """Keep what a sentence says."""
        kind = message.msgID
        if kind in ("VTG", "HDT", "THS"):
            self._untimed(kind, message)
            return
        if not isinstance(message.time, dt.time):
            return  # a receiver that does not know the time yet
        self._tick(message.time)
        if kind == "RMC" and isinstance(message.date, dt.date):
            self._dated(message.date)
        elif kind == "ZDA":
            self._dated(dt.date(int(message.year), int(message.month), int(message.day)))
        elif kind == "GST":
            self.accuracy[self.clock] = (
                _number(message.stdLat), _number(message.stdLong), _number(message.stdAlt)
            )  # fmt: skip
        if kind in FIXES:
            self._fix(kind, message)

    def _tick(self, time: dt.time) -> None:
        """The clock of a sentence; a fall of over half a day is a midnight."""
        seconds = time.hour * 3600 + time.minute * 60 + time.second
        of_day = seconds * SECOND + time.microsecond * 1000
        clock = of_day + self.nights * DAY
        if clock < self.clock - HALF_A_DAY:
            self.nights += 1
            clock += DAY
        elif clock > self.clock + HALF_A_DAY and self.clock >= 0 and self.nights:
            clock -= DAY  # of yesterday, after the first of today
        if clock != self.clock or not self.told:
            self.seen.clear()
        self.clock, self.told = clock, True

    def _dated(self, date: dt.date) -> None:
        self.dates.append((self.clock, (date - dt.date(1970, 1, 1)).days * DAY))

    def _fix(self, kind: str, message: Any) -> None:
        if kind == "GGA":
            good = int(message.quality) > 0
        elif kind == "GNS":
            good = any(letter != "N" for letter in str(message.posMode))
        else:
            good = message.status == "A"
        lat, lon = (_number(message.lat), _number(message.lon)) if good else (math.nan, math.nan)
        height = math.nan
        if good and kind in ("GGA", "GNS"):
            height = _number(message.alt) + (0.0 if math.isnan(s := _number(message.sep)) else s)
        self.gatherer.rows_of(kind, "fix").add(self.clock, lat, lon, height)
        if kind == "RMC":
            self._velocity("RMC", message.spd, message.cog, good)

    def _untimed(self, kind: str, message: Any) -> None:
        if not self.told or kind in self.seen:  # of several after one time only the first has it
            self.gone += 1
            return
        self.seen.add(kind)
        if kind == "VTG":
            self._velocity("VTG", message.sogn, message.cogt, True)
        else:
            told = message.headingT if kind == "HDT" else message.headt
            good = kind == "HDT" or message.mi == "A"
            heading = math.radians(_number(told)) if good else math.nan
            self.gatherer.rows_of(kind, "attitude").add(self.clock, math.nan, math.nan, heading)

    def _velocity(self, kind: str, speed: Any, course: Any, good: bool) -> None:
        v, c = (_number(speed) * KNOT, math.radians(_number(course))) if good else (math.nan,) * 2
        self.gatherer.rows_of(kind, "velocity").add(self.clock, v * math.cos(c), v * math.sin(c))

    def settle(self) -> None:
        """Put dates to clocks and accuracies to fixes, and keep one sentence of several alike."""
        if self.bad + self.cut > ALL_BAD * (self.count + self.cut):
            raise ValueError(
                f"{self.bad + self.cut} of {self.count + self.cut} sentences are damaged or have no "
                "right checksum"
            )
        g = self.gatherer
        if self.bad + self.cut:
            g.doubts.append(f"{self.bad + self.cut} of {self.count + self.cut} sentences are damaged: left out")  # fmt: skip
        if self.gone:
            g.said.append(f"{self.gone} sentences are left out, of which no time is known")
        for kind, names in (("fix", FIXES), ("velocity", ("RMC", "VTG")), ("attitude", ("HDT", "THS"))):  # fmt: skip
            there = [name for name in names if (name, kind) in g.rows]
            for name in there[1:]:
                del g.rows[name, kind]
                g.said.append(f"{name} left out: {there[0]} tells the {kind} as well")
        self._put_dates()
        self._put_accuracies()

    def _put_dates(self) -> None:
        starts = {day - clock // DAY * DAY for clock, day in self.dates}
        if len(starts) > 1:
            low, high = (str(dt.datetime.fromtimestamp(s / SECOND, dt.UTC).date()) for s in (min(starts), max(starts)))  # fmt: skip
            raise ValueError(
                f"dates and clocks do not agree (the first day is {low} or {high}): a clock was set, "
                "or another voyage begins within the file"
            )
        for rows in self.gatherer.rows.values() if starts else ():
            for k in range(len(rows.time)):
                rows.time[k] += min(starts)
        if starts:
            self.accuracy = {clock + min(starts): sigma for clock, sigma in self.accuracy.items()}

    def _put_accuracies(self) -> None:
        for (_, kind), rows in self.gatherer.rows.items():
            if kind == "fix" and self.accuracy:
                width = len(rows.values) // len(rows.time)
                for k, stamp in enumerate(rows.time):
                    for j, sigma in enumerate(self.accuracy.get(stamp, ())):
                        rows.values[k * width + 3 + j] = sigma


def _number(value: Any) -> float:
    """A field as a number, NaN where it is empty."""
    return math.nan if value in ("", None) else float(value)
