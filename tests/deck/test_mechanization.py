"""Strapdown mechanisation and matching quantities, against rotation products and noise-free truth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import navgym
from navgym.deck.alignment_model import pack
from navgym.deck.batch import DeckBatch
from navgym.deck.estimation import attitude_error, attitudes
from navgym.deck.mechanization import TAPE, coarse_alignment, tapes_of
from navgym.deck.model import DeckModel, lever_matrix
from navgym.deck.recording import DualIMURecording
from navgym.deck.simulation import _move
from navgym.inertial.earth import GRAVITY
from navgym.inertial.flexure import ARCMIN
from navgym.inertial.imu import NO_ERRORS
from navgym.simulation import find_scenario
from tests.deck.lanes import run_alignment

PERFECT = {"main": NO_ERRORS, "sub": NO_ERRORS}
NO_LEVER = DeckModel(lever_arm=(0.0, 0.0, 0.0))


def quaternions(tape, name):
    return Rotation.from_quat(np.array(tape[name]), scalar_first=True)


def tape_of(recording):
    return tapes_of([recording])[0][0]


def built(main_angle, main_velocity, sub_angle=None, sub_velocity=None, h=0.01, model=NO_LEVER):
    """A recording of increments; the sub IMU repeats the main one unless told otherwise."""
    return DualIMURecording(
        h * np.arange(1, len(main_angle) + 1), main_angle, main_velocity,
        main_angle if sub_angle is None else sub_angle,
        main_velocity if sub_velocity is None else sub_velocity,
        model=model, check_units=False,
    )  # fmt: skip


# --- shapes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("per", "steps"), [(1, 200), (5, 40), (7, 28)])
def test_a_tape_has_a_record_per_whole_filter_step(per, steps):
    scenario = {"duration": 2.0, "samples_per_step": 5}
    recording = navgym.simulate("deck/paper", 0, **scenario)
    model = DeckModel(samples_per_step=per)
    short = replace(
        recording, model=model, disturbance=None, disturbance_variance=None,
        impulse_variance=None, impulse_left=None, true_flexure=None,
    )  # fmt: skip
    tapes, lengths = tapes_of([short])
    assert tapes.dtype == TAPE
    assert tapes.shape == (1, steps)
    assert lengths.tolist() == [steps]
    last = per * steps - 1
    np.testing.assert_array_equal(tapes[0, -1]["theta"], short.theta[last])
    turned = Rotation.from_rotvec(short.main_angle[: last + 1] + 0.0)
    whole = np.prod([turned[i] for i in range(last + 1)])
    # the tape adds coning, a few 1e-6 rad here
    assert (whole.inv() * quaternions(tapes[0], "q_m")[-1]).magnitude() < 1e-4


def test_shorter_recordings_are_padded_with_zeros():
    recordings = [navgym.simulate("deck/glitch", 0, duration=d) for d in (2.0, 3.0)]
    tapes, lengths = tapes_of(recordings)
    assert lengths.tolist() == [40, 60]
    np.testing.assert_array_equal(tapes[0, :40], tape_of(recordings[0]))
    assert not tapes[0, 40:].tobytes().strip(b"\0")


def test_recordings_of_different_steps_do_not_share_a_batch():
    fast, slow = (
        navgym.simulate("deck/paper", 0, duration=2.0, samples_per_step=s) for s in (1, 5)
    )
    with pytest.raises(
        ValueError, match=r"share one filter step, got \[0.01, 0.05\] s: split them"
    ):
        DeckBatch.of([fast, slow])
    with pytest.raises(ValueError, match="at least one DualIMURecording, got none"):
        DeckBatch.of([])
    with pytest.raises(TypeError, match="must be a DualIMURecording, got"):
        DeckBatch.of([navgym.simulate("auv/nominal", 0)])


def test_a_recording_without_truth_leaves_nan_in_the_tape():
    tape = tape_of(built(np.full((20, 3), 1e-3), np.zeros((20, 3))))
    assert np.isnan(tape["theta"]).all()
    assert np.isnan(tape["theta_rate"]).all()
    assert np.isnan(tape["regime"]).all()


# --- attitude -------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), size=st.floats(0.0, 2.0))
def test_increments_about_one_axis_make_a_product_of_rotations(seed, size):
    """Without coning the attitude is scipy's product, for increments of 0 to 2 rad."""
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    angle = size * rng.uniform(-1.0, 1.0, 40)[:, None] * axis / np.linalg.norm(axis)
    tape = tape_of(built(angle, np.zeros((40, 3))))
    wanted = Rotation.from_rotvec(np.cumsum(angle, axis=0))
    for name in ("q_m", "q_s"):
        apart = quaternions(tape, name).inv() * wanted[4::5]
        assert apart.magnitude().max() < 1e-13 * (1.0 + 40 * size)
    assert (quaternions(tape, "q_mid").inv() * wanted[2::5]).magnitude().max() < 1e-10
    np.testing.assert_allclose(np.linalg.norm(tape["q_m"], axis=1), 1.0, atol=1e-12)


