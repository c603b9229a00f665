"""When a policy is taken out of force, judged by tallies that were made by hand."""

import numpy as np
import pytest
from scipy.stats import chi2

from navgym.agents.live.fallback import FallbackRule, Guard
from navgym.envs.columns import (
    FREEDOM,
    HEARD,
    NIS_SUM,
    REFERENCE_MISS,
    REFERENCE_SCORE,
    SCORE,
    TALLY,
)

LOW, HIGH = np.array([-1.0, 10.0]), np.array([1.0, 10.5])
INSIDE = np.array([0.0, 10.2], dtype=np.float32)
OUTSIDE = np.array([0.0, 99.0], dtype=np.float32)
QUIET = np.zeros(TALLY)


def guard(most=8, rule=True, **fields):
    return Guard(FallbackRule(**fields) if rule else None, ("speed", "depth"), LOW, HIGH, most)


def tally(nis, dof=8, heard=2, behind=10.0):
    """Of one decision: NIS, its degrees of freedom, samples, and how far the reference is ahead."""
    found = np.zeros(TALLY)
    found[NIS_SUM], found[FREEDOM], found[HEARD] = nis, dof, heard
    found[SCORE], found[REFERENCE_SCORE] = -5.0, -5.0 + behind
    return found


def judged(guarded, *observations):
    """Whether a policy is in force after each decision."""
    in_force = []
    for observation in observations:
        guarded.judge(observation, QUIET)
        in_force.append(guarded.reason is None)
    return in_force


# a fifth of 2 for the speed; of 1 for the depth, whose range is narrower
@pytest.mark.parametrize(
    ("observation", "named"),
    [
        ([1.39, 10.2], None), ([1.41, 10.2], "speed is 1.41"), ([-1.39, 10.2], None),
        ([-1.41, 10.2], "speed is -1.41"), ([0.0, 10.69], None), ([0.0, 10.71], "depth is 10.7"),
        ([0.0, 9.81], None), ([0.0, 9.79], "depth is 9.79"),
    ],
)  # fmt: skip
def test_observations_may_lie_a_margin_outside_of_those_in_training(observation, named):
    guarded = guard(margin=0.2)
    guarded.judge(np.array(observation, dtype=np.float32), QUIET)
    if named is None:
        assert guarded.reason is None
    else:
        assert named in guarded.reason


def test_the_reason_tells_what_training_saw():
    guarded = guard()
    guarded.judge(OUTSIDE, QUIET)
    assert guarded.reason == "observation depth is 99, and validation saw 10 to 10.5"


def test_where_lanes_compare_an_observation_out_of_range_counts_only_while_the_reference_leads():
    for behind, in_force in ((0.01, False), (0.0, True), (-1.0, True)):
        guarded = Guard(FallbackRule(window=2), ("speed", "depth"), LOW, HIGH, 8, compares=True)
        guarded.judge(INSIDE, tally(8.0, behind=behind))
        guarded.judge(OUTSIDE, tally(8.0, behind=behind))
        assert (guarded.reason is None) == in_force


def test_where_lanes_compare_an_observation_out_of_range_counts_before_a_window_is_full():
    guarded = Guard(FallbackRule(window=2), ("speed", "depth"), LOW, HIGH, 8, compares=True)
    guarded.judge(OUTSIDE, tally(8.0, behind=-1.0))
    assert guarded.reason is not None


def test_so_many_reasons_in_a_row_are_needed():
    assert judged(guard(patience=3), OUTSIDE, OUTSIDE, OUTSIDE) == [True, True, False]
    pattern = (OUTSIDE, OUTSIDE, INSIDE, OUTSIDE, OUTSIDE)
    assert judged(guard(patience=3), *pattern) == [True] * 5


def test_so_many_decisions_without_a_reason_bring_the_policy_back():
    found = judged(guard(recovery=3), OUTSIDE, INSIDE, INSIDE, INSIDE)
    assert found == [False, False, False, True]
    again = judged(guard(recovery=2, patience=2), OUTSIDE, OUTSIDE, INSIDE, OUTSIDE, INSIDE, INSIDE)
    assert again == [True, False, False, False, False, True]  # one relapse starts the count anew


def test_falls_are_counted_once_each():
    guarded = guard(recovery=1)
    judged(guarded, OUTSIDE, OUTSIDE, INSIDE, OUTSIDE)
    assert guarded.falls == 2
    guarded.reset()
    assert (guarded.falls, guarded.reason) == (0, None)


# 3 decisions of 8 degrees of freedom: 24; only beyond the band and behind by .4 a sample of 6
BAND = chi2.ppf([0.005, 0.995], 24)


