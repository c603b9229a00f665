"""The step of which values are multiples, and what follows for values that repeat."""

import numpy as np
import pytest

from navgym.core.repeats import is_held, quantum, repeats

RNG = np.random.default_rng(1)


@pytest.mark.parametrize("step", [1.0, 0.1, 1e-7, 1.0 / 600_000.0])
def test_digits_are_found_through_another_unit(step):
    values = 59.0 + step * np.round(RNG.normal(0.0, 30.0, 500))
    assert quantum(values) == pytest.approx(step, rel=1e-3)


@pytest.mark.parametrize(
    "values",
    [
        RNG.normal(size=500),
        np.sin(np.arange(60) / 7.0),
        np.arange(60) ** 1.5,
        [1.0, 3.0],
        [],
        [2.0],
    ],
    ids=["noise", "sine", "curve", "two", "none", "one"],
)
def test_values_that_lie_on_no_grid_have_no_digits(values):
    assert quantum(np.asarray(values, float)) == 0.0


def test_a_slow_vessel_in_coarse_minutes_is_not_taken_for_a_held_fix():
    minutes = np.round(18.0 + 2e-5 * np.arange(400) + RNG.normal(0.0, 3e-5, 400), 4)
    values = (59.0 + np.round(minutes / 60.0, 10))[:, None]
    repeated = repeats(values)
    assert repeated.mean() > 0.1
    assert not is_held(values, repeated, [quantum(values[:, 0])])
    assert is_held(values, repeated, [1e-10])  # by the digits of the degrees it would be
