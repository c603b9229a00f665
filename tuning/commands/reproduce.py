"""`navgym reproduce`: two papers' figures run again, each beside what was expected."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from navgym.auv.problem import TRACKS
from navgym.command import as_typed
from navgym.core.checks import positive_int
from navgym.core.data import absent, data_folder
from navgym.core.interrupts import STOPPED
from navgym.tuning.commands.parse import parse
from navgym.tuning.papers import idam, ins, qivbf
from navgym.tuning.papers.ins_tracks import has_inertial_data
from navgym.tuning.report import page as report

ABOUT = """Run the published and the prototype's figures again, and say which of them hold.

    navgym reproduce auv            about five minutes on one core
    navgym reproduce deck           about 20 minutes on one core, most of it whale optimisation
    navgym reproduce ins            about six minutes on one core
    navgym reproduce auv --quick    every part on a few recordings: shows that it runs,
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

ins: the system that QIVBF is for and never runs, an INS with a Doppler log: the filter whose model is right;
every filter under noise that changes; what stands in for a log that is silent; QIVBF against the Kalman filter
there; and real tracks with inertial data, without fixes, with outages, and with fixes beside filters of four
states, where they are at hand. Writes ins.html and ins.json. Expected figures: the documentation, Science,
INS/DVL.
"""
DECK_SETS = {"repoimu": "RepoIMU", "multi_imu": "multi-IMU"}


@dataclass(frozen=True)
class ReproduceOptions:
    """What was asked for."""

    paper: Annotated[Literal["auv", "deck", "ins"], tyro.conf.Positional]
    """auv: lost measurements in AUV navigation; deck: attitude and deformation of a ship's deck; ins: an INS with
    a Doppler log, the system that the first is about"""
    runs: int | None = None
    """test recordings per figure; None: 300 for auv, 60 for deck, 24 for ins"""
    trials: int | None = None
    """per study of auv; None: 200"""
    seed: int | None = None
    """of the samplers of auv's studies; None: 0"""
    out: Path = Path("runs/reproduce")
    """folder for everything that is written"""
    data: Path | None = None
    """folder of the A-KIT tracks (auv, ins), or one that holds akit, repoimu or multi_imu; None: that in
    $NAVGYM_DATA"""
    quick: bool = False
    """a few recordings and trials, only to see it run"""

    def check(self) -> None:
        """Raise ValueError for what would be ignored."""
        for name in ("trials", "seed"):
            if self.paper != "auv" and getattr(self, name) is not None:
                raise ValueError(
                    f"--{name} is for studies, and {self.paper} has none: leave it out."
                )


def main(words: Sequence[str]) -> int:
    """Reproduce one paper's figures; returns the exit status."""
    options = parse(ReproduceOptions, "reproduce", ABOUT, words)
    options.check()
    began = time.perf_counter()
    run = {"auv": _auv, "deck": _deck, "ins": _ins}[options.paper]
    try:
        path = run(options, as_typed("reproduce", words))
    except KeyboardInterrupt:
        kept = f"finished trials are kept in {options.out}: the same command goes on"
        print(f"\nstopped; {kept if options.paper == 'auv' else 'nothing was written'}")
        return STOPPED
    print(f"\nreport: {path}\n{time.perf_counter() - began:.0f} s in all")
    return 0


def _auv(options: ReproduceOptions, command: str) -> Path:
    size = qivbf.QUICK if options.quick else qivbf.FULL
    given = {"trials": options.trials, "runs": options.runs}
    size = replace(size, **{name: n for name, n in given.items() if n is not None})
    folder = data_folder(TRACKS.name, options.data)
    if folder is None:
        print(absent(TRACKS.title))
    seed = options.seed or 0
    parts = _shown(qivbf.auv(size, seed, options.out, folder))
    seeds = {"tuning": "training", "choice among leaders": "validation", "all figures": "test"}
    data = TRACKS.title if folder else "none"
    basis = report.provenance(command, tracks=data, seeds=seeds, sampler_seed=seed)
    return _written(options.out / "auv", parts, basis)


def _deck(options: ReproduceOptions, command: str) -> Path:
    size = idam.QUICK if options.quick else idam.FULL
    size = size if options.runs is None else replace(size, runs=options.runs)
    folders = {name: data_folder(name, options.data) for name in DECK_SETS}
    missing = [DECK_SETS[name] for name, folder in folders.items() if folder is None]
    if missing:
        print(absent(*missing))
    parts = _shown(idam.deck(size, *folders.values()))
    seeds = {"choice of the fixed width": "training", "all figures": "test"}
    real = [name for name, folder in folders.items() if folder is not None]
    basis = report.provenance(command, real=real, seeds=seeds)
    return _written(options.out / "deck", parts, basis, "The deck figures, reproduced")


def _ins(options: ReproduceOptions, command: str) -> Path:
    size = ins.QUICK if options.quick else ins.FULL
    size = (
        size
        if options.runs is None
        else replace(size, runs=positive_int("runs", options.runs, least=2))
    )
    folder = data_folder(TRACKS.name, options.data)
    if folder is None or not has_inertial_data(folder):
        folder = None
        print(absent(f"{TRACKS.title} with inertial data"))
    parts = _shown(ins.ins(size, folder))
    seeds = {"choice of the log's R": "training, tracks 1-3", "all figures": "test"}
    basis = report.provenance(command, tracks=TRACKS.title if folder else "none", seeds=seeds)
    return _written(options.out / "ins", parts, basis, "INS/DVL, the tables")


def _shown(parts: Iterable[Any]) -> list[Any]:
    """The parts of a reproduction, each printed as soon as it is there."""
    done = []
    for each in parts:
        done.append(each)
        print(f"\n{each.section.title}", flush=True)
        for check in each.checks:
            print(f"  {check.verdict:13} {check.what}: {check.found:.3f} ± {check.half:.3f}, "
                  f"expected {check.expected:g}", flush=True)  # fmt: skip
    return done


def _written(where: Path, parts: list[Any], basis: Mapping[str, Any], *title: str) -> Path:
    """Write results and page; returns the page."""
    report.write_json(where.with_suffix(".json"), qivbf.results(parts, basis))
    return report.write_page(where.with_suffix(".html"), qivbf.page(parts, basis, *title))
