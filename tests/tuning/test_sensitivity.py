"""What a report says of knobs, on goals whose answer is known."""

import numpy as np
import pytest

from navgym.core.parameters import Parameter, ParameterSpace
from navgym.tuning.objectives import Evaluation
from navgym.tuning.study.racing import evaluate
from navgym.tuning.study.run import search
from navgym.tuning.study.sensitivity import Sweep, importances, sweeps

SPACE = ParameterSpace(
    (
        Parameter("steep", "a", "1", 0.01, 100.0, "log", 3.0),
        Parameter("dead", "b", "1", 0.0, 1.0, "linear", 0.2),
        Parameter("half", "c", "s", 1.0, 100.0, "log", 50.0),
        Parameter("kind", "d", "1", 0, 1, "linear", 0, integer=True, choices=("on", "off")),
    )
)


class Known:
    """Loss 1 + ln²(a) + what `half` adds below 10, on instances of different difficulty."""

    space, about, metric = SPACE, {}, "mean"

    def __len__(self):
        return 8

    def evaluate(self, values, which=None):
        hard = 1.0 + 0.1 * np.arange(8)[slice(None) if which is None else which]
        below = max(0.0, np.log(10.0 / values["half"]))
        return Evaluation(hard * (1.0 + np.log(values["steep"]) ** 2 + below))

    def __call__(self, values):
        return float(self.evaluate(values).losses.mean())


def run(calls):
    return [evaluate(*call) for call in calls]


@pytest.fixture(scope="module")
def found():
    winner = {"steep": 1.0, "dead": 0.4, "half": 30.0, "kind": "on"}
    return {s.parameter.name: s for s in sweeps(Known(), winner, run)}


def test_a_sweep_is_the_metric_along_one_parameter(found):
    s = found["steep"]
    np.testing.assert_allclose(s.change, np.log(s.values) ** 2, atol=1e-12)
    assert (s.low <= s.change).all()
    assert (s.change <= s.high).all()
    assert 1.0 in s.values
    assert (s.values[0], s.values[-1]) == pytest.approx((0.01, 100.0))


def test_a_knob_without_effect_is_dead_and_no_other_is(found):
    assert [name for name, s in found.items() if s.dead] == ["dead", "kind"]


def test_the_flat_stretch_is_where_nothing_changes(found):
    low, high = found["half"].flat
    assert 10.0 <= low < 16.0
    assert high == pytest.approx(100.0)
    assert found["steep"].flat is None


def test_a_winner_at_the_end_of_its_range_is_told():
    at_end = sweeps(Known(), {"steep": 100.0, "dead": 1.0, "half": 30.0, "kind": "on"}, run)
    assert [s.parameter.name for s in at_end if s.at_edge] == ["steep"]


@pytest.mark.parametrize(
    ("share", "at_edge"),
    [(0.0, True), (0.019, True), (0.021, False), (0.979, False), (0.981, True), (1.0, True)],
)
@pytest.mark.parametrize("name", ["steep", "dead"])  # on a logarithmic and on a linear scale
def test_a_fiftieth_of_the_range_on_its_own_scale_is_its_end(name, share, at_edge):
    p = SPACE[name]
    start, whole = p.warp(p.low), p.warp(p.high) - p.warp(p.low)
    chosen, values = p.unwarp(start + share * whole), np.array([p.low, p.high])
    assert Sweep(p, chosen, values, np.array([0.0, 0.5]), values, values).at_edge is at_edge
    without_effect = Sweep(p, chosen, values, np.zeros(2), values, values)
    assert not without_effect.at_edge


def test_importances_rank_the_steep_parameter_first_and_sum_to_one():
    outcome = search(Known(), 60, progress=False)
    shares = importances(outcome, SPACE)
    assert next(iter(shares)) == "steep"
    assert sum(shares.values()) == pytest.approx(1.0)
    assert set(shares) == set(SPACE.names)
    assert importances(search(Known(), 5, progress=False), SPACE) == {}  # too few to say
