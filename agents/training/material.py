"""Training recordings: made once, within a bound on memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from navgym.agents.training.configuration import Configuration
from navgym.agents.training.logs import RATES, earlier
from navgym.agents.training.randomisation import drawn
from navgym.agents.training.references import starts_of
from navgym.agents.training.validation import engine_on
from navgym.agents.training.vec_env import LaneVecEnv
from navgym.core.checks import one_of
from navgym.core.seeds import seeds
from navgym.simulation import find_scenario, simulate_many

GIGA = 1e9


@dataclasses.dataclass(frozen=True)
class Material:
    """The environment to train in, and what its recordings are.

    Args:
        env: all lanes, on recordings of the training split.
        gigabytes: that recordings take, prepared ones and raw ones.
        seeds: first and last.
        count: how many recordings.
        columns: the only elements of the observation that are shown; None for all.
    """

    env: LaneVecEnv
    gigabytes: float
    seeds: tuple[int, int]
    count: int
    columns: tuple[int, ...] | None = None


def training_seeds(config: Configuration) -> range:
    """Seeds of the training recordings: every training seed has its own."""
    return seeds("train", config.pool, start=config.seed * config.pool)


def recording(config: Configuration, number: int, seed: int) -> Any:
    """The configuration's `number`-th recording: scenarios take turns, conditions may be drawn."""
    names = config.scenarios
    scenario = find_scenario(names[number % len(names)], **dict(config.overrides))
    if config.randomise and number % 100 >= round(100 * config.untouched):
        scenario = drawn(scenario, config.conditions, seed)
    return simulate_many(scenario, [seed])[0]


def from_logs(config: Configuration) -> list[Any]:
    """Recordings of the training logs, about `pool` of them where the format draws noise and losses.

    Without validation logs their earlier parts: the later ones choose and judge.
    """
    logs = config.logs
    found = logs.recordings("train", draws_of(config))
    return [r if config.validation_log else earlier(r) for _, r in found]


def draws_of(config: Configuration) -> int:
    """Of noise and losses per training log and rate."""
    return max(1, config.pool // (len(config.log) * len(RATES)))


def gigabytes(config: Configuration, first: Any, count: int) -> float:
    """What so many recordings will take, from the first one."""
    shelf = engine_on(config, [first], config.reference).shelf
    prepared = [shelf.tapes, shelf.models, shelf.stations, *shelf.extra.values()]
    raw = [v for v in vars(first).values() if isinstance(v, np.ndarray)]
    return count * sum(array.nbytes for array in (*prepared, *raw)) / GIGA


def material(config: Configuration) -> Material:
    """Make the training recordings and the environment that plays them.

    Raises ValueError where they would take more memory than the configuration allows.
    """
    chosen = training_seeds(config)
    if config.log:
        made = from_logs(config)
        chosen = seeds("train", draws_of(config))
        needed = _checked(config, made[0], len(made))
    else:
        needed = _checked(config, recording(config, 0, chosen[0]), config.pool)
        made = [recording(config, i, seed) for i, seed in enumerate(chosen)]
    engine = engine_on(config, made, starts_of(config, made), config.lanes)
    columns = columns_of(config, engine.observation_names)
    env = LaneVecEnv(engine, desynchronise=True, columns=columns, reach=config.reach)
    return Material(env, needed, (chosen.start, chosen.stop - 1), len(made), columns)


def columns_of(config: Configuration, names: Sequence[str]) -> tuple[int, ...] | None:
    """Where the configuration's observations stand; None for all of them."""
    if not config.observations:
        return None
    return tuple(names.index(one_of("observation", n, names)) for n in config.observations)


def _checked(config: Configuration, first: Any, count: int) -> float:
    """GB that so many recordings take; ValueError for more than there may be."""
    needed = gigabytes(config, first, count)
    if needed > config.memory:
        fitting = int(config.pool * config.memory / needed)
        raise ValueError(
            f"pool={config.pool} recordings take {needed:.1f} GB, more than memory="
            f"{config.memory:g}: set pool={fitting}, or memory={np.ceil(needed):g} if you have it."
        )
    return needed
