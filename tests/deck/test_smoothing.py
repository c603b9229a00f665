"""`navgym.smooth` on decks: what a fixed lag tells, and errors as large as they are told."""

from __future__ import annotations

import numpy as np
import pytest

import navgym
from navgym.deck.alignment import RATE, THETA
from navgym.deck.errors import deck_errors
from navgym.problem import PROBLEMS


def stacked(recording):
    return PROBLEMS["deck"].stack([recording])


@pytest.mark.parametrize("steps", [500, 601])  # within a stretch, and across two marks
def test_one_mode_smoothed_is_what_its_lagged_states_say(steps):
    """θ̇ two steps before the end by everything: the filter that carries θ̇ along has the same."""
    recording = navgym.simulate("deck/switch-60", 3, duration=steps * 0.05)
    lagged = navgym.estimate("oracle", recording).extras["theta_rate_lagged"]
    smoothed = navgym.smooth("oracle", recording)
    sd = np.sqrt(np.diagonal(smoothed.covariances, axis1=1, axis2=2))[:, RATE]
    for lag in (1, 2):
        off = smoothed.theta_rate[-1 - lag] - lagged[-1, lag - 1]
        assert np.abs(off / sd[-1 - lag]).max() < 1e-6


def test_smoothing_takes_a_third_off_the_rate_and_nine_tenths_off_the_fast_deformation():
    gains, told = [], []
    for seed in navgym.seeds("train", 2):
        recording = navgym.simulate("deck/switch-60", seed, duration=240.0)
        batch = stacked(recording)
        after, before = (f("deck_bank_lever", recording) for f in (navgym.smooth, navgym.estimate))
        errors = [deck_errors(batch, e.states[None]).norm for e in (after, before)]
        gains.append(
            [errors[0][n][0] / errors[1][n][0] for n in ("theta_rate", "theta_ac", "theta")]
        )
        P, off = after.covariances, after.states[:, 18:] - batch.truth[0]
        assert (np.linalg.eigvalsh(P[::50]) > 0.0).all()
        for block in (THETA, RATE):
            own = slice(block.start - 18, block.stop - 18)
            whitened = np.linalg.solve(P[:, block, block], off[:, own, None])[..., 0]
            told.append((off[:, own] * whitened)[1200:].sum(axis=1).mean() / 3.0)
    rate, fast, slow = np.mean(gains, axis=0)
    assert rate < 0.8
    assert fast < 0.2
    assert slow < 1.0
    assert np.mean(told[1::2]) == pytest.approx(0.95, abs=0.25)  # θ̇
    assert 0.3 < np.mean(told[::2]) < 2.0  # θ: one constant offset in a recording, few of them


def test_where_nothing_happens_the_bank_smooths_as_its_one_mode():
    recording = navgym.simulate("deck/paper", 2, duration=120.0)
    bank, one = navgym.smooth("deck_bank", recording), navgym.smooth("oracle", recording)
    sd = np.sqrt(np.diagonal(one.covariances, axis1=1, axis2=2))
    assert np.abs((bank.states - one.states) / sd)[400:].max() < 0.3
