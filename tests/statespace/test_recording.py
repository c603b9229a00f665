"""Recordings: validated on construction, saved and loaded without loss, refused when damaged."""

import copy
import json
import os
import pickle
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import navgym
from navgym import CoordinatedTurnModel, LinearModel, Recording
from navgym.core.storage import FORMAT

T = np.arange(5.0)
Y = np.zeros((5, 4))
FIELDS = ("time", "measurements", "lost", "truth", "regime", "process_scale", "measurement_scale")
MODEL = ("F", "H", "Q", "R", "x0", "P0", "position", "velocity", "sensors", "axes")


def same(a, b):
    """Assert that two recordings hold the same bits."""
    for field in FIELDS:
        first, second = getattr(a, field), getattr(b, field)
        assert (first is None) == (second is None), field
        if first is not None:
            assert first.dtype == second.dtype
            np.testing.assert_array_equal(first, second)
    for field in MODEL:
        np.testing.assert_array_equal(getattr(a.model, field), getattr(b.model, field))
    assert a.meta == b.meta


# what is kept


def test_nan_counts_as_lost_and_lost_values_become_nan():
    y = Y.copy()
    y[1, 2] = np.nan
    lost = np.zeros((5, 4), dtype=bool)
    lost[3, 0] = True
    recording = Recording(T, y, lost)
    wanted = lost.copy()
    wanted[1, 2] = True
    np.testing.assert_array_equal(recording.lost, wanted)
    np.testing.assert_array_equal(np.isnan(recording.measurements), wanted)
    assert recording.loss_rate == 2 / 20


def test_a_flag_per_sample_loses_all_its_components():
    lost = np.array([0, 1, 0, 0, 1])
    np.testing.assert_array_equal(Recording(T, Y, lost).lost, np.tile(lost[:, None] > 0, 4))


def test_infinite_values_are_allowed_where_lost():
    y = Y.copy()
    y[2] = np.inf
    assert Recording(T, y, np.arange(5) == 2).loss_rate == 0.2


def test_arrays_are_copied_and_read_only():
    y = Y.copy()
    recording = Recording(T, y)
    y[:] = 7.0
    assert (recording.measurements == 0.0).all()
    with pytest.raises(ValueError, match="read-only"):
        recording.measurements[0] = 1.0
    with pytest.raises(AttributeError):
        recording.time = T


def test_the_default_model_has_the_time_step_of_the_recording():
    assert Recording(0.5 * T, Y).model.F[0, 1] == 0.5
    assert Recording([0.0, 0.5], Y[:2]).model.F[0, 1] == 0.5
    assert Recording([7.0], Y[:1]).model.F[0, 1] == 1.0  # no step is known: that of the paper
    uneven = Recording([0.0, 1.0, 3.0], Y[:3]).model.F
    np.testing.assert_array_equal(uneven[:, 0, 1], [1.0, 1.0, 2.0])


# accuracies that come with the samples, and steps


def with_accuracies(unknown, lost=False):
    """Five samples whose R[2, 1, 1] is `unknown`, and of which that component may be lost."""
    R = np.tile(np.diag([1.0, 2.0, 3.0, 4.0]), (5, 1, 1))
    R[:, 0, 1] = R[:, 1, 0] = 0.5
    R[2, 1, 1] = unknown
    y = Y.copy()
    y[2, 1] = np.nan if lost else 0.0
    return Recording(T, y, model=LinearModel(R=R))


@pytest.mark.parametrize("unknown", [np.nan, 0.0])
def test_an_accuracy_may_be_unknown_where_the_measurement_is_lost(unknown, tmp_path):
    recording = with_accuracies(unknown, lost=True)
    wanted = np.zeros((5, 4), bool)
    wanted[2, 1] = True
    np.testing.assert_array_equal(recording.model.deaf, wanted)
    assert np.isnan(recording.model.R[2, [0, 1, 1], [1, 0, 1]]).all()  # its covariances as well
    assert np.isfinite(recording.model.R[2, [0, 2, 3], [0, 2, 3]]).all()
    again = Recording.load(recording.save(tmp_path / "a.npz"))
    same(again, recording)
    assert (again.model.pack() == recording.model.pack()).all()


@pytest.mark.parametrize("unknown", [np.nan, 0.0])
def test_an_accuracy_that_is_unknown_where_something_was_received_is_refused(unknown):
    with pytest.raises(ValueError, match=r"R\[2, 1, 1\] is NaN or 0 and measurements\[2, 1\]") as e:
        with_accuracies(unknown)
    assert "set it, or mark the component as lost" in str(e.value)


