"""A head start: imitate the table by true regime, then learn on from there (DAgger).

The teacher knows the true regime of the samples to come, which no policy does; the student sees what
the filter sees. It is fitted to what the teacher would do in the states that the student itself
comes to, and so learns the best guess of the regime together with its parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from navgym.agents.training.configuration import Configuration
from navgym.agents.training.vec_env import LaneVecEnv
from navgym.core.checks import Array

CANDIDATES = 16  # tables that are tried side by side, a group of lanes each
ELITE = 4  # of them that shape the next generation
SPREAD = 0.6  # of the first generation, in actions
PATIENCE = 160  # decisions per generation


@dataclass(frozen=True)
class Teacher:
    """Actions by true regime.

    Args:
        regimes: names.
        actions: (regimes, k) each in -1..1.
        reward: mean reward of a decision under the table, as the search saw it.
    """

    regimes: tuple[str, ...]
    actions: Array
    reward: float

    def as_dict(self) -> dict[str, Any]:
        """For the record."""
        pairs = zip(self.regimes, self.actions, strict=True)
        return {name: [round(float(a), 4) for a in row] for name, row in pairs}


class Regimes:
    """Which regime each lane of an environment is about to enter, as a number.

    Args:
        env: whose recordings are simulated: each knows the names of its regimes.

    Raises ValueError for recordings without regimes.
    """

    def __init__(self, env: LaneVecEnv) -> None:
        engine = env.engine
        known = [label.get("regimes", ()) for label in engine.shelf.labels]
        self.names = tuple(dict.fromkeys(name for names in known for name in names))
        if not all(known) or not np.isfinite(engine.shelf.tapes["regime"][:, 0]).all():
            raise ValueError(
                "clone needs recordings that know their regimes: simulate them, or set clone=False."
            )
        numbers = {name: i for i, name in enumerate(self.names)}
        longest = max(map(len, known))
        self._number = np.zeros((len(known), longest), dtype=np.int64)
        for row, names in zip(self._number, known, strict=True):
            row[: len(names)] = [numbers[name] for name in names]
        self._engine = engine

    def __call__(self) -> NDArray[np.int64]:
        """(N,) regime of the next sample of each lane."""
        stations = self._engine.stations
        which, k = stations["which"], np.minimum(stations["k"], stations["length"] - 1)
        labels = self._engine.shelf.tapes["regime"][which, k].astype(np.int64)
        found: NDArray[np.int64] = self._number[which, labels]
        return found


def find_teacher(config: Configuration, env: LaneVecEnv, seed: int) -> Teacher:
    """The best table by true regime, by the cross-entropy method on the environment itself.

    Regimes do not share decisions, so one generation tries as many tables for each regime as there
    are candidates; all candidates see the same recordings.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0xC1]))
    regimes = Regimes(env)
    shape = (len(regimes.names), len(env.engine.table))
    mean, spread = np.zeros(shape), np.full(shape, SPREAD)
    rewards = np.zeros(0)
    for generation in range(config.cloning.search):
        tables = np.clip(mean + spread * rng.standard_normal((CANDIDATES, *shape)), -1.0, 1.0)
        tables[0] = np.clip(mean, -1.0, 1.0)  # what came out so far stays in the race
        totals, counts = _try(env, regimes, tables, seed * 1000 + generation)
        means = totals / np.maximum(counts, 1.0)
        rewards = means[0][counts[0] > 0.0]
        for g in range(shape[0]):
            if (counts[:, g] > 0.0).all():  # else the regime did not occur
                best = tables[np.argsort(-means[:, g])[:ELITE], g]
                mean[g], spread[g] = best.mean(axis=0), best.std(axis=0) + 0.02
    return Teacher(regimes.names, np.clip(mean, -1.0, 1.0), float(rewards.mean()))


