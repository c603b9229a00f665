"""Look a log over: `inspect(path)` reads it, asks every test, and names the command to run next."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from navgym.core.typed import options_of
from navgym.formats.kinds import kept_channels, read_channels
from navgym.inspection import series
from navgym.inspection.findings import (
    SEVERITIES,
    Channel,
    Evidence,
    Finding,
    Inspection,
    Losses,
)
from navgym.inspection.mending import in_all, mended, pairs, told
from navgym.inspection.reading import CLOCK, Read, as_finding, read
from navgym.inspection.timing import losses
from navgym.problem import Problem
from navgym.readers import ReaderOptions, reader_of

Line = tuple[str, str]

AIDED = "log", "ins_log"  # formats of devices' logs: positions and velocities, or an IMU as well
IMU_SET, IMU_FILE = "ins_csv", "imu.csv"  # a folder, and what must be in it
NO_IMU = "format 'log'"  # what an error says where there is none
IMU = "'ins_log'"  # what an error says where there is an IMU and nothing else
MENDABLE = 8  # findings whose options are put into the next command


def inspect(log: str | Path, *words: str, format_name: str | None = None) -> Inspection:
    """What is in a log, and what is wrong with it.

    Args:
        log: the file, or the folder.
        words: for the reader, as after --read on the command line: pairs of an option and a value.
        format_name: of the file; by default what it looks like.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: options that the reader does not have. A file that it refuses is a finding.
    """
    return of(Path(log), ReaderOptions(tuple(words), format_name))


def of(log: Path, reading: ReaderOptions) -> Inspection:
    """The same with a reader's options as they are."""
    with kept_channels():  # read once, and looked at as the file has them and as a recording does
        return _looked_over(log, reading)


def _looked_over(log: Path, reading: ReaderOptions) -> Inspection:
    from navgym.read_command import following
    from navgym.read_command import told as lines_of

    done = read(log, reading)
    name = reading.format_of(log)
    held = _held(log, reading, name)
    command = shlex.join(["navgym", "inspect", str(log), *_told(reading)])
    if done.recording is None:
        return Inspection(
            str(log), name, "", tuple(held), tuple(done.findings), (), (), (), (),
            _refused(log, reading, name, held, done.findings), command,
        )  # fmt: skip
    problem = done.reading.problem(log)
    evidence = _evidence(problem, log, done)
    lines = lines_of(done.recording, problem)
    doubts = [as_finding(text) for name, text in lines if name == "doubt"]
    lines = [*lines[:1], *held, *((name, text) for name, text in lines[1:] if name != "doubt")]
    said = [*done.findings, *(f for f in doubts if f is not None)]
    found = [*said, *evidence.findings, *_of_channels(evidence.channels)]
    options, repaired = done.reading.options(name), found[: int(done.repaired)]
    more = [in_all(f, options) for f in found[len(repaired) :]]  # a repair is among the options
    findings = _sorted([*repaired, *more])
    next_command = _next(log, reading, done, findings, evidence, following, problem)
    return Inspection(
        str(log), name, problem.title, tuple(lines), findings, tuple(evidence.channels),
        _losses(evidence.channels), tuple(evidence.noise), evidence.words, next_command, command,
        evidence.track, done.recording,
    )  # fmt: skip


def _evidence(problem: Problem, log: Path, done: Read) -> Evidence:
    if problem.evidence is None:
        return Evidence(())
    return problem.evidence(done.recording, log, done.reading.options(done.reading.format_of(log)))


def _of_channels(channels: Sequence[Channel]) -> list[Finding]:
    """What each channel alone shows; what all channels of a sensor share is said once."""
    found = [f for channel in channels for f in series.of(channel)]
    sensor = {c.name: c.sensor for c in channels}
    shared: dict[tuple[str, str], list[Finding]] = {}
    for f in found:
        shared.setdefault((f.kind, sensor[f.channel]), []).append(f)
    return [_joined(fs) for fs in shared.values()]


