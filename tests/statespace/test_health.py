"""When a filter is called diverged: it foretells worse than who repeats or extends the last values."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings

import navgym
from navgym.core.health import RUNAWAY
from navgym.statespace.filters import kalman, nonlinear, qivbf, qivbf_printed
from navgym.statespace.filters.catalogue import CATALOGUE
from tests.helpers import problems, run_bank, run_family
from tests.statespace.test_bank import GRID
from tests.statespace.test_nonlinear import turn_recording
from tests.twins.health import BEHIND, behind

FEW = ((2, 1), (4, 4))
PLAIN = ["kf", "kf_hold", "kf_extrapolate", "ekf", "ukf", "ckf", "cukf"]  # believe a spike
ROBUST = ["vbakf", "qivbf", "bank", "bank_2026"]
SOUND = [*PLAIN, *ROBUST, "imm", "imm_wide"]
FAMILIES = {
    "kf": lambda r: run_family(kalman, r, (1.0, 1.0, 1.0)),
    "kf_zero": lambda r: run_family(kalman, r, (1.0, 1.0, 1.0), kalman.ZERO),
    "qivbf": lambda r: run_family(qivbf, r, (5, 5.0, 0.97, 5.0, 1.0, 1.0, 1, 1.0)),
    "qivbf_printed": lambda r: run_family(qivbf_printed, r, (5, 5.0, 5.0)),
    "ekf": lambda r: run_family(nonlinear, r, (1.0, 1.0, 1.0), nonlinear.EXTENDED),
    "cukf": lambda r: run_family(nonlinear, r, (1.0, 1.0, 0.7), nonlinear.ALTERNATING),
    "bank": lambda r: run_bank(r, GRID, 1),
}


def agrees(found, recording):
    """Whether the lane's last mean, and its flag, are those that its innovations have."""
    course = behind(recording.model, recording.time, recording.measurements, found["innovations"])
    np.testing.assert_allclose(found["lane"]["behind"], course[-1], rtol=1e-9, atol=1e-9)
    assert (found["lane"]["diverged"] == RUNAWAY) == (course >= BEHIND).any()


@pytest.mark.parametrize("name", FAMILIES)
@settings(max_examples=10)
@given(problem=problems(FEW, steps=7))
def test_every_family_is_watched_as_the_twin_says(name, problem):
    agrees(FAMILIES[name](problem.recording), problem.recording)


@pytest.mark.parametrize("name", ["ekf", "cukf"])
def test_angles_are_compared_by_the_shorter_way(name):
    """On a circle about the beacon, so that the bearing passes π again and again."""
    model = navgym.CoordinatedTurnModel(x0=[30, 0, 0, 3, 0.1], beacon=[0, 0])
    recording = turn_recording(model, 200, seed=1, loss=0.2)
    bearing = recording.measurements[~recording.lost[:, 1], 1]
    assert np.abs(np.diff(bearing)).max() > np.pi
    found = FAMILIES[name](recording)
    agrees(found, recording)
    assert found["lane"]["diverged"] == 0


def nominal(seed=0, steps=200, loss=0.0, **changed):
    """A recording of the paper's world, with other measurements, losses or model."""
    recording = navgym.simulate("auv/nominal", seed, steps=steps, loss=loss)
    return dataclasses.replace(recording, **changed)


def other(recording, y=None, **model):
    """The recording with other measurements, or parts of its model changed."""
    return navgym.Recording(
        recording.time, recording.measurements if y is None else y, truth=recording.truth,
        process_scale=recording.process_scale, measurement_scale=recording.measurement_scale,
        model=dataclasses.replace(recording.model, **model),
    )  # fmt: skip


@pytest.mark.parametrize("name", CATALOGUE)
@pytest.mark.parametrize("wrong", [1.3 * np.eye(4), -np.eye(4)], ids=["grows", "mirrors"])
def test_a_model_that_moves_wrongly_is_flagged(name, wrong):
    """Each step's prediction lies far off, which the next measurement tells."""
    recording = nominal(steps=120)
    F = wrong @ recording.model.F
    assert navgym.estimate(name, other(recording, F=F, dt=None)).diverged


