"""Recordings of two IMUs: what is refused, what is noticed, and what survives a file."""

import copy
import dataclasses
import json
import pickle
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import navgym
from navgym.deck.model import DeckModel, lever_matrix
from navgym.deck.recording import DualIMURecording, resample, steadiness, turning
from navgym.deck.scenarios import DECK_CATALOGUE
from navgym.deck.simulation import simulate
from navgym.inertial.earth import GRAVITY
from navgym.inertial.flexure import FlexureModel

IMU = ("main_angle", "main_velocity", "sub_angle", "sub_velocity")
STEPS = ("disturbance", "disturbance_variance", "impulse_variance", "impulse_left", "true_flexure")


@pytest.fixture(scope="module")
def ship():
    """30 s of a ship that sways by 10°."""
    return simulate(DECK_CATALOGUE["paper"].override(duration=30.0), [0])[0]


def fields_of(recording, **changes):
    """Every field of a recording, some changed; the units are checked."""
    found = {f.name: getattr(recording, f.name) for f in dataclasses.fields(recording)}
    return found | {"check_units": True} | changes


def rates_of(recording):
    """Arguments of from_rates: time, then rates and forces of the main and the sub IMU."""
    return [recording.time, *(getattr(recording, name) / recording.interval for name in IMU)]


def still(T=40, **changes):
    """A deck at rest: a little noise and gravity."""
    rng = np.random.default_rng(0)
    rates = [1e-4 * rng.standard_normal((T, 3)) for _ in range(2)]
    force = np.tile([0.0, 0.0, -GRAVITY], (T, 1)) + 1e-3 * rng.standard_normal((T, 3))
    arguments = {
        "time": np.arange(T) / 100.0, "main_rate": rates[0], "main_force": force,
        "sub_rate": rates[1], "sub_force": force.copy(),
    } | changes  # fmt: skip
    return DualIMURecording.from_rates(**arguments)


# --- what it holds --------------------------------------------------------------------------------


def test_rates_become_increments_over_one_interval(ship):
    time, *given = rates_of(ship)
    made = DualIMURecording.from_rates(time, *given)
    for name in IMU:
        assert np.allclose(getattr(made, name), getattr(ship, name), rtol=1e-12, atol=0)
    assert made.interval == pytest.approx(0.01)
    assert len(made) == 3000


def test_filter_steps_end_with_their_last_sample(ship):
    assert ship.steps == 600
    assert ship.step == pytest.approx(0.05)
    assert ship.step_time[:2] == pytest.approx([0.05, 0.10])
    ragged = still(T=13)
    assert ragged.steps == 2
    assert ragged.step_time == pytest.approx(ragged.time[[4, 9]])


def test_the_reference_at_steps_is_the_references_own(ship):
    assert np.array_equal(ship.step_reference, ship.at_steps(ship.reference))
    own = dataclasses.replace(ship, attitude=ship.reference)
    assert np.array_equal(own.step_reference, own.at_steps(own.reference))
    assert still().step_reference is None


def test_the_reference_follows_from_the_truth_or_is_what_was_given(ship):
    turn = Rotation.from_quat(np.array(ship.reference[70]))
    wanted = Rotation.from_rotvec(ship.theta[70] + 0.0) * Rotation.from_rotvec(ship.static + 0.0)
    assert (turn * wanted.inv()).magnitude() < 1e-12
    assert still().reference is None
    given = np.tile([0.0, 0.0, 0.0, 1.0], (40, 1))
    assert np.array_equal(still(attitude=given).reference, given)


