"""A self-tuning filter is its policy's environment, sample by sample, and knows when to fall back."""

import dataclasses

import numpy as np
import pytest

import navgym
from navgym.agents.live.fallback import FallbackRule
from navgym.agents.live.streaming import DIVERGED, SelfTuningFilter
from navgym.agents.policies.policy import Policy
from navgym.auv.environment import AUVDropoutEnv
from tests.agents.both import AUV
from tests.agents.live import episode, parameters, schedule, some_policy, stacked

STEERED = ("vb_iterations", "prior_count", "forgetting", "process_noise_scale", "fill")
STEADY = {"process_noise_scale": 70.0, "prior_count": 2.0}
# nine seconds' memory of R: what the policy sees is soon as before once a noisy stretch is over
FORGETFUL = {"process_noise_scale": 3.0, "prior_count": 1.2, "forgetting": 0.89}
SPIKE = 1e200
ALIKE = FallbackRule(
    behind=1e9
)  # who misses fixes by less is not asked: other reasons are looked at


def auv(recording, bias=None, size=1.0, **settings):
    """An environment on one recording, and a policy for it."""
    given = {"action": "residual", "reference": {"process_noise_scale": 3.0}}
    env = AUVDropoutEnv(recordings=[recording], reward="likelihood", **given | settings)
    return env, some_policy(env, AUV, bias=bias, size=size)


def trained_on(policy, low, high):
    """The same policy, said to have seen observations in low to high."""
    return Policy(policy.manifest, policy.layers, policy.normalisation, low, high)


def calm_then(scale, start, end, steps=400, seed=0):
    """A nominal recording of which samples start to end are `scale` times as noisy."""
    recording = navgym.simulate("auv/nominal", seed=seed, steps=steps, loss=0.0)
    noise = recording.measurements - recording.truth
    noise[start:end] *= scale
    return navgym.Recording(recording.time, recording.truth + noise, model=recording.model)


def unevenly(recording, rng):
    """The measurements at uneven times, with a model of these steps."""
    dt = rng.uniform(0.3, 2.0, len(recording))
    model = navgym.LinearModel.white_acceleration(dt, x0=[0.0, 1.0, 0.0, 1.0])
    return dt, navgym.Recording(np.cumsum(dt), recording.measurements, recording.lost, model=model)


class TestAUVParity:
    @pytest.mark.parametrize(
        ("scenario", "interval", "overrides"),
        [
            ("auv/switch-D", 5, {}),
            ("auv/component-loss", 5, {}),
            ("auv/burst", 7, {}),
            ("auv/switch-B", 1, {"loss": 0.3}),
        ],
    )
    def test_it_is_the_environment_to_the_last_bit(self, scenario, interval, overrides):
        recording = navgym.simulate(scenario, seed=3, **{"steps": 150} | overrides)
        # parameters near the reference's: a filter that loses the track is started again, live only
        env, policy = auv(
            recording, size=0.3, reference=STEADY, decision_interval=interval,
            action_parameters=STEERED,
        )  # fmt: skip
        rows = episode(env, policy)
        assert len(np.unique(rows, axis=0)) > 10
        run = navgym.estimate("qivbf", recording, schedule(env.engine.space, rows), interval)
        tuned = SelfTuningFilter("qivbf", policy, recording.model, rule=None)
        found = list(tuned.follow(recording))
        np.testing.assert_array_equal(stacked(found, "state"), run.states)
        np.testing.assert_array_equal(stacked(found, "covariance"), run.covariances)
        np.testing.assert_array_equal(stacked(found, "nis"), run.nis)
        np.testing.assert_array_equal(
            parameters(env.engine.space, found), np.repeat(rows, interval, axis=0)[:150]
        )
        assert tuned.decisions == len(rows)
        assert tuned.restarts == 0

    def test_uneven_samples_are_filtered_with_the_model_of_each_step(self):
        recording = navgym.simulate("auv/nominal", seed=1, steps=60)
        dt, uneven = unevenly(recording, np.random.default_rng(0))
        env, policy = auv(uneven)
        run = navgym.estimate("qivbf", uneven, schedule(env.engine.space, episode(env, policy)))

        def model(step):
            return navgym.LinearModel.white_acceleration(step, x0=[0.0, 1.0, 0.0, 1.0])

        for given, interval in ((uneven.model, None), (model, float(dt[0]))):
            tuned = SelfTuningFilter("qivbf", policy, given, interval=interval, rule=None)
            states = stacked(list(tuned.follow(uneven)), "state")
            # times are sums of steps, and a difference of sums is a step but for rounding
            np.testing.assert_allclose(states, run.states, rtol=1e-9, atol=1e-9)

    def test_a_saved_policy_is_the_same_one(self, tmp_path):
        recording = navgym.simulate("auv/switch-D", seed=3, steps=60)
        _, policy = auv(recording)
        again = Policy.load(policy.save(tmp_path / "policy"))
        runs = [
            stacked(list(SelfTuningFilter("qivbf", p, recording.model).follow(recording)), "state")
            for p in (policy, again)
        ]
        np.testing.assert_array_equal(*runs)


