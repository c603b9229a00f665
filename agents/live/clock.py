"""Which times of a log that arrives line by line to believe."""

from __future__ import annotations

from decimal import Decimal

LONGEST = 1000  # usual steps: a time further ahead is taken for a wrong one until the next agrees
LATE = 10  # steps: a line that comes late by less was overtaken on its way
DAY = 86_400  # s: no longer step is usual


class Clock:
    """Times of a log, in which a wrong one must not silence all that follow.

    A time that goes on from the last one by at most `LONGEST` usual steps is believed at once. One
    that lies further ahead, or behind, is left out and remembered: if the next one goes on from
    there, the clock was set (or the log paused) and everything begins anew; if the next one goes on
    from before, it was a single wrong stamp. What is only a few steps late, or comes twice, is left
    out without more ado: the clock will have passed the last time within as many lines.

    Args:
        step: s between lines, as far as is known; the last step that was taken counts as usual too,
            so that a log of hours between lines is not one jump after the other.

    Attributes:
        last: time of the last line that was believed, s; None before the first.
    """

    def __init__(self, step: float) -> None:
        self._step = self._usual = Decimal(step)
        self.last: Decimal | None = None
        self._doubted: Decimal | None = None

    def goes_on(self, time: Decimal) -> bool:
        """Take in a line's time, s: True if it goes on from the last one, False if it begins anew.

        Raises ValueError for a time that is not believed, at least until the next one.
        """
        last, doubted, self._doubted = self.last, self._doubted, None
        if last is None:
            self.last = time
            return True
        gap, longest = time - last, LONGEST * max(self._step, self._usual)
        if 0 < gap <= longest:
            self._take(time, gap)
            return True
        if -LATE * self._step <= gap <= 0:
            raise ValueError(f"time must increase, got {time} after {last}.")
        if doubted is not None and 0 < time - doubted <= max(longest, abs(gap)):
            self._take(time, time - doubted)
            return False
        self._doubted = time
        raise ValueError(
            f"time jumps from {last} to {time}: if the next line goes on from there, the clock was "
            "set, and so is the filter."
        )

    def _take(self, time: Decimal, step: Decimal) -> None:
        self.last, self._usual = time, min(step, Decimal(DAY))
