"""The README's examples run as they are written."""

import re
from pathlib import Path

import numpy as np
import pytest

import navgym
from navgym.auv.csv_log import write_csv

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
EXAMPLES = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.strip().splitlines()[-1][:40])
def test_an_example_runs(example, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    log = navgym.simulate("auv/heavy", seed=0, steps=60)
    write_csv(navgym.Recording(log.time, log.measurements, log.lost, model=log.model), "my_log.csv")
    exec(compile(example, "README.md", "exec"), {})
    assert capsys.readouterr().out


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
