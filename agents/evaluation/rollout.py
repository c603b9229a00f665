"""What a chooser of parameters does on given recordings: a schedule that any filter run can replay.

A policy or a rule is rolled out on the environment's own engine, one lane per recording. The parameters
in force at each decision make a schedule, and the problem's `run` with that schedule gives the engine's
states to the last bit. So everything that compares filters compares policies too.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array, one_of
from navgym.envs.base import LaneEngine
from navgym.envs.columns import INFORMATION, TERMINATED, TRUNCATED
from navgym.problem import Filter, Problem, environments, problem_of


def problem_in(environment: str) -> Problem:
    """The problem that an environment (an id) plays; ValueError with the nearest id for none."""
    return problem_of(one_of("environment", environment, environments()))


class Chooser(Protocol):
    """Observation in, parameters out."""

    @property
    def environment(self) -> str:
        """Id of the environment whose observations it reads."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """Arguments of that environment; see `LaneSettings.SEEN`."""

    @property
    def width(self) -> int:
        """Number of observations that it reads."""

    def begin(self, lanes: int) -> None:
        """Forget what was seen: so many recordings start now."""

    def __call__(self, observation: NDArray[Any]) -> Array:
        """Actions (N, k), each in -1..1, for observations (N, n)."""


@dataclass(frozen=True)
class Learnt:
    """A trained policy as a chooser.

    Args:
        policy: an `navgym.agents.policies.policy.Policy`.
    """

    policy: Any

    @property
    def environment(self) -> str:
        """What it was trained in."""
        return str(self.policy.manifest.environment)

    @property
    def settings(self) -> Mapping[str, Any]:
        """How that was set up."""
        found: Mapping[str, Any] = self.policy.manifest.settings
        return found

    @property
    def width(self) -> int:
        """What its first layer takes."""
        return len(self.policy.low)

    def begin(self, lanes: int) -> None:
        """A policy remembers nothing."""

    def __call__(self, observation: NDArray[Any]) -> Array:
        """The policy's actions."""
        found: Array = self.policy(observation)
        return found


@dataclass(frozen=True, eq=False)
class Rollout:
    """A chooser's parameters on each recording.

    Args:
        schedules: per recording, every parameter of the filter: an array with one number per decision
            interval, or one number where it never changes.
        interval: filter steps per number.
        microseconds: wall time of the chooser per decision and recording, in a batch.
        terminated: (N,) whether the engine ended the recording as diverged.
    """

    schedules: list[dict[str, Any]]
    interval: int
    microseconds: float
    terminated: NDArray[np.bool_]


def engine_for(chooser: Chooser, recordings: Sequence[Any]) -> LaneEngine:
    """The engine that `chooser` knows, with a lane for each of `recordings`."""
    own = problem_in(chooser.environment).environment
    usual = own.settings.__dataclass_fields__["scenario"].default  # not drawn from
    chosen = {n: chooser.settings[n] for n in own.settings.SEEN if n in chooser.settings}
    given = own.settings(usual, recordings=tuple(recordings), reward=own.settings.BLIND, **chosen)
    engine: LaneEngine = own.engine(given, len(recordings))
    return engine


def roll_out(chooser: Chooser, recordings: Sequence[Any]) -> Rollout:
    """Let `chooser` set the parameters on every recording.

    Args:
        chooser: a policy or a baseline.
        recordings: of the kind that its environment plays, of one model size.

    Raises:
        ValueError: no recordings, or ones that the environment cannot play.
    """
    engine = engine_for(chooser, recordings)
    obs = np.stack([engine.restart(i, recording=i) for i in range(engine.count)])
    start = engine.stations["k"].copy()
    chooser.begin(engine.count)
    taken: list[Array] = []
    spent = 0.0
    terminated = np.zeros(engine.count, dtype=np.bool_)
    while (active := engine.stations["active"] > 0).any():
        began = time.perf_counter()
        actions = chooser(obs)
        spent += time.perf_counter() - began
        out = engine.step(np.where(active[:, None], actions, 0.0), obs)
        rows = out[:, INFORMATION + len(engine.INFO_NAMES) :]
        taken.append(np.where(active[:, None], rows, np.nan))
        terminated |= out[:, TERMINATED] > 0.0
        over = (out[:, TERMINATED] > 0.0) | (out[:, TRUNCATED] > 0.0)
        engine.stations["active"][over] = 0
    each = 1e6 * spent / (len(taken) * engine.count)
    return Rollout(*_schedules(engine, np.stack(taken, axis=1), start), each, terminated)


def _schedules(
    engine: LaneEngine, rows: Array, start: NDArray[np.int64]
) -> tuple[list[dict[str, Any]], int]:
    """Rows (N, D, P) as schedules from the first filter step on, and filter steps per entry.

    Until `start` (N,) the reference ran. Where that is no whole number of decisions, entries are
    single filter steps.
    """
    interval = engine.settings.decision_interval
    if (start % interval).any():
        rows, interval = np.repeat(rows, interval, axis=1), 1
    reference = engine.space.array(engine.reference)
    found = []
    for i, first in enumerate(start // interval):
        own = rows[i][np.isfinite(rows[i]).all(axis=1)]
        length = -(-int(engine.stations["length"][i]) // interval)
        whole = np.concatenate([np.repeat(reference, int(first), axis=0), own])[:length]
        columns = zip(engine.space.names, whole.T, strict=True)
        found.append({n: c[0].item() if (c == c[0]).all() else c.copy() for n, c in columns})
    return found, interval


def replay_filter(chooser: Chooser) -> Filter:
    """The filter whose run with a roll-out's schedules gives the engine's states."""
    return problem_in(chooser.environment).environment.replayed(chooser.settings)
