"""Training of a mixture on logs: what it is taught with, by what, what the guard says, what is refused."""

import dataclasses
import json

import numpy as np
import pytest

pytest.importorskip("optuna")
pytest.importorskip("tyro")

import navgym
from navgym.agents import Mixture
from navgym.agents.mixture import training
from navgym.agents.mixture.experts import around
from navgym.agents.mixture.material import ahead, calm, lessons_of, material, spoilt
from navgym.agents.mixture.training import fitted, train
from navgym.agents.training.logs import Logs, earlier
from navgym.agents.training.verdict import compared, judged
from navgym.command import main as command
from navgym.tuned import read_tuned
from tests.agents.mixtures import TUNED, quiet, recording, saved, small


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return saved(tmp_path_factory.mktemp("logs"))


@pytest.fixture(scope="module")
def made(logs, tmp_path_factory):
    return train(small(tmp_path_factory.mktemp("made"), logs), quiet, "the command")


# ---- what comes out


def test_the_same_training_gives_the_same_mixture(made, logs, tmp_path):
    again = train(small(tmp_path, logs), quiet).tried
    other = train(small(tmp_path, logs, seed=4), quiet).tried
    assert np.array_equal(again.W, made.tried.W)
    assert not np.array_equal(other.W, made.tried.W)


def test_it_is_better_than_its_start_on_what_it_is_taught_with(made, logs):
    cases = next(iter(Logs(logs).by_rate("train", 1).values()))
    start = made.start
    base = cases.problem.run(start.filter, cases.batch, dict(start.parameters), everything=True)
    assert compared(cases, made.tried.run(cases.batch, True), base)["truth"] > 0.0


def test_the_files_say_where_they_come_from_and_name_no_folder(made):
    text = (made.folder / "mixture.json").read_text()
    facts = json.loads(text)["training"]
    assert facts["command"] == "the command"
    assert facts["learnt_from"] == "truth"
    assert facts["configuration"]["log"] == ["log0.npz", "log1.npz", "log2.npz"]
    assert facts["guard"]["better"] is made.verdict.better
    assert str(made.folder.parent) not in text
    assert dict(read_tuned(made.folder / "tuned.toml").parameters) == dict(made.start.parameters)


def test_without_truth_it_learns_from_the_fixes_and_says_so(tmp_path):
    said = []
    blind = saved(tmp_path, truth=False)
    made = train(small(tmp_path / "out", blind), said.append)
    assert said[0].startswith("the logs hold no truth: learning from how well each fix is foretold")
    assert made.verdict.truth is None
    assert Mixture.load(tmp_path / "out" / "mixture").training["learnt_from"] == "fixes"


def test_not_looking_at_the_truth_is_the_same_as_not_having_it(tmp_path):
    blind, seeing = (saved(folder, truth=truth) for folder, truth in _folders(tmp_path))
    one = train(small(tmp_path / "one", blind), quiet).tried
    two = train(small(tmp_path / "two", seeing, truth=False), quiet).tried
    assert np.array_equal(one.W, two.W)


def _folders(tmp_path):
    for name, truth in (("blind", False), ("seeing", True)):
        (tmp_path / name).mkdir()
        yield tmp_path / name, truth


def test_it_starts_from_a_tuned_file(logs, tmp_path):
    (tmp_path / "tuned.toml").write_text(
        'filter = "vbakf"\n[parameters]\nprocess_noise_scale = 4.0\n'
    )
    made = train(small(tmp_path / "out", logs, start=tmp_path / "tuned.toml"), quiet)
    assert [e.filter for e in made.tried.experts] == ["vbakf"] * 5 + ["kf", "bank"]
    assert made.tried.reference.parameters["process_noise_scale"] == 4.0


# ---- the guard


