"""Playing a contest: recordings in chunks, every contender on each, and the chunks joined."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.agents.evaluation.contest import BEST_FIXED, OWN, Condition, Contender, Labels, Result
from navgym.agents.evaluation.league import League
from navgym.core.checks import Array
from navgym.tuning.comparison import Comparison, Entry, rows_of


@dataclass(eq=False)
class Tally:
    """What one contender did on some recordings.

    Args:
        entry: without its schedules, which weigh megabytes.
        quantities: (N,) each.
        flags: (N,) its own word that it diverged.
        seconds: (N, S) squared errors, where they are kept.
        fallbacks: (N,) shares, where there is a fallback.
        jitter: (N,) of the parameters, where they are chosen.
        spent: s of filtering.
        latency: µs per filter step of choosing.
    """

    entry: Entry
    quantities: dict[str, Array]
    flags: NDArray[np.bool_]
    seconds: Array | None
    fallbacks: Array | None
    jitter: Array | None
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


def parts(league: League, condition: Condition) -> list[tuple[int, int]]:
    """(first, count) of the chunks that a condition's recordings are run in."""
    total, chunk = league.count(condition), league.problem.contest.chunk
    starts = range(0, total, chunk)
    return [(first, min(chunk, total - first)) for first in starts]


def play(league: League, condition: Condition, first: int, count: int) -> Part:
    """Run every contender on some recordings of a condition; what a worker process does."""
    own = condition.kind == OWN
    cases = league.cases(condition, first, count)
    contenders = league.contenders(condition, cases)
    tallies = {c.entry.label: _run(league, condition, c, cases) for c in contenders}
    return Part(
        tallies, cases.samples, dict(cases.about), league.labels(cases) if own else [],
        _looks(league, contenders, cases) if own and first == 0 else {},
    )  # fmt: skip


def _run(league: League, condition: Condition, contender: Contender, cases: Any) -> Tally:
    if contender.states is None and not isinstance(contender.entry.parameters, list):
        league.run(contender, cases.take([0]))  # load its kernels before they are timed
    began = time.perf_counter()
    own = contender.states
    states, flags = league.run(contender, cases) if own is None else own()
    spent = time.perf_counter() - began
    scheduled = isinstance(contender.entry.parameters, list)
    return Tally(
        replace(contender.entry, parameters=[]) if scheduled else contender.entry,
        league.errors(cases, states, league.measured(condition)),
        np.asarray(flags, dtype=np.bool_),
        league.seconds(cases, states) if condition.kind == OWN else None,
        contender.fallbacks, contender.jitter, spent, contender.latency,
    )  # fmt: skip


def _looks(league: League, contenders: Sequence[Contender], cases: Any) -> dict[str, Any]:
    """What is looked at on a few recordings only: parameters in time, consistency."""
    chosen = {
        c.entry.label: _in_time(c.entry, len(league.times(cases)))
        for c in contenders
        if isinstance(c.entry.parameters, list) and c.entry.parameters
    }
    judged = {c.entry.label: league.consistency(c, cases) for c in contenders if c.states is None}
    return {"chosen": chosen, "time": league.times(cases), "consistency": judged}


def _in_time(entry: Entry, steps: int) -> dict[str, Array]:
    """The schedule of the first recording, its numbers once per filter step."""
    found = {}
    for name, values in entry.parameters[0].items():
        if not isinstance(values, str):
            each = np.atleast_1d(np.asarray(values, dtype=np.float64))
            found[name] = each[np.minimum(np.arange(steps) // (entry.interval or 1), len(each) - 1)]
    return found


def joined(league: League, condition: Condition, found: Sequence[Part]) -> Result:
    """All parts of a condition as one result."""
    about = dict(found[0].about)
    if "seeds" in about:
        about["seeds"] = [found[0].about["seeds"][0], found[-1].about["seeds"][1]]
    each = {label: [p.tallies[label] for p in found] for label in found[0].tallies}
    samples = sum(p.samples for p in found)
    shares, jitter = (_means(each, name) for name in ("fallbacks", "jitter"))
    return Result(
        condition,
        {name: _compared(league, name, each, samples, about) for name in league.measured(condition)},
        [label for p in found for label in p.labels],
        shares,
        jitter,
        **found[0].looks,
    )  # fmt: skip


def _means(each: Mapping[str, Sequence[Tally]], name: str) -> dict[str, float]:
    """Mean over recordings, per label that has any, of a field of its tallies."""
    found = {
        label: [v for t in tallies if (v := getattr(t, name)) is not None]
        for label, tallies in each.items()
    }
    return {label: float(np.concatenate(v).mean()) for label, v in found.items() if v}


def _compared(
    league: League,
    name: str,
    each: Mapping[str, Sequence[Tally]],
    samples: int,
    about: Mapping[str, Any],
) -> Comparison:
    """The comparison by one quantity."""
    problem = league.problem
    measure = problem.scoring.measures[name]
    errors = {k: np.concatenate([t.quantities[name] for t in ts]) for k, ts in each.items()}
    flags = {k: np.concatenate([t.flags for t in ts]) for k, ts in each.items()}
    spent = {k: 1e6 * sum(t.spent for t in ts) / samples + ts[0].latency for k, ts in each.items()}
    entries = [ts[0].entry for ts in each.values()]
    ends, yardstick = (problem.contest.plain, problem.contest.top), problem.contest.yardstick
    rows = rows_of(entries, errors, flags, BEST_FIXED, ends, measure, problem, yardstick)
    squared = {}
    if name == league.quantities[0]:
        kept = {k: [t.seconds for t in ts if t.seconds is not None] for k, ts in each.items()}
        squared = {k: np.concatenate(s) for k, s in kept.items() if s}
    return Comparison(rows, BEST_FIXED, about, errors, spent, squared, measure)
