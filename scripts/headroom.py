"""What could be won by steering a filter: best fixed parameters against parameters by true regime.

    python scripts/headroom.py                         auv/switch-D, -B, -A and deck/switch-60
    python scripts/headroom.py auv/switch-D            one scenario, about two minutes on two cores
    python scripts/headroom.py deck/switch-60
    python scripts/headroom.py --quick                 shortened, only to see it run

For each scenario two studies: the best parameters that never change, and the best table of parameters
by true regime, which is truth and so bounds what any schedule or agent can win. Both are tuned on
training seeds, chosen on validation seeds and compared on test seeds, beside filters that need no
tuning and the oracle. The studies under --out resume an interrupted run. Writes headroom.html and
headroom.json.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

USUAL = ("auv/switch-D", "auv/switch-B", "auv/switch-A", "deck/switch-60")


def main() -> int:
    """Parse the command line and run; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("scenario", nargs="*", help=f"names of navgym.scenarios() (default: {' '.join(USUAL)})")
    add("--seed", type=int, default=0, help="of the samplers (default: %(default)s)")
    add("--workers", type=int, default=2, help="processes (default: %(default)s)")
    add("--out", type=Path, default=Path("runs/headroom"), help="folder (default: %(default)s)")
    add("--quick", action="store_true", help="a few recordings and trials, only to see it run")
    options = parser.parse_args()
    from navgym.tuning import headroom
    from navgym.tuning.study.executors import workers

    found = []
    try:
        with workers(options.workers) as executor:
            for name in options.scenario or USUAL:
                one = headroom.headroom(name, options.seed, options.out, executor, options.quick)
                found.append(one)
                print(f"\n{headroom.summary(one)}\n")
        path = headroom.write(found, options.out, sampler_seed=options.seed)
    except KeyboardInterrupt:
        print("\nstopped: finished trials are kept, the same command goes on from there")
        return 130
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"report: {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
