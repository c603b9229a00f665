"""The deck filter on live samples of two IMUs is its environment, and survives what the sea does."""

import dataclasses

import numpy as np
import pytest

import navgym
from navgym.agents.live.streaming import SelfTuningFilter
from navgym.deck.alignment import THETA
from navgym.deck.batch import DeckBatch
from navgym.deck.environment import DeckDeformationEnv
from navgym.deck.estimation import attitudes
from navgym.deck.problem import PROBLEM, STEERED
from navgym.inertial.flexure import ARCMIN
from tests.agents.both import DECK, run_deck
from tests.agents.live import episode, parameters, schedule, some_policy, stacked

SPIKE = 1e200


def deck(recording, bias=None, **settings):
    env = DeckDeformationEnv(recordings=[recording], reward="likelihood", **settings)
    return env, some_policy(env, DECK, bias=bias)


def deck_filter(recording, policy, **options):
    given = {"interval": recording.interval, "rule": None} | options
    return SelfTuningFilter("idam", policy, recording.model, **given)


def imu_samples(recording):
    names = ("main_angle", "main_velocity", "sub_angle", "sub_velocity")
    return np.stack([getattr(recording, name) for name in names], axis=1)


def sea(seconds=30.0, seed=3, scenario="deck/switch-60", **overrides):
    return navgym.simulate(scenario, seed=seed, duration=seconds, **overrides)


class TestDeckParity:
    @pytest.mark.parametrize(
        ("features", "warmup", "interval", "own"),
        [("all", 10.0, 20, False), ("gyro", 0.0, 7, False), ("all", 10.0, 20, True)],
    )
    def test_it_is_the_environment_to_the_last_bit(self, features, warmup, interval, own):
        recording = sea()
        assert np.abs(recording.disturbance).max() > 0.0
        env, policy = deck(
            recording, features=features, warmup=warmup, decision_interval=interval,
            reference={"kernel_width": 12.0}, action="residual", own_channels=own,
        )  # fmt: skip
        rows, space = episode(env, policy), env.engine.space
        first = round(warmup / recording.step)
        fixed = np.repeat(space.array(env.engine.reference), first, axis=0)
        whole = np.concatenate([fixed, np.repeat(rows, interval, axis=0)])[: recording.steps]
        run = run_deck(
            PROBLEM.environment.replayed(vars(env.engine.settings)), DeckBatch.of([recording]),
            [schedule(space, whole)], 1, everything=True,
        )  # fmt: skip
        found = list(deck_filter(recording, policy).follow(recording))
        np.testing.assert_array_equal(stacked(found, "state"), run.states[0])
        np.testing.assert_array_equal(stacked(found, "covariance"), run.covariances[0])
        np.testing.assert_array_equal(stacked(found, "nis"), run.nis[0])
        np.testing.assert_array_equal(parameters(space, found), whole)
        tape = DeckBatch.of([recording]).tapes[0]
        attitude, static = attitudes(tape, run.states[0])
        np.testing.assert_array_equal(found[-1].attitude, attitude[-1])
        np.testing.assert_array_equal(found[-1].static, static[-1])

    @pytest.mark.parametrize("per", [1, 2, 5])
    def test_any_number_of_samples_makes_a_step(self, per):
        recording = sea(4.0)
        model = dataclasses.replace(recording.model, samples_per_step=per)
        fields = {
            n: getattr(recording, n)
            for n in ("main_angle", "main_velocity", "sub_angle", "sub_velocity")
        }
        short = navgym.DualIMURecording(recording.time, **fields, model=model)
        env, policy = deck(short, warmup=0.0)
        found = list(deck_filter(short, policy).follow(short))
        rows = parameters(env.engine.space, found)
        whole = np.concatenate([rows[:1]] * (short.steps - len(found)) + [rows])
        chosen = schedule(env.engine.space, whole)
        run = run_deck(STEERED, DeckBatch.of([short]), [chosen], 1)
        # the first steps are filtered together, once three samples are there
        np.testing.assert_array_equal(stacked(found, "state"), run.states[0][-len(found) :])
        assert short.steps - len(found) <= 2

    def test_rates_are_increments_over_the_interval(self):
        recording = sea(5.0)
        _, policy = deck(recording, warmup=1.0)
        h = recording.interval
        by_increments, by_rates = (
            deck_filter(recording, policy, rates=rates) for rates in (False, True)
        )
        for x in imu_samples(recording):
            wanted, found = by_increments.step(x), by_rates.step((x / h).ravel())
            assert (wanted is None) == (found is None)
        np.testing.assert_allclose(found.state, wanted.state, rtol=1e-6, atol=1e-12)


