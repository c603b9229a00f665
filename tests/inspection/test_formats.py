"""The same defects are found by their names in logs of every format, and none in sound ones."""

import itertools
import shlex

import pytest

from navgym import command
from navgym.inspection.inspect import inspect
from navgym.readers import ReaderOptions
from tests.formats import writers
from tests.formats.writers import Sailed
from tests.inspection import logs

FORMATS = {
    "nmea": (writers.nmea, "boat.nmea"),
    "mcap": (lambda path, v: writers.bag(path, v, without=("/log/twist", "/odom")), "dive"),
    "ulog": (writers.ulog, "flight.ulg"),
    "ardupilot": (writers.dataflash, "flight.bin"),
    "tlog": (writers.tlog, "flight.tlog"),
}
BODY = {"mcap"}  # with a Doppler log, whose axes are the vehicle's


def written(name, folder, columns):
    write, file = FORMATS[name]
    return write(folder / file, Sailed(columns))


def changed(defect):
    columns = logs.eights()
    return logs.CHANGES[defect](columns) or columns


def said(found):
    return [f"{f.kind} {f.channel}: {f.said}" for f in found.findings]


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", FORMATS)
def test_nothing_is_found_in_a_sound_log(name, seed, tmp_path):
    found = inspect(written(name, tmp_path, logs.eights(seed)))
    assert said(found) == []
    assert found.status == 0


DEFECTS = {
    "rows are missing for a minute and a half": "gap",
    "the clock jumps forward": "clock step",
    "the clock is set back": "clock set",
    "rows stand there twice": "duplicate",
    "the rate halves": "rate",
    "fixes are held between those of a slower receiver": "held",
    "three fixes are far off": "outliers",
    "positions are reset on the way": "jump",
    "velocities are in knots": "units",
    "velocities are a third too large": "scale",
    "north and east are exchanged": "axes",
    "velocities count from magnetic north": "rotation",
    "velocities are three seconds late": "delay",
    "heading is a quarter turn off": "heading",
}


# pyulog writes in the order of time, and stamps since boot are not set
NEVER = {("ulog", "the clock is set back")}


@pytest.mark.parametrize(
    ("name", "defect"), [each for each in itertools.product(FORMATS, DEFECTS) if each not in NEVER]
)
def test_a_defect_is_found(name, defect, tmp_path):
    found = inspect(written(name, tmp_path, changed(defect)))
    assert DEFECTS[defect] in {f.kind for f in found.findings}, said(found)


def test_a_doppler_log_whose_axes_are_exchanged_is_told_by_its_channels(tmp_path):
    voyage = Sailed(logs.eights())
    voyage.__dict__["body"] = voyage.body[:, [1, 0, 2]]
    found = inspect(writers.bag(tmp_path / "dive", voyage, without=("/log/twist", "/odom")))
    (axes,) = [f for f in found.findings if f.kind == "axes"]
    assert axes.channel == "/dvl.u and /dvl.v"
    assert "forward is +/dvl.v and starboard +/dvl.u" in axes.said
    assert axes.options == ()  # no column of the reader is one of the sensor's axes


def test_a_wrong_attitude_shows_in_the_velocities_that_it_turned(tmp_path):
    columns = logs.eights()
    voyage, turned = Sailed(columns), Sailed(columns | {"heading": columns["heading"] + 20.0})
    voyage.__dict__["to_enu"] = turned.to_enu
    found = inspect(writers.bag(tmp_path / "dive", voyage, without=("/log/twist", "/odom")))
    (turn,) = [f for f in found.findings if f.kind == "rotation"]
    assert "-20" in turn.said


