"""From a recording and parameters to an estimate: schedules, batches of parameters, refusals."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import navgym
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters.catalogue import CATALOGUE
from tests.helpers import identical, lane, run

RECORDING = navgym.simulate("auv/switch-D", 1, steps=83)
TUNED = {
    "kf": {"process_noise_scale": 3.0, "measurement_noise_scale": 0.5},
    "kf_extrapolate": {"process_noise_scale": 3.0, "fill_inflation": 4.0},
    "qivbf": {"vb_iterations": 3, "prior_count": 40.0, "fill": "extrapolate", "forgetting": 0.9},
    "qivbf_printed": {"vb_iterations": 2},
    "imm": {"process_noise_scale": 2.0, "mode_stay": 0.9},
    "bank": {"measurement_noise_scale": 2.0, "regime_stay": 0.9, "outlier_rate": 0.0},
}
every = pytest.mark.parametrize("name", TUNED)


def intervals(interval):
    """Rows of a schedule that covers the recording."""
    return -(-len(RECORDING) // interval)


@every
@pytest.mark.parametrize("interval", [1, 5, 100])
def test_a_constant_schedule_is_the_dict(name, interval):
    wanted = navgym.estimate(name, RECORDING, TUNED[name])
    lists = {key: [value] * intervals(interval) for key, value in TUNED[name].items()}
    identical(navgym.estimate(name, RECORDING, lists, interval), wanted)
    table = np.tile(navgym.parameter_space(name).array(TUNED[name]), (intervals(interval), 1))
    identical(navgym.estimate(name, RECORDING, table, interval), wanted)
    identical(navgym.estimate(name, RECORDING, table[0], interval), wanted)


@every
@given(interval=st.integers(1, 20), switch=st.integers(0, 20))
def test_a_row_acts_on_its_own_samples_only(name, interval, switch):
    """Up to the switch the estimate is the first rows'; after it, it is no longer."""
    space = navgym.parameter_space(name)
    switch = min(switch, intervals(interval) - 1)
    first, then = space.array()[0], space.array(TUNED[name])[0]
    table = np.tile(first, (intervals(interval), 1))
    table[switch:] = then
    found = navgym.estimate(name, RECORDING, table, interval)
    before = navgym.estimate(name, RECORDING, first)
    k = switch * interval
    np.testing.assert_array_equal(found.states[:k], before.states[:k])
    later = slice(k, min(k + 2 * interval + 12, len(RECORDING)))
    assert (found.states[later] != before.states[later]).any() or RECORDING.lost[k:].all()


def test_a_schedule_is_two_filters_run_one_after_the_other():
    """The Kalman filter restarted at the switch from where it stood, with the new parameters."""
    k, interval = 40, 8
    rows = intervals(interval)
    schedule = {"process_noise_scale": [1.0] * 5 + [9.0] * (rows - 5)}
    found = navgym.estimate("kf", RECORDING, schedule, interval)
    head = navgym.estimate("kf", RECORDING, {"process_noise_scale": 1.0})
    model = navgym.LinearModel(x0=head.states[k - 1], P0=head.covariances[k - 1])
    tail = navgym.Recording(
        RECORDING.time[k:], RECORDING.measurements[k:], RECORDING.lost[k:], model=model
    )
    rest = navgym.estimate("kf", tail, {"process_noise_scale": 9.0})
    np.testing.assert_array_equal(found.states[k:], rest.states)


def test_the_last_row_holds_to_the_end():
    short = {"process_noise_scale": [1.0, 7.0]}
    long = {"process_noise_scale": [1.0] + [7.0] * (intervals(5) - 1)}
    identical(navgym.estimate("kf", RECORDING, short), navgym.estimate("kf", RECORDING, long))


@pytest.mark.parametrize("parameter", ["initial_scale", "initial_count"])
def test_what_acts_at_the_start_only_follows_no_schedule(parameter):
    message = rf"{parameter} acts at the start only.* got .*20.*2.*: give one number"
    with pytest.raises(ValueError, match=message):
        navgym.estimate("qivbf", RECORDING, {parameter: [20.0, 2.0]})
    table = np.repeat(navgym.parameter_space("qivbf").array({parameter: 20.0}), 2, axis=0)
    table[1, navgym.parameter_space("qivbf").index(parameter)] = 2.0
    with pytest.raises(ValueError, match=message):
        navgym.estimate("qivbf", RECORDING, table)


@every
def test_each_recording_may_have_parameters_of_its_own(name):
    recordings = [navgym.simulate("auv/switch-B", seed, steps=60) for seed in range(3)]
    batch = StateSpaceBatch.of(recordings)
    found = run(name, batch, [{}, TUNED[name], {}], everything=True)
    for i, parameters in enumerate(({}, TUNED[name], {})):
        alone = navgym.estimate(name, recordings[i], parameters)
        identical(lane(found, i), alone)


def test_estimates_of_the_catalogue_have_the_documented_shapes():
    for name in CATALOGUE:
        found = navgym.estimate(name, RECORDING)
        assert found.states.shape == (83, 4)
        assert found.covariances.shape == (83, 4, 4)
        assert found.innovations.shape == (83, 4)
        assert found.nis.shape == found.log_likelihood.shape == (83,)
        assert type(found.diverged) is bool