@pytest.fixture(scope="module")
def nominal():
    return navgym.simulate("auv/component-loss", seed=2, steps=80)


@pytest.fixture
def tuned(nominal):
    return SelfTuningFilter("qivbf", auv(nominal)[1], nominal.model)


class TestSamples:
    def test_nan_and_flags_mean_the_same(self, tuned, nominal):
        wanted = stacked(list(tuned.follow(nominal)), "state")
        tuned.reset()
        whole = np.nan_to_num(nominal.measurements, nan=77.0)
        found = [
            tuned.step(y, lost=True if gone.all() else gone)
            for y, gone in zip(whole, nominal.lost, strict=True)
        ]
        np.testing.assert_array_equal(stacked(found, "state"), wanted)

    def test_reset_forgets_everything(self, tuned, nominal):
        tuned.step([1e6, 0.0, 0.0, 0.0])
        tuned.reset()
        first = stacked(list(tuned.follow(nominal)), "state")
        counts = tuned.decisions, tuned.fallbacks, tuned.restarts
        tuned.reset()
        assert (tuned.decisions, tuned.fallbacks, tuned.restarts) == (0, 0, 0)
        np.testing.assert_array_equal(stacked(list(tuned.follow(nominal)), "state"), first)
        assert (tuned.decisions, tuned.fallbacks, tuned.restarts) == counts

    def test_what_is_returned_belongs_to_the_caller(self, tuned, nominal):
        wanted = [f.state.copy() for f in tuned.follow(nominal)]
        tuned.reset()
        found = []
        for row in nominal.measurements:
            y = row.copy()
            estimate = tuned.step(y)
            found.append(estimate.state.copy())
            y[:], estimate.state[:], estimate.covariance[:] = 7.0, 7.0, 7.0
            with pytest.raises(TypeError):
                estimate.parameters["forgetting"] = 0.9
            with pytest.raises(dataclasses.FrozenInstanceError):
                estimate.nis = 0.0
        np.testing.assert_array_equal(found, wanted)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (([1.0, 2.0],), r"measurement must have shape \(4,\)"),
            (([1.0, np.inf, 0.0, 0.0],), "must be finite or NaN"),
            ((["a", "b", "c", "d"],), "must be an array of numbers"),
            (([0.0] * 4, [True, False]), r"lost must be one flag or one per component"),
            (([0.0] * 4, 0.5), "lost must be booleans"),
            (([0.0] * 4, None, 3.0), "time must be finite and increase, got 3.0 after 3.0"),
            (([0.0] * 4, None, 2.0), "time must .* increase.* clock was set, call restart_clock"),
            (([0.0] * 4, None, np.nan), "time must be finite, got nan"),
            (([0.0] * 4, None, 5.0), "made for steps of 1 s: pass samples that were missed"),
        ],
    )
    def test_wrong_input_is_named_and_changes_nothing(self, tuned, nominal, arguments, message):
        samples = nominal.measurements
        for y in samples[:3]:
            tuned.step(y)
        with pytest.raises(ValueError, match=message):
            tuned.step(*arguments)
        after = tuned.step(samples[3]).state
        tuned.reset()
        np.testing.assert_array_equal(after, [tuned.step(y).state for y in samples[:4]][-1])


