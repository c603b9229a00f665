"""Errors of deck filters, on errors that were made by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import navgym
from navgym.deck.alignment import FLEXING, THETA
from navgym.deck.batch import DeckBatch
from navgym.deck.errors import deck_errors, moving_mean
from navgym.inertial.flexure import ARCMIN
from navgym.simulation import simulate_many
from tests.helpers import run_deck

NAMES = ("attitude", "theta", "static", "theta_rate", "theta_ac")


@pytest.fixture(scope="module")
def batch():
    """Two voyages of 200 s and one of 160 s."""
    return DeckBatch.of(
        [
            *simulate_many("deck/paper", [0, 1], duration=200.0),
            navgym.simulate("deck/paper", 2, duration=160.0),
        ]
    )


@pytest.fixture(scope="module")
def perfect(batch):
    """States (N, K, 24) of a filter that knows θ, θ̇ and the attitude, whatever l it holds."""
    states = np.zeros((*batch.tapes.shape, 24))
    states[..., FLEXING] = np.nan_to_num(batch.truth)
    for i, r in enumerate(batch.recordings):
        tape = batch.tapes[i, : r.steps]
        main, sub = (
            Rotation.from_quat(np.array(tape[n]), scalar_first=True) for n in ("q_m", "q_s")
        )
        start = main * Rotation.from_quat(np.array(r.at_steps(r.reference))) * sub.inv()
        v = start.as_rotvec()
        angle = np.linalg.norm(v, axis=1, keepdims=True)
        states[i, : r.steps, :3] = np.tan(angle / 2.0) * v / angle
    return states


def test_truth_has_no_errors(batch, perfect):
    found = deck_errors(batch, perfect)
    assert set(found.axes) == set(found.norm) == set(NAMES)
    for name in NAMES:
        assert found.axes[name].shape == (3, 3)
        assert found.norm[name].shape == (3,)
        assert found.axes[name].max() < 1e-6


def test_a_constant_offset_of_theta_is_slow(batch, perfect):
    """It counts in θ and in the static part, which takes it off the attitude; not in theta_ac."""
    states = perfect.copy()
    states[..., THETA] += np.array([3.0, 4.0, 12.0]) * ARCMIN
    found = deck_errors(batch, states)
    np.testing.assert_allclose(found.axes["theta"], np.tile([3.0, 4.0, 12.0], (3, 1)), rtol=1e-9)
    np.testing.assert_allclose(found.norm["theta"], 13.0, rtol=1e-9)
    np.testing.assert_allclose(found.axes["static"], np.tile([3.0, 4.0, 12.0], (3, 1)), atol=0.2)
    assert found.axes["theta_ac"].max() < 1e-9
    assert found.axes["attitude"].max() < 1e-6
    assert found.axes["theta_rate"].max() < 1e-9


@pytest.mark.parametrize(
    ("period", "low", "high"), [(5.0, 0.95, 1.05), (20.0, 0.95, 1.05), (600.0, 0.0, 0.1)]
)
def test_only_waves_faster_than_a_minute_count_as_fast(period, low, high, batch, perfect):
    states = perfect.copy()
    t = batch.step * np.arange(1, batch.tapes.shape[1] + 1)
    states[..., THETA.start] += 2.0 * ARCMIN * np.sin(2.0 * np.pi * t / period)
    found = deck_errors(batch, states)
    ratio = found.axes["theta_ac"][:2, 0] / np.sqrt(2.0)
    assert (low <= ratio).all()
    assert (ratio <= high).all()
    assert found.axes["theta_ac"][:, 1:].max() < 1e-9


def test_an_offset_of_the_rate_is_in_arcminutes_per_second(batch, perfect):
    states = perfect.copy()
    states[..., 23] += 0.5 * ARCMIN
    found = deck_errors(batch, states)
    np.testing.assert_allclose(found.axes["theta_rate"][:, 2], 0.5, rtol=1e-9)
    np.testing.assert_allclose(found.norm["theta_rate"], 0.5, rtol=1e-9)
    assert found.axes["theta"].max() < 1e-9


def test_a_wrong_l_turns_attitude_and_static_deformation_by_twice_as_much(batch, perfect):
    states = perfect.copy()
    states[..., 0] += 0.5 * 4.0 * ARCMIN
    found = deck_errors(batch, states)
    np.testing.assert_allclose(found.norm["attitude"], 4.0, rtol=1e-4)
    np.testing.assert_allclose(found.norm["static"], 4.0, rtol=1e-2)
    assert found.norm["theta"].max() < 1e-9


def test_the_start_is_not_scored(batch, perfect):
    states = perfect.copy()
    states[:, :1200, FLEXING] += 1.0
    assert deck_errors(batch, states).norm["theta"].max() < 1e-9
    assert deck_errors(batch, states).norm["theta_rate"].max() < 1e-9
    assert deck_errors(batch, states, start=59.0).norm["theta"].min() > 10.0


def test_a_failed_run_counts_as_infinitely_bad_and_alone(batch, perfect):
    states = perfect.copy()
    states[1, 3000:] = np.nan
    found = deck_errors(batch, states)
    for name in NAMES:
        assert found.norm[name][1] == np.inf, name
        assert np.isinf(found.axes[name][1]).all(), name
        assert found.norm[name][[0, 2]].max() < 1e-6, name


def test_what_lies_beyond_a_shorter_recording_does_not_count(batch, perfect):
    states = perfect.copy()
    states[2, 3200:] = np.nan
    assert deck_errors(batch, states).norm["theta"][2] < 1e-9


def test_the_first_minute_is_not_scored_unless_asked_for(batch, perfect):
    early, late = perfect.copy(), perfect.copy()
    minute = round(60.0 / batch.step)
    early[:, :minute, 18] += 1.0
    late[:, minute, 18] += 1.0
    assert deck_errors(batch, early, attitude=False).norm["theta"].max() < 1e-9
    assert deck_errors(batch, early, start=0.0, attitude=False).norm["theta"].min() > 1.0
    scored = batch.lengths - minute  # one error of a radian among as many
    np.testing.assert_allclose(
        deck_errors(batch, late, attitude=False).norm["theta"], 1.0 / ARCMIN / np.sqrt(scored)
    )


def test_attitude_is_left_out_where_it_is_not_asked_for(batch, perfect):
    found = deck_errors(batch, perfect, attitude=False)
    assert set(found.axes) == {"theta", "theta_rate", "theta_ac"}


def test_errors_need_truth_and_something_to_score(batch, perfect):
    blind = DeckBatch.of([replace(batch.recordings[0], theta=None)])
    with pytest.raises(ValueError, match="errors need the truth"):
        deck_errors(blind, perfect[:1])
    with pytest.raises(
        ValueError, match=r"start must leave something to score, got 160\.0 s .* 160 s"
    ):
        deck_errors(batch, perfect, start=160.0)


def test_the_moving_mean_is_centred_and_leaves_constants():
    x = np.zeros((101, 3))
    x[50] = 9.0
    mean = moving_mean(x, 9)
    np.testing.assert_allclose(mean[46:55], 1.0)
    assert np.abs(mean[:46]).max() == np.abs(mean[55:]).max() == 0.0
    np.testing.assert_allclose(moving_mean(np.full((20, 3), 7.0), 60), 7.0)


def test_the_filters_own_errors_are_as_large_as_expected(batch):
    """Attitude to an arcminute or two, θ by the split: docs/science/idam.md#information-limit."""
    found = deck_errors(batch, run_deck("alignment", batch).states)
    assert found.norm["attitude"].max() < 3.0
    assert 0.5 < found.norm["theta"].mean() < 12.0
    assert (found.norm["theta_ac"] < found.norm["theta"]).all()
    assert 0.1 < found.norm["theta_rate"].mean() < 0.6


def test_a_span_is_scored_alone():
    """The first half and the second give the whole again, as mean squares do."""
    batch = DeckBatch.of(navgym.simulation.simulate_many("deck/paper", [3], duration=20.0))
    states = np.zeros((1, batch.steps, 24))
    spans = (0.0, 0.5), (0.5, 1.0), (0.0, 1.0)
    first, second, whole = (
        deck_errors(batch, states, 0.0, attitude=False, span=span).norm["theta"] ** 2
        for span in spans
    )
    np.testing.assert_allclose((first + second) / 2, whole)
    assert abs(first - second) > 0.01 * whole
