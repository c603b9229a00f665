"""A defect is found by its name, and nothing is found in a sound log."""

import numpy as np
import pytest

import navgym
from navgym.auv.csv_log import write_csv
from navgym.core.data import absent, data_folder
from navgym.deck.csv_log import write_deck_csv
from navgym.ins.csv_set import write_ins_csv
from navgym.inspection.findings import KINDS
from navgym.inspection.inspect import inspect
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
BRIEF = ["deck/paper", "deck/slam", "deck/glitch", "deck/lever"]


def _sound(name, folder):
    """The log of that name."""
    if name.startswith("auv/"):
        return write_csv(
            navgym.simulate(name, seed=1),
            folder / "log.csv",
        )
    if name.startswith("deck/"):
        return write_deck_csv(navgym.simulate(name, seed=1, duration=60.0), folder / "deck.csv")
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


@pytest.mark.parametrize("name", SOUND)
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
