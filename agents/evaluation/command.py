"""`navgym evaluate`: policies beside every simpler way, on fresh recordings."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from navgym.agents.evaluation.contest import Extent
from navgym.agents.evaluation.verdicts import (
    Bench,
    evaluate,
    failures,
    leagues,
    load,
    load_combiners,
)
from navgym.agents.mixture.mixture import KIND as MIXTURE
from navgym.agents.policies.loading import Agent, kind_of, load_agent
from navgym.agents.policies.policy import Policy, located
from navgym.agents.training.logs import Logs
from navgym.command import as_typed
from navgym.core.atomic import writable_folder
from navgym.core.checks import positive_int
from navgym.core.data import absent, base_folder
from navgym.core.machine import cores
from navgym.tuned import read_tuned
from navgym.tuning.commands.parse import parse

ABOUT = """Is a policy better than the simpler ways of choosing parameters, and where?

    navgym evaluate                             the policies that navgym ships, in 10 to 25 minutes
    navgym evaluate runs/mine/policy.npz        one's own; name several to compare them
    navgym evaluate runs/mine/policy.npz auv --runs 200
    navgym evaluate auv --scenario auv/switch-B
    navgym evaluate --quick                     a few recordings and conditions, for a first look
    navgym evaluate runs/mix/mixture runs/mine/policy.npz --log other.csv --read position_noise 1.5

Everybody runs on the same fresh recordings (test seeds): fixed parameters, rules, filters that need no
parameters, bounds that know the truth, and the policies, alone and with their fallback. First the
scenarios that a policy was trained on, as designed (also where its training drew conditions anew), then shifted ones, scenarios that it was not trained on,
and real tracks, where the data are at hand. Prints the tables; writes report.html (open it
in a browser) and results.json to --out. The same command gives the same numbers, times excepted.

With --log everybody runs on your logs instead, policies and mixtures beside the parameters that each starts
from and beside filters that need none: one-step error of the fixes, and, where the logs hold the truth, the
error against it. A gain has an interval over logs where there are five or more. Name logs that nothing was
tuned or trained on. Writes results.json.

Exit status: 0 if every policy is better than the best fixed parameters in the conditions that it was
trained for; 1 if one is not (an interval that touches 0 counts as not better); 2 for wrong input.
"""


@dataclass(frozen=True)
class Options:
    """What was asked for."""

    policies: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """files of policies or mixtures (.npz), or auv and deck for the policies that navgym ships; both of these
    if none is named. On scenarios a mixture runs beside the policies"""
    log: tuple[Path, ...] = ()
    """judge on these real logs instead"""
    read: tuple[str, ...] = ()
    """what the logs' reader is told: pairs of an option and its value, before them, if you like, a mapping
    file"""
    format: str | None = None
    """of the logs; by default what they look like"""
    draws: int = 10
    """of noise and losses per log and rate of losses, where the logs' format draws them"""
    reference: Path | None = None
    """a tuned.toml to put the policies around on logs, instead of the parameters that they were trained with"""
    tuned: tuple[Path, ...] = ()
    """further tuned parameters to run beside on logs: files of navgym tune"""
    scenario: tuple[str, ...] = ()
    """judge on these instead of the scenarios that the policies were trained on"""
    combiner: tuple[Path, ...] = ()
    """files of learned combiners, or of mixtures, to run beside; the combiner that navgym ships if none is
    named"""
    runs: int | None = None
    """recordings per condition that a policy was trained for; None: hundreds, as each problem says"""
    workers: int | None = None
    """processes; None: one per core, at most 8, and one with --quick. The numbers do not depend on it, but
    times are those of a busy machine then"""
    data: Path | None = None
    """folder of real tracks, or with a folder per set of them, such as akit; None: that in $NAVGYM_DATA"""
    out: Path = Path("runs/evaluate")
    """folder for report.html and results.json"""
    fallback: bool = True
    """run each policy with its fallback too"""
    quick: bool = False
    """a few recordings and conditions: for a first look and for CI"""

    def check(self) -> None:
        """Raise ValueError for what cannot be."""
        if self.runs is not None:
            positive_int("runs", self.runs, least=2)
        positive_int("workers", self.processes)
        positive_int("draws", self.draws)
        if (self.read or self.format or self.tuned or self.reference) and not self.log:
            raise ValueError(
                "--read, --format, --tuned and --reference are for logs: name them with --log."
            )
        if self.log and self.scenario:
            raise ValueError("give --log or --scenario, not both.")
        if self.data is not None and not self.data.is_dir():
            raise ValueError(f"--data must be a folder of real tracks: {self.data} is none.")
        writable_folder("--out", self.out)

    @property
    def extent(self) -> Extent:
        """How much is run."""
        return Extent(self.quick, self.runs)

    @property
    def processes(self) -> int:
        """How many processes run it."""
        usual = 1 if self.quick else min(cores(), 8)
        return usual if self.workers is None else self.workers

    @property
    def tracks(self) -> Path | None:
        """Folder that real tracks are looked for in."""
        return base_folder() if self.data is None else self.data


