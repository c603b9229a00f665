"""A ship's own log of two IMUs: what is read is what was written, and every fault is named."""

import gzip

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import navgym
from navgym.deck.csv_log import write_deck_csv
from navgym.deck.log_columns import COLUMNS
from navgym.deck.model import DeckModel
from navgym.deck.relative import relative_attitude
from navgym.deck.scenarios import DECK_CATALOGUE
from navgym.deck.simulation import simulate
from navgym.inertial.flexure import ARCMIN
from navgym.inertial.imu import NO_ERRORS

IMU = ("main_angle", "main_velocity", "sub_angle", "sub_velocity")
T20 = np.array([k / 100 for k in range(20)])
HOUR = np.pi / 180.0 / 3600.0  # rad/s in a °/h


@pytest.fixture(scope="module")
def ship():
    """30 s of a swaying ship."""
    return simulate(DECK_CATALOGUE["paper"].override(duration=30.0), [0])[0]


@pytest.fixture(scope="module")
def exact():
    """60 s of it by IMUs without errors, as reference units would have it."""
    scenario = DECK_CATALOGUE["paper"].override(duration=60.0, main=NO_ERRORS, sub=NO_ERRORS)
    return simulate(scenario, [3])[0]


def table(T=20, **changes):
    """Columns of a short log at rest, by name; None takes one out."""
    found = {name: [1.0] * T for name in COLUMNS[:13]}
    found |= {f"{unit}_acc_z": [-9.8] * T for unit in ("main", "sub")}
    found |= {"time": [k / 100 for k in range(T)]} | changes
    return {name: column for name, column in found.items() if column is not None}


@pytest.fixture
def log(tmp_path):
    """Writes columns as a log and returns its path."""

    def write(columns, delimiter=","):
        path = tmp_path / "ship.csv"
        rows = [list(columns), *zip(*columns.values(), strict=True)]
        path.write_text("\n".join(delimiter.join(str(c) for c in row) for row in rows) + "\n")
        return path

    return write


def read(path, **options):
    """A log whose lever arm is told."""
    usual = {} if "model" in options else {"lever_arm": (10.0, 10.0, 2.0)}
    return navgym.read("deck_csv", path, **usual | options)


def rates_of(recording):
    return [np.array(getattr(recording, name)) / recording.interval for name in IMU]


# --- round trip -----------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["deg/h", "deg/s", "rad/s"])
def test_what_was_written_is_read_to_rounding(ship, tmp_path, unit):
    path = write_deck_csv(ship, tmp_path / "ship.csv", gyro_unit=unit)
    back = read(path, gyro_unit=unit, model=ship.model)
    assert np.array_equal(back.time, ship.time)
    for name in IMU:
        assert np.allclose(getattr(back, name), getattr(ship, name), rtol=1e-14, atol=0.0)
    assert np.allclose(back.reference, ship.reference, atol=1e-15)
    assert back.model is not None
    assert np.array_equal(back.model.lever_arm, ship.model.lever_arm)


def test_lost_samples_are_empty_cells(ship, tmp_path):
    angle = np.array(ship.sub_angle)
    angle[[5, 6, 900]] = np.nan
    broken = read(write_deck_csv(ship, tmp_path / "whole.csv"))
    broken = type(ship)(ship.time, *(getattr(broken, n) for n in IMU[:2]), angle, ship.sub_velocity)
    path = write_deck_csv(broken, tmp_path / "broken.csv")
    assert ",,," in path.read_text().splitlines()[6]
    back = read(path)
    assert back.gaps.nonzero()[0].tolist() == [5, 6, 900]
    assert back.reference is None


def test_a_folder_that_is_not_there_is_named(ship, tmp_path):
    with pytest.raises(FileNotFoundError):
        write_deck_csv(ship, tmp_path / "nowhere" / "ship.csv")
    with pytest.raises(FileNotFoundError, match="check the path"):
        read(tmp_path / "absent.csv")


# --- what the columns mean ------------------------------------------------------------------------


def test_gyros_are_in_degrees_per_hour_and_forces_in_metres_per_second_squared(log):
    recording = read(log(table(main_gyro_y=[3600.0] * 20)))
    assert recording.main_angle[4] == pytest.approx([HOUR / 100, np.radians(0.01), HOUR / 100])
    assert recording.sub_velocity[4] == pytest.approx([0.01, 0.01, -0.098])


