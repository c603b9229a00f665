"""What a reader says of a log as findings: its errors, its warnings, and what it tidied."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from navgym.inspection.findings import Finding
from navgym.inspection.mending import named
from navgym.readers import ReaderOptions

# what readers say, and the kind of finding that it is; the first that fits counts
_SAID = (
    (r"taken for held|repeat the values before them: kept", "held"),
    (r"taken for lost ones", "sentinel"),
    (r"times are taken for|the usual step is [\d.e+]+ s: if the times|time_scale= or units", "time unit"),
    (r"rows sorted by time", "order"),
    (r"rows that repeat each other|of times that stand there before", "duplicate"),
    (r"rows with different values, first", "conflict"),
    (r"small enough to be radians|columns of latitude and longitude: read as degrees", "degrees"),
    (r"more than 100 km from the origin", "far"),
    (r"infinite values are lost", "infinite"),
    (r"was cut off|ends in NUL bytes", "cut"),
    (r"no heading in their rows", "unseen"),
    (r"^axes: |fit far better if", "axes"),
    (r"fit better if they were made", "delay"),
    (r"are left out: where that should not be, bring both to one clock", "outside"),
    (r"stands still for most", "standing"),
    (r"damaged: left out|file is damaged|in no sound ensemble|in no message that is known", "damage"),
    (r"logger lost data", "gap"),
    (r"^\S+ holds no (fix|position|velocity|body velocity)", "empty"),
    (r"stop of its range|saturat|at their (largest|least)|times? at exactly|stands? at", "saturation"),
)  # fmt: skip
_REFUSED = (
    (r"is not known: pass", "untold"),
    (r"the time goes back|as where a clock is set|a clock was set", "clock set"),
    (r"name a column with finer times|check the unit of the times", "stamps"),
    (r"look like degrees|must be within ±|no row has both latitude", "degrees"),
    (r"turn the axes", "axes"),
    (r"check the units|usual specific force|gravity standing|holds degrees or rates|\bunits? .* is not one of", "units"),
    (r"every measurement is lost|nothing but NaN", "empty"),
    (r"could each be|all hold a position|no measurement column|unknown column|no such column", "columns"),
    (r"must be a number|must be a date|must be a clock|got '", "text"),
    (r"even steps|increase strictly|rows? .*after|gap", "uneven"),
)  # fmt: skip
CLOCK = "clock set"
_SILENT = re.compile(
    r"nothing shows it|no magnetometer"
)  # said of sound logs too: a fact, no fault
# an IMU whose z points up, forward left alone
Z_UP = tuple(w for a in ("gyro", "acc") for x in "yz" for w in (f"turn.{a}_{x}", f"-{a}_{x}"))
# by kind of an error, options that let a log be read in spite of it; the first that works is taken
_REPAIRS: dict[str, tuple[tuple[str, ...], ...]] = {
    "clock set": (("sort", "true"), ("regular", "true")),
    "uneven": (("regular", "true"),),
    "units": (("check_units", "false"),),
    "axes": (Z_UP, ("check_units", "false")),
}
HIDING = "check_units"  # shows what is there, and mends nothing


@dataclass(frozen=True, eq=False)
class Read:
    """What became of reading a log.

    Args:
        recording: or None, where it could not be read in any way.
        findings: what the reader found.
        reading: how it was read in the end.
        repaired: whether that is otherwise than it was told.
    """

    recording: Any
    findings: Sequence[Finding]
    reading: ReaderOptions
    repaired: bool = False


def read(log: Path, reading: ReaderOptions) -> Read:
    """Read a log, if need be with options that its reader asks for.

    What options only hide, such as units that cannot be, is a finding without any.

    Raises FileNotFoundError where there is no such file, and ValueError for options that cannot be.
    """
    reading.options(reading.format_of(log))
    try:
        return Read(*_tried(log, reading), reading)
    except FileNotFoundError:
        if not log.exists():
            raise
        return Read(None, [_alone(log)], reading)
    except ValueError as error:
        refused = _refused(str(error))
    for words in (*_choice(refused.said), *_REPAIRS.get(refused.kind, ())):
        found = None if words[0] in reading.words else _repaired(log, reading, refused, words)
        if found is not None:
            return found
    return Read(None, [refused], reading)


def _choice(error: str) -> list[tuple[str, str]]:
    """What an error proposes where two channels could be meant, as words for the reader."""
    return [(f"topics.{role}", name) for role, name in re.findall(r"topics=\{'(\w+)': '([^']+)'\}", error)]  # fmt: skip


def _repaired(log: Path, reading: ReaderOptions, refused: Finding, words: tuple[str, ...]) -> Read | None:  # fmt: skip
    """What became of a log that was refused, read with more words; None if that is refused too."""
    try:
        found = read(log, ReaderOptions((*reading.words, *words), reading.format))
    except ValueError:  # an option that this reader does not have
        return None
    if found.recording is None:
        return None
    options = () if words[0] == HIDING else words
    repaired = Finding(refused.kind, refused.channel, refused.said, refused.remedy, options)
    mixed = any(f.kind == "conflict" for f in found.findings)
    if refused.kind == CLOCK and (mixed or "sort=True" not in refused.said):
        repaired = replace(
            repaired, said=refused.said.partition(": cut the file")[0], options=(),
            remedy="cut the file there, or mend the later times: sorting mixes moments of before and after",
        )  # fmt: skip
    own = [f for f in found.findings if f.kind not in (refused.kind, "order") or f.options]
    return Read(found.recording, [repaired, *own], found.reading, True)


def _tried(log: Path, reading: ReaderOptions) -> tuple[Any, list[Finding]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = reading.read(log)
    kept = [str(s) for s in recording.meta.get("reading", ())]
    warned = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    doubts = [text.partition(": ")[2] or text for text in warned]
    # a doubt stands among the sentences too, where the reader keeps them
    found = [as_finding(text, doubted=True) for text in doubts]
    found += [as_finding(text) for text in kept if text not in doubts]
    return recording, [f for f in found if f is not None]


def as_finding(text: str, doubted: bool = False) -> Finding | None:
    """A reader's sentence as a finding; None for one that says what was done, not what is wrong.

    Args:
        text: the sentence.
        doubted: whether it was a warning: then it is a finding in any case.
    """
    for pattern, kind in _SAID:
        if re.search(pattern, text):
            said = text.removeprefix(f"{kind}: ")
            return Finding(kind, _channel(said), said, options=named(said))
    if not doubted or _SILENT.search(text):
        return None
    return Finding("reader", _channel(text), text)


def _alone(log: Path) -> Finding:
    """One file of what must be a set of them."""
    remedy = "put it into a folder as imu.csv, beside it what aids it (dvl.csv, fix.csv, ...), and name the folder"
    if (log.parent / "imu.csv").exists():
        remedy = (
            f"name its folder, {log.parent}, with what aids it beside it (dvl.csv, fix.csv, ...)"
        )
    said = (
        f"{log.name} is one file, an IMU's, and this format is a folder of a file for each sensor"
    )
    return Finding("unreadable", "", said, remedy)


def _refused(text: str) -> Finding:
    kind = next((k for pattern, k in _REFUSED if re.search(pattern, text)), "unreadable")
    found = re.search(r"column '([^']+)'", text)
    return Finding(kind, found[1] if found else "", text)


def _channel(text: str) -> str:
    """What a sentence begins with or names, if that is a channel."""
    found = re.match(
        r"(\w+) says exactly|'([^']+)':|(\w+): |\d+% of the rows with ([\w ]+?) repeat", text
    )
    return next((g for g in found.groups() if g), "") if found else ""
