"""Playing a contest: recordings in chunks, every contender on each, and the chunks joined."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.contest import BEST_FIXED, OWN, Condition, Contender, Labels, Result, World
from navgym._checks import Array
from tuning.comparison import Comparison, Entry, rows_of
from tuning.measures import find_measure


@dataclass(eq=False)
class Tally:
    """What one contender did on some recordings.

    Args:
        entry: without its schedules, which weigh megabytes.
        quantities: (N,) each.
        flags: (N,) its own word that it diverged.
        seconds: (N, S) squared errors, where they are kept.
        fallbacks: (N,) shares, where there is a fallback.
        spent: s of filtering.
        latency: µs per filter step of choosing.
    """

    entry: Entry
    quantities: dict[str, Array]
    flags: NDArray[np.bool_]
    seconds: Array | None
    fallbacks: Array | None
    spent: float
    latency: float


@dataclass(frozen=True, eq=False)
class Part:
    """A contest on some of a condition's recordings.

    Args:
        tallies: of each contender.
        samples: filter steps.
        about: provenance of the recordings.
        labels: their true regimes.
        looks: what is looked at on the first recordings only.
    """

    tallies: Mapping[str, Tally]
    samples: int
    about: Mapping[str, Any]
    labels: Sequence[Labels]
    looks: Mapping[str, Any]


def parts(world: World, condition: Condition) -> list[tuple[int, int]]:
    """(first, count) of the chunks that a condition's recordings are run in."""
    total = world.count(condition)
    starts = range(0, total, world.chunk)
    return [(first, min(world.chunk, total - first)) for first in starts]


def play(world: World, condition: Condition, first: int, count: int) -> Part:
    """Run every contender on some recordings of a condition; what a worker process does."""
    own = condition.kind == OWN
    cases = world.cases(condition, first, count)
    contenders = world.contenders(condition, cases)
    tallies = {c.entry.label: _run(world, condition, c, cases) for c in contenders}
    return Part(
        tallies, cases.samples, dict(cases.about), world.labels(cases) if own else [],
        _looks(world, contenders, cases) if own and first == 0 else {},
    )  # fmt: skip


def _run(world: World, condition: Condition, contender: Contender, cases: Any) -> Tally:
    if contender.states is None and not isinstance(contender.entry.parameters, list):
        world.run(contender, cases.take([0]))  # load its kernels before they are timed
    began = time.perf_counter()
    own = contender.states
    states, flags = world.run(contender, cases) if own is None else own()
    spent = time.perf_counter() - began
    scheduled = isinstance(contender.entry.parameters, list)
    return Tally(
        replace(contender.entry, parameters=[]) if scheduled else contender.entry,
        world.errors(cases, states, world.measured(condition)),
        np.asarray(flags, dtype=np.bool_),
        world.seconds(cases, states) if condition.kind == OWN else None,
        contender.fallbacks, spent, contender.latency,
    )  # fmt: skip


def _looks(world: World, contenders: Sequence[Contender], cases: Any) -> dict[str, Any]:
    """What is looked at on a few recordings only: parameters in time, consistency."""
    chosen = {
        c.entry.label: _in_time(c.entry, len(world.times(cases)))
        for c in contenders
        if isinstance(c.entry.parameters, list) and c.entry.parameters
    }
    judged = {c.entry.label: world.consistency(c, cases) for c in contenders if c.states is None}
    return {"chosen": chosen, "time": world.times(cases), "consistency": judged}


def _in_time(entry: Entry, steps: int) -> dict[str, Array]:
    """The schedule of the first recording, its numbers once per filter step."""
    found = {}
    for name, values in entry.parameters[0].items():
        if not isinstance(values, str):
            each = np.atleast_1d(np.asarray(values, dtype=np.float64))
            found[name] = each[np.minimum(np.arange(steps) // (entry.interval or 1), len(each) - 1)]
    return found


def joined(world: World, condition: Condition, found: Sequence[Part]) -> Result:
    """All parts of a condition as one result."""
    about = dict(found[0].about)
    if "seeds" in about:
        about["seeds"] = [found[0].about["seeds"][0], found[-1].about["seeds"][1]]
    each = {label: [p.tallies[label] for p in found] for label in found[0].tallies}
    samples = sum(p.samples for p in found)
    shares = {
        label: [t.fallbacks for t in ts if t.fallbacks is not None] for label, ts in each.items()
    }
    return Result(
        condition,
        {name: _compared(world, name, each, samples, about) for name in world.measured(condition)},
        [label for p in found for label in p.labels],
        {label: float(np.concatenate(s).mean()) for label, s in shares.items() if s},
        **found[0].looks,
    )  # fmt: skip


def _compared(
    world: World,
    name: str,
    each: Mapping[str, Sequence[Tally]],
    samples: int,
    about: Mapping[str, Any],
) -> Comparison:
    """The comparison by one quantity."""
    measure = find_measure(world.half, name)
    errors = {k: np.concatenate([t.quantities[name] for t in ts]) for k, ts in each.items()}
    flags = {k: np.concatenate([t.flags for t in ts]) for k, ts in each.items()}
    spent = {k: 1e6 * sum(t.spent for t in ts) / samples + ts[0].latency for k, ts in each.items()}
    entries = [ts[0].entry for ts in each.values()]
    ends = (world.plain, world.top)
    rows = rows_of(entries, errors, flags, BEST_FIXED, ends, measure, world.half, world.yardstick)
    squared = {}
    if name == world.quantities[0]:
        kept = {k: [t.seconds for t in ts if t.seconds is not None] for k, ts in each.items()}
        squared = {k: np.concatenate(s) for k, s in kept.items() if s}
    return Comparison(rows, BEST_FIXED, about, errors, spent, squared, measure)
