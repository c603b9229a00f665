"""Baselines choose what they say they choose; a roll-out's schedule gives the engine's states."""

import numpy as np
import pytest

from navgym.agents.evaluation import regime_tables
from navgym.agents.evaluation.baselines import (
    Fixed,
    Random,
    TrueRegime,
    hand_rule,
    whole_filters,
)
from navgym.agents.evaluation.rollout import Learnt, engine_for, replay_filter, roll_out
from navgym.deck.batch import DeckBatch
from navgym.envs.columns import INFORMATION, TERMINATED, TRUNCATED
from navgym.problem import PROBLEMS, problem_of
from navgym.simulation import find_scenario, simulate_many
from navgym.statespace.batch import StateSpaceBatch
from tests.agents import hand_made
from tests.agents.both import AUV, DECK, run, run_deck

STEPS = 120


def auv(count=3, scenario="auv/switch-D", **overrides):
    return simulate_many(scenario, range(count), steps=STEPS, **overrides)


def deck(count=2, **overrides):
    return simulate_many("deck/switch-60", range(count), **{"duration": 80.0} | overrides)


class Dice:
    """A chooser that stands for any policy: actions depend on the seed alone."""

    def __init__(self, environment, **settings):
        self.environment, self.settings = environment, settings
        self.begin(0)

    def begin(self, lanes):
        self._rng = np.random.default_rng(4)

    def __call__(self, observation):
        size = (len(observation), len(self.settings["action_parameters"]))
        return self._rng.uniform(-1.0, 1.0, size)


def stepped(chooser, recordings):
    """States of the engine itself, from its first decision on (NaN before), and where that was."""
    plain = engine_for(chooser, recordings)
    engine = type(plain)(plain.settings, len(recordings), trail=True)
    obs = np.stack([engine.restart(i, recording=i) for i in range(engine.count)])
    start = engine.stations["k"].copy()
    chooser.begin(engine.count)
    while (active := engine.stations["active"] > 0).any():
        out = engine.step(np.where(active[:, None], chooser(obs), 0.0), obs)
        engine.stations["active"][(out[:, TERMINATED] > 0) | (out[:, TRUNCATED] > 0)] = 0
    return engine.trail, start


# ---- roll-outs


