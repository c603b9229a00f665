"""Metrics against closed forms, published figures, and the package's own Kalman filter."""

import math
import warnings

import numpy as np
import pytest
from scipy import stats

import navgym
from navgym import metrics
from navgym.simulation import simulate_many
from navgym.statespace.batch import StateSpaceBatch
from tests.helpers import run

# --- errors ---------------------------------------------------------------------------------------


def test_squared_error_is_the_squared_distance_over_the_chosen_states():
    states = np.array([[[3.0, 9.0, 4.0, 9.0]]])
    assert metrics.squared_error(states, np.zeros((1, 1, 4)), (0, 2)).tolist() == [[25.0]]
    assert metrics.squared_error(states, np.zeros((1, 4)), [1]).tolist() == [[81.0]]


def test_a_failed_estimate_is_infinitely_wrong_and_unknown_truth_is_not_scored():
    states = np.array([[1.0], [np.nan], [np.inf], [1.0], [np.nan]])
    truth = np.array([[0.0], [0.0], [0.0], [np.nan], [np.nan]])
    found = metrics.squared_error(states, truth, [0])
    assert np.array_equal(found, [1, np.inf, np.inf, np.nan, np.nan], equal_nan=True)


def test_means_over_time_runs_and_both():
    squared = np.array([[1.0, 9.0], [25.0, 25.0]])
    assert metrics.run_rmse(squared).tolist() == [math.sqrt(5), 5.0]
    assert metrics.time_rmse(squared).tolist() == [math.sqrt(13), math.sqrt(17)]
    summary = metrics.summarize(squared)
    assert summary.mean == pytest.approx((math.sqrt(5) + 5) / 2)
    assert summary.pooled == pytest.approx(math.sqrt(15))
    assert summary.time_mean == pytest.approx((math.sqrt(13) + math.sqrt(17)) / 2)
    assert summary.divergence_rate == 0.0


def test_samples_that_are_not_scored_do_not_count():
    padded = np.array([[1.0, 9.0, np.nan], [4.0, 4.0, 4.0]])
    assert metrics.run_rmse(padded).tolist() == [math.sqrt(5), 2.0]
    assert metrics.time_rmse(padded)[2] == 2.0


def test_one_failed_run_spoils_the_mean_but_not_the_median():
    squared = np.ones((21, 4))
    squared[3, 2] = np.inf
    summary = metrics.summarize(squared)
    assert (summary.mean, summary.pooled, summary.time_mean) == (np.inf, np.inf, np.inf)
    assert summary.median == 1.0
    assert summary.quantile_95 == 1.0
    assert summary.divergence_rate == pytest.approx(1 / 21)
    squared[5] = np.inf
    assert metrics.summarize(squared).quantile_95 == np.inf


def test_divergence_is_a_flag_a_failure_or_ten_times_the_reference():
    rmse, flags = [1.0, np.nan, 9.9, 10.1, np.inf, 1.0], [False] * 5 + [True]
    assert metrics.divergence(rmse).tolist() == [False, True, False, False, True, False]
    found = metrics.divergence(rmse, flags, reference=1.0)
    assert found.tolist() == [False, True, False, True, True, True]
    assert metrics.divergence([9.0, 9.0], reference=[1.0, 0.5]).tolist() == [False, True]


def test_score_runs_from_nominal_to_oracle():
    assert metrics.score([2.0, 1.0, 1.25, 3.0, np.inf], 2.0, 1.0).tolist() == [
        0, 1, 0.75, -1, -np.inf,
    ]  # fmt: skip
    assert math.isnan(metrics.score(0.7, 0.7, 0.7))


