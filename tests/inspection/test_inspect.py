"""A defect is found by its name, and nothing is found in a sound log."""

import json
import re
import shlex
import subprocess
import sys

import numpy as np
import pytest

import navgym
from navgym import command
from navgym.auv.csv_log import write_csv
from navgym.core.data import absent, data_folder
from navgym.deck.csv_log import write_deck_csv
from navgym.ins.csv_set import write_ins_csv
from navgym.inspection.findings import KINDS, SEVERITIES, Finding
from navgym.inspection.inspect import inspect
from navgym.inspection.noise import allan, densities
from navgym.inspection.timing import losses
from tests.commands import EXTRAS, without
from tests.inspection import logs

LEVER = ("lever_arm", "10,10,2")


@pytest.mark.parametrize("name", logs.DEFECTS)
def test_a_defect_is_found(name, tmp_path):
    kind, channel, make = logs.DEFECTS[name]
    log = make(tmp_path)
    found = inspect(log, *(LEVER if log.name == "deck.csv" else ()))
    mine = [f for f in found.findings if f.kind == kind]
    assert mine, [f"{f.kind} {f.channel}: {f.said}" for f in found.findings]
    assert any(channel in f.channel for f in mine)
    assert found.status == (2 if KINDS[kind][0] == "error" else 1)


def test_defects_are_of_many_kinds():
    assert len({kind for kind, _, _ in logs.DEFECTS.values()}) >= 20


SIMULATED = [n for n in navgym.scenarios() if n.startswith("auv/")]
BRIEF = ["deck/paper", "deck/slam", "deck/glitch"]
SLOW = {"deck/slam", *SIMULATED} - {"auv/nominal", "auv/heavy", "auv/burst", "auv/coordinated-turn"}


def _some(names, slow):
    """Parameters of a test, of which those in `slow` are for the slow suite."""
    return [pytest.param(n, marks=pytest.mark.slow) if n in slow else n for n in names]


def _sound(name, folder):
    """The log of that name."""
    if name.startswith("auv/"):
        return write_csv(
            navgym.simulate(name, seed=1),
            folder / "log.csv",
        )
    if name.startswith("deck/"):
        return write_deck_csv(navgym.simulate(name, seed=1, duration=40.0), folder / "deck.csv")
    if name.startswith("ins"):
        return write_ins_csv(logs.ins(seed=2), folder / "set")
    columns = logs.eights(seed=int(name[-1]))
    rng = np.random.default_rng(5)
    if "lossy" in name:
        for n in ("px", "py"):
            columns[n][rng.random(logs.ROWS) < 0.5] = np.nan
    if "rows" in name:
        keep = rng.random(logs.ROWS) < 0.7
        columns = {n: v[keep] for n, v in columns.items()}
    if "accurate" in name:
        columns["sigma_position"] = np.full(logs.ROWS, 0.3)
    return logs.written(folder / "log.csv", columns)


SOUND = [*SIMULATED, *BRIEF, "ins", "eights 1", "lossy 2", "rows 3", "accurate 4"]


@pytest.mark.parametrize("name", _some(SOUND, SLOW))
def test_nothing_is_found_in_a_sound_log(name, tmp_path):
    beacon = name == "auv/coordinated-turn"
    if beacon:  # a text file would need its model
        log = navgym.simulate(name, seed=1).save(tmp_path / "log.npz")
    else:
        log = _sound(name, tmp_path)
    found = inspect(log, *(LEVER if name.startswith("deck/") else ()))
    assert [f"{f.kind} {f.channel}: {f.said}" for f in found.findings] == []
    assert found.status == 0


@pytest.mark.skipif(data_folder("akit") is None, reason=absent("akit"))
@pytest.mark.parametrize("track", range(1, 7))
def test_nothing_is_found_in_the_tracks_of_a_real_vehicle(track):
    found = inspect(data_folder("akit"), "track", str(track), format_name="akit")
    assert [f"{f.kind} {f.channel}: {f.said}" for f in found.findings] == []


# ---- the command


def test_the_page_of_docs_has_every_kind():
    page = (logs.ROOT / "docs" / "inspect.md").read_text("utf-8")
    for kind, (severity, meaning) in KINDS.items():
        assert f"| {kind} | {severity} | {meaning} |" in page
        assert severity in SEVERITIES


def test_the_examples_of_docs_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = (logs.ROOT / "docs" / "inspect.md").read_text("utf-8")
    names = {}
    for example in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(compile(example, "inspect.md", "exec"), names)
    assert "navgym tune" in capsys.readouterr().out
    assert {p.name for p in tmp_path.iterdir()} >= {"estimate.png", "estimate.csv", "estimate.gpx"}


def test_a_finding_of_no_known_kind_is_refused():
    with pytest.raises(ValueError, match="kind of finding"):
        Finding("frozzen", "px", "")


def _defect(name, folder):
    return logs.DEFECTS[name][2](folder)


def test_the_next_command_mends_what_an_option_can_mend(tmp_path, capsys):
    log = _defect("velocities are in knots", tmp_path)
    assert command.main(["inspect", str(log)]) == 1
    following = shlex.split(capsys.readouterr().out.splitlines()[-1])[1:]
    assert following[:2] == ["navgym", "inspect"]
    assert command.main(following[1:]) == 0  # and then nothing is left
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("next       navgym tune --filter kf")


