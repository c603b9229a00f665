"""What DeckDeformation pays, shows and refuses, against navgym.estimate and by its own words."""

import dataclasses

import gymnasium
import numpy as np
import pytest

import navgym
from navgym.deck import spaces
from navgym.deck.environment import DeckDeformationEnv, DeckDeformationVectorEnv
from navgym.inertial.flexure import ARCMIN

ID = "navgym/DeckDeformation-v0"
TRUTH = (
    "theta",
    "theta_rate",
    "static",
    "attitude",
    "true_flexure",
    "impulse_variance",
    "impulse_left",
)
FAST = {"warmup": 10.0}


def recording_of(seed=0, scenario="deck/switch-60", **overrides):
    return navgym.simulate(
        scenario, seed=seed, **{"duration": 40.0, "dwell": (8.0, 8.0)} | overrides
    )


def alter(recording, **changes):
    return dataclasses.replace(recording, check_units=False, **changes)


def episode(env, actions, **options):
    env.reset(seed=0, options=options or None)
    return [env.step(a) for a in actions]


def square(estimate, recording):
    """Squared errors (K,) of θ̇ and θ, arcmin²."""
    rate = (estimate.theta_rate - recording.at_steps(recording.theta_rate)) / ARCMIN
    theta = (estimate.theta - recording.at_steps(recording.theta)) / ARCMIN
    keep, drift, fast = np.exp(-recording.step / 60.0), np.zeros(3), []
    for e in theta:
        drift = keep * drift + (1.0 - keep) * e
        fast.append(((e - drift) ** 2).sum())
    return (rate**2).sum(1), np.array(fast), (theta**2).sum(1)


@pytest.mark.parametrize("interval", [7, 20])
def test_an_episode_is_the_filter_run_on_a_schedule(interval):
    recording = recording_of(3)
    names = ("kernel_width", "velocity_noise", "model_error_weight", "process_noise_scale")
    env = DeckDeformationEnv(
        recordings=[recording], decision_interval=interval, action_parameters=names, **FAST
    )
    warm = 200
    decisions = -(-(recording.steps - warm) // interval)
    rng = np.random.default_rng(1)
    actions = rng.uniform(-0.5, 1, (decisions, 4)).astype(np.float32)
    outcomes = episode(env, actions)
    assert outcomes[-1][3]
    assert not any(o[3] for o in outcomes[:-1])
    reference = {n: v for n, v in env.engine.reference.items() if n in names}
    schedule = {
        n: np.concatenate(
            [np.full(warm, reference[n]), np.repeat([o[4][n] for o in outcomes], interval)]
        )[: recording.steps]
        for n in names
    }
    space = dict.fromkeys(("identification_window",), 600.0)
    own = navgym.estimate("idam", recording, schedule | space, decision_interval=1)
    base = navgym.estimate("idam", recording, reference | space)
    ours, theirs = square(own, recording), square(base, recording)
    means = [e[warm:].mean() for e in theirs]
    for i, outcome in enumerate(outcomes):
        part = slice(warm + i * interval, warm + (i + 1) * interval)
        rate, ac, theta = (
            (a[part] - b[part]).mean() / m for a, b, m in zip(ours, theirs, means, strict=True)
        )
        reward = np.clip(-(rate + 0.5 * ac + max(theta, 0.0)), -20, 20)
        assert outcome[1] == pytest.approx(reward, rel=1e-6, abs=1e-8)
        assert outcome[4]["theta_rate_rmse"] == pytest.approx(np.sqrt(ours[0][part].mean()))
        assert outcome[4]["reference_theta_rmse"] == pytest.approx(np.sqrt(theirs[2][part].mean()))


def test_a_residual_action_of_zero_is_the_reference_and_earns_nothing():
    env = DeckDeformationEnv(recordings=[recording_of()], action="residual", **FAST)
    outcomes = episode(env, np.zeros((30, 2), dtype=np.float32))
    assert all(abs(o[1]) < 1e-6 for o in outcomes)


def test_the_widest_kernel_is_the_plain_filter():
    recording = recording_of(4)
    env = DeckDeformationEnv(
        recordings=[recording], action_parameters=("kernel_width",),
        reference={"kernel_width": 50.0}, **FAST,
    )  # fmt: skip
    outcomes = episode(env, np.ones((30, 1), dtype=np.float32))
    assert all(o[4]["weight"] == 1.0 for o in outcomes)
    assert all(abs(o[1]) < 1e-6 for o in outcomes)


def test_observations_contain_no_truth():
    recording = recording_of(5)
    rng = np.random.default_rng(0)
    lied = alter(
        recording, theta=rng.standard_normal(recording.theta.shape),
        theta_rate=rng.standard_normal(recording.theta.shape),
        regime=rng.integers(0, 9, len(recording)), true_flexure=None, disturbance_variance=None,
    )  # fmt: skip
    env, liar = (
        DeckDeformationEnv(recordings=[r], reward="absolute", **FAST) for r in (recording, lied)
    )
    actions = rng.uniform(-1, 1, (25, 2)).astype(np.float32)
    honest, false = episode(env, actions), episode(liar, actions)
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(honest, false, strict=True))
    assert all(a[1] != b[1] for a, b in zip(honest, false, strict=True))