def test_a_sensor_that_is_silent_while_others_go_on_has_a_gap(tmp_path):
    store, voyage = writers.typestore(), Sailed(logs.eights())
    rest = [m for m in writers.messages(store, voyage)
            if m[0] in ("/gps/fix", "/imu") or (m[0] == "/dvl" and not 100 < m[2] / 1e9 - voyage.start / 1e9 < 200)]  # fmt: skip
    none = Sailed({n: v[:0] for n, v in logs.eights().items()})
    found = inspect(writers.bag(tmp_path / "dive", none, more=rest))
    assert [(f.kind, f.channel) for f in found.findings] == [("gap", "velocity")]
    assert "no row for 100 s" in found.findings[0].said
    (lost,) = [each for each in found.losses if each.sensor == "position"]
    assert lost.rows == logs.ROWS  # its own rows: those of others are none that it lost


def test_of_two_channels_that_could_be_meant_the_first_is_looked_at(tmp_path):
    path = writers.bag(tmp_path / "dive", Sailed(logs.eights()))
    found = inspect(path)
    assert found.status == 2
    assert [(f.kind, f.options) for f in found.findings] == [
        ("columns", ("topics.velocity", "/log/twist"))
    ]
    words = shlex.split(found.next)
    assert words[-2:] == ["topics.velocity", "/log/twist"]
    assert command.main(words[1:]) == 0


def test_what_is_damaged_is_a_finding(tmp_path):
    path = written("nmea", tmp_path, logs.eights())
    content = bytearray(path.read_bytes())
    content[5000:5040] = b"#" * 40
    path.write_bytes(content)
    assert "damage" in {f.kind for f in inspect(path).findings}


def test_dates_that_do_not_agree_are_a_clock_that_was_set(tmp_path):
    path = written("nmea", tmp_path, logs.eights())
    later = Sailed(logs.eights(), writers.START + (600 + 86_400) * 10**9)
    other = writers.nmea(tmp_path / "later.nmea", later)
    path.write_bytes(path.read_bytes() + other.read_bytes())
    found = inspect(path)
    assert [f.kind for f in found.findings] == ["clock set"]


def test_a_log_of_an_imu_alone_is_looked_at_as_one(tmp_path):
    alone = ("/log/twist", "/odom", "/dvl", "/gps/fix")
    found = inspect(writers.bag(tmp_path / "dive", Sailed(logs.eights()), without=alone))
    assert found.status == 2
    assert ("holds", "/imu: imu, 400 rows in 399 s, 1 Hz") in found.told
    words = shlex.split(found.next)
    assert words[:2] + words[-2:] == ["navgym", "inspect", "--format", "ins_log"]
    assert command.main(words[1:]) == 1


def test_a_log_without_an_imu_is_sent_to_the_format_that_needs_none(tmp_path):
    found = inspect(written("nmea", tmp_path, logs.eights()), format_name="ins_log")
    words = shlex.split(found.next)
    assert (found.status, words[:2], len(words)) == (2, ["navgym", "inspect"], 3)
    assert command.main(words[1:]) == 0


@pytest.mark.parametrize("name", FORMATS)
def test_the_next_command_runs_as_it_stands(name, tmp_path, capsys):
    log = written(name, tmp_path, changed("velocities are in knots"))
    assert command.main(["inspect", str(log)]) == 1
    mended = shlex.split(capsys.readouterr().out.splitlines()[-1].removeprefix("next"))
    assert mended[:2] == ["navgym", "inspect"]
    assert command.main(mended[1:]) == 0
    words = shlex.split(capsys.readouterr().out.splitlines()[-1].removeprefix("next"))
    assert words[:2] == ["navgym", "tune"]
    told = words[words.index("--read") + 1 :]
    assert command.main(["read", str(log), "--read", *told]) == 0
    reading = ReaderOptions.parsed(told)
    assert reading.read(log).measurements.shape[1] == 4


@pytest.mark.parametrize("name", FORMATS)
def test_a_mapping_file_says_which_channels_count(name, tmp_path, capsys):
    log, mapping = written(name, tmp_path, logs.eights()), tmp_path / "mapping.toml"
    assert command.main(["read", str(log), "--write-mapping", str(mapping)]) == 0
    assert "topics" in mapping.read_text()
    assert command.main(["inspect", str(log), "--read", str(mapping)]) == 0
    assert "findings   none" in capsys.readouterr().out
