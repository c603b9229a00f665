"""Shrinkage toward a prior."""

import numpy as np
import pytest

from navgym.identification import identify, shrink
from navgym.inertial.flexure import FlexureModel
from tests.identification.world import PAPER, logarithms, rms_ln_b, simulate

NEW = FlexureModel(1.0, 2.0, 3.0, deviation=np.full((3, 3), 0.5))


def test_equal_precisions_meet_at_the_geometric_mean():
    between = shrink(NEW, FlexureModel(4.0, 8.0, 12.0), 0.5)
    np.testing.assert_allclose(between.damping, 2.0)
    np.testing.assert_allclose(between.stiffness, 4.0)
    np.testing.assert_allclose(between.sigma, 6.0)
    np.testing.assert_allclose(between.deviation, 0.5 / np.sqrt(2.0))


def test_a_wide_prior_says_nothing_and_a_narrow_one_everything():
    prior = FlexureModel(4.0, 8.0, 12.0)
    np.testing.assert_allclose(logarithms(shrink(NEW, prior, 1e6)), logarithms(NEW), atol=1e-9)
    np.testing.assert_allclose(logarithms(shrink(NEW, prior, 1e-6)), logarithms(prior), atol=1e-9)


def test_the_prior_may_bring_its_own_deviation():
    prior = FlexureModel(4.0, 8.0, 12.0, deviation=np.full((3, 3), 0.5))
    assert shrink(NEW, prior).damping == pytest.approx(2.0)


def test_short_windows_gain_by_shrinkage():
    records = simulate(PAPER, 60.0, 0.5, runs=12, seed=2)
    alone = [identify("regression", r, 0.5) for r in records]
    shrunk = [shrink(m, PAPER, 0.3) for m in alone]
    assert (rms_ln_b(shrunk, PAPER) < 0.75 * rms_ln_b(alone, PAPER)).all()


# three axes and three parameters, each with a certainty of its own
FOUND = FlexureModel(
    [0.4, 0.6, 0.1], [0.05, 0.02, 0.3], [2e-3, 3e-3, 1e-3],
    deviation=[[0.3, 0.5, 0.2], [0.7, 0.4, 0.9], [0.6, 1.1, 0.25]], evidence=[1.0, 2.0, 3.0],
    diagnostics={"duration": 90.0, "method": "by hand"},
)  # fmt: skip
BELIEF = FlexureModel([0.5, 0.3, 0.2], [0.04, 0.09, 0.16], [1e-3, 5e-3, 2e-3])
SPREAD = np.array([[0.5, 0.2, 0.4], [0.3, 0.8, 0.1], [0.9, 0.35, 0.6]])
# the sampling limit (2, 2, 1)/√(bW) of 90 s, with the b of BELIEF: 0.2, 0.3 and 0.4 rad/s
LIMIT = np.array([[2.0, 2.0, 1.0]]) / np.sqrt([[0.2 * 90.0], [0.3 * 90.0], [0.4 * 90.0]])


def weighted(deviation, spread):
    """Logarithms and deviations of two independent Gaussians, multiplied: each number by itself."""
    ours, theirs = 1.0 / deviation**2, 1.0 / spread**2
    mean = (ours * logarithms(FOUND) + theirs * logarithms(BELIEF)) / (ours + theirs)
    return mean, 1.0 / np.sqrt(ours + theirs)


def without_deviation(**diagnostics):
    """FOUND, as sure of itself as can be."""
    return FlexureModel(
        FOUND.damping, FOUND.stiffness, FOUND.sigma, deviation=np.zeros((3, 3)),
        diagnostics=diagnostics,
    )  # fmt: skip


@pytest.mark.parametrize("spread", [0.4, SPREAD[0], SPREAD], ids=["number", "row", "per axis"])
def test_logarithms_are_weighted_by_their_precisions(spread):
    mean, deviation = weighted(FOUND.deviation, np.broadcast_to(spread, (3, 3)))
    found = shrink(FOUND, BELIEF, spread)
    np.testing.assert_allclose(logarithms(found), mean, rtol=1e-12)
    np.testing.assert_allclose(found.deviation, deviation, rtol=1e-12)


@pytest.mark.parametrize("multiple", [0.5, 1.0, 2.0])
def test_sampling_adds_a_variance_to_the_model_s_own(multiple):
    own = np.hypot(FOUND.deviation, multiple * LIMIT)
    mean, deviation = weighted(own, SPREAD)
    found = shrink(FOUND, BELIEF, SPREAD, sampling=multiple)
    np.testing.assert_allclose(logarithms(found), mean, rtol=1e-12)
    np.testing.assert_allclose(found.deviation, deviation, rtol=1e-12)


def test_a_fit_that_claims_certainty_is_held_to_the_sampling_limit():
    sure = without_deviation(duration=90.0)
    np.testing.assert_allclose(logarithms(shrink(sure, BELIEF, SPREAD)), logarithms(sure))
    found = shrink(sure, BELIEF, LIMIT, sampling=1.0)  # a prior that is just as uncertain
    np.testing.assert_allclose(
        logarithms(found), (logarithms(sure) + logarithms(BELIEF)) / 2.0, rtol=1e-12
    )
    np.testing.assert_allclose(found.deviation, LIMIT / np.sqrt(2.0), rtol=1e-12)


