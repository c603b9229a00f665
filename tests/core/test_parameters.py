"""Parameters and spaces: ranges, scales, and the array that a kernel reads."""

import math
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import navgym
from navgym import Parameter, ParameterSpace
from navgym.problem import problems

SPACES = {f"{p.name} {name}": f.space for p in problems() for name, f in p.filters.items()}
ALL = [(name, p) for name, space in SPACES.items() for p in space]
QIVBF = navgym.parameter_space("qivbf")


@pytest.mark.parametrize(("filter_name", "parameter"), ALL, ids=lambda v: getattr(v, "name", v))
@given(place=st.floats(0.0, 1.0))
def test_unwarp_is_the_inverse_of_warp(filter_name, parameter, place):
    low, high = parameter.warp(parameter.low), parameter.warp(parameter.high)
    value = parameter.unwarp(low + place * (high - low))
    slack = 1e-12 * (parameter.high - parameter.low)
    assert parameter.low - slack <= value <= parameter.high + slack
    assert parameter.warp(value) == pytest.approx(low + place * (high - low), rel=1e-9, abs=1e-9)
    assert parameter.unwarp(parameter.warp(value)) == pytest.approx(value, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("name", SPACES)
@given(data=st.data())
def test_to_unit_is_the_inverse_of_from_unit(name, data):
    space = SPACES[name]
    unit = data.draw(st.lists(st.floats(0, 1), min_size=len(space), max_size=len(space)))
    values = space.from_unit(unit)
    again = space.to_unit(values)
    np.testing.assert_allclose(space.array(space.from_unit(again)), space.array(values), rtol=1e-9)
    for p, place, found in zip(space, unit, again, strict=True):
        # a whole number stands for all places that round to it
        width = 0.5 / (p.high - p.low) if p.integer else 0.0
        assert abs(place - found) <= width + 1e-9


@pytest.mark.parametrize("name", SPACES)
def test_ends_and_defaults_survive_the_round_trip(name):
    space = SPACES[name]
    for place, end in ((0.0, "low"), (1.0, "high")):
        values = space.array(space.from_unit([place] * len(space)))[0]
        np.testing.assert_allclose(values, [getattr(p, end) for p in space], rtol=1e-12)
    again = space.from_unit(space.to_unit())
    np.testing.assert_allclose(space.array(again), space.array(), rtol=1e-12)


def test_scales_are_linear_logarithmic_and_logarithmic_in_the_complement():
    p = Parameter("x", "x", "1", 0.1, 0.9, "linear", 0.5)
    assert p.warp(0.3) == 0.3
    assert replace(p, scale="log").warp(0.3) == pytest.approx(math.log(0.3))
    assert replace(p, scale="log-complement").warp(0.3) == pytest.approx(-math.log(0.7))


def test_half_way_up_a_logarithmic_range_is_the_geometric_mean():
    space = ParameterSpace((Parameter("x", "x", "1", 0.1, 1000.0, "log", 1.0),))
    assert space.from_unit([0.5])["x"] == pytest.approx(10.0)


def test_kernels_read_the_warped_ends_of_each_range():
    rows = {p.name: row for p, row in zip(QIVBF, QIVBF.table(), strict=True)}
    np.testing.assert_allclose(rows["vb_iterations"], [1, 20, 0, 1])
    np.testing.assert_allclose(rows["prior_count"], [math.log(0.1), math.log(300), 1, 0])
    np.testing.assert_allclose(
        rows["forgetting"], [-math.log(0.4), -math.log(1e-3), 2, 0], rtol=1e-9
    )


def test_array_fills_in_defaults_and_keeps_the_order():
    table = QIVBF.array({"prior_count": 20, "fill": "extrapolate"})
    wanted = dict(zip(QIVBF.names, (p.default for p in QIVBF), strict=True))
    wanted |= {"prior_count": 20.0, "fill": 1.0}
    np.testing.assert_array_equal(table, [list(wanted.values())])


def test_a_list_is_a_schedule_beside_constants():
    table = QIVBF.array({"vb_iterations": [1, 2, 3], "prior_count": 20})
    np.testing.assert_array_equal(table[:, QIVBF.index("vb_iterations")], [1, 2, 3])
    np.testing.assert_array_equal(table[:, QIVBF.index("prior_count")], [20, 20, 20])


@pytest.mark.parametrize("name", SPACES)
def test_defaults_array_and_dict_are_the_same_parameters(name):
    space = SPACES[name]
    np.testing.assert_array_equal(space.array(space.array()), space.array(space.defaults))
    np.testing.assert_array_equal(space.array(), space.array(None))


def test_choices_may_be_named_or_numbered():
    fill = QIVBF["fill"]
    assert fill.check("extrapolate") == fill.check(1) == 1.0
    assert fill.show(1.0) == "extrapolate"


def test_shown_values_are_python_numbers():
    assert type(QIVBF["vb_iterations"].show(3.0)) is int
    assert type(QIVBF["prior_count"].show(np.float64(3.0))) is float


def test_a_subset_keeps_the_order_it_was_asked_in():
    assert QIVBF.subset(("forgetting", "vb_iterations")).names == ("forgetting", "vb_iterations")


def test_fingerprints_tell_spaces_apart():
    prints = {tuple(s.names): s.fingerprint for s in SPACES.values()}
    assert len(set(prints.values())) == len(prints)
    first, *rest = QIVBF
    for change in (
        {"low": 2},
        {"high": 19},
        {"scale": "log"},
        {"name": "other"},
        {"integer": False},
    ):
        assert ParameterSpace((replace(first, **change), *rest)).fingerprint != QIVBF.fingerprint
    assert ParameterSpace((*rest, first)).fingerprint != QIVBF.fingerprint


def test_fingerprints_ignore_what_changes_no_meaning():
    first, *rest = QIVBF
    for change in ({"default": 7}, {"equation": "elsewhere"}, {"symbol": "k"}):
        assert ParameterSpace((replace(first, **change), *rest)).fingerprint == QIVBF.fingerprint


def test_spaces_survive_pickling():
    assert pickle.loads(pickle.dumps(QIVBF)) == QIVBF


@pytest.mark.parametrize(
    ("name", "low", "high", "scale"),
    [
        ("vb_iterations", 1, 20, "linear"),
        ("prior_count", 0.1, 300, "log"),
        ("forgetting", 0.6, 0.999, "log-complement"),
        ("process_noise_scale", 0.1, 1000, "log"),
        ("fill_inflation", 1, 100, "log"),
    ],
)
def test_qivbf_has_the_promised_tunables(name, low, high, scale):
    p = QIVBF[name]
    assert (p.low, p.high, p.scale) == (low, high, scale)
    assert p.equation
    assert p.symbol


def test_qivbf_has_no_other_tunables():
    assert set(QIVBF.names) == {
        "vb_iterations", "prior_count", "forgetting", "initial_count", "initial_scale",
        "process_noise_scale", "fill", "fill_inflation",
    }  # fmt: skip
    assert QIVBF["fill"].choices == ("skip", "extrapolate")


@pytest.mark.parametrize("name", SPACES)
def test_every_default_is_admissible(name):
    for p in SPACES[name]:
        assert p.check(p.default) == p.default


P = Parameter("gain", "g", "m/s", 0.5, 2.0, "linear", 1.0)
WHOLE = Parameter("count", "n", "1", 1, 9, "linear", 5, integer=True)
BAD = [
    (lambda: P.check(3.0), "gain must lie in 0.5..2 m/s, got 3"),
    (lambda: P.check(math.nan), "gain must lie in 0.5..2 m/s, got nan"),
    (lambda: P.check("fast"), "gain must be a number, got 'fast'"),
    (lambda: P.check(None), "gain must be a number, got None"),
    (lambda: WHOLE.check(2.5), "count must be a whole number, got 2.5"),
    (lambda: WHOLE.check(10), "count must lie in 1..9, got 10"),
    (lambda: replace(P, scale="logs"), "unknown scale 'logs'. Did you mean 'log'"),
    (lambda: replace(P, default=5.0), "gain: default 5.0 outside 0.5..2.0"),
    (lambda: replace(P, low=3.0), "gain: low must be below high"),
    (lambda: replace(P, low=0.0, scale="log"), "both on the log scale, got 0.0..2.0"),
    (lambda: replace(P, scale="log-complement"), "both on the log-complement scale"),
    (lambda: QIVBF.array({"tau": 3}), "unknown parameter 'tau'"),
    (lambda: QIVBF.array({"prior_cuont": 3}), "Did you mean 'prior_count'"),
    (
        lambda: QIVBF.array({"fill": "extrapolat"}),
        "unknown fill 'extrapolat'. Did you mean 'extrapolate'",
    ),
    (lambda: QIVBF.array({"prior_count": []}), "prior_count must be a number or a list, got []"),
    (lambda: QIVBF.array({"prior_count": [[1]]}), "prior_count must be a number or a list"),
    (lambda: QIVBF.array({"prior_count": [1, 2], "forgetting": [0.9] * 3}), "[2, 3]"),
    (lambda: QIVBF.array([1.0, 2.0]), "8 columns (vb_iterations, prior_count"),
    (lambda: QIVBF.array(np.ones((1, 2, 8))), "got shape (1, 2, 8)"),
    (lambda: QIVBF.array("abc"), "parameters must be an array of numbers, got 'abc'"),
    (
        lambda: QIVBF.array("abc"),
        "Expected: a dict, a list with one dict per recording, or an array",
    ),
    (lambda: QIVBF.array([[1.0], [1.0, 2.0]]), "got [[1.0], [1.0, 2.0]]: make its rows equally"),
    (lambda: QIVBF.array([1.0, "a"]), "parameters must be an array of numbers, got [1.0, 'a']"),
    (lambda: QIVBF.array([math.nan] * 8), "parameters must be finite, got nan at index (0,)"),
    (lambda: QIVBF.array({"prior_count": [[1], [2, 3]]}), "prior_count must be a number or a list"),
    (lambda: QIVBF["priorcount"], "Did you mean 'prior_count'"),
    (lambda: QIVBF.from_unit([0.5]), "unit must have shape (8,)"),
    (lambda: QIVBF.from_unit([math.nan] * 8), "unit must be finite, got nan at index (0,)"),
]


@pytest.mark.parametrize(("act", "message"), BAD)
def test_bad_values_are_refused_by_name_value_and_range(act, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        act()
