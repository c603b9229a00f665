"""Learners of Stable-Baselines3 and sb3-contrib, set up as a configuration says."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from navgym.agents.training.configuration import Configuration
from navgym.agents.training.vec_env import LaneVecEnv

# name: module, class and policy
ALGORITHMS: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {
        "ppo": ("stable_baselines3", "PPO", "MlpPolicy"),
        "sac": ("stable_baselines3", "SAC", "MlpPolicy"),
        "tqc": ("sb3_contrib", "TQC", "MlpPolicy"),
        "recurrent_ppo": ("sb3_contrib", "RecurrentPPO", "MlpLstmPolicy"),
    }
)
REMEMBERING = ("recurrent_ppo",)  # whose policies are more than dense layers


def normalised(config: Configuration, env: LaneVecEnv) -> VecNormalize:
    """`env` behind a monitor of episodes and running normalisation of observations and rewards."""
    from stable_baselines3.common.vec_env import VecMonitor

    recipe = config.recipe
    return VecNormalize(
        VecMonitor(env),
        clip_obs=recipe.clip_observation,
        clip_reward=recipe.clip_reward,
        gamma=recipe.gamma,
    )


def learner(config: Configuration, env: VecNormalize) -> BaseAlgorithm:
    """A fresh learner; its random numbers, and torch's, start from the configuration's seed.

    Raises:
        ModuleNotFoundError: sb3-contrib is needed and missing.
    """
    import torch

    package, kind, policy = ALGORITHMS[config.algorithm]
    try:
        algorithm = getattr(importlib.import_module(package), kind)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"algorithm {config.algorithm!r} needs sb3-contrib: pip install sb3-contrib."
        ) from error
    torch.set_num_threads(config.threads)
    own = _off_policy if config.algorithm in ("sac", "tqc") else _on_policy
    made: BaseAlgorithm = algorithm(
        policy,
        env,
        learning_rate=schedule(config),
        batch_size=config.recipe.batch,
        gamma=config.recipe.gamma,
        seed=config.seed,
        device="cpu",
        **own(config),
    )
    return made


def schedule(config: Configuration) -> Callable[[float], float]:
    """Learning rate by the share of training that remains, 1 to 0."""
    first, last = config.recipe.learning_rate, config.recipe.final_learning_rate
    return lambda remaining: last + (first - last) * remaining


def _on_policy(config: Configuration) -> dict[str, Any]:
    recipe = config.recipe
    kwargs: dict[str, Any] = {
        "net_arch": list(recipe.hidden),
        "log_std_init": recipe.log_std_init,
    }
    if config.algorithm in REMEMBERING:
        kwargs["lstm_hidden_size"] = recipe.hidden[0] if recipe.hidden else 64
    return {
        "n_steps": recipe.steps,
        "n_epochs": recipe.epochs,
        "gae_lambda": recipe.gae_lambda,
        "clip_range": recipe.clip_range,
        "ent_coef": recipe.entropy,
        "policy_kwargs": kwargs,
    }


def _off_policy(config: Configuration) -> dict[str, Any]:
    recipe = config.recipe
    return {
        "buffer_size": recipe.buffer,
        "train_freq": 1,
        "gradient_steps": recipe.gradient_steps,
        "learning_starts": recipe.learning_starts,
        "policy_kwargs": {"net_arch": list(recipe.hidden)},
    }


class Remembering:
    """The deterministic actions of a recurrent model, one lane per row.

    Args:
        model: of sb3-contrib.
        normaliser: that it was trained behind.
    """

    def __init__(self, model: Any, normaliser: VecNormalize) -> None:
        self.model, self.normaliser = model, normaliser
        self.begin()

    def begin(self) -> None:
        """Forget: other recordings start now."""
        self._state: Any = None
        self._fresh = True

    def __call__(self, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        """Actions (N, k) for the next observations (N, n) of the same lanes."""
        actions: NDArray[np.float32]
        actions, self._state = self.model.predict(
            self.normaliser.normalize_obs(observations),
            state=self._state,
            episode_start=np.full(len(observations), self._fresh),
            deterministic=True,
        )
        self._fresh = False
        return actions
