"""`navgym demo`: the whole of navgym's tuning half in one page."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from navgym.auv.problem import TRACKS
from navgym.command import as_typed
from navgym.core.data import data_folder
from navgym.core.interrupts import STOPPED
from navgym.tuning import demo
from navgym.tuning.commands.parse import parse
from navgym.tuning.report import page as report
from navgym.tuning.study.run import Interrupted

ABOUT = """Which filter, with which parameters, holds an AUV's position when measurements get lost?

    navgym demo             tune, compare, replay tracks, write the page
    navgym demo --quick     the same, shortened to well under a minute
    navgym demo --data FOLDER

1. tunes QIVBF with Optuna on training seeds of the scenario auv/switch-D, 30 % of whose samples are
   lost. The study is kept in a
   journal under --out: Ctrl-C loses nothing, and the same command goes on where it stopped;
2. runs the default, the tuned and every other filter on fresh test seeds, all on the same
   recordings, so that differences are paired;
3. replays real tracks (A-KIT, 1 to 6) at 10, 30 and 50 % loss with every filter, at its defaults
   and tuned on the other half of the tracks. Without the data, simulated tracks stand in, and the
   page says so;
4. writes report.html (open it in a browser) and results.json to --out, and prints the table.
"""


@dataclass(frozen=True)
class DemoOptions:
    """What was asked for."""

    trials: int | None = None
    """finished trials of the study; None: 200, or 20 with --quick"""
    runs: int | None = None
    """fresh recordings to compare on; None: 300, or 60 with --quick"""
    seed: int = 0
    """of the studies' samplers"""
    out: Path = Path("runs/demo")
    """folder for everything that is written"""
    data: Path | None = None
    """folder of the A-KIT tracks, or the one above it; None: those in $NAVGYM_DATA, if there are any"""
    quick: bool = False
    """shortened, for a first look and for CI"""

    @property
    def amount(self) -> demo.DemoAmount:
        """How much is run."""
        given = {"trials": self.trials, "test": self.runs}
        usual = demo.QUICK if self.quick else demo.FULL
        return replace(usual, **{name: n for name, n in given.items() if n is not None})


def main(words: Sequence[str]) -> int:
    """Run the demo; returns the exit status."""
    options = parse(DemoOptions, "demo", ABOUT, words)
    try:
        _show(options, as_typed("demo", words))
    except Interrupted as stop:
        best = stop.outcome.best
        print(f"\nstopped after {len(stop.outcome.trials)} trials: the best so far has "
              f"{best.result:.4g} m with {dict(best.values)}")  # fmt: skip
    except KeyboardInterrupt:
        print("\nstopped")
    else:
        return 0
    print(f"finished trials are kept in {options.out}: the same command goes on from there")
    return STOPPED


def _show(options: DemoOptions, command: str) -> None:
    """Run, write the page and the results, print the table and the path."""
    began = time.perf_counter()
    folder = data_folder(TRACKS.name, options.data)
    data = TRACKS.title if folder else "simulated stand-in"
    print(f"tracks: {data}, {folder}" if folder else f"tracks: {data}")
    found = demo.run(options.amount, options.seed, options.out, folder)
    seeds = {"tuning": "training", "choice among leaders": "validation", "all figures": "test"}
    basis = report.provenance(command, tracks=data, seeds=seeds, sampler_seed=options.seed)
    report.write_json(options.out / "results.json", demo.results(found, basis))
    path = report.write_page(options.out / "report.html", demo.page(found, basis))
    print(f"\n{demo.vehicle()}\n{100 * demo.LOSS:.0f} % of the samples are lost.\n")
    print(f"{demo.table(found).as_text()}\n\nreport: {path}")
    print(f"{time.perf_counter() - began:.0f} s in all\n\n{demo.NOW}")