def test_innovations_and_nis_are_nan_exactly_where_nothing_was_received():
    recording = navgym.simulate("auv/component-loss", 0, steps=200)
    for name in CATALOGUE:
        found = navgym.estimate(name, recording)
        if name != "qivbf_printed":
            np.testing.assert_array_equal(np.isnan(found.innovations), recording.lost)
            np.testing.assert_array_equal(np.isnan(found.nis), recording.lost.all(1))


def test_the_initial_state_holds_one_step_before_the_first_measurement():
    """With P0 next to nothing the first prediction is F x0."""
    model = navgym.LinearModel(x0=[1.0, 2.0, 3.0, 4.0], P0=1e-12 * np.eye(4), Q=1e-12 * np.eye(4))
    recording = navgym.Recording([10.0], [[0.0] * 4], model=model)
    np.testing.assert_allclose(navgym.estimate("kf", recording).states[0], [3, 2, 7, 4], atol=1e-9)


def test_padding_a_time_axis_keeps_the_model_of_each_sample():
    uneven = navgym.Recording([0.0, 1.0, 3.0, 3.5], np.ones((4, 4)))
    even = navgym.simulate("auv/nominal", 0, steps=9)
    found = run("kf", StateSpaceBatch.of([uneven, even]))
    np.testing.assert_array_equal(found.states[0, :4], navgym.estimate("kf", uneven).states)
    np.testing.assert_array_equal(found.states[1], navgym.estimate("kf", even).states)


def with_scales(scale):
    return navgym.Recording(
        RECORDING.time, RECORDING.measurements, RECORDING.lost, model=RECORDING.model,
        process_scale=scale, measurement_scale=scale,
    )  # fmt: skip


@pytest.mark.parametrize("name", [name for name in CATALOGUE if name != "oracle"])
def test_no_filter_but_the_oracle_reads_the_true_scales(name):
    a, b = (with_scales(scale) for scale in (np.ones(83), np.full(83, 50.0)))
    identical(navgym.estimate(name, a), navgym.estimate(name, b))


def test_the_oracle_reads_the_true_scales():
    a, b = (navgym.estimate("oracle", with_scales(np.full(83, s))).nis for s in (1.0, 4.0))
    assert np.nanmean(a) > 3 * np.nanmean(b)


PLAIN = navgym.Recording(np.arange(5.0), np.zeros((5, 4)))
TURN = navgym.simulate("auv/coordinated-turn", 0, steps=5)
BAD = [
    (lambda: navgym.estimate("kff", PLAIN), "unknown filter 'kff'. Did you mean 'kf'"),
    (lambda: navgym.estimate("KF_Extrapolate", PLAIN), "Did you mean 'kf_extrapolate'"),
    (lambda: navgym.estimate(3, PLAIN), "unknown filter 3"),
    (lambda: navgym.parameter_space("qivb"), "Did you mean 'qivbf'"),
    (
        lambda: navgym.estimate("kf", PLAIN, {"process_noise": 1}),
        "Did you mean 'process_noise_scale'",
    ),
    (lambda: navgym.estimate("kf", PLAIN, {"process_noise_scale": 1e9}), "1e-06..1e+06, got 1e+09"),
    (lambda: navgym.estimate("qivbf", PLAIN, {"vb_iterations": 2.5}), "whole number, got 2.5"),
    (lambda: navgym.estimate("kf", PLAIN, [1.0, 2.0, 3.0]), "2 columns"),
    (
        lambda: navgym.estimate("kf", PLAIN, {"process_noise_scale": [1.0, 1.0]}),
        "at most 1 rows, got 2",
    ),
    (lambda: navgym.estimate("kf", PLAIN, None, 0), "decision_interval must be a whole number"),
    (lambda: navgym.estimate("oracle", PLAIN), "'oracle' needs the true noise scales"),
    (lambda: navgym.estimate("kf", TURN), "'kf' needs a LinearModel"),
    (lambda: run("kf", StateSpaceBatch.of([PLAIN] * 3), [{}, {}]), "one dict per recording, got 2"),
    (lambda: navgym.estimate("kf", PLAIN, [{}, 3]), "parameters must hold dicts or numbers, not"),
    (lambda: navgym.estimate("kf", PLAIN, []), "parameters has the wrong shape, got shape (0,)"),
    (lambda: StateSpaceBatch.of([]), "at least one Recording, got none"),
    (
        lambda: StateSpaceBatch.of([PLAIN, navgym.simulate("auv/position-only", 0)]),
        "share one model size",
    ),
    (lambda: navgym.simulate("auv/switchD"), "Did you mean 'auv/switch-D'"),
    (lambda: navgym.simulate("switch-d"), "Did you mean 'auv/switch-D'"),
    (
        lambda: navgym.simulate("auv/nominal", steps=0),
        "steps must be a whole number of at least 1, got 0",
    ),
]


@pytest.mark.parametrize(("act", "message"), BAD)
def test_bad_requests_are_refused_with_field_value_and_remedy(act, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        act()


def test_something_that_is_no_recording_is_refused():
    with pytest.raises(TypeError, match=r"must be one of Recording, .*, got ndarray"):
        navgym.estimate("kf", np.zeros((5, 4)))