def test_observations_are_causal():
    recording = recording_of(6)
    changed = recording.sub_angle.copy()
    changed[2500:] += 1e-4
    actions = np.zeros((30, 2), dtype=np.float32)
    first, second = (
        episode(DeckDeformationEnv(recordings=[r], **FAST), actions)
        for r in (recording, alter(recording, sub_angle=changed))
    )
    same = [np.array_equal(a[0], b[0]) for a, b in zip(first, second, strict=True)]
    assert all(same[:15])
    assert not any(same[15:])


def test_gyro_features_are_the_others_without_the_velocity_channels():
    recording = recording_of(7)
    actions = np.random.default_rng(0).uniform(-1, 1, (20, 2)).astype(np.float32)
    everything, gyro = (
        DeckDeformationEnv(recordings=[recording], features=f, **FAST) for f in ("all", "gyro")
    )
    names = everything.engine.observation_names
    assert gyro.engine.observation_names == tuple(n for n in names if not n.startswith("velocity."))
    for a, b in zip(episode(everything, actions), episode(gyro, actions), strict=True):
        np.testing.assert_array_equal(a[0][6:], b[0])


def test_persistence_tells_a_glitch_that_passed_from_a_slam_that_was_rejected():
    """Negative: the next innovation corrects a swallowed glitch. Positive: the slam is still there."""
    seen = {}
    for scenario, width in (("deck/glitch", 1.0), ("deck/slam", -1.0)):
        recording = recording_of(1, scenario, duration=100.0)
        env = DeckDeformationEnv(recordings=[recording], action_parameters="kernel_width", **FAST)
        index = env.engine.observation_names.index("rate.persistence")
        actions = np.full((89, 1), width, dtype=np.float32)
        seen[scenario] = np.mean([o[0][index] for o in episode(env, actions)])
    assert seen["deck/glitch"] < 0.0 < seen["deck/slam"]


def test_likelihood_pays_recordings_without_truth_and_other_rewards_refuse_them():
    recording = recording_of(2)
    blind = alter(recording, **dict.fromkeys(TRUTH))
    with pytest.raises(ValueError, match="reward='likelihood'"):
        DeckDeformationEnv(recordings=[blind])
    env = DeckDeformationEnv(recordings=[blind], reward="likelihood", reward_clip=1e9, **FAST)
    outcomes = episode(env, np.zeros((5, 2), dtype=np.float32))
    width, noise = (outcomes[0][4][n] for n in ("kernel_width", "velocity_noise"))
    parameters = {
        "kernel_width": [10.0] * 10 + [width] * 5, "velocity_noise": [0.2] * 10 + [noise] * 5,
    }  # fmt: skip
    run = navgym.estimate("alignment_mcc", blind, parameters)
    reference = navgym.estimate("alignment_mcc", blind)
    for i, outcome in enumerate(outcomes):
        part = slice(200 + 20 * i, 220 + 20 * i)
        gain = run.log_likelihood[part] - reference.log_likelihood[part]
        assert outcome[1] == pytest.approx(gain.mean(), rel=1e-6, abs=1e-9)
        assert "theta_rmse" not in outcome[4]


def test_theta_is_not_traded_away():
    """A θ worse than the reference's costs; a better one earns nothing by itself."""
    worse = []
    for seed in range(4):
        arguments = {"recordings": [recording_of(seed)], "reward_clip": 1e9, **FAST}
        actions = np.full((25, 2), -0.5, dtype=np.float32)
        cheap, dear = (
            episode(DeckDeformationEnv(theta_price=p, **arguments), actions) for p in (0.0, 1.0)
        )
        for a, b in zip(cheap, dear, strict=True):
            worse.append(a[4]["theta_rmse"] > a[4]["reference_theta_rmse"])
            assert (a[1] - b[1] > 0.0) == worse[-1]
    assert 0 < sum(worse) < len(worse)