def test_unit_quaternions_are_normalised_to_rounding():
    given = np.tile([0.001, 0.0, 0.0, 1.0], (40, 1))
    reference = still(attitude=1.005 * given).reference
    np.testing.assert_allclose(np.linalg.norm(reference, axis=1), 1.0, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(reference[0, 0] / reference[0, 3], 0.001, rtol=1e-12)


def test_arrays_are_copies_and_read_only(ship):
    time = np.arange(40) / 100.0
    recording = still(time=time)
    time[0] = -1.0
    assert recording.time[0] == 0.0
    for name in ("time", *IMU, "theta", "theta_rate", "static", "regime", *STEPS):
        array = getattr(ship, name)
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        ship.theta = None


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda r: pickle.loads(pickle.dumps(r))])  # fmt: skip
def test_copies_keep_every_number_and_stay_read_only(ship, copied):
    twin = copied(ship)
    for name in ("time", *IMU, "theta", "static", *STEPS):
        assert np.array_equal(getattr(twin, name), getattr(ship, name))
        assert not getattr(twin, name).flags.writeable
    assert not twin.model.lever_arm.flags.writeable
    assert twin.meta == ship.meta


# --- what is refused ------------------------------------------------------------------------------

T40 = np.arange(40) / 100.0


def at(k, value, shape=(40, 3)):
    array = np.full(shape, 1e-4)
    array[k] = value
    return array


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time": T40[:, None]}, r"time must have shape \(T,\)"),
        ({"time": [0.0]}, r"time must have shape \(T,\) with T of at least 2, got \(1,\)"),
        ({"time": np.where(T40 == 0.2, np.nan, T40)}, r"time must be finite, got nan at index \(20,\)"),
        ({"time": np.where(T40 == 0.2, 0.19, T40)}, r"time\[19\] = 0\.19 is followed by 0\.19: sort .* drop duplicates"),
        ({"time": T40[::-1]}, r"time must increase strictly, but time\[0\] = 0\.39"),
        ({"time": T40 + (T40 > 0.2)}, r"even steps, but 1\.01 s follow time\[20\] = 0\.2 .*use navgym.deck.recording.resample"),
        ({"time": T40 + 0.001 * (T40 == 0.3)}, "even steps, but 0.011 s follow"),
        ({"main_rate": at(3, np.inf)}, r"main_rate must be finite or NaN, got inf at sample 3: mark it as NaN"),
        ({"sub_force": at(slice(None), np.nan)}, "sub_force holds nothing but NaN"),
        ({"sub_rate": at(0, 0.0, (39, 3))}, r"sub_rate has 39 rows and time has 40: .*resample"),
        ({"sub_rate": at(0, 0.0, (41, 3))}, "sub_rate has 41 rows and time has 40"),
        ({"main_force": at(0, 0.0, (40, 2))}, r"main_force must have shape \(T, 3\), a row per sample, got \(40, 2\)"),
        ({"main_force": at(0, 0.0, (3, 40))}, r"main_force must have shape \(T, 3\)"),
        ({"main_rate": "fast"}, "main_rate must be an array of numbers"),
        ({"theta": np.zeros((40, 2))}, r"theta must have shape \(40, 3\) \(a row per IMU sample\), got \(40, 2\)"),
        ({"theta_rate": np.zeros((8, 3))}, r"theta_rate must have shape \(40, 3\)"),
        ({"theta": at(5, np.nan)}, r"theta must be finite, got nan at index \(5, 0\)"),
        ({"static": np.zeros(2)}, r"static must have shape \(3,\) \(a rotation vector in rad\)"),
        ({"attitude": np.ones((40, 4))}, "attitude must hold unit quaternions, got length 2 at 0"),
        ({"attitude": np.ones((8, 4))}, r"attitude must have shape \(40, 4\) \(a quaternion per IMU sample"),
        ({"regime": np.zeros(8)}, r"regime must have shape \(40,\)"),
        ({"regime": np.full(40, 0.5)}, r"regime must hold whole numbers, got 0\.5 at sample 0"),
        ({"disturbance": np.zeros((40, 6))}, r"disturbance must have shape \(8, 6\) \(a row per filter step\)"),
        ({"disturbance_variance": np.zeros((8, 3))}, r"disturbance_variance must have shape \(8, 6\)"),
        ({"impulse_variance": np.zeros((8, 6))}, r"impulse_variance must have shape \(8, 3\)"),
        ({"true_flexure": np.zeros((8, 6))}, r"true_flexure must have shape \(8, 9\)"),
        ({"model": DeckModel(samples_per_step=21)}, "time has 40 samples, two filter steps need 42: record longer"),
        ({"meta": {"when": {1, 2}}}, "meta must hold only what JSON can write"),
        ({"gyro_limit": 0.0}, "limit of main_rate must be a finite number above 0"),
        ({"force_limit": -5}, "limit of main_force must be a finite number above 0"),
    ],
)  # fmt: skip
def test_a_fault_names_the_field_the_value_and_the_remedy(changes, message):
    with pytest.raises(ValueError, match=message):
        still(**changes)


