"""Validation scores are those of the filter on the same recordings."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("tyro")
pytest.importorskip("tomli_w")

import navgym
from navgym.agents.training.validation import LOST, Validation, gain, half_width, play
from navgym.core.seeds import seeds
from navgym.envs.actions import fill_rows
from navgym.metrics import paired_difference, run_rmse, squared_error
from navgym.simulation import simulate_many
from tests.agents.small import tiny


def error_of(recording, parameters, interval=5):
    """Position RMSE of the filter, by the road that everybody else takes."""
    states = navgym.estimate("qivbf", recording, parameters, interval).states
    return run_rmse(squared_error(states[None], recording.truth[None], (0, 2)))[0]


def test_nothing_done_is_no_gain_and_errors_are_those_of_the_filter(tmp_path):
    config = tiny(tmp_path)
    validation = Validation(config)
    scores = validation(lambda o: np.zeros((len(o), 3), dtype=np.float32))
    assert scores.gain == pytest.approx(0.0, abs=1e-9)
    arena = validation.arenas[0]
    recordings = simulate_many("auv/switch-D", seeds("validation", 5), steps=100)
    wanted = [error_of(r, config.reference) for r in recordings]
    np.testing.assert_allclose(arena.best_fixed["rmse"], wanted, rtol=1e-9)


def test_errors_under_actions_are_those_of_the_filter_on_that_schedule(tmp_path):
    config = tiny(tmp_path, decision_interval=7)  # does not divide 100 samples
    engine = Validation(config).arenas[0].engine
    actions = np.random.default_rng(0).uniform(-1, 1, (15, 5, 3)).astype(np.float32)
    rows = iter(actions)
    run = play(engine, lambda _: next(rows))
    recordings = simulate_many("auv/switch-D", seeds("validation", 5), steps=100)
    for i, each in enumerate(recordings):
        table = engine.space.array(config.reference).repeat(15, axis=0)
        assert fill_rows(table, np.ascontiguousarray(actions[:, i]), engine.table)
        assert run.errors["rmse"][i] == pytest.approx(error_of(each, table, 7), rel=1e-9)


def test_gains_of_different_sets(tmp_path):
    assert gain([1.0, 1.0], [2.0, 4.0]) == pytest.approx(1 - 2 / 6)
    assert gain([1.0, 1.0], [2.0, 8.0], mixed=True) == pytest.approx(0.75)
    del tmp_path


def test_the_interval_is_close_to_a_bootstrap():
    rng = np.random.default_rng(0)
    base = rng.gamma(9.0, 0.1, 300)
    errors = base * rng.normal(0.9, 0.1, 300)
    found = paired_difference(errors, base)
    half = (found.gain_high - found.gain_low) / 2
    assert half_width(errors, base) == pytest.approx(half, rel=0.15)


def test_a_lane_that_diverges_counts_as_ten_times_the_reference():
    assert LOST == 10.0
    base = np.array([1.0, 2.0])
    assert gain(np.minimum([np.inf, 1.0], LOST * base), base) == pytest.approx(1 - 11 / 3)
