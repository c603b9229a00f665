"""`navgym headroom`: best fixed parameters against parameters by true regime."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from navgym.command import as_typed
from navgym.tuning import headroom
from navgym.tuning.commands.parse import parse
from navgym.tuning.study.executors import workers

USUAL = ("auv/switch-D", "auv/switch-B", "auv/switch-A", "deck/switch-60")
ABOUT = """What could be won by steering a filter: best fixed parameters against parameters by true regime.

    navgym headroom                         auv/switch-D, -B, -A and deck/switch-60
    navgym headroom auv/switch-D            one scenario, about two minutes on two cores
    navgym headroom deck/switch-60
    navgym headroom --quick                 shortened, only to see it run

For each scenario two studies: the best parameters that never change, and the best table of parameters
by true regime, which is truth and so bounds what any schedule or agent can win. Both are tuned on
training seeds, chosen on validation seeds and compared on test seeds, beside filters that need no
tuning and the oracle. The studies under --out resume an interrupted run. Writes headroom.html and
headroom.json.
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


def main(words: Sequence[str]) -> int:
    """Measure and report; returns the exit status."""
    options = parse(HeadroomOptions, "headroom", ABOUT, words)
    found = []
    with workers(options.workers) as executor:
        for name in options.scenario:
            one = headroom.headroom(name, options.seed, options.out, executor, options.quick)
            found.append(one)
            print(f"\n{headroom.summary(one)}\n")
    command = as_typed("headroom", words)
    path = headroom.write(found, options.out, command, sampler_seed=options.seed)
    print(f"report: {path}")
    return 0
