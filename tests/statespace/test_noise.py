"""Noise scales by sensor and by axis."""

from __future__ import annotations

import numpy as np
import pytest

import navgym
from navgym.statespace.filters.catalogue import CATALOGUE
from navgym.statespace.noise import scaled

# the printed filter and the oracle take no noise scale of their own; the model's they believe all the same
FILTERS = sorted(set(CATALOGUE) - {"oracle"})


@pytest.fixture(scope="module")
def recording():
    return navgym.simulate("auv/nominal", seed=3, steps=60)


@pytest.mark.parametrize("name", FILTERS)
def test_a_scale_by_sensor_is_another_r_in_the_model(name, recording):
    """`position_noise_scale` = 4 is a model with four times the variance of position rows."""
    R = np.array(recording.model.R)
    R[0, 0] *= 4.0
    R[2, 2] *= 4.0
    R[1, 1] *= 0.5
    R[3, 3] *= 0.5
    other = navgym.Recording(
        time=recording.time,
        measurements=recording.measurements,
        model=navgym.LinearModel(R=R, dt=1.0),
    )
    scales = {"position_noise_scale": 4.0, "velocity_noise_scale": 0.5}
    found = navgym.estimate(name, recording, scales)
    wanted = navgym.estimate(name, other)
    np.testing.assert_allclose(found.states, wanted.states, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.nis, wanted.nis, rtol=1e-9, atol=1e-9)


def test_scales_are_listed_for_a_recording_and_leave_the_filters_own_first(recording):
    """`parameter_space(filter, recording)` adds them; an array has the filter's own columns."""
    space = navgym.parameter_space("kf", recording)
    own = navgym.parameter_space("kf")
    assert space.names == (*own.names, "position_noise_scale", "velocity_noise_scale")
    assert navgym.parameter_space("oracle", recording).names == ()
    plain = navgym.estimate("kf", recording, [1.0, 1.0]).states
    assert np.array_equal(plain, navgym.estimate("kf", recording).states)
    alone = navgym.simulate("auv/position-only", seed=3, steps=20)
    assert navgym.parameter_space("kf", alone).names == own.names


def test_correlations_stay_and_axes_scale_q():
    """Scales multiply variances by axis and leave correlations as they are; exactly r with all alike."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(4, 4))
    R, Q = A @ A.T + np.eye(4), np.eye(4) + 0.3
    names = {"sensors": ("gnss", "gnss", "dvl", "dvl"), "axes": ("flat", "flat", "up", "up")}
    y = rng.normal(size=(30, 4)).cumsum(0)

    def made(R, Q):
        model = navgym.LinearModel(F=np.eye(4), R=R, Q=Q, **names)
        return navgym.Recording(time=np.arange(30.0), measurements=y, model=model)

    both = {"gnss_noise_scale": 9.0, "dvl_noise_scale": 9.0}
    np.testing.assert_allclose(
        navgym.estimate("kf", made(R, Q), both).states,
        navgym.estimate("kf", made(R, Q), {"measurement_noise_scale": 9.0}).states,
        rtol=1e-12,
    )
    d = np.sqrt(np.diag([5.0, 5.0, 0.2, 0.2]))
    axes = {"flat_process_scale": 5.0, "up_process_scale": 0.2}
    np.testing.assert_allclose(
        navgym.estimate("kf", made(R, Q), axes).states,
        navgym.estimate("kf", made(R, d @ Q @ d)).states,
        rtol=1e-12,
    )


def test_a_turn_model_has_a_scale_for_each_of_its_sensors():
    """Range, bearing, speed, heading; translation and turn."""
    recording = navgym.simulate("auv/coordinated-turn", seed=1, steps=40)
    names = navgym.parameter_space("ukf", recording).names
    for name in ("range", "bearing", "speed", "heading"):
        assert f"{name}_noise_scale" in names
    assert {"translation_process_scale", "turn_process_scale"} < set(names)
    all_four = {f"{name}_noise_scale": 4.0 for name in ("range", "bearing", "speed", "heading")}
    np.testing.assert_allclose(
        navgym.estimate("ekf", recording, all_four).states,
        navgym.estimate("ekf", recording, {"measurement_noise_scale": 4.0}).states,
        rtol=1e-9,
    )


def test_wrong_names_and_schedules_are_refused(recording):
    """As for any parameter."""
    with pytest.raises(ValueError, match="position_noise_scale"):
        navgym.estimate("kf", recording, {"positoin_noise_scale": 2.0})
    with pytest.raises(ValueError, match="cannot change on the way"):
        navgym.estimate("kf", recording, {"position_noise_scale": [1.0, 2.0]})


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("unknown", [np.nan, 0.0])
def test_what_is_lost_needs_no_accuracy_whatever_fills_it(name, unknown):
    """The last known variance stands in, for fills and for modes: the answer is that of R kept."""
    rng = np.random.default_rng(0)
    y = rng.normal(size=(40, 4)).cumsum(0)
    y[10:13] = y[0] = np.nan
    y[20, 1] = np.nan
    R = np.tile(0.01 * np.eye(4), (40, 1, 1))
    gone = R.copy()
    gone[10:13] = gone[0] = gone[20, 1, 1] = unknown

    def states(R):
        model = navgym.LinearModel(dt=1.0, R=R)
        return navgym.estimate(
            name, navgym.Recording(time=np.arange(40.0), measurements=y, model=model)
        ).states

    assert np.array_equal(states(gone), states(R), equal_nan=True)


def test_a_scaled_model_is_what_filters_believe_under_the_same_scales(recording):
    scales = {"velocity_noise_scale": 7.0, "position_noise_scale": 0.5}
    model = scaled(recording.model, scales)
    same = navgym.Recording(recording.time, recording.measurements, recording.lost, model=model)
    own = navgym.estimate("kf", recording, scales).states
    assert np.array_equal(navgym.estimate("kf", same).states, own)
    with pytest.raises(ValueError, match="unknown noise scale 'depth_noise_scale'"):
        scaled(recording.model, {"depth_noise_scale": 2.0})