@pytest.mark.parametrize(
    ("unit", "value"), [("deg/h", 1800.0), ("deg/s", 0.5), ("rad/s", np.pi / 360.0)]
)
def test_half_a_degree_per_second_is_the_same_in_every_unit(log, unit, value):
    rates = {f"{imu}_gyro_{axis}": [value] * 20 for imu in ("main", "sub") for axis in "xyz"}
    recording = read(log(table(**rates)), gyro_unit=unit, check_units=False)
    np.testing.assert_allclose(recording.main_angle[1:], np.radians(0.005), rtol=1e-12)
    np.testing.assert_allclose(recording.sub_angle[1:], np.radians(0.005), rtol=1e-12)


def spelled(columns):
    """The same columns as another logger names them."""
    return {
        name.replace("_gyro_", " Gyro ").replace("_acc_", " Accel. ").title(): values
        for name, values in columns.items()
    }


def test_names_may_be_in_any_case_and_tell_units(log):
    plain = read(log(table(main_gyro_x=[3600.0] * 20)))
    columns = table(main_gyro_x=[1.0] * 20)
    columns = {
        f"{name} [deg/s]" if "main_gyro" in name else f"{name} (g)" if "sub_acc" in name else name:
        [v / 3600.0 for v in values] if name in ("main_gyro_y", "main_gyro_z")
        else [v / 9.80665 for v in values] if "sub_acc" in name else values
        for name, values in columns.items()
    }  # fmt: skip
    other = read(log(spelled(columns)))
    for name in IMU:
        np.testing.assert_allclose(getattr(other, name), getattr(plain, name), rtol=1e-12)
    assert other.meta["columns"]["sub_acc_z"] == "Sub Accel. Z (G)"
    told = {f"sub_acc_{axis}": "g" for axis in "xyz"}
    twice = read(log(table(**{n: [v / 9.80665 for v in table()[n]] for n in told})), units=told)
    np.testing.assert_allclose(twice.sub_velocity, plain.sub_velocity, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "start", "scale"),
    [("time", 0, 1.0), ("Time (ms)", 0, 1e3), ("t", 1_700_000_000_000_000_000, 1e9),
     ("timestamp [us]", 1_700_000_000_000_000, 1e6)],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:ship.csv. the times are taken for ns")
def test_times_are_seconds_whatever_the_clock_counts(log, name, start, scale):
    stamps = [start + round(k * scale / 100) if scale > 1 else k / 100 for k in range(20)]
    columns = {name: stamps, **{n: v for n, v in table().items() if n != "time"}}
    recording = read(log(columns))
    np.testing.assert_allclose(np.diff(recording.time), 0.01, rtol=1e-9)


def test_dates_are_times_too(log):
    dates = [f"2026-11-28T12:00:00.{k:02d}Z" for k in range(20)]
    recording = read(log(table(time=dates)))
    np.testing.assert_allclose(recording.time, np.arange(20) / 100.0, atol=1e-12)
    assert recording.meta["start"].startswith("2026-11-28T12:00:00")


@pytest.mark.parametrize(("word", "told"), [("NA", ()), ("null", ()), ("-9999", (-9999,)), ("-9999.0", (-9999,)), ("lost", ("lost",))])  # fmt: skip
def test_lost_samples_have_many_names(log, word, told):
    rates = [1.0] * 20
    rates[7] = word
    assert read(log(table(sub_gyro_z=rates)), missing=told).gaps.nonzero()[0].tolist() == [7]


@pytest.mark.parametrize("count", [1, 12])
def test_a_sentinel_that_nobody_told_is_no_measurement(log, count):
    forces = [0.1] * 20
    forces[7 : 7 + count] = [-9999] * count
    with pytest.raises(ValueError, match=r"line 9, column 'sub_acc_x': -9999 is .* m/s².*missing="):
        read(log(table(sub_acc_x=forces)))


def test_decimal_commas_tabs_and_gzip_are_found(log, tmp_path):
    plain = read(log(table()))
    text = "\n".join("\t".join(line.split(",")) for line in log(table()).read_text().splitlines())
    packed = tmp_path / "ship.csv.gz"
    packed.write_bytes(gzip.compress(text.replace(".", ",").encode("latin-1")))
    other = read(packed)
    np.testing.assert_array_equal(other.main_velocity, plain.main_velocity)
    assert "unpacked by gzip" in other.meta["reading"]


