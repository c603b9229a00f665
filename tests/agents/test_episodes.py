"""Episodes kept as a Minari data set come back as they were played."""

import numpy as np
import pytest

import navgym  # noqa: F401
from navgym import agents
from navgym.agents import episodes

TASK = {"scenario": "auv/switch-D", "overrides": {"steps": 60}}


def test_episodes_by_a_policy_come_back_from_minari_with_their_environment(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    policy = agents.shipped("auv")
    task = dict(TASK, **{n: policy.manifest.settings[n] for n in ("action", "action_parameters")})
    made = episodes.played("navgym/AUVDropout-v0", policy, 2, seed=5, **task)
    episodes.to_minari("navgym/test-v0", "navgym/AUVDropout-v0", policy, 2, seed=5, **task)
    read = minari.load_dataset("navgym/test-v0")
    assert read.total_episodes == 2
    for one, other in zip(made, read.iterate_episodes(), strict=True):
        np.testing.assert_array_equal(one.observations, other.observations)
        np.testing.assert_array_equal(one.actions, other.actions)
        np.testing.assert_array_equal(one.rewards, other.rewards)
        assert bool(other.terminations[-1]) == one.terminated
        assert len(one.info["rmse"]) == len(one.rewards) == 12
    env = read.recover_environment()
    again, _ = env.reset(seed=5)
    np.testing.assert_array_equal(again, made[0].observations[0])
    np.testing.assert_array_equal(env.step(made[0].actions[0])[0], made[0].observations[1])


def test_random_episodes_repeat_and_a_count_of_none_is_refused():
    one, other = (episodes.played("navgym/AUVDropout-v0", None, 1, **TASK)[0] for _ in range(2))
    np.testing.assert_array_equal(one.actions, other.actions)
    assert np.ptp(one.actions) > 0.5
    with pytest.raises(ValueError, match="count must be"):
        episodes.played("navgym/AUVDropout-v0", None, 0)