class TestRefusals:
    def test_filters_that_no_policy_steers(self, nominal):
        _, policy = auv(nominal)
        with pytest.raises(ValueError, match=r"'kf' has no environment.*use one of qivbf, idam"):
            SelfTuningFilter("kf", policy, nominal.model)
        with pytest.raises(ValueError, match=r"sets the parameters of qivbf, not of idam"):
            SelfTuningFilter("idam", policy, navgym.DeckModel())

    def test_policies_of_another_environment(self, nominal):
        _, policy = auv(nominal)
        later = dataclasses.replace(policy.manifest, environment="navgym/AUVDropout-v1")
        with pytest.raises(ValueError, match=r"AUVDropout-v1, not in navgym/AUVDropout-v0"):
            SelfTuningFilter("qivbf", Policy(later, policy.layers), nominal.model)
        names = (*policy.manifest.observation_names[:-1], "something.else")
        other = dataclasses.replace(policy.manifest, observation_names=names)
        with pytest.raises(ValueError, match=r"something\.else"):
            SelfTuningFilter("qivbf", Policy(other, policy.layers), nominal.model)

    def test_models_of_another_kind(self, nominal):
        _, policy = auv(nominal)
        with pytest.raises(TypeError, match=r"needs recordings with a LinearModel|function from"):
            SelfTuningFilter("qivbf", policy, navgym.CoordinatedTurnModel())
        with pytest.raises(ValueError, match="interval must be a finite number above 0"):
            SelfTuningFilter("qivbf", policy, nominal.model, interval=0.0)

    def test_rules_out_of_range(self):
        for wrong in ({"margin": -1.0}, {"confidence": 2.0}, {"window": 0}, {"recovery": 1.5}):
            with pytest.raises(ValueError, match=next(iter(wrong))):
                FallbackRule(**wrong)


class TestFallback:
    def test_a_policy_that_misses_the_fixes_by_more_is_left_for_the_parameters_it_starts_from(self):
        recording = navgym.simulate("auv/nominal", seed=0, steps=400, loss=0.0)
        _, policy = auv(recording, bias=0.5)  # far from best fixed, which nothing beats here
        tuned = SelfTuningFilter("qivbf", policy, recording.model)
        alone = SelfTuningFilter("qivbf", policy, recording.model, rule=None)
        fixed = navgym.estimate("qivbf", recording, policy.manifest.reference)
        errors = []
        for states in (
            stacked(list(tuned.follow(recording)), "state"),
            stacked(list(alone.follow(recording)), "state"),
            fixed.states,
        ):
            miss = (states - recording.truth)[:, [0, 2]]
            errors.append(np.sqrt((miss**2).sum(axis=1).mean()))
        assert tuned.fallback is not None
        assert errors[1] > 1.1 * errors[2]
        assert errors[0] < errors[2] + 0.3 * (errors[1] - errors[2])

    def test_a_shift_beyond_training_triggers_it_and_its_end_ends_it(self):
        recording = calm_then(30.0, 150, 200, 500)
        env, policy = auv(recording, reference=FORGETFUL, bias=0.1)
        tuned = SelfTuningFilter("qivbf", policy, recording.model, rule=None)
        seen = []
        for seed in range(1, 7):
            tuned.reset()
            for y in calm_then(1.0, 0, 1, 500, seed).measurements:
                tuned.step(y)
                seen.append(tuned._lane.observation[0].copy())
        known = trained_on(policy, np.min(seen, axis=0), np.max(seen, axis=0))
        tuned = SelfTuningFilter("qivbf", known, recording.model, rule=ALIKE)
        found = list(tuned.follow(recording))
        fallen = np.array([f.fallback is not None for f in found])
        assert not fallen[:150].any()
        assert fallen[165:200].all()
        assert not fallen[-20:].any()
        assert found[170].fallback.startswith("observation ")
        assert "validation saw" in found[170].fallback
        assert tuned.fallbacks >= 1
        assert 0 < tuned.fallback_decisions < tuned.decisions

        # while it lasts, the answers are those of the best fixed parameters from the start on
        reference = env.engine.reference
        run = navgym.estimate("qivbf", recording, reference)
        np.testing.assert_array_equal(stacked(found, "state")[fallen], run.states[fallen])
        assert all(f.parameters == found[170].parameters for f in np.array(found)[fallen])
        assert dict(found[170].parameters) == reference

    def test_a_policy_that_foretells_worse_is_left_once_its_nis_is_out_of_band(self):
        recording = navgym.simulate("auv/mismatch", seed=0, steps=300)
        fixed = {"process_noise_scale": 100.0, "prior_count": 170.0, "forgetting": 0.99}
        arguments = {"action_parameters": ("process_noise_scale",), "action": "absolute"}
        _, policy = auv(recording, bias=-0.1, reference=fixed, **arguments)
        tuned = SelfTuningFilter("qivbf", policy, recording.model, rule=ALIKE)
        found = list(tuned.follow(recording))
        fallen = np.array([f.fallback is not None for f in found])
        assert fallen[60:].mean() > 0.5
        assert all(f.fallback.startswith("NIS is ") for f in np.array(found)[fallen])
        run = navgym.estimate("qivbf", recording, fixed)
        np.testing.assert_array_equal(stacked(found, "state")[fallen], run.states[fallen])

    @pytest.mark.parametrize("scale", [0.2, 5.0])
    def test_best_fixed_parameters_may_be_inconsistent_without_a_fallback(self, scale):
        # R is wrong by a factor of 25 and never adapted: the NIS of the reference is out of band
        recording = calm_then(scale, 0, 300, steps=300)
        fixed = {"prior_count": 300.0, "forgetting": 0.999, "initial_count": 100.0,
                 "initial_scale": 1.0, "process_noise_scale": 1.0}  # fmt: skip
        _, policy = auv(recording, bias=0.05, reference=fixed)
        tuned = SelfTuningFilter("qivbf", policy, recording.model, rule=ALIKE)
        found = list(tuned.follow(recording))
        assert not 3.5 < np.mean([f.nis for f in found[5:60]]) < 4.5
        assert all(f.fallback is None for f in found)

    def test_without_a_rule_nothing_is_judged(self):
        recording = calm_then(30.0, 20, 60, steps=100)
        _, policy = auv(recording)
        known = trained_on(policy, np.zeros(len(policy.low)), np.zeros(len(policy.low)))
        judged = SelfTuningFilter("qivbf", known, recording.model)
        free = SelfTuningFilter("qivbf", known, recording.model, rule=None)
        assert any(f.fallback for f in judged.follow(recording))
        assert not any(f.fallback for f in free.follow(recording))

    def test_patience_and_recovery_count_decisions(self):
        recording = calm_then(1.0, 0, 1, steps=200)
        y = recording.measurements.copy()
        y[50:55] = np.nan  # what training never saw: one decision without measurements
        _, policy = auv(recording)
        since = policy.manifest.observation_names.index("since_received")
        low, high = policy.low.copy(), policy.high.copy()
        low[since] = high[since] = 0.0
        known = trained_on(policy, low, high)
        for patience, recovery, wanted in ((1, 4, range(55, 75)), (2, 4, range(0))):
            rule = dataclasses.replace(ALIKE, patience=patience, recovery=recovery, confidence=1.0)
            tuned = SelfTuningFilter("qivbf", known, recording.model, rule=rule)
            fallen = [k for k, row in enumerate(y) if tuned.step(row).fallback is not None]
            assert fallen == list(wanted)


