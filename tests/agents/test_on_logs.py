"""Agents judged on logs, and what a recording's own fixes choose afterwards."""

import json

import numpy as np
import pytest

pytest.importorskip("optuna")
pytest.importorskip("tyro")

import navgym
from navgym.agents import Mixture
from navgym.agents.evaluation.on_logs import contest, failures, gain, table
from navgym.agents.mixture.experts import Expert
from navgym.agents.mixture.retune import chosen, retuned, settings_around
from navgym.agents.policies.loading import load_agent
from navgym.agents.policies.policy import shipped
from navgym.agents.training.logs import Logs
from navgym.command import main as command
from navgym.tuned import read_tuned
from navgym.tuning.cases import Cases
from tests.agents.mixtures import TUNED, mixture, recording, saved


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return saved(tmp_path_factory.mktemp("logs"))


def fought(agents, logs, **options):
    return contest(agents, Logs(logs), 1, {}, **options)


# ---- the ladder


def test_agents_stand_beside_their_own_parameters_and_filters_that_need_none(logs):
    found = fought({"mix": mixture(), "auv": shipped("auv")}, logs)
    labels = [s.label for s in found.scores]
    assert {"kf", "qivbf", "imm", "bank", "mix", "mix, tuned", "auv", "auv, tuned", "auv + fallback"} <= {*labels}  # fmt: skip
    assert found.base == {"mix": "mix, tuned", "auv": "auv, tuned"}
    assert found.logs == ("log0.npz", "log1.npz", "log2.npz")


def test_errors_are_those_of_the_filters_on_each_log(logs):
    score = fought({"mix": mixture()}, logs).find("mix, tuned", "as recorded")
    for i in range(3):
        log = recording(i)
        off = navgym.estimate("qivbf", log, dict(TUNED.parameters)).states - log.truth
        assert score.truth[i] == pytest.approx(np.sqrt((off[:, [0, 2]] ** 2).sum(axis=1).mean()))


def test_an_agent_that_is_its_parameters_gains_nothing_and_is_told_of(logs):
    alone = Mixture.single(TUNED, {})
    found = fought({"alone": alone}, logs)
    assert failures(found) == ["alone is not better than its tuned parameters: as recorded +0.0 %"]
    assert "+0.0 %" in table(found)


def test_without_truth_the_fixes_count(tmp_path):
    found = fought({"mix": mixture()}, saved(tmp_path, truth=False))
    score = found.find("mix", "as recorded")
    assert score.truth is None
    assert np.array_equal(score.counts, score.fixes)
    assert "position" not in table(found)


def test_a_gain_has_an_interval_over_logs_where_there_are_enough():
    few, many = gain(np.full(4, 0.9), np.ones(4)), gain(np.full(6, 0.9), np.ones(6))
    assert few.mean == pytest.approx(0.1)
    assert np.isnan(few.low)
    assert many.low == pytest.approx(0.1)


def test_one_that_diverges_has_no_gain():
    assert gain(np.array([1.0, np.inf]), np.ones(2)).mean == -np.inf


def test_an_agent_of_another_problem_is_refused(logs):
    with pytest.raises(
        ValueError, match=r"deck is for the Deck, and log0\.npz is a log of the AUV"
    ):
        fought({"deck": shipped("deck")}, logs)


def test_the_command_says_who_is_not_better_and_exits_with_1(logs, tmp_path, capsys):
    mixture().save(tmp_path / "mix")
    Mixture.single(TUNED, {}).save(tmp_path / "alone")
    words = ["evaluate", *(str(tmp_path / n) for n in ("mix", "alone")), "--log", *map(str, logs)]
    assert command([*words, "--out", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert "alone is not better than its tuned parameters" in said.err
    results = json.loads((tmp_path / "results.json").read_text())
    assert len(next(r for r in results["rows"] if r["label"] == "mix")["fixes"]) == 3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--read", "position_noise", "2"], "are for logs"),
        (["--log", "nowhere.csv"], "no log at nowhere.csv"),
    ],
)
def test_the_command_refuses_what_cannot_be(words, message, tmp_path, capsys):
    assert command(["evaluate", "auv", *words, "--out", str(tmp_path)]) == 2
    assert message in capsys.readouterr().err


