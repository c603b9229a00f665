"""Deck recordings made ready for the kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.deck.mechanization import tapes_of
from navgym.deck.recording import DualIMURecording

DECISION_SECONDS = 1.0  # per row of a parameter schedule, as in the environment


@dataclass(frozen=True, eq=False)
class DeckBatch:
    """Recordings of two IMUs, mechanised once for every filter that will run over them.

    Args:
        recordings: what they were made of.
        tapes: (N, K) records of `navgym.deck.mechanization.TAPE`, 6.9 kB per second at 20 Hz.
        lengths: (N,) filter steps of each; shorter ones end in zeros.
    """

    recordings: tuple[DualIMURecording, ...]
    tapes: NDArray[Any]
    lengths: NDArray[np.int64]

    @classmethod
    def of(cls, recordings: Sequence[DualIMURecording]) -> DeckBatch:
        """Mechanise `recordings`; ValueError if there is none, or if their steps differ."""
        given = tuple(recordings)
        if not given:
            raise ValueError("recordings must hold at least one DualIMURecording, got none.")
        for r in given:
            if not isinstance(r, DualIMURecording):
                raise TypeError(f"a deck recording must be a DualIMURecording, got {type(r)}.")
        steps = {round(r.step, 9) for r in given}
        if len(steps) > 1:
            raise ValueError(
                f"recordings must share one filter step, got {sorted(steps)} s: split them."
            )
        tapes, lengths = tapes_of(given)
        return cls(given, tapes, lengths)

    def __len__(self) -> int:
        return len(self.recordings)

    def take(self, which: Sequence[int] | NDArray[np.int64]) -> DeckBatch:
        """Some of the recordings, in the order of `which`."""
        index = np.asarray(which, dtype=np.int64)
        chosen = tuple(self.recordings[i] for i in index)
        return DeckBatch(chosen, self.tapes[index], self.lengths[index])

    linear: ClassVar[bool] = True

    @property
    def steps(self) -> int:
        """Filter steps of the longest."""
        return int(self.tapes.shape[1])

    @property
    def decision_interval(self) -> int:
        """Filter steps in a second: per row of a schedule, as in the environment."""
        return max(1, round(DECISION_SECONDS / self.step))

    def regimes(self) -> list[NDArray[np.int64]]:
        """(K_i,) label of the true regime of each filter step; an empty list where not known."""
        if any(r.regime is None for r in self.recordings):
            return []
        labels = np.nan_to_num(self.tapes["regime"]).astype(np.int64)
        return [row[:length] for row, length in zip(labels, self.lengths, strict=True)]

    def time_of(self, i: int) -> Array:
        """(K_i,) s, when recording i's filter steps end."""
        return self.recordings[i].step_time

    @property
    def step(self) -> float:
        """Seconds per filter step."""
        return self.recordings[0].step

    @property
    def truth(self) -> Array | None:
        """(N, K, 6) true θ and θ̇, NaN past a recording's end; None where one lacks them."""
        if any(r.theta is None or r.theta_rate is None for r in self.recordings):
            return None
        known = np.concatenate([self.tapes["theta"], self.tapes["theta_rate"]], axis=-1)
        known[np.arange(known.shape[1]) >= self.lengths[:, None]] = np.nan
        return known
