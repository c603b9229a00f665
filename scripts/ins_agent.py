"""What an agent wins over the best fixed hold where a Doppler log is lost, and what is left to be won.

    python scripts/ins_agent.py runs/a/policy.npz runs/b/policy.npz   policies in the whole ladder
    python scripts/ins_agent.py                                       the ladder without policies
    python scripts/ins_agent.py --only outage burst --runs 8          a look at some of the tables

Missions are of test seeds. Tracks are A-KIT's with recorded inertial data ($NAVGYM_DATA), their log lost
once for 60 or 120 s, as recorded and with MEMS errors added; "best fixed" is tuned there on the other three
tracks and on training seeds. Gains are paired, with 95 % intervals: recordings are resampled, and of tracks
whole tracks, with all their draws.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from numpy.typing import NDArray

from navgym.agents.evaluation.contest import BEST_FIXED, HAND_RULE, REAL, Condition, Extent, Result
from navgym.agents.evaluation.league import League
from navgym.agents.evaluation.play import joined, parts, play
from navgym.agents.evaluation.verdicts import load
from navgym.core.checks import Array
from navgym.core.data import data_folder
from navgym.ins.problem import PROBLEM

OWN = {"outage": "ins/outage", "burst": "ins/burst"}
RESAMPLES = 4000


@dataclass(frozen=True)
class Options:
    """What was asked for."""

    policies: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """files of policies (.npz) for navgym/INSDropout-v0"""
    only: tuple[str, ...] = ()
    """tables by the beginning of their names: outage, burst, tracks; all of them by default"""
    runs: int = 60
    """missions per scenario"""
    draws: int = 10
    """outages and errors per track"""


def main() -> None:
    """Print the tables."""
    options = tyro.cli(Options, description=__doc__)
    policies = load(options.policies) if options.policies else {}
    own = [Condition(name, scenario) for name, scenario in OWN.items()]
    league = League(
        PROBLEM.environment.id, policies, own, Extent(runs=options.runs, draws=options.draws),
        fallback=False, folder=data_folder("akit"),
    )  # fmt: skip
    for condition in conditions(league, options.only):
        began = time.perf_counter()
        found = [play(league, condition, *part) for part in parts(league, condition)]
        print(table(league, joined(league, condition, found)), flush=True)
        print(f"{time.perf_counter() - began:.0f} s\n", flush=True)


def conditions(league: League, only: Sequence[str]) -> list[Condition]:
    """Outages, bursts, and tracks that fall silent."""
    every = [c for c in league.conditions() if c in league.own or c.variant]
    return [c for c in every if not only or c.name.startswith(tuple(only))]


def table(league: League, result: Result) -> str:
    """Everybody's errors and gains on one kind of recordings."""
    errors = {q: result.comparisons[q].errors for q in ("position", "velocity")}
    groups = groups_of(league, result.condition, len(errors["position"][BEST_FIXED]))
    lines = [
        f"{result.condition.name}: {len(groups)} recordings, {len(np.unique(groups))} resampled",
        f"{'':22}{'position':>9}{'velocity':>10}  {'gain over ' + BEST_FIXED:28}gain over {HAND_RULE}",
    ]
    for label, own in errors["position"].items():
        gains = [
            gain(own, errors["position"][other], groups) if label != other else ""
            for other in (BEST_FIXED, HAND_RULE)
        ]
        speed = errors["velocity"][label].mean()
        lines.append(f"{label:22}{own.mean():9.3f}{speed:10.4f}  {gains[0]:28}{gains[1]}")
    return "\n".join(lines)


def groups_of(league: League, condition: Condition, count: int) -> NDArray[np.int64]:
    """What is resampled together: (count,) numbers of tracks, or of recordings."""
    if condition.kind != REAL:
        return np.arange(count)
    return np.arange(count) // league.extent.of_track


def gain(own: Array, other: Array, groups: NDArray[np.int64]) -> str:
    """1 − mean / mean of the other, %, with its interval from resampled groups."""
    if not (np.isfinite(own).all() and np.isfinite(other).all()):
        return "diverges"
    count = groups.max() + 1
    sums = np.stack([np.bincount(groups, each, count) for each in (own, other)])
    drawn = np.random.default_rng(0).integers(0, count, (RESAMPLES, count))
    a, b = sums[:, drawn].sum(axis=-1)
    low, high = np.quantile(1.0 - a / b, (0.025, 0.975))
    return f"{1 - own.mean() / other.mean():+7.1%} ({low:+.1%} to {high:+.1%})"


if __name__ == "__main__":
    main()
