"""What an estimate of a deck holds: attitude, static and dynamic deformation, and what it warns of."""

import warnings
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import navgym
from navgym.deck.alignment import THETA
from navgym.deck.estimation import attitude_error, attitudes
from navgym.deck.increments import rodrigues
from navgym.deck.mechanization import TAPE
from navgym.inertial.flexure import ARCMIN
from navgym.simulation import simulate_many


@pytest.fixture(scope="module")
def ship():
    return navgym.simulate("deck/paper", 1, duration=60.0)


@pytest.fixture(scope="module")
def found(ship):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a swaying sea shows everything
        return navgym.estimate("alignment", ship)


SHAPES = {
    "time": (), "attitude": (4,), "static": (3,), "theta": (3,), "theta_rate": (3,),
    "states": (24,), "covariances": (24, 24), "innovations": (6,), "innovation_variance": (6,),
    "weights": (6,), "model_error": (3,), "nis": (), "log_likelihood": (), "attitude_error": (3,),
}  # fmt: skip


def test_every_array_has_a_row_per_filter_step(found):
    for name, shape in SHAPES.items():
        array = getattr(found, name)
        assert array.shape == (1200, *shape), name
        assert np.isfinite(array).all(), name
    assert found.flexures == ()
    assert found.diverged is False
    assert found.unobserved.shape == (0, 3)
    told = {f.name for f in fields(found)} - {"extras"} | set(found.extras)
    assert set(SHAPES) | {"flexures", "diverged", "unobserved", "recording", "parameters"} == told
    np.testing.assert_allclose(found.time, 0.05 * np.arange(1, 1201))


def test_states_are_where_they_are_said_to_be(found):
    np.testing.assert_array_equal(found.theta, found.states[:, 18:21])
    np.testing.assert_array_equal(found.theta_rate, found.states[:, 21:])


def test_nis_and_likelihood_are_those_of_the_innovations(found, ship):
    """Their mean is 6 where the believed noise is right; the velocities are trusted too little."""
    assert 0.5 < found.nis[200:].mean() < 6.0
    ratio = found.innovations**2 / found.innovation_variance
    assert (found.nis >= ratio.max(axis=1) * (1.0 - 1e-9)).all()  # S's own diagonal bounds it


def test_attitudes_are_unit_quaternions_of_static_times_dynamic(found):
    assert np.abs(np.linalg.norm(found.attitude, axis=1) - 1.0).max() < 1e-12
    composed = Rotation.from_rotvec(found.theta) * Rotation.from_rotvec(found.static)
    assert (composed.inv() * Rotation.from_quat(found.attitude)).magnitude().max() < 1e-12


def test_the_attitude_error_is_that_against_the_reference(found, ship):
    true = Rotation.from_quat(np.array(ship.at_steps(ship.reference)))
    error = (Rotation.from_quat(found.attitude) * true.inv()).as_rotvec() / ARCMIN
    np.testing.assert_allclose(found.attitude_error, error, atol=1e-10)
    assert np.sqrt((found.attitude_error[600:] ** 2).sum(1).mean()) < 3.0
    assert np.sqrt((found.attitude_error[:5] ** 2).sum(1).mean()) > 10.0


@given(seed=st.integers(0, 2**32 - 1), axis=st.integers(0, 2), size=st.floats(-100.0, 100.0))
def test_attitude_errors_are_turns_in_the_main_axes(seed, axis, size):
    true = Rotation.random(5, rng=seed)
    turn = Rotation.from_rotvec(np.eye(3)[axis] * size * ARCMIN)
    wanted = np.tile(np.eye(3)[axis] * size, (5, 1))
    np.testing.assert_allclose(
        attitude_error((turn * true).as_quat(), true.as_quat()), wanted, atol=1e-9
    )
    np.testing.assert_allclose(attitude_error(true.as_quat(), true.as_quat()), 0.0, atol=1e-10)
    np.testing.assert_allclose(attitude_error(-true.as_quat(), true.as_quat()), 0.0, atol=1e-10)


@given(seed=st.integers(0, 2**32 - 1), degrees=st.floats(0.0, 170.0))
def test_true_states_give_the_true_attitude_and_static_deformation(seed, degrees):
    """C_s^m = C_im^m C_is^im (I + φ×) C_s^ŝ from any l, φ, θ and any attitudes of the IMUs."""
    rng = np.random.default_rng(seed)
    tape = np.zeros(4, TAPE)
    main, sub = Rotation.random(4, rng=rng), Rotation.random(4, rng=rng)
    tape["q_m"] = main.as_quat(scalar_first=True)
    tape["q_s"] = sub.as_quat(scalar_first=True)
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    states = 1e-3 * rng.standard_normal((4, 24))
    states[:, :3] = np.tan(np.radians(degrees) / 2.0) * axis
    start = Rotation.from_rotvec(np.radians(degrees) * axis)
    tilt = Rotation.from_rotvec(states[:, 6:9])
    wanted = main.inv() * start * tilt * sub
    attitude, static = attitudes(tape, states)
    assert (Rotation.from_quat(attitude).inv() * wanted).magnitude().max() < 1e-7
    bent = Rotation.from_rotvec(states[:, THETA]) * Rotation.from_rotvec(static)
    assert (bent.inv() * wanted).magnitude().max() < 1e-7


