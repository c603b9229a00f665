"""Contests: conditions, how much is run, contenders, and what comes out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.agents.combiner.combiner import Combiner
from navgym.agents.evaluation.rollout import Chooser, problem_in, replay_filter, roll_out
from navgym.agents.evaluation.streamed import stream
from navgym.agents.mixture.mixture import Mixture
from navgym.agents.policies.policy import Policy
from navgym.core.checks import Array
from navgym.problem import Contest, Filter
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Comparison, Entry

OWN, SHIFT, OTHER, REAL = "own", "shift", "other", "real"
BEST_FIXED, DEFAULT, HAND_RULE = "best fixed", "default", "hand rule"
RANDOM, TRUE_REGIME = "random", "true-regime table"
FALLBACK = "{} + fallback"
AS_TRAINED = "as trained"  # an own condition again, on fewer recordings, with the fallback
LATENCY_CALLS = 300  # single observations that a policy is timed on


@dataclass(frozen=True)
class Condition:
    """What recordings are made under.

    Args:
        name: what tables call it.
        scenario: a name of `navgym.scenarios()`; "" for real tracks.
        overrides: fields of the scenario to change.
        kind: "own" (a policy was trained for it), "shift" (of an own scenario), "other" (a scenario
            that no policy here was trained on) or "real" (tracks).
        base: name of the own condition that it shifts; "" for the last two kinds.
        loss: of real tracks.
        variant: of real tracks, instead of a loss; see `navgym.problem.Tracks`.
    """

    name: str
    scenario: str = ""
    overrides: Mapping[str, Any] = field(default_factory=dict)
    kind: str = OWN
    base: str = ""
    loss: float = 0.0
    variant: str = ""


@dataclass(frozen=True)
class Extent:
    """How much is run.

    Args:
        quick: whether only a few conditions are run, shortened.
        runs: recordings per condition that a policy was trained for; the problem's own number by
            default.
        draws: noise and loss seeds per real track; by default 10, quickly 2.
    """

    quick: bool = False
    runs: int | None = None
    draws: int | None = None

    def own(self, contest: Contest) -> int:
        """Recordings per condition that a policy was trained for."""
        return self.runs or (contest.quick_own if self.quick else contest.own)

    def other(self, contest: Contest) -> int:
        """Recordings per other condition: as many, or fewer where the problem runs fewer there."""
        own, other = contest.own, contest.other
        if self.quick:
            own, other = contest.quick_own, contest.quick_other
        if self.runs is None:
            return other
        return self.runs if other >= own else min(self.runs, other)

    @property
    def of_track(self) -> int:
        """Recordings per real track."""
        return self.draws or (2 if self.quick else 10)


@dataclass(frozen=True)
class Contender:
    """Somebody who estimates.

    Args:
        entry: label, filter and parameters.
        runs: what runs, where it is no filter of the catalogue: one of one's own, a combiner
            or a mixture.
        states: estimates of its own, (N, T, n) and flags (N,), where it is no filter run.
        latency: µs per filter step that choosing takes on its own.
        fallbacks: (N,) share of each recording that a fallback was in force.
        jitter: (N,) mean |Δ| of its parameters per decision, each on its own scale; see `jitter`.
    """

    entry: Entry
    runs: Filter | Combiner | Mixture | None = None
    states: Callable[[], tuple[Array, NDArray[Any]]] | None = None
    latency: float = 0.0
    fallbacks: Array | None = None
    jitter: Array | None = None


@dataclass(frozen=True, eq=False)
class Labels:
    """The true regime of a recording, once per second: what `navgym.tuning.report.plots` shades."""

    regime: NDArray[np.int64]
    meta: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Result:
    """What a condition showed.

    Args:
        condition: which.
        comparisons: per quantity, the first is what counts; that one's `squared` holds errors over
            time, once per second, where they were asked for.
        labels: the true regimes of those recordings, where they have any.
        fallbacks: per label, share of the time that its fallback was in force.
        jitter: per label that chooses parameters, mean |Δ| of them per decision; see `jitter`.
        chosen: per label, parameters over time (values per name) on the first recording.
        time: (K,) s of the filter steps of the first recording.
        consistency: per label, NIS and NEES; see `League.consistency`.
    """

    condition: Condition
    comparisons: Mapping[str, Comparison]
    labels: Sequence[Labels] = ()
    fallbacks: Mapping[str, float] = field(default_factory=dict)
    jitter: Mapping[str, float] = field(default_factory=dict)
    chosen: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)
    time: Array | None = None
    consistency: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def main(self) -> Comparison:
        """The comparison that counts."""
        return next(iter(self.comparisons.values()))


def short(scenario: str) -> str:
    """A scenario's name without its problem."""
    return scenario.partition("/")[2]


def choosing(label: str, chooser: Chooser, cases: Cases) -> Contender:
    """A contender whose parameters `chooser` sets on the recordings of `cases`."""
    found, runs = roll_out(chooser, cases.recordings), replay_filter(chooser)
    return Contender(
        Entry(label, runs.name, found.schedules, interval=found.interval),
        runs=runs,
        latency=latency(chooser) / chooser.settings["decision_interval"],
        jitter=np.array([jitter(each, chooser, found.interval) for each in found.schedules]),
    )


def jitter(schedule: Mapping[str, Any], chooser: Chooser, interval: int) -> float:
    """How restless a schedule is: mean |Δ| per decision of what the chooser sets, on its own scale.

    The scale is mostly a logarithm: .1 is a change by a tenth, decision after decision.
    """
    space = problem_in(chooser.environment).environment.settings.SPACE
    every = max(1, chooser.settings["decision_interval"] // interval)
    ways = []
    for name in chooser.settings["action_parameters"]:
        values = np.atleast_1d(schedule[name])[::every]
        warped = [space[name].warp(float(v)) for v in values]
        ways.append(np.abs(np.diff(warped)).mean() if len(warped) > 1 else 0.0)
    return float(np.mean(ways))


def deployed(label: str, policy: Policy, cases: Cases) -> Contender:
    """A policy as it is deployed: sample by sample, with its fallback."""
    shares = np.zeros(len(cases))

    def states() -> tuple[Array, NDArray[Any]]:
        found, shares[:] = stream(policy, cases.recordings, cases.batch.steps)
        return found, np.zeros(len(cases), dtype=np.bool_)  # it starts again and goes on

    entry = Entry(FALLBACK.format(label), policy.manifest.filter, [])
    return Contender(entry, states=states, fallbacks=shares)


def latency(chooser: Chooser) -> float:
    """µs of one decision on a single observation, the median of many."""
    obs = np.zeros((1, chooser.width), dtype=np.float32)
    chooser.begin(1)
    spent = []
    for _ in range(LATENCY_CALLS):
        began = time.perf_counter()
        chooser(obs)
        spent.append(time.perf_counter() - began)
    return 1e6 * float(np.median(spent))