def _try(env: LaneVecEnv, regimes: Regimes, tables: Array, seed: int) -> tuple[Array, Array]:
    """Reward and number of decisions of each candidate in each regime, (candidates, regimes)."""
    group = np.arange(env.num_envs) % CANDIDATES
    engine, rng = env.engine, np.random.default_rng(seed)
    env.reset()
    count = len(engine.shelf.stations)
    for first in range(0, env.num_envs, CANDIDATES):  # the same place for every candidate
        which, share = int(rng.integers(count)), rng.random()
        begun = int(engine.shelf.stations["k"][which])
        room = int(engine.shelf.stations["length"][which]) - begun
        start = begun + int(share * room / 2.0)
        for i in range(first, min(first + CANDIDATES, env.num_envs)):
            engine.place(i, which, start if start > begun else None)
    totals, counts = np.zeros((2, *tables.shape[:2]))
    for _ in range(PATIENCE):
        now = regimes()
        _, rewards, dones, _ = env.step(tables[group, now].astype(np.float32))
        np.add.at(totals, (group, now), rewards)
        np.add.at(counts, (group, now), 1.0)
        if dones.any():
            break
    return totals, counts


def clone(
    config: Configuration, model: BaseAlgorithm, normaliser: VecNormalize, env: LaneVecEnv
) -> Mapping[str, Any]:
    """Fit the model's actor to a teacher, and the normaliser to what it sees; returns a record."""
    teacher = find_teacher(config, env, config.seed)
    regimes = Regimes(env)
    rounds = config.cloning.rounds + 1
    steps = max(1, config.cloning.decisions // (rounds * config.lanes))
    seen: list[NDArray[np.float32]] = []
    wanted: list[NDArray[np.float32]] = []
    losses = []
    for number in range(rounds):
        env.desynchronise = True
        observations = np.asarray(env.reset())
        fresh = []
        for _ in range(steps):
            answer = teacher.actions[regimes()].astype(np.float32)
            fresh.append(observations)
            wanted.append(answer)
            act = answer if number == 0 else _student(model, normaliser, observations)
            observations = np.asarray(env.step(act)[0])
        seen += fresh
        rms: Any = normaliser.obs_rms
        rms.update(np.concatenate(fresh).astype(np.float64))
        inputs = normaliser.normalize_obs(np.concatenate(seen))
        losses.append(_fit(config, model, np.asarray(inputs), np.concatenate(wanted)))
    spread = float(np.concatenate(wanted).var(axis=0).mean())
    return {
        "teacher": teacher.as_dict(),
        "reward": teacher.reward,
        "losses": losses,  # mean squared miss of the teacher's actions, after each round
        "spread": spread,  # what it would be for a student who always does the same
    }


def _student(
    model: BaseAlgorithm, normaliser: VecNormalize, observations: NDArray[np.float32]
) -> NDArray[np.float32]:
    actions: NDArray[np.float32]
    actions, _ = model.predict(normaliser.normalize_obs(observations), deterministic=True)
    return actions


def _fit(
    config: Configuration,
    model: BaseAlgorithm,
    inputs: NDArray[np.float32],
    targets: NDArray[np.float32],
) -> float:
    """Least squares of the actor's mean action on the targets; returns the last epoch's loss."""
    import torch

    x, y = torch.from_numpy(inputs), torch.from_numpy(targets)
    actor: Any = getattr(model, "actor", None) or model.policy
    optimiser = torch.optim.Adam(actor.parameters(), lr=config.recipe.learning_rate)
    total = 0.0
    for _ in range(config.cloning.epochs):
        total = 0.0
        for rows in torch.split(torch.randperm(len(x)), 512):
            loss = torch.mean((_mean_action(model, x[rows]) - y[rows]) ** 2)
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            total += float(loss.detach()) * len(rows)
    return total / len(x)


def _mean_action(model: BaseAlgorithm, observations: Any) -> Any:
    """What the actor would do without exploration, before clipping."""
    actor: Any = getattr(model, "actor", None)
    if actor is not None:
        return actor(observations, deterministic=True)
    policy: Any = model.policy
    return policy.get_distribution(observations).distribution.mean
