"""NMEA 0183: sentences of receivers and compasses, over pynmeagps.

Fields, checksums and number formats are the library's; of a sentence only the wanted fields are
turned into numbers, as a message object of the library takes ten times as long. A sentence whose
checksum is wrong, or that stands without one, is left out and counted. What sentences without a
time (VTG, HDT, THS) belong to stands in `navgym.formats.epochs`.
"""

from __future__ import annotations

import datetime as dt
import math
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
from pynmeagps import NMEA_PAYLOADS_GET, calc_checksum, date2utc, dmm2ddd, get_parts, time2utc
from pynmeagps.exceptions import NMEAMessageError

from navgym.core.text import opened
from navgym.core.units import SIZES
from navgym.formats.channels import SECOND, Gatherer
from navgym.formats.epochs import Epochs

BEGUN = re.compile(rb"[$][A-Z]{2}(GGA|GNS|RMC|GLL|VTG|GST|HDT|THS|ZDA),")
SENTENCE = re.compile(BEGUN.pattern + rb"[^*$]*\*[0-9A-Fa-f]{2}(?=\s|\Z)")
OTHER = re.compile(rb"[^$*!]*[$!][0-9A-Z]{3,},[^*$]*\*[0-9A-Fa-f]{2}\s*")  # of no use here
UNREADABLE = re.compile(rb"[$*]|[^\s -~]")  # beside a sentence there may be a logger's own words
LONGEST = 1000  # bytes of a line
HALF_A_DAY, DAY = 43_200 * SECOND, 86_400 * SECOND  # ns
KNOT = SIZES["speed"]["kn"]  # m/s
UNTIMED = ("VTG", "HDT", "THS")
# who tells what: the first that is there counts
TELLERS = {
    "fix": ("GGA", "GNS", "RMC", "GLL"), "velocity": ("RMC", "VTG"), "attitude": ("HDT", "THS"),
}  # fmt: skip
ALL_BAD = 0.5  # share of sentences with a wrong checksum from which the file is no log
PLACES = {  # by kind and name, where a field stands
    kind: {name: k for k, name in enumerate(NMEA_PAYLOADS_GET[kind])}
    for kind in ("GGA", "GNS", "RMC", "GLL", "VTG", "GST", "HDT", "THS", "ZDA")
}


class _Sentence:
    """One sentence; ValueError for a wrong checksum, IndexError for a field that is not there."""

    def __init__(self, raw: bytes) -> None:
        content, _, self.kind, self.fields, told = get_parts(raw)
        if told.upper() != calc_checksum(content):
            raise ValueError("a wrong checksum")
        self.places = PLACES[self.kind]

    def text(self, name: str) -> str:
        """A field as it stands."""
        found: str = self.fields[self.places[name]]
        return found

    def number(self, name: str) -> float:
        """A field as a number, NaN where it is empty."""
        text = self.text(name)
        return float(text) if text else math.nan

    def degrees(self, name: str, side: str, negative: str) -> float:
        """A latitude or longitude, NaN where it is none."""
        found = dmm2ddd(self.text(name))
        if found == "":
            return math.nan
        return -abs(float(found)) if self.text(side) == negative else abs(float(found))

    def of_day(self) -> int:
        """ns since midnight, -1 where no time is told."""
        return _of_day(self.text("time"))


@lru_cache(maxsize=4)  # sentences of one moment follow each other
def _of_day(text: str) -> int:
    time = time2utc(text)
    if not isinstance(time, dt.time):
        return -1
    seconds = time.hour * 3600 + time.minute * 60 + time.second
    return seconds * SECOND + time.microsecond * 1000


def read(path: Path, gatherer: Gatherer) -> None:
    """Positions, velocities over ground, their accuracy, and headings of a file."""
    log = _Log(gatherer)
    for raw in _sentences(path, log):
        try:
            log.take(_Sentence(raw))
        except (NMEAMessageError, ValueError, IndexError):
            log.bad += 1
            log.epochs.unreadable()
    log.settle()


def _sentences(path: Path, log: _Log) -> Iterator[bytes]:
    """The sentences of a file that have a checksum; how many are damaged is counted."""
    size, done = max(path.stat().st_size, 1), 0
    with opened(path) as file:
        while line := file.readline(LONGEST):
            done += len(line)
            if not log.count % 1000:
                log.gatherer.progress.at(min(done / size, 1.0))
            found = SENTENCE.search(line)
            log.count += found is not None
            if found is None:
                log.cut += BEGUN.search(line) is not None
            rest = line if found is None else line[: found.start()] + line[found.end() :]
            if UNREADABLE.search(rest) and not OTHER.fullmatch(rest):
                log.epochs.unreadable()
            if found is not None:
                yield found[0]


