"""What an inspection finds: findings, channels, and all of it together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array, one_of

ERROR, WARNING, NOTE = "error", "warning", "note"
SEVERITIES = (ERROR, WARNING, NOTE)

# by kind: severity, and what it means
KINDS: Mapping[str, tuple[str, str]] = {
    # the file
    "unreadable": (ERROR, "the reader refuses the file"),
    "text": (ERROR, "text stands where a number is needed"),
    "untold": (ERROR, "the reader must be told something that no file says"),
    "columns": (ERROR, "no column, or more than one, could be what is needed"),
    "cut": (NOTE, "the last row is cut off"),
    "damage": (WARNING, "parts of the file are damaged and left out"),
    # times
    "clock set": (ERROR, "the clock goes back, or jumps by more than a voyage"),
    "clock step": (WARNING, "time jumps and the vehicle does not: the clock was set forward"),
    "time unit": (WARNING, "the unit of the times is a guess"),
    "stamps": (ERROR, "times too coarse: many rows with different values share one"),
    "uneven": (ERROR, "steps are uneven where a filter needs even ones"),
    "gap": (WARNING, "a gap longer than the log's other gaps let expect"),
    "order": (NOTE, "rows came late"),
    "duplicate": (NOTE, "rows stand there twice"),
    "conflict": (WARNING, "rows of one time hold different values"),
    "rate": (NOTE, "the rate of the rows changes within the log"),
    "outside": (WARNING, "measurements outside the time that the IMU covers"),
    # values
    "empty": (WARNING, "a column without a value"),
    "constant": (WARNING, "a channel never changes"),
    "held": (WARNING, "a receiver's last value, repeated"),
    "frozen": (WARNING, "a channel stands still for a while, to the last digit"),
    "saturation": (WARNING, "a sensor at the stop of its range"),
    "outliers": (WARNING, "values that are impossibly far from their neighbours"),
    "jump": (WARNING, "a channel jumps and stays there"),
    "sentinel": (WARNING, "a number that stands for no value"),
    "infinite": (NOTE, "infinite values"),
    "resolution": (NOTE, "digits coarser than the noise"),
    "accuracy": (WARNING, "the receiver's own accuracies are not those of its values"),
    # units, frames, signs
    "degrees": (WARNING, "degrees where metres were named, or radians where degrees were"),
    "far": (WARNING, "positions far from the origin of their plane"),
    "units": (WARNING, "units that cannot be"),
    "scale": (WARNING, "velocities are too large or too small for the positions"),
    "sign": (WARNING, "a velocity points the other way"),
    "axes": (WARNING, "axes are exchanged or turned over"),
    "rotation": (WARNING, "velocities are turned against the positions"),
    "frame": (WARNING, "velocities in body axes where north and east are meant"),
    "heading": (WARNING, "heading that does not go with the track"),
    "gravity": (WARNING, "specific force at odds with gravity"),
    "unlike": (WARNING, "two IMUs of one hull do not turn alike"),
    # clocks of several sensors, and what cannot be seen
    "delay": (WARNING, "one sensor is late against another"),
    "unseen": (NOTE, "nothing shows a quantity that the filter needs"),
    "standing": (NOTE, "the vehicle stands still"),
    "reader": (WARNING, "a doubt of the reader that is none of the others"),
}  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a log.

    Args:
        kind: a key of `KINDS`.
        channel: where, "" for the whole file.
        said: what was found, with the numbers that it rests on.
        remedy: what to do.
        options: words for --read that do it, pairs of an option and a value.
    """

    kind: str
    channel: str
    said: str
    remedy: str = ""
    options: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        one_of("kind of finding", self.kind, KINDS)

    @property
    def severity(self) -> str:
        """One of `SEVERITIES`."""
        return KINDS[self.kind][0]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"kind": self.kind, "severity": self.severity, "channel": self.channel,
                "said": self.said, "remedy": self.remedy, "options": list(self.options)}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Channel:
    """One series of numbers as the log holds it.

    Args:
        name: such as "px" or "gyro_x".
        sensor: what it is part of; channels of one sensor are received and lost together.
        kind: "position", "velocity", "rate", "force", "angle", "depth", "field" or "other".
        unit: of the values.
        time: (T,) s, in order; equal times may stand side by side.
        values: (T,) NaN where nothing was received.
        mended: names of kinds that the reader has dealt with already.
        digit: step between the values as they stand in the file, in `unit`; 0 where the values show it.
    """

    name: str
    sensor: str
    kind: str
    unit: str
    time: Array
    values: Array
    mended: frozenset[str] = frozenset()
    digit: float = 0.0

    @property
    def received(self) -> NDArray[np.bool_]:
        """(T,) where there is a value."""
        there: NDArray[np.bool_] = np.isfinite(self.values)
        return there

    def as_dict(self) -> dict[str, Any]:
        """A summary for JSON."""
        there = self.values[self.received]
        known = len(there) > 0
        return {
            "name": self.name, "sensor": self.sensor, "unit": self.unit, "rows": len(self.values),
            "received": len(there),
            "least": float(there.min()) if known else None,
            "median": float(np.median(there)) if known else None,
            "largest": float(there.max()) if known else None,
        }  # fmt: skip