def test_columns_of_no_use_are_said_or_refused(log):
    path = log(table(main_gyro_w=[0] * 20))
    assert "left out, of no use here: 'main_gyro_w'" in read(path).meta["reading"]
    assert "main_gyro_w" not in " ".join(read(path, extra="ignore").meta["reading"])
    with pytest.raises(ValueError, match=r"unknown column of ship.csv: 'main_gyro_w'. Did you mean 'main_.*extra='ignore'"):  # fmt: skip
        read(path, extra="raise")


def test_two_columns_that_could_be_meant_are_refused(log):
    columns = table() | {"Main Gyro X": [1.0] * 20, "main gyro x (deg/h)": [1.0] * 20}
    del columns["main_gyro_x"]
    with pytest.raises(ValueError, match="several columns that may be main_gyro_x"):
        read(log(columns))


@pytest.mark.parametrize("unit", ["furlong/s", "m"])
def test_a_unit_that_is_none_is_named(log, unit):
    with pytest.raises(ValueError, match=f"unknown unit of ship.csv, column 'main_gyro_x': '{unit}'"):  # fmt: skip
        read(log(table()), units={"main_gyro_x": unit})


def test_a_wild_time_is_no_gap_of_years(log):
    time = T20.tolist()
    time[9] = 1e12
    with pytest.raises(
        ValueError, match=r"ship\.csv, line 11, column 'time': 1e\+12 s lie between"
    ):
        read(log(table(time=time)), regular=True)


def test_options_reach_the_model(log):
    recording = read(log(table()), lever_arm=(1, 2, 3), samples_per_step=4)
    assert recording.model.lever_arm.tolist() == [1, 2, 3]
    assert recording.steps == 5
    believed = DeckModel(lever_arm=(4, 5, 6), rate_noise=1e-3)
    kept = read(log(table()), model=believed, samples_per_step=2).model
    assert kept.lever_arm.tolist() == [4, 5, 6]
    assert (kept.rate_noise, kept.samples_per_step) == (1e-3, 2)


def test_a_model_may_be_told_field_by_field(log):
    told = {"lever_arm": (4, 5, 6), "rate_noise": 1e-3}
    found = read(log(table()), model=told).model
    assert (found.lever_arm.tolist(), found.rate_noise) == ([4, 5, 6], 1e-3)
    assert read(log(table()), model=told, lever_arm=(1, 2, 3)).model.lever_arm.tolist() == [1, 2, 3]


@pytest.mark.parametrize(("rate", "samples"), [(20.0, 1), (100.0, 5), (200.0, 10)])
def test_a_filter_step_takes_as_long_at_any_rate(log, rate, samples):
    columns = table(T=60, time=[k / rate for k in range(60)])
    recording = read(log(columns))
    assert recording.model.samples_per_step == samples
    assert recording.step == pytest.approx(0.05)


def test_what_nobody_told_is_said(log):
    said = " ".join(read(log(table())).meta["reading"])
    assert "IDAM section 5" in said
    assert "gyro_bias" in said
    assert "gyros in deg/h" in said
    whole = " ".join(read(log(table()), model=DeckModel(lever_arm=(1, 2, 3))).meta["reading"])
    assert "IDAM" not in whole


def test_columns_may_come_in_any_order_and_under_other_names(log):
    columns = dict(reversed(table(main_gyro_x=[7.0] * 20).items()))
    columns = {{"main_gyro_x": "gx 1", "time": "t (ms)"}.get(k, k): v for k, v in columns.items()}
    columns |= {"t (ms)": [10 * k for k in range(20)], "depth": [3] * 20}
    names = {"main_gyro_x": "gx 1", "time": "t (ms)"}
    path = log(columns, ";")
    recording = read(path, columns=names, delimiter=";", time_scale=1e-3, extra="ignore")
    assert recording.interval == pytest.approx(0.01)
    assert recording.main_angle[0, 0] == pytest.approx(7.0 * HOUR / 100)


