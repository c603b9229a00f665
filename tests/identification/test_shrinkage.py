"""Shrinkage toward a prior."""

import numpy as np
import pytest

from navgym.identification import identify, shrink
from navgym.identification.flexure import FlexureModel
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


def test_errors_name_the_remedy():
    with pytest.raises(ValueError, match="spread must be given"):
        shrink(NEW, FlexureModel(1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="spread must be positive"):
        shrink(NEW, NEW, -1.0)
    with pytest.raises(ValueError, match="model must have a deviation"):
        shrink(FlexureModel(1.0, 1.0, 1.0), NEW)
