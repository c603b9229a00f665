"""Stable-Baselines3's face of an engine: all lanes as one `VecEnv`, moved by one compiled call."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from navgym.core.checks import one_of, positive_int
from navgym.envs.base import LaneEngine
from navgym.envs.columns import INFORMATION, REWARD, TERMINATED, TRUNCATED
from navgym.envs.faces import checked_options, known, spaces_of


class LaneVecEnv(VecEnv):
    """All lanes of an engine, for any algorithm of Stable-Baselines3 or sb3-contrib.

    Lane i equals a single environment with seed s + i after `seed(s)`, bit for bit, in any number
    of lanes. A lane that ends starts a new recording within the same step: its info holds
    `terminal_observation` and `TimeLimit.truncated`, and the observation returned is the new one.

    Args:
        engine: with as many lanes as there shall be environments.
        max_episode_steps: truncate episodes after this many decisions, or None.
        desynchronise: whether the first `reset` puts each lane at a random place of its recording
            (filtered up to there with the reference parameters), so that lanes do not end together.
        information: whether each info holds every field of the single environment's. Making 128
            dictionaries of them takes longer than filtering; `latest` gives a field as an array.
        columns: the only elements of the observation that are shown; all by default.
        reach: what actions are multiplied by before they act.
    """

    render_mode = None
    spec = None

    def __init__(
        self,
        engine: LaneEngine,
        max_episode_steps: int | None = None,
        desynchronise: bool = False,
        information: bool = False,
        columns: Sequence[int] | None = None,
        reach: float = 1.0,
    ) -> None:
        self.engine, self._reach = engine, np.float32(reach)
        whole, actions = spaces_of(engine)
        every = range(len(engine.observation_names))
        self._columns = np.array(every if columns is None else columns, dtype=np.int64)
        shown = gymnasium.spaces.Box(-engine.LIMIT, engine.LIMIT, self._columns.shape, np.float32)
        if max_episode_steps is not None:
            positive_int("max_episode_steps", max_episode_steps)
        super().__init__(engine.count, whole if columns is None else shown, actions)
        self.desynchronise = desynchronise
        self.information = information
        self._limit = max_episode_steps
        self._steps = np.zeros(self.num_envs, dtype=np.int64)
        self._observations = np.zeros(
            (self.num_envs, len(engine.observation_names)), dtype=np.float32
        )
        self._outcomes: NDArray[np.float64] | None = None
        self._actions: NDArray[Any] | None = None
        self._seeded = False

    # ---- the life of the lanes ---------------------------------------------------------------

    def reset(self) -> NDArray[np.float32]:
        """Start a new recording in every lane; returns observations (N, ·).

        Seeds and options given by `seed` and `set_options` count once.
        """
        for i, (seed, options) in enumerate(zip(self._seeds, self._options, strict=True)):
            if seed is not None or not self._seeded:
                self.engine.seed(i, gymnasium.utils.seeding.np_random(seed)[0])
            self._restart(i, **checked_options(options))
            if self.desynchronise and "start" not in options:
                self._observations[i] = self._scatter(i)
        self._seeded, self.desynchronise = True, False
        self._outcomes = self._actions = None
        self._reset_seeds()
        self._reset_options()
        return self._shown()

    def _shown(self) -> NDArray[np.float32]:
        # in rows, as a checkpoint keeps them: networks add up in another order otherwise
        return np.ascontiguousarray(self._observations[:, self._columns])

    def _restart(self, i: int, **options: int) -> None:
        self._observations[i] = self.engine.restart(i, **options)
        self.reset_infos[i] = self.engine.label(i)
        self._steps[i] = 0

    def _scatter(self, i: int) -> NDArray[np.float32]:
        """Put lane i at a random place of the recording that it has just begun."""
        station = self.engine.stations[i]
        first, length = int(station["k"]), int(station["length"])
        last = max(length - self.engine.settings.decision_interval, first)
        place = int(self.engine.generator(i).integers(first, last + 1))
        if place == first:
            same: NDArray[np.float32] = self._observations[i]
            return same
        return self.engine.place(i, int(station["which"]), place)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep `actions` (N, k) for `step_wait`."""
        self._actions = np.asarray(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """One decision in every lane: observations, rewards, ends and infos.

        Raises RuntimeError before the first `reset` or without actions.
        """
        if self._actions is None or not self._seeded:
            raise RuntimeError("call reset(), then step(actions).")
        actions = (
            self._actions if self._reach == 1.0 else self._reach * np.clip(self._actions, -1, 1)
        )
        out = self.engine.step(actions, self._observations)
        self._actions = None
        self._outcomes = out.copy()
        self._steps += 1
        over = out[:, TERMINATED] > 0.0
        dones = over | (out[:, TRUNCATED] > 0.0)
        if self._limit is not None:
            dones |= self._steps >= self._limit
        infos = self._infos(self._outcomes)
        for i in np.flatnonzero(dones).tolist():
            infos[i]["terminal_observation"] = self._observations[i, self._columns]
            infos[i]["TimeLimit.truncated"] = not over[i]
            self._restart(i)
        return self._shown(), out[:, REWARD].astype(np.float32), dones, infos

    def _infos(self, out: NDArray[np.float64]) -> list[dict[str, Any]]:
        if not self.information:
            return [{} for _ in range(self.num_envs)]
        names = self.engine.info_fields
        return [
            known(names, row) | {"TimeLimit.truncated": False}
            for row in out[:, INFORMATION:].tolist()
        ]

    def latest(self, field: str) -> NDArray[np.float64]:
        """A field of the single environment's info in every lane, (N,), after the last step.

        Raises ValueError for an unknown field, RuntimeError before the first step.
        """
        names = self.engine.info_fields
        one_of("information", field, names)
        if self._outcomes is None:
            raise RuntimeError("no step has been taken since reset(): call step() first.")
        return self._outcomes[:, INFORMATION + names.index(field)].copy()

    def counters(self) -> dict[str, NDArray[Any]]:
        """What this face keeps between two steps, beside its engine's `snapshot`; see `restore`."""
        return {"steps": self._steps.copy(), "observations": self._observations.copy()}

    def restore(self, counters: Mapping[str, NDArray[Any]]) -> None:
        """Put back what `counters` returned."""
        self._steps[...] = counters["steps"]
        self._observations[...] = counters["observations"]

    def close(self) -> None:
        """Nothing to release."""

    # ---- what Stable-Baselines3 asks of the environments inside ----------------------------------

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of this environment or of its engine, once per lane asked for."""
        owner: Any = self if hasattr(self, attr_name) else self.engine
        return [getattr(owner, attr_name)] * len(self._lanes(indices))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute for all lanes; ValueError for some of them, as they share one engine."""
        if len(self._lanes(indices)) != self.num_envs:
            raise ValueError(
                f"set_attr({attr_name!r}) for lanes {indices}: lanes share one engine, set it for all."
            )
        setattr(self, attr_name, value)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Call a method of the engine that takes a lane first (`label`, say), for each lane."""
        method = getattr(self.engine, method_name)
        return [method(i, *method_args, **method_kwargs) for i in self._lanes(indices)]

    def env_is_wrapped(
        self,
        wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]],
        indices: VecEnvIndices = None,
    ) -> list[bool]:
        """No lane is wrapped: wrap the whole, for example in `VecMonitor`."""
        del wrapper_class
        return [False] * len(self._lanes(indices))

    def _lanes(self, indices: VecEnvIndices) -> Sequence[int]:
        if indices is None:
            return range(self.num_envs)
        return list(indices) if isinstance(indices, Iterable) else [indices]


def lane_vec_env(
    environment: str,
    lanes: int,
    max_episode_steps: int | None = None,
    desynchronise: bool = False,
    information: bool = False,
    **arguments: Any,
) -> LaneVecEnv:
    """The environment called `environment` (an id) as a `LaneVecEnv`.

    Args:
        environment: such as "navgym/AUVDropout-v0".
        lanes: how many.
        max_episode_steps: see `LaneVecEnv`.
        desynchronise: see `LaneVecEnv`.
        information: see `LaneVecEnv`.
        arguments: of the environment.
    """
    made: Any = gymnasium.make_vec(environment, num_envs=lanes, **arguments).unwrapped
    return LaneVecEnv(made.engine, max_episode_steps, desynchronise, information)
