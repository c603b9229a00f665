"""What AUVDropout pays, shows and refuses, against navgym.estimate and by its own words."""

import gymnasium
import numpy as np
import pytest

import navgym
from navgym.auv.environment import AUVDropoutEnv, AUVDropoutVectorEnv
from navgym.statespace.filters import spaces

ID = "navgym/AUVDropout-v0"


def recording_of(seed=0, scenario="auv/switch-D", **overrides):
    return navgym.simulate(scenario, seed=seed, **{"steps": 200} | overrides)


def without_truth(recording, **changes):
    fields = {
        name: getattr(recording, name) for name in ("time", "measurements", "lost", "model", "meta")
    }
    return navgym.Recording(**fields | changes)


def episode(env, actions):
    env.reset(seed=0)
    return [env.step(a) for a in actions]


def square_error(estimate, recording):
    position = list(recording.model.position)
    return ((estimate.states - recording.truth)[:, position] ** 2).sum(axis=1)


@pytest.mark.parametrize("interval", [1, 5, 7])
def test_an_episode_is_the_filter_run_on_a_schedule(interval):
    recording = recording_of(3, loss=0.3)
    names = ("vb_iterations", "prior_count", "forgetting", "process_noise_scale", "fill")
    env = AUVDropoutEnv(recordings=[recording], decision_interval=interval, action_parameters=names)
    decisions = -(-len(recording) // interval)
    actions = np.random.default_rng(1).uniform(-1, 1, (decisions, len(names))).astype(np.float32)
    outcomes = episode(env, actions)
    assert outcomes[-1][3]
    assert not any(o[3] for o in outcomes[:-1])
    schedule = {n: [o[4][n] for o in outcomes] for n in names}
    reference = env.engine.reference
    fixed = {n: v for n, v in reference.items() if n not in names}
    run = navgym.estimate("qivbf", recording, fixed | schedule, decision_interval=interval)
    errors = square_error(run, recording)
    base = square_error(navgym.estimate("qivbf", recording, reference), recording)
    for i, outcome in enumerate(outcomes):
        part = slice(i * interval, (i + 1) * interval)
        reward = np.clip(-(errors[part] - base[part]).mean(), -20, 20)
        assert outcome[1] == pytest.approx(reward, rel=1e-9, abs=1e-12)
        assert outcome[4]["rmse"] == pytest.approx(np.sqrt(errors[part].mean()), rel=1e-9)


def test_actions_map_through_the_parameter_space():
    env = AUVDropoutEnv()
    space = spaces.QIVBF.subset(env.engine.settings.action_parameters)
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(20):
        action = rng.uniform(-1, 1, len(space)).astype(np.float32)
        info = env.step(action)[4]
        for name, value in space.from_unit((action.astype(np.float64) + 1) / 2).items():
            assert info[name] == pytest.approx(value, rel=1e-6)


def test_a_residual_action_of_zero_is_the_reference_and_earns_nothing():
    env = AUVDropoutEnv(action="residual", reference={"process_noise_scale": 7.0})
    env.reset(seed=0)
    for _ in range(10):
        _, reward, _, _, info = env.step(np.zeros(4, dtype=np.float32))
        assert reward == pytest.approx(0.0, abs=1e-9)
        assert info["process_noise_scale"] == pytest.approx(7.0)


def test_observations_contain_no_truth():
    recording = recording_of(5)
    rng = np.random.default_rng(0)
    lied = navgym.Recording(
        time=recording.time, measurements=recording.measurements, lost=recording.lost,
        truth=rng.standard_normal(recording.truth.shape), model=recording.model,
        regime=rng.integers(0, 9, len(recording)),
    )  # fmt: skip
    env, liar = (AUVDropoutEnv(recordings=[r], reward="absolute") for r in (recording, lied))
    actions = rng.uniform(-1, 1, (40, 4)).astype(np.float32)
    honest, false = episode(env, actions), episode(liar, actions)
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(honest, false, strict=True))
    assert any(a[1] != b[1] for a, b in zip(honest, false, strict=True))


def test_observations_are_causal():
    recording = recording_of(6)
    changed = recording.measurements.copy()
    changed[101:, [0, 2]] += 50.0
    later = without_truth(recording, measurements=changed, truth=recording.truth)
    actions = np.zeros((40, 4), dtype=np.float32)
    first = episode(AUVDropoutEnv(recordings=[recording]), actions)
    second = episode(AUVDropoutEnv(recordings=[later]), actions)
    same = [np.array_equal(a[0], b[0]) for a, b in zip(first, second, strict=True)]
    assert all(same[:20])
    assert not any(same[21:])


