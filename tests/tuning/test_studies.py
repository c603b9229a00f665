"""Objectives, studies, comparisons and reports, on studies small enough to run for real."""

import json
import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest

import navgym
from navgym.auv.problem import PROBLEM, TRACKS
from navgym.core.seeds import SPLITS, split_of
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Entry, compare
from navgym.tuning.experiments import cross_tuned, per_track, real_cases
from navgym.tuning.objectives import GeometricMean, Guarded, Objective
from navgym.tuning.papers.expected import Check
from navgym.tuning.report import page as report
from navgym.tuning.report import tables, words
from navgym.tuning.schedule import RegimeTable
from navgym.tuning.study.run import search
from navgym.tuning.study.search_space import from_optuna, to_optuna
from navgym.tuning.study.selection import confirm, rounded

FREE = ("forgetting", "process_noise_scale", "fill", "vb_iterations")


@pytest.fixture(scope="module")
def cases():
    return Cases.simulated("auv/switch-D", "train", 6, steps=120, loss=0.2)


@pytest.fixture(scope="module")
def goal(cases):
    return Objective("qivbf", FREE, cases)


class Stopping:
    """A goal that is interrupted at its `at`-th call."""

    def __init__(self, goal, at, error=KeyboardInterrupt):
        self.space, self.about, self.goal, self.left, self.error = (
            goal.space, goal.about, goal, at, error,
        )  # fmt: skip

    def __call__(self, values):
        self.left -= 1
        if self.left == 0:
            raise self.error
        return self.goal(values)


def run(goal, trials, journal=None, seed=0, **more):
    return search(goal, trials, seed, journal, progress=False, **more)


def results(outcome):
    return [(dict(t.values), t.result) for t in outcome.trials]


# ---- objectives


def test_the_objective_is_the_mean_over_runs_of_the_position_rmse(cases):
    errors = []
    for recording in cases.recordings:
        states = navgym.estimate("kf", recording, {"process_noise_scale": 7.0}).states
        squared = ((states - recording.truth)[:, [0, 2]] ** 2).sum(axis=1)
        errors.append(np.sqrt(squared.mean()))
    objective = Objective("kf", ["process_noise_scale"], cases)
    assert objective({"process_noise_scale": 7.0}) == pytest.approx(np.mean(errors), rel=1e-12)
    median = Objective("kf", ["process_noise_scale"], cases, "median")
    assert median({"process_noise_scale": 7.0}) == pytest.approx(np.median(errors), rel=1e-12)


def test_a_diverged_run_costs_ten_times_the_plain_filter():
    cases = Cases.simulated("auv/nominal", "train", 5)
    objective = Objective("qivbf_printed", ["vb_iterations"], cases)
    wild, flags = cases.errors("qivbf_printed")
    assert flags.any()
    assert wild.max() > 50.0
    bounded, plain = objective.errors({"vb_iterations": 5}), cases.plain_errors()
    np.testing.assert_array_equal(bounded[flags], 10.0 * plain[flags])
    assert np.isfinite(bounded).all()
    assert (bounded > plain).all()


def test_a_batch_without_provenance_will_do(cases, goal):
    values = goal.space.defaults
    assert Objective("qivbf", FREE, cases.batch)(values) == goal(values)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("qivf", ["fill"]), "Did you mean 'qivbf'"),
        (("qivbf", ["forgeting"]), "Did you mean 'forgetting'"),
        (("qivbf", []), "at least one parameter"),
        (("qivbf", ["fill"], "maen"), "Did you mean 'mean'"),
        (("qivbf", ["fill"], "mean", {"fill": "skip"}), "free and fixed"),
        (("qivbf", ["fill"], "mean", {"forgetting": 2.0}), "forgetting must lie in"),
    ],
)
def test_a_bad_objective_is_refused(cases, arguments, message):
    name, free, *rest = arguments
    with pytest.raises(ValueError, match=message):
        Objective(name, free, cases, *rest)


def test_recordings_without_truth_are_refused():
    recording = navgym.simulate("auv/nominal", steps=5)
    blind = navgym.Recording(recording.time, recording.measurements, model=recording.model)
    with pytest.raises(ValueError, match=r"needs the truth.*'fixes'"):
        Objective("kf", ["process_noise_scale"], Cases.of([blind]))
    with pytest.raises(ValueError, match="truth"):
        compare([Entry("kf", "kf")], Cases.of([blind]), "kf")


