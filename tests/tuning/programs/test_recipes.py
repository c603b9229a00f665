"""The recipes of docs/your-filter.md, each from an empty folder to a file that the target reads."""

import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from navgym.tuning.export.command import main as export

PAGE = Path(__file__).resolve().parents[3] / "docs" / "your-filter.md"
NAMED = re.compile(r"(?:/\* |# )([\w.]+\.(?:c|py|toml))")
NOISES = {"walk_noise": 0.5, "meter_noise": 2.0}


def section(title):
    return PAGE.read_text("utf-8").split(f"\n## {title}\n")[1].split("\n## ")[0]


def blocks(text):
    return re.findall(r"```(\w+)\n(.*?)```", text, re.DOTALL)


def prepared(folder):
    """Every file that the page holds, by the name in its first line."""
    for kind, body in blocks(PAGE.read_text("utf-8")):
        named = NAMED.match(body)
        if kind == "json":
            (folder / "present.json").write_text(body)
        elif named:
            (folder / named[1]).write_text(body)


def follow(title, folder):
    """Give the commands of a recipe, one after the other."""
    prepared(folder)
    for kind, body in blocks(section(title)):
        for line in body.strip().splitlines() if kind == "sh" else ():
            words = shlex.split(line)
            start = {"python": [sys.executable], "navgym": [sys.executable, "-m", "navgym.command"]}
            command = start.get(words[0], [words[0]]) + words[1:]
            command = [sys.executable + w[6:] if w.startswith("python ") else w for w in command]
            done = subprocess.run(command, cwd=folder, text=True, capture_output=True, check=False)
            assert done.returncode == 0, f"{line}\n{done.stderr[-2000:]}"


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_a_program_in_c(tmp_path):
    follow("A program in C", tmp_path)
    (tmp_path / "show.c").write_text(
        '#include <stdio.h>\n#include "walk_noises.h"\n'
        'int main(void) { printf("%.17g %.17g", walk_noise, meter_noise); return 0; }\n'
    )
    subprocess.run(["cc", "-Wall", "-Werror", "-o", "show", "show.c"], cwd=tmp_path, check=True)
    shown = subprocess.run(
        [str(tmp_path / "show")], capture_output=True, text=True, check=True
    ).stdout
    found = tomllib.loads((tmp_path / "runs/walk/tuned.toml").read_text())
    assert [float(w) for w in shown.split()] == [found["parameters"][n] for n in NOISES]
    for name, true in NOISES.items():
        assert found["intervals"][name][0] < true < found["intervals"][name][1]


@pytest.mark.slow
def test_a_script_in_python(tmp_path):
    follow("A script in Python", tmp_path)
    found = json.loads((tmp_path / "tuned.json").read_text())["filter"]
    assert found["name"] == "by hand"
    assert 0.1 < found["gain"] < 0.5  # of the walk and the meter above: .22


@pytest.mark.slow
def test_an_ekf_of_filterpy(tmp_path):
    pytest.importorskip("filterpy")
    yaml = pytest.importorskip("yaml")
    follow("An EKF of filterpy", tmp_path)
    found = yaml.safe_load((tmp_path / "noises.yaml").read_text())
    for name, true in NOISES.items():
        assert found[name] == pytest.approx(true, rel=0.5)


def test_the_commands_that_take_it_home(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    zeros = ", ".join(["0.0"] * 225)
    Path("ekf.yaml").write_text(
        f"a:\n  ros__parameters:\n    process_noise_covariance: [{zeros}]\n"
    )
    Path("fuse.yaml").write_text("")
    Path("old.params").write_text("1\t1\tEKF2_ACC_NOISE\t0.3\t9\n")
    for kind, body in blocks(section("Take it home")):
        for line in body.strip().splitlines() if kind == "sh" else ():
            autopilot = " px4 " in line or " ardupilot " in line
            name = "EKF2_ACC_NOISE" if autopilot else "accel_noise"
            Path("tuned.toml").write_text(f'filter = "mine"\n[parameters]\n{name} = 0.5\n')
            words = shlex.split(line)
            assert words[:2] == ["navgym", "export"]
            assert export(words[2:]) == 0
    assert "0.5" in Path("gains.h").read_text()


def test_the_contract_on_the_page_is_one(tmp_path):
    from navgym.tuning.programs.contract import Contract

    body = next(body for kind, body in blocks(section("The contract")) if kind == "toml")
    (tmp_path / "all.toml").write_text(body)
    found = Contract.load(tmp_path / "all.toml")
    assert found.targets == {"accel_noise": "EKF2_ACC_NOISE"}
    assert found.columns.innovation == ("nu_x", "nu_y")