class TestDivergence:
    def test_where_both_filters_fail_they_start_again_from_the_last_sound_state(self):
        recording = calm_then(1.0, 0, 1, steps=200)
        y = recording.measurements.copy()
        y[100] = SPIKE
        _, policy = auv(recording, bias=0.1)
        tuned = SelfTuningFilter("qivbf", policy, recording.model, rule=ALIKE)
        found = [tuned.step(row) for row in y]
        assert [k for k, f in enumerate(found) if f.diverged] == [100]
        assert tuned.restarts == 1
        assert found[101].fallback == DIVERGED
        assert found[-1].fallback is None
        states = stacked(found, "state")
        assert np.isfinite(states).all()
        before, after = (np.trace(found[k].covariance) for k in (99, 100))
        assert after > before
        sound = stacked(list(_fresh(tuned).follow(recording)), "state")
        np.testing.assert_allclose(states[130:], sound[130:], atol=1.5)

    def test_the_controlled_filter_goes_on_from_the_reference_filter(self):
        recording = calm_then(1.0, 0, 1, steps=130)
        env, policy = auv(recording, bias=0.1)
        tuned = SelfTuningFilter("qivbf", policy, recording.model)
        found = []
        for k, y in enumerate(recording.measurements):
            if k == 60:
                tuned._lane.lanes["x"][0] = np.nan
            found.append(tuned.step(y))
        assert found[60].diverged
        assert found[61].fallback == DIVERGED
        assert found[-1].fallback is None
        run = navgym.estimate("qivbf", recording, env.engine.reference)
        np.testing.assert_array_equal(found[60].state, run.states[60])
        assert np.isfinite(stacked(found, "state")).all()

    def test_a_runaway_is_found_again(self):
        # the vehicle is carried off by 10 km: both filters run away, for they learn to distrust it
        recording = calm_then(1.0, 0, 1, steps=300)
        y = recording.measurements.copy()
        y[100:, 0] += 1e4
        fixed = {"process_noise_scale": 0.1, "prior_count": 300.0, "forgetting": 0.9}
        _, policy = auv(recording, reference=fixed, bias=0.0)
        tuned = SelfTuningFilter("qivbf", policy, recording.model)
        found = [tuned.step(row) for row in y]
        assert tuned.restarts >= 1
        assert abs(found[-1].state[0] - y[-1, 0]) < 10.0


def _fresh(tuned):
    tuned.reset()
    return tuned
