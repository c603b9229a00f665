"""A study from beginning to end, small but real."""

import itertools
import json
import re
import tomllib

import numpy as np
import pytest

import navgym
from navgym.auv.csv_log import write_csv
from navgym.problem import Amount
from navgym.tuning import tune
from navgym.tuning.cases import Cases
from navgym.tuning.headroom import FIXED, TABLE, headroom
from navgym.tuning.report import study as tune_report
from navgym.tuning.settings import StudySettings
from tests.browser import check, needs_browser


def small(out, **more):
    settings = {"trials": 24, "runs": 8, "select_runs": 10, "report_runs": 30, "steps": 200,
                "workers": 1, "scenario": ("auv/mismatch",), "out": out}  # fmt: skip
    return StudySettings(**(settings | more))


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A study of the variational filter where the motion is not the model's, and its report."""
    made = tune.run(small(tmp_path_factory.mktemp("tune"), filter="vbakf"))
    tune_report.write(made)
    return made


def test_the_tuned_filter_gains_on_recordings_that_nobody_tuned_on(found):
    comparison = found.reports["auv/mismatch"]
    assert comparison.difference(found.tuned, found.default).gain_low > 0.05
    fresh = Cases.simulated("auv/mismatch", "test", 30, steps=200)
    mean = fresh.errors("vbakf", found.values)[0].mean()
    assert comparison[found.tuned].mean == pytest.approx(mean, rel=1e-12)


def test_the_winner_is_the_best_of_the_leaders_on_the_validation_seeds(found):
    fresh = tune.goal_of(found.settings, found.stages.select)
    leaders = sorted(found.outcome.trials, key=lambda t: (t.given_up, t.result))[:8]
    assert found.chosen.result == min(fresh(t.values) for t in leaders)


def test_the_tuned_file_gives_the_reported_error(found):
    path = found.settings.out / "tuned.toml"
    recording = navgym.simulate("auv/mismatch", seed=navgym.seeds("test", 1)[0], steps=200)
    states = navgym.estimate("vbakf", recording, path).states
    rmse = np.sqrt(((states - recording.truth)[:, [0, 2]] ** 2).sum(axis=1).mean())
    assert rmse == pytest.approx(found.reports["auv/mismatch"].errors[found.tuned][0], rel=1e-12)
    content = tomllib.loads(path.read_text())
    assert content["provenance"]["command"].startswith("navgym")
    assert "%" in content["provenance"]["gain over defaults"]["auv/mismatch"]


def test_the_page_and_the_results_hold_the_same_numbers(found):
    html = (found.settings.out / "report.html").read_text()
    results = json.loads((found.settings.out / "results.json").read_text())
    for row in results["reports"]["auv/mismatch"]["rows"]:
        assert f"{row['mean']:.3f}" in html
    assert html.count("<svg") >= 5
    assert not re.search(r"(src|href)=", html.replace("xlink:href=", ""))
    assert len(results["trials"]) == 24
    assert set(results["sweeps"]) == {p.name for p in found.settings.parameters()}
    assert {"navgym", "python", "optuna"} <= set(results["provenance"]["versions"])


@needs_browser
def test_the_page_fits_in_a_browser(found, tmp_path):
    check([found.settings.out / "report.html"], tmp_path)


def test_the_same_command_again_finds_the_study_done_and_the_same_winner(found):
    again = tune.run(found.settings)
    assert again.values == found.values
    assert again.outcome == found.outcome


def test_several_scenarios_have_a_report_each(tmp_path):
    made = tune.run(
        small(tmp_path, trials=6, filter="kf", scenario=("auv/mismatch", "auv/nominal"))
    )
    assert list(made.reports) == ["auv/mismatch", "auv/nominal"]
    tune_report.write(made)
    assert "auv/nominal" in tune_report.summary(made)


def test_time_is_an_objective_on_request(tmp_path):
    made = tune.run(small(tmp_path, trials=16, filter="vbakf", free=("vb_iterations",), cost=True))
    front = made.outcome.front
    assert all(a.cost < b.cost and a.result > b.result for a, b in itertools.pairwise(front))
    assert made.outcome.best in front
    tune_report.write(made)
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["front"] == [t.number for t in front]


def test_an_earlier_result_is_tried_right_after_the_defaults(tmp_path, found):
    start = found.settings.out / "tuned.toml"
    made = tune.run(small(tmp_path, trials=2, filter="vbakf", start=start))
    space = made.goal.space
    np.testing.assert_allclose(
        space.array(made.outcome.trials[1].values), space.array(found.chosen.values), rtol=1e-9
    )
    with pytest.raises(ValueError, match="'vbakf', not of 'kf'"):
        tune.run(small(tmp_path / "other", trials=2, filter="kf", start=start))