@pytest.mark.parametrize("name", ["kf", "vbakf", "qivbf", "imm", "bank", "ekf", "ukf", "cukf"])
def test_the_accuracy_of_a_lost_sample_is_never_used(name):
    """Whatever a receiver says of the accuracy of fixes that it does not have."""
    rng = np.random.default_rng(0)
    y = rng.normal(size=(60, 4)).cumsum(axis=0)
    lost = rng.random(60) < 0.4
    R = rng.uniform(0.5, 2.0, 60)[:, None, None] * np.eye(4)
    runs = []
    for unknown in (1.0, 50.0, np.nan):
        R[lost] = unknown * np.eye(4)
        recording = Recording(np.arange(60.0), y, lost, model=LinearModel(R=R))
        runs.append(navgym.estimate(name, recording))
    for other in runs[1:]:
        for field in ("states", "covariances", "nis"):
            np.testing.assert_allclose(
                getattr(other, field), getattr(runs[0], field), rtol=1e-9, atol=1e-12
            )


@pytest.mark.parametrize("make", [LinearModel, CoordinatedTurnModel])
def test_a_model_on_steps_that_it_was_not_made_for_is_refused(make):
    y = np.ones((5, 4))
    for time in (T / 3, 1.2 * T, [0.0, 1.0, 2.0, 4.0, 5.0], [0.0, 1.0, 1.85, 3.0, 4.0]):
        with pytest.raises(
            ValueError, match=r"the model is made for steps of dt = 1 s, but time\["
        ):
            Recording(time, y, model=make(dt=1.0))
    with pytest.raises(ValueError, match=r"dt = 2 s, but time\[3\] comes 1 s after time\[2\]"):
        Recording(T, y, model=make(dt=[1.0, 1.0, 1.0, 2.0, 1.0]))
    with pytest.raises(ValueError, match=r"LinearModel\(dt=numpy\.diff\(time, prepend=") as caught:
        Recording(T / 3, y, model=make(dt=1.0))
    if make is LinearModel:  # the remedy works
        remedy = re.search(r"LinearModel\(.*?\)\)", str(caught.value))[0]
        names = {"LinearModel": LinearModel, "numpy": np, "time": T / 3}
        model = eval(remedy, names)
        np.testing.assert_allclose(Recording(T / 3, y, model=model).model.dt, 1 / 3)


@pytest.mark.parametrize("make", [LinearModel, CoordinatedTurnModel])
def test_clocks_may_miss_their_steps_by_a_tenth(make):
    time = [0.0, 1.09, 2.0, 3.09, 4.0]
    assert len(Recording(time, np.ones((5, 4)), model=make(dt=1.0))) == 5
    first = np.array([9.0, 1.0, 1.0, 1.0, 1.0])  # of the first step no stamp tells
    assert len(Recording(T, np.ones((5, 4)), model=make(dt=first))) == 5
    assert len(Recording([3.0], np.ones((1, 4)), model=make(dt=0.2))) == 1


def test_a_transition_of_ones_own_is_made_for_any_steps():
    assert len(Recording(T**2, Y, model=LinearModel(F=np.eye(4)))) == 5


def test_length_is_the_number_of_samples():
    assert len(Recording(T, Y)) == 5


# round trip


@given(
    y=hnp.arrays(np.float64, (5, 4), elements=st.floats(allow_infinity=False)),
    lost=hnp.arrays(np.bool_, (5, 4)),
    meta=st.dictionaries(st.text(), st.integers() | st.text() | st.lists(st.booleans())),
)
def test_a_saved_recording_comes_back_bit_for_bit(tmp_path_factory, y, lost, meta):
    model = LinearModel(
        dt=np.array([7.0, 1.0, 0.1, 2.0, 3.0]), R=2.0 * np.eye(4),
        sensors=["gnss", "dvl"] * 2, axes=["x", "x", "y", "y"],
    )  # fmt: skip
    time = np.array([0.0, 1.0, 1.1, 3.1, 6.1]) / 1.03
    recording = Recording(
        time, y, lost, truth=Y + 1 / 3, regime=np.arange(5), model=model, meta=meta,
        process_scale=T + 1, measurement_scale=T + 2,
    )  # fmt: skip
    path = tmp_path_factory.getbasetemp() / "round.npz"
    assert recording.save(path) == path
    same(Recording.load(path), recording)


