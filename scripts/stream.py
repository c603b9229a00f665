"""Filter a log line by line, as it arrives, with parameters that a trained policy sets.

    python scripts/stream.py POLICY < my_log.csv > estimates.csv
    some_logger | python scripts/stream.py POLICY --position-noise 1.5

The first line of standard input names the columns: time (s) and any of px, vx, py, vy (m, m/s). Each
further line is a sample, at any time after the last one; an empty cell or nan is a lost component
(as are lost, lost_px, ...). After each, a line goes to standard output: state, standard
deviations, normalised innovation squared, and whether the best fixed parameters are in force
instead of the policy's. Why, and since when, is said on standard error. torch is not needed.

POLICY is what scripts/train.py wrote (policy.npz and policy.json) for navgym/AUVDropout-v0.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("policy", type=Path, help="path of the policy, with or without .npz")
    add("--position-noise", type=float, default=1.0, help="std of a position, m (%(default)s)")
    add("--velocity-noise", type=float, default=0.1, help="std of a velocity, m/s (%(default)s)")
    add("--acceleration", type=float, default=0.1, help="std of the vehicle's, m/s² (%(default)s)")
    add("--step", type=float, default=1.0, help="usual step between samples, s (%(default)s)")
    add("--delimiter", default=",", help="between cells (a comma); \\t: a tab")
    return parser.parse_args()


def notice(text: str) -> None:
    """Say something beside the estimates."""
    print(text, file=sys.stderr, flush=True)


def main() -> int:
    """Filter standard input; returns the exit status."""
    options = parse()
    # a broken byte spoils its line, not the stream
    sys.stdin.reconfigure(errors="replace")  # type: ignore[union-attr]
    from navgym.agents import Policy
    from navgym.agents.live.lines import Noise, estimates

    try:
        policy = Policy.load(options.policy)
        noise = Noise(
            options.position_noise, options.velocity_noise, options.acceleration, options.step
        )
        delimiter = options.delimiter.replace("\\t", "\t")
        for line in estimates(sys.stdin, policy, noise, notice, delimiter):
            print(line, flush=True)
    except BrokenPipeError:  # whoever read the estimates has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (ValueError, OSError) as error:
        notice(f"error: {error}")
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