class TestDeckSamples:
    def test_lost_samples_are_filled_in_marked_and_survived(self):
        recording = sea(60.0, scenario="deck/paper")
        _, policy = deck(recording, bias=0.0, action="residual")
        tuned = deck_filter(recording, policy)
        whole = list(tuned.follow(recording))
        tuned.reset()
        found, gaps = [], []
        for k, x in enumerate(imu_samples(recording)):
            gone = [False, False, 4000 <= k < 4030, 4000 <= k < 4030]  # the sub IMU, .3 s
            estimate = tuned.step(x, lost=gone)
            if estimate is not None:
                found.append(estimate)
                gaps.append(int(estimate.tape["gap"][0]))
        assert gaps == [5 if 800 <= k < 806 else 0 for k in range(1200)]
        assert np.trace(found[806].covariance[6:9, 6:9]) > np.trace(whole[806].covariance[6:9, 6:9])
        theta = [stacked(each[-100:], "state")[:, THETA] for each in (whole, found)]
        assert np.abs(theta[0] - theta[1]).max() < 3.0 * ARCMIN

    def test_filtering_begins_with_the_first_complete_sample(self):
        recording = sea(4.0)
        _, policy = deck(recording, bias=0.0, warmup=0.0)
        late, usual = (deck_filter(recording, policy) for _ in range(2))
        for x in imu_samples(recording)[:7]:
            assert late.step(x, lost=True) is None
        for x in imu_samples(recording):
            one, other = late.step(x), usual.step(x)
            assert (one is None) == (other is None)
        np.testing.assert_array_equal(one.state, other.state)

    def test_where_both_filters_fail_everything_begins_anew(self):
        recording = sea(30.0)
        _, policy = deck(recording, bias=0.0, warmup=1.0)
        tuned = deck_filter(recording, policy)
        samples = imu_samples(recording)
        broken = samples[1500].copy()
        broken[3] = SPIKE
        found = [tuned.step(x) for x in (*samples[:1500], broken, *samples[1501:])]
        found = [f for f in found if f is not None]
        failed = [k for k, f in enumerate(found) if f.diverged]
        assert failed == [300]
        assert tuned.restarts == 1
        assert all(np.isfinite(f.state).all() for f in found)
        # what follows is what a new filter makes of the samples that follow
        anew = deck_filter(recording, policy)
        wanted = [f for f in (anew.step(x) for x in samples[1505:]) if f is not None]
        np.testing.assert_array_equal(found[-1].state, wanted[-1].state)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (([0.0] * 4,), r"measurement must have shape \(4, 3\)"),
            ((np.full((4, 3), np.inf),), "must be finite or NaN"),
            ((np.zeros((4, 3)), [True] * 5), "one flag or one per component"),
            ((np.zeros((4, 3)), None, 0.5), r"time must move by the interval of 0\.01 s"),
        ],
    )
    def test_wrong_input_is_named(self, arguments, message):
        recording = sea(4.0)
        tuned = deck_filter(recording, deck(recording)[1])
        tuned.step(imu_samples(recording)[0], time=0.01)
        with pytest.raises(ValueError, match=message):
            tuned.step(*arguments)

    def test_a_policy_that_sets_how_to_identify_is_refused(self):
        recording = sea(4.0)
        _, policy = deck(recording, action_parameters=("kernel_width", "rvm_kernel_scale"))
        with pytest.raises(ValueError, match=r"rvm_kernel_scale.*identifies nothing"):
            deck_filter(recording, policy)