@pytest.mark.parametrize("name", [*SOUND, "kf_zero", "oracle"])
@pytest.mark.parametrize("share", [1e-6, 1 / 300.0, 300.0])
def test_noise_that_the_model_has_wrong_is_no_divergence(name, share):
    """R 300 times larger than the model's: the motion is right, so the track is kept."""
    for seed in range(3):
        recording = nominal(seed)
        scaled = other(recording, R=share * recording.model.R)
        assert not navgym.estimate(name, scaled).diverged


@pytest.mark.parametrize("name", SOUND)
def test_noisier_measurements_than_the_model_has_are_no_divergence(name):
    for seed in range(3):
        recording = navgym.simulate("auv/nominal", seed, steps=200, measurement_scale=300.0)
        assert not navgym.estimate(name, recording).diverged


@pytest.mark.parametrize("name", ["kf", "imm", "ekf"])
def test_sensors_that_deny_each_other_are_told(name):
    """The fixes stand still, the velocity says 1.5 m/s, and the filter ends well off the fixes."""
    model = navgym.LinearModel.white_acceleration(1.0, 0.1, 1.0, 0.1, x0=[0.0, 1.5, 0.0, 1.5])
    y = np.tile([0.0, 1.5, 0.0, 1.5], (60, 1))
    found = navgym.estimate(name, navgym.Recording(np.arange(60.0), y, model=model))
    assert found.states[-1, 0] > 10.0
    assert found.diverged


def spiked(size, seed=0):
    """One fix of x that is off by `size` sigma, half-way."""
    recording = nominal(seed)
    y = recording.measurements.copy()
    y[100, 0] += size
    return other(recording, y)


def far(name, recording, metres):
    """Samples at which the estimate of x is further off than so many metres."""
    found = navgym.estimate(name, recording)
    off = np.abs(found.states[:, 0] - recording.truth[:, 0]) > metres
    return int(off.sum()), found.diverged


@pytest.mark.parametrize("name", SOUND)
@pytest.mark.parametrize("seed", range(3))
def test_one_spike_is_no_divergence(name, seed):
    """Nor does it matter how large it is, to filters that do not believe it."""
    for size in (1e3, 1e6) if name in ROBUST else (1e3,):
        assert not navgym.estimate(name, spiked(size, seed)).diverged


@pytest.mark.parametrize("name", ["kf", "ekf", "imm"])
def test_a_spike_that_is_believed_for_a_minute_is_divergence(name):
    """A mean square of 1e12 takes a plain filter more than forty samples to forget."""
    samples, diverged = far(name, spiked(1e6), 100.0)
    assert samples > 40
    assert diverged
    samples, diverged = far(name, spiked(1e3), 100.0)
    assert samples < 10
    assert not diverged


@pytest.mark.parametrize("name", SOUND)
@pytest.mark.parametrize("columns", [[0, 2], [0, 1, 2, 3]])
def test_held_values_are_no_divergence(name, columns):
    """Each value repeated five times, as receivers do: repeating it foretells four of five."""
    for seed in range(3):
        recording = nominal(seed)
        y = recording.measurements.copy()
        y[:, columns] = np.repeat(y[::5][:, columns], 5, axis=0)
        assert not navgym.estimate(name, other(recording, y)).diverged


@pytest.mark.parametrize("name", SOUND)
def test_an_hour_of_silence_that_ends_where_it_began_is_no_divergence(name):
    """The velocity that was known says kilometres; the first fix says that it was not kept."""
    rng = np.random.default_rng(0)
    time = np.arange(200.0) + 3600.0 * (np.arange(200) >= 100)
    y = rng.normal(size=(200, 4)) * [1.0, 0.1, 1.0, 0.1]
    y[60:100, [1, 3]] += 1.0  # under way, it seemed
    y[60:100, [0, 2]] += np.arange(40.0)[:, None]
    model = navgym.LinearModel.white_acceleration(np.diff(time, prepend=-1.0), 0.1)
    recording = navgym.Recording(time, y, model=model)
    assert not navgym.estimate(name, recording).diverged