def test_a_model_of_another_kind_is_refused():
    with pytest.raises(TypeError, match=r"model must be a navgym\.DeckModel, got .*LinearModel"):
        still(model=navgym.LinearModel())


# --- units ----------------------------------------------------------------------------------------

DEGREE = np.pi / 180.0


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (1.0 / DEGREE, r"in °/s: convert them with numpy\.radians"),
        (3600.0 / DEGREE, r"in °/h: convert them with numpy\.radians\(\.\.\.\) / 3600"),
        (3600.0, "in °/h but taken for °/s: divide them by 3600"),
        (1.0 / 3600.0, "in °/s but taken for °/h: multiply them by 3600"),
        (DEGREE, "in rad/s but taken for °/s"),
        (DEGREE / 3600.0, "in rad/s but taken for °/h"),
    ],
)
@pytest.mark.parametrize("imu", ["main", "sub"])
def test_rates_in_other_units_are_named(ship, factor, message, imu):
    wrong = getattr(ship, f"{imu}_angle") * factor
    with pytest.raises(ValueError, match=f"{imu}_angle: .*{message}"):
        DualIMURecording(**fields_of(ship, **{f"{imu}_angle": wrong}))
    kept = DualIMURecording(**fields_of(ship, **{f"{imu}_angle": wrong}, check_units=False))
    assert np.array_equal(getattr(kept, f"{imu}_angle"), wrong)


def test_right_units_pass_at_any_sway_and_at_rest():
    for sway in (0.0, 0.05, 1.0, 25.0):
        scenario = DECK_CATALOGUE["lever"].override(duration=10.0, sway=(sway,) * 3)
        recording = simulate(scenario, [0])[0]
        assert DualIMURecording(**fields_of(recording)).interval == recording.interval
    assert len(still()) == 40


@pytest.mark.parametrize("imu", ["main", "sub"])
def test_forces_in_g_are_named(ship, imu):
    name = f"{imu}_velocity"
    with pytest.raises(ValueError, match=f"{name}: .*they look like g: multiply by 9.80665"):
        DualIMURecording(**fields_of(ship, **{name: getattr(ship, name) / GRAVITY}))
    with pytest.raises(ValueError, match=rf"{name}: the usual specific force is 98\.\d m/s²"):
        DualIMURecording(**fields_of(ship, **{name: getattr(ship, name) * 10.0}))


def test_units_are_judged_by_what_was_received(ship):
    """More than half of the samples lost leaves the usual force what it is."""
    broken = {name: np.array(getattr(ship, name)) for name in IMU}
    broken["sub_velocity"][1000:] = np.nan
    recording = DualIMURecording(**fields_of(ship, **broken))
    assert recording.gaps.sum() == 2000


def test_steadiness_is_one_where_rates_explain_all_that_turns():
    rng = np.random.default_rng(1)
    rate = rng.standard_normal((500, 3))
    force = turning(rate * 0.01).apply([0.0, 0.0, -GRAVITY], inverse=True)
    assert steadiness(rate, force, 0.01) == pytest.approx(1.0, abs=1e-12)
    assert steadiness(-rate, force, 0.01) < 0.999


