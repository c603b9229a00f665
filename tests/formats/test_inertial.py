"""IMUs of logs: one with aiding sensors, and two on a deck."""

import numpy as np
import pytest

import navgym
from navgym.auv.geodesy import to_plane
from tests.formats import writers
from tests.formats.writers import GRAVITY, Voyage

FAST = Voyage(count=400, step=0.05)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return writers.bag(tmp_path_factory.mktemp("ins") / "bag", FAST, without=("/log/twist",))


def test_a_bag_is_an_inertial_recording_with_its_sensors(bag):
    r = navgym.read("ins_log", bag)
    assert len(r) == FAST.count
    assert np.allclose(r.angle, [0.0, 0.0, 0.02 * 0.05])
    assert np.allclose(r.velocity, np.array([0.1, -0.2, -GRAVITY]) * 0.05)
    assert set(r.aiding) == {"dvl", "fix"}
    dvl, fix = r.aiding["dvl"], r.aiding["fix"]
    assert np.allclose(dvl.values[~dvl.lost], [2.0, 0.0, 0.0])
    assert np.flatnonzero(dvl.lost).tolist() == list(range(4, FAST.count, 5))
    assert np.allclose(fix.time, FAST.seconds)
    truth = to_plane(*FAST.places.T, (*FAST.places[0], 33.0), None)[:, :2]
    assert np.abs(fix.values[~fix.lost][:, :2] - truth[~fix.lost]).max() < 0.02
    assert np.allclose(r.model.sensors["dvl"].noise, 0.01)
    assert np.allclose(r.model.sensors["fix"].noise, [0.4, 0.5, 1.0])
    assert any("/imu left out as heading" in line for line in r.meta["reading"])
    assert any("/odom left out as dvl" in line or "/odom" in line for line in r.meta["reading"])


def test_sensors_of_an_inertial_recording_are_told_as_for_text(bag):
    r = navgym.read(
        "ins_log", bag, topics={"dvl": "/odom", "fix": "none", "heading": "/imu"},
        sensors={"dvl": {"noise": 0.5, "lever_arm": (1.0, 0.0, 0.0)}}, time_offsets={"dvl": 0.2},
    )  # fmt: skip
    assert set(r.aiding) == {"dvl", "heading"}
    assert np.allclose(r.model.sensors["dvl"].noise, 0.5)
    assert np.allclose(r.aiding["dvl"].time, FAST.seconds - 0.2)
    assert np.allclose(r.aiding["heading"].values[:, 0], FAST.heading)


@pytest.mark.parametrize("write", ["ulog", "dataflash", "tlog"])
def test_autopilots_logs_are_inertial_recordings(write, tmp_path):
    r = navgym.read("ins_log", getattr(writers, write)(tmp_path / "x.tlog", FAST))
    assert len(r) == FAST.count
    assert np.allclose(r.velocity[:, 2], -GRAVITY * 0.05, rtol=2e-4)
    assert set(r.aiding) == {"fix"}
    assert np.allclose(r.model.sensors["fix"].noise, [0.8, 0.8, 1.5])
    found = navgym.estimate("ins_kf", r)
    assert np.isfinite(found.states).all()


def test_a_log_without_an_imu_says_what_it_is_for(tmp_path):
    with pytest.raises(ValueError, match=r"x\.nmea holds no IMU: format 'log'"):
        navgym.read("ins_log", writers.nmea(tmp_path / "x.nmea"))


# ---- a deck


def deck(path, shift=0.02, names=("/main/imu", "/sub/imu")):
    """Two IMUs whose rates grow with time, the second's stamps between the first's."""
    store = writers.typestore()
    T, none = store.types, np.zeros(9)
    still = T["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    more = []
    for name, late in zip(names, (0.0, shift), strict=True):
        for k in range(FAST.count):
            t = 0.05 * k + late
            stamp = writers.START + round(t * 1e9)
            imu = T["sensor_msgs/msg/Imu"](
                writers.header(store, stamp, "imu"), still, none,
                writers._vector(store, (1e-3 * t, 0.0, 0.0)), none,
                writers._vector(store, (0.0, 0.1, GRAVITY)), none,
            )  # fmt: skip
            more.append((name, "sensor_msgs/msg/Imu", stamp, imu))
    return writers.bag(path, Voyage(count=0), more=more)


def test_two_imus_of_a_bag_are_brought_to_one_clock(tmp_path):
    r = navgym.read("deck_log", deck(tmp_path / "two"), lever_arm=(10.0, 10.0, 2.0))
    assert np.allclose(r.time, 0.05 * np.arange(1, FAST.count))
    for side in (r.main_angle, r.sub_angle):
        assert np.allclose(side[:, 0], 1e-3 * r.time * 0.05)
    assert np.allclose(r.main_velocity, np.array([0.0, -0.1, -GRAVITY]) * 0.05)
    assert np.allclose(r.model.lever_arm, (10.0, 10.0, 2.0))
    late = navgym.read(
        "deck_log", tmp_path / "two", lever_arm=(1.0, 1.0, 2.0), latency={"sub": 0.02}
    )
    assert np.allclose(late.sub_angle[:, 0] / 0.05, 1e-3 * (late.time + 0.02))


def test_which_imu_is_which_is_never_guessed(tmp_path):
    path = deck(tmp_path / "two", names=("/a", "/b"))
    with pytest.raises(ValueError, match=r"which IMU is the main one.*holds /a, /b"):
        navgym.read("deck_log", path, lever_arm=(1.0, 1.0, 2.0))
    r = navgym.read("deck_log", path, lever_arm=(1.0, 1.0, 2.0), topics={"main": "/b", "sub": "/a"})
    assert "/b is main" in " ".join(r.meta["reading"])
    with pytest.raises(ValueError, match="lever_arm"):
        navgym.read("deck_log", path, topics={"main": "/b", "sub": "/a"})


def test_imus_without_a_common_time_are_refused(tmp_path):
    path = deck(tmp_path / "ship", shift=100.0)
    with pytest.raises(ValueError, match=r"ship: the two IMUs have no time in common"):
        navgym.read("deck_log", path, lever_arm=(1.0, 1.0, 2.0))