@dataclass(frozen=True)
class Losses:
    """How a sensor's measurements got lost.

    Args:
        sensor: which.
        rows: that it could have had.
        share: of them lost.
        runs: losses in a row.
        mean: length of a run, rows.
        longest: of them.
        after_loss: share lost among rows after a lost one: above `share`, losses come in bursts.
        every: rows from one received to the next where these come at a regular pace, rows from one
            lost to the next (negative) where losses do; 0 where neither does.
    """

    sensor: str
    rows: int
    share: float
    runs: int
    mean: float
    longest: int
    after_loss: float
    every: float = 0.0

    @property
    def words(self) -> str:
        """In one line."""
        if not self.runs:
            return "none lost"
        if self.runs == 1:
            return f"{self.share:.1%} lost, {self.manner} of {self.longest} rows"
        if self.every:
            return f"{self.share:.1%} lost, {self.manner}, the longest run {self.longest}"
        return (f"{self.share:.1%} lost, {self.manner}: {self.runs} runs of {self.mean:.3g} rows on average, "
                f"the longest {self.longest}")  # fmt: skip

    @property
    def manner(self) -> str:
        """How losses come, in words; "" where there are none."""
        if self.every:
            who, pace = ("received", self.every) if self.every > 0.0 else ("lost", -self.every)
            return f"regularly: one in {pace:.3g} rows is {who}"
        if self.runs < 2:
            return "in one run" * self.runs
        return "in bursts" if self.bursts else "independent"

    @property
    def bursts(self) -> bool:
        """Whether a loss makes the next more likely, by three standard deviations, and has no pace."""
        if self.every:
            return False
        lost = max(self.share * self.rows, 1.0)
        chance = math.sqrt(self.share * (1.0 - self.share) / lost)
        return self.after_loss - self.share > 3.0 * chance


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a problem makes of one of its recordings for an inspection.

    Args:
        channels: what the log holds.
        findings: what only the problem can tell.
        noise: what the log suggests of its noise, as lines of a name and a text.
        words: for --read, pairs of an option and a value, that tell the reader so.
        track: (north, east) or None, for a drawing, m.
    """

    channels: Sequence[Channel]
    findings: Sequence[Finding] = ()
    noise: Sequence[tuple[str, str]] = ()
    words: tuple[str, ...] = ()
    track: tuple[Array, Array] | None = None


@dataclass(frozen=True, eq=False)
class Inspection:
    """A log, looked over.

    Args:
        log: its path as it was given.
        format: of the file.
        problem: what reports call the problem, "" where the file could not be read.
        told: lines of a name and a text, as `navgym read` says them.
        findings: what is wrong, the worst first.
        channels: what the log holds.
        losses: by sensor.
        noise: what the log suggests, lines of a name and a text.
        model: words for --read with the model that the log suggests.
        next: the command to run now, "" where none helps before the file is mended.
        command: the one that was run, "" for none.
        track: (north, east), m, or None.
        recording: what the reader made of it, or None.
    """

    log: str
    format: str
    problem: str
    told: Sequence[tuple[str, str]]
    findings: Sequence[Finding]
    channels: Sequence[Channel]
    losses: Sequence[Losses]
    noise: Sequence[tuple[str, str]]
    model: tuple[str, ...]
    next: str
    command: str = ""
    track: tuple[Array, Array] | None = field(default=None, repr=False)
    recording: Any = field(default=None, repr=False)

    def __repr__(self) -> str:
        kinds = ", ".join(dict.fromkeys(f.kind for f in self.findings)) or "nothing found"
        return f"<Inspection of {self.log}: {self.problem or 'unreadable'}, {kinds}>"

    @property
    def readable(self) -> bool:
        """Whether the reader could make a recording of it, if need be with what the findings say."""
        return self.recording is not None

    @property
    def status(self) -> int:
        """For scripts: 0 nothing found, 1 something, 2 what keeps the log from being read as it is."""
        if any(f.severity == ERROR for f in self.findings):
            return 2
        return 1 if self.findings else 0

    def as_dict(self) -> dict[str, Any]:
        """All but the series and the recording, for JSON."""
        return {
            "log": self.log, "format": self.format, "problem": self.problem, "status": self.status,
            "told": [list(line) for line in self.told],  # of a name there may be several
            "findings": [f.as_dict() for f in self.findings],
            "channels": [c.as_dict() for c in self.channels],
            "losses": [{n: float(v) if isinstance(v, float) else v for n, v in vars(each).items()} for each in self.losses],
            "noise": dict(self.noise), "model": list(self.model), "next": self.next,
        }  # fmt: skip
