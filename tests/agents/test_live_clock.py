"""Clocks that are set, wrong stamps and large ones: what a live filter makes of them."""

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import navgym
from navgym import agents
from navgym.agents.live.clock import LATE, Clock
from navgym.agents.live.lines import Noise, estimates
from navgym.agents.live.notices import FIRST, Notices
from tests.agents import hand_made
from tests.agents.both import DECK

EPOCH = 1_732_788_000


def believed(stamps, step=1.0):
    """For each stamp True (goes on), False (begins anew) or None (left out)."""
    clock, found = Clock(step), []
    for stamp in stamps:
        try:
            found.append(clock.goes_on(Decimal(str(stamp))))
        except ValueError:
            found.append(None)
    return found


class TestClock:
    @pytest.mark.parametrize("to", [1_700_000_000, -3600, 100_000])
    def test_one_that_is_set_costs_one_line(self, to):
        stamps = [*range(9), *(to + k for k in range(9, 18))]
        assert believed(stamps) == [True] * 9 + [None, False] + [True] * 7

    @pytest.mark.parametrize(
        "far", [(9e8,), (9e8, 3), (9e8, 5e7), (9e8, 9.5e8), (9e8, 1.4e9), (-9e8, 9e8, -5e8)]
    )
    def test_wrong_stamps_silence_nothing(self, far):
        found = believed([*range(9), *far, *range(9, 99)])
        assert found[:9] == [True] * 9
        assert found[9 + len(far) + 2 :] == [True] * 88

    def test_what_comes_late_or_twice_is_left_out_and_nothing_else(self):
        assert believed([1, 2, 5, 3, 4, 6, 6, 7]) == [
            True,
            True,
            True,
            None,
            None,
            True,
            None,
            True,
        ]

    def test_a_log_of_hours_between_its_lines_goes_on(self):
        assert believed([0, 3600, 7200, 10800, 14400]) == [True, None, False, True, True]

    @given(
        st.lists(st.integers(-(10**12), 10**12), max_size=20),
        st.floats(1e-3, 1e3),
        st.integers(-(10**10), 10**10),
    )
    @settings(max_examples=200, deadline=None)
    def test_after_any_stamps_good_lines_are_taken_again(self, noise, step, start):
        good = [Decimal(start) + k * Decimal(step) for k in range(LATE + 10)]
        found = believed([*noise, *good], step)[len(noise) :]
        # ten may seem late, and of a jump one is left out
        assert None not in found[LATE + 2 :]

    def test_steps_are_exact_whatever_the_digits(self):
        clock = Clock(1e-3)
        clock.goes_on(Decimal("1732788000.000000123"))
        clock.goes_on(Decimal("1732788000.001000123"))
        assert clock._usual == Decimal("0.001")


def run(lines, **noise):
    said = []
    answers = list(estimates(lines, agents.shipped("auv"), Noise(**noise), said.append))
    rows = [line.split(",") for line in answers[1:]]
    return [row[0] for row in rows], np.array([[float(c) for c in row[1:5]] for row in rows]), said


def straight(times, seed=0):
    """A log of a straight way at uneven times: truth (T, 4) and lines."""
    rng = np.random.default_rng(seed)
    k = np.arange(len(times))
    truth = np.stack([k, np.ones(len(k)), 0.5 * k, 0.5 * np.ones(len(k))], -1)
    y = truth + rng.normal(size=truth.shape) * [1, 0.1, 1, 0.1]
    rows = [f"{t},{','.join(f'{v:.3f}' for v in row)}" for t, row in zip(times, y, strict=True)]
    return truth, ["time,px,vx,py,vy", *rows]


