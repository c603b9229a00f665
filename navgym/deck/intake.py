"""Samples of two IMUs one by one: checked, filled in where lost, gathered into filter steps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array, real_array, within
from navgym.deck.estimation import attitudes
from navgym.deck.mechanization import (
    ATTITUDE_M,
    ATTITUDE_S,
    HISTORY,
    LEVER,
    TAPE,
    begin_lever,
)
from navgym.deck.model import DeckModel
from navgym.envs.live import checked_time, flags, since

FIRST = 3  # samples that the rate at the start is extrapolated from
SHAPE = (4, 3)  # a sample: angle and velocity increments of the main, then of the sub IMU
USUAL_INTERVAL = 0.01  # s between IMU samples
LATE = 0.02  # by how much of it an IMU's step may miss the interval, as in `DualIMURecording`


class Intake:
    """What live deck filters share: samples in, and the strapdown mechanisation's state.

    Args:
        model: what the filter believes.
        interval: s between IMU samples; 0.01 by default.
        rates: whether samples hold rates (rad/s) and specific forces (m/s²); else increments.

    Raises:
        TypeError: a model of another kind.
    """

    time: float | Decimal | None

    def __init__(self, model: DeckModel, interval: float | None, rates: bool) -> None:
        if not isinstance(model, DeckModel):
            raise TypeError(f"model must be a navgym.DeckModel, got {type(model).__name__}.")
        usual = USUAL_INTERVAL if interval is None else interval
        self.model, self.interval = model, within("interval", usual, 0.0, above=True)
        self._unit = self.interval if rates else 1.0
        self._tape = np.zeros(1, TAPE)
        self._samples = np.zeros((4, HISTORY + model.samples_per_step, 3))
        self._filled = np.zeros(HISTORY + model.samples_per_step, dtype=np.bool_)
        self._moving = np.zeros((5, 4))
        self._disturbance = np.zeros(6)
        self._lever = np.array(model.lever_arm)

    def _begin_samples(self) -> None:
        """Begin with the next sample: both IMUs' axes frozen there."""
        self._started = False
        self._pending: list[tuple[Array, bool]] = []
        self._last = np.full(SHAPE, np.nan)
        self._moving[...] = 0.0
        self._moving[ATTITUDE_M : ATTITUDE_S + 1, 0] = 1.0
        self._tape[...] = np.zeros((), TAPE)
        self._tape["q_m"][:, 0] = self._tape["q_s"][:, 0] = 1.0

    def _start_samples(self) -> Array:
        """Put the mechanisation at its start; returns the main IMU's first angles (3, 3)."""
        first = np.stack([sample[0] for sample, _ in self._pending[:FIRST]])
        begin_lever(first, self._lever, self.interval, self._moving[LEVER])  # type: ignore[no-untyped-call]
        self._samples[:, :HISTORY] = self._pending[0][0][:, None]
        self._started = True
        return first

    def put(
        self,
        measurement: Any,
        lost: Any = None,
        time: float | Decimal | None = None,
        disturbance: Array | None = None,
    ) -> None:
        """Take in one sample of both IMUs; see `agents.SelfTuningFilter.step`.

        Args:
            measurement: (4, 3), or the same in one row of 12.
            lost: flags.
            time: s.
            disturbance: (6,) errors of the transmitted quantities, if a simulator made some.
        """
        sample, whole = _checked(measurement, self._unit)
        if lost is not None:
            sample[flags(lost, SHAPE)] = np.nan
            whole = _whole(sample)
        self.time = self._checked_time(time)
        self._disturbance[:] = 0.0 if disturbance is None else disturbance
        if not whole:
            self._fill(sample)
        if whole or self._started or not np.isnan(sample).any():
            self._last = sample
            self._pending.append((sample, not whole))

    def _checked_time(self, time: float | Decimal | None) -> float | Decimal:
        if time is None:
            return (0.0 if self.time is None else float(self.time)) + self.interval
        last, late = self.time, LATE * self.interval
        if type(time) is float and type(last) is float and abs(time - last - self.interval) <= late:
            return time  # as most are
        now = checked_time(time)
        if self.time is None:
            return now
        step = since(now, self.time)
        unsure = 0.0 if isinstance(now, Decimal) else 2.0 * math.ulp(now)
        if not abs(step - self.interval) <= LATE * self.interval + unsure:
            raise ValueError(
                f"time must move by the interval of {self.interval:.6g} s, got {time} after "
                f"{self.time}: pass missed samples as lost ones, and bring uneven ones to a grid; "
                "where the clock was set, call restart_clock() first."
            )
        return now

    def _fill(self, sample: Array) -> None:
        """Put in the other IMU's sample, turned by the attitude estimate, or hold the last one.

        What is made up is marked: the filter widens its covariance and leaves the step's rates out.
        A recording's gaps are filled alike, but with an attitude from the whole recording.
        """
        missing: Any = np.isnan(sample).any(axis=1)
        main_from_sub = self._attitude()
        for row in np.flatnonzero(missing):
            other = (row + 2) % 4
            if main_from_sub is None or missing[other]:
                sample[row] = self._last[row]
            else:
                turn = main_from_sub if row < 2 else main_from_sub.T
                sample[row] = turn @ sample[other]

    def _known(self) -> Array:
        """(24,) what is known of the state."""
        raise NotImplementedError

    def _attitude(self) -> Array | None:
        """The sub's axes in the main's, (3, 3); None before the filter has run."""
        x = self._known()
        if not self._started or not x.any():
            return None
        from scipy.spatial.transform import Rotation

        found: Array = Rotation.from_quat(attitudes(self._tape, x[None])[0][0]).as_matrix()
        return found

    def ready(self) -> bool:
        """Whether the samples of a filter step are there."""
        per = self.model.samples_per_step
        return len(self._pending) >= (per if self._started else max(per, FIRST))

    def _gather(self) -> None:
        """The step's samples, behind those before it."""
        per = self.model.samples_per_step
        for i, (sample, made_up) in enumerate(self._pending[:per], start=HISTORY):
            self._samples[:, i] = sample
            self._filled[i] = made_up
        del self._pending[:per]

    def _shift(self) -> None:
        """The step's last samples are the next one's history."""
        self._samples[:, :HISTORY] = self._samples[:, -HISTORY:].copy()

    @staticmethod
    def samples(recording: Any) -> Iterator[tuple[Array, float, dict[str, Any]]]:
        """Samples of a `navgym.DualIMURecording`, their times, and what was transmitted wrongly."""
        names = ("main_angle", "main_velocity", "sub_angle", "sub_velocity")
        whole = np.stack([getattr(recording, name) for name in names], axis=1)
        per, errors = recording.model.samples_per_step, recording.disturbance
        for k, time in enumerate(recording.time[: recording.steps * per].tolist()):
            more = {} if errors is None else {"disturbance": errors[k // per]}
            yield whole[k], time, more


def _checked(measurement: Any, unit: float) -> tuple[NDArray[np.float64], bool]:
    """A sample (4, 3) in increments, its own copy, and whether it is whole; ValueError if it is none."""
    if type(measurement) is np.ndarray and measurement.dtype == np.float64:  # needs no reading
        sample: Array = measurement * unit
    else:
        sample = real_array("measurement", measurement, finite=False) * unit
    if sample.shape not in (SHAPE, (12,)):
        raise ValueError(
            "measurement must have shape (4, 3), rows main angle, main velocity, sub angle, sub "
            f"velocity, got {sample.shape}: pass NaN where a sample was lost."
        )
    whole = _whole(sample)
    if not whole and np.isinf(sample).any():
        raise ValueError(f"measurement must be finite or NaN, got {measurement}: mark it as lost.")
    return sample.reshape(SHAPE), whole


_ONES = np.ones(12)  # times a sample: a number if that is whole, for a quarter of the time of sum()


def _whole(sample: Array) -> bool:
    """Whether all twelve numbers of a sample are there."""
    return math.isfinite(sample.reshape(-1).dot(_ONES))