def test_scores_are_shares_whatever_the_unit_of_the_errors():
    assert metrics.score([9.0, 8.0, 5.0], 9.0, 5.0).tolist() == [0.0, 0.25, 1.0]
    assert metrics.score([0.9, 0.8, 0.5], 0.9, 0.5) == pytest.approx([0.0, 0.25, 1.0])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: metrics.squared_error(np.ones((3, 4)), np.ones((3, 4)), [4]), "indices must name"),
        (lambda: metrics.squared_error(np.ones((3, 4)), np.ones((3, 4)), []), "indices must name"),
        (lambda: metrics.squared_error(np.ones((3, 4)), np.ones((2, 4)), [0]), "truth must have"),
        (lambda: metrics.run_rmse([]), "at least one error"),
        (lambda: metrics.run_rmse([-1.0]), "must not be negative, got -1"),
        (lambda: metrics.run_rmse([[np.nan], [1.0]]), "without a single scored sample"),
        (lambda: metrics.summarize([1.0]), r"shape \(N, T\)"),
        (lambda: metrics.summarize([[1.0]], diverged=[True, False]), "diverged must have one"),
        (lambda: metrics.divergence([1.0, 2.0], reference=[1.0] * 3), "reference must have one"),
        (lambda: metrics.score(1.0, -1.0, 0.0), "nominal must be an error"),
        (lambda: metrics.score(1.0, np.nan, 0.0), "nominal must be finite"),
        (lambda: metrics.nis_band([1, -1]), "dof must be at least 0, got -1"),
        (lambda: metrics.nis_band(1, confidence=95), "confidence must lie in 0..1, got 95"),
        (lambda: metrics.consistency([np.nan], 4), "nothing was received"),
        (lambda: metrics.nees(np.ones((3, 2)), np.ones((3, 2)), np.ones((3, 2))), "must match"),
        (
            lambda: metrics.nees(np.ones((1, 2)), np.ones((1, 2, 2)), np.zeros((1, 2))),
            "positive definite",
        ),
        (lambda: metrics.paired_difference([1.0], [2.0]), "at least 2 pairs"),
        (lambda: metrics.paired_difference([1.0, 2.0], [2.0]), "b must have one entry per run"),
        (lambda: metrics.paired_difference([], []), "one number per run"),
        (lambda: metrics.paired_difference([1, 2], [1, 3], resamples=9), "resamples must be"),
        (lambda: metrics.holm([0.1, 1.2]), "numbers in 0..1"),
        (lambda: metrics.holm([0.1, np.nan]), "p_values must be finite"),
        (lambda: metrics.holm([]), "numbers in 0..1"),
        (lambda: metrics.loss_bounds(navgym.LinearModel(), 1.1), "arrival_rate must lie in 0..1"),
        (
            lambda: metrics.steady_state(navgym.LinearModel(dt=[1.0, 2.0])),
            "must not change in time",
        ),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


# --- consistency ----------------------------------------------------------------------------------


def test_bands_of_one_and_of_many():
    low, high = metrics.nis_band([2, 0, 1])
    assert low[0] == pytest.approx(-2 * math.log(0.975))  # chi-square of 2 is exponential
    assert high[0] == pytest.approx(-2 * math.log(0.025))
    assert np.isnan([low[1], high[1]]).all()
    assert high[2] == pytest.approx(1.959964**2 * 1.3056, rel=0.01)
    low, high = metrics.mean_nis_band(np.full(10_000, 4.0))
    assert (low, high) == pytest.approx(
        (4 - 1.96 * math.sqrt(8e-4), 4 + 1.96 * math.sqrt(8e-4)), rel=1e-3
    )


def test_mean_band_takes_in_what_was_received():
    mixed = metrics.mean_nis_band([4, 2, 0, 2])
    alike = metrics.nis_band(8)
    assert np.allclose(np.array(mixed) * 3, alike)
    low, _ = metrics.mean_nis_band([[4, 2], [0, 0]], axis=1)
    assert low[0] == pytest.approx(metrics.nis_band(6)[0] / 2)
    assert math.isnan(low[1])


def test_nees_of_known_numbers():
    states, truth = np.array([[2.0, 3.0]]), np.zeros((1, 2))
    assert metrics.nees(states, np.diag([4.0, 9.0])[None], truth).tolist() == [2.0]
    assert metrics.nees(states, np.diag([4.0, 9.0])[None], truth, indices=[1]).tolist() == [1.0]
    assert np.isnan(metrics.nees(states * np.nan, np.eye(2)[None], truth)).all()
    assert np.isnan(metrics.nees(states, np.eye(2)[None], truth * np.nan)).all()
    assert np.isnan(metrics.nees(states, np.eye(2)[None] * np.nan, truth)).all()