@pytest.mark.parametrize("reward", ["over-oracle", "absolute", "likelihood"])
def test_other_rewards_are_what_the_manual_says(reward):
    recording = recording_of(2, loss=0.2)
    env = AUVDropoutEnv(recordings=[recording], reward=reward, reward_clip=1e9, action="residual")
    outcomes = episode(env, np.zeros((40, 4), dtype=np.float32))
    run = navgym.estimate("qivbf", recording, env.engine.reference)
    errors = square_error(run, recording)
    variance = navgym.estimate("oracle", recording).covariances[:, [0, 2], [0, 2]].sum(axis=1)
    for i, outcome in enumerate(outcomes):
        part = slice(5 * i, 5 * i + 5)
        expected = {
            "over-oracle": -(errors[part] / variance[part]).mean(),
            "absolute": -np.sqrt(errors[part].mean()),
            "likelihood": np.nansum(run.log_likelihood[part]) / 5,
        }[reward]
        assert outcome[1] == pytest.approx(expected, rel=1e-6)


def test_a_log_without_truth_is_paid_by_likelihood_only():
    blind = without_truth(recording_of())
    with pytest.raises(ValueError, match="reward='likelihood'"):
        AUVDropoutEnv(recordings=[blind])
    env = AUVDropoutEnv(recordings=[blind], reward="likelihood")
    outcomes = episode(env, np.zeros((3, 4), dtype=np.float32))
    assert all(np.isfinite(o[1]) for o in outcomes)
    assert "rmse" not in outcomes[0][4]


def test_an_oracle_reward_needs_true_noise_scales():
    recording = recording_of()
    plain = without_truth(recording, truth=recording.truth)
    with pytest.raises(ValueError, match="noise scales"):
        AUVDropoutEnv(recordings=[plain], reward="over-oracle")


def test_a_diverging_lane_ends_with_the_worst_reward_and_leaves_others_alone():
    good = recording_of(1)
    absurd = good.measurements.copy()
    absurd[50:] = 1e200
    bad = without_truth(good, measurements=absurd, truth=good.truth)
    batch = AUVDropoutVectorEnv(4, recordings=[good, bad])
    which = batch.reset(seed=3)[1]["recording"]
    assert {0, 1} == set(which)
    alone = AUVDropoutEnv(recordings=[good])
    expected = episode(alone, np.zeros((11, 4), dtype=np.float32))
    for k in range(11):
        observations, rewards, terminated, _, _ = batch.step(np.zeros((4, 4), dtype=np.float32))
        assert np.isfinite(observations).all()
        np.testing.assert_array_equal(terminated, (which == 1) & (k == 10))
        for i in np.flatnonzero(which == 0):
            np.testing.assert_array_equal(observations[i], expected[k][0])
        assert not (terminated & (rewards != -20.0)).any()


def test_a_pool_is_drawn_from_the_split_that_was_asked_for():
    env = AUVDropoutEnv(pool=5, split="validation", overrides={"steps": 20})
    drawn = {env.reset(seed=s)[1]["seed"] for s in range(40)}
    assert drawn == set(navgym.seeds("validation", 5))


def test_fresh_recordings_come_from_the_split_that_was_asked_for():
    from navgym.core.seeds import split_of

    env = AUVDropoutEnv(split="test", overrides={"steps": 20})
    assert all(split_of(env.reset(seed=s)[1]["seed"]) == "test" for s in range(10))


def test_several_scenarios_are_mixed():
    env = AUVDropoutEnv(scenario=["auv/nominal", "auv/heavy"], overrides={"steps": 20})
    assert {env.reset(seed=s)[1]["scenario"] for s in range(20)} == {"auv/nominal", "auv/heavy"}


def test_recordings_of_different_lengths_end_at_their_own_end():
    env = AUVDropoutEnv(recordings=[recording_of(1, steps=10), recording_of(2, steps=23)])
    lengths = {}
    for seed in range(8):
        which = env.reset(seed=seed)[1]["recording"]
        steps = 1
        while not env.step(np.zeros(4, dtype=np.float32))[3]:
            steps += 1
        lengths[which] = steps
    assert lengths == {0: 2, 1: 5}