def blind_log(path, scenario="auv/mismatch", seed=3, steps=300, **overrides):
    recording = navgym.simulate(scenario, seed=seed, steps=steps, **overrides)
    write_csv(navgym.Recording(recording.time, recording.measurements, model=recording.model), path)
    return path


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """A study on one log without truth, and its report."""
    out = tmp_path_factory.mktemp("log")
    log = blind_log(out / "log.csv")
    made = tune.run(small(out / "out", filter="kf", log=(log,), trials=20))
    tune_report.write(made)
    return made


def test_a_log_without_truth_is_tuned_by_the_one_step_error_of_its_fixes(logged):
    found = logged.reports["logs"]
    assert found.measure.name == "fixes"
    assert {"nll"} == set(found.quantities)
    # the reader believes white acceleration of its own; a better fit to the motion foretells better
    assert found.difference(logged.tuned, logged.default).mean_difference < 0.0
    assert not logged.held.kept_default
    assert logged.values == logged.winner


def test_what_a_one_step_error_cannot_see_is_chosen_by_nis(logged):
    (name,) = logged.stages.select
    cases = logged.stages.select[name]
    nis, _ = cases.consistency("kf", logged.winner)
    assert nis.mean == pytest.approx(1.0, rel=0.05)  # P0 does not take part
    noises = ("process_noise_scale", "measurement_noise_scale")
    assert logged.winner["measurement_noise_scale"] == pytest.approx(logged.calibrated)
    before = logged.winner | {k: logged.winner[k] / logged.calibrated for k in noises}
    told = [
        cases.judge("kf", v, ("fixes",)).quantities["fixes"][0] for v in (before, logged.winner)
    ]
    assert told[0] == pytest.approx(told[1], rel=0.005)


def test_the_report_of_a_log_speaks_of_metres_and_nats_and_bands(logged):
    text = tune_report.summary(logged)
    assert "one-step error of the position fixes, m" in text
    assert "innovation NLL, nats per component" in text
    assert re.search(r"NIS \(0\.\d\d … 1\.\d\d\)", text)
    assert "The tuned parameters hold on the part never tuned on" in text
    assert "A likelihood is no position error" in text
    assert "one recording: no interval over recordings" in text.lower()
    assert "NEES (" not in text


def test_parameters_that_do_not_hold_on_the_rest_of_the_log_are_not_kept(tmp_path):
    """The first 70 % move as a model says, the rest not at all like it: tuned for calm, worse there."""
    rng = np.random.default_rng(0)
    acceleration = rng.normal(size=(600, 2)) * np.where(np.arange(600) < 420, 0.001, 0.5)[:, None]
    position = acceleration.cumsum(axis=0).cumsum(axis=0) + rng.normal(size=(600, 2))
    log = tmp_path / "log.csv"
    rows = "".join(f"{k},{x:.4f},{y:.4f}\n" for k, (x, y) in enumerate(position))
    log.write_text(f"time,px,py\n{rows}")
    made = tune.run(small(tmp_path / "out", filter="kf", log=(log,), trials=30))
    assert made.held.kept_default
    tune_report.write(made)
    assert "do not hold" in tune_report.summary(made)
    kept = tomllib.loads((tmp_path / "out/tuned.toml").read_text())
    assert kept["parameters"] == made.space.defaults
    assert "do not hold" in kept["provenance"]["held"]
    assert "do not hold" in (tmp_path / "out/report.html").read_text()


def test_a_log_with_little_in_it_ends_in_words(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text(
        "time,px,py\n" + "".join(f"{k},{k}.0,1.0\n" for k in range(6)) + "6,,\n7,,\n8,,\n"
    )
    with pytest.raises(ValueError, match=r"between 70% and 100% .*Use a longer recording"):
        tune.run(small(tmp_path / "out", filter="kf", log=(log,), trials=4))


def test_tuned_without_truth_the_real_tracks_are_tracked_better_than_by_default(akit, tmp_path):
    made = tune.run(
        small(tmp_path, filter="vbakf", akit=akit, trials=60, runs=2, select_runs=2, report_runs=3)
    )
    for comparison in made.reports.values():
        assert comparison.measure.name == "rmse"
        assert comparison.difference(made.tuned, made.default).gain_low > 0.0
        assert "vbakf, tuned with the truth" in comparison
    assert {m.measure.name for m in made.goal.members} == {"fixes"}


def test_headroom_is_what_the_true_regime_is_worth(tmp_path):
    """The typical recording gains a tenth; a mean over 40 hangs on whether one of them locks out."""
    found = headroom("auv/switch-D", 0, tmp_path, amount=Amount(40, 20, 20, 40), steps=300)
    comparison = found.comparisons["rmse"]
    gain = comparison.difference(TABLE, FIXED)
    assert gain.median_difference < -0.1 * comparison[FIXED].mean
    assert comparison["oracle"].mean < comparison[TABLE].mean < comparison[FIXED].mean
    with pytest.raises(ValueError, match="unknown scenario"):
        headroom("auv/switch-X", 0, tmp_path)