@given(st.integers(1, 70), st.integers(0, 99))
def test_turning_multiplies_one_turn_after_the_other(count, seed):
    angle = np.random.default_rng(seed).standard_normal((count, 3))
    total, wanted = Rotation.identity(), []
    for turn in Rotation.from_rotvec(angle):
        total = total * turn
        wanted.append(total.as_matrix())
    assert np.allclose(turning(angle).as_matrix(), wanted, atol=1e-13)


# --- lost and saturated samples -------------------------------------------------------------------


def test_bursts_of_nan_are_gaps_and_keep_their_place():
    rate = at(slice(10, 15), np.nan)
    force = np.tile([0.0, 0.0, -GRAVITY], (40, 1))
    force[30, 2] = np.nan
    recording = still(main_rate=rate, sub_force=force)
    assert recording.gaps.nonzero()[0].tolist() == [10, 11, 12, 13, 14, 30]
    assert np.isnan(recording.main_angle[12]).all()
    assert np.isfinite(recording.sub_angle).all()


def clipped(limit=0.19):
    return np.clip(0.2 * np.sin(T40[:, None] * 20.0) * [1.0, 0.1, 0.1], -limit, limit)


def test_a_saturated_gyro_is_warned_of_where_it_happens():
    with pytest.warns(UserWarning, match=r"sub_rate looks saturated: axis 0 .* 0\.19, .*gyro_limit=") as caught:  # fmt: skip
        still(sub_rate=clipped())
    assert caught[0].filename == __file__.replace(".pyc", ".py")


def test_a_known_limit_turns_saturated_samples_into_lost_ones():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        recording = still(sub_rate=clipped(), gyro_limit=0.19, force_limit=50.0)
    assert np.array_equal(np.isnan(recording.sub_angle[:, 0]), np.abs(clipped()[:, 0]) >= 0.19)
    assert np.isfinite(recording.sub_angle[:, 1:]).all()
    assert np.isfinite(recording.main_velocity).all()


def test_clean_data_and_constant_data_are_not_called_saturated():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        still()
        still(main_rate=np.zeros((40, 3)))
        still(main_rate=np.tile([1e-4, 2e-4, 0.0], (40, 1)))


def test_held_samples_and_quantised_rest_are_not_called_saturated():
    rng = np.random.default_rng(0)
    held = np.repeat(rng.standard_normal((10, 3)), 4, axis=0) * 0.1
    quantised = rng.integers(-1, 2, (40, 3)) * 1e-3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        still(main_rate=held, sub_rate=quantised)


def test_a_gyro_saturated_for_most_of_the_time_is_noticed():
    with pytest.warns(UserWarning, match="sub_rate looks saturated"):
        still(sub_rate=clipped(0.08))


def test_an_axis_that_never_answered_is_lost_without_a_fuss():
    rate = at(slice(None), 1e-4)
    rate[:, 1] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert still(sub_rate=rate).gaps.all()


# --- files ----------------------------------------------------------------------------------------


def test_a_file_gives_back_every_field(ship, tmp_path):
    path = ship.save(tmp_path / "ship.npz")
    back = DualIMURecording.load(path)
    for name in ("time", *IMU, "theta", "theta_rate", "static", "regime", *STEPS):
        assert np.array_equal(getattr(back, name), getattr(ship, name)), name
    assert back.attitude is None
    assert back.meta == ship.meta
    for name, value in ship.model.arrays().items():
        assert np.array_equal(back.model.arrays()[name], value), name
    assert isinstance(back.model.samples_per_step, int)


def test_a_file_of_a_bare_log_keeps_what_is_not_there(tmp_path):
    attitude = Rotation.from_rotvec(1e-3 * np.arange(120.0).reshape(40, 3)).as_quat()
    rate = at(7, np.nan)
    bare = still(attitude=attitude, sub_rate=rate, model=DeckModel(rate_noise=1e-3))
    back = DualIMURecording.load(bare.save(tmp_path / "bare.npz"))
    assert back.theta is None
    assert back.true_flexure is None
    assert back.model.rate_noise == 1e-3
    assert np.allclose(back.reference, bare.reference, atol=1e-15)
    assert np.array_equal(back.sub_angle, bare.sub_angle, equal_nan=True)


