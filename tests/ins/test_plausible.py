"""What sensors say of each other: axes turned over, clocks apart, nothing to see, and a sensor at its stop."""

import dataclasses
import os
import warnings
from pathlib import Path

import numpy as np
import pytest

import navgym
from navgym.core.stops import saturated
from navgym.inertial.earth import EARTH_RATE, GRAVITY
from navgym.ins.csv_set import read_ins_csv, write_ins_csv
from navgym.ins.model import AidingModel, InsModel
from navgym.ins.plausible import TURNS, axes, clocks, concerns
from navgym.ins.recording import Aiding, InertialRecording
from navgym.ins.scenarios import FISH
from tests.ins.lanes import made

AKIT = Path(os.environ.get("NAVGYM_DATA", "nowhere")) / "akit"
USUAL = {"water_period": 0.0, "dvl_lever": (0.0, 0.0, 0.0), "legs": (60.0, 90.0), "fix_period": 5.0}


def mission(seed=0, **overrides):
    """Five minutes with turns."""
    return made(seed=seed, **({"duration": 300.0} | USUAL | overrides))


def rebuilt(recording, **changes):
    return dataclasses.replace(recording, **({"check_units": False} | changes))


class TestAxes:
    @pytest.mark.parametrize("number", range(len(TURNS)))
    @pytest.mark.parametrize("grade", ["mems", "tactical"])
    def test_each_way_to_mount_an_imu_wrongly_is_named(self, number, grade):
        names, gyros, forces = TURNS[number]
        good = mission(seed=number, grade=grade)
        wrong = rebuilt(good, angle=good.angle @ gyros, velocity=good.velocity @ forces)
        (said,) = axes(wrong)
        assert all(name in said for name in names)
        assert "turn" in said

    @pytest.mark.parametrize("grade", ["mems", "tactical", "navigation"])
    def test_of_right_axes_nothing_is_said(self, grade):
        for seed in range(3):
            assert axes(mission(seed=seed, grade=grade)) == []

    def test_noise_that_is_worse_than_believed_is_no_wrong_axis(self):
        assert axes(mission(regimes=(FISH,))) == []

    def test_a_reader_warns_and_keeps_the_sentence(self, tmp_path):
        good = mission(seed=1)
        folder = write_ins_csv(rebuilt(good, angle=good.angle * [1.0, 1.0, -1.0]), tmp_path / "log")
        with pytest.warns(UserWarning, match='turn={"gyro_z": "-gyro_z"}'):
            found = read_ins_csv(folder)
        assert any("gyro_z points the other way" in s for s in found.meta["reading"])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            right = read_ins_csv(folder, turn={"gyro_z": "-gyro_z"})
        np.testing.assert_allclose(right.angle, good.angle, atol=1e-12)

    def test_too_little_to_tell_is_nothing_to_say(self):
        assert axes(made(duration=20.0)) == []
        r = mission()
        assert axes(rebuilt(r, aiding={})) == []


@pytest.mark.skipif(not AKIT.is_dir(), reason="NAVGYM_DATA does not name A-KIT's data")
class TestRealTracks:
    def test_the_axes_that_are_turned_over_on_real_tracks_are_named(self):
        r = navgym.read("akit_ins", AKIT, track=3, position_noise=1.0)
        assert not r.gaps.any()
        assert axes(r) == clocks(r) == concerns(r) == []
        y = np.array([1.0, -1.0, 1.0])
        (said,) = axes(rebuilt(r, angle=r.angle * y, velocity=r.velocity * y))
        assert "gyro_y and acc_y point the other way" in said

    def test_clocks_as_published_are_told_apart(self):
        r = navgym.read("akit_ins", AKIT, track=3, position_noise=1.0, align_clocks=False)
        assert [s.split(":")[0] for s in clocks(r)] == ["dvl"]


class TestClocks:
    @pytest.mark.parametrize(("name", "late"), [("dvl", 0.5), ("dvl", -0.5), ("magnetometer", 0.5), ("fix", 1.0)])  # fmt: skip
    def test_a_sensor_that_is_stamped_late_is_told_and_not_moved(self, name, late):
        good = mission(seed=2, grade="tactical", fix_noise=(0.2, 0.2, 0.2))
        sensor = good.aiding[name]
        moved = Aiding(sensor.time + late, np.array(sensor.values), np.array(sensor.lost))
        wrong = rebuilt(good, aiding=dict(good.aiding) | {name: moved}, noise_scales=None)
        said = [s for s in clocks(wrong) if s.startswith(name)]
        assert len(said) == 1
        assert ("earlier" if late > 0 else "later") in said[0]
        assert f"about {abs(late):g} s" in said[0]
        np.testing.assert_array_equal(wrong.aiding[name].time, moved.time)

    def test_of_one_clock_nothing_is_said(self):
        for grade in ("mems", "tactical"):
            assert clocks(mission(seed=3, grade=grade)) == []


