"""Which filter, with which parameters, holds an AUV's position when measurements get lost?

    python scripts/demo.py             tune, compare, replay real tracks, write the page
    python scripts/demo.py --quick     the same, shortened to well under a minute

1. tunes QIVBF with Optuna on training seeds of the scenario auv/switch-D. The study is kept in a
   journal under --out: Ctrl-C loses nothing, and the same command goes on where it stopped;
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
from dataclasses import replace
from pathlib import Path

BESIDE = Path(__file__).resolve().parents[2] / "shared" / "data" / "akit"


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--trials", type=int, help="finished trials of the study (default: 200)")
    add("--runs", type=int, help="fresh recordings to compare on (default: 300)")
    add("--seed", type=int, default=0, help="of the studies' samplers (default: %(default)s)")
    add("--out", type=Path, default=Path("runs/demo"), help="folder (default: %(default)s)")
    add(
        "--data", type=Path, help="folder of the A-KIT tracks "
        "(default: ../shared/data/akit beside the repository, if it is there)",
    )  # fmt: skip
    add("--quick", action="store_true", help="shortened, for a first look and for CI")
    return parser.parse_args()


def main() -> int:
    """Run the demo; returns the exit status."""
    options = parse()
    from navgym.tuning import demo

    began = time.perf_counter()
    size = demo.QUICK if options.quick else demo.FULL
    given = {"trials": options.trials, "test": options.runs}
    size = replace(size, **{name: n for name, n in given.items() if n is not None})
    try:
        return show(options, size, began)
    except demo.Interrupted as stop:
        best = stop.outcome.best
        print(f"\nstopped after {len(stop.outcome.trials)} trials: the best so far has "
              f"{best.result:.4g} m with {dict(best.values)}")  # fmt: skip
    except KeyboardInterrupt:
        print("\nstopped")
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"finished trials are kept in {options.out}: the same command goes on from there")
    return 130


def show(options: argparse.Namespace, size: object, began: float) -> int:
    """Run, write the page and the results, print the table and the path."""
    from navgym.tuning import demo
    from navgym.tuning.report import page as report

    assert isinstance(size, demo.DemoAmount)
    folder = options.data or (BESIDE if BESIDE.is_dir() else None)
    data = f"A-KIT, {options.data or '../shared/data/akit'}" if folder else "simulated stand-in"
    print(f"tracks: {data}")
    found = demo.run(size, options.seed, options.out, folder)
    seeds = {"tuning": "training", "choice among leaders": "validation", "all figures": "test"}
    basis = report.provenance("demo.py", tracks=data, seeds=seeds, sampler_seed=options.seed)
    report.write_json(options.out / "results.json", demo.results(found, basis))
    path = report.write_page(options.out / "report.html", demo.page(found, basis))
    print(f"\n{demo.table(found).as_text()}\n\nreport: {path}")
    print(f"{time.perf_counter() - began:.0f} s in all")
    return 0


if __name__ == "__main__":
    sys.exit(main())
