"""`navgym benchmark`: ratios to well-known things, measured in the same run."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from navgym.command import as_typed
from navgym.core.atomic import writable_folder
from navgym.core.checks import positive_int
from navgym.tuning.benchmarks.timing import Row, as_markdown, machine
from navgym.tuning.commands.parse import parse
from navgym.tuning.report.page import write_text

ABOUT = """How fast navgym is, as ratios to well-known things measured in the same run.

    navgym benchmark auv                print the table
    navgym benchmark deck
    navgym benchmark ins                against numpy, pyins and navlib
    navgym benchmark agents             learning, acting, live filters (needs the agents extra)
    navgym benchmark studies            what Optuna and its storage cost
    navgym benchmark programs           tuning a program: what it costs, and whether its intervals hold
    navgym benchmark scaling            time and memory as work grows, with plots beside --write's file
    navgym benchmark deck --write benchmarks-deck.md

Machines are noisy, so each pair is run in turns, and the median of the ratios is what counts. The
peers filterpy, fastrvm, dynamax, pyins, navlib and kalman-py are optional: pip install filterpy fastrvm
dynamax python-ins navlib kalman-py.
"""
TITLES = {
    "auv": "the AUV",
    "deck": "the deck",
    "ins": "the INS",
    "agents": "agents",
    "studies": "studies",
    "programs": "programs that are tuned",
}
IMAGES = "images"


@dataclass(frozen=True)
class BenchmarkOptions:
    """What was asked for."""

    part: Annotated[
        Literal["auv", "deck", "ins", "agents", "studies", "programs", "scaling"],
        tyro.conf.Positional,
    ]
    """what to measure"""
    rounds: int = 7
    """turns per pair"""
    write: Path | None = None
    """also write the table to this Markdown file"""
    quick: bool = False
    """scaling only: the least of each kind, in seconds"""


def main(words: Sequence[str]) -> int:
    """Measure; returns the exit status."""
    options = parse(BenchmarkOptions, "benchmark", ABOUT, words)
    rounds, command = positive_int("rounds", options.rounds), as_typed("benchmark", words)
    if options.part == "scaling":
        return _scaling(rounds, command, options)
    if options.quick:
        raise ValueError("--quick is of scaling only: leave it out, or ask for fewer --rounds.")
    text = as_markdown(TITLES[options.part], command, _part(options.part)(rounds))
    print(text)
    if options.write is not None:
        write_text(options.write, text)
    return 0


def _scaling(rounds: int, command: str, options: BenchmarkOptions) -> int:
    """Measure growth; its page is written with pictures in `images` beside it."""
    from navgym.tuning.benchmarks import growth_page
    from navgym.tuning.benchmarks.scaling import scaling

    state, load = machine(), os.getloadavg()[0]  # its own processes are no load
    found = scaling(rounds, options.quick)
    text = growth_page.page(found, command, state, load, IMAGES)
    print(text)
    if options.write is not None:
        folder = writable_folder("the folder of pictures", options.write.parent / IMAGES)
        for name, svg in growth_page.pictures(found).items():
            write_text(folder / name, svg)
        write_text(options.write, text)
    return 0


def _part(name: str) -> Callable[[int], list[Row]]:
    """What measures `name`; only its own packages are imported."""
    if name == "agents":
        from navgym.agents.benchmarks import agents

        return agents
    if name == "studies":
        from navgym.tuning.benchmarks.studies import studies

        return studies
    if name == "programs":
        from navgym.tuning.benchmarks.programs import programs

        return programs
    from navgym.tuning.benchmarks import auv, deck, ins

    return {"auv": auv.auv, "deck": deck.deck, "ins": ins.ins}[name]