@pytest.fixture(scope="module")
def matched():
    """200 recordings of the nominal scenario (30 % lost), filtered by the matched `kf`."""
    batch = StateSpaceBatch.of(simulate_many("auv/nominal", navgym.seeds("test", 200), steps=150))
    return batch, run("kf", batch, everything=True)


def test_nees_of_the_matched_filter_is_chi_square_at_each_time(matched):
    batch, found = matched
    nees = metrics.nees(found.states, found.covariances, batch.truth)
    low, high = metrics.nis_band(4.0 * len(nees), confidence=0.95)
    inside = (low < nees.sum(axis=0)) & (nees.sum(axis=0) < high)
    assert 0.88 < inside.mean() <= 1.0
    assert metrics.consistency(nees[:, -1], 4, confidence=0.99).consistent
    # values along a run are correlated, those at distant times of 200 runs hardly: their law holds
    p = stats.kstest(nees[:, ::50].ravel(), stats.chi2(4).cdf).pvalue
    assert p > 0.01


def test_position_nees_is_chi_square_with_two_degrees(matched):
    batch, found = matched
    nees = metrics.nees(found.states, found.covariances, batch.truth, indices=(0, 2))
    assert metrics.consistency(nees[:, -1], 2, confidence=0.99).consistent


@pytest.mark.parametrize("scenario", ["nominal", "component-loss", "position-only"])
def test_nis_of_the_matched_filter_is_chi_square_in_what_was_received(scenario):
    batch = StateSpaceBatch.of(
        simulate_many(f"auv/{scenario}", navgym.seeds("test", 100), steps=200)
    )
    nis = run("kf", batch, everything=True).nis
    dof = metrics.degrees_of_freedom(batch.lost)
    assert np.array_equal(np.isnan(nis), dof == 0)
    found = metrics.consistency(nis, dof, confidence=0.99)
    assert found.samples == (dof > 0).sum()
    assert found.consistent
    assert found.inside == pytest.approx(0.99, abs=0.003)
    judged = dof > 0
    assert stats.kstest(stats.chi2.cdf(nis[judged], dof[judged]), "uniform").pvalue > 0.01


def test_a_wrong_measurement_noise_is_found_out(matched):
    batch, _ = matched
    bold = run("kf", batch, {"measurement_noise_scale": 0.7}, everything=True).nis
    timid = run("kf", batch, {"measurement_noise_scale": 1.5}, everything=True).nis
    dof = metrics.degrees_of_freedom(batch.lost)
    bold, timid = (metrics.consistency(nis, dof) for nis in (bold, timid))
    assert bold.mean > bold.high
    assert timid.mean < timid.low


# --- bounds ---------------------------------------------------------------------------------------


def test_riccati_limit_of_the_papers_model():
    model = navgym.LinearModel()
    filtered = metrics.steady_state(model).filtered
    assert np.allclose(np.diag(filtered), [0.189449, 0.004703] * 2, atol=5e-7)
    assert metrics.rms(filtered, model.position) == pytest.approx(0.61555, abs=5e-6)


def test_riccati_solution_satisfies_its_equation():
    model = navgym.LinearModel.white_acceleration(0.5, velocity_noise=None)
    found = metrics.steady_state(model)
    F, H, Q, R = model.F, model.H, model.Q, model.R
    assert np.allclose(found.predicted, F @ found.filtered @ F.T + Q, rtol=1e-9)
    information = np.linalg.inv(found.predicted) + H.T @ np.linalg.inv(R) @ H
    assert np.allclose(found.filtered, np.linalg.inv(information), rtol=1e-7)
    assert np.allclose(found.gain, found.filtered @ H.T @ np.linalg.inv(R), rtol=1e-7)


def test_the_filter_settles_on_the_riccati_limit():
    recording = navgym.simulate("auv/nominal", seed=navgym.seeds("test", 1)[0], steps=400, loss=0.0)
    covariance = navgym.estimate("kf", recording).covariances[-1]
    limit = metrics.steady_state(recording.model).filtered
    assert np.abs(covariance - limit).max() < 1e-10


