"""`navgym headroom`: best fixed parameters against parameters by true regime."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from navgym.command import as_typed
from navgym.problem import problem_of
from navgym.tuning import headroom, worth
from navgym.tuning.commands.parse import parse
from navgym.tuning.report.page import SHORTENED
from navgym.tuning.study.executors import workers

USUAL = ("auv/switch-D", "auv/switch-B", "auv/switch-A", "deck/switch-60")
ABOUT = """What could be won by steering a filter: best fixed parameters against parameters by true regime.

    navgym headroom                         auv/switch-D, -B, -A and deck/switch-60
    navgym headroom auv/switch-D            one scenario, about two minutes on two cores
    navgym headroom deck/switch-60
    navgym headroom --quick                 shortened, only to see it run
    navgym headroom --akit FOLDER           what each measure is worth that needs no truth, on real tracks
    navgym headroom --measures deck/paper deck/switch-60 deck/sea-state        and on simulated ones

For each scenario two studies: the best parameters that never change, and the best table of parameters
by true regime, which is truth and so bounds what any schedule or agent can win. Both are tuned on
training seeds, chosen on validation seeds and compared on test seeds, beside filters that need no
tuning and the oracle. The studies under --out resume an interrupted run. Writes headroom.html and
headroom.json.

With --akit or --measures another question: 214 settings of a filter (60 of a deck's), spread over its
whole space, are judged by the truth and by every measure that needs none. What does each of these pick,
and does it rank the better half as the truth does? Writes worth.html and worth.json, in a minute or two.
"""


@dataclass(frozen=True)
class HeadroomOptions:
    """What was asked for."""

    scenario: Annotated[tuple[str, ...], tyro.conf.Positional] = USUAL
    """names of navgym.scenarios()"""
    seed: int = 0
    """of the samplers"""
    workers: int = 2
    """processes"""
    out: Path = Path("runs/headroom")
    """folder for everything that is written"""
    quick: bool = False
    """a few recordings and trials, only to see it run"""
    akit: Path | None = None
    """folder of the A-KIT tracks: measure what measures are worth there"""
    measures: tuple[str, ...] = ()
    """scenarios of one problem: measure what measures are worth there"""
    filter: str | None = None
    """whose settings --akit and --measures spread; None: what the problem's studies tune"""
    free: tuple[str, ...] = ()
    """parameters that --measures varies; nothing for every one"""
    truth: str | None = None
    """measure that --measures ranks by; None: the problem's first"""
    settings: int | None = None
    """how many of them; None: 214, of a deck 60"""


def main(words: Sequence[str]) -> int:
    """Measure and report; returns the exit status."""
    options = parse(HeadroomOptions, "headroom", ABOUT, words)
    command = as_typed("headroom", words)
    if options.akit is not None or options.measures:
        return _worth(options, command)
    found = []
    with workers(options.workers) as executor:
        for name in options.scenario:
            one = headroom.headroom(name, options.seed, options.out, executor, options.quick)
            found.append(one)
            print(f"\n{headroom.summary(one)}\n")
    banner = SHORTENED if options.quick else ""
    path = headroom.write(found, options.out, command, banner, sampler_seed=options.seed)
    print(f"report: {path}")
    return 0


def _worth(options: HeadroomOptions, command: str) -> int:
    """What measures without truth are worth."""
    first = problem_of(options.measures[0]) if options.measures else problem_of("auv")
    name = options.filter or first.study.filter
    count = options.settings or (worth.SETTINGS if first.scoring.at_once is None else worth.FEW)
    count, draws = (8, 1) if options.quick else (count, worth.DRAWS)
    with workers(options.workers) as executor:
        if options.akit is not None:
            found = worth.on_tracks(first, options.akit, name, count, draws, options.seed, executor)
        else:
            found = worth.on_scenarios(
                options.measures, name, options.truth, count, draws, options.seed, executor,
                options.free,
            )  # fmt: skip
    print(f"\n{worth.summary(found)}\n")
    title = f"What a measure of {name} is worth that needs no truth"
    banner = SHORTENED if options.quick else ""
    path = worth.write(found, title, options.out, command, banner, design_seed=options.seed)
    print(f"report: {path}")
    return 0
