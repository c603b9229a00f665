"""Algorithms with discrete actions learn on the environments through Gymnasium's own wrapper."""

import gymnasium
import numpy as np
import pytest

import navgym

stable_baselines3 = pytest.importorskip("stable_baselines3")


def test_dqn_learns_on_discretised_actions_and_every_action_is_a_box_corner_or_between():
    from gymnasium.wrappers import DiscretizeAction

    recordings = [navgym.simulate("auv/switch-D", seed=seed, steps=100) for seed in range(4)]
    env = gymnasium.make(
        "navgym/AUVDropout-v0", recordings=recordings, action="residual",
        action_parameters=("process_noise_scale", "forgetting"), reward_clip=2.0,
    )  # fmt: skip
    narrow = DiscretizeAction(env, bins=3)
    assert isinstance(narrow.action_space, gymnasium.spaces.Discrete)
    assert narrow.action_space.n == 9
    model = stable_baselines3.DQN("MlpPolicy", narrow, learning_starts=64, seed=0, buffer_size=2000)
    before = [p.detach().clone() for p in model.policy.parameters()]
    model.learn(400)
    moved = [
        float((a - b).abs().max()) for a, b in zip(before, model.policy.parameters(), strict=True)
    ]
    assert max(moved) > 1e-3
    seen = set()
    for action in range(9):
        narrow.reset(seed=1)
        info = narrow.step(action)[4]
        seen.add((round(np.log(info["process_noise_scale"]), 3), round(info["forgetting"], 4)))
    assert len(seen) == 9