@given(seed=st.integers(0, 2**32 - 1), degrees=st.floats(1e-9, 170.0))
def test_rodrigues_parameters_solve_the_equation_that_defines_them(seed, degrees):
    """(I − l×) C = I + l× (IDAM eq. 67)."""
    axis = np.random.default_rng(seed).standard_normal(3)
    l = np.tan(np.radians(degrees) / 2.0) * axis / np.linalg.norm(axis)  # noqa: E741
    cross = np.cross(l, np.eye(3)).T  # columns l × e_j
    C = rodrigues(l).as_matrix()
    np.testing.assert_allclose((np.eye(3) - cross) @ C, np.eye(3) + cross, atol=1e-9)
    np.testing.assert_array_equal(rodrigues(np.zeros(3)).as_matrix(), np.eye(3))


def test_states_that_failed_give_nan_and_leave_the_rest(found, ship):
    tape = np.zeros(3, TAPE)
    tape["q_m"][:, 0] = tape["q_s"][:, 0] = 1.0
    states = np.zeros((3, 24))
    states[1, 5] = np.nan
    attitude, static = attitudes(tape, states)
    np.testing.assert_array_equal(np.isnan(attitude).all(axis=1), [False, True, False])
    np.testing.assert_array_equal(np.isnan(static).all(axis=1), [False, True, False])
    error = attitude_error(attitude, np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)))
    np.testing.assert_array_equal(np.isnan(error).all(axis=1), [False, True, False])


def test_without_truth_there_is_an_estimate_and_no_error(ship, found):
    blind = replace(ship, theta=None, theta_rate=None, static=None, true_flexure=None)
    other = navgym.estimate("alignment", blind)
    assert other.attitude_error is None
    np.testing.assert_array_equal(other.states, found.states)


def test_the_truth_is_not_used(ship, found):
    """θ, Φ and the true noises may be anything."""
    changed = replace(
        ship, theta=ship.theta + 1.0, theta_rate=-ship.theta_rate, static=ship.static - 0.5,
        true_flexure=ship.true_flexure * 2.0, impulse_variance=ship.impulse_variance + 1.0,
        disturbance_variance=ship.disturbance_variance + 1.0, regime=ship.regime + 1,
    )  # fmt: skip
    np.testing.assert_array_equal(navgym.estimate("alignment", changed).states, found.states)


def test_a_reference_attitude_of_a_log_serves_as_truth(ship, found):
    given_one = replace(ship, attitude=ship.reference, theta=None, theta_rate=None, static=None)
    other = navgym.estimate("alignment", given_one)
    np.testing.assert_allclose(other.attitude_error, found.attitude_error, atol=1e-9)


# --- warnings -------------------------------------------------------------------------------------


def test_where_nothing_moves_the_heading_is_reported_as_unobserved():
    """Gravity tells nothing of turns about itself: after a minute the heading is wrong by degrees."""
    still = navgym.simulate("deck/paper", 0, duration=60.0, sway=(0.0, 0.0, 0.0))
    with pytest.warns(UserWarning, match="cannot be observed"):
        found = navgym.estimate("alignment", still)
    assert found.unobserved.shape == (1, 3)
    assert abs(found.unobserved[0, 2]) > 0.99


def test_where_nothing_moves_the_filter_knows_that_it_does_not_know_the_heading():
    """Its error, 2° here, is within its own limits; roll and pitch are good to arcminutes."""
    recordings = simulate_many("deck/paper", range(8), duration=60.0, sway=(0.0, 0.0, 0.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        runs = [navgym.estimate("alignment", r) for r in recordings]
    error = np.array([r.attitude_error[-1] for r in runs]) * ARCMIN
    sd = 2.0 * np.sqrt([np.diag(r.covariances[-1])[:3] for r in runs])
    assert (sd[:, 2] > np.radians(1.0)).all()
    assert (np.abs(error[:, 2]) < 4.0 * sd[:, 2]).all()
    assert np.abs(error[:, :2]).max() < 2.0 * ARCMIN


def test_in_a_swaying_sea_nothing_is_unobserved(found, ship):
    sd = np.sqrt(np.diagonal(found.covariances[-1])[:3])
    assert (sd < 0.02 * ship.model.misalignment).all()


def test_missing_samples_are_counted_in_a_warning(ship):
    angle = ship.sub_angle.copy()
    angle[3000:3050] = np.nan
    with pytest.warns(UserWarning, match="50 of 6000 IMU samples are missing and were filled in"):
        found = navgym.estimate("alignment", replace(ship, sub_angle=angle))
    assert np.isnan(found.innovations[600:610, 3:]).all()
    assert np.isfinite(found.nis).all()
    assert np.sqrt((found.attitude_error[610:] ** 2).sum(1)).max() < 30.0


def test_a_recording_without_gaps_warns_of_nothing(ship):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        navgym.estimate("alignment_mcc", ship)


def test_warnings_point_at_the_callers_line(ship):
    angle = ship.sub_angle.copy()
    angle[3000] = np.nan
    with pytest.warns(UserWarning, match="1 of 6000 IMU samples are missing") as caught:
        navgym.estimate("alignment", replace(ship, sub_angle=angle))
    assert [w.filename for w in caught] == [__file__]


def test_a_filter_that_identified_nothing_says_so():
    brief = navgym.simulate("deck/paper", seed=0, duration=30.0)
    with pytest.warns(UserWarning, match="identified nothing in this recording of 30 s"):
        found = navgym.estimate("idam", brief)
    assert found.flexures == ()
