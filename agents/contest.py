"""Contests: conditions, contenders, what comes out, and what each half of navgym says for itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.combiner import Combiner
from agents.policy import Policy
from agents.rollout import ENGINES, Chooser, Learnt, replay_filter, roll_out
from agents.streamed import stream
from navgym._checks import Array
from navgym.filters.catalogue import Filter
from tuning.comparison import Comparison, Entry

OWN, SHIFT, OTHER, REAL = "own", "shift", "other", "real"
BEST_FIXED, DEFAULT, HAND_RULE = "best fixed", "default", "hand rule"
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
    """

    name: str
    scenario: str = ""
    overrides: Mapping[str, Any] = field(default_factory=dict)
    kind: str = OWN
    base: str = ""
    loss: float = 0.0


@dataclass(frozen=True)
class Size:
    """How much is run.

    Args:
        auv: recordings per AUV condition.
        deck: per deck condition that a policy was trained for.
        deck_other: per other deck condition, where policies run with their fallback too: a
            recording then takes seconds.
        draws: noise and loss seeds per real track.
        quick: whether only a few conditions are run, shortened.
    """

    auv: int = 300
    deck: int = 200
    deck_other: int = 30
    draws: int = 10
    quick: bool = False


@dataclass(frozen=True)
class Contender:
    """Somebody who estimates.

    Args:
        entry: label, filter and parameters.
        runs: what runs, where it is no filter of the catalogue: one of one's own, or a combiner.
        states: estimates of its own, (N, T, n) and flags (N,), where it is no filter run.
        latency: µs per filter step that choosing takes on its own.
        fallbacks: (N,) share of each recording that a fallback was in force.
    """

    entry: Entry
    runs: Filter | Combiner | None = None
    states: Callable[[], tuple[Array, NDArray[Any]]] | None = None
    latency: float = 0.0
    fallbacks: Array | None = None


