"""What arguments are let through, and the ends of ranges."""

import math

import numpy as np
import pytest

from navgym.core.checks import covariance, one_of, positive_int, real_array, shaped, span, within


@pytest.mark.parametrize(
    "value",
    [[1.0, object()], [[1.0], [1.0, 2.0]], 1j, "1", ["1", 2.0], [b"1"], [{}], [1.0, None, "x"]],
)
def test_what_is_no_array_of_numbers_is_refused_by_name(value):
    with pytest.raises(ValueError, match="thing must be an array of numbers"):
        real_array("thing", value)


def test_numbers_become_a_copy_in_double_precision():
    given = np.array([1.0, 2.0])
    found = real_array("thing", given)
    found[0] = 9.0
    assert given[0] == 1.0
    for value in (1, True, np.float32(1.0), np.int8(1), [1], np.array(1, dtype=object)):
        assert real_array("thing", value).dtype == np.float64


def test_only_finite_numbers_unless_asked():
    for bad in (math.nan, math.inf, -math.inf):
        with pytest.raises(ValueError, match=r"thing must be finite, got .* at index \(1,\)"):
            real_array("thing", [0.0, bad])
        np.testing.assert_array_equal(real_array("thing", [0.0, bad], finite=False), [0.0, bad])


@pytest.mark.parametrize("value", [2.0, 2, np.float32(2.0), np.int64(2), 3.0])
def test_the_ends_of_a_range_belong_to_it(value):
    assert within("thing", value, 2.0, 3.0) == float(value)
    assert isinstance(within("thing", value, 2.0, 3.0), float)


@pytest.mark.parametrize(
    "value", [1.999, 3.001, math.nan, math.inf, -math.inf, True, "2", None, [2.0], np.array([2.0])]
)
def test_what_lies_outside_of_a_range_or_is_no_number_is_refused(value):
    with pytest.raises(ValueError, match=r"thing must be a number in 2\.\.3"):
        within("thing", value, 2.0, 3.0)


def test_an_open_end_is_left_out_and_infinity_never_counts():
    assert within("thing", 2.0 + 1e-12, 2.0, above=True) > 2.0
    with pytest.raises(ValueError, match="above 2"):
        within("thing", 2.0, 2.0, above=True)
    with pytest.raises(ValueError, match="of at least 2"):
        within("thing", math.inf, 2.0)


def test_pairs_are_ordered_and_in_range():
    span("thing", (1.0, 1.0), 1.0)
    span("thing", [2, 5], 2, whole=True)
    for bad in ((2.0, 1.0), (0.9, 2.0), (1.0,), (1.0, 2.0, 3.0), 4.0, None, (1.0, math.inf)):
        with pytest.raises(ValueError, match="thing must be"):
            span("thing", bad, 1.0)
    for bad in ((1.0, 2.0), (0, 3)):
        with pytest.raises(ValueError, match="thing must be"):
            span("thing", bad, 1, whole=True)
    with pytest.raises(ValueError, match="above 1"):
        span("thing", (1.0, 2.0), 1.0, above=True)


@pytest.mark.parametrize("value", [2, np.int32(2), 7])
def test_whole_numbers_from_the_least_on(value):
    found = positive_int("thing", value, least=2)
    assert type(found) is int
    assert found == value


@pytest.mark.parametrize("value", [1, 2.0, True, "2", None, -3])
def test_other_counts_are_refused(value):
    with pytest.raises(ValueError, match="thing must be a whole number of at least 2"):
        positive_int("thing", value, least=2)


def test_one_is_the_least_count_by_default():
    assert positive_int("thing", 1) == 1
    with pytest.raises(ValueError, match="of at least 1, got 0"):
        positive_int("thing", 0)


