"""Simulated decks: flexure, ship motion, IMU errors and disturbances against theory."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import navgym
from navgym.deck.mechanization import tapes_of
from navgym.deck.scenarios import DECK_CATALOGUE, DeckRegime, DeckScenario
from navgym.inertial.earth import EARTH_RATE, EQUATORIAL_RADIUS, GRAVITY, MICRO_G
from navgym.inertial.flexure import ARCMIN
from navgym.inertial.imu import DEGREE_PER_HOUR, DEGREE_PER_ROOT_HOUR, NO_ERRORS, ImuErrors
from navgym.simulation import find_scenario, simulate_many

IMU = ("main_angle", "main_velocity", "sub_angle", "sub_velocity")
TRUTH = ("theta", "theta_rate")
FIELDS = (
    *IMU,
    *TRUTH,
    "regime",
    "disturbance",
    "disturbance_variance",
    "impulse_variance",
    "impulse_left",
)
PERFECT = {"main": NO_ERRORS, "sub": NO_ERRORS}


def chi_square_band(count, share=1e-5):
    """Limits of a sample variance over its true value."""
    return chi2.ppf([share, 1.0 - share], count) / count


@pytest.fixture(scope="module")
def many():
    """θ and θ̇ at the first and the last sample of 400 voyages of 30 s, (400, 2, 3) each."""
    scenario = find_scenario("deck/paper", duration=30.0, rate=10.0, samples_per_step=1)
    recordings = simulate_many(scenario, range(400))
    return [np.stack([getattr(r, name)[[0, -1]] for r in recordings]) for name in TRUTH]


# --- catalogue and seeds --------------------------------------------------------------------------


@pytest.mark.parametrize("name", DECK_CATALOGUE)
def test_every_scenario_simulates_what_it_says(name):
    scenario = DECK_CATALOGUE[name]
    recording = navgym.simulate(f"deck/{name}", 7)
    assert len(recording) == scenario.duration * scenario.rate
    assert recording.steps == scenario.duration * scenario.rate / scenario.samples_per_step
    assert recording.interval == pytest.approx(1.0 / scenario.rate)
    assert recording.time[0] == pytest.approx(1.0 / scenario.rate)
    assert recording.meta == {
        "scenario": f"deck/{name}", "regimes": [r.name for r in scenario.regimes], "seed": 7,
    }  # fmt: skip
    assert recording.static == pytest.approx(np.array([10.0, 10.0, 30.0]) * ARCMIN)
    believed = recording.model.flexure
    assert np.array_equal(believed.stiffness, scenario.regimes[0].flexure.stiffness)
    assert f"deck/{name}" in navgym.scenarios()


@pytest.mark.parametrize("name", DECK_CATALOGUE)
def test_a_seed_is_one_recording_in_any_company(name):
    alone = navgym.simulate(f"deck/{name}", 5, duration=70.0)
    among = simulate_many(f"deck/{name}", [9, 5, 2], duration=70.0)[1]
    for field in (*FIELDS, "true_flexure"):
        np.testing.assert_array_equal(getattr(alone, field), getattr(among, field))
    np.testing.assert_array_equal(alone.model.lever_arm, among.model.lever_arm)
    other = navgym.simulate(f"deck/{name}", 6, duration=70.0)
    for field in (*IMU, *TRUTH):
        assert (getattr(other, field) != getattr(alone, field)).mean() > 0.99


def test_a_seed_that_no_split_owns_is_refused():
    with pytest.raises(ValueError, match="seed must lie in"):
        navgym.simulate("deck/paper", 3 * 10**9)


CHANGES = {
    "glitch rate": {"regimes": (DeckRegime(glitch_rate=0.4),)},
    "glitch size": {"regimes": (DeckRegime(glitch_rate=0.4, glitch_velocity=9.0),)},
    "outliers": {"regimes": (DeckRegime(outlier_rate=0.2),)},
    "imu errors": {"main": ImuErrors(), "sub": ImuErrors(1.0)},
    "no imu errors": PERFECT,
    "lever error": {"lever_error": 1.0},
    "sway": {"sway": (1.0, 2.0, 3.0), "latitude": -20.0},
    "static": {"static": (1.0, 2.0, 3.0)},
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_does_not_bend_the_deck_leaves_the_flexure_to_the_bit(change):
    base = navgym.simulate("deck/paper", 4, duration=20.0)
    other = navgym.simulate("deck/paper", 4, duration=20.0, **CHANGES[change])
    for name in TRUTH:
        np.testing.assert_array_equal(getattr(base, name), getattr(other, name))


def test_slams_add_to_a_flexure_that_is_otherwise_the_same():
    """The process is linear: what slams add obeys it without noise."""
    slam = DeckRegime(slam_rate=0.2)
    base = navgym.simulate("deck/paper", 4, duration=60.0)
    other = navgym.simulate("deck/paper", 4, duration=60.0, regimes=(slam,))
    x = np.stack([other.theta - base.theta, other.theta_rate - base.theta_rate], axis=-1)
    F = slam.flexure.transition(0.01)
    jumps = x[1:] - np.einsum("aij,kaj->kai", F, x[:-1])
    np.testing.assert_allclose(jumps[..., 0], 0.0, atol=1e-15)
    hit = (np.abs(jumps[..., 1]) > 1e-12).any(axis=1)
    per_step = np.concatenate([[False], hit]).reshape(-1, 5).any(axis=1)
    np.testing.assert_array_equal(per_step, (other.impulse_variance > 0.0).any(axis=1))
    assert 3 <= hit.sum() <= 30


def test_glitches_outliers_slams_and_each_imu_draw_from_streams_of_their_own():
    regime = DeckRegime(glitch_rate=0.1, slam_rate=0.2, outlier_rate=0.1)
    base = navgym.simulate("deck/paper", 4, duration=20.0, regimes=(regime,))
    louder = navgym.simulate("deck/paper", 4, duration=20.0, regimes=(regime,), sub=ImuErrors(1.0))
    for name in ("disturbance", "impulse_variance", "main_angle", "main_velocity"):
        np.testing.assert_array_equal(getattr(base, name), getattr(louder, name))
    assert (base.sub_angle != louder.sub_angle).all()
    np.testing.assert_array_equal(base.sub_velocity, louder.sub_velocity)
    calm = navgym.simulate(
        "deck/paper", 4, duration=20.0, regimes=(replace(regime, slam_rate=0.0),)
    )
    np.testing.assert_array_equal(base.disturbance, calm.disturbance)
    fewer = replace(regime, glitch_rate=0.05)
    less = navgym.simulate("deck/paper", 4, duration=20.0, regimes=(fewer,))
    both = less.disturbance != 0.0
    assert both.any()
    np.testing.assert_array_equal(less.disturbance[both], base.disturbance[both])
    for name in IMU:
        np.testing.assert_array_equal(getattr(base, name), getattr(less, name))


# --- flexure --------------------------------------------------------------------------------------


@pytest.mark.parametrize("when", [0, 1], ids=["start", "end"])
def test_theta_and_its_rate_keep_their_stationary_law(when, many):
    """At the first sample as after half a minute; a start from 0 would give the split to the filter."""
    model = DECK_CATALOGUE["paper"].model.flexure
    low, high = chi_square_band(400)
    for values, sigma in zip(many, (model.sigma, model.rate_sigma), strict=True):
        power = (values[:, when] ** 2).mean(axis=0) / sigma**2
        assert (low < power).all()
        assert (power < high).all()
    cross = (many[0][:, when] * many[1][:, when]).mean(axis=0) / (model.sigma * model.rate_sigma)
    assert np.abs(cross).max() < 4.5 / np.sqrt(400)


@pytest.mark.parametrize("oscillation", [0.0, 1.5])
def test_theta_correlates_as_the_model_says(oscillation):
    regime = DeckRegime(tau=(2.0, 2.0, 4.0), oscillation=oscillation)
    scenario = find_scenario(
        "deck/paper", duration=60.0, regimes=(regime,), rate=10.0, samples_per_step=1
    )
    theta = np.stack([r.theta for r in simulate_many(scenario, range(200))])
    lags = np.array([0.0, 0.5, 1.0, 2.0, 4.0, 8.0])
    found = np.array(
        [(theta[:, : 600 - k] * theta[:, k:]).mean(axis=(0, 1)) for k in (10 * lags).astype(int)]
    )
    wanted = regime.flexure.autocorrelation(lags)
    # some 10 independent spans of θ per minute and voyage
    assert np.abs((found - wanted) / regime.flexure.sigma**2).max() < 4.5 * np.sqrt(2.0 / 2000)


def test_the_printed_recursion_of_theta_explodes_and_the_exact_one_does_not():
    """Eq. 80 lacks a −1: θ(k+1) = (2 − 2μT)θ(k) + (2μT − b²T²)θ(k−1) doubles with every sample."""
    model = DECK_CATALOGUE["paper"].model.flexure
    T, damping, stiffness = 0.01, model.damping[0], model.stiffness[0]

    def recursion(constant):
        theta = np.array([model.sigma[0], model.sigma[0]])
        for _ in range(30_000):
            new = (2.0 - damping * T) * theta[1] + (
                damping * T - stiffness * T**2 + constant
            ) * theta[0]
            theta = np.array([theta[1], new])
            if abs(new) > 1e300:
                break
        return abs(theta[1])

    assert recursion(0.0) > 1e300
    assert recursion(-1.0) < model.sigma[0]
    theta = navgym.simulate("deck/paper", 0).theta
    assert np.abs(theta / model.sigma).max() < 6.0


def test_slams_come_as_a_poisson_process_and_have_their_size():
    recordings = simulate_many("deck/slam", range(40), duration=100.0)
    variance = np.stack([r.impulse_variance for r in recordings])
    counts = (variance[..., 0] > 0.0).sum(axis=1)
    # .2 per second over 100 s; two in one step of 50 ms are 1 % of them
    assert counts.mean() == pytest.approx(20.0, abs=4.5 * np.sqrt(20.0 / 40) + 0.2)
    low, high = chi_square_band(39)
    assert low < counts.var(ddof=1) / 20.0 < high
    rate_sigma = recordings[0].model.flexure.rate_sigma
    single = variance[variance[..., 0] > 0.0] / (4.0 * rate_sigma) ** 2
    assert np.median(single, axis=0) == pytest.approx(np.ones(3))
    np.testing.assert_allclose(single, np.rint(single), atol=1e-9)
    gaps = np.diff(np.flatnonzero((variance[..., 0] > 0.0).ravel())) * 0.05
    for wait in (1.0, 5.0, 10.0):  # exponential
        share = np.exp(-0.2 * wait)
        assert (gaps > wait).mean() == pytest.approx(share, abs=0.06)


def test_slams_raise_the_rate_by_what_they_are_said_to():
    recordings = simulate_many("deck/slam", range(300), duration=1.0)
    jumped = [r for r in recordings if (r.impulse_variance > 0.0).any()]
    assert 25 < len(jumped) < 90
    ratio = []
    for r in jumped:
        calm = navgym.simulate("deck/paper", r.meta["seed"], duration=1.0)
        k = int(np.argmax((r.impulse_variance > 0.0).any(axis=1)))
        gained = (r.theta_rate - calm.theta_rate)[5 * k + 4]
        ratio.append(gained**2 / r.impulse_variance[k])
    low, high = chi_square_band(3 * len(jumped))
    assert 0.9 * low < np.mean(ratio) < 1.1 * high


# --- ship motion ----------------------------------------------------------------------------------

STILL = {"sway": (0.0, 0.0, 0.0), "static": (0.0, 0.0, 0.0), "speed": 0.0, **PERFECT}


@pytest.mark.parametrize("latitude", [0.0, 45.0, -60.0])
@pytest.mark.parametrize("heading", [0.0, 130.0])
def test_at_rest_the_main_imu_feels_gravity_and_the_earths_rate(latitude, heading):
    r = navgym.simulate("deck/paper", 0, duration=2.0, latitude=latitude, heading=heading, **STILL)
    force = r.main_velocity / r.interval
    np.testing.assert_allclose(force, np.tile([0.0, 0.0, -GRAVITY], (200, 1)), atol=1e-12)
    north, down = np.cos(np.radians(latitude)), -np.sin(np.radians(latitude))
    c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    wanted = EARTH_RATE * np.array([north * c, -north * s, down])
    np.testing.assert_allclose(r.main_angle / r.interval, np.tile(wanted, (200, 1)), atol=1e-16)


def test_under_way_coriolis_and_transport_rate_are_there():
    """Sailing east at the equator: lighter by v²/R + 2Ωv (Eötvös), and turning faster about north."""
    r = navgym.simulate(
        "deck/paper", 0, duration=2.0, latitude=0.0, heading=90.0, **(STILL | {"speed": 10.0})
    )
    lift = 2.0 * EARTH_RATE * 10.0 + 10.0**2 / EQUATORIAL_RADIUS
    assert r.main_velocity[0] / r.interval == pytest.approx([0.0, 0.0, lift - GRAVITY], abs=1e-9)
    assert r.main_angle[0] / r.interval == pytest.approx(
        [0.0, -(EARTH_RATE + 10.0 / EQUATORIAL_RADIUS), 0.0], abs=1e-12
    )


def test_the_main_imus_increments_follow_the_sway():
    """Attitude by pitch, roll and heading (eq. 79) against the product of the increments."""
    r = navgym.simulate("deck/paper", 0, duration=20.0, **PERFECT)
    s = find_scenario("deck/paper")
    t = np.concatenate([[0.0], r.step_time])
    pitch, roll = 10.0 * np.sin(np.pi / 4 * t), 10.0 * np.sin(np.pi / 4 * t)
    heading = 45.0 + 10.0 * np.sin(np.pi / 5 * t)
    ship = Rotation.from_euler("ZYX", np.stack([heading, pitch, roll], axis=1), degrees=True)
    # the local frame turns with the earth and along it
    lat, v = np.radians(s.latitude), s.speed / np.sqrt(2.0)
    R = EQUATORIAL_RADIUS
    omega = np.array(
        [EARTH_RATE * np.cos(lat) + v / R, -v / R, -EARTH_RATE * np.sin(lat) - v * np.tan(lat) / R]
    )
    local = Rotation.from_rotvec(omega * t[:, None])
    inertial = local * ship
    tape = tapes_of([r])[0][0]
    found = Rotation.from_quat(np.array(tape["q_m"]), scalar_first=True)
    apart = (inertial[0].inv() * inertial[1:]).inv() * found
    assert apart.magnitude().max() < 1e-7


def test_gravity_stays_where_it_is_while_the_ship_sways():
    r = navgym.simulate("deck/paper", 0, duration=20.0, speed=0.0, **PERFECT)
    tape = tapes_of([replace(r, model=replace(r.model, lever_arm=(0.0, 0.0, 0.0)))])[0][0]
    turn = Rotation.from_euler("ZYX", [45.0, 0.0, 0.0], degrees=True)
    V = turn.apply(tape["V_m"])
    np.testing.assert_allclose(V[:, 2], -GRAVITY * r.step_time, atol=1e-3)
    assert np.abs(V[:, :2]).max() < 20.0 * GRAVITY * 20.0 * EARTH_RATE


def test_without_deformation_and_lever_arm_both_imus_measure_the_same():
    rigid = DeckRegime(sigma=(1e-12, 1e-12, 1e-12))
    r = navgym.simulate(
        "deck/paper", 0, duration=20.0, regimes=(rigid,), static=(0.0, 0.0, 0.0),
        lever_arm=(0.0, 0.0, 0.0), **PERFECT,
    )  # fmt: skip
    np.testing.assert_allclose(r.sub_angle, r.main_angle, atol=1e-15)
    np.testing.assert_allclose(r.sub_velocity, r.main_velocity, atol=1e-15)


def test_a_static_deformation_alone_turns_the_axes():
    rigid = DeckRegime(sigma=(1e-12, 1e-12, 1e-12))
    static = (600.0, -300.0, 1800.0)
    r = navgym.simulate(
        "deck/paper", 0, duration=5.0, regimes=(rigid,), static=static, lever_arm=(0.0, 0.0, 0.0),
        **PERFECT,
    )  # fmt: skip
    turn = Rotation.from_rotvec(np.array(static) * ARCMIN)
    np.testing.assert_allclose(turn.apply(r.sub_angle + 0.0), r.main_angle, atol=1e-15)
    np.testing.assert_allclose(turn.apply(r.sub_velocity + 0.0), r.main_velocity, atol=1e-14)


def relative_velocity(r):
    """What the sub's velocity gains on the main's over the record, in inertial axes (K, 3)."""
    bare = replace(r, model=replace(r.model, lever_arm=(0.0, 0.0, 0.0)))
    tape = tapes_of([bare])[0][0]
    q_m = Rotation.from_quat(np.array(tape["q_m"]), scalar_first=True)
    q_s = Rotation.from_quat(np.array(tape["q_s"]), scalar_first=True)
    start = (q_m * Rotation.from_quat(np.array(r.at_steps(r.reference))) * q_s.inv())[0]
    return start.apply(tape["V_s"]) - tape["V_m"], tape, q_m


def test_the_static_deformation_moves_the_lever_arm_by_twelve_centimetres_where_asked():
    lever = np.array([10.0, 10.0, 2.0])
    moved = Rotation.from_rotvec(np.array([10.0, 10.0, 30.0]) * ARCMIN).apply(lever) - lever
    assert np.linalg.norm(moved) == pytest.approx(0.12, abs=0.03)
    plain, shifted = (
        navgym.simulate("deck/paper", 3, duration=30.0, static_lever=s, **PERFECT)
        for s in (False, True)
    )
    (V, tape, q_m), (V_moved, _, _) = relative_velocity(plain), relative_velocity(shifted)
    np.testing.assert_array_equal(plain.main_velocity, shifted.main_velocity)
    np.testing.assert_array_equal(plain.sub_angle, shifted.sub_angle)
    swing = q_m.apply(np.cross(tape["omega"], moved))
    gained = (V_moved - V)[1:] - (V_moved - V)[0]
    np.testing.assert_allclose(gained, swing[1:] - swing[0], atol=3e-4)
    assert np.abs(gained).max() > 0.01


def test_lever_error_changes_only_what_the_filter_believes():
    exact, wrong = (
        navgym.simulate("deck/paper", 3, duration=5.0, lever_error=e) for e in (0.0, 0.5)
    )
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(exact, name), getattr(wrong, name))
    np.testing.assert_array_equal(exact.model.lever_arm, [10.0, 10.0, 2.0])
    levers = np.array(
        [
            r.model.lever_arm
            for r in simulate_many("deck/paper", range(400), duration=0.2, lever_error=0.03)
        ]
    )
    low, high = chi_square_band(400)
    power = ((levers - [10.0, 10.0, 2.0]) ** 2).mean(axis=0) / 0.03**2
    assert (low < power).all()
    assert (power < high).all()


# --- IMU errors -----------------------------------------------------------------------------------


def increments_error(seeds, duration=2.0, **errors):
    """Errors of the four streams, (4, seeds, T, 3), against the same voyage with perfect IMUs."""
    spoilt = simulate_many("deck/paper", seeds, duration=duration, **errors)
    clean = simulate_many("deck/paper", seeds, duration=duration, **PERFECT)
    return np.array(
        [
            [getattr(a, n) - getattr(b, n) for a, b in zip(spoilt, clean, strict=True)]
            for n in IMU
        ]
    )  # fmt: skip


def test_white_noise_has_its_density():
    only = ImuErrors(0.0, 0.001, 0.0, 10.0, 0.0, 0.0)
    error = increments_error(range(10), main=only.scaled(0.1), sub=only)
    gyro, accelerometer = 0.001 * DEGREE_PER_ROOT_HOUR * 0.1, 10.0 * MICRO_G * 0.1  # times √h
    wanted = np.array([gyro / 10, accelerometer / 10, gyro, accelerometer])
    low, high = chi_square_band(10 * 200 * 3)
    power = (error**2).mean(axis=(1, 2, 3)) / wanted**2
    assert (low < power).all()
    assert (power < high).all()
    flat = error[2].reshape(-1, 3) / gyro
    assert np.abs(np.corrcoef(flat.T) - np.eye(3)).max() < 4.5 / np.sqrt(2000)
    assert abs((error[2][:, 1:] * error[2][:, :-1]).mean() / gyro**2) < 4.5 / np.sqrt(5970)


def test_biases_are_constant_and_have_their_size():
    only = ImuErrors(0.01, 0.0, 50.0, 0.0, 0.0, 0.0)
    error = increments_error(range(150), duration=0.2, main=only.scaled(0.1), sub=only) * 100.0
    assert np.abs(error - error[:, :, :1]).max() < 1e-11
    gyro, accelerometer = 0.01 * DEGREE_PER_HOUR, 50.0 * MICRO_G
    wanted = np.array([gyro / 10, accelerometer / 10, gyro, accelerometer])[:, None]
    low, high = chi_square_band(150)
    power = (error[:, :, 0] ** 2).mean(axis=1) / wanted**2
    assert (low < power).all()
    assert (power < high).all()


def test_scale_factors_and_installation_errors_multiply_what_is_measured():
    """e = M x with a diagonal of scale factors and a skew part of installation angles."""
    only = ImuErrors(0.0, 0.0, 0.0, 0.0, 5.0, 5.0)
    lively = {"duration": 2.0, "sway_rate": (5.0, 3.0, 4.0), "main": NO_ERRORS}
    clean = simulate_many("deck/paper", range(100), sub=NO_ERRORS, **lively)
    spoilt = simulate_many("deck/paper", range(100), sub=only, **lively)
    error = [r.sub_velocity - c.sub_velocity for r, c in zip(spoilt, clean, strict=True)]
    M = np.array(
        [
            np.linalg.lstsq(c.sub_velocity, e, rcond=None)[0].T
            for c, e in zip(clean, error, strict=True)
        ]
    )
    residual = [e - c.sub_velocity @ m.T for c, e, m in zip(clean, error, M, strict=True)]
    assert np.abs(residual).max() < 1e-12
    diagonal = np.diagonal(M, axis1=1, axis2=2)
    off = M - diagonal[:, None, :] * np.eye(3)
    np.testing.assert_allclose(off, -off.swapaxes(1, 2), atol=1e-9)
    low, high = chi_square_band(300)
    assert low < (diagonal**2).mean() / 5e-6**2 < high
    skew = off[:, [2, 0, 1], [1, 2, 0]]
    assert low < (skew**2).mean() / (5.0 / 3600.0 * np.pi / 180.0) ** 2 < high


def test_the_main_imu_is_ten_times_better_by_default():
    s = DeckScenario("x", "")
    np.testing.assert_allclose(np.array(s.sub.si) / np.array(s.main.si), 10.0)
    assert s.sub.si[0] == pytest.approx(np.radians(0.01) / 3600.0)
    assert s.sub.si[2] == pytest.approx(50e-6 * 9.80665)


# --- disturbances and regimes ---------------------------------------------------------------------


def test_a_tenth_of_each_channel_is_wrong_in_the_glitch_regime():
    recordings = simulate_many("deck/glitch", range(10))
    wrong = np.concatenate([r.disturbance for r in recordings])
    variance = np.concatenate([r.disturbance_variance for r in recordings])
    hit = variance > 0.0
    np.testing.assert_array_equal(wrong != 0.0, hit)
    n = len(hit)
    assert np.abs(hit.mean(axis=0) - 0.1).max() < 4.5 * np.sqrt(0.09 / n)
    assert np.abs(np.corrcoef(hit.T.astype(float)) - np.eye(6)).max() < 4.5 / np.sqrt(n)
    low, high = chi_square_band(hit.sum(axis=0).min())
    for channel, size in enumerate([1.0] * 3 + [2e-3] * 3):
        np.testing.assert_allclose(variance[hit[:, channel], channel], size**2)
        power = (wrong[hit[:, channel], channel] ** 2).mean() / size**2
        assert low < power < high


def test_glitches_of_the_rates_only_leave_the_velocities_right():
    r = navgym.simulate("deck/switch-gyro", 0)
    inside = r.at_steps(r.regime) == 3
    assert inside.any()
    assert not r.disturbance[:, :3].any()
    assert (r.disturbance[inside, 3:] != 0.0).mean() == pytest.approx(0.1, abs=0.02)
    assert not r.disturbance[~inside].any()


def test_outliers_enter_the_sub_gyros_samples():
    regime = DeckRegime(outlier_rate=0.1, outlier_size=0.05)
    base = navgym.simulate("deck/paper", 2, duration=60.0)
    other = navgym.simulate("deck/paper", 2, duration=60.0, regimes=(regime,))
    added = (other.sub_angle - base.sub_angle) / base.interval
    hit = np.abs(added) > 1e-12
    assert hit.mean(axis=0) == pytest.approx([0.1] * 3, abs=4.5 * np.sqrt(0.09 / 6000))
    assert added[hit].std() == pytest.approx(0.05, rel=0.08)
    for name in ("main_angle", "main_velocity", "sub_velocity"):
        np.testing.assert_array_equal(getattr(other, name), getattr(base, name))


def test_regimes_last_their_dwell_and_never_follow_themselves():
    recordings = simulate_many("deck/switch-30", range(20), duration=300.0)
    for r in recordings:
        assert set(np.diff(np.flatnonzero(np.diff(r.regime)))) <= {3000}
        labels = r.regime[::3000]
        assert (np.diff(labels) != 0).all()
        np.testing.assert_array_equal(np.repeat(labels, 3000), r.regime)
    assert len({int(r.regime[0]) for r in recordings}) == 4


def test_dwell_is_drawn_in_whole_filter_steps():
    r = navgym.simulate("deck/switch-60", 1, dwell=(1.0, 2.0), duration=200.0)
    stays = np.diff(np.flatnonzero(np.diff(r.regime)))
    assert (stays % 5 == 0).all()
    assert 100 <= stays.min() < stays.max() <= 200


def test_true_flexure_is_that_of_the_regime_and_theta_grows_with_it():
    recordings = simulate_many("deck/sea-state", range(30))
    for r in recordings[:3]:
        calm = r.at_steps(r.regime) == 0
        for now, regime in ((calm, 0), (~calm, 1)):
            model = DECK_CATALOGUE["sea-state"].regimes[regime].flexure
            wanted = [*model.damping, *model.stiffness, *model.sigma]
            np.testing.assert_array_equal(r.true_flexure[now], np.tile(wanted, (now.sum(), 1)))
    late = [
        np.concatenate(
            [r.theta_rate[(r.regime == g) & (r.time % 150.0 > 60.0)] for r in recordings]
        )
        for g in (0, 1)
    ]
    models = [g.flexure for g in DECK_CATALOGUE["sea-state"].regimes]
    for found, model in zip(late, models, strict=True):
        assert found.std(axis=0) == pytest.approx(model.rate_sigma, rel=0.2)


def test_a_slam_leaves_the_share_of_its_step_that_is_said():
    """θ̇ jumps with the sample after which that share of the step is left."""
    per, found = 5, []
    for r in simulate_many("deck/slam", range(3), duration=60.0):
        struck = (r.impulse_variance > 0.0).any(axis=1)
        assert (r.impulse_left[~struck] == 0.0).all()
        change = np.linalg.norm(np.diff(r.theta_rate, axis=0, prepend=r.theta_rate[:1]), axis=1)
        for k in np.flatnonzero(struck):
            within = change[k * per : (k + 1) * per]
            if within.max() > 5.0 * np.median(change):  # others are too small to be seen
                found.append(1.0 - (within.argmax() + 1) / per - r.impulse_left[k, 0])
    assert len(found) > 15
    assert np.mean(np.abs(found) < 1e-9) > 0.9  # but where two fell into one step
