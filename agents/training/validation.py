"""How good a policy is on validation recordings: paired gain over best fixed parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from navgym.agents.evaluation.rollout import problem_in
from navgym.agents.training.configuration import Configuration
from navgym.agents.training.randomisation import drawn
from navgym.agents.training.references import starts_of
from navgym.core.checks import Array
from navgym.core.seeds import seeds
from navgym.envs.base import LaneEngine
from navgym.envs.columns import INFORMATION, TERMINATED, TRUNCATED
from navgym.simulation import find_scenario, simulate_many

LOST = 10.0  # errors of the reference that a diverged lane counts as
RANDOMISED = "randomised"

Actor = Callable[[NDArray[np.float32]], NDArray[np.float32]]


@dataclass(frozen=True)
class Played:
    """What lanes did on one recording each.

    Args:
        errors: per quantity, RMS over each recording (N,); infinite where the lane diverged.
        reference: the same of the engine's reference filter.
        low: (n,) smallest observations met.
        high: (n,) largest ones.
    """

    errors: Mapping[str, Array]
    reference: Mapping[str, Array]
    low: Array
    high: Array


@dataclass(frozen=True)
class Scores:
    """What validation found.

    Args:
        score: what training selects by; larger is better, 0 is best fixed parameters.
        gains: per set of recordings and quantity, 1 − error / error of best fixed parameters.
        half: half the 95 % interval of the first set's first gain.
        diverged: lanes that diverged, over all sets.
        low: (n,) smallest observations met.
        high: (n,) largest ones.
    """

    score: float
    gains: Mapping[str, Mapping[str, float]]
    half: float
    diverged: int
    low: Array
    high: Array

    @property
    def gain(self) -> float:
        """The first set's first gain."""
        return next(iter(next(iter(self.gains.values())).values()))


@dataclass(frozen=True)
class Arena:
    """One set of recordings: the engine that plays them and the errors of best fixed parameters."""

    name: str
    engine: LaneEngine
    best_fixed: Mapping[str, Array]


def quantities(engine: LaneEngine) -> list[str]:
    """Information of an engine that it also has of its reference filter."""
    names = engine.info_fields
    return [name for name in names if f"reference_{name}" in names]


def play(engine: LaneEngine, act: Actor) -> Played:
    """Let `act` set the parameters of lane i on recording i, to the end of each.

    One that remembers has a method `begin`, which is called first.
    """
    if hasattr(act, "begin"):
        act.begin()
    observations = np.stack([engine.restart(i, recording=i) for i in range(engine.count)])
    fields, names = list(engine.info_fields), quantities(engine)
    columns = [INFORMATION + fields.index(n) for n in names]
    columns += [INFORMATION + fields.index(f"reference_{n}") for n in names]
    squares, steps = np.zeros((engine.count, len(columns))), np.zeros((engine.count, 1))
    failed = np.zeros(engine.count, dtype=np.bool_)
    low, high = observations.min(axis=0), observations.max(axis=0)
    active = np.ones(engine.count, dtype=np.bool_)
    while active.any():
        engine.stations["active"] = active
        before = engine.stations["k"].copy()
        out = engine.step(act(observations), observations)
        taken = (engine.stations["k"] - before)[active, None]
        squares[active] += taken * out[active][:, columns] ** 2
        steps[active] += taken
        low = np.minimum(low, observations[active].min(axis=0))
        high = np.maximum(high, observations[active].max(axis=0))
        failed |= active & (out[:, TERMINATED] > 0.0)
        active &= (out[:, TERMINATED] == 0.0) & (out[:, TRUNCATED] == 0.0)
    own, reference = np.split(np.sqrt(squares / steps), 2, axis=1)
    own[failed] = np.inf
    pairs = ((own, reference)[i] for i in (0, 1))
    errors, base = ({n: each[:, j] for j, n in enumerate(names)} for each in pairs)
    return Played(errors, base, low.astype(np.float64), high.astype(np.float64))


def engine_on(
    config: Configuration,
    recordings: list[Any],
    reference: Mapping[str, Any] | list[Mapping[str, Any]],
    lanes: int | None = None,
) -> LaneEngine:
    """The configuration's engine on `recordings`, with a lane for each or `lanes` of them.

    `reference` holds the parameters that actions start from, for all or for each.
    """
    made: Any = gymnasium.make_vec(
        config.environment,
        num_envs=len(recordings) if lanes is None else lanes,
        recordings=recordings,
        reference=reference if isinstance(reference, list) else dict(reference),
        **config.environment_arguments(),
    )
    engine: LaneEngine = made.unwrapped.engine
    return engine


