"""Training recordings: made once, within a bound on memory."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from navgym.agents.training.configuration import Configuration
from navgym.agents.training.randomisation import drawn
from navgym.agents.training.validation import engine_on
from navgym.agents.training.vec_env import LaneVecEnv
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
    """

    env: LaneVecEnv
    gigabytes: float
    seeds: tuple[int, int]


def training_seeds(config: Configuration) -> range:
    """Seeds of the training recordings: every training seed has its own."""
    return seeds("train", config.pool, start=config.seed * config.pool)


def recording(config: Configuration, number: int, seed: int) -> Any:
    """The configuration's `number`-th recording: scenarios take turns, conditions may be drawn."""
    names = config.scenarios
    scenario = find_scenario(names[number % len(names)], **dict(config.overrides))
    if config.randomise:
        scenario = drawn(scenario, config.conditions, seed)
    return simulate_many(scenario, [seed])[0]


def gigabytes(config: Configuration) -> float:
    """What the configuration's recordings will take, from the first one."""
    first = recording(config, 0, training_seeds(config)[0])
    shelf = engine_on(config, [first], config.reference).shelf
    prepared = [shelf.tapes, shelf.models, shelf.stations, *shelf.extra.values()]
    raw = [v for v in vars(first).values() if isinstance(v, np.ndarray)]
    return config.pool * sum(array.nbytes for array in (*prepared, *raw)) / GIGA


def material(config: Configuration) -> Material:
    """Make the training recordings and the environment that plays them.

    Raises ValueError where they would take more memory than the configuration allows.
    """
    needed = gigabytes(config)
    if needed > config.memory:
        fitting = int(config.pool * config.memory / needed)
        raise ValueError(
            f"pool={config.pool} recordings take {needed:.1f} GB, more than memory="
            f"{config.memory:g}: set pool={fitting}, or memory={np.ceil(needed):g} if you have it."
        )
    chosen = training_seeds(config)
    made = [recording(config, i, seed) for i, seed in enumerate(chosen)]
    engine = engine_on(config, made, config.reference, config.lanes)
    env = LaneVecEnv(engine, desynchronise=True)
    return Material(env, needed, (chosen.start, chosen.stop - 1))
