"""The page on own logs: its examples run, and its table names every option that decides something."""

import inspect
import re
from pathlib import Path

from navgym.auv.csv_log import read_csv

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "own-logs.md").read_text("utf-8")
NOISES = {"model", "position_noise", "velocity_noise", "acceleration"}  # what filters believe


def test_its_examples_run_one_after_the_other(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    for example in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(compile(example, "own-logs.md", "exec"), names)
    said = capsys.readouterr().out
    assert "59.3000" in said
    assert "R of px, py is the receiver's own, row by row" in said


def test_it_tells_of_every_option_and_of_no_other():
    options = set(list(inspect.signature(read_csv).parameters)[1:])
    told = set(re.findall(r"`([a-z_]+)=", PAGE)) | set(re.findall(r"\b([a-z_]+)=[({\"]", PAGE))
    told |= set(re.findall(r"`(latency|lever_arm|largest)`", PAGE))
    assert options - NOISES <= told
    assert {name for name in told if name not in options} == set()
