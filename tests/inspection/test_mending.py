"""The next command: what mends is in it once and in all, and it is never the one that was just run."""

import dataclasses
import json
import shlex

import numpy as np
import pytest

from navgym import command
from navgym.ins.csv_set import write_ins_csv
from navgym.inspection.findings import Finding
from navgym.inspection.inspect import inspect
from navgym.inspection.mending import in_all, mended, named
from navgym.inspection.reading import as_finding
from tests.inspection import logs


def _log(name, folder):
    return logs.DEFECTS[name][2](folder)


def _words(command_line):
    words = shlex.split(command_line)
    return words[words.index("--read") + 1 :]


def test_a_delay_on_top_of_one_that_was_told_is_told_in_all(tmp_path):
    log = _log("velocities are three seconds late", tmp_path)
    found = inspect(log, "latency.velocity", "1.0")
    (delay,) = [f for f in found.findings if f.kind == "delay"]
    total = float(dict([delay.options])["latency.velocity"])
    assert total == pytest.approx(3.0, abs=0.6)
    assert _words(found.next) == ["latency.velocity", f"{total:g}"]
    assert "that the reader was told" in delay.said


@pytest.mark.parametrize(
    "name", [n for n in logs.CHANGES if n != "times are ms and nobody says so"]
)
def test_the_next_command_is_not_the_one_that_was_run(name, tmp_path):
    log, words = _log(name, tmp_path), []
    for _ in range(4):
        found = inspect(log, *words)
        assert shlex.split(found.next) != [
            "navgym",
            "inspect",
            str(log),
            *["--read"] * bool(words),
            *words,
        ]
        if not found.next.startswith("navgym inspect"):
            return
        words = _words(found.next)
    pytest.fail(f"{found.next} does not end")


def test_axes_that_the_reader_names_are_in_the_next_command(tmp_path):
    r = logs.ins()
    angle = np.array(r.angle) * [-1.0, 1.0, 1.0]
    turned = dataclasses.replace(r, angle=angle, check_units=False)
    folder = write_ins_csv(turned, tmp_path / "set")
    found = inspect(folder)
    (axes,) = [f for f in found.findings if f.kind == "axes"]
    assert axes.options == ("turn.gyro_x", "-gyro_x")
    assert not axes.said.startswith("axes")
    assert _words(found.next) == ["turn.gyro_x", "-gyro_x"]
    again = inspect(folder, *_words(found.next))
    assert "axes" not in {f.kind for f in again.findings}


def test_a_clock_that_the_reader_names_is_added_to_what_it_was_told():
    said = 'dvl: its measurements fit better if they were made about .5 s earlier: pass time_offsets={"dvl": 0.5} if so'
    assert named(said) == ("time_offsets.dvl", "0.5")
    options = {"time_offsets": {"dvl": 0.25}}
    assert in_all(as_finding(said), options).options == ("time_offsets.dvl", "0.75")


def test_an_axis_that_was_turned_wrongly_is_turned_back():
    found = Finding("axes", "", "", "", ("turn.acc_x", "-acc_x"))
    assert in_all(found, {"turn": {"acc_x": "-acc_y"}}).options == ("turn.acc_x", "acc_y")
    assert in_all(found, {"turn": {"acc_x": "acc_y"}}).options == ("turn.acc_x", "-acc_y")


def test_an_option_that_the_reader_does_not_have_mends_nothing():
    found = Finding("axes", "", "", "", ("turn.acc_x", "-acc_x"))
    assert mended(["a", "1"], [found], {"a": "1"}, ["a"]) == ["a", "1"]


def test_noise_of_a_mapping_file_stays(tmp_path):
    log = logs.written(tmp_path / "log.csv", logs.eights())
    mapping = tmp_path / "mapping.toml"
    mapping.write_text('format = "csv"\nposition_noise = 1.5\n')
    words = _words(inspect(log, str(mapping)).next)
    assert words[0] == str(mapping)
    assert "position_noise" not in words
    assert "velocity_noise" in words


@pytest.mark.parametrize("name", ["velocities are forward and right", "west is called east"])
def test_no_noise_rests_on_velocities_that_are_wrong(name, tmp_path):
    found = inspect(_log(name, tmp_path))
    assert found.model[::2] == ("position_noise",)
    assert float(found.model[1]) == pytest.approx(0.3, rel=0.35)  # made with .3 m


def test_json_keeps_every_line(tmp_path, capsys):
    log = logs.written(tmp_path / "log.csv", logs.eights())
    command.main(["inspect", str(log), "--read", "latency.velocity", "0.1", "--json", "-"])
    told = json.loads(capsys.readouterr().out)["told"]
    assert len([text for name, text in told if name == "reading"]) >= 2