@pytest.mark.parametrize(
    "name", ["switch-B", "position-only", "component-loss", "coordinated-turn"]
)
def test_simulated_recordings_come_back_and_filter_alike(tmp_path, name):
    recording = navgym.simulate(f"auv/{name}", 3, steps=30)
    again = Recording.load(recording.save(tmp_path / "a.npz"))
    assert type(again.model) is type(recording.model)
    assert again.meta == recording.meta
    a, b = (navgym.estimate("ekf", r).states for r in (recording, again))
    np.testing.assert_array_equal(a, b)


def test_what_is_not_known_stays_unknown(tmp_path):
    again = Recording.load(Recording(T, Y).save(tmp_path / "a.npz"))
    for field in ("truth", "regime", "process_scale", "measurement_scale"):
        assert getattr(again, field) is None


def test_files_hold_no_pickle(tmp_path):
    path = navgym.simulate("auv/switch-D", 0, steps=9).save(tmp_path / "a.npz")
    with np.load(path, allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)
        assert json.loads(str(file["header"]))["navgym"] == FORMAT


def test_recordings_survive_pickling():
    recording = navgym.simulate("auv/switch-D", 0, steps=9)
    same(pickle.loads(pickle.dumps(recording)), recording)


@pytest.mark.parametrize("again", [copy.deepcopy, lambda r: pickle.loads(pickle.dumps(r))])
def test_copies_and_pickles_stay_read_only(again):
    recording = again(navgym.simulate("auv/switch-D", 0, steps=9))
    for field in FIELDS:
        assert not getattr(recording, field).flags.writeable, field
    assert not recording.model.R.flags.writeable


def test_files_have_the_mode_that_the_umask_asks_for(tmp_path):
    before = os.umask(0o027)
    try:
        path = Recording(T, Y).save(tmp_path / "a.npz")
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o640


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"absent does not exist: create it first"):
        Recording(T, Y).save(tmp_path / "absent" / "a.npz")


def test_a_failing_write_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    path = Recording(T, Y).save(tmp_path / "a.npz")
    before = path.read_bytes()

    def fail(file, **arrays):
        file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(OSError, match="disk full"):
        Recording(T, Y + 1).save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_saving_replaces_the_old_file(tmp_path):
    path = Recording(T, Y).save(tmp_path / "a.npz")
    Recording(T, Y + 1).save(path)
    assert Recording.load(path).measurements[0, 0] == 1.0
    assert list(tmp_path.iterdir()) == [path]


# damaged and foreign files


def changed(path, **arrays):
    """Rewrite a saved recording with some arrays replaced, or dropped where None."""
    with np.load(path) as file:
        kept = {name: file[name] for name in file.files}
    kept |= arrays
    np.savez(path, **{name: value for name, value in kept.items() if value is not None})


def header(**content):
    return np.array(json.dumps(content))