def test_fixes_go_to_meta_as_means(log):
    fixes = {"latitude": ["", 45.0] * 10, "longitude": [""] * 19 + [-120.5]}
    meta = read(log(table(**fixes))).meta
    assert (meta["format"], meta["file"]) == ("deck_csv", "ship.csv")
    assert (meta["latitude"], meta["longitude"]) == (45.0, -120.5)
    assert "latitude" not in read(log(table(latitude=[""] * 20))).meta


def test_limits_are_in_the_units_of_the_columns(log):
    rates = [1.0] * 20
    rates[7:9] = [400.0, -500.0]
    path = log(table(sub_gyro_z=rates))
    assert read(path, gyro_limit=400.0).gaps.nonzero()[0].tolist() == [7, 8]
    assert read(path, force_limit=9.0).gaps.all()


def test_a_quaternion_is_the_reference(log):
    turn = Rotation.from_euler("ZYX", [1.0, 2.0, 3.0], degrees=True).as_quat().tolist()
    columns = table(
        **{name: [v] * 20 for name, v in zip(("qx", "qy", "qz", "qw"), turn, strict=True)}
    )
    assert read(log(columns)).reference[3] == pytest.approx(turn)
    assert read(log(columns), reference=False).reference is None


# --- a reference from two better units ------------------------------------------------------------


def test_two_better_units_give_the_relative_attitude(exact):
    """Its changes, the flexure, to a second of arc; its constant as well as 60 s of sway allow."""
    found = relative_attitude(np.array(exact.time), *rates_of(exact), exact.model.lever_arm)
    error = (found * Rotation.from_quat(np.array(exact.reference)).inv()).as_rotvec() / ARCMIN
    assert error.std(axis=0).max() < 0.3
    assert np.abs(error.mean(axis=0)).max() < 2.5
    bent = Rotation.from_quat(np.array(exact.reference)).as_rotvec() / ARCMIN
    assert bent.std(axis=0).max() > 3.0  # so much was there to follow


def test_the_lever_arm_is_worth_knowing(exact):
    errors = []
    for lever in (exact.model.lever_arm, np.zeros(3)):
        found = relative_attitude(np.array(exact.time), *rates_of(exact), lever)
        error = (found * Rotation.from_quat(np.array(exact.reference)).inv()).mean().as_rotvec()
        errors.append(np.linalg.norm(error[:2]))
    assert errors[0] < 0.5 * errors[1]


def test_large_angles_between_the_units_are_found(exact):
    """The paper's units stand as they stand: no small angle is assumed."""
    turn = Rotation.from_euler("ZYX", [120.0, -30.0, 50.0], degrees=True)
    main, pull, sub, push = rates_of(exact)
    given = (main, pull, turn.apply(sub, inverse=True), turn.apply(push, inverse=True))
    found = relative_attitude(np.array(exact.time), *given, exact.model.lever_arm)
    plain = relative_attitude(np.array(exact.time), main, pull, sub, push, exact.model.lever_arm)
    assert (found * (plain * turn).inv()).magnitude().max() < 1e-9


def with_references(recording, side1, side2):
    """A log whose reference units are turned from the IMUs: IMU = side · reference unit."""
    columns = {"time": recording.time.tolist()}
    readings = dict(
        zip(("main_gyro", "main_acc", "sub_gyro", "sub_acc"), rates_of(recording), strict=True)
    )
    for unit, name, side in (("ref1", "main", side1), ("ref2", "sub", side2)):
        readings |= {f"{unit}_{s}": side.apply(readings[f"{name}_{s}"]) for s in ("gyro", "acc")}
    for name, values in readings.items():
        scaled = values / (HOUR if name.endswith("gyro") else 1.0)
        columns |= dict(zip([f"{name}_{axis}" for axis in "xyz"], scaled.T.tolist(), strict=True))
    return columns


def test_installation_deviations_are_taken_off(ship, log):
    """The paper's table 2, which is up to half a degree."""
    given = ((-0.041, 0.430, -0.250), (-0.029, 0.525, 0.330))
    sides = [Rotation.from_euler("ZYX", [h, p, r], degrees=True) for p, r, h in given]
    path = log(with_references(ship, *sides))
    options = {"deviation1": given[0], "deviation2": given[1], "model": ship.model}
    error = Rotation.from_quat(np.array(read(path, **options).reference))
    error = (error * Rotation.from_quat(np.array(ship.reference)).inv()).as_rotvec() / ARCMIN
    assert np.abs(error.mean(axis=0)).max() < 4.0
    assert error.std(axis=0).max() < 0.5
    wrong = Rotation.from_quat(np.array(read(path, model=ship.model).reference))
    assert (
        wrong * Rotation.from_quat(np.array(ship.reference)).inv()
    ).mean().magnitude() > 20 * ARCMIN


