"""A log means the same however it is cut: empty rows, a gap in time and finer rows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import navgym
from navgym.statespace.filters.catalogue import CATALOGUE
from navgym.statespace.models import process_noise

# Those that take a lost row for a datum: what they do with it is what they are.
ROW_BY_ROW = {"kf_zero", "kf_hold", "kf_extrapolate", "qivbf_printed"}
FILTERS = sorted(set(CATALOGUE) - ROW_BY_ROW - {"oracle"})


def log(time, kept, y, dt0, own=None):
    """A recording whose rows stand at `time`; those that are not `kept` are empty."""
    dt = np.diff(time, prepend=time[0] - dt0)
    rows = np.full((len(time), 4), np.nan)
    rows[kept] = y
    if own is not None:
        A, D = own
        model = navgym.LinearModel.from_continuous(
            A, D, dt, H=np.eye(4), R=np.diag([1.0, 0.04, 2.0, 0.04]), P0=4.0 * np.eye(4)
        )
    else:
        model = navgym.LinearModel.white_acceleration(dt, 0.2, x0=np.zeros(4))
    return navgym.Recording(time=time, measurements=rows, model=model)


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 10**6), own=st.booleans(), apart=st.booleans())
@pytest.mark.parametrize("name", FILTERS)
def test_empty_rows_and_gaps_change_nothing(name, seed, own, apart):
    """Estimates at the samples that were received are those of the log without the other rows.

    Whether axes are lost together or apart (`apart`), so that the bank's two forms are both met.
    """
    rng = np.random.default_rng(seed)
    steps = rng.choice([0.1, 0.5, 1.0, 1.7, 40.0, 300.0], size=25)
    time = np.cumsum(steps)
    y = rng.normal(size=(25, 4)).cumsum(axis=0)
    if apart:
        y[rng.random((25, 4)) < 0.3] = np.nan
    y[0] = 0.0
    more = rng.uniform(time[0], time[-1], size=60)
    finer = np.unique(np.concatenate([time, more[np.abs(more[:, None] - time).min(1) > 1e-3]]))
    kept = np.isin(finer, time)
    drift = (np.diag([1.0, 0.0, 1.0], 1) - np.diag([0.0, 0.05, 0.0, 0.05])) if own else None
    model = (drift, np.diag([0.0, 0.04, 0.01, 0.02])) if own else None
    short = navgym.estimate(name, log(time, np.arange(25), y, steps[0], model))
    long = navgym.estimate(name, log(finer, kept, y, steps[0], model))
    scale = 1e-9 * (1.0 + np.abs(short.states).max())
    np.testing.assert_allclose(long.states[kept], short.states, rtol=1e-6, atol=scale)
    np.testing.assert_allclose(long.covariances[kept], short.covariances, rtol=1e-5, atol=scale)
    np.testing.assert_allclose(long.nis[kept], short.nis, rtol=1e-5, atol=1e-7)
    assert long.diverged == short.diverged


@pytest.mark.parametrize("name", sorted(ROW_BY_ROW))
def test_those_that_are_left_out_do_take_an_empty_row_for_a_datum(name):
    time = np.arange(1.0, 21.0)
    y = np.tile([3.0, 0.5, -3.0, 0.5], (20, 1)) * time[:, None]
    late = np.concatenate([time[:10], time[10:] + 30.0])
    finer = np.arange(1.0, 51.0)
    short = navgym.estimate(name, log(late, np.arange(20), y, 1.0))
    long = navgym.estimate(name, log(finer, np.isin(finer, late), y, 1.0))
    assert np.abs(long.states[np.isin(finer, late)] - short.states).max() > 1e-3


def test_process_noise_adds_up_over_time():
    """Q(s + t) = F(t) Q(s) F(t)ᵀ + Q(t), for any density, and table 2's Q over one second."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(2, 2))
    for density in (root @ root.T, np.diag([0.0, 0.09])):
        s, t = 0.7, 12.3
        F = navgym.LinearModel(dt=t).F
        both = F @ process_noise(s, density) @ F.T + process_noise(t, density)
        np.testing.assert_allclose(process_noise(s + t, density), both, rtol=1e-12)
    table_2 = 1e-3 * np.diag([1.0, 0.5, 1.0, 0.5])
    np.testing.assert_allclose(navgym.LinearModel().Q, table_2, atol=1e-18)
    a, b = navgym.LinearModel(dt=3.0), navgym.LinearModel(dt=1.0)
    thrice = b.F @ b.F @ b.Q @ b.F.T @ b.F.T + b.F @ b.Q @ b.F.T + b.Q
    np.testing.assert_allclose(a.Q, thrice, rtol=1e-12, atol=1e-18)


def test_sixty_seconds_without_a_fix():
    """White acceleration a over t: the position wanders by a √(t³/3), one row or six thousand."""
    for rows in (1, 60, 6000):
        dt = np.full(rows, 60.0 / rows)
        model = navgym.LinearModel.white_acceleration(dt, 0.1, P0=1e-12 * np.eye(4))
        found = navgym.estimate(
            "kf",
            navgym.Recording(
                time=np.cumsum(dt), measurements=np.full((rows, 4), np.nan), model=model
            ),
        )
        np.testing.assert_allclose(
            found.covariances[-1, 0, 0] ** 0.5, 0.1 * (60.0**3 / 3) ** 0.5, rtol=1e-6
        )


def test_a_model_of_ones_own_in_continuous_time():
    """Van Loan: e^{A dt} and Q by the semigroup; constant velocity is its special case."""
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1.0
    D = np.diag([0.0, 0.09, 0.0, 0.09])
    dt = np.array([0.5, 7.0])
    own = navgym.LinearModel.from_continuous(A, D, dt)
    usual = navgym.LinearModel.white_acceleration(dt, 0.3)
    np.testing.assert_allclose(own.F, usual.F, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(own.Q, usual.Q, rtol=1e-10, atol=1e-12)
