"""Which filter, with which parameters, holds an AUV's position when measurements get lost?

    python scripts/demo.py             tune, compare, replay real tracks, write the page
    python scripts/demo.py --quick     the same, shortened to well under a minute

1. tunes QIVBF with Optuna on training seeds of the scenario auv/switch-D; the study is kept in a
   journal under --out, so Ctrl-C loses nothing and the same command goes on where it stopped;
2. runs the default, the tuned and every other filter on fresh test seeds, all on the same
   recordings, so that differences are paired;
3. replays real tracks (A-KIT, 1 to 6) at 10, 30 and 50 % loss with every filter, at its defaults
   and tuned on the other half of the tracks. Without the data, simulated tracks stand in, and the
   page says so;
4. writes report.html (open it in a browser) and results.json to --out, and prints the table.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[1]
BESIDE = REPOSITORY.parent / "shared" / "data" / "akit"
SCENARIO = "auv/switch-D"
DEFAULT, TUNED, UNTUNED = "qivbf (default)", "qivbf (tuned)", "qivbf (untuned)"
SHOWN = ("kf", TUNED, "imm", "bank")
REPLAYED = ("kf", "kf_extrapolate", DEFAULT, "qivbf (tuned on tracks)", "bank")


@dataclass(frozen=True)
class Size:
    """How much is run: recordings, steps and trials of each part."""

    trials: int
    train: int
    test: int
    steps: int | None
    draws: int
    track_trials: int


FULL = Size(trials=120, train=40, test=300, steps=None, draws=10, track_trials=50)
QUICK = Size(trials=20, train=40, test=60, steps=400, draws=2, track_trials=8)


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--trials", type=int, help=f"finished trials of the study (default: {FULL.trials})")
    add("--runs", type=int, help=f"fresh recordings to compare on (default: {FULL.test})")
    add("--seed", type=int, default=0, help="of the study's sampler (default: 0)")
    add("--out", type=Path, default=Path("runs/demo"), help="folder to write to (default: %(default)s)")
    add("--data", type=Path, help="folder with the A-KIT tracks (default: shared/data/akit beside the repository, if it exists)")
    add("--quick", action="store_true", help="a shortened demo, for a first look and for CI")
    return parser.parse_args(arguments)


def main() -> int:
    """Run the demo; returns the exit status."""
    options = parse()
    began = time.perf_counter()
    try:
        found = Demo(options)
        found.run()
    except KeyboardInterrupt:
        print(
            f"\nStopped. Finished trials are kept under {options.out}; the same command goes on.",
            file=sys.stderr,
        )
        return 130
    except (ValueError, FileNotFoundError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(found.summary())
    print(f"\n{found.page}  ({time.perf_counter() - began:.0f} s)")
    return 0
