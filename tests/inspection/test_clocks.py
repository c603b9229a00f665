"""A clock that was set back is told with its row and time, and no command that must fail is named."""

import numpy as np
import pytest

import navgym
from navgym import command
from navgym.core.clocks import date_of
from navgym.inspection.inspect import inspect
from tests.formats import writers
from tests.formats.writers import Sailed
from tests.inspection import logs


def _set_back(seconds, at=200):
    columns = logs.eights()
    columns["time"][at:] -= seconds + 1.0  # one step later it is so many seconds less
    return columns


@pytest.mark.parametrize("seconds", [1, 2, 4, 19])
def test_a_clock_set_back_by_whole_steps_is_found_however_short(seconds, tmp_path):
    log = logs.written(tmp_path / "log.csv", _set_back(float(seconds)))
    found = inspect(log)
    (clock,) = [f for f in found.findings if f.kind == "clock set"]
    assert f"line 202, column 'time': the time goes back by {seconds} s, from 199 s" in clock.said
    assert (found.status, found.next) == (2, "")
    assert "sort=True" not in clock.said + clock.remedy  # which would mix two moments


def test_a_short_fall_of_one_sensor_of_several_is_found(tmp_path):
    store, voyage = writers.typestore(), Sailed(logs.eights())
    rest = []
    for message in writers.messages(store, voyage):
        if message[0] == "/gps/fix" and message[2] > voyage.start + 200 * 10**9:
            message[3].header.stamp.sec -= 3
        if message[0] in ("/gps/fix", "/imu", "/dvl"):
            rest.append(message)
    none = Sailed({n: v[:0] for n, v in logs.eights().items()})
    found = inspect(writers.bag(tmp_path / "dive", none, more=rest))
    (clock,) = [f for f in found.findings if f.kind == "clock set"]
    assert "goes back by 2 s, from 200 s" in clock.said
    assert found.next == ""


@pytest.mark.parametrize("seconds", [7.25, 50.25, 3600.0])
def test_a_clock_that_was_set_is_not_sorted_where_the_vehicle_moves_on(seconds, tmp_path):
    found = inspect(logs.written(tmp_path / "log.csv", _set_back(seconds)))
    clock = next(f for f in found.findings if f.kind == "clock set")
    assert "sort=True" not in clock.said
    assert "cut the file there" in clock.remedy
    assert found.next == ""


def test_blocks_in_another_order_are_sorted_by_the_next_command(tmp_path):
    k = np.r_[150 : logs.ROWS, 0:150]
    log = logs.written(tmp_path / "log.csv", {n: v[k] for n, v in logs.eights().items()})
    found = inspect(log)
    assert [f.kind for f in found.findings] == ["clock set"]
    assert found.next.endswith("--read sort true")
    assert {f.kind for f in inspect(log, "sort", "true").findings} == {"order"}


@pytest.mark.parametrize("rows", [1, 2, 3, 4])
@pytest.mark.parametrize("how", ["late", "twice"])
def test_rows_that_came_late_or_twice_are_no_clock_that_was_set(rows, how, tmp_path):
    k = np.arange(logs.ROWS)
    block = np.arange(100, 100 + rows)
    if how == "late":  # after the three rows that follow them
        k = np.concatenate([k[:100], k[100 + rows : 103 + rows], block, k[103 + rows :]])
    else:
        k = np.insert(k, 100 + rows, block)
    columns = {n: v[k] for n, v in logs.eights().items()}
    found = inspect(logs.written(tmp_path / "log.csv", columns))
    assert {f.kind for f in found.findings} <= {"order", "duplicate"}


def test_of_a_device_whose_clock_was_set_back_no_command_is_named(tmp_path, capsys):
    path = writers.nmea(tmp_path / "boat.nmea", Sailed(_set_back(39.0)))
    for words in ([], ["sort", "true"]):
        found = inspect(path, *words)
        assert [f.kind for f in found.findings] == ["clock set"]
        assert "goes back by 39 s, from 199 s to 160 s" in found.findings[0].said
        assert found.next == ""
    assert command.main(["inspect", str(path)]) == 2
    assert "no command helps" in capsys.readouterr().out.splitlines()[-1]


# ---- dates


def test_a_device_log_tells_the_date_from_which_its_times_count(tmp_path):
    path = writers.nmea(tmp_path / "boat.nmea", Sailed(logs.eights()))
    recording = navgym.read("log", path)
    start = date_of(str(writers.START + 600 * 10**9), 1e-9)
    assert recording.meta["start"] == start
    assert any(f"({start})" in text for text in recording.meta["reading"])
    gpx = navgym.estimate("kf", recording).to_gpx(tmp_path / "e.gpx").read_text()
    assert f"<time>{start[:19]}.000Z</time>" in gpx


def test_an_inertial_log_does_so_too(tmp_path):
    path = writers.bag(tmp_path / "dive", Sailed(logs.eights()))
    recording = navgym.read("ins_log", path, topics={"dvl": "/dvl", "fix": "/gps/fix"})
    assert recording.meta["start"].startswith("2026-11-29T")


def test_stamps_since_boot_are_no_date(tmp_path):
    path = writers.ulog(tmp_path / "flight.ulg", Sailed(logs.eights()))
    assert not str(navgym.read("log", path).meta.get("start", "")).endswith("Z")
    assert date_of("12000000000", 1e-9) is None
    assert date_of("1795910970.5", 1.0) == "2026-11-29T00:09:30.500000000Z"