class TestStreams:
    @pytest.mark.parametrize("to", [1_700_000_000, -250, -(10**6), 10**7])
    def test_a_clock_that_is_set_is_said_once_and_the_position_is_there_again(self, to):
        truth, lines = straight([k + 300 + (to if k >= 300 else 0) for k in range(600)])
        times, states, said = run(lines)
        assert len(times) == 599
        miss = np.hypot(*(states - np.delete(truth, 300, axis=0))[:, [0, 2]].T)
        assert miss.max() < 5.0
        assert miss[310:].max() < 3.0
        assert (
            len([text for text in said if "clock was set" in text and "left out" not in text]) == 1
        )
        assert len(said) <= 5

    def test_thousands_of_lines_that_cannot_be_read_are_told_in_a_few(self):
        _, lines = straight(range(100))
        _, _, said = run([*lines, *["x"] * 12_345])
        left_out = [text for text in said if "left out" in text]
        assert len(left_out) == FIRST + 4 + 1  # three, the 10th, 100th, 1000th, 10 000th, all
        assert left_out[-1] == "in all: left out 12345 times"

    def test_times_come_out_as_they_went_in(self):
        stamps = [f"{EPOCH}.{k:09d}" for k in range(0, 900_000_000, 1_000_003)]
        stamps[3] = f"+{stamps[3]}00"
        _, lines = straight(stamps)
        times, _, said = run(lines, step=1e-3)
        assert times == stamps
        assert not [text for text in said if "left out" in text]

    def test_estimates_are_the_same_since_1970_as_since_zero(self):
        _, early = straight([f"{k // 10}.{k % 10}" for k in range(200)])
        _, late = straight([f"{EPOCH + k // 10}.{k % 10}" for k in range(200)])
        np.testing.assert_array_equal(run(early, step=0.1)[1], run(late, step=0.1)[1])


class TestNotices:
    def test_kinds_are_counted_apart(self):
        said = []
        with Notices(said.append) as told:
            for k in range(5):
                told("one", f"a{k}")
            told("other", "b")
        assert said == ["a0", "a1", "a2", "b", "in all: one 5 times"]


class TestPython:
    MODEL = staticmethod(navgym.LinearModel.white_acceleration)

    def filter(self, **options):
        return agents.SelfTuningFilter("qivbf", agents.shipped("auv"), self.MODEL, **options)

    def test_decimal_times_are_exact_at_any_size(self):
        y = np.zeros((50, 4))
        seen = {}
        for start in ("0", f"{EPOCH}", f"{EPOCH}.000000123"):
            tuned = self.filter(interval=1e-3)
            times = [Decimal(start) + k * Decimal("0.001") for k in range(50)]
            found = [tuned.step(row, time=t) for row, t in zip(y, times, strict=True)]
            assert [f.time for f in found] == times
            seen[start] = np.array([f.covariance for f in found])
        np.testing.assert_array_equal(seen["0"], seen[f"{EPOCH}"])
        np.testing.assert_array_equal(seen["0"], seen[f"{EPOCH}.000000123"])

    def test_floats_since_1970_are_as_good_as_their_rounding(self):
        y = np.zeros((50, 4))
        near, far = self.filter(interval=0.1), self.filter(interval=0.1)
        for k, row in enumerate(y):
            one, other = near.step(row, time=0.1 * k), far.step(row, time=EPOCH + 0.1 * k)
        np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-5)

    def test_a_late_sample_is_refused_and_a_clock_that_was_set_is_not_once_it_is_said(self):
        truth, _ = straight(range(100))
        wanted, tuned = self.filter(), self.filter()
        for k, row in enumerate(truth):
            expected = wanted.step(row, time=float(k + 1))
            if k == 50:
                with pytest.raises(ValueError, match="restart_clock"):
                    tuned.step(row, time=-1e6)
                tuned.restart_clock()
            found = tuned.step(row, time=float(k + 1) - (1e6 if k >= 50 else 0.0))
        np.testing.assert_allclose(found.state, expected.state, rtol=1e-9, atol=1e-9)
        assert tuned.restarts == 0

    def test_a_deck_goes_on_as_well(self):
        recording = navgym.simulate("deck/paper", seed=1, duration=3.0)
        policy = hand_made.policy(DECK, "deck/switch-60")
        names = ("main_angle", "main_velocity", "sub_angle", "sub_velocity")
        samples = np.stack([getattr(recording, name) for name in names], axis=1)
        ends = []
        for shift in (0.0, 1.7e9, -50.0):
            tuned = agents.SelfTuningFilter(
                "idam", policy, recording.model, interval=recording.interval, rule=None
            )
            last = None
            for k, x in enumerate(samples):
                time = recording.time[k] + (shift if k >= 150 else 0.0)
                if shift and k == 150:
                    with pytest.raises(ValueError, match="restart_clock"):
                        tuned.step(x, time=time)
                    tuned.restart_clock()
                found = tuned.step(x, time=time)
                last = last if found is None else found
            ends.append(last.state)
        np.testing.assert_array_equal(ends[0], ends[1])
        np.testing.assert_array_equal(ends[0], ends[2])