def test_a_geometric_mean_weighs_ratios_alike(cases):
    one = Objective("kf", ["process_noise_scale"], cases)
    values = {"process_noise_scale": 3.0}
    value = one(values)
    assert GeometricMean([one, one], [value / 2, value * 2])(values) == pytest.approx(1.0)
    three = GeometricMean([one] * 3, [value / 2, value / 2, value])
    assert three(values) == pytest.approx(2.0 ** (2 / 3))  # two of three are twice their reference
    with pytest.raises(ValueError, match="as many"):
        GeometricMean([one], [1.0, 2.0])
    with pytest.raises(ValueError, match="share one space"):
        GeometricMean([one, Objective("qivbf", ["forgetting"], one.cases)], [1.0, 1.0])


def test_a_guard_prices_runs_that_fail():
    goal = Objective("qivbf_printed", ["vb_iterations"], Cases.simulated("auv/nominal", "train", 4))
    guarded = Guarded(goal, [goal], limit=2.0, price=20.0)
    values = {"vb_iterations": 5}
    share = (goal.errors(values) > 2.0 * goal.cases.plain_errors()).mean()
    assert share > 0
    assert guarded(values) == pytest.approx(goal(values) * (1 + 20.0 * share))


def test_a_table_that_is_alike_in_all_regimes_is_a_fixed_filter(cases):
    names = ("forgetting", "process_noise_scale")
    values = {"forgetting": 0.9, "process_noise_scale": 20.0}
    table = RegimeTable("qivbf", names, cases, {"prior_count": 3.0})
    fixed = Objective("qivbf", names, cases, fixed={"prior_count": 3.0})
    assert table(table.same_everywhere(values)) == pytest.approx(fixed(values), rel=1e-12)
    assert len(table.space) == 2 * len(cases.recordings[0].meta["regimes"])


# ---- studies


def test_the_same_seed_gives_the_same_study(goal, tmp_path):
    memory = run(goal, 20)
    assert results(memory) == results(run(goal, 20, tmp_path / "study.log"))
    assert results(memory) != results(run(goal, 20, seed=1))
    assert memory.best.result == min(t.result for t in memory.trials)


def test_the_defaults_are_tried_first_and_then_what_is_given(goal):
    extra = {"forgetting": 0.7, "process_noise_scale": 9.0}
    trials = run(goal, 2, first=[extra]).trials
    for trial, values in zip(trials, ({}, extra), strict=True):
        np.testing.assert_allclose(goal.space.array(trial.values), goal.space.array(values))


def test_an_interrupted_study_loses_nothing_and_ends_like_an_uninterrupted_one(goal, tmp_path):
    journal = tmp_path / "study.log"
    stopped = run(Stopping(goal, 18), 22, journal)
    assert stopped.interrupted
    assert len(stopped.trials) == 17
    again = run(goal, 22, journal)
    assert not again.interrupted
    assert results(again)[:17] == results(stopped)
    assert results(again) == results(run(goal, 22))
    assert results(run(goal, 22, journal)) == results(again)  # nothing left to do


def test_the_first_ctrl_c_lets_the_trial_at_hand_finish(goal):
    calls = []

    class Pressed:
        space, about = goal.space, goal.about

        def __call__(self, values):
            calls.append(values)
            if len(calls) == 3:
                signal.raise_signal(signal.SIGINT)
            return goal(values)

    outcome = run(Pressed(), 6)
    assert outcome.interrupted
    assert len(outcome.trials) == len(calls) == 3
    with pytest.raises(KeyboardInterrupt):
        outcome.complete()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_error_in_the_objective_is_raised_and_costs_no_trial(goal, tmp_path):
    journal = tmp_path / "study.log"
    with pytest.raises(ZeroDivisionError):
        run(Stopping(goal, 3, ZeroDivisionError), 6, journal)
    assert results(run(goal, 6, journal)) == results(run(goal, 6))


KILLED = """
import os, sys
from pathlib import Path
from navgym.tuning.cases import Cases
from navgym.tuning.objectives import Objective
from navgym.tuning.study.run import search

goal = Objective("kf", ["process_noise_scale"], Cases.simulated("auv/nominal", "train", 2, steps=20))

class Killed:
    space, about, calls = goal.space, goal.about, 0
    def __call__(self, values):
        Killed.calls += 1
        if Killed.calls == 5:
            os.kill(os.getpid(), 9)
        return goal(values)

search(Killed(), 8, journal=Path(sys.argv[1]), progress=False)
"""


def test_a_killed_study_goes_on(tmp_path):
    journal = tmp_path / "study.log"
    done = subprocess.run([sys.executable, "-c", KILLED, str(journal)], check=False)
    assert done.returncode == -9
    small = Cases.simulated("auv/nominal", "train", 2, steps=20)
    goal = Objective("kf", ["process_noise_scale"], small)
    assert results(run(goal, 8, journal)) == results(run(goal, 8))


