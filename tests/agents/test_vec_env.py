"""The face for Stable-Baselines3 is the same environment, lane by lane."""

import gymnasium
import numpy as np
import pytest

import navgym

pytest.importorskip("stable_baselines3")
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecCheckNan,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
)

from navgym.agents.training.vec_env import LaneVecEnv, lane_vec_env
from navgym.problem import problems

# of a problem without arguments of its own here: recordings of some decisions
ARGUMENTS = {
    p.environment.id: {"overrides": {name: 5 * value for name, value in p.brief.items()}}
    for p in problems()
} | {
    "navgym/AUVDropout-v0": {"overrides": {"steps": 42, "loss": 0.2}},
    "navgym/DeckDeformation-v0": {"overrides": {"duration": 14.0}, "warmup": 8.0},
}
IDS = sorted(ARGUMENTS)


def test_all_environments_are_covered():
    assert sorted(name for name in gymnasium.registry if name.startswith("navgym/")) == IDS


def actions_of(env, count, seed=0):
    rng = np.random.default_rng(seed)
    shape = (count, env.num_envs, *env.action_space.shape)
    return rng.uniform(-1.0, 1.0, shape).astype(np.float32)


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("pool", [None, 3])
def test_lanes_are_single_environments_bit_for_bit(name, pool):
    arguments = ARGUMENTS[name] | {"pool": pool}
    lanes = lane_vec_env(name, 3, information=True, **arguments)
    singles = DummyVecEnv([lambda: gymnasium.make(name, **arguments) for _ in range(3)])
    for env in (lanes, singles):
        env.seed(5)
    np.testing.assert_array_equal(lanes.reset(), singles.reset())
    ends = 0
    for action in actions_of(lanes, 20):
        one, other = lanes.step(action), singles.step(action)
        for mine, theirs in zip(one[:3], other[:3], strict=True):
            np.testing.assert_array_equal(mine, theirs)
            assert mine.dtype == theirs.dtype
        for info, single in zip(one[3], other[3], strict=True):
            assert info.keys() == single.keys()
            for key, value in single.items():
                np.testing.assert_array_equal(info[key], value)
        ends += int(one[2].sum())
    assert ends >= 3
    assert lanes.reset_infos == singles.reset_infos


@pytest.mark.parametrize("name", IDS)
def test_a_lane_is_the_same_in_any_company(name):
    found = []
    for count in (2, 5):
        env = lane_vec_env(name, count, **ARGUMENTS[name])
        env.seed(1)
        env.reset()
        actions = actions_of(env, 12)[:, :2]
        wide = np.zeros((12, count, actions.shape[2]), dtype=np.float32)
        wide[:, :2] = actions_of(lane_vec_env(name, 2, **ARGUMENTS[name]), 12)
        found.append([env.step(a)[0][:2] for a in wide])
    np.testing.assert_array_equal(*found)


def test_the_end_of_a_recording_is_a_truncation_with_its_last_observation():
    env = lane_vec_env(IDS[0], 2, **ARGUMENTS[IDS[0]])
    vector = gymnasium.make_vec(IDS[0], num_envs=2, **ARGUMENTS[IDS[0]])
    env.seed(3)
    env.reset()
    vector.reset(seed=3)
    action = np.zeros((2, *env.action_space.shape), dtype=np.float32)
    for _ in range(9):  # 42 samples in decisions of 5
        observations, rewards, dones, infos = env.step(action)
        last = vector.step(action)[0]
    assert dones.all()
    assert rewards.dtype == np.float32
    for i, info in enumerate(infos):
        assert info["TimeLimit.truncated"] is True
        np.testing.assert_array_equal(info["terminal_observation"], last[i])
        assert (observations[i] != last[i]).any()


def test_divergence_is_no_truncation():
    recording = navgym.simulate("auv/nominal", seed=0, steps=60)
    y = np.array(recording.measurements)
    y[20:] += 1e4 * np.arange(40)[:, None] ** 2
    wild = navgym.Recording(recording.time, y, truth=recording.truth, model=recording.model)
    env = lane_vec_env(IDS[0], 1, recordings=[wild])
    env.seed(0)
    env.reset()
    action = np.full((1, *env.action_space.shape), -1.0, dtype=np.float32)
    for _ in range(12):
        _, rewards, dones, infos = env.step(action)
        if dones[0]:
            break
    assert infos[0]["TimeLimit.truncated"] is False
    assert rewards[0] == -20.0


