"""What runs are judged by: units, what needs the truth, bounds on divergence."""

import numpy as np
import pytest

from navgym.metrics.measures import (
    NLL,
    Judged,
    bounded,
    cut_squares,
    innovation_quantities,
    one_step_error,
    spreads,
)
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
    known = {**AUV.quantities, NLL.name: NLL}
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


@pytest.mark.parametrize("problem", list(problems()), ids=lambda p: p.name)
def test_every_one_step_error_is_a_measure_that_needs_no_truth(problem):
    for name, quantity in problem.scoring.foretold.items():
        assert problem.scoring.measures[name].parts == (quantity,)
        assert not quantity.needs_truth


def test_a_spread_is_the_deviation_of_normal_innovations_whatever_few_outliers_are():
    e = np.random.default_rng(0).normal(0.0, [1.0, 3.0], (2, 4000, 2))
    e[:, ::50] = 1e6
    e[0, ::3, 0] = np.nan  # lost
    np.testing.assert_allclose(spreads(e), [[1.0, 3.0]] * 2, rtol=0.06)


def test_a_spread_of_nothing_cuts_nothing():
    e = np.stack([np.full(5, np.nan), np.zeros(5)], axis=-1)[None]
    assert (spreads(e) == np.inf).all()
    assert one_step_error(cut_squares(e[..., 1:], np.ones((1, 1)), np.full((1, 1), np.inf))) == 0.0


def test_a_one_step_error_of_two_coordinates_is_a_length_and_outliers_are_cut():
    e = np.full((1, 10, 3), [3.0, 4.0, 9.0])
    e[0, 0] = 1e9  # an outlier
    e[0, 1:3, 0] = np.nan  # lost: the other coordinate counts on
    factors, most = np.array([[1.0, 1.0, 0.0]]), np.array([[3.0, 4.0, 5.0]])
    squares = cut_squares(e, factors, most)
    assert one_step_error(squares) == pytest.approx(5.0)
    assert one_step_error(cut_squares(e, 100.0 * factors, most)) == pytest.approx(500.0)
    assert np.isnan(one_step_error(squares[:, :0]))


def test_only_innovations_are_judged_without_the_truth():
    needs = {m.name for m in DECK.measures.values() if not m.needs_truth}
    assert needs == {"rates", "one_step", "likelihood", "consistency"}
    assert AUV.measures["rmse"].needs_truth is True
    assert AUV.measures["likelihood"].needs_truth is False


def test_a_mean_of_ratios_has_no_unit_and_one_quantity_has_its_own():
    assert DECK.measures["composite"].unit == ""
    assert DECK.measures["theta_rate"].unit == "′/s"
    assert AUV.measures["rmse"].axis == "position RMSE, m"
    assert AUV.measures["consistency"].axis == "|ln NIS|"
