"""Run the published and the prototype's figures again, and say which of them hold.

    python scripts/reproduce.py auv            about five minutes on one core
    python scripts/reproduce.py deck           about 20 minutes on one core, most of it whale optimisation
    python scripts/reproduce.py auv --quick    every part on a few recordings: shows that it runs,
                                               and its figures mean nothing

auv: what to do with a lost sample, under five conditions, the printed QIVBF included; what switching
conditions leave to win: best fixed parameters, table by true regime, IMM, oracle; the bank against
the wide IMM, off its design too; nonlinear filters on a coordinated turn; and real AUV tracks, where
the A-KIT data are at hand. Figures are from test seeds; what was tuned was tuned on training seeds
and chosen on validation seeds, in studies whose journals under --out resume an interrupted run.
Writes auv.html and auv.json to --out. Expected figures: the documentation, Science, QIVBF.

deck: IDAM against WOAM and SVRAM in the paper's setting, with enough seeds to tell (IDAM section 5); what
can be known of the deformation at all, the lever arm, identification by every method, correntropy and
model prediction; switching conditions and a changing sea; and a real pendulum and a real quadrotor,
where the RepoIMU and multi-IMU data are at hand. Writes deck.html and deck.json. Expected
figures: the documentation, Science, IDAM.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
BESIDE = SHARED / "akit"


def parse() -> argparse.Namespace:
    """The command line: one subcommand per paper."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    papers = parser.add_subparsers(dest="paper", required=True, metavar="paper")
    add = papers.add_parser("auv", help="lost measurements in AUV navigation").add_argument
    add("--runs", type=int, help="test recordings per figure (default: 300)")
    add("--trials", type=int, help="per study (default: 200)")
    add("--seed", type=int, default=0, help="of the studies' samplers (default: %(default)s)")
    add("--out", type=Path, default=Path("runs/reproduce"), help="folder (default: %(default)s)")
    add(
        "--data", type=Path, help="folder of the A-KIT tracks "
        "(default: ../shared/data/akit beside the repository, if it is there)",
    )  # fmt: skip
    add("--quick", action="store_true", help="a few recordings and trials, only to see it run")
    add = papers.add_parser("deck", help="attitude and deformation of a ship's deck").add_argument
    add("--runs", type=int, help="paired test recordings per figure (default: 60)")
    add("--out", type=Path, default=Path("runs/reproduce"), help="folder (default: %(default)s)")
    add(
        "--data", type=Path, help="folder that holds repoimu and multi_imu "
        "(default: ../shared/data beside the repository, if it is there)",
    )  # fmt: skip
    add("--quick", action="store_true", help="a few recordings, only to see it run")
    return parser.parse_args()


def deck(options: argparse.Namespace) -> int:
    """Reproduce the deck figures."""
    from navgym.tuning.papers import idam as deck_reproduction
    from navgym.tuning.papers import qivbf as reproduction
    from navgym.tuning.report import page as report

    began = time.perf_counter()
    size = deck_reproduction.QUICK if options.quick else deck_reproduction.FULL
    size = size if options.runs is None else replace(size, runs=options.runs)
    folders = [(options.data or SHARED) / name for name in ("repoimu", "multi_imu")]
    there = [folder if folder.is_dir() else None for folder in folders]
    for name, folder in zip(("RepoIMU", "multi-IMU"), there, strict=True):
        if folder is None:
            print(f"no {name} data: left out (name the folder above it with --data)")
    parts = shown(deck_reproduction.deck(size, *there))
    seeds = {"choice of the fixed width": "training", "all figures": "test"}
    basis = report.provenance(
        "reproduce.py", real=[f.name for f in there if f is not None], seeds=seeds
    )
    report.write_json(options.out / "deck.json", reproduction.results(parts, basis))
    page = reproduction.page(parts, basis, "The deck figures, reproduced")
    path = report.write_page(options.out / "deck.html", page)
    print(f"\nreport: {path}\n{time.perf_counter() - began:.0f} s in all")
    return 0


def shown(parts: Iterable[Any]) -> list[Any]:
    """The parts of a reproduction, each printed as soon as it is there."""
    done = []
    for part in parts:
        done.append(part)
        print(f"\n{part.section.title}", flush=True)
        for check in part.checks:
            print(f"  {check.verdict:13} {check.what}: {check.found:.3f} ± {check.half:.3f}, "
                  f"expected {check.expected:g}", flush=True)  # fmt: skip
    return done


def auv(options: argparse.Namespace) -> int:
    """Reproduce the AUV figures."""
    from navgym.tuning.papers import qivbf as reproduction
    from navgym.tuning.report import page as report

    began = time.perf_counter()
    size = reproduction.QUICK if options.quick else reproduction.FULL
    given = {"trials": options.trials, "runs": options.runs}
    size = replace(size, **{name: n for name, n in given.items() if n is not None})
    folder = options.data or (BESIDE if BESIDE.is_dir() else None)
    if folder is None:
        print("no A-KIT data: the real tracks are left out (name their folder with --data)")
    parts = shown(reproduction.auv(size, options.seed, options.out, folder))
    data = f"A-KIT, {options.data or '../shared/data/akit'}" if folder else "none"
    seeds = {"tuning": "training", "choice among leaders": "validation", "all figures": "test"}
    basis = report.provenance("reproduce.py", tracks=data, seeds=seeds, sampler_seed=options.seed)
    report.write_json(options.out / "auv.json", reproduction.results(parts, basis))
    path = report.write_page(options.out / "auv.html", reproduction.page(parts, basis))
    print(f"\nreport: {path}\n{time.perf_counter() - began:.0f} s in all")
    return 0


PAPERS: dict[str, Callable[[argparse.Namespace], int]] = {"auv": auv, "deck": deck}


def main() -> int:
    """Parse the command line and run; returns the exit status."""
    options = parse()
    try:
        return PAPERS[options.paper](options)
    except KeyboardInterrupt:
        print(f"\nstopped; finished trials are kept in {options.out}: the same command goes on")
        return 130
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