class Validation:
    """Validation recordings of a configuration: those of each scenario and, if it randomises, drawn ones.

    Args:
        config: of the training.
    """

    def __init__(self, config: Configuration) -> None:
        self.config = config
        overrides = dict(config.overrides)
        scenarios = [find_scenario(name, **overrides) for name in config.scenarios]
        chosen = seeds("validation", config.validation)
        self.arenas = []
        for name, scenario in zip(config.scenarios, scenarios, strict=True):
            self.arenas.append(
                self._arena(name, simulate_many(scenario, chosen), dict(scenario.reference))
            )
        if config.randomise:
            made = [
                simulate_many(
                    drawn(scenarios[i % len(scenarios)], config.conditions, seed), [seed]
                )[0]
                for i, seed in enumerate(chosen)
            ]
            self.arenas.append(self._drawn(made))

    @property
    def count(self) -> int:
        """Recordings."""
        return sum(arena.engine.count for arena in self.arenas)

    def _arena(self, name: str, recordings: list[Any], best: Mapping[str, Any]) -> Arena:
        """An arena whose zero line is the scenario's own best fixed parameters.

        They may differ from the configuration's reference, which actions start from.
        """
        engine = engine_on(self.config, recordings, self.config.reference)
        same = dict(best) == self.config.reference
        judge = engine if same else engine_on(self.config, recordings, best)
        nothing = np.zeros((judge.count, len(judge.table)), dtype=np.float32)
        return Arena(name, engine, play(judge, lambda _: nothing).reference)

    def _drawn(self, recordings: list[Any]) -> Arena:
        """The arena of drawn conditions; with `references` each recording has a zero line of its own."""
        if not self.config.references:
            return self._arena(RANDOMISED, recordings, self.config.reference)
        engine = engine_on(self.config, recordings, starts_of(self.config, recordings))
        nothing = np.zeros((engine.count, len(engine.table)), dtype=np.float32)
        return Arena(RANDOMISED, engine, play(engine, lambda _: nothing).reference)

    def __call__(self, act: Actor) -> Scores:
        """Gains of `act`, which maps observations (N, n) to actions (N, k)."""
        gains, scores = {}, []
        half, diverged = np.nan, 0
        lows, highs = [], []
        for arena in self.arenas:
            run = play(arena.engine, act)
            lows.append(run.low)
            highs.append(run.high)
            first = next(iter(run.errors.values()))
            diverged += int(np.isinf(first).sum())
            bounded = {
                name: np.minimum(errors, LOST * arena.best_fixed[name])
                for name, errors in run.errors.items()
            }
            mixed = arena.name == RANDOMISED
            gains[arena.name] = {
                name: gain(errors, arena.best_fixed[name], mixed)
                for name, errors in bounded.items()
            }
            scores.append(self._score(gains[arena.name]))
            if arena is self.arenas[0]:
                name = next(iter(bounded))
                half = half_width(bounded[name], arena.best_fixed[name])
        return Scores(
            float(np.mean(scores)), gains, half, diverged,
            np.min(lows, axis=0), np.max(highs, axis=0),
        )  # fmt: skip

    def _score(self, gains: Mapping[str, float]) -> float:
        """One number from the gains of a set."""
        own = problem_in(self.config.environment).environment
        return own.score(self.arenas[0].engine.settings, gains)


def gain(errors: ArrayLike, reference: ArrayLike, mixed: bool = False) -> float:
    """1 − mean error / mean error of the reference; `mixed` takes the geometric mean of the ratios.

    Among conditions that differ by orders of magnitude an arithmetic mean hears the loudest only.
    """
    own, other = np.asarray(errors), np.asarray(reference)
    if mixed:
        return 1.0 - float(np.exp(np.mean(np.log(own / other))))
    return 1.0 - float(own.mean() / other.mean())


def half_width(errors: Array, reference: Array) -> float:
    """Half the 95 % interval of `gain`, by the delta method over pairs."""
    ratio = errors.mean() / reference.mean()
    spread = np.std(errors - ratio * reference, ddof=1) / reference.mean()
    return float(1.96 * spread / np.sqrt(len(errors)))


def plain(scores: Scores) -> dict[str, Any]:
    """Scores as JSON can hold them, without the observations."""
    found = dataclasses.asdict(scores)
    return {name: found[name] for name in ("score", "gains", "half", "diverged")}
