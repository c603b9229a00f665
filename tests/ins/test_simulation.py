"""Simulated missions: what sensors make of the truth, and what seeds and scenarios promise."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from navgym.inertial.earth import GRAVITY
from navgym.ins.scenarios import CATALOGUE, InsRegime, InsScenario
from navgym.ins.simulation import simulate
from navgym.ins.speed import FITTED, LAGS, STEADY, SpeedProcess, fit, structure
from navgym.ins.tape import write_tape
from tests.ins.lanes import InsBatch, made

STRAIGHT = {"legs": (5000.0, 5000.0), "waves": 0.0}


def body_velocity(recording):
    """(K, 3) true velocity in body axes, from the truth."""
    C = Rotation.from_euler("ZYX", recording.truth[:, 8:5:-1])
    return C.inv().apply(np.array(recording.truth[:, 3:6]))


def residual(recording, name, exact):
    """What is left of a sensor's values where it was heard, and the scales of its variance there."""
    sensor = recording.aiding[name]
    k = np.round(sensor.time / recording.step).astype(int) - 1
    good = ~sensor.lost & np.isclose((k + 1) * recording.step, sensor.time)
    return sensor.values[good] - exact[k[good]], recording.noise_scales[name][good]


def test_sensors_measure_the_truth_with_the_noise_that_is_told():
    r = made(seed=7, duration=1500.0, dvl_lever=(0.0, 0.0, 0.0), water_period=0.0, grade="navigation",
             regimes=CATALOGUE["survey"].regimes, fix_period=2.0)  # fmt: skip
    s, alpha = r.truth[0, 18:20]
    body = body_velocity(r)
    seen = (1.0 + s) * np.stack([body[:, 0] + alpha * body[:, 1], body[:, 1] - alpha * body[:, 0], body[:, 2]], 1)  # fmt: skip
    for name, exact, noise in (("dvl", seen, (0.01, 0.01, 0.007)), ("fix", r.truth[:, :3], (2.0,) * 3), ("depth", r.truth[:, 2:3], (0.05,))):  # fmt: skip
        left, scale = residual(r, name, exact)
        unit = left / np.array(noise) / np.sqrt(scale)[:, None]
        assert np.abs(unit.mean(axis=0)).max() < 5.0 / np.sqrt(len(unit))
        assert np.abs(unit.std(axis=0) - 1.0).max() < 5.0 / np.sqrt(2.0 * len(unit))


def test_the_imu_has_the_biases_and_the_noise_of_its_grade():
    quiet, loud = (made(seed=3, duration=60.0, grade=g) for g in ("navigation", "mems"))
    difference = (loud.angle - quiet.angle) / loud.interval
    np.testing.assert_allclose(difference.mean(axis=0), loud.truth[-1, 9:12], atol=1.2e-4)
    # both draw the same numbers, each times its own deviation
    white = np.subtract(loud.model.imu.si, quiet.model.imu.si) * np.sqrt(2.0 * loud.interval)
    for name, column in (("angle", 1), ("velocity", 3)):
        spread = np.diff(getattr(loud, name) - getattr(quiet, name), axis=0).std()
        assert spread == pytest.approx(white[column], rel=0.05)


def test_a_level_vehicle_feels_gravity():
    r = made(seed=3, duration=30.0, grade="navigation", **STRAIGHT)
    assert r.velocity.mean(axis=0)[2] / r.interval == pytest.approx(-GRAVITY, abs=0.2)


def test_the_vibration_meter_sees_the_noise_of_the_accelerometers():
    # of MEMS accelerometers: those of navigation grade are quieter than waves at 100 Hz
    r = made(seed=3, duration=120.0, regimes=CATALOGUE["vibration"].regimes, dwell=(20.0, 30.0))
    batch = InsBatch.of([r])
    ratio = batch.tapes["shake"][0] / r.model.imu.si[3] ** 2 / r.imu_scale
    assert ratio.mean() == pytest.approx(1.0, abs=0.05)
    assert len(np.unique(r.imu_scale)) == 2