def test_where_the_guard_says_no_the_tuned_parameters_are_written_and_it_is_said(
    logs, tmp_path, monkeypatch
):
    no = judged("mixture", "on each log", [{"fixes": -0.01, "truth": 0.02}])
    monkeypatch.setattr(training, "guarded", lambda *_: no)
    said = []
    made = train(small(tmp_path, logs), said.append)
    assert "the mixture is NOT kept" in said[-1]
    assert "what is written is the tuned parameters" in said[-1]
    kept = Mixture.load(tmp_path / "mixture")
    assert kept.refused
    assert kept.training["guard"]["better"] is False
    log = recording(7)
    alone = navgym.estimate("qivbf", log, dict(made.start.parameters))
    np.testing.assert_allclose(kept.estimate(log).states, alone.states)


def test_a_run_that_fails_loses_whatever_the_others_gain():
    verdict = judged("mixture", "there", [{"fixes": 0.1}, {"fixes": -1.0}])
    assert not verdict.better
    assert verdict.worst == -1.0


def test_each_log_is_judged_by_weights_trained_on_the_others(made):
    assert made.verdict.said.count("on each log, trained on the others") == 1


def test_one_log_alone_is_cut_in_time_and_that_is_said(logs, tmp_path):
    made = train(small(tmp_path, logs[:1]), quiet)
    assert "on the last 30% of the one log, trained on what is before" in made.verdict.said


def test_validation_logs_judge(logs, tmp_path):
    made = train(small(tmp_path, logs[:2], validation_log=logs[2:]), quiet)
    assert "on the validation logs" in made.verdict.said


# ---- what it is taught with


def lessons(recordings, truth=True, drawn=False):
    return lessons_of(list(enumerate(recordings)), truth, drawn, np.random.default_rng(0))


def test_lessons_are_the_logs_spoilt_copies_and_calm_legs():
    logs = [recording(i) for i in range(4)]
    made = lessons(logs)
    assert [each.log for each in made] == [0, 1, 2, 3, 0, 1, 2, 3, 0, 2]
    assert all(np.array_equal(a.recording.measurements, r.measurements, equal_nan=True) for a, r in zip(made, logs, strict=False))  # fmt: skip


def test_a_spoilt_copy_has_another_noise_and_outliers_in_its_fixes_alone():
    log = recording(steps=2000, loss=0.0)
    copy = spoilt(log, 0, True, True, np.random.default_rng(5))
    off = copy.recording.measurements - log.measurements
    assert not off[:, [1, 3]].any()
    size = np.linalg.norm((copy.recording.measurements - copy.clean)[:, [0, 2]], axis=1)
    hit = size > 0.0
    assert 0.0 < hit.mean() < 0.1
    assert np.ptp(size[hit]) < 1e-9 * size.max()
    noise = [y[:, 0] - log.truth[:, 0] for y in (copy.clean, log.measurements)]
    ratio = noise[0] / noise[1]
    assert np.ptp(ratio) < 1e-6
    assert 0.5 <= ratio[0] <= 2.5


def test_without_truth_a_spoilt_copy_only_adds_noise_and_losses():
    log = recording(steps=500, truth=False)
    copy = spoilt(log, 0, False, False, np.random.default_rng(1))
    assert (copy.recording.lost | ~log.lost).all()
    assert copy.recording.lost.sum() > log.lost.sum()
    heard = ~copy.recording.lost
    assert np.array_equal(copy.clean[heard], log.measurements[heard])


def test_a_calm_leg_has_the_logs_clock_losses_and_model():
    log = recording(steps=300)
    leg = calm(log, np.random.default_rng(0))
    assert np.array_equal(leg.time, log.time)
    assert np.array_equal(leg.lost, log.lost)
    assert leg.model is log.model
    off = (leg.measurements - leg.model.observe(leg.truth))[~leg.lost]
    assert 0.8 < off.std() < 1.2  # the model's own R is 1