class _Log:
    """What the sentences said so far."""

    def __init__(self, gatherer: Gatherer) -> None:
        self.gatherer = gatherer
        self.count = self.bad = self.cut = 0
        self.clock = -1  # ns since the day of the first sentence
        self.nights = 0
        self.epochs = Epochs()
        self.accuracy: dict[int, tuple[float, float, float]] = {}
        self.dates: list[tuple[int, int]] = []  # clock, day
        self.tellers: dict[str, set[str]] = {quantity: set() for quantity in TELLERS}

    def take(self, s: _Sentence) -> None:
        """Keep what a sentence says."""
        if s.kind in UNTIMED:
            self._untimed(s)
            return
        of_day = s.of_day()
        if of_day < 0:  # a receiver that does not know the time yet, or has lost it
            self.epochs.timed(s.kind, None)
            return
        self._tick(of_day)
        self.epochs.timed(s.kind, self.clock)
        if s.kind == "RMC":
            self._dated(date2utc(s.text("date")))
        elif s.kind == "ZDA":
            self._dated(dt.date(int(s.text("year")), int(s.text("month")), int(s.text("day"))))
        elif s.kind == "GST":
            self.accuracy[self.clock] = s.number("stdLat"), s.number("stdLong"), s.number("stdAlt")
        if s.kind in TELLERS["fix"]:
            self._fix(s)

    def _tick(self, of_day: int) -> None:
        """The clock of a sentence; a fall of over half a day is a midnight."""
        clock = of_day + self.nights * DAY
        if clock < self.clock - HALF_A_DAY:
            self.nights += 1
            clock += DAY
        elif clock > self.clock + HALF_A_DAY and self.clock >= 0 and self.nights:
            clock -= DAY  # of yesterday, after the first of today
        self.clock = clock

    def _dated(self, date: dt.date | str) -> None:
        if isinstance(date, dt.date):
            self.dates.append((self.clock, (date - dt.date(1970, 1, 1)).days * DAY))

    def _counts(self, kind: str, quantity: str) -> bool:
        """Whether no better teller of a quantity was heard before."""
        names, heard = TELLERS[quantity], self.tellers[quantity]
        heard.add(kind)
        return not heard.intersection(names[: names.index(kind)])

    def _fix(self, s: _Sentence) -> None:
        if s.kind == "GGA":
            good = int(s.text("quality")) > 0
        elif s.kind == "GNS":
            good = any(letter != "N" for letter in s.text("posMode"))
        else:
            good = s.text("status") == "A"
        if self._counts(s.kind, "fix"):
            lat, lon, height = (math.nan,) * 3
            if good:
                lat, lon = s.degrees("lat", "NS", "S"), s.degrees("lon", "EW", "W")
            if good and s.kind in ("GGA", "GNS"):
                sep = s.number("sep")
                height = s.number("alt") + (0.0 if math.isnan(sep) else sep)
            self.gatherer.rows_of(s.kind, "fix").add(self.clock, lat, lon, height)
        if s.kind == "RMC" and self._counts("RMC", "velocity"):
            north, east = _velocity(s, "spd", "cog") if good else (math.nan,) * 2
            self.gatherer.rows_of("RMC", "velocity").add(self.clock, north, east)

    def _untimed(self, s: _Sentence) -> None:
        quantity = "velocity" if s.kind == "VTG" else "attitude"
        if not self._counts(s.kind, quantity):
            return
        values: tuple[float, ...]
        if s.kind == "VTG":
            values = _velocity(s, "sogn", "cogt")
        else:
            good = s.kind == "HDT" or s.text("mi") == "A"
            told = s.number("headingT" if s.kind == "HDT" else "headt")
            values = math.nan, math.nan, math.radians(told) if good else math.nan
        if self.epochs.untimed(s.kind):
            self.gatherer.rows_of(s.kind, quantity).add(self.clock, *values)

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
        self._keep_tellers()
        self._keep_sure()
        self._put_dates()
        self._put_accuracies()

    def _keep_tellers(self) -> None:
        g = self.gatherer
        for quantity, names in TELLERS.items():
            there = [name for name in names if name in self.tellers[quantity]]
            for name in there[1:]:
                g.rows.pop((name, quantity), None)
                g.said.append(f"{name} left out: {there[0]} tells the {quantity} as well")

    def _keep_sure(self) -> None:
        """Leave out rows of sentences without a time that may be of another moment."""
        gone = 0
        for (name, _), rows in self.gatherer.rows.items():
            if name in UNTIMED:
                sure = self.epochs.sure(name)
                gone += self.epochs.homeless[name] + int((~sure).sum())
                rows.keep(sure)
        if gone:
            self.gatherer.said.append(f"{gone} sentences are left out, of which no time is known")

    def _put_dates(self) -> None:
        starts = {day - clock // DAY * DAY for clock, day in self.dates}
        if len(starts) > 1:
            low, high = (str(dt.datetime.fromtimestamp(s / SECOND, dt.UTC).date()) for s in (min(starts), max(starts)))  # fmt: skip
            raise ValueError(
                f"dates and clocks do not agree (the first day is {low} or {high}): a clock was set, "
                "or another voyage begins within the file"
            )
        if not starts:
            self.gatherer.said.append(
                "no sentence tells a date: times are seconds of the day, from the first midnight"
            )
            return
        start = min(starts)
        for rows in self.gatherer.rows.values():
            np.frombuffer(rows.time, np.int64)[:] += start
        self.accuracy = {clock + start: sigma for clock, sigma in self.accuracy.items()}

    def _put_accuracies(self) -> None:
        for (_, kind), rows in self.gatherer.rows.items():
            if kind == "fix" and self.accuracy:
                width = len(rows.values) // len(rows.time)
                for k, stamp in enumerate(rows.time):
                    for j, sigma in enumerate(self.accuracy.get(stamp, ())):
                        rows.values[k * width + 3 + j] = sigma


def _velocity(s: _Sentence, speed: str, course: str) -> tuple[float, float]:
    """North and east, m/s, of a speed in knots and a course."""
    v, c = s.number(speed) * KNOT, math.radians(s.number(course))
    return v * math.cos(c), v * math.sin(c)