@pytest.mark.parametrize(
    "name",
    [
        "north and east are exchanged",
        "velocities are three seconds late",
        "heading is in radians",
    ],
)
def test_so_it_is_with_others(name, tmp_path):
    log = _defect(name, tmp_path)
    found = inspect(log)
    words = shlex.split(found.next)
    again = inspect(log, *words[words.index("--read") + 1 :])
    assert {f.kind for f in again.findings} <= {"order"}


def test_what_differences_suggest_is_the_noise_that_was_there(tmp_path):
    found = inspect(logs.written(tmp_path / "log.csv", logs.eights()))
    told = dict(zip(found.model[::2], map(float, found.model[1::2]), strict=True))
    assert told["position_noise"] == pytest.approx(0.3, rel=0.25)  # made with .3 m
    assert told["velocity_noise"] < 0.15  # made with .05 m/s, and turning
    assert f"position_noise {told['position_noise']:g}" in found.next


def test_allan_deviation_of_white_noise_falls_with_the_root_of_the_time():
    x = np.random.default_rng(1).normal(0.0, 2.0, 40_000)
    tau, deviation = allan(x, 0.1)
    np.testing.assert_allclose(deviation[:10], 2.0 * np.sqrt(0.1 / tau[:10]), rtol=0.05)
    assert densities(x, 0.1)[0] == pytest.approx(2.0 * np.sqrt(0.1), rel=0.03)


def test_losses_in_bursts_are_told_from_independent_ones():
    rng = np.random.default_rng(1)
    alone = losses("position", rng.random(2000) < 0.3)
    burst = losses("position", (rng.random(200) < 0.3).repeat(10))
    assert (alone.bursts, burst.bursts) == (False, True)
    assert burst.longest % 10 == 0
    assert alone.mean == pytest.approx(1.0 / 0.7, rel=0.1)


@pytest.mark.parametrize("more", [0.0, 0.2])
def test_losses_that_keep_a_pace_are_neither(more):
    rng, row = np.random.default_rng(1), np.arange(2000)
    slow = losses("position", (row % 5 != 0) | (rng.random(2000) < more))
    assert (slow.every, slow.bursts) == (5.0, False)
    assert "regularly: one in 5 rows is received" in slow.words
    silenced = losses("velocity", row % 7 == 0)
    assert (silenced.every, silenced.bursts) == (-7.0, False)
    assert "one in 7 rows is lost" in silenced.words


def test_a_pace_need_be_no_whole_number_of_rows():
    heard = np.isin(np.arange(2000), np.arange(0.0, 2000.0, 3.4).astype(int))
    assert losses("position", ~heard).every == pytest.approx(3.4, rel=0.01)


@pytest.mark.parametrize("share", [0.02, 0.2, 0.5, 0.9])
def test_independent_losses_and_bursts_keep_no_pace(share):
    rng = np.random.default_rng(2)
    for rows in (40, 100, 1000):
        for _ in range(100):
            assert losses("position", rng.random(rows) < share).every == 0.0
            lengths = rng.geometric([share, 1.0 - share], (rows, 2)).ravel()
            burst = np.repeat(np.arange(len(lengths)) % 2 == 0, 3 * lengths)[:rows]
            assert losses("position", burst).every == 0.0


def test_the_sample_log_s_held_fixes_are_regular_losses():
    found = inspect(navgym.sample_log())
    (position,) = [each for each in found.losses if each.sensor == "position"]
    assert position.every == 5.0


def test_json_holds_all_of_it(tmp_path, capsys):
    log = _defect("three fixes are far off", tmp_path)
    assert command.main(["inspect", str(log), "--json", "-"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["status"], told["format"], told["findings"][0]["kind"]) == (1, "csv", "outliers")
    assert [c["name"] for c in told["channels"]] == ["px", "vx", "py", "vy", "heading"]
    assert command.main(["inspect", str(log), "--json", str(tmp_path / "found.json")]) == 1
    assert json.loads((tmp_path / "found.json").read_text()) == told


def test_a_log_that_cannot_be_read_is_status_2_and_told(tmp_path, capsys):
    log = _defect("nothing_says_what_columns_hold", tmp_path)
    assert command.main(["inspect", str(log)]) == 2
    out = capsys.readouterr().out
    assert "no measurement column" in out
    assert "--write-mapping mapping.toml" in out


def test_no_file_and_an_unknown_option_are_errors(tmp_path, capsys):
    assert command.main(["inspect", str(tmp_path / "absent.csv")]) == 2
    log = logs.written(tmp_path / "log.csv", logs.eights())
    assert command.main(["inspect", str(log), "--read", "positionnoise", "2"]) == 2
    assert "position_noise" in capsys.readouterr().err


def test_terminal_and_json_need_no_extra(tmp_path):
    log = logs.written(tmp_path / "log.csv", logs.eights())
    page = tmp_path / "page.html"
    source = without(EXTRAS) + (
        f"code = main(['inspect', {str(log)!r}, '--json', '-'])\n"
        f"raise SystemExit([code, main(['inspect', {str(log)!r}, '--page', {str(page)!r}])] != [0, 2])"
    )
    done = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "pip install 'navgym[tuning]'" in done.stderr
    assert not page.exists()