def test_one_reference_unit_alone_is_no_reference(log):
    columns = table()
    columns |= {f"ref1_{s}_{axis}": [1.0] * 20 for s in ("gyro", "acc") for axis in "xyz"}
    assert read(log(columns)).reference is None


# --- time -----------------------------------------------------------------------------------------


def test_a_gap_names_the_line_and_the_remedy(log):
    time = (T20 + 0.05 * (T20 > 0.095)).tolist()
    with pytest.raises(ValueError, match=r"ship\.csv, line 12, column 'time': 0\.06 s after .* 0\.01 s are usual: pass regular=True"):  # fmt: skip
        read(log(table(time=time)))


def test_a_duplicate_names_the_line_and_the_remedy(log):
    time = T20.tolist()
    time[4] = time[3]
    with pytest.raises(ValueError, match=r"line 6, column 'time': 0\.03 does not come after 0\.03: .*regular=True"):  # fmt: skip
        read(log(table(time=time)))


def test_regular_makes_even_steps_and_marks_gaps(log):
    time = T20 + 0.05 * (T20 > 0.095)
    slope = (100.0 * time).tolist()
    recording = read(log(table(time=time.tolist(), main_gyro_x=slope)), regular=True)
    assert recording.time == pytest.approx(np.arange(25) / 100.0)
    assert recording.gaps.nonzero()[0].tolist() == [10, 11, 12, 13, 14]
    whole = read(log(table(time=time.tolist(), main_gyro_x=slope)), regular=True, longest_gap=0.1)
    assert whole.main_angle[:, 0] / HOUR * 100 == pytest.approx(np.arange(25.0))


def test_regular_sorts_and_drops_duplicates(log):
    columns = table(main_gyro_x=list(range(20)))
    shuffled = [19, 3, *range(19), 3]
    columns = {name: [column[k] for k in shuffled] for name, column in columns.items()}
    recording = read(log(columns), regular=True)
    assert recording.main_angle[:, 0] / HOUR * 100 == pytest.approx(np.arange(20.0))


def test_regular_leaves_an_even_log_as_it_is(ship, tmp_path):
    path = write_deck_csv(ship, tmp_path / "ship.csv")
    plain, regular = read(path), read(path, regular=True)
    for name in ("time", *IMU, "attitude"):
        assert np.allclose(getattr(plain, name), getattr(regular, name), rtol=1e-9, atol=1e-13), (
            name
        )


def test_regular_turns_the_reference_on_the_way_between(ship, tmp_path):
    lines = write_deck_csv(ship, tmp_path / "ship.csv").read_text().splitlines()
    del lines[500]
    (tmp_path / "ship.csv").write_text("\n".join(lines))
    recording = read(tmp_path / "ship.csv", regular=True)
    assert len(recording) == 3000
    apart = (
        Rotation.from_quat(recording.reference + 0.0)
        * Rotation.from_quat(ship.reference + 0.0).inv()
    )
    assert apart.magnitude().max() < 0.01 * ARCMIN


def test_references_cannot_carry_over_a_gap(ship, log):
    columns = with_references(ship, Rotation.identity(), Rotation.identity())
    columns = {name: column[:600] + column[700:1200] for name, column in columns.items()}
    path = log(columns)
    with pytest.raises(
        ValueError, match=r"gap at 6\.01 s, over which ref1 and ref2 .*reference=False"
    ):
        read(path, regular=True)
    assert read(path, regular=True, reference=False).gaps.sum() == 100


# --- what is refused ------------------------------------------------------------------------------