def test_errors_of_the_filter_reach_the_riccati_limit():
    batch = StateSpaceBatch.of(
        simulate_many("auv/nominal", navgym.seeds("test", 200), steps=300, loss=0.0)
    )
    squared = metrics.squared_error(run("kf", batch).states, batch.truth, (0, 2))[:, 100:]
    limit = metrics.rms(metrics.steady_state(navgym.LinearModel()).filtered, (0, 2))
    assert metrics.summarize(squared).pooled == pytest.approx(limit, rel=0.02)


def test_a_state_that_is_never_seen_has_no_steady_state():
    with pytest.raises(ValueError, match=r"does not settle.*measure every state"):
        metrics.steady_state(navgym.LinearModel(H=np.eye(4)[[1, 3]]))


def sinopoli():
    """The scalar example of Sinopoli et al. 2004."""
    return navgym.LinearModel(F=[[-1.25]], H=[[1.0]], Q=[[1.0]], R=[[2.5]])


@pytest.mark.parametrize(
    ("rate", "lower", "upper"), [(0.5, 4.571, 11.956), (0.7, 1.882, 5.401), (1.0, 1.0, 3.190)]
)
def test_bounds_under_loss_of_sinopolis_example(rate, lower, upper):
    bounds = metrics.loss_bounds(sinopoli(), rate)
    assert bounds.lower.item() == pytest.approx(lower, abs=5e-4)
    assert bounds.upper.item() == pytest.approx(upper, abs=5e-4)


def test_critical_arrival_rates():
    assert metrics.critical_arrival_rate(sinopoli()) == pytest.approx(0.36)
    assert metrics.critical_arrival_rate(navgym.LinearModel()) == pytest.approx(0.0, abs=1e-7)
    assert np.isinf(metrics.loss_bounds(sinopoli(), 0.36).lower).all()
    assert np.isfinite(metrics.loss_bounds(sinopoli(), 0.37).upper).all()


def test_unstable_state_unseen_by_H_has_no_upper_bound():
    model = navgym.LinearModel(F=np.diag([1.1, 1.1]), H=[[1.0, 0.0]])
    assert np.isinf(metrics.loss_bounds(model, 0.9).upper).all()


@pytest.mark.parametrize("rate", [0.5, 0.7, 1.0])
def test_mean_covariance_of_the_filter_lies_between_the_bounds(rate):
    model = sinopoli()
    arrived = np.random.default_rng(4).random((100, 1000)) < rate
    # covariances do not depend on what is measured, so the unstable truth is left out
    recordings = [
        navgym.Recording(np.arange(1000.0), np.zeros((1000, 1)), lost=~a, model=model)
        for a in arrived
    ]
    filtered = run("kf", StateSpaceBatch.of(recordings), everything=True).covariances[:, 50:, 0, 0]
    mean = (1.25**2 * filtered + 1.0).mean()
    bounds = metrics.loss_bounds(model, rate)
    assert bounds.lower.item() < mean < bounds.upper.item() + 1e-9


def test_upper_bound_without_loss_is_the_riccati_limit():
    model = navgym.LinearModel()
    upper = metrics.loss_bounds(model, 1.0).upper
    assert np.allclose(upper, metrics.steady_state(model).predicted, rtol=1e-9)


# --- comparisons ----------------------------------------------------------------------------------


def test_paired_difference_of_known_numbers():
    b = np.array([2.0, 3.0, 4.0, 5.0])
    found = metrics.paired_difference(b - [1, 2, 1, 2], b)
    assert found.pairs == 4
    assert found.mean_difference == -1.5
    assert found.median_difference == -1.5
    assert found.relative_gain == pytest.approx(1 - 2 / 3.5)
    assert found.low < -1.5 < found.high < 0
    assert found.p_value == pytest.approx(2 / 2**4)  # exact: two of the sixteen sign patterns


def test_the_same_seed_gives_the_same_answer_and_sides_mirror():
    rng = np.random.default_rng(0)
    a, b = rng.gamma(4, size=(2, 50))
    assert metrics.paired_difference(a, b, seed=3) == metrics.paired_difference(a, b, seed=3)
    assert metrics.paired_difference(a, b).mean_difference == pytest.approx(
        -metrics.paired_difference(b, a).mean_difference
    )


