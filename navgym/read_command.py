"""`navgym read`: what a log holds as navgym reads it, before anything is made of it."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from navgym.problem import Problem
from navgym.readers import ReaderOptions, formats

ABOUT = """Read a log and say what was found in it: rows, steps, gaps, losses, what the reader changed.

    navgym read my_log.csv
    navgym read my_log.csv --read position_noise 1.5 columns.px "north (m)" delimiter ";"
    navgym read my_log.csv --read mapping.toml --out my_log.npz
    navgym read ship.csv --read lever_arm 10,10,2 regular true

--read takes pairs of an option and its value, as navgym tune and the other commands do, and
before them, if you like, a mapping file that says what each column holds. An option of the reader
that is not there is answered with those that are.
"""

NAMED = 9  # columns of the line's name


def parse(words: Sequence[str]) -> argparse.Namespace:
    """The command line. By argparse: the core of navgym does not install tyro."""
    parser = argparse.ArgumentParser(
        prog="navgym read", description=ABOUT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = parser.add_argument
    add("log", type=Path, help="the file, or the folder of a public data set")
    add("--read", nargs="+", default=[], metavar="WORD", help="what the reader is told")
    add("--format", help=f"one of {', '.join(formats())}; by default what the log looks like")
    add("--out", type=Path, help="save the recording there, as NAME.npz, with the model")
    return parser.parse_args(list(words))


def main(words: Sequence[str]) -> int:
    """Read and tell; returns the exit status."""
    asked = parse(words)
    reading = ReaderOptions.parsed(asked.read, asked.format)
    recording = reading.read(asked.log)
    problem = reading.problem(asked.log)
    for name, line in told(recording, problem):
        print(f"{name.ljust(NAMED)} {line}")
    if asked.out is not None:
        print(f"{'saved'.ljust(NAMED)} {recording.save(asked.out)}")
    print(f"{'next'.ljust(NAMED)} {following(reading, asked.log, recording, problem)}")
    return 0


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
        longest = f"the longest {steps[k]:.4g} s, after {time[k]:.10g} s"
        lines.append(("step", f"{np.median(steps):.4g} s (median), {longest}"))
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
