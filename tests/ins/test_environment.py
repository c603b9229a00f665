"""`navgym/INSDropout-v0`: what its lanes see and earn, checked against runs of the filter."""

import gymnasium
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import navgym  # noqa: F401 - registers the environments
from navgym.ins.kernels import CHANGE_UNIT, VELOCITY_UNIT
from navgym.ins.layout import PHI, V
from navgym.problem import PROBLEMS
from navgym.simulation import simulate_many

INS = PROBLEMS["ins"]
HOLD = {"fill": "hold", "fill_variance": 0.3, "fill_growth": 0.01}
OUTAGE = (80.0, 60.0)  # s: to the end and beyond
WARMUP = 60


@pytest.fixture(scope="module")
def recording():
    """Two minutes, of which the log is silent for the last 40 s."""
    return simulate_many("ins/outage", [4], duration=120.0, outages=(OUTAGE,))[0]


def played(recording, actions, reward="relative"):
    """Observations, rewards and infos of one episode, and the engine."""
    env = gymnasium.make(
        "navgym/INSDropout-v0",
        recording=recording,
        reference=HOLD,
        reward=reward,
        action="residual",
    )
    obs, _ = env.reset(seed=0)
    seen, rewards = [obs], []
    for action in actions:
        obs, reward, terminated, truncated, _ = env.step(np.array([action], np.float32))
        seen.append(obs)
        rewards.append(reward)
        if terminated or truncated:
            break
    return np.array(seen), np.array(rewards), env.unwrapped.engine


def run(recording, parameters, everything=False, interval=None):
    return INS.run("ins_kf", INS.stack([recording]), parameters, interval, everything)


def squares(recording, states, first):
    """Squared errors of horizontal position or velocity (first = 0 or 3) after each step."""
    return ((states[0, :, first : first + 2] - recording.truth[:, first : first + 2]) ** 2).sum(1)


def test_the_twin_says_what_a_filter_without_a_fill_says(recording):
    seen, _, engine = played(recording, np.zeros(60))
    names = list(engine.observation_names)
    alone = run(recording, HOLD | {"fill": "skip"}, everything=True)
    k = recording.steps - 1
    log = recording.aiding["dvl"]
    held = log.values[np.flatnonzero(~log.lost)[-1]]
    body = (
        Rotation.from_euler("ZYX", alone.states[0, k, PHI][::-1]).inv().apply(alone.states[0, k, V])
    )
    change = np.linalg.norm((body - held)[:2]) / CHANGE_UNIT
    assert seen[-1][names.index("twin.change")] == pytest.approx(change, rel=1e-5)
    P = alone.covariances[0, k]
    spread = 0.5 * np.log(0.5 * (P[3, 3] + P[4, 4]) / VELOCITY_UNIT**2)
    assert seen[-1][names.index("twin.spread")] == pytest.approx(spread, rel=1e-5)
    assert seen[-1][names.index("spread")] < spread - 0.5


def test_the_twin_does_not_depend_on_the_agent(recording):
    names = None
    found = []
    for action in (-1.0, 1.0):
        seen, _, engine = played(recording, np.full(60, action))
        names = list(engine.observation_names)
        found.append(seen[:, [names.index("twin.change"), names.index("twin.spread")]])
    np.testing.assert_array_equal(*found)


def test_a_velocity_reward_adds_up_to_what_is_left_of_the_references_error(recording):
    _, rewards, engine = played(recording, np.full(60, 0.5))
    own = run(recording, schedule(engine, 0.5), interval=1).states
    reference = run(recording, HOLD).states
    ends = [squares(recording, s, 3)[WARMUP * 5 :].mean() for s in (own, reference)]
    assert rewards.mean() == pytest.approx(1.0 - ends[0] / ends[1], rel=1e-6)
    assert abs(rewards.mean()) > 1e-3


def test_a_position_reward_adds_up_to_the_errors_at_the_end(recording):
    _, rewards, engine = played(recording, np.full(60, 0.5), "position")
    own = squares(recording, run(recording, schedule(engine, 0.5), interval=1).states, 0)
    reference = squares(recording, run(recording, HOLD).states, 0)
    gained = (reference[-1] - own[-1]) / reference[WARMUP * 5 :].mean()
    assert rewards.sum() == pytest.approx(gained, rel=1e-6)
    assert abs(gained) > 1e-3


@pytest.mark.parametrize("reward", ["relative", "position", "likelihood"])
def test_doing_what_the_reference_does_earns_nothing(recording, reward):
    _, rewards, _ = played(recording, np.zeros(60), reward)
    np.testing.assert_allclose(rewards, 0.0, atol=1e-6)


def test_the_largest_variance_is_as_good_as_nothing(recording):
    wide = run(recording, HOLD | {"fill_variance": 1000.0}).states[0, -1, V]
    nothing = run(recording, {"fill": "skip"}).states[0, -1, V]
    held = run(recording, HOLD).states[0, -1, V]
    assert np.linalg.norm(wide - nothing) < 0.02 * np.linalg.norm(held - nothing)


def schedule(engine, action):
    """Parameters per filter step of an episode under one action all along."""
    row = engine.stations["row"][0]
    chosen = engine.space.index("fill_variance")
    assert row[chosen] != pytest.approx(HOLD["fill_variance"]), action
    steps = int(engine.stations["length"][0])
    values = np.where(np.arange(steps) < WARMUP * 5, HOLD["fill_variance"], row[chosen])
    return [HOLD | {"fill_variance": values}]