def test_a_diverging_lane_ends_with_the_worst_reward_and_leaves_others_alone():
    good = recording_of(1)
    absurd = good.disturbance.copy()
    absurd[300:] = 1e9
    bad = alter(good, disturbance=absurd)
    arguments = {"action_parameters": "kernel_width", **FAST}
    batch = DeckDeformationVectorEnv(4, recordings=[good, bad], **arguments)
    which = batch.reset(seed=3)[1]["recording"]
    assert {0, 1} == set(which)
    alone = episode(DeckDeformationEnv(recordings=[good], **arguments), np.ones((8, 1), np.float32))
    ended = np.zeros(4, dtype=bool)
    for k in range(8):
        observations, rewards, terminated, _, _ = batch.step(np.ones((4, 1), dtype=np.float32))
        assert np.isfinite(observations).all()
        assert not (terminated & (rewards != -20.0)).any()
        ended |= terminated
        for i in np.flatnonzero(which == 0):
            np.testing.assert_array_equal(observations[i], alone[k][0])
    np.testing.assert_array_equal(ended, which == 1)


def test_the_kernel_scale_makes_lanes_identify():
    recording = recording_of(0, "deck/paper", duration=130.0)
    window = {"identification_window": 60.0}
    plain = DeckDeformationEnv(recordings=[recording], reference=window, **FAST)
    identifying = DeckDeformationEnv(
        recordings=[recording], reference=window, action_parameters=("rvm_kernel_scale",), **FAST
    )
    believed = recording.model.flexure.transition(recording.step)
    for env in (plain, identifying):
        actions = np.zeros((120, env.action_space.shape[0]), dtype=np.float32)
        outcomes = episode(env, actions)
        assert outcomes[-1][3]
    assert np.array_equal(plain.engine.models["transition"][0, 0], believed)
    assert not np.array_equal(identifying.engine.models["transition"][0, 0], believed)


def test_a_lane_starts_where_the_reference_filter_is_after_the_warm_up():
    recording = recording_of(9)
    warm = DeckDeformationEnv(recordings=[recording], **FAST)
    cold = DeckDeformationEnv(recordings=[recording], **FAST)
    first, _ = warm.reset(seed=0)
    second, _ = cold.reset(seed=0, options={"start": 200})
    np.testing.assert_allclose(first, second, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(warm.engine.lanes["x"], cold.engine.lanes["x"])


def test_a_short_recording_starts_at_its_beginning():
    recording = recording_of(0, duration=8.0)
    env = DeckDeformationEnv(recordings=[recording])
    outcomes = episode(env, np.zeros((8, 2), dtype=np.float32))
    assert outcomes[-1][3]
    assert not outcomes[-2][3]


def test_recordings_of_different_lengths_end_at_their_own_end():
    recordings = [recording_of(0, duration=20.0), recording_of(1, duration=30.0)]
    env = DeckDeformationEnv(recordings=recordings, **FAST)
    for i, decisions in enumerate((10, 20)):
        outcomes = episode(env, np.zeros((decisions, 2), dtype=np.float32), recording=i)
        assert [o[3] for o in outcomes] == [False] * (decisions - 1) + [True]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": "deck/switch"}, "switch-60"),
        ({"scenario": "auv/switch-D"}, "another kind"),
        ({"action_parameters": ("kernel_with",)}, "kernel_width"),
        ({"action_parameters": ("identification_window",)}, "at the start only"),
        ({"reward": "difference"}, "composite"),
        ({"features": "gyros"}, "gyro"),
        ({"warmup": -1.0}, "warmup"),
        ({"ac_weight": -0.5}, "ac_weight"),
        ({"recordings": []}, "at least one"),
        ({"reference": {"kernel_width": [1.5, 2.0]}}, "one number"),
        ({"render_mode": "ansi"}, "rgb_array"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        gymnasium.make(ID, **arguments)


def test_the_actions_reach_the_whole_declared_range():
    env = DeckDeformationEnv(recordings=[recording_of()], **FAST)
    space = spaces.IDAM.subset(env.engine.settings.action_parameters)
    for end, action in ((0, -1.0), (1, 1.0)):
        env.reset(seed=0)
        info = env.step(np.full(2, action, dtype=np.float32))[4]
        for p in space:
            assert info[p.name] == pytest.approx((p.low, p.high)[end], rel=1e-6)


def test_the_likelihood_reward_tells_actions_apart_on_ship_grade_imus():
    env = DeckDeformationEnv(recordings=[recording_of()], reward="likelihood", **FAST)
    narrow, wide = (
        sum(o[1] for o in episode(env, np.full((30, 2), a, dtype=np.float32))) for a in (-1.0, 0.0)
    )
    assert narrow != wide


def test_one_recording_reaches_the_batch_and_two_ways_at_once_are_refused():
    recording = recording_of(3, duration=20.0)
    batch = gymnasium.make_vec(ID, num_envs=2, recordings=None, recording=recording, **FAST)
    assert list(batch.reset(seed=0)[1]["seed"]) == [3, 3]
    with pytest.raises(ValueError, match="not both"):
        gymnasium.make_vec(ID, num_envs=2, recordings=[recording], recording=recording)