def test_errors_ahead_are_misses_of_the_next_fix_as_it_was_before_it_was_spoilt():
    log = recording(steps=30, loss=0.4)
    y = log.measurements + np.array([5.0, 0.0, -3.0, 0.0])
    lesson = dataclasses.replace(
        lessons([log])[0], recording=dataclasses.replace(log, measurements=y)
    )
    found = navgym.estimate("kf", lesson.recording)
    miss = ahead([lesson], found.innovations[None, :, None], np.array([0, 1, 0, 1]))[0, :, 0]
    heard = np.flatnonzero(~log.lost[:, 0])
    for k in range(len(log) - 1):
        later = heard[heard > k]
        if len(later):
            clean = found.innovations[later[0]][[0, 2]] - np.array([5.0, -3.0])
            np.testing.assert_allclose(miss[k], clean)
        else:
            assert np.isnan(miss[k]).all()


def test_the_slope_of_the_loss_is_right():
    taught = material(around(TUNED), lessons([recording(steps=40)]), True)
    z = np.random.default_rng(0).standard_normal(taught.features.shape).astype(np.float32)
    loss = training._Loss(z, taught, 0.01)
    x = 0.1 * np.random.default_rng(1).standard_normal((z.shape[1] + 1) * 7)
    _, slope = loss(x)
    for i in (0, 17, 60, len(x) - 2):
        step = np.zeros_like(x)
        step[i] = 1e-4
        numeric = (loss(x + step)[0] - loss(x - step)[0]) / 2e-4
        assert slope[i] == pytest.approx(numeric, rel=1e-3, abs=1e-6)


def test_a_heavy_decay_leaves_nothing_of_the_features(tmp_path, logs):
    config = small(tmp_path, logs, decay=1e6)
    taught = material(around(TUNED), lessons([recording()]), True)
    assert np.abs(fitted(around(TUNED), taught, config).W).max() < 1e-4


# ---- what is refused


def test_no_logs(tmp_path):
    with pytest.raises(ValueError, match="logs must be named"):
        train(small(tmp_path, ()), quiet)


def test_a_log_that_judges_and_is_trained_on(logs, tmp_path):
    with pytest.raises(ValueError, match=r"log0\.npz is trained on and judges at once"):
        train(small(tmp_path, logs, validation_log=logs[:1]), quiet)


def test_logs_of_different_problems(logs, tmp_path):
    deck = navgym.simulate("deck/switch-60", seed=0, duration=20.0).save(tmp_path / "deck.npz")
    with pytest.raises(ValueError, match="are logs of different problems"):
        train(small(tmp_path, (*logs, deck)), quiet)
    with pytest.raises(ValueError, match="is a log of the Deck"):
        train(small(tmp_path, (deck,)), quiet)


def test_a_log_without_fixes(tmp_path):
    log = recording(steps=80)
    H = np.eye(4)[[1, 3]]
    model = navgym.LinearModel(dt=1.0, H=H, R=np.eye(2))
    speeds = navgym.Recording(log.time, log.measurements[:, [1, 3]], model=model)
    path = speeds.save(tmp_path / "speeds.npz")
    with pytest.raises(ValueError, match=r"speeds\.npz holds no position fixes"):
        train(small(tmp_path, (path,)), quiet)


def test_a_log_that_is_too_short(tmp_path):
    path = recording(steps=30).save(tmp_path / "short.npz")
    with pytest.raises(ValueError, match="a log has 30 rows, and 40 are needed"):
        train(small(tmp_path, (path,)), quiet)
    with pytest.raises(ValueError, match="too few to be cut in time"):
        earlier(recording(steps=50))


def test_the_command_trains_and_tells_what_is_next(logs, tmp_path, capsys):
    words = ["train", "--kind", "mixture", "--log", *map(str, logs), "--out", str(tmp_path)]
    assert command([*words, "--trials", "2", "--iterations", "5", "--draws", "1"]) == 0
    out = capsys.readouterr().out
    assert "guard: the mixture is" in out
    assert "next, on other logs: navgym evaluate" in out
    assert command(["train", "--kind", "magic"]) == 2
    assert "unknown --kind 'magic'" in capsys.readouterr().err
