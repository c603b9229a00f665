"""A user's own log: what is read is what was written, and every fault is named."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import navgym
from navgym.auv.csv_log import write_csv

LOG = """time,px,vx,py,vy
0,1,2,3,4
1,3.1,,5,nan
2,5,2,,4
"""


@pytest.fixture
def log(tmp_path):
    """Writes a text as a log and returns its path."""

    def write(text, encoding="utf-8"):
        path = tmp_path / "log.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
        return path

    return write


def read(path, **options):
    return navgym.read("csv", path, **options)


def test_empty_and_nan_cells_are_lost(log):
    recording = read(log(LOG))
    assert recording.lost.tolist() == [
        [False] * 4,
        [False, True, False, True],
        [False, False, True, False],
    ]
    assert recording.measurements[0].tolist() == [1, 2, 3, 4]
    assert recording.truth is None


def test_lost_columns_mark_samples_and_components(log):
    path = log("time,px,py,lost,lost_py\n0,1,2,0,0\n1,1,2,1,0\n2,1,2,false,TRUE\n")
    assert read(path).lost.tolist() == [[False, False], [True, True], [False, True]]


def test_columns_may_come_in_any_order_and_under_other_names(log):
    path = log('"t (ms)";depth;East;North\n0;9;1;2\n500;9;3;4\n')
    names = {"time": "t (ms)", "px": "North", "py": "East"}
    recording = read(path, columns=names, delimiter=";", time_scale=1e-3, extra="ignore")
    assert recording.time.tolist() == [0.0, 0.5]
    assert recording.measurements.tolist() == [[2, 1], [4, 3]]


def test_a_chosen_column_goes_before_one_that_bears_the_name(log):
    path = log("time,t,px\nmonday,0,1\ntuesday,1,2\n")
    assert read(path, columns={"time": "t"}).time.tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("names", "rows"), [("px,py", [0, 2]), ("vx,vy", [1, 3]), ("vy,px", [0, 3]), ("py", [2])]
)
def test_any_subset_of_the_states_may_be_measured(log, names, rows):
    recording = read(log(f"time,{names}\n0{',1' * len(rows)}\n"))
    in_state_order = sorted(rows)
    assert np.array_equal(recording.model.H, np.eye(4)[in_state_order])


def test_uneven_times_give_a_step_per_sample(log):
    recording = read(log("time,px\n10,1\n12,2\n12.5,3\n"))
    assert recording.model.F[:, 0, 1].tolist() == [2.0, 2.0, 0.5]
    even = read(log("time,px\n10,1\n12,2\n14,3\n"))
    assert even.model.F.shape == (4, 4)
    assert even.model.F[0, 1] == 2.0


def test_the_noise_of_the_default_model_is_what_is_asked_for(log):
    recording = read(log(LOG), position_noise=3, velocity_noise=0.5, acceleration=0.2)
    assert np.diag(recording.model.R).tolist() == [9, 0.25, 9, 0.25]
    assert recording.model.Q[1, 1] == pytest.approx(0.2**2)


def test_default_start_is_the_first_fix_taken_one_step_back(log):
    model = read(log(LOG)).model
    assert model.x0.tolist() == [-1.0, 2.0, -1.0, 4.0]
    late = read(log("time,px,py\n0,,\n2,5,1\n4,9,1\n")).model  # first received at 2 s, at 2 m/s
    assert late.x0.tolist() == [-3.0, 2.0, 1.0, 0.0]


def test_default_start_weighs_a_hundredth_of_a_fix(log):
    """After the first sample the filter's variance is R / (1 + 1/100) or larger, and at most R."""
    recording = read(log("time,px,vx,py,vy\n0,100,2,-50,1\n1,102,2,-49,1\n"))
    estimate = navgym.estimate("kf", recording)
    assert np.allclose(estimate.states[0], [100, 2, -50, 1])
    variance = np.diag(estimate.covariances[0]) / np.diag(recording.model.R)
    assert (variance > 0.98).all()
    assert (variance < 1.0).all()


@pytest.mark.parametrize("rows", [1, 2, 50])
@pytest.mark.parametrize("names", ["px,vx,py,vy", "px,py", "vx,vy", "px"])
def test_filters_run_on_logs_of_any_length_and_content(log, names, rows):
    cells = ["1.5" if name.startswith("p") else "0" for name in names.split(",")]  # it lies still
    text = "\n".join(["time," + names, *(",".join([str(k), *cells]) for k in range(rows))])
    estimate = navgym.estimate("kf", read(log(text)))
    assert np.isfinite(estimate.states).all()
    assert not estimate.diverged


def test_missing_true_velocities_are_differences_of_true_positions(log):
    path = log("time,px,truth_px,truth_py\n0,1,0,5\n1,1,2,5\n3,1,6,5\n")
    assert np.allclose(read(path).truth, [[0, 2, 5, 0], [2, 2, 5, 0], [6, 2, 5, 0]])


