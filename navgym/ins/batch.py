"""INS recordings made ready for the kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.inertial.blocks import SENSORS
from navgym.ins.error_state import MODEL
from navgym.ins.filtering import NAVIGATION, TAPE
from navgym.ins.measurements import EVENT, SENSOR
from navgym.ins.recording import InertialRecording
from navgym.ins.tape import pack_model, pack_sensors, write_tape

DECISION_SECONDS = 1.0  # per row of a parameter schedule, as in the environment


@dataclass(frozen=True, eq=False)
class InsBatch:
    """INS recordings, their increments summed up once for every filter that will run over them.

    Args:
        recordings: what they were made of.
        tapes: (N, K) records of `navgym.ins.filtering.TAPE`.
        events: (N, E) records of `navgym.ins.measurements.EVENT`.
        models: (N,).
        sensors: (N, SENSORS).
        lengths: (N,) filter steps of each; shorter ones end in zeros.
    """

    recordings: tuple[InertialRecording, ...]
    tapes: NDArray[Any]
    events: NDArray[Any]
    models: NDArray[Any]
    sensors: NDArray[Any]
    lengths: NDArray[np.int64]

    linear: ClassVar[bool] = True

    @classmethod
    def of(cls, recordings: Sequence[InertialRecording]) -> InsBatch:
        """Sum up `recordings`; ValueError if there is none, or if their steps differ."""
        given = tuple(recordings)
        if not given:
            raise ValueError("recordings must hold at least one InertialRecording, got none.")
        for r in given:
            if not isinstance(r, InertialRecording):
                raise TypeError(f"an INS recording must be an InertialRecording, got {type(r)}.")
        steps = {round(r.step, 6) for r in given}
        if len(steps) > 1:
            raise ValueError(
                f"recordings must share one filter step, got {sorted(steps)} s: split them."
            )
        lengths = np.array([r.steps for r in given])
        tapes = np.zeros((len(given), int(lengths.max())), TAPE)
        each = [write_tape(r, tape[: r.steps]) for tape, r in zip(tapes, given, strict=True)]
        events = np.zeros((len(given), max(1, *(len(e) for e in each))), EVENT)
        models, sensors = np.zeros(len(given), MODEL), np.zeros((len(given), SENSORS), SENSOR)
        for i, r in enumerate(given):
            events[i, : len(each[i])] = each[i]
            models[i] = pack_model(r.model, r.interval)[0]
            sensors[i] = pack_sensors(r.model)
        return cls(given, tapes, events, models, sensors, lengths)

    def __len__(self) -> int:
        return len(self.recordings)

    def take(self, which: Sequence[int] | NDArray[np.int64]) -> InsBatch:
        """Some of the recordings, in the order of `which`."""
        i = np.asarray(which, dtype=np.int64)
        return InsBatch(
            tuple(self.recordings[k] for k in i), self.tapes[i], self.events[i], self.models[i],
            self.sensors[i], self.lengths[i],
        )  # fmt: skip

    @property
    def steps(self) -> int:
        """Filter steps of the longest."""
        return int(self.tapes.shape[1])

    @property
    def step(self) -> float:
        """Seconds per filter step."""
        return self.recordings[0].step

    @property
    def decision_interval(self) -> int:
        """Filter steps in a second: per row of a schedule, as in the environment."""
        return max(1, round(DECISION_SECONDS / self.step))

    @property
    def truth(self) -> Array | None:
        """(N, K, 22) true states, NaN past a recording's end; None where one lacks them."""
        if any(r.truth is None for r in self.recordings):
            return None
        found = np.full((len(self), self.steps, self.recordings[0].truth.shape[1]), np.nan)
        for i, r in enumerate(self.recordings):
            found[i, : r.steps] = r.truth
        return found

    def regimes(self) -> list[NDArray[np.int64]]:
        """(K_i,) label of the true regime of each filter step; an empty list where not known."""
        if any(r.regime is None for r in self.recordings):
            return []
        return [r.regime for r in self.recordings]

    def time_of(self, i: int) -> Array:
        """(K_i,) s, when recording i's filter steps end."""
        return self.recordings[i].step_time


__all__ = ["NAVIGATION", "InsBatch"]
