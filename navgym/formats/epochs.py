"""Which moment sentences belong to that tell no time of their own.

An epoch is the run of sentences from one time to the next. A sentence without a time is of the epoch
that it stands in only if nothing between can be missing: of its kind the first there; what stands
before and after it, sentences with a time, repeated ones without and damaged lines, is the usual; the
next epoch is no further off than usual. All else, and what follows the last time of a file, may be
of a moment whose own sentences were lost.
"""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict

import numpy as np
from numpy.typing import NDArray

LONGEST = 50  # sentences of an epoch that are told apart
FURTHEST = 1.5  # usual steps
FEWEST = 3  # epochs that make something usual
UNREADABLE = "?"  # stands for a damaged line, and before a kind for the second of it in an epoch
REGULAR = 0.5  # share of epochs from which a sentence is usual: some come every tenth time


class Epochs:
    """The epochs of a file, as its sentences come."""

    def __init__(self) -> None:
        self.clocks = array("q")
        self.shapes: list[
            tuple[str, ...]
        ] = []  # kinds in an epoch, of those without a time the first
        self.known: dict[
            tuple[str, ...], tuple[str, ...]
        ] = {}  # so that equal shapes are one object
        self.shape: list[str] = []
        self.members: defaultdict[str, array[int]] = defaultdict(lambda: array("q"))
        self.homeless: Counter[str] = Counter()  # sentences that belong nowhere, by kind

    def timed(self, kind: str, clock: int | None) -> None:
        """A sentence with a time, ns; None for one that should have told it."""
        if clock is not None and (not self.clocks or clock != self.clocks[-1]):
            self._close()
            self.clocks.append(clock)
        self._stands(kind)

    def untimed(self, kind: str) -> bool:
        """Whether a sentence without a time may be of the epoch that it stands in."""
        if not self.clocks or kind in self.shape or len(self.shape) == LONGEST:
            self.homeless[kind] += 1
            if UNREADABLE + kind not in self.shape:
                self._stands(UNREADABLE + kind)
            return False
        self._stands(kind)
        self.members[kind].append(len(self.clocks) - 1)
        return True

    def unreadable(self) -> None:
        """A line that may have been any sentence."""
        self._stands(UNREADABLE)

    def sure(self, kind: str) -> NDArray[np.bool_]:
        """For each sentence of a kind that `untimed` took, whether it is of its epoch.

        Returns (n,), in the order of the file.
        """
        self._close()
        epochs = np.frombuffer(self.members[kind], np.int64) if self.members[kind] else np.zeros(0, np.int64)  # fmt: skip
        clocks = np.array(self.clocks, np.int64)
        step = np.append(np.diff(clocks), -1)[epochs]  # none after the last
        usual: NDArray[np.bool_] = self._usual([self.shapes[e] for e in epochs], kind) & (step > 0)
        if usual.sum() < FEWEST:
            return np.zeros(len(epochs), bool)
        sure: NDArray[np.bool_] = usual & (step <= FURTHEST * np.median(step[usual]))
        return sure

    def _usual(self, shapes: list[tuple[str, ...]], kind: str) -> NDArray[np.bool_]:
        """Which epochs have the most common sentences before and after one of a kind."""
        counts, within = Counter(shapes), Counter[str]()
        for shape, n in counts.items():
            within.update(dict.fromkeys(set(shape) - set(self.members), n))
        often = REGULAR * len(shapes)
        regular = {name for name, n in within.items() if n > often or name.startswith(UNREADABLE)}
        place = {s: _around(s, kind, regular) for s in counts}
        votes = Counter[tuple[tuple[str, ...], tuple[str, ...]]]()
        for shape, n in counts.items():
            votes[place[shape]] += n
        best = votes.most_common(1)[0][0] if votes else None
        return np.array([place[shape] == best for shape in shapes], bool)

    def _stands(self, kind: str) -> None:
        if len(self.shape) < LONGEST:
            self.shape.append(kind)

    def _close(self) -> None:
        if len(self.shapes) < len(self.clocks):
            shape = tuple(self.shape)
            self.shapes.append(self.known.setdefault(shape, shape))
        self.shape.clear()


def _around(shape: tuple[str, ...], kind: str, regular: set[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:  # fmt: skip
    """The usual sentences before and after one of a kind."""
    at = shape.index(kind)
    before, after = shape[:at], shape[at + 1 :]
    return tuple(s for s in before if s in regular), tuple(s for s in after if s in regular)
