"""`navgym read`: what a log holds as navgym reads it, before anything is made of it."""

from __future__ import annotations

import argparse
import shlex
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from navgym.core.atomic import replacing
from navgym.core.tables import read_table
from navgym.core.typed import options_of
from navgym.log_command import log_parser, parse
from navgym.mapping import written
from navgym.problem import Problem
from navgym.readers import ReaderOptions, reader_of

ABOUT = """Read a log and say what was found in it: rows, steps, gaps, losses, what the reader changed.

    navgym read my_log.csv
    navgym read my_log.csv --read position_noise 1.5 columns.px "north (m)" delimiter ";"
    navgym read my_log.csv --read mapping.toml --out my_log.npz
    navgym read ship.csv --read lever_arm 10,10,2 regular true
    navgym read my_log.csv --write-mapping mapping.toml

--read, after the log, takes pairs of an option and its value, as navgym tune and the other commands
do, and before them, if you like, a mapping file that says what each column holds. An option of the
reader that is not there is answered with those that are.
"""

# by role of a device's channel, quantities whose column shows which one counts
CHOSEN = {"position": ("lat", "px"), "velocity": ("vx",)}
LONGER = 1.05  # usual steps: less is rounding of stamps
NAMED = 9  # columns of the line's name


def command_line(words: Sequence[str]) -> argparse.Namespace:
    """The command line."""
    parser = log_parser("navgym read", ABOUT)
    add = parser.add_argument
    add("--out", type=Path, help="save the recording there, as NAME.npz, with the model")
    add("--write-mapping", type=Path, metavar="FILE", help="write a mapping file to go on from")
    return parse(parser, words)


def main(words: Sequence[str]) -> int:
    """Read and tell; returns the exit status."""
    asked = command_line(words)
    reading = ReaderOptions.parsed(asked.read, asked.format)
    try:
        recording, warned = _read(reading, asked.log)
    except ValueError as error:
        textual = "delimiter" in options_of(reader_of(reading.format_of(asked.log)))
        if asked.write_mapping is None or not asked.log.is_file() or not textual:
            raise
        begun = _write_mapping(asked.write_mapping, reading, asked.log, {})
        raise ValueError(f"{error} Say what the columns hold in {begun}.") from error
    problem = reading.problem(asked.log)
    for name, line in told(recording, problem) + [("warning", text) for text in warned]:
        print(f"{name.ljust(NAMED)} {line}")
    if asked.out is not None:
        print(f"{'saved'.ljust(NAMED)} {recording.save(asked.out)}")
    if asked.write_mapping is not None:
        columns = recording.meta.get("columns", {})
        mapping = _write_mapping(asked.write_mapping, reading, asked.log, columns)
        print(f"{'mapping'.ljust(NAMED)} {mapping}")
    print(f"{'next'.ljust(NAMED)} {following(reading, asked.log, recording, problem)}")
    return 0


def _read(reading: ReaderOptions, log: Path) -> tuple[Any, list[str]]:
    """The recording, and what was warned of that it does not keep among its sentences."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = reading.read(log)
    kept = "\n".join(map(str, recording.meta.get("reading", ())))
    texts = [str(each.message) for each in caught if issubclass(each.category, UserWarning)]
    return recording, [text for text in texts if text.partition(": ")[2] not in kept]


def _write_mapping(
    target: Path, reading: ReaderOptions, log: Path, columns: Mapping[str, str]
) -> Path:
    """Write what is known of a log's columns as a mapping file; returns its path."""
    name = reading.format_of(log)
    known = options_of(reader_of(name))
    options = reading.options(name)
    if "topics" in known:  # a device's log, whose columns are channels'
        told = {
            r: columns[q].rpartition(".")[0] for r, qs in CHOSEN.items() for q in qs if q in columns
        }
        return _put(
            target,
            written(name, {}, [], {**options, "topics": {**told, **(options.get("topics") or {})}}),
        )
    if "columns" not in known:
        raise ValueError(
            f"format {name!r} has no columns to say anything of: --write-mapping is for text logs."
        )
    delimiter, decimal, encoding = map(options.get, ("delimiter", "decimal", "encoding"))
    names = read_table(log, delimiter, decimal=decimal, encoding=encoding).cells
    others = [each for each in names if each not in columns.values()]
    return _put(target, written(name, columns, others, options))


def _put(target: Path, text: str) -> Path:
    if target.exists():
        raise ValueError(f"{target} exists: name another file, or remove it.")
    with replacing(target, text=True) as file:
        file.write(text)
    return target


def told(recording: Any, problem: Problem) -> list[tuple[str, str]]:
    """What a recording holds, as lines with a name each."""
    meta = recording.meta
    source = meta.get("file") or meta.get("source") or meta.get("scenario")
    lines = [("log", f"{problem.title}, {meta.get('format', 'npz')}{f': {source}' * bool(source)}")]
    time = np.asarray(recording.time)
    lines.append(("rows", f"{len(time)} over {time[-1] - time[0]:.6g} s, from {time[0]:.10g} s"))
    if len(time) > 1:
        steps = np.diff(time)
        k = int(steps.argmax())
        usual = float(np.median(steps))
        longest = f", the longest {steps[k]:.4g} s, after {time[k]:.10g} s" * bool(
            steps[k] > LONGER * usual
        )
        lines.append(("step", f"{usual:.4g} s (median){longest}"))
    if problem.told is not None:
        lines += problem.told(recording)
    return lines + [("reading", str(line)) for line in meta.get("reading", ())]


def following(reading: ReaderOptions, log: Path, recording: Any, problem: Problem) -> str:
    """The command that would come next."""
    chosen = problem.plain[0]
    if len(problem.plain) > 1:
        chosen = problem.plain_filter(problem.stack([recording]))
    if not problem.filters[chosen].space.names:  # nothing in it to tune
        chosen = problem.study.filter
    words = ["navgym", "tune", "--filter", chosen, "--log", str(log)]
    words += ["--format", reading.format] if reading.format else []
    words += ["--read", *reading.words] if reading.words else []
    return shlex.join(words)
