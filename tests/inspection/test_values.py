"""Outages, digits and fixes at (0, 0): what stands in the cells, and what does not."""

import dataclasses
import shlex

import numpy as np
import pytest

from navgym.ins.csv_set import write_ins_csv
from navgym.inspection import timing
from navgym.inspection.inspect import inspect
from tests.formats import writers
from tests.formats.writers import Sailed
from tests.inspection import logs


def kinds(found):
    return {(f.kind, f.channel) for f in found.findings}


def degrees(columns, digits=8, at=(43.3, -8.4)):
    """The same log in latitude and longitude, °, of so many digits."""
    north, east = 111_132.0, 111_320.0 * np.cos(np.radians(at[0]))
    lat, lon = at[0] + columns["px"] / north, at[1] + columns["py"] / east
    rest = {n: columns[n] for n in ("time", "vx", "vy")}
    return rest | {"lat": np.round(lat, digits), "lon": np.round(lon, digits)}


@pytest.mark.parametrize("sensor", ["position", "velocity"])
def test_an_outage_of_empty_cells_is_a_gap(sensor, tmp_path):
    columns = logs.eights()
    for name in {"position": ("px", "py"), "velocity": ("vx", "vy")}[sensor]:
        columns[name][100:180] = np.nan
    found = inspect(logs.written(tmp_path / "log.csv", columns))
    assert kinds(found) == {("gap", sensor)}
    assert "nothing received for 81 s after 99 s" in found.findings[0].said


def test_of_rows_that_are_not_there_a_gap_is_told_once(tmp_path):
    columns = logs.eights()
    columns["px"][99] = columns["py"][99] = np.nan  # the sensor's gap is a step longer
    keep = np.r_[0:100, 180 : logs.ROWS]
    found = inspect(logs.written(tmp_path / "log.csv", {n: v[keep] for n, v in columns.items()}))
    assert kinds(found) == {("gap", "")}


@pytest.mark.parametrize("seed", range(5))
def test_losses_in_bursts_are_no_outage(seed):
    lengths = np.random.default_rng(seed).geometric(1.0 / 20.0, 40)
    heard = np.repeat(np.arange(40) % 2 == 0, lengths)
    assert list(timing.outage(np.flatnonzero(heard).astype(float), "position")) == []


def test_void_sentences_are_an_outage(tmp_path):
    columns = logs.eights()
    path = writers.nmea(tmp_path / "boat.nmea", Sailed(columns))
    whole = path.read_text().splitlines()
    fixes = [k for k, line in enumerate(whole) if "GGA" in line][100:170]
    for k in fixes:
        cells = whole[k][1:].partition("*")[0].split(",")
        cells[6] = "0"
        body = ",".join(cells)
        whole[k] = f"${body}*{np.bitwise_xor.reduce(list(body.encode())):02X}"
    path.write_text("\n".join(whole) + "\n")
    assert ("gap", "position") in kinds(inspect(path))


def test_a_sensor_of_an_ins_that_lost_some_is_looked_at_for_gaps_too(tmp_path):
    r = logs.ins(duration=120.0)
    fix = r.aiding["dvl"]
    values = np.array(fix.values)
    values[3] = np.nan
    values[20:90] = np.nan
    lost = np.isnan(values).any(axis=1)
    folder = write_ins_csv(logs._with(r, "dvl", values=values, lost=lost), tmp_path / "set")
    assert ("gap", "dvl") in kinds(inspect(folder))


# ---- digits


@pytest.mark.parametrize("digits", [4, 5])
def test_coarse_degrees_are_coarse_and_not_held(digits, tmp_path):
    columns = logs.eights()
    log = logs.written(tmp_path / "log.csv", degrees(columns, digits))
    found = inspect(log)
    assert {f.kind for f in found.findings} <= {"resolution"}
    step = 10.0**-digits * 111e3
    noise = dict(zip(found.model[::2], found.model[1::2], strict=True))["position_noise"]
    assert float(noise) >= 0.99 * step / np.sqrt(12.0)


def test_ten_metres_of_a_digit_are_told(tmp_path):
    found = inspect(logs.written(tmp_path / "log.csv", degrees(logs.eights(), 4)))
    (coarse,) = [f for f in found.findings if f.kind == "resolution"]
    assert "multiples of 11.1" in coarse.said


