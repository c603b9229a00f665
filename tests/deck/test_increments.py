"""Increments of the flexure as two IMUs show them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import navgym
from navgym.deck.estimation import final_alignment, flexure_increments
from navgym.deck.increments import increments_of, rodrigues
from navgym.inertial.flexure import ARCMIN
from navgym.inertial.imu import NO_ERRORS
from tests.deck.lanes import prepare

PERFECT = {"main": NO_ERRORS, "sub": NO_ERRORS}


@pytest.fixture(scope="module")
def ship():
    return navgym.simulate("deck/paper", 3, duration=120.0, **PERFECT)


def true_increments(recording):
    return np.diff(recording.at_steps(recording.theta), axis=0)


def true_alignment(recording):
    """C_is^im, from the reference attitude."""
    tape = prepare([recording])[2][0]
    main, sub = (Rotation.from_quat(np.array(tape[n]), scalar_first=True) for n in ("q_m", "q_s"))
    given = Rotation.from_quat(np.array(recording.at_steps(recording.reference)))
    return (main * given * sub.inv())[0]


def rms(x):
    return np.sqrt((x**2).mean(axis=0))


def test_inertial_increments_are_those_of_theta(ship):
    """To a thousandth with the true alignment, perfect IMUs."""
    found = flexure_increments(ship, true_alignment(ship))
    assert found.shape == (ship.steps - 1, 3)
    wanted = true_increments(ship)
    assert (rms(found - wanted) < 0.005 * rms(wanted)).all()


def test_the_filters_own_alignment_is_the_default(ship):
    found = flexure_increments(ship)
    np.testing.assert_array_equal(found, flexure_increments(ship, final_alignment(ship)))
    wanted = true_increments(ship)
    assert (rms(found - wanted) < 0.1 * rms(wanted)).all()
    assert (final_alignment(ship).inv() * true_alignment(ship)).magnitude() / ARCMIN < 2.0


def test_printed_increments_lock_on_to_the_sway(ship):
    """Eq. 16 leaves δΘ × θ in, θ from its first value on: an error as large as what is sought."""
    wanted = true_increments(ship)
    error = flexure_increments(ship, true_alignment(ship), "body") - wanted
    assert (rms(error) > 0.5 * rms(wanted)).all()
    assert rms(error)[2] > 1.5 * rms(wanted)[2]
    turns = Rotation.from_quat(np.array(prepare([ship])[2][0]["q_m"]), scalar_first=True)
    sway = (turns[:-1].inv() * turns[1:]).as_rotvec()
    left = np.cross(sway, ship.at_steps(ship.theta)[1:] - ship.theta[0])
    assert (rms(error - left) < 0.05 * rms(error)).all()


def test_gyro_noise_is_all_that_errors_of_the_imus_add(ship):
    noisy = navgym.simulate("deck/paper", 3, duration=120.0)
    error = flexure_increments(noisy, true_alignment(ship)) - true_increments(ship)
    walk = noisy.model.gyro_noise * np.sqrt(noisy.step)
    assert (0.9 * walk < rms(error)).all()
    assert (rms(error) < 3.0 * walk).all()


def test_increments_beside_a_gap_are_nan(ship):
    angle = ship.sub_angle.copy()
    angle[1000:1003] = np.nan
    found = flexure_increments(replace(ship, sub_angle=angle), true_alignment(ship))
    lost = np.isnan(found).all(axis=1)
    assert np.flatnonzero(lost).tolist() == [199, 200]
    assert np.isfinite(found[~lost]).all()


def test_frames_have_names(ship):
    tape = prepare([ship])[2][0]
    with pytest.raises(ValueError, match="inertial"):
        increments_of(tape, rodrigues(np.zeros(3)), "inertal")