def test_a_file_is_loaded_as_what_it_holds(tmp_path):
    mixture().save(tmp_path / "mix")
    shipped("auv").save(tmp_path / "policy")
    assert isinstance(load_agent(tmp_path / "mix.npz"), Mixture)
    assert load_agent(tmp_path / "policy").manifest.filter == "qivbf"
    with pytest.raises(FileNotFoundError):
        load_agent(tmp_path / "nothing")


def test_a_mixture_filters_a_stream(tmp_path, monkeypatch, capsys):
    import io
    import sys

    mixture().save(tmp_path / "mix")
    log = recording(loss=0.0, steps=30)
    lines = ["time,px,vx,py,vy", *(",".join(map(str, [t, *y])) for t, y in zip(log.time, log.measurements, strict=True))]  # fmt: skip
    raw = io.TextIOWrapper(io.BytesIO("\n".join(lines).encode()))
    monkeypatch.setattr(sys, "stdin", raw)
    assert command(["stream", str(tmp_path / "mix")]) == 0
    out = capsys.readouterr().out.splitlines()
    assert len(out) == 31
    assert float(out[-1].split(",")[1]) == pytest.approx(log.truth[-1, 0], abs=5.0)


# ---- retuning


def test_the_table_holds_the_tuned_setting_variations_of_it_and_the_bank():
    table = settings_around(TUNED, spread=0)
    assert table[0] == TUNED
    assert len(table) == 25
    assert table[-1].filter == "bank"
    assert max(e.parameters["prior_count"] for e in table[:-1]) <= 3.0 * 3.0
    assert min(e.parameters["process_noise_scale"] for e in table[:-1]) >= 0.5 * 2.0


def test_the_fixes_of_each_recording_choose():
    assert chosen(np.array([[1.0, 3.0], [2.0, np.inf], [0.5, 4.0]])).tolist() == [2, 0]
    assert chosen(np.full((3, 1), np.inf)).tolist() == [0]


def test_what_is_chosen_never_foretells_worse_than_what_it_began_with():
    found = retuned(Cases.of([recording(i) for i in range(3)]), settings_around(TUNED, 7))
    assert found.gain >= 0.0
    assert (found.fixes[found.which, range(3)] == found.fixes.min(axis=0)).all()


def test_nothing_of_the_truth_chooses():
    seeing, blind = (
        retuned(Cases.of([recording(truth=truth)]), settings_around(TUNED, 7)) for truth in (True, False)
    )  # fmt: skip
    assert seeing.which == blind.which
    assert blind.true_gain is None


def test_the_command_writes_what_was_chosen(logs, tmp_path, capsys):
    (tmp_path / "tuned.toml").write_text(
        'filter = "qivbf"\n[parameters]\nprocess_noise_scale = 2.0\n'
    )
    words = [
        "retune",
        str(logs[0]),
        "--start",
        str(tmp_path / "tuned.toml"),
        "--out",
        str(tmp_path / "out"),
    ]
    assert command(words) == 0
    assert "one-step error of the fixes +" in capsys.readouterr().out
    found = read_tuned(tmp_path / "out" / "log0.toml")
    navgym.estimate(found.filter, recording(), tmp_path / "out" / "log0.toml")


def test_a_log_without_fixes_cannot_choose(tmp_path, capsys):
    deck = navgym.simulate("deck/switch-60", seed=0, duration=20.0).save(tmp_path / "deck.npz")
    assert command(["retune", str(deck), "--out", str(tmp_path)]) == 2
    assert "holds no position fixes to choose by" in capsys.readouterr().err


def test_an_expert_of_a_tuned_file_must_be_able_to_run_live():
    with pytest.raises(ValueError, match="an expert must be"):
        Expert("ukf")