class TestConcerns:
    def test_what_the_imu_does_not_cover_is_told_and_changes_nothing(self):
        r = mission(duration=60.0)
        early = Aiding(np.r_[-3.0, -2.0, -1.0, r.aiding["dvl"].time], np.vstack([np.full((3, 3), 9.0), r.aiding["dvl"].values]))  # fmt: skip
        more = rebuilt(r, aiding=dict(r.aiding) | {"dvl": early}, noise_scales=None)
        (said,) = concerns(more)
        assert said.startswith("dvl: 3 of")
        assert "before the IMU's first sample" in said
        one, other = (navgym.estimate("ins_kf", x) for x in (r, more))
        np.testing.assert_array_equal(one.states, other.states)

    def test_a_heading_that_nothing_shows_is_said(self):
        r = mission(
            duration=60.0,
            fix_period=0.0,
            magnetometer_period=0.0,
            heading_deviation=8.0,
            velocity_deviation=1.0,
        )
        assert any("heading" in s for s in concerns(r))
        with pytest.warns(UserWarning, match="heading is known to"):
            found = navgym.estimate("ins_kf", r)
        assert "heading unknown" in found.health
        assert "heading" not in navgym.estimate("ins_kf", mission(duration=60.0)).health

    def test_a_vehicle_that_stands_still_is_said_and_stays_where_it_is(self):
        found, r = still()
        assert any("stands still" in s for s in concerns(r))
        assert np.abs(found.states[:, :2]).max() < 0.3
        assert np.isfinite(found.covariances).all()
        # nothing but the Earth's turning shows the heading, as far as the gyro's bias lets it
        compass = EARTH_RATE * np.cos(r.model.latitude) / r.model.grade.si[0]
        assert 0.98 * (0.05**-2 + compass**2) ** -0.5 < found.deviations[-1, 8] <= 0.05


def still(seed=0, seconds=120):
    """A vehicle at rest with noise, and its estimate."""
    rng, count = np.random.default_rng(seed), 100 * seconds
    rate = 1e-3 * rng.standard_normal((count, 3))
    force = [0.0, 0.0, -GRAVITY] + 2e-2 * rng.standard_normal((count, 3))
    time = np.arange(1, seconds + 1.0)
    model = InsModel(
        sensors={"dvl": AidingModel("dvl", 0.01)}, imu="tactical", position_deviation=0.1
    )
    dvl = Aiding(time, 0.01 * rng.standard_normal((seconds, 3)))
    r = InertialRecording.from_rates(np.arange(1, count + 1) / 100.0, rate, force, aiding={"dvl": dvl}, model=model)  # fmt: skip
    return navgym.estimate("ins_kf", r), r


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", ["ins_kf", "ins_student", "ins_vb", "ins_bank"])
def test_bursts_of_missing_imu_samples_lose_no_filter(name, seed):
    r = mission(seed=seed, duration=120.0)
    rng = np.random.default_rng(seed)
    angle, velocity = np.array(r.angle), np.array(r.velocity)
    for begin in rng.integers(0, len(r) - 60, 8):
        length = int(rng.integers(1, 60))
        (angle if rng.random() < 0.5 else velocity)[begin : begin + length] = np.nan
    with pytest.warns(UserWarning, match="IMU samples are missing"):
        found = navgym.estimate(name, rebuilt(r, angle=angle, velocity=velocity))
    assert not found.diverged
    e = found.states[300:, :2] - r.truth[300:, :2]
    assert np.sqrt((e**2).sum(axis=1).mean()) < 5.0


class TestStops:
    def values(self, seed=0, count=6000):
        rng = np.random.default_rng(seed)
        t = np.arange(count)[:, None] / 100.0
        return 0.5 * np.sin(t * [1.0, 1.3, 1.7]) + 0.02 * rng.standard_normal((count, 3))

    @pytest.mark.parametrize("resolution", [0.0, 1e-4, 1e-3])
    def test_a_clipped_channel_is_found_and_only_that(self, resolution):
        x = self.values()
        x[:, 1] = np.clip(x[:, 1], -0.4, 0.45)
        x = np.round(x / resolution) * resolution if resolution else x
        at_stop, found = saturated(x, ("a", "b", "c"))
        assert [(n, round(s, 6)) for n, s, _ in found] == [("b", 0.45), ("b", -0.4)]
        np.testing.assert_array_equal(at_stop, (x[:, 1] >= 0.45 - 1e-9) | (x[:, 1] <= -0.4 + 1e-9))

    @pytest.mark.parametrize("seed", range(5))
    def test_noise_a_clean_sine_and_a_constant_stand_at_no_stop(self, seed):
        t = np.arange(6000) / 100.0
        noisy = np.round(self.values(seed), 4)
        clean = np.round(np.stack([np.sin(t), np.zeros(6000), np.repeat(np.arange(60.0), 100)], 1), 4)  # fmt: skip
        for x in (noisy, clean):
            assert saturated(x, ("a", "b", "c"))[1] == []

    def test_saturated_samples_count_as_missing_with_a_warning(self):
        r = mission(duration=60.0)
        stop = 0.6 * np.abs(r.angle[:, 0]).max()
        angle = np.clip(r.angle, -stop, stop)
        with pytest.warns(UserWarning, match="gyro_x says exactly"):
            found = rebuilt(r, angle=angle, check_units=True)
        assert (found.gaps == (np.abs(angle) >= stop).any(axis=1)).all()
        assert not rebuilt(r, angle=angle).gaps.any()
