"""Episodes of any environment as a data set that offline learners read: Minari's format.

    from navgym.agents import episodes, shipped
    episodes.to_minari("navgym/auv-shipped-v0", "navgym/AUVDropout-v0", shipped("auv"), 100)

Needs `pip install 'navgym[minari]'`. Minari keeps data sets in the folder that MINARI_DATASETS_PATH
names; `minari.load_dataset` reads one back, and its `recover_environment()` makes the environment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import one_of, positive_int
from navgym.problem import environments

Act = Callable[[NDArray[np.float32]], NDArray[np.float32]]


@dataclass(frozen=True)
class Episode:
    """What happened from a reset to an end.

    Args:
        seed: of the reset.
        observations: (T + 1, n).
        actions: (T, k).
        rewards: (T,).
        terminated: whether the filter diverged at the end; else the recording was over.
        info: (T,) arrays of the information that every decision had, by name.
    """

    seed: int
    observations: NDArray[np.float32]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminated: bool
    info: dict[str, NDArray[np.float64]]


def played(environment: str, act: Act | None, count: int, seed: int = 0, **arguments: Any) -> list[Episode]:  # fmt: skip
    """Play whole episodes, the i-th from seed + i.

    Args:
        environment: an id.
        act: observations (n,) to actions (k,), such as a `Policy`; None draws them at random.
        count: how many.
        seed: of the first.
        arguments: of the environment.

    Raises ValueError for an unknown environment or a count that is no positive number.
    """
    one_of("environment", environment, environments())
    env = gymnasium.make(environment, **arguments)
    env.action_space.seed(seed)
    choose: Act = (lambda _: env.action_space.sample()) if act is None else act
    return [_episode(env, choose, seed + i) for i in range(positive_int("count", count))]


def _episode(env: gymnasium.Env[Any, Any], act: Act, seed: int) -> Episode:
    observation, _ = env.reset(seed=seed)
    observations, actions, rewards, infos = [observation], [], [], []
    terminated = truncated = False
    while not (terminated or truncated):
        actions.append(np.asarray(act(observation), dtype=np.float32))
        observation, reward, terminated, truncated, info = env.step(actions[-1])
        observations.append(observation)
        rewards.append(float(reward))
        infos.append(info)
    known = set(infos[0]).intersection(*infos)
    told = {n: np.array([i[n] for i in infos]) for n in infos[0] if n in known}
    return Episode(
        seed, np.stack(observations), np.stack(actions), np.array(rewards), terminated, told
    )


def to_minari(
    name: str,
    environment: str,
    act: Act | None,
    count: int,
    seed: int = 0,
    description: str = "",
    **arguments: Any,
) -> Any:
    """Play episodes and keep them as the Minari data set `name`, such as "navgym/auv-shipped-v0".

    Returns the `minari.MinariDataset`. Arguments must be what JSON holds, so that the environment can be
    made again; see `played` for the others.

    Raises:
        RuntimeError: minari is missing.
        ValueError: see `played`; a name that is taken or that Minari refuses.
    """
    try:
        import minari
        from minari.data_collector import EpisodeBuffer
    except ImportError as error:
        raise RuntimeError(
            "a Minari data set needs minari: pip install 'navgym[minari]'."
        ) from error
    buffers = [
        EpisodeBuffer(
            id=i, seed=e.seed, observations=list(e.observations), actions=list(e.actions),
            rewards=e.rewards.tolist(),
            terminations=[False] * (len(e.rewards) - 1) + [e.terminated],
            truncations=[False] * (len(e.rewards) - 1) + [not e.terminated],
        )
        for i, e in enumerate(played(environment, act, count, seed, **arguments))
    ]  # fmt: skip
    return minari.create_dataset_from_buffers(
        name, buffers, env=gymnasium.make(environment, **arguments), description=description,
        algorithm_name="random" if act is None else type(act).__name__, requirements=["navgym"],
    )  # fmt: skip