def bad(value, k=4):
    return [value if i == k else 1.0 for i in range(20)]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"main_gyro_x": bad("fast")}, r"ship\.csv, line 6, column 'main_gyro_x': must be a finite number, or nothing where lost, got 'fast'"),
        ({"sub_acc_z": bad("inf")}, "line 6, column 'sub_acc_z': must be a finite number"),
        ({"time": bad("")}, "line 6, column 'time': must be a finite number, got ''"),
        ({"sub_gyro_z": None}, r"ship\.csv lacks sub_gyro_z: name the columns so, or say which .*\{'sub_gyro_z': \.\.\.\}"),
        ({"time": None}, "unknown column of ship.csv: 'time'.* Say which it is with columns="),
        ({"ref1_gyro_x": [0] * 20}, "lacks ref1_gyro_y, ref1_gyro_z, ref1_acc_x"),
        ({"qw": [1.0] * 20, "qx": [0.0] * 20}, "lacks qy, qz"),
        ({"qw": [2.0] * 20, "qx": [0] * 20, "qy": [0] * 20, "qz": [0] * 20}, "line 2, column 'qw': the quaternion has length 2"),
        ({"qw": bad(""), "qx": [0] * 20, "qy": [0] * 20, "qz": [0] * 20}, "line 6, column 'qw': .*reference=False"),
        ({"latitude": bad(95.0)}, r"line 6, column 'latitude': must be in degrees, ±90, got 95"),
        ({"longitude": bad("east")}, "line 6, column 'longitude'"),
        ({"main_acc_z": [-1.0] * 20, "main_acc_x": [0.0] * 20, "main_acc_y": [0.0] * 20}, "they look like g"),
        ({"time": [0.0] * 20}, "does not come after"),
    ],
)  # fmt: skip
def test_a_faulty_log_names_line_and_column(log, changes, message):
    with pytest.raises(ValueError, match=message):
        read(log(table(**changes)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gyro_unit": "deg/sec"}, "unknown gyro_unit 'deg/sec'. Did you mean 'deg/s'"),
        ({"lever_arm": (1, 2)}, r"lever_arm must have shape \(3,\)"),
        ({"samples_per_step": 0}, "samples_per_step must be a whole number"),
        ({"samples_per_step": 11}, "time has 20 samples, two filter steps need 22"),
        ({"model": 3}, r"model must be a navgym\.DeckModel or a dict of its fields, got 3"),
        ({"model": {"lever_arm": (1, 2, 3), "rate": 1}}, "unknown field of model: 'rate'"),
        ({"model": {"rate_noise": 1e-3}}, "where the sub IMU stands is not known"),
        ({"lever_arm": None}, r"ship\.csv: where the sub IMU stands is not known: pass lever_arm="),
        ({"extra": "drop"}, "unknown extra 'drop'"),
        ({"time_scale": 0.0}, "time_scale must be a finite number above 0"),
        ({"columns": ["time"]}, "columns must be a dict"),
        ({"columns": {"gyro": "gx"}}, "unknown name in columns: 'gyro'"),
        ({"columns": {"time": "t"}}, "unknown column of ship.csv: 't'"),
        ({"delimiter": ";"}, r"pass delimiter=','"),
        ({"levers": 1}, "unknown option of format 'deck_csv': 'levers'. Did you mean"),
        ({"regular": True, "longest_gap": -1.0}, "longest_gap must be a finite number above 0"),
    ],
)
def test_bad_options_are_named(log, options, message):
    with pytest.raises(ValueError, match=message):
        read(log(table()), **options)


def test_degrees_per_second_taken_for_degrees_per_hour_are_noticed(ship, tmp_path):
    path = write_deck_csv(ship, tmp_path / "ship.csv", gyro_unit="deg/s")
    with pytest.raises(ValueError, match=r"main_angle: .* in °/s but taken for °/h"):
        read(path)
    with pytest.raises(ValueError, match=r"main_angle: .* in °/h but taken for °/s"):
        read(write_deck_csv(ship, tmp_path / "ship.csv"), gyro_unit="deg/s")


def test_deviations_are_three_angles(ship, log):
    path = log(with_references(ship, Rotation.identity(), Rotation.identity()))
    with pytest.raises(ValueError, match=r"deviation2 must have shape \(3,\) \(pitch, roll and"):
        read(path, deviation2=(1.0, 2.0))


def test_one_time_is_too_little(log):
    with pytest.raises(ValueError, match="the log holds one time only"):
        read(log(table(time=[0.5] * 20)), regular=True)