def test_a_limit_on_decisions_truncates():
    env = lane_vec_env(IDS[0], 2, max_episode_steps=4, **ARGUMENTS[IDS[0]])
    env.seed(0)
    env.reset()
    ends = [env.step(a)[2].all() for a in actions_of(env, 8)]
    assert ends == [False, False, False, True] * 2


@pytest.mark.parametrize("name", IDS)
def test_scattered_lanes_go_on_as_lanes_started_there(name):
    env = lane_vec_env(name, 6, desynchronise=True, pool=2, **ARGUMENTS[name])
    env.seed(0)
    observations = env.reset()
    places, which = (env.engine.stations[f].copy() for f in ("k", "which"))
    assert len(set(places.tolist())) > 3
    actions = actions_of(env, 1)[0]
    following = env.step(actions)[0]
    plain = lane_vec_env(name, 6, pool=2, **ARGUMENTS[name])
    begun = lane_vec_env(name, 1, pool=2, **ARGUMENTS[name]).engine.shelf.stations["k"]
    plain.set_options(
        [
            {"recording": int(w)} | ({} if k == begun[w] else {"start": int(k)})
            for k, w in zip(places, which, strict=True)
        ]
    )
    np.testing.assert_array_equal(plain.reset(), observations)
    own = plain.step(actions)[0]
    same = env.engine.stations["k"] == plain.engine.stations["k"]  # the others have restarted
    np.testing.assert_array_equal(own[same], following[same])
    assert same.sum() >= 3


def test_lanes_are_scattered_once_and_within_one_decision_of_the_end():
    env = lane_vec_env(IDS[0], 40, desynchronise=True, pool=2, **ARGUMENTS[IDS[0]])
    env.seed(0)
    env.reset()
    assert env.engine.stations["k"].max() <= 37
    env.reset()
    assert not env.engine.stations["k"].any()


def test_seeds_count_once_and_give_the_same_again():
    env = lane_vec_env(IDS[0], 2, **ARGUMENTS[IDS[0]])
    env.seed(4)
    env.reset()
    first = [label["seed"] for label in env.reset_infos]
    env.reset()
    second = [label["seed"] for label in env.reset_infos]
    env.seed(4)
    env.reset()
    assert [label["seed"] for label in env.reset_infos] == first != second


