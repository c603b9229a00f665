"""`navgym stream`: estimates of a log that arrives on standard input, line by line."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from navgym.agents.live.lines import Noise, estimates
from navgym.agents.policies.policy import Policy, located

ABOUT = """Filter a log line by line, as it arrives, with parameters that a trained policy sets.

    navgym stream auv < my_log.csv > estimates.csv
    some_logger | navgym stream runs/mine/policy.npz --position-noise 1.5

The first line of standard input names the columns: time (s) and any of px, vx, py, vy (m, m/s). Each
further line is a sample, at any time after the last one; an empty cell or nan is a lost component
(as are lost, lost_px, ...). After each, a line goes to standard output: state, standard
deviations, normalised innovation squared, and whether the best fixed parameters are in force
instead of the policy's. Why, and since when, is said on standard error.

POLICY is auv, which comes with navgym, or what `navgym train` wrote (policy.npz and policy.json)
for navgym/AUVDropout-v0. Neither torch nor any extra of navgym is needed.
"""


def parse(words: Sequence[str]) -> argparse.Namespace:
    """The command line. By argparse: this command runs on board, where tyro is not installed."""
    parser = argparse.ArgumentParser(
        prog="navgym stream", description=ABOUT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    add = parser.add_argument
    add("policy", help="path of the policy, with or without .npz, or: auv")
    add("--position-noise", type=float, default=1.0, help="std of a position, m (%(default)s)")
    add("--velocity-noise", type=float, default=0.1, help="std of a velocity, m/s (%(default)s)")
    add("--acceleration", type=float, default=0.1, help="std of the vehicle's, m/s² (%(default)s)")
    add("--step", type=float, default=1.0, help="usual step between samples, s (%(default)s)")
    add("--delimiter", default=",", help="between cells (a comma); \\t: a tab")
    return parser.parse_args(list(words))


def main(words: Sequence[str]) -> int:
    """Filter standard input; returns the exit status."""
    options = parse(words)
    policy = Policy.load(located(options.policy))
    noise = Noise(
        options.position_noise, options.velocity_noise, options.acceleration, options.step
    )
    delimiter = options.delimiter.replace("\\t", "\t")
    # a broken byte spoils its line, not the stream
    sys.stdin.reconfigure(errors="replace")  # type: ignore[union-attr]
    try:
        for line in estimates(sys.stdin, policy, noise, _notice, delimiter):
            print(line, flush=True)
    except BrokenPipeError:  # whoever read the estimates has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _notice(text: str) -> None:
    """Say something beside the estimates."""
    print(text, file=sys.stderr, flush=True)
