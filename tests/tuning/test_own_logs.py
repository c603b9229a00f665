"""Logs of one's own are tuned on as they are read: with the reader's options, with models of their own."""

import dataclasses

import numpy as np
import pytest

import navgym
from navgym import command
from navgym.tuning.settings import StudySettings
from navgym.tuning.smoothed import judged_by_smoother
from navgym.tuning.stages import stages
from tests.commands import run

LOG = "time;north (m);vx\n" + "".join(f"{k};{k};1\n" for k in range(40))
READ = ("delimiter", ";", "columns.px", "north (m)", "position_noise", "5")


@pytest.fixture
def log(tmp_path):
    """A log whose reader has to be told something."""
    path = tmp_path / "mine.csv"
    path.write_text(LOG)
    return path


@pytest.fixture
def mine(tmp_path):
    """A saved recording of one state, with a model of its own."""
    rng = np.random.default_rng(0)
    model = navgym.LinearModel(F=[[1.0]], Q=[[1.0]], R=[[0.1]])
    y = rng.normal(size=(200, 1)).cumsum(0)
    return navgym.Recording(np.arange(200) / 10, y, model=model).save(tmp_path / "mine.npz")


def test_what_the_reader_is_told_reaches_the_recordings(log):
    found = stages(StudySettings(filter="kf", log=(log,), read=READ))
    for stage in (found.train, found.select, found.report):
        (recording,) = stage["logs"].recordings
        assert recording.model.R[0, 0] == 25.0
        assert stage["logs"].about["read"] == list(READ)


def test_a_mapping_file_that_changed_is_another_study(log, tmp_path):
    mapping = tmp_path / "m.toml"
    about = []
    for noise in (5, 6):
        mapping.write_text(f'position_noise = {noise}\n[column."north (m)"]\nquantity = "px"\n')
        found = stages(StudySettings(filter="kf", log=(log,), read=(str(mapping),)))
        assert found.train["logs"].recordings[0].model.R[0, 0] == noise**2
        about.append(found.train["logs"].about)
    assert about[0] != about[1]


def test_a_log_is_read_once_for_three_stages(log):
    found = stages(StudySettings(filter="kf", log=(log,), read=READ))
    recordings = [s["logs"].recordings[0] for s in (found.train, found.select, found.report)]
    assert recordings[0] is recordings[1] is recordings[2]


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"read": ("position_nois", "5")}, "Did you mean 'position_noise'"),
        ({"read": ("position_noise", "five")}, "position_noise must be a number, got 'five'"),
        ({"read": ("position_noise",)}, "'position_noise' stands alone"),
        ({"read": READ, "format": "npz"}, "format 'npz' takes no options"),
        ({"read": READ, "log": ()}, "--read is for the reader of --log"),
    ],
)
def test_words_that_no_reader_knows_are_refused_at_once(log, asked, message):
    with pytest.raises(ValueError, match=message):
        StudySettings(**{"filter": "kf", "log": (log,), **asked})


def test_logs_of_two_problems_are_refused(mine, tmp_path):
    deck = navgym.simulate("deck/paper", seed=1, duration=4.0).save(tmp_path / "deck.npz")
    with pytest.raises(ValueError, match=r"mine.npz and .*deck.npz are logs of different problems"):
        StudySettings(filter="kf", log=(mine,), report_log=(deck,))
    assert StudySettings(filter="alignment_mcc", log=(deck,)).problem.name == "deck"


def test_a_model_of_ones_own_is_kept(mine):
    (recording,) = stages(StudySettings(filter="kf", log=(mine,))).train["logs"].recordings
    assert recording.model.F.tolist() == [[1.0]]
    assert recording.model.R.tolist() == [[0.1]]


def test_a_recording_with_a_model_of_its_own_is_tuned_to_the_end(mine, tmp_path):
    code, out, err = run(
        "tune", "--filter", "kf", "--log", mine, "--out", tmp_path / "out", "--workers", "1",
        "--trials", "6",
    )  # fmt: skip
    assert code == 0, err
    assert (tmp_path / "out" / "tuned.toml").exists()
    assert "process_noise_scale" in (tmp_path / "out" / "tuned.toml").read_text()
    assert out


@pytest.mark.parametrize(
    ("name", "scenario"), [("ins_kf", "ins/nominal"), ("alignment", "deck/paper")]
)
def test_what_inspect_names_next_is_a_study_that_ends(name, scenario, tmp_path):
    log = navgym.simulate(scenario, seed=1, duration=200.0).save(tmp_path / "log.npz")
    found = navgym.inspect(log)
    assert found.next == f"navgym tune --filter {name} --log {log}"
    few = ("--trials", "2", "--sampler", "random", "--out", str(tmp_path / "run"))
    status, _, err = run(*found.next.split()[1:], *few)
    assert status == 0, err
    assert (tmp_path / "run" / "tuned.toml").is_file()


# ---- judged against a smoother


def test_a_smoothed_track_stands_for_the_truth_and_all_that_is_said_says_so(mine, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["--filter", "kf", "--log", str(mine), "--truth", "smoother", "--out", str(out)]
    assert command.main(["tune", *words, "--workers", "1", "--trials", "6"]) == 0
    said = capsys.readouterr().out
    assert "The truth is no truth" in said
    assert "which favours kf" in said
    assert "The truth is no truth" in (out / "report.html").read_text("utf-8")
    asked = StudySettings(filter="kf", log=(mine,), truth="smoother")
    (recording,) = stages(asked).train["logs"].recordings
    smoothed = navgym.smooth("kf", navgym.Recording.load(mine))
    np.testing.assert_array_equal(recording.truth, smoothed.states)
    assert recording.meta["truth"] == "kf smoothed (smoother), not measured"


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"truth": "smother"}, "truth must be 'smoother' or a tuned.toml .*, got 'smother'"),
        ({"truth": "smoother", "log": ()}, "--truth is for --log"),
    ],
)
def test_another_truth_is_refused_at_once(mine, asked, message):
    with pytest.raises(ValueError, match=message):
        StudySettings(**{"filter": "kf", "log": (mine,), **asked})


def test_no_smoother_stands_for_a_truth_that_is_known_or_for_what_cannot_be_smoothed(tmp_path):
    known = navgym.simulate("auv/nominal", seed=1, steps=40)
    deck = navgym.simulate("deck/paper", seed=1, duration=4.0)
    deck = dataclasses.replace(deck, theta=None, theta_rate=None, true_flexure=None)
    turning = navgym.simulate("auv/coordinated-turn", seed=1, steps=40)
    turning = dataclasses.replace(turning, truth=None)
    for recording, message in (
        (known, "whose truth is known"),
        (deck, "cannot be smoothed"),
        (turning, "Leave --truth out"),
    ):
        with pytest.raises(ValueError, match=message):
            judged_by_smoother(recording)


def test_an_inertial_log_is_smoothed_too():
    recording = navgym.simulate("ins/nominal", seed=1, duration=20.0)
    blind = dataclasses.replace(recording, truth=None)
    assert judged_by_smoother(blind).truth.shape == recording.truth.shape


def test_the_next_command_of_navgym_read_is_one_that_runs(log, capsys):
    assert command.main(["read", str(log), "--read", *READ]) == 0
    typed = capsys.readouterr().out.splitlines()[-1]
    assert typed.endswith(
        f"--log {log} --read delimiter ';' columns.px 'north (m)' position_noise 5"
    )
