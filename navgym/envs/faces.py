"""The two Gymnasium faces of an engine: one lane, and a batch of them."""

from __future__ import annotations

import dataclasses
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from navgym.core.checks import one_of
from navgym.envs.base import LaneEngine
from navgym.envs.canvas import OneLane
from navgym.envs.columns import INFORMATION, REWARD, TERMINATED, TRUNCATED
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
    PAINTER: ClassVar[Callable[[str], Any]]  # what draws a lane, from a render mode

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
        settings = self.SETTINGS(**setting_arguments(self.SETTINGS, arguments))
        self.engine = engine = self.ENGINE(settings, 1, trail=render_mode is not None)
        self.observation_space, self.action_space = spaces_of(engine)
        self._obs_shape = (1, *(self.observation_space.shape or ()))
        self._over = True
        self._painter: Any = None
        self._history: list[list[float]] = []

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
        """Filter until the next decision with the parameters that `action` chooses.

        What cannot be known, such as an error where the truth is not, is left out of the information.
        """
        if self._over:
            raise RuntimeError("no episode is running: call reset() before step().")
        obs = np.empty(self._obs_shape, dtype=np.float32)
        row = self.engine.step(np.asarray(action)[None], obs)[0].tolist()
        self._over = row[TERMINATED] > 0.0 or row[TRUNCATED] > 0.0
        if self.render_mode is not None:
            self._history.append(row[INFORMATION + len(self.engine.INFO_NAMES) :])
            if self.render_mode == "human":
                self.render()
        info = known(self.engine.info_fields, row[INFORMATION:])
        return obs[0], row[REWARD], row[TERMINATED] > 0.0, row[TRUNCATED] > 0.0, info

    def render(self) -> Any:
        """Draw the episode so far.

        Returns (height, width, 3) bytes with `render_mode="rgb_array"`, else None.
        """
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs render_mode='rgb_array' or 'human' in gym.make.")
            return None
        if self._painter is None:
            self._painter = type(self).PAINTER(self.render_mode)
        return self._painter.paint(self.engine, self._history)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._painter is not None:
            self._painter.close()
            self._painter = None


class LaneVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """All lanes of an engine as a Gymnasium vector environment: one compiled call moves them.

    Lane i equals a single environment with the same seed, bit for bit, in any batch size.
    `reset(seed=s)` seeds lane i with s + i; a list gives one seed each. What becomes of a lane that has
    ended is Gymnasium's `AutoresetMode`: by default the next `step` resets it and ignores its action.

    Args:
        num_envs: number of lanes.
        max_episode_steps: truncate episodes after this many decisions, or None.
        autoreset_mode: "NextStep"; "SameStep", where the step that ends an episode resets the lane and
            `infos` hold `final_obs` and `final_info`; "Disabled", where
            `reset(options={"reset_mask": ended})` does.
        render_mode: "rgb_array" or None.
        arguments: those of the single environment.
    """

    SETTINGS: ClassVar[type[LaneSettings]]
    ENGINE: ClassVar[type[LaneEngine]]
    PAINTER: ClassVar[Callable[[str], Any]]  # what draws a lane, from a render mode

    metadata = {  # noqa: RUF012
        "render_modes": ["rgb_array"], "render_fps": 10, "autoreset_mode": AutoresetMode.NEXT_STEP,
    }  # fmt: skip

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **arguments: Any,
    ) -> None:
        self._mode = _checked_mode(autoreset_mode)
        self.metadata = self.metadata | {"autoreset_mode": self._mode}
        self.render_mode = arguments.pop("render_mode", None)
        if self.render_mode not in (None, "rgb_array"):
            raise ValueError(
                f"render_mode of a batch must be 'rgb_array' or None, got {self.render_mode!r}: for a "
                "window use gym.make, which has one lane."
            )
        settings = self.SETTINGS(**setting_arguments(self.SETTINGS, arguments))
        self.engine = self.ENGINE(settings, num_envs, trail=self.render_mode is not None)
        self._painter: Any = None
        self._history: list[list[list[float]]] = [[] for _ in range(num_envs)]
        self.num_envs = num_envs
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

        `options` are those of the single environment, each a number for all lanes or a list, and
        `reset_mask`, (N,) of which lanes to reset; all by default. Lanes that go on keep their
        observation, their generator and their recording.
        """
        given = dict(options or {})
        which = _checked_mask(given.pop("reset_mask", None), self.num_envs)
        if not which.all() and not self._generators:
            raise RuntimeError("call reset() for all lanes before a reset_mask leaves some out.")
        self._seed_lanes(seed, which)
        chosen = checked_options(given)
        each = {name: np.broadcast_to(value, self.num_envs) for name, value in chosen.items()}
        for i in map(int, np.flatnonzero(which)):
            self._restart(i, **{name: int(values[i]) for name, values in each.items()})
        return self._observations.copy(), self._labels(which)

    def _seed_lanes(
        self, seed: int | Sequence[int | None] | None, which: NDArray[np.bool_]
    ) -> None:
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
            old[i]
            if old and (s is None or not which[i])
            else gymnasium.utils.seeding.np_random(s)[0]
            for i, s in enumerate(each)
        ]
        for i in map(int, np.flatnonzero(which)):
            self.engine.seed(i, self._generators[i])

    def _restart(self, i: int, **options: int) -> None:
        self._observations[i] = self.engine.restart(i, **options)
        self._steps[i], self._done[i] = 0, False
        self._history[i] = []

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[
        Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]
    ]:
        """One decision in every lane; see `autoreset_mode` for lanes that have ended."""
        if not self._generators:
            raise RuntimeError("call reset() before step().")
        fresh = self._done.copy()
        if fresh.any() and self._mode == AutoresetMode.DISABLED:
            raise RuntimeError(
                f"lanes {np.flatnonzero(fresh).tolist()} have ended: reset them by "
                'reset(options={"reset_mask": ...}), or choose another autoreset_mode.'
            )
        engine = self.engine
        engine.stations["active"] = ~fresh
        out = engine.step(np.asarray(actions), self._observations)
        infos = self._restarted(fresh)
        self._remember(out, ~fresh)
        self._steps[~fresh] += 1
        terminated, truncated = out[:, TERMINATED] > 0.0, out[:, TRUNCATED] > 0.0
        if self._limit is not None:
            truncated |= (self._steps >= self._limit) & ~terminated
        ended = terminated | truncated
        self._done = ended.copy()
        if ended.any() and self._mode == AutoresetMode.SAME_STEP:
            infos |= {
                "final_obs": self._observations * ended[:, None], "_final_obs": ended.copy(),
                "final_info": self._information(out, ended), "_final_info": ended.copy(),
            }  # fmt: skip
            infos |= self._restarted(ended) | self._information(out, ~ended)
        else:
            infos |= self._information(out, ~fresh)
        return self._observations.copy(), out[:, REWARD].copy(), terminated, truncated, infos

    def _remember(self, out: NDArray[np.float64], which: NDArray[np.bool_]) -> None:
        """Keep the parameters that were in force, for pictures."""
        if self.render_mode is not None:
            rows = out[:, INFORMATION + len(self.engine.INFO_NAMES) :].tolist()
            for i in map(int, np.flatnonzero(which)):
                self._history[i].append(rows[i])

    def render(self) -> tuple[Any, ...] | None:
        """A picture of each lane so far, (height, width, 3) bytes; needs `render_mode="rgb_array"`."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs render_mode='rgb_array' in gym.make_vec.")
            return None
        if self._painter is None:
            self._painter = type(self).PAINTER(self.render_mode)
        lanes = ((OneLane(self.engine, i), rows) for i, rows in enumerate(self._history))
        return tuple(self._painter.paint(lane, rows) for lane, rows in lanes)

    def _restarted(self, which: NDArray[np.bool_]) -> dict[str, Any]:
        """Reset some lanes; their infos."""
        which = which.copy()
        for i in map(int, np.flatnonzero(which)):
            self._restart(i)
        return self._labels(which) if which.any() else {}

    def _information(self, out: NDArray[np.float64], valid: NDArray[np.bool_]) -> dict[str, Any]:
        """Gymnasium's form: an array per key, and a mask of the lanes where it is known."""
        found: dict[str, Any] = {}
        for j, name in enumerate(self.engine.info_fields, start=INFORMATION):
            found[name], found[f"_{name}"] = out[:, j].copy(), valid & ~np.isnan(out[:, j])
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


def known(names: Sequence[str], values: Sequence[float]) -> dict[str, float]:
    """A lane's information by name, without what is NaN: not known."""
    found = dict(zip(names, values))  # noqa: B905 - of one engine; a check doubles the cost
    if not math.isnan(sum(values)):  # one look instead of one per value
        return found
    return {name: value for name, value in found.items() if not math.isnan(value)}


def checked_render_mode(render_mode: str | None) -> str | None:
    """`render_mode` if it is one; ValueError if not."""
    if render_mode not in (None, *RENDER_MODES):
        raise ValueError(f"render_mode must be 'human', 'rgb_array' or None, got {render_mode!r}.")
    return render_mode


def _checked_mode(mode: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError:
        known = ", ".join(repr(m.value) for m in AutoresetMode)
        raise ValueError(f"autoreset_mode must be one of {known}, got {mode!r}.") from None


def _checked_mask(mask: Any, count: int) -> NDArray[np.bool_]:
    """`reset_mask` of `count` lanes, all where it is None; ValueError for what is no mask."""
    if mask is None:
        return np.ones(count, dtype=np.bool_)
    given = np.asarray(mask)
    if given.dtype != np.bool_ or given.shape != (count,) or not given.any():
        raise ValueError(
            f"reset_mask must hold a boolean for each of {count} lanes, at least one of them True, got "
            f"{given.dtype} of shape {given.shape}."
        )
    return given.copy()


def setting_arguments(kind: type[LaneSettings], arguments: dict[str, Any]) -> dict[str, Any]:
    """Arguments of an environment as those of its settings; TypeError for one that there is not."""
    own = arguments.pop("recording", None)
    for name in arguments:
        try:
            one_of("argument", name, [f.name for f in dataclasses.fields(kind) if f.init])
        except ValueError as error:
            raise TypeError(str(error)) from None
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