def test_position_only_works_through_make():
    env = gymnasium.make(ID, scenario="auv/position-only")
    env.reset(seed=0)
    assert np.isfinite(env.step(env.action_space.sample())[0]).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": "auv/switch-d"}, "Did you mean 'auv/switch-D'"),
        ({"split": "tset"}, "Did you mean 'test'"),
        ({"decision_interval": 0}, "decision_interval must be a whole number"),
        ({"action_parameters": ("forgeting",)}, "Did you mean 'forgetting'"),
        ({"action_parameters": ()}, "action_parameters must be one or more"),
        ({"action_parameters": ("initial_count",)}, "acts at the start only"),
        ({"action": "relative"}, "unknown action"),
        ({"reward": "differnce"}, "Did you mean 'difference'"),
        ({"reward_clip": 0.0}, "reward_clip must be positive"),
        ({"pool": 0}, "pool must be a whole number"),
        ({"reference": {"forgetting": 2.0}}, "forgetting must lie in"),
        ({"overrides": {"los": 0.3}}, "Did you mean 'loss'"),
        ({"recordings": []}, "at least one Recording"),
        ({"scenario": []}, "at least one scenario"),
        ({"scenario": ["auv/nominal", "auv/position-only"]}, "share a model size"),
        ({"render_mode": "ansi"}, "render_mode must be"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        AUVDropoutEnv(**arguments)


def test_the_batch_refuses_what_it_cannot_do():
    with pytest.raises(ValueError, match="render_mode of a batch"):
        AUVDropoutVectorEnv(2, render_mode="human")
    with pytest.raises(ValueError, match="num_envs must be"):
        AUVDropoutVectorEnv(0)
    with pytest.raises(ValueError, match="seed must be one number or 2"):
        AUVDropoutVectorEnv(2).reset(seed=[1, 2, 3])


def test_a_recording_can_be_chosen_and_begun_in_the_middle():
    pool = [recording_of(s, loss=0.2) for s in range(3)]
    env = AUVDropoutEnv(recordings=pool, action="residual")
    nothing = np.zeros(4, dtype=np.float32)
    _, info = env.reset(options={"recording": 2})
    assert info["recording"] == 2
    for _ in range(8):
        later = env.step(nothing)[0]
    begun, _ = env.reset(options={"recording": 2, "start": 40})
    np.testing.assert_allclose(begun, later, rtol=1e-6, atol=1e-6)
    ahead = [env.step(nothing) for _ in range(32)]
    assert ahead[-1][3]
    assert not ahead[-2][3]


def test_a_batch_takes_an_option_for_each_lane():
    pool = [recording_of(s) for s in range(3)]
    batch = AUVDropoutVectorEnv(3, recordings=pool)
    _, infos = batch.reset(options={"recording": [2, 0, 1], "start": 5})
    assert list(infos["recording"]) == [2, 0, 1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"recordin": 1}, "Did you mean 'recording'"),
        ({"recording": 7}, "must lie in 0..1"),
        ({"start": 200}, "must lie in 0..199"),
    ],
)
def test_bad_options_of_reset_are_named(options, message):
    env = AUVDropoutEnv(recordings=[recording_of(0), recording_of(1)])
    with pytest.raises(ValueError, match=message):
        env.reset(seed=0, options=options)


def test_each_scenario_of_a_mixture_has_its_own_reference():
    names = ["auv/tvr", "auv/switch-D"]
    env = AUVDropoutEnv(scenario=names, pool=2, overrides={"steps": 50})
    for i, name in enumerate(names):
        env.reset(options={"recording": i})
        expected = navgym.simulation.find_scenario(name).reference
        row = dict(zip(spaces.QIVBF.names, env.engine.stations[0]["row"], strict=True))
        assert row["process_noise_scale"] == expected["process_noise_scale"]


def test_what_a_measurement_observes_is_told_for_each_recording():
    from navgym.statespace.models import LinearModel

    parts = []
    for rows in ([0, 2], [1, 3]):
        model = LinearModel(H=np.eye(4)[rows])
        whole = recording_of(0)
        parts.append(
            navgym.Recording(
                whole.time, whole.measurements[:, rows], truth=whole.truth, model=model
            )
        )
    env = AUVDropoutEnv(recordings=parts)
    seen = []
    for i in range(2):
        env.reset(options={"recording": i})
        seen.append(env.engine.stations[0]["kind"].tolist())
    assert seen == [[0, 0], [1, 1]]


def test_whole_number_and_double_actions_mean_what_they_say():
    for kind in (np.int32, np.float64):
        env = AUVDropoutEnv()
        env.reset(seed=0)
        info = env.step(np.ones(4, dtype=kind))[4]
        assert info["vb_iterations"] == 20
        assert info["process_noise_scale"] == pytest.approx(1000.0)


def test_a_finished_lane_ignores_even_an_action_that_is_no_number():
    batch = AUVDropoutVectorEnv(2, recordings=[recording_of(0, steps=5)])
    batch.reset(seed=0)
    assert batch.step(np.zeros((2, 4)))[3].all()
    batch.step(np.full((2, 4), np.nan))


def test_infos_are_copies():
    recording = recording_of(0)
    env = AUVDropoutEnv(recording=recording)
    env.reset(seed=0)[1]["regimes"].append("changed")
    assert "changed" not in env.reset(seed=0)[1]["regimes"]
    assert "changed" not in recording.meta["regimes"]


def test_a_model_that_turns_is_refused_by_name():
    with pytest.raises(TypeError, match="CoordinatedTurnModel"):
        AUVDropoutEnv(scenario="auv/coordinated-turn")
