"""What runs are judged by: units, what needs the truth, bounds on divergence."""

import numpy as np
import pytest

from navgym.metrics.measures import BLIND, Judged, bounded, innovation_quantities
from navgym.problem import PROBLEMS, problems

AUV, DECK = (PROBLEMS[name].scoring for name in ("auv", "deck"))


def test_nothing_received_is_no_number():
    found = innovation_quantities([[np.nan, np.nan]], [[np.nan, np.nan]], [[0, 0]])
    assert np.isnan(found["nll"]).all()
    assert np.isnan(found["nis"]).all()


@pytest.mark.parametrize("bad", [np.inf, np.nan, 1e6])
@pytest.mark.parametrize(("name", "ceiling"), [("rmse", 20.0), ("nll", 12.0)])
def test_a_failed_run_counts_as_its_ceiling_and_leaves_the_others(bad, name, ceiling):
    found = Judged({name: np.array([1.0, bad, 3.0])}, np.array([False, False, False]), 0.0)
    known = {**AUV.quantities, **BLIND}
    kept = bounded(found, {name: np.full(3, 2.0)}, known)[name]
    np.testing.assert_array_equal(kept, [1.0, ceiling, 3.0])
    flagged = Judged({name: np.array([1.0, 2.0, 3.0])}, np.array([False, True, False]), 0.0)
    np.testing.assert_array_equal(
        bounded(flagged, {name: np.full(3, 2.0)}, known)[name], [1.0, ceiling, 3.0]
    )


@pytest.mark.parametrize("problem", list(problems()), ids=lambda p: p.name)
def test_an_axis_bears_the_unit_where_there_is_one(problem):
    for measure in problem.scoring.measures.values():
        unit = measure.axis.removeprefix(measure.label)
        assert unit == (f", {measure.unit}" if len(measure.parts) == 1 and measure.unit else "")


def test_only_innovations_are_judged_without_the_truth():
    needs = {m.name for m in DECK.measures.values() if not m.needs_truth}
    assert needs == {"likelihood", "consistency"}
    assert AUV.measures["rmse"].needs_truth is True
    assert AUV.measures["likelihood"].needs_truth is False


def test_a_mean_of_ratios_has_no_unit_and_one_quantity_has_its_own():
    assert DECK.measures["composite"].unit == ""
    assert DECK.measures["theta_rate"].unit == "′/s"
    assert AUV.measures["rmse"].axis == "position RMSE, m"
    assert AUV.measures["consistency"].axis == "|ln NIS|"