@pytest.mark.parametrize("action", ["absolute", "residual"])
@pytest.mark.parametrize("interval", [1, 5, 7])
def test_an_auv_schedule_gives_the_engines_states_to_the_last_bit(action, interval):
    names = ("forgetting", "process_noise_scale", "vb_iterations", "fill")
    chooser = Dice(AUV, action_parameters=names, action=action, decision_interval=interval,
                   reference={"initial_count": 30.0})  # fmt: skip
    recordings = auv(2, loss=0.3) + simulate_many("auv/switch-B", [9], steps=77, loss=0.3)
    found = roll_out(chooser, recordings)
    states = run(
        replay_filter(chooser), StateSpaceBatch.of(recordings), found.schedules, found.interval
    )
    trail, _ = stepped(chooser, recordings)
    np.testing.assert_array_equal(states.states, trail)
    assert found.schedules[0]["initial_count"] == 30.0
    assert len(found.schedules[2]["forgetting"]) == -(-77 // interval)


@pytest.mark.parametrize(
    ("interval", "features", "warmup"), [(20, "all", 60.0), (20, "gyro", 10.0), (7, "gyro", 10.0)]
)
def test_a_deck_schedule_gives_the_engines_states_to_the_last_bit(interval, features, warmup):
    chooser = Dice(DECK, action_parameters=("kernel_width", "velocity_noise"), features=features,
                   decision_interval=interval, warmup=warmup)  # fmt: skip
    recordings = deck() + deck(1, duration=70.0)
    found = roll_out(chooser, recordings)
    batch = DeckBatch.of(recordings)
    states = run_deck(replay_filter(chooser), batch, found.schedules, found.interval).states
    trail, start = stepped(chooser, recordings)
    for i, (first, length) in enumerate(zip(start, batch.lengths, strict=True)):
        assert first == round(20 * warmup)
        np.testing.assert_array_equal(
            states[i, first:length], trail[i, first:length, : states.shape[2]]
        )


def test_a_policys_schedule_is_what_the_policy_says():
    weights = {(0, "frozen.power_position.0.8"): 0.4, (1, "curvature.0.5"): -0.3}
    policy = hand_made.policy(AUV, "auv/switch-D", weights)
    chooser, recordings = Learnt(policy), auv()
    found = roll_out(chooser, recordings)
    engine = engine_for(chooser, recordings)
    obs = np.stack([engine.restart(i, recording=i) for i in range(engine.count)])
    q, rho = (engine.space.index(n) for n in ("process_noise_scale", "forgetting"))
    for decision in range(STEPS // 5):
        rows = policy.parameters(obs)
        for i, schedule in enumerate(found.schedules):
            assert schedule["process_noise_scale"][decision] == rows[i, q]
            assert schedule["forgetting"][decision] == rows[i, rho]
        engine.step(policy(obs), obs)


def test_a_recording_without_truth_can_be_rolled_out():
    (recording,) = auv(1)
    blind = type(recording)(recording.time, recording.measurements, model=recording.model)
    schedules = [roll_out(hand_rule(AUV), [r]).schedules[0] for r in (recording, blind)]
    for name, values in schedules[0].items():
        np.testing.assert_array_equal(values, schedules[1][name])


# ---- baselines


@pytest.mark.parametrize(
    "baseline",
    [Fixed(AUV, {"forgetting": 0.9}), Random(AUV), hand_rule(AUV), Fixed(DECK), Random(DECK),
     hand_rule(DECK)],
    ids=lambda b: f"{type(b).__name__}-{b.environment[7:10]}",
)  # fmt: skip
def test_actions_put_the_chosen_parameters_in_force(baseline):
    recordings = auv() if baseline.environment == AUV else deck()
    engine = engine_for(baseline, recordings)
    obs = np.stack([engine.restart(i, recording=i) for i in range(engine.count)])
    for _ in range(6):
        baseline.begin(engine.count)
        rows = baseline.parameters(obs)
        baseline.begin(engine.count)
        out = engine.step(baseline(obs), obs)
        np.testing.assert_allclose(out[:, INFORMATION + len(engine.INFO_NAMES) :], rows, rtol=1e-5)


def test_random_parameters_are_the_same_twice_and_inside_their_ranges():
    baseline, recordings = Random(AUV), auv()
    first, again = (roll_out(baseline, recordings).schedules for _ in range(2))
    for one, other in zip(first, again, strict=True):
        for name in ("process_noise_scale", "forgetting"):
            np.testing.assert_array_equal(one[name], other[name])
            assert len(np.unique(one[name])) == STEPS // 5
    assert not np.array_equal(first[0]["forgetting"], first[1]["forgetting"])


def observed(baseline, **signals):
    """Two lanes of zeros, but for the signals (one number per lane)."""
    obs = np.zeros((2, baseline.width), dtype=np.float32)
    for name, values in signals.items():
        obs[:, baseline.places[name.replace("__", ".")]] = values
    return obs


def chosen(baseline, name, obs):
    return baseline.parameters(obs)[:, baseline.space.index(name)]


def test_covariance_matching_is_ten_times_innovation_power_over_noise_power():
    rule = hand_rule(AUV)
    obs = observed(rule)
    obs[:, rule.places["frozen.power_position.0.8"]] = np.log([3.0, 1.0])  # half logarithms
    obs[:, rule.places["curvature.0.8"]] = np.log([2.0, 2.0])
    q = chosen(rule, "process_noise_scale", obs)
    np.testing.assert_allclose(q, [10.0 * (3.0 / 2.0) ** 2, 10.0], rtol=1e-6)
    obs[:, rule.places["frozen.power_position.0.8"]] = 5.0
    np.testing.assert_array_equal(chosen(rule, "process_noise_scale", obs), 1000.0)  # its range


def test_the_sign_rule_narrows_at_once_widens_by_half_and_drifts_back():
    rule = hand_rule(DECK)
    rule.begin(2)
    loud = {"rate__alarm": 0.1}
    narrowed = chosen(rule, "kernel_width", observed(rule, **loud, rate__persistence=[-0.3, 0.0]))
    np.testing.assert_allclose(
        narrowed, [rule.rule.NARROW, 10.0]
    )  # the default where nothing is told
    widened = chosen(rule, "kernel_width", observed(rule, **loud, rate__persistence=[0.5, 0.5]))
    np.testing.assert_allclose(widened, [1.5 * rule.rule.NARROW, 15.0])
    quiet = [chosen(rule, "kernel_width", observed(rule))[0] for _ in range(60)]
    assert (np.diff(quiet) > 0.0).all()
    assert quiet[-1] == pytest.approx(rule.rule.QUIET, rel=0.01)
    rule.begin(1)
    again = chosen(rule, "kernel_width", observed(rule, **loud)[:1])
    assert again == pytest.approx(10.0)


def test_the_true_regimes_table_follows_the_truth_at_once():
    recordings = auv(3, dwell=(20, 40))
    names, regimes = recordings[0].meta["regimes"], [r.regime for r in recordings]
    reference = find_scenario("auv/switch-D").reference
    table = TrueRegime(AUV, "auv/switch-D", regimes, names, reference)
    assert table.bound
    rolled = roll_out(table, recordings).schedules
    for mine, other, regime in zip(rolled, table.schedules(), regimes, strict=True):
        own = regime_tables.tables()["auv/switch-D"]
        for name in ("forgetting", "process_noise_scale"):
            wanted = [own[names[g]][name] for g in regime]
            np.testing.assert_array_equal(other[name], wanted)
            np.testing.assert_allclose(mine[name], wanted, rtol=1e-5)
        assert mine["prior_count"] == reference["prior_count"]


@pytest.mark.parametrize("scenario", regime_tables.tables())
def test_tables_hold_every_regime_of_their_scenario_within_the_parameters_ranges(scenario):
    problem, table = problem_of(scenario), regime_tables.tables()[scenario]
    (recording,) = simulate_many(scenario, [0], **problem.brief)
    assert set(table) == set(recording.meta["regimes"])
    space = problem.find(problem.contest.default).space
    for row in table.values():
        space.array(row)


def test_a_missing_table_and_a_missing_regime_are_named():
    with pytest.raises(ValueError, match=r"no table by true regime for 'auv/turn'"):
        regime_tables.rows_by_regime("auv/turn", ["nominal"])
    with pytest.raises(ValueError, match=r"have 'burst'"):
        regime_tables.rows_by_regime("auv/switch-D", ["nominal", "burst"])


@pytest.mark.parametrize("name", PROBLEMS)
def test_whole_filters_are_the_problems_and_only_bounds_need_the_truth(name):
    problem = PROBLEMS[name]
    entries = whole_filters(problem)
    assert entries[0].label == problem.contest.plain
    assert {e.filter for e in entries} <= set(problem.filters)
    assert {e.filter for e in entries if e.bound} == {
        e.filter for e in entries if problem.filters[e.filter].needs_scales
    }
    real = {e.label for e in whole_filters(problem, real=True)}
    simulated = {r.label for r in problem.contest.rivals if r.overrides}  # another sensor on board
    assert {e.label for e in entries if not e.bound} - simulated <= real
    assert not real & simulated
    assert not real & {e.label for e in entries if e.bound}


def test_an_unknown_environment_is_refused_with_the_nearest_name():
    with pytest.raises(ValueError, match=r"Did you mean 'navgym/AUVDropout-v0'"):
        Fixed("navgym/AUVDropout-v1")
