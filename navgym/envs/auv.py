"""`navgym/AUVDropout-v0`: tune QIVBF while an AUV loses measurements. Single and batch face."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from navgym._checks import one_of
from navgym.envs.engine import INFO_NAMES, Engine, Settings
from navgym.envs.kernels import INFO, LIMIT, REWARD, RMSE, TERMINATED, TRUNCATED
from navgym.filters import spaces

Observation = NDArray[np.float32]


class AUVDropoutEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Choose the parameters of a variational-Bayes navigation filter while it runs.

    ## Description
    An AUV moves with nearly constant velocity; its position and velocity are measured, some
    measurements get lost, and the noise of measurements and motion changes between regimes that
    nobody announces. QIVBF (Yang et al. 2020, corrected) estimates the track. The agent sets the
    filter's parameters every `decision_interval` samples, from what the filter itself knows. The
    parameters never change the truth or the measurements.

    | fact | value |
    |---|---|
    | task | dynamic algorithm configuration of a filter, one recording per episode |
    | cost | squared position error against a filter with fixed parameters on the same recording |
    | parameters | any of `navgym.parameter_space("qivbf")` that act while it runs |
    | state information | statistics of innovations and of the filter; never the truth |
    | noise level | high: the error of one decision is dominated by measurement noise |
    | instances | recordings of a scenario, split into train, validation and test by seed |

    ## Action Space
    `Box(-1, 1, (k,), float32)`, an element per name in `action_parameters`. With
    `action="absolute"`, -1 and 1 are the ends of the parameter's range and the way between is
    linear in its own scale; with `action="residual"`, 0 is the reference parameter and 1 is half
    the range away. Values outside are clipped; whole-number parameters are rounded.

    {parameters}

    ## Observation Space
    `Box(-5, 5, (41 + k,), float32)`. Each signal is followed by exponential means that keep .5, .8
    and .95 per received sample; logarithms are half natural logarithms of mean squares, so 0 is
    "as the model says".

    | index | name | unit | range | meaning |
    |---|---|---|---|---|
    | 0-2 | filter.log_nis | 1 | -5 to 5 | NIS of the controlled filter per received component |
    | 3-5 | filter.alarm | 1 | 0 to 1 | share of samples with NIS above 5 per component |
    | 6-8 | filter.correlation | 1 | -1 to 1 | cosine between successive innovations |
    | 9-11 | filter.power_position | 1 | -5 to 5 | innovation power of positions over R |
    | 12-14 | filter.power_velocity | 1 | -5 to 5 | innovation power of velocities over R |
    | 15-29 | frozen.* | | | the same of a Kalman filter with the model's Q and R, run beside |
    | 30-32 | curvature | 1 | -5 to 5 | miss of the parabola through the last three samples: tells R from Q |
    | 33-35 | lost | 1 | 0 to 1 | share of lost components |
    | 36 | since_received | 1 | 0 to 5 | half log of 1 + samples since anything was received |
    | 37, 38 | noise_position, noise_velocity | 1 | -5 to 5 | estimated R over the model's R |
    | 39 | widening | 1 | -5 to 5 | adapted over predicted covariance |
    | 40 | change | 1 | -5 to 5 | how far the last sweep still moved the state |
    | 41- | parameter.* | 1 | -1 to 1 | parameters in force, in their range |

    ## Rewards
    `reward="difference"` (default): minus the mean over the decision of the squared position error
    less that of the reference filter on the same recording, m², clipped to plus or minus
    `reward_clip`. `"over-oracle"`: minus the squared error over the variance of a filter that knows
    the true noise. `"absolute"`: minus the root of the mean squared error, m. `"likelihood"`: mean
    log-likelihood of the innovations, for recordings without truth.

    ## Starting State
    The filter holds x0, P0 one sample before the first measurement; the observation is zero but
    for the parameters in force, which are the reference's. `reset(options={{"start": k}})` filters
    k samples with them beforehand, and `options={{"recording": i}}` chooses a recording of the pool.

    ## Episode End
    `terminated` if the filter diverges (a covariance loses definiteness, or innovations run away a
    hundred times beyond R): the reward is then -`reward_clip`. `truncated` at the recording's end.

    ## Information
    `rmse` and `reference_rmse` of the decision (m), `nis` per received component, `lost` samples,
    `regime` (for analysis only: a policy must not see it), `reward_term` before clipping, and every
    parameter of the filter in physical units. `reset` returns what the recording is.

    ## Arguments
    Args:
        scenario: name (see `navgym.scenarios()`), scenario, or a list to draw from at each reset.
        overrides: fields of the scenario to change, for example `{{"loss": 0.3}}`.
        split: seeds to draw recordings from: "train", "validation" or "test".
        pool: simulate this many recordings once and draw from them; None makes a new one at each
            reset. About 0.3 MB per 800 samples.
        recordings: replay these instead of simulating.
        recording: the same for a single one.
        decision_interval: samples per step.
        action_parameters: what the agent sets; the rest stays at the reference's.
        action: "absolute" or "residual".
        reference: parameters of the reference filter; by default the scenario's best fixed ones,
            or the filter's defaults for recordings of your own. With several scenarios each has
            its own; residual actions start from the first one's.
        reward: "difference", "over-oracle", "absolute" or "likelihood".
        reward_clip: bound on the reward.
        render_mode: "rgb_array", "human" or None.

    ```python
    >>> import gymnasium, navgym
    >>> env = gymnasium.make("navgym/AUVDropout-v0", scenario="auv/switch-D")
    >>> obs, info = env.reset(seed=1)
    >>> obs, reward, terminated, truncated, info = env.step(env.action_space.sample())
    >>> obs.shape, terminated
    ((45,), False)

    ```

    ## Version History
    * v0: first version
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        scenario: Any = "auv/switch-D",
        overrides: Mapping[str, Any] | None = None,
        split: str = "train",
        pool: int | None = None,
        recordings: Sequence[Any] | None = None,
        recording: Any = None,
        decision_interval: int = 5,
        action_parameters: Sequence[str] = Settings.action_parameters,
        action: str = "absolute",
        reference: Mapping[str, Any] | None = None,
        reward: str = "difference",
        reward_clip: float = 20.0,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(
                f"render_mode must be 'human', 'rgb_array' or None, got {render_mode!r}."
            )
        settings = Settings(
            scenario, overrides, split, pool, recording if recordings is None else recordings, decision_interval,
            action_parameters, action, reference, reward, reward_clip,
        )  # fmt: skip
        self.render_mode = render_mode
        self.engine = Engine(settings, 1, trail=render_mode is not None)
        self.observation_space, self.action_space = spaces_of(self.engine)
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
                how many samples to filter beforehand with the reference parameters.
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
        """Filter the next `decision_interval` samples with the parameters that `action` chooses."""
        if self._over:
            raise RuntimeError("no episode is running: call reset() before step().")
        obs = np.empty(self._obs_shape, dtype=np.float32)
        row = self.engine.step(np.asarray(action)[None], obs)[0].tolist()
        self._over = row[TERMINATED] > 0.0 or row[TRUNCATED] > 0.0
        if self.render_mode is not None:
            self._history.append(row[INFO:])
            if self.render_mode == "human":
                self.render()
        info = dict(zip(INFO_FIELDS, row[RMSE:], strict=True))
        return obs[0], row[REWARD], row[TERMINATED] > 0.0, row[TRUNCATED] > 0.0, info

    def render(self) -> Any:
        """Draw track, estimate, covariance ellipse, lost samples and parameters so far.

        Returns (height, width, 3) bytes with `render_mode="rgb_array"`, else None.
        """
        from navgym.envs.rendering import Painter

        if self.render_mode is None:
            gymnasium.logger.warn("render() needs render_mode='rgb_array' or 'human' in gym.make.")
            return None
        if self._painter is None:
            self._painter = Painter(self.render_mode)
        return self._painter.paint(self.engine, self._history)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._painter is not None:
            self._painter.close()
            self._painter = None


class AUVDropoutVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """The batch face of `AUVDropoutEnv`: one compiled call moves every lane.

    Lane i equals a single environment with the same seed, bit for bit, in any batch size.
    `reset(seed=s)` seeds lane i with s + i; a list gives one seed each. A lane that has ended is
    reset by the next `step`, whose action for it is ignored (`AutoresetMode.NEXT_STEP`).

    Args:
        num_envs: number of lanes.
        max_episode_steps: truncate episodes after this many decisions, or None.
        arguments: those of `AUVDropoutEnv`.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self, num_envs: int = 1, max_episode_steps: int | None = None, **arguments: Any
    ) -> None:
        if arguments.pop("render_mode", None) is not None:
            raise ValueError("the vector environment does not render: use gym.make for one lane.")
        if "recording" in arguments:
            arguments.setdefault("recordings", arguments.pop("recording"))
        self.engine = Engine(Settings(**arguments), num_envs)
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

        `options` are those of `AUVDropoutEnv.reset`, each a number for all lanes or a list.
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

    @staticmethod
    def _information(out: NDArray[np.float64], valid: NDArray[np.bool_]) -> dict[str, Any]:
        """Gymnasium's form: an array per key, and a mask of the lanes where it holds."""
        found: dict[str, Any] = {}
        for j, name in enumerate(INFO_FIELDS, start=RMSE):
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


INFO_FIELDS = (*INFO_NAMES, *spaces.QIVBF.names)
assert len(INFO_NAMES) == INFO - RMSE


def checked_options(options: Mapping[str, Any] | None) -> dict[str, Any]:
    """Options of `reset`; ValueError for an unknown one."""
    for name in options or {}:
        one_of("option of reset:", name, ("recording", "start"))
    return dict(options or {})


def spaces_of(engine: Engine) -> tuple[gymnasium.Space[Any], gymnasium.Space[Any]]:
    """Observation and action space of one lane."""
    length = len(engine.observation_names)
    return (
        gymnasium.spaces.Box(-LIMIT, LIMIT, (length,), np.float32),
        gymnasium.spaces.Box(-1.0, 1.0, (len(engine.table),), np.float32),
    )


if AUVDropoutEnv.__doc__:  # absent under python -OO
    _table = spaces.QIVBF.markdown().replace("\n", "\n    ")
    AUVDropoutEnv.__doc__ = AUVDropoutEnv.__doc__.format(parameters=_table)
