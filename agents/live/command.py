"""`navgym stream`: estimates of a log that arrives on standard input, line by line."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from typing import Any, BinaryIO

from navgym.agents.live.lines import LONGEST_LINE, Format, Noise, estimates
from navgym.agents.policies.loading import load_agent
from navgym.agents.policies.policy import Policy, located
from navgym.readers import ReaderOptions, words_after

ABOUT = """Filter a log line by line, as it arrives, with parameters that a trained policy sets.

    navgym stream auv < my_log.csv > estimates.csv
    some_logger | navgym stream runs/mine/policy.npz --position-noise 1.5
    some_logger | navgym stream auv --read position_noise 5 columns.px "north (m)"

The first line of standard input names the columns: time (s) and any of px, vx, py, vy (m, m/s), or
lat and lon; names and units are understood as everywhere ("North (m)", "Time [ms]"). Each further
line is a sample, at any time after the last one; an empty cell or nan is a lost component (as are
lost, lost_px, ...). After each, a line goes to standard output: time as it came, state,
standard deviations, normalised innovation squared, and whether the best fixed parameters are in force
instead of the policy's. Why, and since when, is said on standard error, and so is what was left out.

A line whose time jumps is left out; if the next one goes on from there, the clock was set, and the
filter begins anew. One measurement far off is an outlier; five that agree are where the vehicle is.

POLICY is auv, which comes with navgym, or what `navgym train` wrote (policy.npz and policy.json)
for navgym/AUVDropout-v0, or a mixture (mixture.npz and mixture.json): there the tuned filter takes the place
of the best fixed parameters. Neither torch nor any extra of navgym is needed.
"""
# reader options that make sense for a stream: of the model's noise by what they are called here
OPTIONS = {"position_noise": "position", "velocity_noise": "velocity", "acceleration": "acceleration"}  # fmt: skip
FORMAT = ("columns", "units", "delimiter", "time_scale")


def parse(words: Sequence[str]) -> argparse.Namespace:
    """The command line. By argparse: this command runs on board, where tyro is not installed."""
    parser = argparse.ArgumentParser(
        prog="navgym stream", description=ABOUT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = parser.add_argument
    add("policy", help="path of the policy, with or without .npz, or: auv")
    add(
        "--reference", metavar="tuned.toml",
        help="your own tuned parameters, as navgym tune writes them: the policy starts from them and falls "
        "back to them, and is in force once it has foretold the fixes better",
    )  # fmt: skip
    add("--position-noise", type=float, help="std of a position, m (1.0)")
    add("--velocity-noise", type=float, help="std of a velocity, m/s (0.1)")
    add("--acceleration", type=float, help="std of the vehicle's white one, m/s²/√Hz (0.1)")
    add("--step", type=float, default=1.0, help="usual step between samples, s (%(default)s)")
    add("--delimiter", help="between cells (a comma); \\t: a tab")
    add(
        "--read", nargs="+", metavar="WORD",
        help="the same as words of any command that reads logs: a mapping file, pairs of "
        f"{', '.join([*OPTIONS, *FORMAT])} and their values",
    )  # fmt: skip
    told, rest = words_after("--read", words)
    return parser.parse_args(rest, argparse.Namespace(read=told))


def main(words: Sequence[str]) -> int:
    """Filter standard input; returns the exit status."""
    options = parse(words)
    noise, form = _told(options)
    policy = load_agent(located(options.policy))
    if options.reference is not None:
        if not isinstance(policy, Policy):
            raise ValueError("--reference is for policies: a mixture has its own tuned parameters.")
        policy = policy.with_reference(options.reference)
    found = estimates(text_lines(sys.stdin.buffer), policy, noise, say, form)
    with closing(found):
        for line in found:
            print(line, flush=True)
    return 0


def text_lines(raw: BinaryIO) -> Iterator[str]:
    """Lines of text as they arrive; a broken byte spoils its cell, not the stream.

    Of a line that is too long come the first `LONGEST_LINE` bytes.
    """
    while line := raw.readline(LONGEST_LINE):
        rest = line
        while len(rest) == LONGEST_LINE and not rest.endswith(b"\n"):
            rest = raw.readline(LONGEST_LINE)
        yield line.decode("utf-8", errors="replace")


def say(text: str) -> None:
    """Say something beside the estimates."""
    print(text, file=sys.stderr, flush=True)


def _told(options: argparse.Namespace) -> tuple[Noise, Format]:
    """What the words say of the noise, and of how lines are written."""
    read = ReaderOptions.parsed(options.read).options("csv", (*OPTIONS, *FORMAT))
    given: dict[str, Any] = {ours: read[name] for name, ours in OPTIONS.items() if name in read}
    for name, ours in OPTIONS.items():
        if getattr(options, name) is not None:
            given[ours] = getattr(options, name)
    form = {name: read[name] for name in FORMAT if read.get(name) is not None}
    if options.delimiter is not None:
        form["delimiter"] = options.delimiter
    if "delimiter" in form:
        form["delimiter"] = form["delimiter"].replace("\\t", "\t")
    return Noise(step=options.step, **given), Format(**form)
