"""Rows of a comparison from errors that were made by hand."""

import math

import numpy as np
import pytest
from scipy import stats

import navgym
from navgym.metrics.blocks import Blocks
from navgym.problem import PROBLEMS
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Entry, compare, rows_of
from navgym.tuning.objectives import find_measure

AUV = PROBLEMS["auv"]
RMSE = find_measure(AUV, "rmse")
PLAIN = np.array([4.0, 6.0, 5.0, 5.0] * 2)
BEST = np.array([1.0, 2.0, 1.5, 1.5] * 2)
OURS = np.array([2.0, 3.0, 3.0, 4.0] * 2)


def rows(flags=None, measure=RMSE, reference="plain", **errors):
    """By label."""
    entries = [Entry(label, "kf") for label in errors]
    count = len(next(iter(errors.values())))
    none = dict.fromkeys(errors, np.zeros(count, bool)) | (flags or {})
    made = rows_of(entries, errors, none, reference, ("plain", "best"), measure, AUV)
    return {row.label: row for row in made}


def test_means_have_students_interval():
    row = rows(plain=PLAIN, best=BEST, ours=OURS)["ours"]
    wanted = stats.t.interval(0.95, 7, loc=3.0, scale=stats.sem(OURS))
    assert (row.mean, row.median) == (3.0, 3.0)
    assert (row.low, row.high) == pytest.approx(wanted)


def test_the_plain_filter_scores_nought_and_the_oracle_one():
    found = rows(plain=PLAIN, best=BEST, ours=OURS)
    assert [found[x].score for x in ("plain", "best")] == [0.0, 1.0]
    assert found["ours"].score == pytest.approx((5.0 - 3.0) / (5.0 - 1.5))
    assert found["ours"].gain == pytest.approx(1.0 - 3.0 / 5.0)
    assert found["plain"].gain == 0.0
    assert found["ours"].gain_low < found["ours"].gain < found["ours"].gain_high


def test_a_likelihood_has_no_zero_to_score_from():
    found = rows(plain=PLAIN, best=BEST, ours=OURS, measure=find_measure(AUV, "likelihood"))
    assert all(math.isnan(row.score) for row in found.values())


def test_without_an_oracle_there_is_no_score():
    assert math.isnan(rows(plain=PLAIN, ours=OURS)["ours"].score)


def test_a_run_is_lost_if_flagged_not_finite_or_more_than_ten_times_the_oracles():
    errors = np.array([10.0, 20.1, 1.0, 1.0] * 2)  # ten times the oracle's is not more than that
    flagged = {"ours": np.array([False, False, True, False] * 2)}
    found = rows(plain=PLAIN, best=BEST, ours=errors, flags=flagged)
    assert found["ours"].divergence_rate == 0.5
    assert found["ours"].diverges
    assert found["plain"].divergence_rate == found["best"].divergence_rate == 0.0
    assert rows(plain=PLAIN, ours=10.0 * PLAIN)["ours"].divergence_rate == 0.0
    assert rows(plain=PLAIN, ours=10.1 * PLAIN)["ours"].divergence_rate == 1.0


@pytest.mark.parametrize(("lost", "diverges"), [(1, False), (2, True)])
def test_more_than_one_run_in_a_hundred_must_be_lost_for_a_mean_to_say_nothing(lost, diverges):
    flags = {"ours": np.arange(100) < lost}
    row = rows(plain=np.full(100, 5.0), ours=np.full(100, 3.0), flags=flags)["ours"]
    assert row.divergence_rate == lost / 100
    assert row.diverges is diverges


def test_a_failed_run_leaves_the_median():
    row = rows(plain=PLAIN, best=BEST, ours=np.array([2.0, 3.0, 3.0, np.inf] * 2))["ours"]
    assert (row.mean, row.median, row.divergence_rate) == (math.inf, 3.0, 0.25)
    assert np.isnan([row.low, row.high, row.gain, row.score]).all()
    assert row.diverges


