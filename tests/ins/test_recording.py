"""Inertial recordings and models: what is refused, and what survives a file."""

import dataclasses
import pickle

import numpy as np
import pytest

from navgym.inertial.earth import GRAVITY
from navgym.ins.imu_grades import GRADES, ImuGrade
from navgym.ins.model import AidingModel, InsModel
from navgym.ins.recording import Aiding, InertialRecording
from navgym.ins.tape import events_of
from tests.ins.lanes import made

DVL = {"dvl": AidingModel("dvl", 0.01)}


def still(count=100, aiding=None, model=None, **changes):
    """A vehicle at rest."""
    force = np.tile([0.0, 0.0, -GRAVITY], (count, 1))
    given = {
        "time": np.arange(count) / 100.0,
        "rate": np.zeros((count, 3)),
        "force": force,
    } | changes
    return InertialRecording.from_rates(
        given["time"], given["rate"], given["force"], aiding=aiding or {}, model=model or InsModel(sensors=DVL)
    )  # fmt: skip


def same(one, other):
    """Whether two dataclasses hold the same, arrays and all."""
    for f in dataclasses.fields(one):
        a, b = getattr(one, f.name), getattr(other, f.name)
        if f.name == "check_units":
            continue
        if isinstance(a, dict):
            assert list(a) == list(b)
            for name, each in a.items():
                if dataclasses.is_dataclass(each):
                    same(each, b[name])
                else:
                    np.testing.assert_array_equal(each, b[name])
        elif dataclasses.is_dataclass(a):
            same(a, b)
        else:
            np.testing.assert_array_equal(a, b)


def test_a_recording_survives_a_file_and_a_pickle(tmp_path):
    recording = made(duration=4.0)
    same(InertialRecording.load(recording.save(tmp_path / "r.npz")), recording)
    copied = pickle.loads(pickle.dumps(recording))
    same(copied, recording)
    assert not copied.angle.flags.writeable
    assert not copied.aiding["dvl"].values.flags.writeable


def test_a_file_that_lacks_something_is_refused(tmp_path):
    path = made(duration=4.0).save(tmp_path / "r.npz")
    with np.load(path) as file:
        arrays = dict(file)
    for name in ("angle", "model.latitude", "aiding.dvl.values"):
        np.savez(path, **{k: v for k, v in arrays.items() if k != name})
        with pytest.raises(ValueError, match="damaged"):
            InertialRecording.load(path)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"force": np.tile([0.0, 0.0, GRAVITY], (100, 1))}, "turn the axes"),
        ({"force": np.tile([0.0, 0.0, -1.0], (100, 1))}, "check the units"),
        ({"rate": np.full((100, 3), 57.0)}, "degrees"),
        ({"rate": np.full((100, 3), np.inf)}, "mark it as NaN"),
        ({"rate": np.full((100, 3), np.nan)}, "no whole sample"),
        ({"rate": np.zeros((99, 3))}, "must have shape"),
        ({"time": np.zeros(100)}, "increase strictly"),
        ({"time": np.r_[np.arange(99) / 100.0, 2.0]}, "even steps"),
        ({"time": np.arange(10) / 100.0, "rate": np.zeros((10, 3)), "force": np.ones((10, 3))}, "filter step needs 20"),
    ],
)  # fmt: skip
def test_what_no_imu_measures_is_refused_with_a_remedy(changes, told):
    with pytest.raises(ValueError, match=told):
        still(**changes)


@pytest.mark.parametrize(
    ("sensor", "told"),
    [
        (lambda: {"sonar": Aiding([0.1], [[0.0] * 3])}, "which the model does not know"),
        (lambda: {"dvl": Aiding([0.1], [0.0])}, "3 numbers per measurement"),
        (lambda: {"dvl": Aiding([0.1, 0.1], np.zeros((2, 3)))}, "increase strictly"),
        (lambda: {"dvl": Aiding([0.1], np.zeros((2, 3)))}, "a row for each"),
        (lambda: {"dvl": Aiding([0.1], [[np.inf, 0.0, 0.0]])}, "mark it as NaN"),
        (lambda: {"dvl": Aiding([0.1], np.zeros((1, 3)), lost=[1])}, "booleans"),
    ],
)
def test_what_no_sensor_measures_is_refused_with_a_remedy(sensor, told):
    with pytest.raises(ValueError, match=told):
        still(aiding=sensor())


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("latitude", 32.8), ("velocity", (1.0, 2.0)), ("samples_per_step", 0), ("imu", "best"),
        ("tilt_deviation", -1.0), ("height", np.nan), ("current_time", 0.0),
    ],
)  # fmt: skip
def test_a_model_names_the_field_that_is_wrong(field, value):
    with pytest.raises(ValueError, match="grade of IMU" if field == "imu" else field):
        InsModel(**{field: value})


def test_sensors_of_a_model_are_checked():
    with pytest.raises(ValueError, match="Did you mean 'depth'"):
        AidingModel("dept", 0.1)
    with pytest.raises(ValueError, match="positive"):
        AidingModel("depth", 0.0)
    with pytest.raises(ValueError, match="no vehicle is that long"):
        AidingModel("depth", 0.1, (0.0, 0.0, 1000.0))
    with pytest.raises(ValueError, match="at most 8"):
        InsModel(sensors={str(i): AidingModel("depth", 0.1) for i in range(9)})


def test_lost_and_missing_measurements_are_one():
    sensor = Aiding([1.0, 2.0, 3.0], [[1.0, 0.0, 0.0], [np.nan, 0.0, 0.0], [3.0, 0.0, 0.0]], [True, False, False])  # fmt: skip
    assert sensor.lost.tolist() == [True, True, False]
    assert np.isnan(sensor.values[:2]).all()


def test_events_are_in_the_order_of_their_moments_and_within_the_recording():
    recording = made(duration=4.0, water_period=0.7)
    events, sample = events_of(recording)
    assert (np.diff(sample) >= 0).all()
    begin = recording.time[0] - recording.interval
    np.testing.assert_allclose(begin + sample * recording.interval, events["time"], atol=0.006)
    inside = sum(
        (a.time <= recording.step_time[-1] + 1e-9).sum() for a in recording.aiding.values()
    )
    assert len(events) == inside


class TestGrades:
    def test_an_allan_plot_is_a_grade(self):
        grade = ImuGrade.from_allan(0.1, 1.0, 50.0, 30.0)
        assert grade.gyro_bias == 10.0
        assert grade.gyro_drift == pytest.approx(1.506, abs=1e-3)
        assert grade.si[1] == pytest.approx(2.909e-5, rel=1e-3)

    def test_grades_are_those_of_the_literature(self):
        found = {name: (g.gyro_bias, g.accelerometer_bias) for name, g in GRADES.items()}
        assert found == {
            "navigation": (0.01, 50.0),
            "tactical": (1.0, 500.0),
            "mems": (50.0, 3000.0),
        }

    def test_white_noise_must_be_there(self):
        with pytest.raises(ValueError, match="gyro_noise"):
            ImuGrade(1.0, 0.0, 1.0, 1.0)