def test_a_study_of_another_goal_is_refused_naming_both(goal, cases, tmp_path):
    journal = tmp_path / "study.log"
    run(goal, 2, journal)
    other = Objective("qivbf", ("prior_count",), cases)
    with pytest.raises(ValueError, match="belongs to another search") as caught:
        run(other, 2, journal)
    assert re.search(r"it holds: .*forgetting 0\.6\.\.0\.999", str(caught.value))
    assert re.search(r"asked for: .*prior_count 0\.1\.\.300", str(caught.value))
    fresh = Objective(
        "qivbf", FREE, Cases.simulated("auv/switch-D", "train", 7, steps=120, loss=0.2)
    )
    with pytest.raises(ValueError, match=r"seeds: 0, 5[\s\S]*seeds: 0, 6"):
        run(fresh, 2, journal)
    with pytest.raises(ValueError, match="seed: 0"):
        run(goal, 2, journal, seed=1)


def test_no_trials_are_refused(goal):
    with pytest.raises(ValueError, match="trials must be a whole number of at least 1, got 0"):
        run(goal, 0)


@pytest.mark.parametrize("name", [f.name for f in PROBLEM.filters.values() if len(f.space)])
def test_every_space_can_be_searched_and_read_back(name):
    space = navgym.parameter_space(name)
    for unit in np.random.default_rng(0).random((20, len(space))):
        values = space.from_unit(unit)
        back = from_optuna(space, to_optuna(space, values))
        np.testing.assert_allclose(space.array(back), space.array(values), rtol=1e-9)
    for end in (np.zeros(len(space)), np.ones(len(space))):
        values = space.from_unit(end)
        back = from_optuna(space, to_optuna(space, values))
        np.testing.assert_allclose(space.array(back), space.array(values), rtol=1e-9)


def test_leaders_are_confirmed_on_fresh_recordings(goal):
    outcome = run(goal, 12)
    fresh = Objective("qivbf", FREE, Cases.simulated("auv/switch-D", "validation", 6, steps=120))
    best = confirm(outcome, fresh, top=5)
    leaders = sorted(outcome.trials, key=lambda t: t.result)[:5]
    assert best.result == min(fresh(t.values) for t in leaders)


def test_rounding_follows_the_scale_of_the_parameter():
    space = navgym.parameter_space("qivbf").subset(("forgetting", "process_noise_scale", "fill"))
    values = {"forgetting": 0.99736, "process_noise_scale": 347.0, "fill": "skip"}
    rough = {"forgetting": 0.9974, "process_noise_scale": 350.0, "fill": "skip"}
    assert rounded(space, values) == rough


# ---- defaults and references that ship


@pytest.mark.parametrize("scenario", ["mismatch", "turn"])
@pytest.mark.parametrize("name", ["vbakf", "qivbf"])
def test_shipped_defaults_do_not_diverge_where_the_motion_is_not_the_models(scenario, name):
    cases = Cases.simulated(f"auv/{scenario}", "test", 100)
    errors, flags = cases.errors(name)
    plain = cases.plain_errors()
    assert not flags.any()
    assert errors.mean() < plain.mean()
    assert (errors < 2.0 * plain).all()


def test_the_reference_of_switch_d_is_the_best_fixed_filter():
    from navgym.auv.scenarios import CATALOGUE as SCENARIOS

    cases = Cases.simulated("auv/switch-D", "test", 300)
    reference = cases.errors("qivbf", dict(SCENARIOS["switch-D"].reference))[0].mean()
    # docs/science/qivbf.md#scenarios-and-headroom
    assert reference == pytest.approx(1.161, rel=0.02)
    assert reference < cases.errors("qivbf")[0].mean()


# ---- comparisons


@pytest.fixture(scope="module")
def found():
    fresh = Cases.simulated("auv/switch-D", "test", 12, steps=150)
    entries = [
        Entry("kf", "kf"), Entry("oracle", "oracle", bound=True), Entry("bank", "bank"),
        Entry("printed", "qivbf_printed"),
    ]  # fmt: skip
    return compare(entries, fresh, "kf", keep=("bank",))


def test_a_comparison_scores_between_the_plain_filter_and_the_oracle(found):
    assert found["kf"].score == 0.0
    assert found["oracle"].score == 1.0
    assert 0.5 < found["bank"].score < 1.0
    assert found["bank"].gain == pytest.approx(1 - found["bank"].mean / found["kf"].mean)
    assert found["bank"].gain_low < found["bank"].gain < found["bank"].gain_high
    assert found["bank"].mean == pytest.approx(found.errors["bank"].mean())
    np.testing.assert_allclose(np.sqrt(found.squared["bank"].mean(axis=1)), found.errors["bank"])


