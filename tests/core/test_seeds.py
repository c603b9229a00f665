"""Seeds for tuning and for reporting never meet."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

import navgym
from navgym.core.seeds import SIZE, SPLITS, split_of

starts = st.integers(0, SIZE - 1000)
counts = st.integers(0, 1000)


@given(a=starts, b=starts, count=counts, other=counts)
def test_splits_share_no_seed(a, b, count, other):
    ranges = [
        navgym.seeds(split, c, s)
        for split, c, s in zip(SPLITS, (count, other, 9), (a, b, 0), strict=True)
    ]
    for i, first in enumerate(ranges):
        for second in ranges[i + 1 :]:
            assert first.stop <= second.start
    for split, numbers in zip(SPLITS, ranges, strict=True):
        assert {split_of(n) for n in (*numbers[:2], *numbers[-2:])} <= {split}


def test_a_split_ends_where_the_next_begins():
    assert navgym.seeds("train", 1, SIZE - 1)[-1] + 1 == navgym.seeds("validation", 1)[0]
    assert navgym.seeds("validation", 1, SIZE - 1)[-1] + 1 == navgym.seeds("test", 1)[0]


def test_later_starts_continue_the_same_split():
    assert [*navgym.seeds("test", 3), *navgym.seeds("test", 2, 3)] == [*navgym.seeds("test", 5)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("tests", 3), "unknown split 'tests'. Did you mean 'test'"),
        (("test", -1), "count must be a whole number of at least 0, got -1"),
        (("test", 1.5), "count must be a whole number of at least 0, got 1.5"),
        (("test", 1, -1), "start must be a whole number of at least 0, got -1"),
        (("test", SIZE, 1), f"start + count must not exceed {SIZE}, got {SIZE + 1}"),
    ],
)
def test_bad_ranges_are_refused(arguments, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        navgym.seeds(*arguments)


@pytest.mark.parametrize("seed", [-1, 3 * SIZE, 1.5, "a", True])
def test_seeds_that_no_split_owns_are_refused(seed):
    with pytest.raises(ValueError, match=f"seed must .* got {seed!r}"):
        navgym.simulate("auv/nominal", seed)
