"""How fast agents learn and act, against plain Stable-Baselines3 in the same run."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecMonitor, VecNormalize

import navgym
from navgym.agents.combiner.combiner import BANK, Combiner
from navgym.agents.live.streaming import SelfTuningFilter
from navgym.agents.policies.manifest import Manifest
from navgym.agents.policies.policy import PRETRAINED, Policy, shipped
from navgym.agents.training import learners
from navgym.agents.training.configuration import Configuration
from navgym.agents.training.material import material
from navgym.agents.training.vec_env import LaneVecEnv
from navgym.tuning.benchmarks.timing import Row, measured, paired
from navgym.tuning.cases import Cases

FEW = 16  # single environments that stand for the usual way
CALLS = 2000
POOL = 64


def agents(rounds: int) -> list[Row]:
    """Every row; `rounds` turns per pair."""
    config = replace(Configuration(), pool=POOL)
    lanes = material(config).env
    singles = DummyVecEnv([functools.partial(_single, config) for _ in range(FEW)])
    parts = (
        functools.partial(steps, config, lanes, singles),
        functools.partial(learning, config, lanes, singles),
        functools.partial(acting, config, lanes),
    )
    named = [functools.update_wrapper(part, part.func) for part in parts]
    return measured([*named, streaming, combining], rounds)


def _single(config: Configuration) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(config.environment, pool=POOL, **config.environment_arguments())


def steps(config: Configuration, lanes: LaneVecEnv, singles: VecEnv, rounds: int) -> Row:
    """Decisions per second of the two ways to step many environments, without learning."""
    mine, other, _ = paired(_stepping(lanes, 160), _stepping(singles, 160), rounds)
    ours, theirs = config.lanes * 160 / mine, FEW * 160 / other
    return Row(
        f"VecEnv of {config.lanes} lanes against DummyVecEnv of {FEW}, stepping only",
        "told",
        f"{ours / theirs:.1f}x ({ours:,.0f} against {theirs:,.0f} decisions/s)",
    )


def _stepping(env: VecEnv, count: int) -> Callable[[], None]:
    monitored = VecMonitor(env)
    monitored.reset()
    rng = np.random.default_rng(0)
    shape = (env.num_envs, *(env.action_space.shape or ()))
    actions = rng.uniform(-1.0, 1.0, shape).astype(np.float32)

    def task() -> None:
        for _ in range(count):
            monitored.step(actions)

    return task


def learning(config: Configuration, lanes: LaneVecEnv, singles: VecEnv, rounds: int) -> Row:
    """Decisions per second of PPO, collecting and learning, updates of one size in both."""
    update = config.lanes * config.recipe.steps
    other_config = replace(config, lanes=FEW, recipe=replace(config.recipe, steps=update // FEW))
    ours = _updating(learners.learner(config, learners.normalised(config, lanes)), update)
    usual = VecNormalize(VecMonitor(singles), clip_obs=config.recipe.clip_observation)
    theirs = _updating(learners.learner(other_config, usual), update)
    mine, other, ratio = paired(ours, theirs, rounds)
    return Row(
        f"PPO on {config.lanes} lanes against PPO on DummyVecEnv of {FEW}, "
        f"{config.threads} thread of torch",
        "at least 10,000 decisions/s",
        f"{ratio:.1f}x ({update / mine:,.0f} against {update / other:,.0f} decisions/s)",
    )


def _updating(model: BaseAlgorithm, decisions: int) -> Callable[[], None]:
    def task() -> None:
        model.learn(decisions, reset_num_timesteps=False)

    return task


def acting(config: Configuration, lanes: LaneVecEnv, rounds: int) -> Row:
    """Time of one decision: the portable policy against the learner's own prediction."""
    normaliser = learners.normalised(config, lanes)
    model = learners.learner(config, normaliser)
    policy = Policy.from_sb3(model, normaliser, Manifest.of(config.environment, lanes.engine, {}))
    observation = np.zeros(len(policy.low), dtype=np.float32)

    def predict() -> None:
        for _ in range(CALLS // 10):
            model.predict(normaliser.normalize_obs(observation), deterministic=True)

    def act() -> None:
        for _ in range(CALLS):
            policy.parameters(observation)

    mine, other, _ = paired(act, predict, rounds)
    own, theirs = 1e6 * mine / CALLS, 1e6 * other / (CALLS // 10)
    return Row(
        "one decision: Policy.parameters (numpy) against Stable-Baselines3's predict",
        "under 20 µs",
        f"{theirs / own:.0f}x ({own:.1f} against {theirs:.0f} µs)",
    )


def streaming(rounds: int) -> list[Row]:
    """Time of one sample of a self-tuning filter, against its kernel on a whole recording."""
    return [
        _streaming("qivbf", shipped("auv"), "auv/switch-D", "at most 8 µs", rounds),
        _streaming(
            "idam", shipped("deck"), "deck/switch-60", "at most 6 µs", rounds, duration=90.0
        ),
    ]


def _streaming(
    name: str, policy: Policy, scenario: str, wanted: str, rounds: int, **overrides: Any
) -> Row:
    recording = navgym.simulate(scenario, navgym.seeds("test", 1)[0], **overrides)
    model: Any = recording.model
    live = SelfTuningFilter(name, policy, model)

    def stream() -> None:
        live.reset()
        for _ in live.follow(recording):
            pass

    mine, other, ratio = paired(stream, lambda: navgym.estimate(name, recording), rounds)
    own, theirs = (1e6 * t / len(recording.time) for t in (mine, other))
    return Row(
        f"SelfTuningFilter of {name} (policy, fallback and the filter beside it), a sample, "
        f"against navgym.estimate on {scenario}",
        wanted,
        f"{1 / ratio:.0f}x ({own:.1f} against {theirs:.2f} µs)",
    )


def combining(rounds: int) -> Row:
    """What the learned combiner costs beyond the bank that it stands on."""
    cases = Cases.simulated("auv/switch-B", "test", 40)
    problem, batch = cases.problem, cases.batch
    combiner = Combiner.load(PRETRAINED / "combiner")
    steps = len(batch) * batch.steps
    mine, other, _ = paired(lambda: combiner.run(batch), lambda: problem.run(BANK, batch), rounds)
    return Row(
        "bank + combiner against bank, 40 series of 800, per step",
        "at most 5 µs more",
        f"{1e6 * (mine - other) / steps:.1f} µs more ({1e6 * other / steps:.1f} the bank)",
    )
