"""The two Gymnasium faces of an engine: one lane, and a batch of them."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from navgym.core.checks import one_of
from navgym.envs.base import INFORMATION, REWARD, TERMINATED, TRUNCATED, LaneEngine
from navgym.envs.settings import LaneSettings, argument_manual, signature

Observation = NDArray[np.float32]
RENDER_MODES = ("human", "rgb_array")


class LaneEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """One lane of an engine as a Gymnasium environment.

    A kind of environment names its settings, whose fields are its arguments, and its engine; its
    docstring is its manual, where `{parameters}` and `{arguments}` stand for what these declare.

    Args:
        render_mode: "rgb_array", "human" or None.
        arguments: those of the settings; `recording` stands for a single one of `recordings`.
    """

    SETTINGS: ClassVar[type[LaneSettings]]
    ENGINE: ClassVar[type[LaneEngine]]

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # noqa: RUF012

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.__signature__ = signature(cls.SETTINGS)  # type: ignore[attr-defined]
        if cls.__doc__:  # absent under python -OO
            table = cls.SETTINGS.SPACE.markdown().replace("\n", "\n    ")
            cls.__doc__ = cls.__doc__.format(
                parameters=table, arguments=argument_manual(cls.SETTINGS)
            )

    def __init__(self, *, render_mode: str | None = None, **arguments: Any) -> None:
        self.render_mode = checked_render_mode(render_mode)
        settings = self.SETTINGS(**setting_arguments(arguments))
        self.engine = engine = self.ENGINE(settings, 1, trail=render_mode is not None)
        self.observation_space, self.action_space = spaces_of(engine)
        self._obs_shape = (1, *(self.observation_space.shape or ()))
        self._over = True
        self._painter: Any = None
        self._history: list[list[float]] = []

    def new_painter(self, mode: str) -> Any:
        """What draws this kind of environment."""
        raise NotImplementedError

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a new recording; the same seed gives the same one.

        Args:
            seed: of the recordings drawn from now on.
            options: `recording`, the number of a recording in `recordings` or the pool; `start`,
                how many filter steps to take beforehand with the reference parameters.
        """
        super().reset(seed=seed)
        self.engine.seed(0, self.np_random)
        observation = self.engine.restart(0, **checked_options(options))
        self._over = False
        self._history = []
        return observation, self.engine.label(0)

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Filter until the next decision with the parameters that `action` chooses."""
        if self._over:
            raise RuntimeError("no episode is running: call reset() before step().")
        obs = np.empty(self._obs_shape, dtype=np.float32)
        row = self.engine.step(np.asarray(action)[None], obs)[0].tolist()
        self._over = row[TERMINATED] > 0.0 or row[TRUNCATED] > 0.0
        if self.render_mode is not None:
            self._history.append(row[INFORMATION + len(self.engine.INFO_NAMES) :])
            if self.render_mode == "human":
                self.render()
        info = dict(zip(self.engine.info_fields, row[INFORMATION:], strict=True))
        return obs[0], row[REWARD], row[TERMINATED] > 0.0, row[TRUNCATED] > 0.0, info

    def render(self) -> Any:
        """Draw the episode so far.

        Returns (height, width, 3) bytes with `render_mode="rgb_array"`, else None.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs render_mode='rgb_array' or 'human' in gym.make.")
            return None
        if self._painter is None:
            self._painter = self.new_painter(self.render_mode)
        return self._painter.paint(self.engine, self._history)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._painter is not None:
            self._painter.close()
            self._painter = None


class LaneVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """All lanes of an engine as a Gymnasium vector environment: one compiled call moves them.

    Lane i equals a single environment with the same seed, bit for bit, in any batch size.
    `reset(seed=s)` seeds lane i with s + i; a list gives one seed each. A lane that has ended is
    reset by the next `step`, whose action for it is ignored (`AutoresetMode.NEXT_STEP`).

    Args:
        num_envs: number of lanes.
        max_episode_steps: truncate episodes after this many decisions, or None.
        arguments: those of the single environment, but for `render_mode`.
    """

    SETTINGS: ClassVar[type[LaneSettings]]
    ENGINE: ClassVar[type[LaneEngine]]

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self, num_envs: int = 1, max_episode_steps: int | None = None, **arguments: Any
    ) -> None:
        if arguments.pop("render_mode", None) is not None:
            raise ValueError("the vector environment does not render: use gym.make for one lane.")
        self.engine = self.ENGINE(self.SETTINGS(**setting_arguments(arguments)), num_envs)
        self.num_envs = num_envs
        self.render_mode = None
        self.single_observation_space, self.single_action_space = spaces_of(self.engine)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._limit = max_episode_steps
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._done = np.zeros(num_envs, dtype=np.bool_)
        self._observations: Observation = np.zeros(
            (num_envs, len(self.engine.observation_names)), dtype=np.float32
        )
        self._generators: list[np.random.Generator] = []

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a new recording in every lane; returns observations (N, ·) and their infos.

        `options` are those of the single environment, each a number for all lanes or a list.
        """
        self._seed_lanes(seed)
        chosen = checked_options(options)
        each = {name: np.broadcast_to(value, self.num_envs) for name, value in chosen.items()}
        for i in range(self.num_envs):
            self._restart(i, **{name: int(values[i]) for name, values in each.items()})
        return self._observations.copy(), self._labels(np.ones(self.num_envs, dtype=np.bool_))

    def _seed_lanes(self, seed: int | Sequence[int | None] | None) -> None:
        if seed is None and self._generators:
            return
        if seed is None:
            each: list[int | None] = [None] * self.num_envs
        elif np.ndim(seed) == 0:  # type: ignore[arg-type]
            each = [operator.index(seed) + i for i in range(self.num_envs)]  # type: ignore[arg-type]
        else:
            each = [None if s is None else operator.index(s) for s in seed]  # type: ignore[union-attr]
        if len(each) != self.num_envs:
            raise ValueError(
                f"seed must be one number or {self.num_envs} of them, got {len(each)}."
            )
        old = self._generators
        self._generators = [
            old[i] if s is None and old else gymnasium.utils.seeding.np_random(s)[0]
            for i, s in enumerate(each)
        ]
        for i, generator in enumerate(self._generators):
            self.engine.seed(i, generator)

    def _restart(self, i: int, **options: int) -> None:
        self._observations[i] = self.engine.restart(i, **options)
        self._steps[i], self._done[i] = 0, False

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[
        Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]
    ]:
        """One decision in every lane; lanes that ended before start a new recording instead."""
        if not self._generators:
            raise RuntimeError("call reset() before step().")
        fresh = self._done.copy()
        engine = self.engine
        engine.stations["active"] = ~fresh
        out = engine.step(np.asarray(actions), self._observations)
        for i in np.flatnonzero(fresh):
            self._restart(int(i))
        self._steps[~fresh] += 1
        terminated, truncated = out[:, TERMINATED] > 0.0, out[:, TRUNCATED] > 0.0
        if self._limit is not None:
            truncated |= (self._steps >= self._limit) & ~terminated
        self._done = terminated | truncated
        infos = self._information(out, ~fresh) | (self._labels(fresh) if fresh.any() else {})
        return self._observations.copy(), out[:, REWARD].copy(), terminated, truncated, infos

    def _information(self, out: NDArray[np.float64], valid: NDArray[np.bool_]) -> dict[str, Any]:
        """Gymnasium's form: an array per key, and a mask of the lanes where it holds."""
        found: dict[str, Any] = {}
        for j, name in enumerate(self.engine.info_fields, start=INFORMATION):
            found[name], found[f"_{name}"] = out[:, j].copy(), valid.copy()
        return found

    def _labels(self, fresh: NDArray[np.bool_]) -> dict[str, Any]:
        labels = [self.engine.label(i) if fresh[i] else {} for i in range(self.num_envs)]
        names = sorted({name for label in labels for name in label})
        found: dict[str, Any] = {}
        for name in names:
            values = np.empty(self.num_envs, dtype=object)
            values[:] = [label.get(name) for label in labels]
            found[name], found[f"_{name}"] = values, np.array([name in label for label in labels])
        return found


def checked_render_mode(render_mode: str | None) -> str | None:
    """`render_mode` if it is one; ValueError if not."""
    if render_mode not in (None, *RENDER_MODES):
        raise ValueError(f"render_mode must be 'human', 'rgb_array' or None, got {render_mode!r}.")
    return render_mode


def setting_arguments(arguments: dict[str, Any]) -> dict[str, Any]:
    """Arguments of an environment as those of its settings."""
    own = arguments.pop("recording", None)
    if own is not None:
        if arguments.get("recordings") is not None:
            raise ValueError("give recording= or recordings=, not both.")
        arguments["recordings"] = own
    return arguments


def checked_options(options: Mapping[str, Any] | None) -> dict[str, Any]:
    """Options of `reset`; ValueError for an unknown one."""
    for name in options or {}:
        one_of("option of reset:", name, ("recording", "start"))
    return dict(options or {})


def spaces_of(engine: LaneEngine) -> tuple[gymnasium.Space[Any], gymnasium.Space[Any]]:
    """Observation and action space of one lane."""
    length = len(engine.observation_names)
    return (
        gymnasium.spaces.Box(-engine.LIMIT, engine.LIMIT, (length,), np.float32),
        gymnasium.spaces.Box(-1.0, 1.0, (len(engine.table),), np.float32),
    )