def test_recordings_of_the_other_kind_are_refused_by_name(ship, tmp_path):
    auv = navgym.Recording([0.0, 1.0], np.zeros((2, 4)), model=navgym.LinearModel())
    with pytest.raises(ValueError, match=r"holds a Recording, not a DualIMURecording: .*Recording\.load"):  # fmt: skip
        DualIMURecording.load(auv.save(tmp_path / "auv.npz"))
    with pytest.raises(ValueError, match=r"holds a DualIMURecording, not a Recording"):
        navgym.Recording.load(ship.save(tmp_path / "ship.npz"))


def test_truncated_and_foreign_files_are_refused(ship, tmp_path):
    path = ship.save(tmp_path / "ship.npz")
    whole = path.read_bytes()
    for size in (0, 10, len(whole) // 2, len(whole) - 30):
        path.write_bytes(whole[:size])
        with pytest.raises(ValueError, match="is not a navgym recording or is truncated"):
            DualIMURecording.load(path)
    np.savez(tmp_path / "foreign.npz", gyro=np.zeros(3))
    with pytest.raises(ValueError, match=r"not a navgym recording: it holds \['gyro'\]"):
        DualIMURecording.load(tmp_path / "foreign.npz")
    with pytest.raises(FileNotFoundError):
        DualIMURecording.load(tmp_path / "absent.npz")


@pytest.mark.parametrize(
    "damage",
    [
        {"main_angle": None},
        {"sub_velocity": np.zeros((5, 3))},
        {"time": np.zeros(3000)},
        {"model.flexure.damping": None},
        {"model.flexure.sigma": np.zeros(3)},
        {"model.samples_per_step": np.array(0)},
        {"model.colour": np.array(3.0)},
        {"model.gyro_noise": None},
        {"model.lever_arm": np.zeros(2)},
    ],
)
def test_a_damaged_file_says_so(ship, tmp_path, damage):
    path = ship.save(tmp_path / "ship.npz")
    with np.load(path) as file:
        arrays = dict(file)
    for name, value in damage.items():
        assert name in arrays or value is not None
        arrays.pop(name, None)
        if value is not None:
            arrays[name] = value
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match=r"ship\.npz is damaged: .*Save the recording again"):
        DualIMURecording.load(path)


def test_a_newer_file_is_refused(ship, tmp_path):
    path = ship.save(tmp_path / "ship.npz")
    with np.load(path) as file:
        arrays = dict(file)
    header = json.loads(str(arrays["header"])) | {"navgym": 99}
    np.savez(path, **arrays | {"header": np.array(json.dumps(header))})
    with pytest.raises(ValueError, match="has format 99, and this navgym reads"):
        DualIMURecording.load(path)


# --- uneven times ---------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1))
def test_straight_lines_stay_straight_at_any_times_in_any_order(seed):
    rng = np.random.default_rng(seed)
    time = rng.permutation(np.append(np.cumsum(rng.uniform(0.5, 1.5, 20)), [0.0]))
    slope, start = rng.standard_normal((2, 3))
    grid = np.linspace(0.0, time.max(), 37)
    found = resample(time, start + slope * time[:, None], grid)
    assert np.allclose(found, start + slope * grid[:, None], atol=1e-12)


def test_between_samples_too_far_apart_lies_nothing():
    time = np.array([0.0, 1.0, 2.0, 3.0, 8.0, 9.0, 10.0])
    grid = np.arange(0.0, 10.5, 0.5)
    lost = np.isnan(resample(time, time[:, None], grid)[:, 0])
    assert grid[lost].tolist() == np.arange(3.5, 8.0, 0.5).tolist()  # 3 and 8 were received
    assert not np.isnan(resample(time, time[:, None], grid, longest_gap=5.0)).any()
    strict = np.isnan(resample(time, time[:, None], grid, longest_gap=0.5)[:, 0])
    assert grid[~strict].tolist() == time.tolist()


