"""From leaders of a study to the one that ships."""

from dataclasses import dataclass

import numpy as np
import pytest

from navgym.core.parameters import Parameter, ParameterSpace
from navgym.tuning.objectives import Costed, Evaluation
from navgym.tuning.study.run import Outcome, Trial
from navgym.tuning.study.selection import confirm, rounded
from tests.tuning.goals import SPACE


@dataclass(frozen=True)
class Told:
    """Loss and share of a limit on fresh recordings, by the number of sweeps; 1 µs per sweep."""

    said: dict

    space, metric, about = SPACE, "mean", {"goal": "told"}

    def __len__(self):
        return 2

    def evaluate(self, values, which=None):
        loss, share = self.said[values["vb_iterations"]]
        return Evaluation(
            np.array([loss - 1.0, loss + 1.0]), {"drift": np.array([share, share])},
            microseconds=float(values["vb_iterations"]),
        )  # fmt: skip

    def __call__(self, values):
        return float(self.evaluate(values).losses.mean())


def studied(*results, **changes):
    """A study whose trial k had k + 1 sweeps and these results."""
    return Outcome(
        tuple(
            Trial(k, SPACE.defaults | {"vb_iterations": k + 1}, result, **changes)
            for k, result in enumerate(results)
        )
    )


def test_the_result_is_that_on_fresh_recordings():
    best = confirm(studied(1.0, 2.0, 3.0), Told({1: (9.0, 0.5), 2: (7.0, 0.5), 3: (8.0, 0.5)}))
    assert (best.number, best.result, best.feasible, best.cost) == (1, 7.0, True, None)


def test_only_the_leaders_are_looked_at_again():
    fresh = Told({1: (9.0, 0.5), 2: (8.0, 0.5)})  # of the third, it knows nothing
    assert confirm(studied(1.0, 2.0, 3.0), fresh, top=2).number == 1
    many = Told({n: (20.0 - n, 0.5) for n in range(1, 9)})  # eight, unless told otherwise
    assert confirm(studied(*range(12)), many).number == 7


def test_leaders_keep_the_limits_and_were_not_given_up_if_any_did():
    fresh = Told(dict.fromkeys((1, 2, 3), (1.0, 0.5)))
    bad = studied(1.0, feasible=False).trials + studied(2.0, given_up=True).trials
    good = Trial(2, SPACE.defaults | {"vb_iterations": 3}, 9.0)
    assert confirm(Outcome((*bad, good)), fresh, top=1).number == 2


def test_a_limit_may_be_used_up_and_not_passed():
    within = Told({1: (5.0, 1.0 + 1e-9), 2: (6.0, 1.0)})
    best = confirm(studied(1.0, 2.0), within)
    assert (best.number, best.feasible) == (1, True)
    none = Told({1: (5.0, 1.5), 2: (6.0, 1.1)})
    best = confirm(studied(1.0, 2.0), none)
    assert (best.number, best.feasible) == (0, False)


def test_the_time_is_kept_where_it_was_an_objective():
    fresh = Costed(Told({1: (9.0, 0.5), 2: (7.0, 0.5)}))
    assert confirm(studied(1.0, 2.0), fresh).cost == 2.0
    assert fresh.about == {"and time per filter step": {"goal": "told"}}


@pytest.mark.parametrize(
    ("value", "digits", "wanted"),
    [
        (0.012345, 2, 0.012),
        (0.012345, 3, 0.0123),
        (98.7, 1, 100.0),
        (99.6, 2, 100.0),
        (1.0, 2, 1.0),
        (0.0, 2, 0.0),
    ],
)
def test_rounding_keeps_significant_digits_and_stays_inside(value, digits, wanted):
    space = ParameterSpace((Parameter("x", "x", "1", 0.0, 100.0, "linear", 1.0),))
    assert rounded(space, {"x": value}, digits) == {"x": wanted}
    narrow = ParameterSpace((Parameter("x", "x", "1", 0.0, 99.7, "linear", 1.0),))
    assert rounded(narrow, {"x": 99.6}) == {"x": 99.7}  # not 100, which is outside


@pytest.mark.parametrize(
    ("value", "wanted"), [(0.99736, 0.9974), (0.9876, 0.988), (0.6543, 0.65), (0.6, 0.6)]
)
def test_a_share_near_one_is_rounded_by_what_it_lacks(value, wanted):
    space = ParameterSpace((SPACE["forgetting"],))
    assert rounded(space, {"forgetting": value}) == {"forgetting": wanted}