def test_byte_order_mark_windows_lines_spaces_and_blank_lines_are_harmless(log):
    path = log("\ufefftime , px\r\n\r\n0, 1\r\n1 ,\r\n\r\n")
    assert read(path).measurements[0].tolist() == [1.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "log.csv is empty"),
        ("\n\n", "log.csv is empty"),
        ("time,px\n", "a header line but no rows"),
        ("0,1\n1,2\n", "first line must name the columns"),
        ("time,px,px\n0,1,1\n", "several columns called 'px'"),
        ("monday,px\n0,1\n", "Say which it is with columns={'time'"),
        ("px\n0\n", "Say which it is with columns={'time'"),
        ("time,tide\n0,1\n", "no measurement column"),
        ("time,lat\n0,1\n", "lat stands without its other half"),
        ("time,px,truth_pz\n0,1,1\n", "'truth_pz'. Did you mean 'truth_p"),
        ("time,px,lost_pxx\n0,1,1\n", "'lost_pxx'. Did you mean 'lost_px'.*extra='ignore'"),
        ("time,px\n0,1\n1,abc\n", "log.csv, line 3, column 'px': must be a finite number.*'abc'"),
        ("time,px\n0,1\n\n1,1_0\n", "log.csv, line 4, column 'px'.*'1_0'"),
        ("time,px\n0,1\n,2\n", "line 3, column 'time'.*''"),
        ("time,px\n0,1\n1,1,1\n", "line 3: 3 cells, but the header names 2"),
        ("time,px\n0,\n1,nan\n", "every measurement is lost"),
        ("time,px,lost\n0,1,1\n", "every measurement is lost"),
        ("time,px,lost\n0,1,2\n", "line 2, column 'lost': must be 0, 1, true or false, got '2'"),
        ("time,px,truth_px,truth_py\n0,1,1,1\n1,1,,1\n", "line 3, column 'truth_px'.*every row"),
        ("time,px,truth_px,truth_py\n0,1,1,inf\n1,1,1,1\n", "line 2, column 'truth_py'"),
        ("time,px,truth_px\n0,1,1\n1,1,1\n", "truth_px but not truth_vx, truth_py, truth_vy"),
        ('time,px\n0,"1\n', "line 2"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "is a binary file"),
        (b"PK\x03\x04\x00\x00\x00", "is a binary file"),
    ],
)
def test_faults_are_named(log, text, message):
    with pytest.raises(ValueError, match=message):
        read(log(text))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"columns": {"pz": "px"}}, "unknown name in columns: 'pz'. Did you mean 'p"),
        ({"columns": {"px": "p_x"}}, "'p_x'. Did you mean 'px'"),
        ({"delimiter": ", "}, "delimiter must be one character"),
        ({"time_scale": 0.0}, "time_scale must be a finite number above 0"),
        ({"position_noise": -1.0}, "position_noise must be a finite number above 0"),
        ({"velocity_noise": math.nan}, "velocity_noise must be a finite number above 0"),
        ({"position_noise": "1"}, "position_noise must be a finite number above 0, got '1'"),
        ({"columns": ["px"]}, r"columns must be a dict .* got \['px'\]"),
        ({"model": "x"}, r"model must be a navgym\.LinearModel .* got 'x'"),
        ({"acceleration": 0.0}, "acceleration must be a finite number above 0"),
        ({"extra": "drop"}, "unknown extra 'drop'"),
        ({"held": "no"}, "unknown held 'no'"),
        ({"decimal": "x"}, "decimal must be '.' or ','"),
        ({"encoding": "klingon"}, "encoding 'klingon' is unknown"),
        ({"units": {"px": "furlong"}}, "taken for px: unit 'furlong' is not one of length"),
        ({"units": {"pz": "m"}}, "unknown name in units: 'pz'"),
        ({"missing": "-9999"}, "missing must be a list"),
        ({"latency": {"velocity": "1"}}, "latency of velocity must be a finite number"),
        ({"latency": {"z": 1.0}}, "unknown name in latency: 'z'"),
        ({"origin": (1.0,)}, "origin must be latitude and longitude"),
        ({"origin": (91.0, 0.0)}, "origin latitude must be a number in -90..90, got 91.0"),
        ({"lever_arm": (1.0, 0.0)}, "lever_arm= needs the heading"),
        ({"lever_arm": 1.0}, "lever_arm must be forward, right"),
        ({"accuracy_floor": -1.0}, "accuracy_floor must be a finite number of at least 0"),
        ({"largest": 10}, "more than 10 bytes"),
        ({"header": 1}, "unknown option of format 'csv': 'header'"),
        ({"model": navgym.LinearModel(F=np.eye(2))}, "'z1'"),
    ],
)
def test_bad_options_are_named(log, options, message):
    with pytest.raises(ValueError, match=message):
        read(log(LOG), **options)