# ---- nowhere


def test_fixes_at_the_origin_of_the_globe_are_told(tmp_path):
    columns = degrees(logs.eights())
    for name in ("lat", "lon"):
        columns[name][50:58] = 0.0
    found = inspect(logs.written(tmp_path / "log.csv", columns))
    (zero,) = [f for f in found.findings if f.kind == "sentinel"]
    assert "8 fixes at (0, 0) are taken for lost ones" in zero.said
    assert kinds(found) == {("sentinel", zero.channel)}


# ---- units and frames whose option is another, or none


def test_degrees_in_radians_are_no_scale(tmp_path):
    columns = degrees(logs.eights(), 12)
    for name in ("lat", "lon"):
        columns[name] = np.radians(columns[name])
    log = tmp_path / "log.csv"
    rows = zip(*([f"{v:.12g}" for v in values] for values in columns.values()), strict=True)
    log.write_text("\n".join([",".join(columns), *map(",".join, rows)]) + "\n")
    found = inspect(log)
    assert {f.kind for f in found.findings} == {"degrees"}
    assert found.next.endswith("--read units.lat rad units.lon rad")
    assert found.model == () or "velocity_noise" not in found.model
    again = inspect(log, "units.lat", "rad", "units.lon", "rad")
    assert [f.kind for f in again.findings] == []


@pytest.mark.parametrize(
    ("change", "kind", "suspect"),
    [
        (lambda c: c | {"lat": c["lon"], "lon": c["lat"]}, "axes", "latitude and longitude"),
        (lambda c: c | {"lon": -c["lon"]}, "sign", "longitude"),
        (lambda c: c | {"vy": -c["vy"]}, "sign", "longitude"),
    ],
)
def test_of_degrees_and_velocities_both_are_suspects(change, kind, suspect, tmp_path):
    columns = change(degrees(logs.eights(), at=(0.5, -8.4)))
    found = inspect(logs.written(tmp_path / "log.csv", columns))
    (one,) = [f for f in found.findings if f.kind == kind]
    assert suspect in one.said
    assert one.options == ()


@pytest.mark.parametrize(("unit", "factor"), [("g", 1.0), ("mg", 1e3)])
def test_accelerometers_in_g_are_named_and_not_hidden(unit, factor, tmp_path):
    r = logs.ins()
    velocity = np.array(r.velocity) / 9.80665 * factor
    wrong = dataclasses.replace(r, velocity=velocity, check_units=False)
    found = inspect(write_ins_csv(wrong, tmp_path / "set"))
    (gravity,) = [f for f in found.findings if f.kind == "gravity"]
    assert f"in {unit}, not m/s²" in gravity.said
    assert "units" in {f.kind for f in found.findings}
    assert found.next == ""


def test_an_imu_the_other_way_up_is_turned_by_the_next_command(tmp_path):
    found = inspect(logs.DEFECTS["an_imu_is_mounted_the_other_way_up"][2](tmp_path))
    words = shlex.split(found.next)
    again = inspect(tmp_path / "set", *words[words.index("--read") + 1 :])
    assert "turn.acc_z" in words
    assert again.findings == ()


@pytest.mark.parametrize("name", ["imu.csv", "other.csv"])
def test_one_file_of_an_ins_is_unreadable_and_told_where_it_belongs(name, tmp_path):
    folder = write_ins_csv(logs.ins(), tmp_path / "set")
    log = (folder / "imu.csv").rename(folder / name)
    found = inspect(log, format_name="ins_csv")
    assert [f.kind for f in found.findings] == ["unreadable"]
    assert "folder" in found.findings[0].remedy
    assert found.next == (f"navgym inspect {folder}" if name == "imu.csv" else "")


def test_the_longest_step_is_told_where_one_is_longer(tmp_path):
    even = dict(inspect(logs.written(tmp_path / "log.csv", logs.eights())).told)
    assert even["step"] == "1 s (median)"
    columns = {n: np.delete(v, 50) for n, v in logs.eights().items()}
    gone = dict(inspect(logs.written(tmp_path / "gone.csv", columns)).told)
    assert gone["step"] == "1 s (median), the longest 2 s, after 49 s"