def test_what_diverges_is_named_and_given_no_mean(found):
    assert found["printed"].diverges
    text = tables.ladder(found).as_text()
    assert re.search(r"printed +diverges", text)
    assert "1e+" not in text
    json.dumps(found.as_dict(), allow_nan=False)


def test_findings_are_said_as_they_are(found):
    assert "below that of `kf`" in words.versus(found, "bank", "kf")
    assert "above that of `bank`" in words.versus(found, "kf", "bank")
    assert "diverges in" in words.versus(found, "printed", "kf")
    assert "bank` beats `kf`" in words.without_learning(found, ["bank"], "kf")
    assert words.without_learning(found, ["kf"], "bank") == "None of `kf` beats `bank` here."
    assert words.best(found).label == "bank"  # the oracle cannot be had
    assert words.nobody_better_than(found, "bank") == "Nothing beats `bank` there."


def test_labels_must_be_distinct_and_the_reference_known(cases):
    with pytest.raises(ValueError, match="distinct labels"):
        compare([Entry("a", "kf"), Entry("a", "kf")], cases, "a")
    with pytest.raises(ValueError, match="unknown entry 'b'"):
        compare([Entry("a", "kf")], cases, "b")


@pytest.mark.parametrize(
    ("found_value", "better", "verdict"),
    [
        (1.02, False, "within"),
        (1.2, False, "outside"),
        (0.8, True, "better"),
        (0.8, False, "outside"),
    ],
)
def test_a_check_says_how_a_figure_compares(found_value, better, verdict):
    check = Check("x", 1.0, found_value, 0.02, 0.02, smaller_is_fine=better)
    assert check.verdict == verdict
    assert check.holds == (verdict != "outside")


# ---- real tracks and their stand-in


def test_the_stand_in_has_the_same_ways_with_new_noise():
    one, other = (real_cases(PROBLEM, None, 0.3, 2, split, [1, 2]) for split in ("train", "test"))
    assert len(one) == 4
    for a, b in zip(one.recordings, other.recordings, strict=True):
        np.testing.assert_array_equal(a.truth, b.truth)
        assert not np.array_equal(a.lost, b.lost)
    assert one.about["source"] == "simulated stand-in"


def test_parameters_are_tuned_on_the_other_half_of_the_tracks(monkeypatch):
    asked = []

    def record(problem, folder, rate, draws, split, tracks=None, *more):
        asked.append((split, tuple(tracks)))
        return real_cases(problem, folder, rate, draws, split, tracks, *more)

    monkeypatch.setattr("navgym.tuning.experiments.real_cases", record)
    halves = list(cross_tuned(PROBLEM, Entry("kf", "kf"), None, 1, 2))
    assert {split for split, _ in asked} == {"train"}
    assert [tracks for tracks, _ in halves] == list(TRACKS.folds)
    assert list(dict.fromkeys(t for _, t in asked)) == list(TRACKS.folds[::-1])
    cases = real_cases(PROBLEM, None, 0.1, 1, "test")
    assert len(per_track(cases, halves)) == len(TRACKS.numbers)


def test_splits_share_no_recording():
    seeds = {
        split: Cases.simulated("auv/nominal", split, 3, steps=5).about["seeds"] for split in SPLITS
    }
    for split, (first, last) in seeds.items():
        assert {split_of(first), split_of(last)} == {split}


# ---- reports


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = report.write_json(tmp_path / "new" / "results.json", {"a": 1})
    before = path.read_bytes()
    with pytest.raises(ValueError, match="JSON compliant"):
        report.write_json(path, {"a": float("nan")})

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        report.write_json(path, {"a": 2})
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == ["results.json"]


def test_a_page_needs_nothing_else_and_escapes_what_it_shows(tmp_path, found):
    page = report.Page(
        "A & B", ["`x` < 1 and **y**"], [report.Section("S", [], [tables.ladder(found)])],
        [report.Tile("1 m", "tile")], report.provenance("demo.py"),
    )  # fmt: skip
    html = report.write_page(tmp_path / "page.html", page).read_text()
    assert "<title>A &amp; B</title>" in html
    assert "<code>x</code> &lt; 1 and <strong>y</strong>" in html
    assert not re.search(r"(src|href)=", html)
    assert f"{found['bank'].mean:.3f}" in html
    assert navgym.__version__ in html