def test_beyond_the_samples_lies_nothing():
    found = resample([0.0, 1.0, 2.0], np.ones((3, 1)), [-0.1, 0.0, 2.0, 2.1])
    assert np.isnan(found[:, 0]).tolist() == [True, False, False, True]


def test_the_first_of_equal_times_counts():
    found = resample([0.0, 1.0, 1.0, 2.0], [[0.0], [1.0], [9.0], [2.0]], [0.5, 1.0, 1.5])
    assert found[:, 0].tolist() == [0.5, 1.0, 1.5]


def test_what_was_lost_stays_lost_and_spoils_only_its_neighbourhood():
    values = np.array([[0.0, 0.0], [1.0, np.nan], [2.0, 2.0], [3.0, 3.0]])
    found = resample([0.0, 1.0, 2.0, 3.0], values, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5])
    assert np.isnan(found[:, 1]).tolist() == [False, True, True, True, False, False]
    assert np.isfinite(found[:, 0]).all()


def test_resampled_data_make_a_recording():
    rng = np.random.default_rng(3)
    time = np.sort(np.append(rng.uniform(0.0, 0.4, 80), [0.0, 0.4]))
    force = np.tile([0.0, 0.0, -GRAVITY], (82, 1))
    grid = np.arange(40) / 100.0
    recording = still(main_force=resample(time, force, grid, longest_gap=0.1))
    assert not recording.gaps.any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.0, 1.0], np.ones((3, 1)), [0.5]), r"values must have shape \(T, c\), .* got \(3, 1\)"),
        (([0.0, 1.0], np.ones(2), [0.5]), r"values must have shape \(T, c\)"),
        (([1.0, 1.0], np.ones((2, 1)), [0.5]), "time must hold at least two different times"),
        (([0.0, 1.0], np.ones((2, 1)), [0.5], -1.0), "longest_gap must be a finite number above 0"),
        (([0.0, np.nan], np.ones((2, 1)), [0.5]), "time must be finite"),
    ],
)
def test_data_that_cannot_be_resampled_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        resample(*arguments)


# --- the deck model -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"lever_arm": (1, 2)}, ValueError, r"lever_arm must have shape \(3,\), in m, got \(2,\)"),
        ({"lever_arm": (10_000, 0, 0)}, ValueError, "lever_arm must be in m, .* no ship is that long"),
        ({"lever_arm": (np.nan, 0, 0)}, ValueError, "lever_arm must be finite"),
        ({"flexure": 3}, TypeError, r"flexure must be a navgym\.FlexureModel"),
        ({"samples_per_step": 0}, ValueError, "samples_per_step must be a whole number of at least 1"),
        ({"samples_per_step": 2.0}, ValueError, "samples_per_step must be a whole number"),
        ({"gyro_bias": -1.0}, ValueError, "gyro_bias must be a finite number above 0"),
        ({"rate_noise": np.inf}, ValueError, "rate_noise must be a finite number above 0"),
    ],
)  # fmt: skip
def test_a_deck_model_names_its_faults(changes, error, message):
    with pytest.raises(error, match=message):
        DeckModel(**changes)


def test_a_deck_model_survives_its_arrays():
    model = DeckModel(flexure=FlexureModel(1.0, [0.1, 0.2, 0.3], 1e-3), lever_arm=(1, 2, 3))
    back = DeckModel.from_arrays(model.arrays())
    assert back.arrays().keys() == model.arrays().keys()
    for name, value in model.arrays().items():
        assert np.array_equal(back.arrays()[name], value)


def test_the_lever_matrix_is_the_cross_product():
    theta, lever = np.array([0.1, -0.2, 0.3]), np.array([10.0, 5.0, 2.0])
    assert np.allclose(lever_matrix(lever) @ theta, np.cross(theta, lever))