@pytest.mark.parametrize(
    ("matrix", "definite", "fault"),
    [
        (np.diag([1.0, 1e-9]), True, None),
        (np.diag([1.0, 0.0]), False, None),
        (np.diag([1.0, 0.0]), True, "positive definite"),
        (np.diag([1.0, -1e-6]), False, "positive semi-definite"),
        (np.array([[1.0, 1.0], [1.0, 1.0]]), False, None),
        (np.array([[1.0, 1.1], [1.1, 1.0]]), False, "positive semi-definite"),
        (np.array([[1.0, 0.2], [0.1, 1.0]]), False, "symmetric"),
        (np.zeros((2, 2)), False, None),
        (np.stack([np.eye(2), -np.eye(2)]), True, "positive definite"),
        (np.stack([np.eye(2), [[1.0, 0.5], [0.4, 1.0]]]), True, "symmetric"),
    ],
)
@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_a_covariance_is_one_in_every_unit(matrix, definite, fault, unit):
    if fault is None:
        covariance("P", unit * matrix, definite)
    else:
        with pytest.raises(ValueError, match=f"P must be {fault}"):
            covariance("P", unit * matrix, definite)


def test_rounding_is_no_fault_of_a_covariance():
    covariance("P", np.array([[1.0, 0.5 + 1e-12], [0.5, 1.0]]), definite=True)
    covariance("P", np.diag([1.0, -1e-12]), definite=False)


def test_shapes_are_compared_whole():
    shaped("thing", np.zeros((2, 3)), (2, 3), "rows")
    for other in ((3, 2), (2,), (2, 3, 1)):
        with pytest.raises(ValueError, match=r"thing must have shape \(2, 3\) \(rows\), got"):
            shaped("thing", np.zeros(other), (2, 3), "rows")


def test_names_are_taken_as_they_are_or_refused_with_the_nearest():
    assert one_of("fruit", "plum", ("pear", "plum")) == "plum"
    for near in ("plumm", "PLUM", "plu"):
        with pytest.raises(ValueError, match=rf"unknown fruit '{near}'\. Did you mean 'plum'"):
            one_of("fruit", near, ("pear", "plum"))
    with pytest.raises(ValueError, match="Did you mean 'sea-state'"):
        one_of("fruit", "Sea_State", ("sea-state", "calm"))
    with pytest.raises(ValueError, match=r"unknown fruit 3\. Known: pear, plum\."):
        one_of("fruit", 3, ("plum", "pear"))


MASKED = np.ma.masked_array([[1.0, 2.0], [3.0, 1e6]], mask=[[0, 0], [0, 1]])


@pytest.mark.parametrize("given", [MASKED, list(MASKED), MASKED.astype(int)])
def test_what_is_masked_is_nothing_where_nothing_is_allowed_and_refused_elsewhere(given):
    found = real_array("thing", given, finite=False)
    np.testing.assert_array_equal(found, [[1.0, 2.0], [3.0, np.nan]])
    assert not np.ma.isMaskedArray(found)
    with pytest.raises(ValueError, match=r"thing .* but 1 of its entries are masked"):
        real_array("thing", given)


def test_a_mask_that_hides_nothing_is_no_mask():
    given = np.ma.masked_array([1.0, 2.0], mask=False)
    assert real_array("thing", given).tolist() == [1.0, 2.0]


def test_what_pandas_calls_na_is_nothing():
    pandas = pytest.importorskip("pandas")
    for kind in ("Float64", "Int64"):
        column = pandas.Series([1, None, 3], dtype=kind)
        found = real_array("thing", column, finite=False)
        np.testing.assert_array_equal(found, [1.0, np.nan, 3.0])
        with pytest.raises(ValueError, match="thing must be finite, got nan at index"):
            real_array("thing", column)
    table = pandas.DataFrame({"px": [1.0, 2.0], "py": [3, None]})
    np.testing.assert_array_equal(real_array("thing", table, finite=False), [[1, 3], [2, np.nan]])
    with pytest.raises(ValueError, match="thing must be an array of numbers"):
        real_array("thing", pandas.Series(["a", "b"]))