def coning(cone, rate, h, T):
    """Increments of a body whose z axis runs around a cone, and its true attitude (T,).

    Exp(cone (cos Ωt, sin Ωt, 0)): body rates are known in closed form, and so are their integrals.
    """
    t = h * np.arange(T + 1)
    attitude = Rotation.from_rotvec(cone * np.stack([np.cos(rate * t), np.sin(rate * t), 0 * t], 1))
    # ω = Ω (−sin κ sin Ωt, sin κ cos Ωt, cos κ − 1) in body axes
    integral = np.stack(
        [np.sin(cone) * np.cos(rate * t), np.sin(cone) * np.sin(rate * t), rate * (np.cos(cone) - 1) * t],
        axis=1,
    )  # fmt: skip
    return np.diff(integral, axis=0), attitude[0].inv() * attitude[1:]


def test_coning_is_corrected_to_fourth_order():
    """Products of plain increments drift by Ω³h²κ²/12; two-sample corrections leave 100 times less."""
    cone, rate, h = 0.05, 2.0 * np.pi, 0.01
    angle, truth = coning(cone, rate, h, 2000)
    naive = Rotation.identity()
    for a in angle:
        naive = naive * Rotation.from_rotvec(a)
    drift = (truth[-1].inv() * naive).magnitude()
    assert drift == pytest.approx(rate**3 * h**2 * cone**2 / 12.0 * 20.0, rel=0.05)
    error = (
        truth[-1].inv() * quaternions(tape_of(built(angle, 0.0 * angle)), "q_m")[-1]
    ).magnitude()
    assert error < 0.01 * drift


def test_the_error_of_coning_falls_with_the_fourth_power_of_the_interval():
    found = []
    for h in (0.02, 0.01):
        angle, truth = coning(0.1, 2.0 * np.pi, h, round(30.0 / h))
        tape = tape_of(built(angle, 0.0 * angle, h=h))
        found.append((truth[-1].inv() * quaternions(tape, "q_m")[-1]).magnitude())
    assert found[0] / found[1] == pytest.approx(16.0, rel=0.25)


# --- velocity and rates ---------------------------------------------------------------------------


def test_a_force_that_stands_still_in_space_adds_up():
    """C f is constant while the body cones: gravity, no matter how it turns, up to (ωh)²/6."""
    h, T, fine = 0.01, 1000, 64
    angle, truth = coning(0.1, 2.0 * np.pi, h, T)
    _, inside = coning(0.1, 2.0 * np.pi, h / fine, T * fine)
    g = np.array([0.3, -0.4, -GRAVITY])
    body = np.concatenate([[g], inside.inv().apply(g)])
    mean = (body[:-1] + body[1:]) / 2.0 * h / fine
    velocity = mean.reshape(T, fine, 3).sum(axis=1)
    tape = tape_of(built(angle, velocity))
    t = h * 5.0 * np.arange(1, 201)[:, None]
    turned = 0.1 * 2.0 * np.pi * h  # rad within a sample
    assert (np.abs(tape["V_m"] - g * t) / (GRAVITY * t)).max() < 1.1 * turned**2 / 6.0
    np.testing.assert_array_equal(tape["V_s"], tape["V_m"])
    plain = truth.apply(velocity).reshape(200, 5, 3).sum(axis=1)
    assert np.abs(plain - 0.05 * g).max() > 100.0 * np.abs(tape["dV"] - 0.05 * g).max()
    np.testing.assert_allclose(np.cumsum(tape["dV"], axis=0), tape["V_s"], atol=1e-10)


