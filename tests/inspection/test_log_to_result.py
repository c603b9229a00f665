"""The page from a log to a result: its commands and examples run, on logs of the same formats and names."""

import re
import shlex
import shutil

import pytest

from navgym import command
from tests.formats import writers
from tests.formats.writers import Sailed
from tests.inspection import logs

PAGE = (logs.ROOT / "docs" / "log-to-result.md").read_text("utf-8")
SECTIONS = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL))
TOPICS = {"/gps/fix": "/fix", "/imu": "/imu/data", "/odom": "/husky_velocity_controller/odom"}
QUICK = ["--trials", "6", "--workers", "1"]  # of a study; the page's own number in the slow suite


def husky(path):
    """A bag with the topics of the page's."""
    voyage, store = Sailed(logs.eights()), writers.typestore(ros1=True)
    named = [
        (TOPICS[topic], kind, stamp, message)
        for topic, kind, stamp, message in writers.messages(store, voyage, ros1=True)
        if topic in TOPICS
    ]
    none = Sailed({n: v[:0] for n, v in logs.eights().items()})
    return writers.bag(path, none, "ros1", more=named)


LOGS = {
    "A ROS 1 bag": ("test1.bag", husky),
    "An ArduPilot log": ("log171.bin", lambda path: writers.dataflash(path, Sailed(logs.eights()))),
    "A telemetry log": ("vtol.tlog", lambda path: writers.tlog(path, Sailed(logs.eights()))),
}


def steps(section):
    """Commands, as words, and examples, in the order of the page."""
    for kind, text in re.findall(r"```(sh|python)\n(.*?)```", section, re.DOTALL):
        if kind == "python":
            yield text
        else:
            yield from (shlex.split(line)[1:] for line in text.splitlines())


def test_the_page_has_a_section_for_each_log():
    assert SECTIONS.keys() == LOGS.keys()


def walk(section, folder, monkeypatch, more=()):
    """Every step of a section, in a folder with its log."""
    monkeypatch.chdir(folder)
    file, write = LOGS[section]
    write(folder / file)
    names = {}
    for step in steps(SECTIONS[section]):
        if isinstance(step, str):
            exec(compile(step, "log-to-result.md", "exec"), names)
        else:
            told = [*step, *more] if step[0] == "tune" else step
            assert command.main(told) in ((0, 1) if step[0] == "inspect" else (0,)), step


def made(folder):
    return {p.suffix for p in folder.iterdir() if p.is_file()}


def test_the_way_of_a_bag_runs(tmp_path, monkeypatch, capsys):
    walk("A ROS 1 bag", tmp_path, monkeypatch, QUICK)
    assert made(tmp_path) >= {".png", ".csv", ".gpx", ".geojson"}
    said = capsys.readouterr().out
    assert "next       navgym tune --filter kf --log test1.bag" in said
    assert "<Estimate: 400 steps" in said


@pytest.mark.slow
@pytest.mark.parametrize("section", LOGS)
def test_every_way_runs_as_it_stands(section, tmp_path, monkeypatch):
    walk(section, tmp_path, monkeypatch)
    assert made(tmp_path) >= {".png"}
    assert (tmp_path / "runs").is_dir()
    shutil.rmtree(tmp_path / "runs")