def _joined(findings: Sequence[Finding]) -> Finding:
    """Findings of one kind in several channels of a sensor as one: the first, with all names."""
    first, names = findings[0], list(dict.fromkeys(f.channel for f in findings))
    if len(findings) == 1:
        return first
    more = f" ({first.channel}; {len(findings) - 1} more like it)"
    return Finding(first.kind, ", ".join(names), first.said + more, first.remedy, first.options)


def _sorted(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """The worst first, and each thing once: what the reader said of a kind and channel goes first."""
    kept: dict[tuple[str, str], Finding] = {}
    turned = any(f.kind == "axes" for f in findings)
    for f in findings:
        if not (turned and f.kind == "delay"):  # of axes that are wrong no clock can be told
            kept.setdefault((f.kind, f.channel), f)
    return tuple(sorted(kept.values(), key=lambda f: SEVERITIES.index(f.severity)))


def _losses(channels: Sequence[Channel]) -> tuple[Losses, ...]:
    by_sensor: dict[str, list[Channel]] = {}
    for c in channels:
        by_sensor.setdefault(c.sensor, []).append(c)
    found = []
    for sensor, group in by_sensor.items():
        lost = ~np.all([c.received for c in group], axis=0)
        found.append(losses(sensor, lost))
    return tuple(found)


# ---- the command to run next


def _refused(
    log: Path, reading: ReaderOptions, name: str, held: Sequence[Line], findings: Sequence[Finding]
) -> str:
    """Where a file cannot be read: in a text file, say what columns hold; of an IMU alone, another format.

    "" where no command would help: whoever cuts the file, or converts it, goes on from there.
    """
    words = ["navgym", "read", str(log), *_told(reading)]
    if any(f.kind == CLOCK for f in findings):
        return ""
    if name == IMU_SET and log.is_file():
        return shlex.join(["navgym", "inspect", str(log.parent)]) if log.name == IMU_FILE else ""
    if log.is_file() and "delimiter" in options_of(reader_of(name)):
        words += ["--write-mapping", "mapping.toml"]
    elif name == AIDED[0] and held and any(IMU in f.said for f in findings):
        words = ["navgym", "inspect", str(log), "--format", AIDED[1]]
    elif held and any(NO_IMU in f.said for f in findings):
        words = ["navgym", "inspect", str(log)]
    else:
        return ""
    return shlex.join(words)


def _held(log: Path, reading: ReaderOptions, name: str) -> list[Line]:
    """What a device's log holds, a line for each channel, whatever of it counts."""
    if not name.endswith(AIDED[0]):
        return []
    try:
        channels = read_channels(log, reading.options(name).get("kind"))
    except ValueError:
        return []
    lines = [("holds", text) for text in channels.summary]
    if name == AIDED[0] and channels.of("imu") and channels.of("fix", "body_velocity"):
        more = ["navgym", "inspect", str(log), "--format", AIDED[1]]
        lines.append(("also", f"an IMU, with what aids it: {shlex.join(more)}"))
    return lines


def _told(reading: ReaderOptions) -> list[str]:
    words = ["--format", reading.format] if reading.format else []
    return words + (["--read", *reading.words] if reading.words else [])


def _next(log, reading, done, findings, evidence, following, problem) -> str:  # type: ignore[no-untyped-def]
    """Mend what options can mend and look again; else tune, with the noise that the log suggests."""
    if done.repaired and not done.findings[0].options:
        return ""
    name = done.reading.format_of(log)
    options = done.reading.options(name)
    mending = [f for f in findings if f.options][:MENDABLE]
    words = mended(done.reading.words, mending, options, options_of(reader_of(name)))
    if words != list(reading.words):  # the same command again would find the same
        told_all = ReaderOptions(tuple(words), done.reading.format)
        return shlex.join(["navgym", "inspect", str(log), *_told(told_all)])
    own = [w for n, value in pairs(evidence.words) if told(options, n) is None for w in (n, value)]
    told_all = ReaderOptions((*words, *own), done.reading.format)
    command: str = following(told_all, log, done.recording, problem)
    return command