@pytest.mark.parametrize("name", IDS)
def test_restored_lanes_go_on_as_if_nothing_had_happened(name):
    env = lane_vec_env(name, 3, pool=2, **ARGUMENTS[name])
    env.seed(0)
    env.reset()
    actions = actions_of(env, 14)
    for action in actions[:4]:
        env.step(action)
    seen, counters = env.engine.snapshot(), env.counters()
    states = [env.engine.generator(i).bit_generator.state for i in range(3)]
    wanted = [env.step(a)[:3] for a in actions[4:]]
    other = lane_vec_env(name, 3, pool=2, **ARGUMENTS[name])
    other.reset()
    other.engine.restore(seen)
    other.restore(counters)
    for i, state in enumerate(states):
        other.engine.generator(i).bit_generator.state = state
    for action, expected in zip(actions[4:], wanted, strict=True):
        for mine, theirs in zip(other.step(action)[:3], expected, strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_a_snapshot_of_another_engine_is_refused():
    env = lane_vec_env(IDS[0], 3, **ARGUMENTS[IDS[0]])
    with pytest.raises(ValueError, match="of another engine"):
        lane_vec_env(IDS[0], 2, **ARGUMENTS[IDS[0]]).engine.restore(env.engine.snapshot())


class Counting(BaseCallback):
    """Counts steps and episodes that it hears of."""

    def __init__(self):
        super().__init__()
        self.steps = self.episodes = 0

    def _on_step(self):
        self.steps += self.training_env.num_envs
        self.episodes += sum("episode" in info for info in self.locals["infos"])
        return True


def test_wrappers_callbacks_and_evaluation_of_stable_baselines3_work():
    env = VecNormalize(VecMonitor(VecCheckNan(lane_vec_env(IDS[0], 4, **ARGUMENTS[IDS[0]]))))
    callback = Counting()
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=32, n_epochs=1, device="cpu", seed=0)
    model.learn(128, callback=callback)
    assert callback.steps == 128
    assert callback.episodes == 4 * (32 // 9)
    mean, spread = evaluate_policy(model, env, n_eval_episodes=4)
    assert np.isfinite([mean, spread]).all()
    stacked = VecFrameStack(lane_vec_env(IDS[0], 2, **ARGUMENTS[IDS[0]]), 3)
    assert stacked.reset().shape == (2, 3 * env.observation_space.shape[0])


def test_single_environments_agree_with_the_batch_on_spaces():
    env = lane_vec_env(IDS[0], 2, **ARGUMENTS[IDS[0]])
    single = gymnasium.make(IDS[0], **ARGUMENTS[IDS[0]])
    assert env.observation_space == single.observation_space
    assert env.action_space == single.action_space
    assert isinstance(env.unwrapped, LaneVecEnv)


class TestWhatIsAskedOfTheLanes:
    @pytest.fixture
    def env(self):
        env = lane_vec_env(IDS[0], 3, **ARGUMENTS[IDS[0]])
        env.seed(0)
        env.reset()
        return env

    def test_attributes_of_face_and_engine(self, env):
        assert env.get_attr("render_mode") == [None] * 3
        assert env.get_attr("count", indices=[0, 2]) == [3, 3]
        assert env.get_attr("num_envs", indices=1) == [3]
        with pytest.raises(AttributeError, match="nonsense"):
            env.get_attr("nonsense")
        assert not env.has_attr("nonsense")

    def test_attributes_are_set_for_all_or_none(self, env):
        env.set_attr("information", True)
        assert env.get_attr("information") == [True] * 3
        with pytest.raises(ValueError, match="share one engine"):
            env.set_attr("information", False, indices=[0])

    def test_methods_take_the_lane_first(self, env):
        assert env.env_method("label", indices=[1]) == [env.reset_infos[1]]

    def test_no_lane_is_wrapped(self, env):
        assert env.env_is_wrapped(gymnasium.Wrapper) == [False] * 3

    def test_the_latest_information_is_that_of_the_infos(self, env):
        env.information = True
        with pytest.raises(RuntimeError, match="step"):
            env.latest("rmse")
        infos = env.step(actions_of(env, 1)[0])[3]
        np.testing.assert_array_equal(env.latest("rmse"), [info["rmse"] for info in infos])
        with pytest.raises(ValueError, match="Did you mean 'rmse'"):
            env.latest("rmsee")

    def test_infos_are_bare_by_default(self, env):
        assert env.step(actions_of(env, 1)[0])[3] == [{}] * 3

    def test_results_are_not_overwritten_by_the_next_step(self, env):
        first = env.step(actions_of(env, 1)[0])
        kept = [np.copy(x) for x in first[:3]]
        env.step(actions_of(env, 1, seed=1)[0])
        for before, now in zip(kept, first[:3], strict=True):
            np.testing.assert_array_equal(before, now)

    def test_misuse_is_named(self, env):
        env.set_options({"begin": 3})
        with pytest.raises(ValueError, match="unknown option of reset"):
            env.reset()
        with pytest.raises(ValueError, match="action must have shape"):
            env.step(np.zeros((2, 4), dtype=np.float32))
        with pytest.raises(ValueError, match=r"numbers in -1\.\.1"):
            env.step(np.full((3, 4), np.nan, dtype=np.float32))
        with pytest.raises(ValueError, match="max_episode_steps"):
            lane_vec_env(IDS[0], 1, max_episode_steps=0)
        with pytest.raises(RuntimeError, match=r"reset\(\)"):
            lane_vec_env(IDS[0], 1).step(np.zeros((1, 4), dtype=np.float32))