@pytest.mark.parametrize(("confidence", "low"), [(0.95, 0.0), (0.9, 0.0), (0.85, 1.0), (0.5, 1.0)])
def test_an_interval_without_acceleration_leaves_out_the_tails_of_the_resamples(confidence, low):
    """Whichever pair is left out, b keeps an error and the gain is 1: BCa divides 0 by 0.

    A resample of 4 has no error at all, and so no gain, with probability (1/2)⁴: more than the
    lower tail holds at 0.9 and above, less at 0.85.
    """
    found = metrics.paired_difference(np.zeros(4), [0.0, 0.0, 1.0, 1.0], confidence=confidence)
    assert (found.relative_gain, found.gain_low, found.gain_high) == (1.0, low, 1.0)


@pytest.mark.parametrize(("shift", "factor"), [(0.0, 1.0), (-1.0, 1.0), (0.0, 0.9)])
def test_differences_without_spread_give_points_and_no_warning(shift, factor):
    b = np.random.default_rng(0).gamma(9, size=40)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = metrics.paired_difference(factor * b + shift, b)
    assert np.isfinite([found.low, found.high, found.gain_low, found.gain_high]).all()
    if factor == 1.0:
        assert found.low == pytest.approx(shift, abs=1e-12)
        assert found.high == pytest.approx(shift, abs=1e-12)
    else:
        assert (found.gain_low, found.gain_high) == pytest.approx((0.1, 0.1), abs=1e-12)
    assert (found.p_value == 1.0) == (shift == 0.0 and factor == 1.0)


def test_a_gain_over_no_error_at_all_has_no_scale():
    found = metrics.paired_difference([1.0, 2.0], [0.0, 0.0])
    assert found.mean_difference == 1.5
    assert np.isnan([found.relative_gain, found.gain_low, found.gain_high]).all()


def test_failed_runs_leave_the_median_and_the_rates():
    found = metrics.paired_difference([1.0, 2.0, np.inf, np.nan], [3.0, 3.0, 3.0, 3.0])
    assert (found.failed_a, found.failed_b) == (0.5, 0.0)
    assert found.median_difference == -1.0
    assert math.isnan(found.mean_difference)
    assert math.isnan(found.p_value)
    both = metrics.paired_difference([np.inf, np.inf, 1.0], [np.inf, np.inf, 2.0])
    assert both.median_difference == 0.0


def test_intervals_cover_the_truth_as_often_as_they_claim():
    """Skewed errors of 30 pairs with a true mean difference of −.5 and a true gain of 1/8."""
    rng = np.random.default_rng(5)
    covered = {"difference": 0, "gain": 0}
    rejected = 0
    for trial in range(200):
        b = rng.gamma(4.0, 1.0, 30)
        noise = rng.gamma(4.0, 0.25, 30) - 1.0
        found = metrics.paired_difference(b - 0.5 + noise, b, resamples=499, seed=trial)
        covered["difference"] += found.low <= -0.5 <= found.high
        covered["gain"] += found.gain_low <= 0.125 <= found.gain_high
        rejected += (
            metrics.paired_difference(b + noise, b, resamples=499, seed=trial).p_value < 0.05
        )
    # 95 % ± 3 binomial standard deviations; the bootstrap falls a little short at 30 pairs
    assert 0.89 <= covered["difference"] / 200 <= 0.99
    assert 0.89 <= covered["gain"] / 200 <= 0.99
    assert rejected / 200 <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 200)


def test_holm_takes_certainty_and_its_opposite():
    assert metrics.holm([0.0, 1.0, 0.0]).tolist() == [0.0, 1.0, 0.0]


def test_holm_of_a_worked_example():
    assert np.allclose(metrics.holm([0.01, 0.04, 0.03, 0.005]), [0.03, 0.06, 0.06, 0.02])
    assert metrics.holm([0.9, 0.8]).tolist() == [1.0, 1.0]
    assert metrics.holm([0.2]).tolist() == [0.2]