@pytest.mark.parametrize("h", [0.01, 0.005])
def test_mean_rates_stand_in_the_axes_of_the_start(h):
    """The mean over a step of C ω, for a body that turns and precesses, up to Ω (ωh)²/12."""
    rate, cone, fine, T = 2.0, 0.2, 20, 500
    angle, _ = coning(cone, rate, h, T)
    small, attitude = coning(cone, rate, h / fine, T * fine)
    before = Rotation.concatenate([Rotation.identity(), attitude[:-1]])
    turned = (before * Rotation.from_rotvec(small / 2)).apply(small)
    wanted = turned.reshape(T // 5, 5 * fine, 3).sum(axis=1) / (5.0 * h)
    tape = tape_of(built(angle, 0.0 * angle, h=h))
    limit = 1.3 * rate * (cone * rate * h) ** 2 / 12.0
    np.testing.assert_allclose(tape["w_m"], wanted, atol=limit)
    np.testing.assert_array_equal(tape["w_s"], tape["w_m"])


def test_the_rate_at_the_end_is_extrapolated_through_three_increments():
    """Exact for rates that are parabolas in time."""
    h = 0.01
    t = h * np.arange(101)
    integral = np.stack([0.1 * t, 0.2 * t**2, -0.1 * t + 0.3 * t**3], axis=1)
    tape = tape_of(built(np.diff(integral, axis=0), np.zeros((100, 3))))
    end = t[5::5]
    wanted = np.stack([0.1 + 0 * end, 0.4 * end, -0.1 + 0.9 * end**2], axis=1)
    np.testing.assert_allclose(tape["omega"], wanted, atol=1e-12)


def stiff(lever):
    """A minute on a deck that does not bend, as the simulator has it."""
    scenario = find_scenario(
        "deck/paper", duration=60.0, static=(0.0, 0.0, 0.0), lever_arm=lever, **PERFECT
    )
    motion, still = np.empty((4, 6000, 3)), np.zeros((6001, 3))
    _move(scenario, still, still, motion)
    return built(*motion, model=scenario.model)


def test_the_rigid_lever_arm_needs_no_derivative_of_a_rate():
    """With ω known, V_m gains C (ω × r) less its start: what an IMU that is r away measures."""
    recording = stiff((10.0, -4.0, 2.0))
    tape, bare = tape_of(recording), tape_of(replace(recording, model=NO_LEVER))
    assert np.abs(tape["V_s"] - bare["V_m"]).max() > 1.0
    assert np.abs(tape["V_s"] - tape["V_m"]).max() < 5e-5


def test_disturbances_enter_the_transmitted_values_and_no_integral():
    clean = navgym.simulate("deck/paper", 0, duration=3.0)
    disturbance = np.random.default_rng(0).standard_normal((clean.steps, 6))
    tape, base = tape_of(replace(clean, disturbance=disturbance)), tape_of(clean)
    np.testing.assert_allclose(tape["V_s"] - base["V_s"], disturbance[:, :3], atol=1e-12)
    np.testing.assert_allclose(tape["w_s"] - base["w_s"], disturbance[:, 3:], atol=1e-12)
    for name in ("V_m", "w_m", "dV", "q_s", "q_m", "q_mid", "omega"):
        np.testing.assert_array_equal(tape[name], base[name])


# --- the measurement equations --------------------------------------------------------------------


def residuals(recording):
    """What the matching quantities leave unexplained, with true l, θ and θ̇ (m/s, rad/s)."""
    tape = tape_of(recording)
    q_s, q_m = quaternions(tape, "q_s"), quaternions(tape, "q_m")
    turns = q_m * Rotation.from_quat(np.array(recording.at_steps(recording.reference))) * q_s.inv()
    v = turns[0].as_rotvec()
    angle = np.linalg.norm(v)
    l = np.tan(angle / 2.0) * v / angle  # noqa: E741
    L0 = lever_matrix(np.array(recording.model.lever_arm))
    theta, rate = tape["theta"], tape["theta_rate"]
    V_r = q_m.apply(np.cross(tape["omega"], theta @ L0.T) + rate @ L0.T)
    total = tape["V_s"] + tape["V_m"]
    velocity = tape["V_s"] - tape["V_m"] - np.cross(total, l) - (V_r - np.cross(l, V_r))
    mean = q_m[1:].apply(np.diff(theta, axis=0) / recording.step)
    total = (tape["w_s"] + tape["w_m"])[1:]
    turning = (tape["w_s"] - tape["w_m"])[1:] - np.cross(total, l) - (mean - np.cross(l, mean))
    wander = (turns * turns[0].inv()).magnitude().max() / ARCMIN
    # V_r counts from its value at t = 0, before the first sample: a free constant
    return np.abs(velocity - velocity.mean(axis=0)).max(), np.abs(turning).max(), wander


@pytest.mark.parametrize("static", [(10.0, 10.0, 30.0), (600.0, -600.0, 1800.0)])
@pytest.mark.parametrize("seed", [0, 5])
def test_without_noise_truth_satisfies_the_measurement_equations_for_300_s(static, seed):
    recording = navgym.simulate("deck/paper", seed, static=static, **PERFECT)
    velocity, turning, wander = residuals(recording)
    assert velocity < 5e-5
    assert turning < 1e-5
    assert wander < 1e-4


def test_the_static_deformations_lever_arm_is_missing_from_the_equations():
    """Φ × r0, 9 cm, leaves residuals a thousand times as large: IDAM eq. 4-7 omit it."""
    velocity, turning, _ = residuals(navgym.simulate("deck/paper", 5, static_lever=True, **PERFECT))
    assert 0.5 * 0.09 * np.radians(10.0) < velocity < 0.05
    assert turning < 1e-5


# --- gaps -----------------------------------------------------------------------------------------


def lossy(recording, *names, first=1500, count=20):
    """The recording without some streams' samples."""
    changes = {}
    for name in names:
        changes[name] = getattr(recording, name).copy()
        changes[name][first : first + count] = np.nan
    return replace(recording, **changes)


SUB, MAIN = ("sub_angle", "sub_velocity"), ("main_angle", "main_velocity")


@pytest.fixture(scope="module")
def ship():
    return navgym.simulate("deck/paper", 3, duration=60.0, static=(200.0, -150.0, 900.0))


def test_the_coarse_alignment_is_good_to_some_arcminutes(ship):
    wanted = Rotation.from_rotvec(ship.static + 0.0)
    assert (coarse_alignment(ship).inv() * wanted).magnitude() / ARCMIN < 30.0
    gone = lossy(ship, *SUB, first=1000, count=777)
    assert (coarse_alignment(gone).inv() * wanted).magnitude() / ARCMIN < 30.0


@pytest.mark.parametrize("names", [("sub_angle",), ("sub_velocity",), ("main_angle",), MAIN, SUB])
def test_a_burst_of_lost_samples_is_filled_from_the_other_imu(names, ship):
    whole, tape = tape_of(ship), tape_of(lossy(ship, *names))
    assert tape["gap"].tolist() == [0] * 300 + [5] * 4 + [0] * 896
    for name in TAPE.names:
        if name not in ("gap", "theta", "theta_rate", "regime"):
            np.testing.assert_array_equal(tape[name][:300], whole[name][:300])
            assert np.isfinite(tape[name]).all()
    for name in ("q_s", "q_m"):
        apart = (quaternions(tape, name).inv() * quaternions(whole, name)).magnitude() / ARCMIN
        assert apart[304:].max() < 10.0  # .2 s of sway (2° and more) known to some per cent
    assert np.abs(tape["V_s"] - whole["V_s"])[304:].max() < 3.0
    assert np.abs(tape["V_s"] - whole["V_s"])[303].max() < 0.1


def test_one_axis_lost_is_a_sample_lost(ship):
    angle = ship.sub_angle.copy()
    angle[1502, 1] = np.nan
    tape = tape_of(replace(ship, sub_angle=angle))
    assert np.flatnonzero(tape["gap"]).tolist() == [300]
    assert tape["gap"][300] == 1


def test_where_both_are_lost_the_last_sample_is_held(ship):
    gone = tape_of(lossy(ship, *MAIN, *SUB))
    held = {n: getattr(ship, n).copy() for n in (*MAIN, *SUB)}
    for stream in held.values():
        stream[1500:1520] = stream[1499]
    wanted = tape_of(replace(ship, **held))
    assert gone["gap"][300:304].tolist() == [5] * 4
    for name in ("V_s", "V_m", "q_s", "q_m", "w_s", "w_m", "omega"):
        np.testing.assert_array_equal(gone[name], wanted[name])


def test_a_recording_that_begins_with_a_gap_stays_finite(ship):
    for names in (SUB, MAIN, (*SUB, *MAIN)):
        tape = tape_of(lossy(ship, *names, first=0, count=7))
        assert tape["gap"][:3].tolist() == [5, 2, 0]
        for name in ("V_s", "V_m", "q_s", "q_m", "w_s", "w_m", "omega"):
            assert np.isfinite(tape[name]).all()


@pytest.mark.parametrize("every", [100, 40, 7])
def test_scattered_losses_leave_enough_to_align_by(every, ship):
    """One sample lost in each second spoils no second's mean."""
    changes = {name: getattr(ship, name).copy() for name in SUB}
    for stream in changes.values():
        stream[every // 2 :: every] = np.nan
    gone = replace(ship, **changes)
    wanted = Rotation.from_rotvec(ship.static + 0.0)
    assert (coarse_alignment(gone).inv() * wanted).magnitude() / ARCMIN < 60.0
    tape = tape_of(gone)
    assert tape["gap"].sum() == len(range(every // 2, 6000, every))
    whole = tape_of(ship)
    assert (quaternions(tape, "q_s").inv() * quaternions(whole, "q_s")).magnitude().max() < 0.01


@pytest.mark.parametrize("lost", [(0,), (1,), (2,), (0, 1, 2)])
def test_a_filter_starts_from_the_rate_that_the_mechanisation_starts_from(lost, ship):
    """V_r counts from the rate at the start, which a lost sample must not double or erase."""
    angle = ship.main_angle.copy()
    angle[list(lost)] = np.nan
    omega = pack(replace(ship, main_angle=angle))["omega"][0]
    np.testing.assert_allclose(omega, pack(ship)["omega"][0], atol=0.03)


def test_estimates_survive_a_gap(ship):
    """Rates are not used there, P grows, and the attitude stays as good as P says."""
    gone = lossy(ship, *SUB, first=3000, count=100)
    found = run_alignment([gone])
    assert np.isnan(found["innovations"][0, 600:620, 3:]).all()
    assert np.isfinite(found["innovations"][0, 620:]).all()
    assert found["lanes"]["diverged"][0] == 0
    attitude, _ = attitudes(found["tapes"][0], found["states"][0])
    error = np.linalg.norm(attitude_error(attitude, gone.at_steps(gone.reference)), axis=1)
    assert error[500:600].max() < 5.0
    assert error[620:].max() < 40.0
    assert error[-100:].max() < 6.0


def test_samples_beyond_the_last_whole_step_change_nothing():
    """Even where more are left over than there are steps."""
    whole = navgym.simulate("deck/paper", seed=0, duration=30.0)
    model = replace(whole.model, samples_per_step=60)
    names = ("time", "main_angle", "main_velocity", "sub_angle", "sub_velocity")
    tapes = []
    for count in (3000, 2940):
        parts = {name: getattr(whole, name)[:count] for name in names}
        cut = navgym.DualIMURecording(**parts, model=model, check_units=False)
        tapes.append(tapes_of([cut])[0][0, :49])
    longer = {name: getattr(whole, name)[:2999] for name in names}
    tapes.append(
        tapes_of([navgym.DualIMURecording(**longer, model=model, check_units=False)])[0][0]
    )
    for field in ("V_s", "w_m", "q_s", "dV"):
        np.testing.assert_allclose(tapes[0][field], tapes[1][field], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(tapes[0][field], tapes[2][field], rtol=1e-9, atol=1e-12)


def test_a_gap_at_the_start_of_both_imus_is_not_taken_for_weightlessness():
    whole = navgym.simulate("deck/paper", seed=0, duration=10.0)
    streams = {n: getattr(whole, n).copy() for n in ("main_velocity", "sub_velocity")}
    for stream in streams.values():
        stream[:50] = np.nan
    gappy = replace(whole, check_units=False, **streams)
    fallen = tapes_of([gappy])[0][0]["V_s"][9] - tapes_of([whole])[0][0]["V_s"][9]
    assert np.linalg.norm(fallen) < 0.4  # the sway of half a second; gravity would be 4.9