def test_the_sampling_limit_falls_with_the_root_of_the_duration():
    twice = shrink(without_deviation(duration=40.0), BELIEF, SPREAD, sampling=2.0)
    longer = shrink(without_deviation(duration=10.0), BELIEF, SPREAD, sampling=1.0)
    np.testing.assert_allclose(logarithms(twice), logarithms(longer), rtol=1e-12)


def test_more_sampling_error_moves_the_answer_to_the_prior():
    away = [
        np.abs(logarithms(shrink(FOUND, BELIEF, SPREAD, sampling=k)) - logarithms(BELIEF))
        for k in (0.0, 1e-6, 0.5, 1.0, 4.0, 1e6)
    ]
    np.testing.assert_allclose(away[1], away[0], rtol=1e-9)
    assert (np.diff(away[1:], axis=0) < 0.0).all()
    np.testing.assert_allclose(away[-1], 0.0, atol=1e-9)
    vague = shrink(FOUND, BELIEF, SPREAD, sampling=1e6)
    np.testing.assert_allclose(vague.deviation, SPREAD, rtol=1e-9)


def test_no_answer_is_less_certain_than_either_source():
    found = shrink(FOUND, BELIEF, SPREAD)
    assert (found.deviation < np.minimum(FOUND.deviation, SPREAD)).all()
    for spread, limit in ((1e4, FOUND.deviation), (1e-4, 1e-4)):
        np.testing.assert_allclose(shrink(FOUND, BELIEF, spread).deviation, limit, rtol=1e-6)


@pytest.mark.parametrize("multiple", [0.0, 1.5])
def test_errors_that_offset_each_other_follow_bayes(multiple):
    """In information form: (C⁻¹ + S⁻¹)⁻¹ (C⁻¹ m + S⁻¹ p), with the whole of C."""
    rng = np.random.default_rng(4)
    factor = 0.4 * rng.standard_normal((3, 3, 3))
    own = factor @ factor.transpose(0, 2, 1) + 0.01 * np.eye(3)
    model = FlexureModel(
        FOUND.damping, FOUND.stiffness, FOUND.sigma,
        deviation=np.ones((3, 3)),  # the covariance knows better
        diagnostics={"covariance": own, "duration": 90.0},
    )  # fmt: skip
    found = shrink(model, BELIEF, SPREAD, sampling=multiple)
    for axis in range(3):
        ours = np.linalg.inv(own[axis] + np.diag(multiple * LIMIT[axis]) ** 2)
        theirs = np.diag(SPREAD[axis] ** -2.0)
        posterior = np.linalg.inv(ours + theirs)
        mean = posterior @ (ours @ logarithms(model)[axis] + theirs @ logarithms(BELIEF)[axis])
        np.testing.assert_allclose(logarithms(found)[axis], mean, rtol=1e-10)
        np.testing.assert_allclose(
            found.diagnostics["covariance"][axis], posterior, rtol=1e-9, atol=1e-12
        )
        np.testing.assert_allclose(found.deviation[axis], np.sqrt(np.diag(posterior)), rtol=1e-9)


def test_two_priors_in_turn_are_one_prior_that_is_the_product_of_both():
    once = shrink(shrink(FOUND, BELIEF, SPREAD), BELIEF, SPREAD)
    both = shrink(FOUND, BELIEF, SPREAD / np.sqrt(2.0))
    np.testing.assert_allclose(logarithms(once), logarithms(both), rtol=1e-12)
    np.testing.assert_allclose(once.deviation, both.deviation, rtol=1e-12)


def test_what_else_the_identification_told_is_kept():
    found = shrink(FOUND, BELIEF, SPREAD)
    np.testing.assert_array_equal(found.evidence, FOUND.evidence)
    assert found.diagnostics["method"] == "by hand"
    assert found.diagnostics["duration"] == 90.0
    assert "covariance" not in FOUND.diagnostics


def test_an_identified_model_knows_its_duration():
    model = identify("regression", simulate(PAPER, 60.0, 0.5, seed=3)[0], 0.5)
    found = shrink(model, PAPER, 0.3, sampling=1e9)
    np.testing.assert_allclose(logarithms(found), logarithms(PAPER), atol=1e-9)


def test_errors_name_the_remedy():
    with pytest.raises(ValueError, match="spread must be given"):
        shrink(NEW, FlexureModel(1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="spread must be positive"):
        shrink(NEW, NEW, -1.0)
    with pytest.raises(ValueError, match="model must have a deviation"):
        shrink(FlexureModel(1.0, 1.0, 1.0), NEW)
    with pytest.raises(ValueError, match="spread must be positive"):
        shrink(NEW, NEW, 0.0)
    with pytest.raises(ValueError, match="spread must be positive"):
        shrink(NEW, NEW, np.ones(2))
    with pytest.raises(ValueError, match="its record has a duration"):
        shrink(NEW, NEW, sampling=1.0)
    with pytest.raises(ValueError, match="sampling"):
        shrink(FOUND, NEW, sampling=-1.0)
