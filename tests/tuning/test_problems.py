"""Every registered problem goes through a study, from its recordings to its page."""

import json
import math
import pickle

import numpy as np
import pytest

from navgym.problem import PROBLEMS
from navgym.tuned import read_tuned
from navgym.tuning import tune
from navgym.tuning.cases import Cases
from navgym.tuning.headroom import FIXED, headroom
from navgym.tuning.objectives import Objective
from navgym.tuning.report import study as tune_report
from navgym.tuning.settings import StudySettings


def brief(problem):
    """Overrides that make recordings as short as can be, and half as long again as what is not scored."""
    batch = Cases.simulated(problem.study.scenario, "train", 1, **problem.brief).batch
    times = max(1, math.ceil(1.5 * problem.scoring.settling / (batch.steps * batch.step)))
    return {name: times * value for name, value in problem.brief.items()}


@pytest.fixture(scope="module", params=list(PROBLEMS))
def problem(request):
    return PROBLEMS[request.param]


@pytest.fixture(scope="module")
def cases(problem):
    return Cases.simulated(problem.study.scenario, "train", 3, **brief(problem))


def test_a_study_ends_with_tuned_parameters_and_a_page(problem, tmp_path):
    study = problem.study
    settings = StudySettings(
        filter=study.filter, scenario=(study.scenario,), overrides=brief(problem), trials=3, runs=2,
        select_runs=2, report_runs=2, workers=1, out=tmp_path,
    )  # fmt: skip
    found = tune.run(settings)
    tune_report.write(found)
    assert len(found.outcome.trials) == 3
    comparison = found.reports[study.scenario]
    assert comparison.measure is next(iter(problem.scoring.measures.values()))
    assert {problem.bound, found.tuned, found.default} <= {row.label for row in comparison.rows}
    assert read_tuned(tmp_path / "tuned.toml").filter == study.filter
    written = json.loads((tmp_path / "results.json").read_text())
    assert written["reports"][study.scenario]["measure"] == comparison.measure.axis
    assert study.filter in (tmp_path / "report.html").read_text()


def test_every_measure_of_a_part_is_that_of_the_whole(problem, cases):
    names = problem.find(problem.study.filter).space.names
    for measure in problem.scoring.measures:
        goal = Objective(problem.study.filter, names, cases, measure=measure)
        values = goal.space.defaults
        losses = goal.evaluate(values).losses
        assert np.isfinite(losses).all()
        np.testing.assert_array_equal(goal.evaluate(values, [2, 0]).losses, losses[[2, 0]])


def test_errors_over_time_are_those_of_the_runs(problem, cases):
    for name in problem.scoring.quantities:
        squared = cases.trace(cases.plain, None, name)
        assert squared.shape == (3, cases.batch.steps)
        first = round(problem.scoring.settling / cases.batch.step)
        rms = np.sqrt(np.nanmean(squared[:, first:], axis=1))
        found = cases.judge(cases.plain, None, (name,)).quantities[name]
        np.testing.assert_allclose(rms, found, rtol=1e-9)


def test_cases_travel_and_name_their_problem(problem, cases):
    again = pickle.loads(pickle.dumps(cases.take([1])))
    assert again.problem is problem
    np.testing.assert_array_equal(again.plain_errors(), cases.plain_errors()[[1]])


def test_headroom_is_measured_where_there_are_regimes(problem, tmp_path):
    steering = problem.study.steering
    if steering is None:
        with pytest.raises(ValueError, match="no scenario of"):
            headroom(problem.study.scenario, 0, tmp_path)
        return
    found = headroom(problem.study.scenario, 0, tmp_path, quick=True)
    assert set(found.comparisons) == set(steering.measures)
    for comparison in found.comparisons.values():
        assert comparison.reference == FIXED
        assert {*steering.beside, problem.bound} <= {row.label for row in comparison.rows}