def test_absent_files_and_folders_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="check the path"):
        read(tmp_path / "none.csv")
    with pytest.raises(ValueError, match="is a folder"):
        read(tmp_path)
    recording = navgym.simulate("auv/nominal", steps=3)
    with pytest.raises(FileNotFoundError, match="create it first"):
        write_csv(recording, tmp_path / "none" / "log.csv")


def same(a, b):
    """Whether two recordings hold the same numbers, bit for bit."""
    fields = ("time", "measurements", "lost", "truth", "regime", "process_scale")
    return all(
        getattr(a, f) is getattr(b, f) is None
        or np.array_equal(getattr(a, f), getattr(b, f), equal_nan=f == "measurements")
        for f in (*fields, "measurement_scale")
    )


finite = st.floats(-1e9, 1e9)
# smaller, larger ones are dates since 1970: read as s since the first
moments = st.floats(-1e4, 1e4)


@st.composite
def recordings(draw):
    """Recordings of a LinearModel with any measured states, times, losses, with or without truth."""
    count = draw(st.integers(1, 6))
    rows = draw(st.lists(st.integers(0, 3), min_size=1, max_size=4, unique=True))
    H = np.eye(4)[rows] if draw(st.booleans()) else draw(st.floats(0.1, 9)) * np.eye(4)[rows]
    gaps = draw(arrays(float, count, elements=st.floats(1e-3, 1e3)))
    lost = draw(arrays(bool, (count, len(rows))))
    lost[draw(st.integers(0, count - 1)), 0] = False
    return navgym.Recording(
        time=draw(moments) + np.cumsum(gaps),
        measurements=draw(arrays(float, (count, len(rows)), elements=finite)),
        lost=lost,
        truth=draw(st.none() | arrays(float, (count, 4), elements=finite)),
        model=navgym.LinearModel(H=H, dt=gaps),
    )


@settings(max_examples=100, deadline=None)
@given(recording=recordings())
def test_what_is_written_is_read_back_bit_for_bit(tmp_path_factory, recording):
    path = tmp_path_factory.mktemp("csv") / "log.csv"
    assert same(recording, read(write_csv(recording, path), model=recording.model))


@pytest.mark.parametrize("name", ["switch-B", "component-loss", "position-only"])
def test_simulated_recordings_survive_and_estimate_alike(tmp_path, name):
    recording = navgym.simulate(f"auv/{name}", steps=200, seed=1)
    back = read(write_csv(recording, tmp_path / "log.csv"), model=recording.model)
    assert same(recording, back)
    before, after = (navgym.estimate("oracle", r).states for r in (recording, back))
    assert np.array_equal(before, after)


def test_a_model_of_other_states_writes_and_reads_generic_names(tmp_path):
    model = navgym.LinearModel(F=np.eye(2), H=[[1.0, 1.0]])
    recording = navgym.Recording([1.0, 2.0], [[1.0], [np.nan]], truth=np.ones((2, 2)), model=model)
    path = write_csv(recording, tmp_path / "log.csv")
    assert path.read_text().splitlines()[0] == "time,z1,truth_x1,truth_x2"
    assert same(recording, read(path, model=model))


@pytest.mark.parametrize(
    ("rows", "names"), [([0, 1, 2, 3], "px,vx,py,vy"), ([2, 0], "py,px"), ([3], "vy")]
)
def test_measured_states_bear_their_own_names(tmp_path, rows, names):
    model = navgym.LinearModel(H=np.eye(4)[rows])
    recording = navgym.Recording([1.0, 2.0], np.ones((2, len(rows))), model=model)
    assert write_csv(recording, tmp_path / "log.csv").read_text().splitlines()[0] == f"time,{names}"


@pytest.mark.parametrize(
    "model",
    [
        navgym.LinearModel(F=np.eye(4), H=np.eye(4)[:1], position=(0, 1), velocity=(2, 3)),
        navgym.LinearModel(F=np.eye(4), H=np.eye(4)[:1], position=(0, 2), velocity=()),
    ],
    ids=["positions first", "no velocities"],
)
def test_four_states_in_another_order_are_not_called_positions_and_velocities(tmp_path, model):
    recording = navgym.Recording([1.0, 2.0], [[1.0], [2.0]], truth=np.ones((2, 4)), model=model)
    path = write_csv(recording, tmp_path / "log.csv")
    assert path.read_text().splitlines()[0] == "time,z1,truth_x1,truth_x2,truth_x3,truth_x4"


def test_a_failed_write_leaves_the_old_file_and_no_debris(tmp_path, monkeypatch):
    recording = navgym.simulate("auv/nominal", steps=3)
    path = write_csv(recording, tmp_path / "log.csv")
    before = path.read_text()
    monkeypatch.setattr("os.fsync", lambda _: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_csv(navgym.simulate("auv/nominal", steps=9), path)
    assert path.read_text() == before
    assert [p.name for p in tmp_path.iterdir()] == ["log.csv"]