def main(words: Sequence[str]) -> int:
    """Evaluate; returns the exit status."""
    options = parse(Options, "evaluate", ABOUT, words)
    if options.log:
        return on_logs(options, as_typed("evaluate", words))
    bad = failures(run(options, as_typed("evaluate", words)))
    for sentence in bad:
        print(f"NOT BETTER: {sentence}", file=sys.stderr)
    return 1 if bad else 0


def on_logs(options: Options, command: str) -> int:
    """Evaluate on logs, print the ladder, write results.json; returns the exit status."""
    from navgym.agents.evaluation import on_logs as ladder
    from navgym.tuning.report import page as report

    options.check()
    logs = Logs(options.log, options.read, options.format)
    paths = [located(p) for p in options.policies] or ladder.shipped_for(logs.problem)
    agents = {
        k: _around(load_agent(p), options)
        for k, p in zip(ladder.labelled(paths), paths, strict=True)
    }
    combiners = load_combiners([located(p) for p in options.combiner])
    tuned = {f"{p.parent.name}/{p.name}": read_tuned(p) for p in options.tuned}
    found = ladder.contest(agents, logs, options.draws, combiners, options.fallback, tuned)
    print(ladder.table(found))
    basis = report.provenance(command, seeds={"noise and losses": "test"})
    results = ladder.as_json(found) | {"provenance": basis}
    path = report.write_json(options.out / "results.json", results)
    print(f"\nresults: {path}")
    bad = ladder.failures(found)
    for sentence in bad:
        print(f"NOT BETTER: {sentence}", file=sys.stderr)
    return 1 if bad else 0


def _around(agent: Agent, options: Options) -> Agent:
    """A policy around the parameters that `--reference` names; a mixture keeps its own."""
    if options.reference is None or not isinstance(agent, Policy):
        return agent
    return agent.with_reference(options.reference)


def run(options: Options, command: str) -> list[Bench]:
    """Evaluate, print the tables, write the page and the results, which record the command."""
    from navgym.agents.evaluation import report as evaluation_report
    from navgym.agents.evaluation import tables as evaluation_tables
    from navgym.tuning.report import page as report

    began = time.perf_counter()
    options.check()
    named = [located(p) for p in options.policies]
    mixtures = [p for p in named if kind_of(p) == MIXTURE]
    found = leagues(
        load([p for p in named if p not in mixtures]), options.extent, options.scenario, options.tracks,
        options.fallback, load_combiners([*(located(p) for p in options.combiner), *mixtures]),
    )  # fmt: skip
    tracks = {each.problem.tracks.title: each.folder for each in found if each.problem.tracks}
    missing = [title for title, folder in tracks.items() if folder is None]
    if missing:
        print(absent(*missing))
    benches = evaluate(found, options.processes, told=_show)
    basis = report.provenance(
        command,
        tracks=", ".join(title for title in tracks if title not in missing) or "none",
        seeds={"all figures": "test"},
        load=f"{os.getloadavg()[0]:.1f}, {options.processes} processes",
    )
    results = evaluation_tables.as_json(benches, basis)
    report.write_json(options.out / "results.json", results)
    path = report.write_page(options.out / "report.html", evaluation_report.page(benches, basis))
    print(f"report: {path}\n{time.perf_counter() - began:.0f} s in all")
    return benches


def _show(bench: Bench) -> None:
    from navgym.agents.evaluation import tables as evaluation_tables

    print(f"\n{evaluation_tables.as_text([bench])}\n", flush=True)
