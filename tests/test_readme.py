"""The README's examples run as they are written; every command of the docs is one."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import navgym
from navgym.auv.csv_log import write_csv
from navgym.command import COMMANDS
from tests.commands import ended, started

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
EXAMPLES = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
# pages that users read; those on how navgym came about may quote anything
GUIDES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SHELL = re.compile(r"```sh\n(.*?)```", re.DOTALL)
QUOTED = re.compile(r"`(navgym [a-z][^`]*)`")


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.strip().splitlines()[-1][:40])
def test_an_example_runs(example, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    log = navgym.simulate("auv/heavy", seed=0, steps=60)
    write_csv(navgym.Recording(log.time, log.measurements, log.lost, model=log.model), "my_log.csv")
    exec(compile(example, "README.md", "exec"), {})
    assert capsys.readouterr().out


def commands(page):
    """Every `navgym ...` of a page, as words: in its blocks of shell and in its sentences."""
    text = page.read_text()
    lines = [line for block in SHELL.findall(text) for line in block.splitlines()]
    lines += QUOTED.findall(text)
    for line in lines:
        words = shlex.split(line, comments=True)
        if words[:1] == ["navgym"]:
            yield words[1 : words.index("<") if "<" in words else None]


@pytest.fixture(scope="module")
def options():
    """What each command's --help names, by command."""
    call = [sys.executable, "-m", "navgym.command"]
    processes = {name: started([*call, name, "--help"]) for name in COMMANDS}
    program = ended(started([*call, "tune", "--program", "--help"]))[1]
    own = {"tune": set(re.findall(r"--[a-z][\w.-]*", program))}  # of a program in a filter's place
    return {
        name: own.get(name, set())
        | {"--help", "--config"}
        | set(re.findall(r"--[a-z][\w.-]*", ended(process)[1]))
        for name, process in processes.items()
    }


@pytest.mark.parametrize("page", GUIDES, ids=lambda p: p.name)
def test_every_command_of_a_page_is_one_with_such_options(page, options):
    for name, *words in commands(page):
        assert name in COMMANDS, f"{page.name}: navgym {name}"
        unknown = {w.partition("=")[0] for w in words if w.startswith("--")} - options[name]
        assert not unknown, f"{page.name}: navgym {name} {' '.join(words)}"


def test_commands_are_found_and_no_script_is_told_of_in_their_place():
    assert len([each for page in GUIDES for each in commands(page)]) > 25
    own = {p.stem for p in (ROOT / "scripts").glob("*.py") if "navgym.command" in p.read_text()}
    for page in GUIDES:
        told = set(re.findall(r"scripts/(\w+)\.py", page.read_text()))
        assert not told & own, page.name


def test_the_shell_s_example_makes_a_log(tmp_path):
    (line,) = re.findall(r"^python -c '(.*)'$", README, re.MULTILINE)
    subprocess.run([sys.executable, "-c", line], cwd=tmp_path, check=True)
    assert len(navgym.read("csv", tmp_path / "my_log.csv").time) > 100


def test_every_file_that_the_readme_points_to_exists():
    links = re.findall(r"\]\((?!http)([^)#]+)\)", README)
    assert links
    assert not [link for link in links if not (ROOT / link).exists()]


def test_the_recommended_filter_beats_the_others_where_the_noise_changes():
    recordings = [navgym.simulate("auv/switch-D", seed=s) for s in navgym.seeds("test", 20)]

    def error(name, parameters=None):
        runs = [navgym.estimate(name, r, parameters).states - r.truth for r in recordings]
        return np.mean([np.sqrt((e[:, [0, 2]] ** 2).sum(axis=1).mean()) for e in runs])

    best_fixed = navgym.simulation.find_scenario("auv/switch-D").reference
    assert error("bank") < 0.8 * error("qivbf", dict(best_fixed)) < error("kf")
