"""Innovations that are correlated are told from white ones, outliers and losses or not."""

import numpy as np
import pytest

import navgym
from navgym.metrics import whiteness
from navgym.tuning.papers.worlds import worlds


def test_white_noise_is_seldom_called_correlated():
    rng = np.random.default_rng(1)
    y = rng.standard_normal((400, 500))
    y[rng.random(y.shape) < 0.1] *= 10.0
    y[rng.random(y.shape) < 0.3] = np.nan
    assert whiteness(y).correlated.mean() < 0.01


@pytest.mark.parametrize("memory", [0.3, -0.3, 0.9])
def test_lag_and_blocks_are_those_of_an_autoregression(memory):
    """ρ₁ = φ; Var Σ over blocks of B is B + 2 Σ (B − l) φˡ times the variance."""
    rng = np.random.default_rng(2)
    y = rng.standard_normal((40_000, 2))
    for k in range(1, len(y)):
        y[k] = memory * y[k - 1] + np.sqrt(1.0 - memory**2) * y[k]
    found = whiteness(y)
    lags = np.arange(1, 20)
    np.testing.assert_allclose(found.lag, memory, atol=0.02)
    np.testing.assert_allclose(
        found.block, 1.0 + 2.0 * ((20 - lags) * memory**lags).sum() / 20.0, rtol=0.12
    )
    assert found.correlated.all()


def test_too_few_innovations_say_nothing():
    found = whiteness(np.full((30, 1), np.nan))
    assert np.isnan(found.lag).all()
    assert not found.correlated.any()
    with pytest.raises(ValueError, match=r"innovations must have shape \(T, m\)"):
        whiteness(np.zeros(5))


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [
        ("position noise AR(.9)", 0.9, 1.0),
        ("swaying 0.05 m/s², 60 s", 0.5, 1.0),
        ("nominal", 0.0, 0.1),
        ("switch-D", 0.0, 0.1),
    ],
)
def test_the_bank_says_so_where_it_takes_noise_for_motion(name, least, most):
    """Under noise that is correlated in time its NEES is 10 and its NIS is 1."""
    (world,) = (w for w in worlds() if w.name == name)
    estimates = [navgym.estimate("bank", r) for r in world.cases("train", 20).recordings]
    said = np.mean(["correlated" in e.health for e in estimates])
    assert least <= said <= most