def test_a_change_of_one_sensor_leaves_the_others_numbers():
    one, other = (
        made(seed=1, duration=20.0),
        made(seed=1, duration=20.0, dvl_period=0.5, hard_iron=0.0),
    )
    np.testing.assert_array_equal(one.angle, other.angle)
    np.testing.assert_array_equal(one.aiding["fix"].values, other.aiding["fix"].values)
    np.testing.assert_array_equal(one.aiding["depth"].values, other.aiding["depth"].values)


def test_outages_are_silent_and_nothing_else_is():
    r = simulate(CATALOGUE["outage"].override(outages=((5.0, 10.0),), duration=30.0), [0])[0]
    dvl = r.aiding["dvl"]
    assert (dvl.lost == ((dvl.time >= 5.0) & (dvl.time < 15.0))).all()
    assert "fix" not in r.aiding


def test_starts_err_as_the_model_says():
    errors = []
    for r in simulate(CATALOGUE["nominal"].override(duration=4.0), range(60)):
        batch = InsBatch.of([r])
        start = batch.models[0]["start"]
        north, east = (start[:2] - r.model.origin[:2]) * batch.models[0]["metres"]
        errors.append([north, east, -(start[2] - r.model.origin[2])])
    assert np.std(errors) == pytest.approx(1.0, abs=0.2)


def test_scenarios_refuse_what_cannot_be():
    for field, value in (("duration", 0.1), ("grade", "best"), ("speed_process", "slow"), ("speeds", ()),
                         ("dvl_period", 0.0), ("legs", (3.0, 1.0)), ("waves", -1.0), ("latitude", 89.0),
                         ("dvl_noise", (1.0,)), ("regimes", ())):  # fmt: skip
        with pytest.raises(ValueError):
            CATALOGUE["nominal"].override(**{field: value})
    with pytest.raises(ValueError, match="dvl_loss of regime 'odd'"):
        InsRegime("odd", dvl_loss=2.0)


def test_a_tape_does_not_depend_on_what_a_model_believes_of_sensors():
    r = made(duration=4.0)
    batch = InsBatch.of([r])
    again = batch.tapes.copy()
    write_tape(r, again[0])
    np.testing.assert_array_equal(again["dv"], batch.tapes["dv"])


class TestSpeed:
    def test_a_process_is_found_again_in_what_it_makes(self):
        logs = []
        for r in simulate(InsScenario("x", "x", duration=1200.0, grade="navigation", waves=0.0, speeds=(1.7,)), range(6)):  # fmt: skip
            second = slice(4, None, 5)
            rate = np.diff(np.unwrap(r.truth[:, 8]), prepend=r.truth[0, 8]) / r.step
            logs.append((body_velocity(r)[second], rate[second]))
        found = fit(logs)
        assert found.side_slip == pytest.approx(FITTED.side_slip, rel=0.3)
        assert found.surge_deviation == pytest.approx(FITTED.surge_deviation, rel=0.4)
        # turns of 6°/s lose less than the wander that hides them; of real tracks those of 15°/s tell
        assert found.turn_loss == pytest.approx(FITTED.turn_loss, rel=0.8)

    def test_a_random_walk_has_a_structure_that_grows_with_the_lag(self):
        walk = np.cumsum(np.random.default_rng(0).standard_normal(100_000))
        assert structure([walk]) == pytest.approx(np.array(LAGS, float), rel=0.2)

    def test_the_steady_vehicle_keeps_its_speed_and_the_fitted_one_does_not(self):
        changes = {}
        for name in ("steady", "fitted"):
            rs = simulate(CATALOGUE["nominal"].override(duration=300.0, speed_process=name, speeds=(1.5,)), range(4))  # fmt: skip
            v = [body_velocity(r)[4::5, 0] for r in rs]
            changes[name] = np.sqrt(structure(v, (60,)))[0]
        assert changes["fitted"] > 3.0 * changes["steady"]

    def test_deviations_must_be_numbers(self):
        with pytest.raises(ValueError, match="surge_time"):
            SpeedProcess(0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0)
        assert STEADY.turn_loss == 0.0