def test_one_log_has_differences_and_no_intervals():
    found = rows(plain=PLAIN[:1], best=BEST[:1], ours=OURS[:1])["ours"]
    assert (found.mean, found.median) == (2.0, 2.0)
    assert (found.gain, found.score) == (0.5, pytest.approx(2.0 / 3.0))
    assert np.isnan([found.low, found.high, found.gain_low, found.gain_high, found.p_value]).all()


@pytest.mark.parametrize("count", [2, 7])
def test_fewer_than_eight_recordings_have_no_intervals(count):
    found = rows(plain=PLAIN[:count], best=BEST[:count], ours=OURS[:count])["ours"]
    assert found.gain == pytest.approx(1.0 - OURS[:count].mean() / PLAIN[:count].mean())
    assert np.isnan([found.low, found.high, found.gain_low, found.gain_high, found.p_value]).all()


def test_a_logarithm_has_differences_and_no_shares():
    likelihood = find_measure(AUV, "likelihood")
    found = rows(plain=-PLAIN, ours=-PLAIN - 0.5 - 0.01 * OURS, measure=likelihood)["ours"]
    assert not found.relative
    assert found.gain == pytest.approx(0.5 + 0.01 * OURS.mean())
    assert 0.5 < found.gain_low < found.gain < found.gain_high


def test_intervals_along_a_log_are_those_of_its_correlated_errors():
    """Errors that hold for 20 samples: a mean of n has the deviation of n / 20 independent ones."""
    rng = np.random.default_rng(0)
    spans, inside = [], 0
    for seed in range(60):
        series = np.repeat(rng.normal(1.0, 1.0, 400), 20)
        means = Blocks.drawn(len(series), 500, seed).means(series)
        low, high = np.quantile(means, [0.025, 0.975])
        spans.append((high - low) / 2.0)
        inside += low <= 1.0 <= high
    assert np.mean(spans) == pytest.approx(1.96 / np.sqrt(400), rel=0.2)
    assert inside / 60 > 0.85


def test_a_log_that_is_too_short_or_failed_has_no_interval():
    assert Blocks.drawn(40, 100) is None
    assert np.isnan(Blocks.drawn(100, 10).means(np.full(100, np.inf))).all()
    np.testing.assert_allclose(Blocks.drawn(100, 10).means(np.full(100, 3.0)), 3.0)


def test_one_log_is_compared_along_itself_and_with_what_is_foretold():
    recording = navgym.simulate("auv/switch-D", seed=2, steps=600)
    blind = navgym.Recording(recording.time, recording.measurements, model=recording.model)
    cases = Cases.of([blind])
    found = compare([Entry("kf", "kf"), Entry("bank", "bank")], cases, "kf", measure="likelihood")
    assert found.intervals == "blocks"
    assert found["bank"].gain_low > 0.0  # switching noise: more likely beyond doubt
    assert found["kf"].gain_low == found["kf"].gain_high == 0.0  # blocks are the same for all
    assert math.isnan(found["bank"].p_value)
    fixes = cases.judge("bank", None, ("fixes",)).quantities["fixes"][0]
    assert found.beside["bank"] == {"fixes": fixes}
    assert not found.nis["kf"].consistent
    assert found.nees["kf"] is None


def test_one_log_without_any_error_is_no_scale_for_a_gain():
    assert math.isnan(rows(plain=np.zeros(1), ours=np.ones(1))["ours"].gain)


def test_parameters_are_those_that_ran():
    entries = [Entry("own", "kf", {"process_noise_scale": 2.0}), Entry("many", "kf", [{}, {}])]
    errors = dict.fromkeys(("own", "many"), OURS)
    flags = dict.fromkeys(errors, np.zeros(8, bool))
    own, many = rows_of(entries, errors, flags, "own", ("plain", "best"), RMSE, AUV)
    assert own.parameters["process_noise_scale"] == 2.0
    assert many.parameters == "schedule"
    assert own.divergence_rate == 0.0  # there is no yardstick to be lost by