@dataclass(frozen=True, eq=False)
class Labels:
    """The true regime of a recording, once per second: what `tuning.plots` shades."""

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
        chosen: per label, parameters over time (values per name) on the first recording.
        time: (K,) s of the filter steps of the first recording.
        consistency: per label, NIS and NEES; see `World.consistency`.
    """

    condition: Condition
    comparisons: Mapping[str, Comparison]
    labels: Sequence[Labels] = ()
    fallbacks: Mapping[str, float] = field(default_factory=dict)
    chosen: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)
    time: Array | None = None
    consistency: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def main(self) -> Comparison:
        """The comparison that counts."""
        return next(iter(self.comparisons.values()))


class World:
    """One half of navgym as a place for contests.

    Args:
        policies: those of its environment, by label.
        own: conditions that policies are judged in: those that they were trained for.
        answers: names of the own conditions that each policy answers for; by default all.
        size: how much is run.
        fallback: whether policies also run with their fallback.
        folder: of real tracks; None leaves them out.
        combiners: learned combiners of the bank, by label.
    """

    environment: str
    half: str
    quantities: tuple[str, ...]  # the first is what counts
    everywhere: tuple[str, ...]  # those that are computed in conditions that are nobody's own too
    plain: str  # label that scores 0
    top: str  # label that scores 1
    yardstick: str  # label that divergence is judged by
    chunk: int  # recordings at a time

    def __init__(
        self,
        policies: Mapping[str, Policy],
        own: Sequence[Condition],
        size: Size,
        fallback: bool = True,
        folder: Path | None = None,
        combiners: Mapping[str, Combiner] = MappingProxyType({}),
        answers: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        everything = [c.name for c in own]
        self.answers = dict.fromkeys(policies, everything) if answers is None else dict(answers)
        self.policies, self.own, self.size = dict(policies), tuple(own), size
        self.fallback, self.folder, self.combiners = fallback, folder, dict(combiners)

    # ---- what each half says for itself

    def conditions(self) -> list[Condition]:
        """Every condition, the own ones first."""
        raise NotImplementedError

    def count(self, condition: Condition) -> int:
        """Recordings of a condition."""
        raise NotImplementedError

    def cases(self, condition: Condition, start: int, count: int) -> Any:
        """Recordings `start` to `start + count` of a condition."""
        raise NotImplementedError

    def contenders(self, condition: Condition, cases: Any) -> list[Contender]:
        """Everybody who runs, in the order of the ladder."""
        raise NotImplementedError

    def run(self, contender: Contender, cases: Any) -> tuple[Array, NDArray[Any]]:
        """States (N, T, n) and flags (N,) of a contender that is a filter run."""
        raise NotImplementedError

    def errors(self, cases: Any, states: Array, names: Sequence[str]) -> dict[str, Array]:
        """Quantities per run, (N,), by name."""
        raise NotImplementedError

    def seconds(self, cases: Any, states: Array) -> Array:
        """Squared errors of the first quantity, once per second, (N, S)."""
        raise NotImplementedError

    def labels(self, cases: Any) -> list[Labels]:
        """The true regimes, once per second; nothing where there is one or none."""
        raise NotImplementedError

    def times(self, cases: Any) -> Array:
        """(K,) s of the filter steps of the first recording."""
        raise NotImplementedError

    def consistency(self, contender: Contender, cases: Any) -> dict[str, float]:
        """NIS and NEES per degree of freedom, and how often NIS lies in its 95 % band."""
        raise NotImplementedError

    # ---- what both share

    def measured(self, condition: Condition) -> tuple[str, ...]:
        """Quantities that are computed in a condition."""
        return self.quantities if condition.kind == OWN else self.everywhere

    def fixed_label(self, policy: str) -> str:
        """What the fixed parameters are called that a policy starts from; some share theirs."""
        first = next(k for k in self.policies if self._row(k) == self._row(policy))
        return f"fixed, as for {first}"

    def _row(self, policy: str) -> tuple[float, ...]:
        space = ENGINES[self.environment][1].SPACE
        return tuple(space.array(self.policies[policy].manifest.reference)[0])

    def references(self, here: Mapping[str, Any] | None) -> dict[str, dict[str, Any]]:
        """Fixed parameters that policies start from, by label, but for those that `here` holds."""
        row = None if here is None else tuple(ENGINES[self.environment][1].SPACE.array(here)[0])
        return {
            self.fixed_label(label): dict(policy.manifest.reference)
            for label, policy in self.policies.items()
            if self._row(label) != row
        }

    def streams(self, condition: Condition) -> bool:  # noqa: ARG002
        """Whether policies run with their fallback in a condition."""
        return self.fallback

    def learners(self, condition: Condition, cases: Any) -> list[Contender]:
        """The policies, each followed by itself with its fallback."""
        found = []
        for label, policy in self.policies.items():
            found.append(choosing(label, Learnt(policy), cases))
            if self.streams(condition):
                found.append(_deployed(label, policy, cases))
        return found


def short(scenario: str) -> str:
    """A scenario's name without its half."""
    return scenario.partition("/")[2]


def choosing(label: str, chooser: Chooser, cases: Any) -> Contender:
    """A contender whose parameters `chooser` sets on the recordings of `cases`."""
    found, runs = roll_out(chooser, cases.recordings), replay_filter(chooser)
    name = runs if isinstance(runs, str) else runs.name
    return Contender(
        Entry(label, name, found.schedules, interval=found.interval),
        runs=None if isinstance(runs, str) else runs,
        latency=latency(chooser) / chooser.settings["decision_interval"],
    )


def _deployed(label: str, policy: Policy, cases: Any) -> Contender:
    """A policy as it is deployed: sample by sample, with its fallback."""
    shares = np.zeros(len(cases))

    def states() -> tuple[Array, NDArray[Any]]:
        found, shares[:] = stream(policy, cases.recordings, int(cases.batch.lengths.max()))
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