DAMAGE = {
    "empty": lambda p: p.write_bytes(b""),
    "text": lambda p: p.write_text("time,px\n0,1\n"),
    "an array": lambda p: np.save(p.open("wb"), Y),
    "cut in half": lambda p: p.write_bytes(p.read_bytes()[: p.stat().st_size // 2]),
    "cut by a byte": lambda p: p.write_bytes(p.read_bytes()[:-1]),
    "foreign npz": lambda p: np.savez(p, a=1),
    "newer": lambda p: changed(p, header=header(navgym=FORMAT + 1, meta={})),
    "strange header": lambda p: changed(p, header=np.array("hello")),
    "header list": lambda p: changed(p, header=np.array("[1]")),
    "header without meta": lambda p: changed(p, header=header(navgym=FORMAT)),
    "no header": lambda p: changed(p, header=None),
    "no time": lambda p: changed(p, time=None),
    "no measurements": lambda p: changed(p, measurements=None),
    "no model": lambda p: changed(p, **{"model.kind": None}),
    "strange model": lambda p: changed(p, **{"model.kind": np.array("cubic")}),
    "strange model field": lambda p: changed(p, **{"model.colour": np.zeros(3)}),
    "wrong shape": lambda p: changed(p, truth=np.zeros((4, 4))),
    "pickle": lambda p: changed(p, extra=np.array([{}], dtype=object)),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_a_damaged_or_foreign_file_is_refused_by_name(tmp_path, what):
    path = Recording(T, Y).save(tmp_path / "broken.npz")
    DAMAGE[what](path)
    with pytest.raises(ValueError, match=r"broken\.npz") as caught:
        Recording.load(path)
    assert re.search("Use|use|save|Save|install", str(caught.value)), "no remedy"


@given(place=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_is_refused_or_harmless(tmp_path_factory, place, bit):
    path = tmp_path_factory.getbasetemp() / "flipped.npz"
    recording = Recording(T, Y + T[:, None], truth=Y, regime=np.arange(5), meta={"where": "sea"})
    recording.save(path)
    content = bytearray(path.read_bytes())
    content[int(place * len(content))] ^= 1 << bit
    path.write_bytes(content)
    try:
        found = Recording.load(path)
    except ValueError:
        return
    same(found, recording)


def test_a_newer_file_says_what_to_do(tmp_path):
    path = Recording(T, Y).save(tmp_path / "a.npz")
    changed(path, header=header(navgym=FORMAT + 1, meta={}))
    with pytest.raises(ValueError, match=rf"format {FORMAT + 1}.*reads {FORMAT}.*install"):
        Recording.load(path)


def test_a_missing_file_is_not_found(tmp_path):
    with pytest.raises(FileNotFoundError, match="absent"):
        Recording.load(tmp_path / "absent.npz")


# bad input

ONES = np.ones((5, 4))
BAD = [
    ({"time": T[:, None]}, "time", "(5, 1)"),
    ({"time": [], "measurements": np.zeros((0, 4))}, "time", "(0,)"),
    ({"time": T[::-1]}, "time", "time[0] = 4.0 is followed by 3.0"),
    ({"time": [0, 1, 1, 2, 3]}, "time", "time[1] = 1.0 is followed by 1.0"),
    ({"time": [0, 1, np.nan, 2, 3]}, "time", "nan at index (2,)"),
    ({"time": [0, 1, 2, 3, np.inf]}, "time", "inf at index (4,)"),
    ({"time": list("abcde")}, "time", "'a'"),
    ({"time": T.astype("M8[s]")}, "time", "np.timedelta64(1, 's')"),
    ({"measurements": Y[:, 0]}, "measurements", "(5,)"),
    ({"measurements": Y[:4]}, "measurements", "(4, 4)"),
    ({"measurements": Y[:, :3]}, "measurements", "3 columns"),
    ({"measurements": ONES * np.inf}, "measurements", "inf at sample 0"),
    ({"measurements": [["a"] * 4] * 5}, "measurements", "'a'"),
    ({"lost": np.zeros((5, 3))}, "lost", "(5, 3)"),
    ({"lost": np.full(5, 0.3)}, "lost", "0.3"),
    ({"lost": ["a"] * 5}, "lost", "'a'"),
    ({"truth": Y[:, :2]}, "truth", "(5, 2)"),
    ({"truth": ONES * np.nan}, "truth", "nan at index (0, 0)"),
    ({"truth": ONES * np.inf}, "truth", "inf at index (0, 0)"),
    ({"regime": [0]}, "regime", "(1,)"),
    ({"regime": [0.5] * 5}, "regime", "0.5"),
    ({"regime": [np.nan] * 5}, "regime", "nan"),
    ({"regime": list("abcde")}, "regime", "'a'"),
    ({"process_scale": np.ones(4)}, "process_scale", "(4,)"),
    ({"process_scale": -np.ones(5)}, "process_scale", "-1.0"),
    ({"measurement_scale": np.zeros(5)}, "measurement_scale", "0.0"),
    ({"measurement_scale": np.full(5, np.nan)}, "measurement_scale", "nan"),
    ({"meta": {"a": np.zeros(3)}}, "meta", "ndarray"),
    ({"meta": 3}, "meta", "int"),
    ({"model": LinearModel(H=np.eye(4)[:2])}, "measurements", "measures 2"),
    ({"model": LinearModel(dt=np.ones(4))}, "model", "4 samples"),
]


@pytest.mark.parametrize(("fields", "field", "value"), BAD)
def test_bad_fields_are_refused_by_name_and_value(fields, field, value):
    with pytest.raises(ValueError, match=field) as caught:
        Recording(**({"time": T, "measurements": Y} | fields))
    assert value in str(caught.value)


def test_something_that_is_no_model_is_refused():
    with pytest.raises(TypeError, match=r"model must be a navgym\.LinearModel.*int"):
        Recording(T, Y, model=3)
