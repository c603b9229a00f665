"""Every registered environment of navgym passes the same checks, found through the registry."""

import copy
import doctest
import importlib.util
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode

import navgym

DRAWS = importlib.util.find_spec("matplotlib") is not None  # of the extra "render"
IDS = sorted(name for name in gymnasium.registry if name.startswith("navgym/"))


def make(name, **arguments):
    return gymnasium.make(name, **arguments).unwrapped


def play(env, actions, seed):
    """Everything that an episode returns under `actions`."""
    seen = [env.reset(seed=seed)]
    for action in actions:
        seen.append(env.step(action))
        if seen[-1][2] or seen[-1][3]:
            seen.append(env.reset())
    return seen


def some_actions(env, count, seed=0):
    env.action_space.seed(seed)
    return [env.action_space.sample() for _ in range(count)]


def test_importing_navgym_registers_something_and_twice_changes_nothing():
    assert IDS
    before = dict(gymnasium.registry)
    importlib.reload(navgym)
    assert dict(gymnasium.registry) == before


@pytest.mark.parametrize("name", IDS)
class TestEveryEnvironment:
    def test_gymnasium_checker_finds_nothing(self, name):
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            check_env(make(name, render_mode="rgb_array"), skip_render_check=not DRAWS)

    def test_stable_baselines3_checker_finds_nothing(self, name):
        checker = pytest.importorskip("stable_baselines3.common.env_checker")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            checker.check_env(make(name))

    def test_same_seed_and_actions_give_the_same_episode(self, name):
        actions = some_actions(make(name), 30)
        assert data_equivalence(play(make(name), actions, 3), play(make(name), actions, 3))

    def test_another_seed_gives_another_episode(self, name):
        actions = some_actions(make(name), 3)
        assert not data_equivalence(play(make(name), actions, 3), play(make(name), actions, 4))

    @pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
    def test_a_copy_in_mid_episode_goes_on_alike_and_alone(self, name, duplicate):
        env = make(name)
        actions = some_actions(env, 20)
        play(env, actions[:10], 5)
        other = duplicate(env)
        ahead = [env.step(a) for a in actions[10:]]
        assert data_equivalence(ahead, [other.step(a) for a in actions[10:]])

    def test_observations_and_actions_stay_in_their_spaces(self, name):
        env = make(name)
        for outcome in play(env, some_actions(env, 200), 1):
            assert env.observation_space.contains(outcome[0])

    @pytest.mark.parametrize("count", [1, 3, 8])
    def test_each_lane_of_a_batch_is_a_single_environment(self, name, count):
        batch = gymnasium.make_vec(name, num_envs=count)
        single = make(name)
        assert batch.single_observation_space == single.observation_space
        assert batch.single_action_space == single.action_space
        rng = np.random.default_rng(0)
        shape = (40, count, *single.action_space.shape)
        actions = rng.uniform(-1, 1, shape).astype(np.float32)
        lane = count - 1
        observations, _ = batch.reset(seed=11)
        expected, _ = single.reset(seed=11 + lane)
        np.testing.assert_array_equal(observations[lane], expected)
        for action in actions:
            step = batch.step(action)
            one = single.step(action[lane])
            np.testing.assert_array_equal(step[0][lane], one[0])
            assert (step[1][lane], step[2][lane], step[3][lane]) == one[1:4]
            assert all(
                np.array_equal(step[4][key][lane], value, equal_nan=True)
                for key, value in one[4].items()
            )

    def test_a_list_seeds_each_lane(self, name):
        first = gymnasium.make_vec(name, num_envs=3).reset(seed=[7, 5, 7])[1]["seed"]
        assert first[0] == first[2] != first[1]

    def test_lanes_restart_on_the_step_after_their_end(self, name):
        batch = gymnasium.make_vec(name, num_envs=2, max_episode_steps=3)
        assert batch.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        batch.reset(seed=0)
        action = batch.action_space.sample()
        for _ in range(2):
            assert not batch.step(action)[3].any()
        assert batch.step(action)[3].all()
        _, rewards, terminated, truncated, infos = batch.step(action)
        assert not rewards.any()
        assert not terminated.any()
        assert not truncated.any()
        assert infos["_seed"].all()
        assert not infos["_reward_term"].any()

    def test_lanes_may_restart_on_the_step_that_ends_them(self, name):
        """`SameStep`: the same episodes as with `NextStep`, without the empty step between two."""
        same = gymnasium.make_vec(name, num_envs=2, max_episode_steps=3, autoreset_mode="SameStep")
        assert same.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
        later = gymnasium.make_vec(name, num_envs=2, max_episode_steps=3)
        later.reset(seed=4)
        observations, _ = same.reset(seed=4)
        rng = np.random.default_rng(2)
        for _ in range(2):
            for k in range(3):
                action = rng.uniform(-1, 1, same.action_space.shape).astype(np.float32)
                observations, rewards, _, truncated, infos = same.step(action)
                expected = later.step(action)
                np.testing.assert_array_equal(rewards, expected[1])
                assert truncated.all() == (k == 2)
            np.testing.assert_array_equal(infos["final_obs"], expected[0])
            assert infos["_final_obs"].all()
            assert not infos["_reward_term"].any()
            for key, values in infos["final_info"].items():
                np.testing.assert_array_equal(values, expected[4][key])
            fresh, _, _, _, labels = later.step(action)
            np.testing.assert_array_equal(observations, fresh)
            np.testing.assert_array_equal(infos["seed"], labels["seed"])

    def test_a_mask_resets_some_lanes(self, name):
        batch = gymnasium.make_vec(name, num_envs=3, max_episode_steps=2, autoreset_mode="Disabled")
        with pytest.raises(RuntimeError, match="all lanes before"):
            batch.reset(options={"reset_mask": np.array([True, False, False])})
        batch.reset(seed=1)
        action = np.zeros(batch.action_space.shape, np.float32)
        first = batch.step(action)[0]
        observations, infos = batch.reset(seed=[5, 6, 7], options={"reset_mask": np.array([False, True, False])})  # fmt: skip
        np.testing.assert_array_equal(observations[[0, 2]], first[[0, 2]])
        assert infos["_seed"].tolist() == [False, True, False]
        alone = gymnasium.make_vec(name, num_envs=1).reset(seed=6)[0]
        np.testing.assert_array_equal(observations[1], alone[0])
        assert batch.step(action)[3].tolist() == [True, False, True]
        with pytest.raises(RuntimeError, match=r"\[0, 2\] have ended.*reset_mask"):
            batch.step(action)
        with pytest.raises(ValueError, match="boolean for each of 3 lanes"):
            batch.reset(options={"reset_mask": [1, 0, 0]})
        with pytest.raises(ValueError, match="'NextStep'"):
            gymnasium.make_vec(name, num_envs=1, autoreset_mode="sometimes")

    def test_the_manual_has_gymnasiums_sections_and_its_examples_run(self, name):
        manual = type(make(name)).__doc__
        for section in (
            "Description", "Action Space", "Observation Space", "Rewards", "Starting State",
            "Episode End", "Arguments", "Version History",
        ):  # fmt: skip
            assert f"## {section}" in manual
        found = doctest.DocTestFinder().find(type(make(name)), name)
        results = [doctest.DocTestRunner(verbose=False).run(test) for test in found]
        assert sum(r.attempted for r in results) > 0
        assert sum(r.failed for r in results) == 0

    def test_the_manual_tells_the_true_size_of_an_observation(self, name):
        env = make(name)
        manual = type(env).__doc__
        length = len(env.engine.observation_names)
        actions = env.action_space.shape[0]
        assert f"({length - actions} + k,)" in manual
        assert env.observation_space.shape == (length,)

    def test_stepping_before_reset_or_after_the_end_says_what_to_do(self, name):
        env = make(name)
        with pytest.raises(RuntimeError, match="call reset"):
            env.step(env.action_space.sample())
        with pytest.raises(RuntimeError, match="call reset"):
            gymnasium.make_vec(name, num_envs=2).step(np.zeros((2, *env.action_space.shape)))

    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_an_action_that_is_no_number_is_refused_and_changes_nothing(self, name, bad):
        env = make(name)
        env.reset(seed=0)
        action = env.action_space.sample()
        twin = copy.deepcopy(env)
        broken = action.copy()
        broken[-1] = bad
        with pytest.raises(ValueError, match="action must be numbers"):
            env.step(broken)
        assert data_equivalence(env.step(action), twin.step(action))

    def test_an_action_of_the_wrong_shape_is_refused(self, name):
        env = make(name)
        env.reset(seed=0)
        with pytest.raises(ValueError, match="action must have"):
            env.step(np.zeros(99, dtype=np.float32))

    def test_a_picture_shows_something(self, name):
        pytest.importorskip("matplotlib")
        env = make(name, render_mode="rgb_array")
        env.reset(seed=0)
        env.step(env.action_space.sample())
        picture = env.render()
        assert picture.dtype == np.uint8
        assert picture.ndim == 3
        assert picture.std() > 1.0

    def test_a_batch_draws_each_lane_as_a_single_environment_would(self, name):
        pytest.importorskip("matplotlib")
        batch = gymnasium.make_vec(name, num_envs=2, render_mode="rgb_array")
        single = make(name, render_mode="rgb_array")
        batch.reset(seed=4)
        single.reset(seed=5)
        for action in some_actions(single, 3):
            batch.step(np.stack([action, action]))
            single.step(action)
        pictures = batch.render()
        assert len(pictures) == 2
        np.testing.assert_array_equal(pictures[1], single.render())
        assert not np.array_equal(*pictures)
        batch.close()

    def test_the_true_regime_is_shown_only_where_it_is_asked_for(self, name):
        hidden, told = make(name), make(name, context="regime")
        before, after = (env.reset(seed=2)[0] for env in (hidden, told))
        count = len(after) - len(before)
        assert count >= 1
        for action in some_actions(hidden, 30):
            before, after = hidden.step(action), told.step(action)
            np.testing.assert_array_equal(after[0][:-count], before[0])
            np.testing.assert_array_equal(after[0][-count:], np.arange(count) == after[4]["regime"])
            assert after[1] == before[1]
            if after[2] or after[3]:
                break

    def test_jitter_costs_as_far_as_parameters_move_and_nothing_where_they_stand(self, name):
        quiet, dear = make(name), make(name, jitter=0.5)
        for env in (quiet, dear):
            env.reset(seed=3)
        first, last = some_actions(quiet, 2)
        rows = []
        for action in (first, first, last):
            a, b = quiet.step(action), dear.step(action)
            rows.append([a[4][n] for n in dear.engine.settings.action_parameters])
            cost = a[1] - b[1]
            if len(rows) > 1:
                space = dear.engine.space
                ways = [
                    abs(space[n].warp(x) - space[n].warp(y))
                    for n, x, y in zip(
                        dear.engine.settings.action_parameters, *rows[-2:], strict=True
                    )
                ]
                assert cost == pytest.approx(0.5 * np.mean(ways), abs=1e-9)
        assert rows[0] == rows[1] != rows[2]

    def test_residual_actions_start_from_the_reference_of_the_recording_that_is_played(self, name):
        env = make(name)
        steered = env.engine.settings.action_parameters
        space, scenario = env.engine.space, env.engine._scenarios[0]
        recordings = [navgym.simulate(scenario, seed=seed) for seed in (1, 2)]
        ends = [
            {n: space[n].show(space[n].unwarp(s * space[n].warp(space[n].high) + (1 - s) * space[n].warp(space[n].low)))
             for n in steered}
            for s in (0.25, 0.75)
        ]  # fmt: skip
        env = make(name, recordings=recordings, reference=ends, action="residual")
        for i, values in enumerate(ends):
            env.reset(seed=0, options={"recording": i})
            info = env.step(np.zeros(len(steered), np.float32))[4]
            assert [info[n] for n in steered] == pytest.approx(list(values.values()), rel=1e-4)
            alone = make(name, recording=recordings[i], reference=values, action="residual")
            alone.reset(seed=0)
            same = alone.step(np.zeros(len(steered), np.float32))[4]
            assert [info[n] for n in steered] == pytest.approx([same[n] for n in steered], rel=1e-4)
        with pytest.raises(ValueError, match="reference must be one set of parameters, or"):
            make(name, recordings=recordings, reference=ends[:1], action="residual")