@pytest.mark.parametrize(
    ("nis", "behind", "in_force"),
    [
        (24.0, 99.0, True), (BAND[1] * 0.999, 99.0, True), (BAND[1] * 1.001, 99.0, False),
        (BAND[0] * 1.001, 99.0, True), (BAND[0] * 0.999, 99.0, False),
        (99.0, 2.39, True), (99.0, 2.41, False), (99.0, -99.0, True),
    ],
)  # fmt: skip
def test_a_policy_falls_if_nis_leaves_its_band_and_the_reference_foretells_better(
    nis, behind, in_force
):
    guarded = guard(window=3, confidence=0.99, advantage=0.4)
    for _ in range(3):
        guarded.judge(INSIDE, tally(nis / 3.0, behind=behind / 3.0))
    assert (guarded.reason is None) == in_force


def test_the_reason_holds_nis_per_component_and_its_band():
    guarded = guard(window=3)
    for _ in range(3):
        guarded.judge(INSIDE, tally(24.0))
    low, high = BAND / 24.0
    assert f"NIS is 3 per component, outside {low:.3g} to {high:.3g}" in guarded.reason


def test_nothing_is_judged_before_a_window_is_full_and_only_the_last_window_counts():
    guarded = guard(window=3, recovery=1)
    guarded.judge(INSIDE, tally(1e3))
    guarded.judge(INSIDE, tally(1e3))
    assert guarded.reason is None
    guarded.judge(INSIDE, tally(1e3))
    assert guarded.reason is not None
    for _ in range(3):
        guarded.judge(INSIDE, tally(8.0))
    assert guarded.reason is None
    guarded.reset()
    guarded.judge(INSIDE, tally(1e3))
    assert guarded.reason is None


def test_losses_leave_nothing_to_judge():
    guarded = guard(window=2)
    for _ in range(4):
        guarded.judge(INSIDE, tally(0.0, dof=0, heard=0, behind=0.0))
    assert guarded.reason is None


def test_without_a_rule_only_a_trip_counts():
    guarded = guard(rule=False)
    assert judged(guarded, OUTSIDE, OUTSIDE) == [True, True]
    guarded.trip("the filter was reset")
    assert (guarded.reason, guarded.falls) == ("the filter was reset", 1)


def test_after_a_trip_the_policy_must_earn_its_way_back():
    guarded = guard(recovery=3)
    judged(guarded, INSIDE, INSIDE)
    guarded.trip("reset")
    assert judged(guarded, INSIDE, INSIDE, INSIDE) == [False, False, True]


@pytest.mark.parametrize(
    "fields",
    [
        {"margin": -0.1}, {"confidence": 1.1}, {"confidence": -0.1}, {"advantage": -0.1},
        {"window": 0}, {"patience": 0}, {"recovery": 0}, {"window": 1.5},
    ],
    ids=str,
)  # fmt: skip
def test_impossible_rules_are_refused_by_name(fields):
    with pytest.raises(ValueError, match=f"{next(iter(fields))} must be"):
        FallbackRule(**fields)


def test_the_ends_of_rules_belong_to_them():
    FallbackRule(margin=0.0, confidence=0.0, advantage=0.0, window=1, patience=1, recovery=1)
    FallbackRule(confidence=1.0)


class TestFixes:
    """Who misses the position fixes by less answers, with some inertia to either side."""

    @staticmethod
    def play(guarded, gains):
        found = []
        for gained in gains:
            seen = QUIET.copy()
            seen[REFERENCE_MISS] = gained
            guarded.judge(INSIDE, seen)
            found.append(guarded.reason)
        return found

    def test_it_leaves_a_policy_that_is_behind_and_returns_when_it_is_ahead(self):
        guarded = guard(memory=10**9, behind=1.0, ahead=3.0)
        reasons = self.play(guarded, [0.0, -0.9, -0.2, 0.0, 1.0, 3.0, 0.2])
        assert [r is None for r in reasons] == [True, True, False, False, False, False, True]
        assert "fixes" in reasons[2]
        assert guarded.falls == 1

    def test_what_was_long_ago_is_forgotten(self):
        guarded = guard(memory=2, behind=1.0)
        # 1.6 in all, .1 and .8 in the end
        assert self.play(guarded, [-0.8, 0.0, 0.0, -0.8]) == [None] * 4

    def test_a_policy_around_other_parameters_must_be_ahead_first(self):
        unproven = Guard(
            FallbackRule(memory=10**9), ("speed", "depth"), LOW, HIGH, 8, trusted=False
        )
        assert "not yet" in unproven.reason
        reasons = self.play(unproven, [1.0, 1.0, 1.5, -5.0])
        assert [r is None for r in reasons] == [False, False, True, False]
        assert "missed" in reasons[3]
        assert unproven.falls == 1  # once in force, once out of it

    def test_a_filter_that_failed_leaves_no_trace(self):
        guarded = guard()
        assert self.play(guarded, [np.nan, 0.0]) == [None, None]
