"""Samples of a linear model as they come in: their form, their times, and the model of each step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array, real_array, within
from navgym.envs.live import checked_time, flags, since
from navgym.statespace.models import LinearModel

JITTER = 0.1  # by how much of it a step may miss the one that the model was made for
SAME_STEP = 1e-6  # relative difference of two steps that share a model, as in `models.step_of`

Model = LinearModel | Callable[[float], LinearModel]


class LinearIntake:
    """Takes in samples one by one; whoever filters them finds them in `_sample` and `_model`.

    Args:
        model: what the filters believe, or, where samples come at uneven times, a function from a
            step in s to such a model. A model with a time axis holds sample by sample, its last
            one to the end.
        interval: s, for such a function: the step to the first sample, and to samples without a
            time of their own; 1 by default.

    Raises:
        TypeError: a model of another kind.
        ValueError: an interval that is not positive.
    """

    k: int  # samples filtered
    _model: NDArray[Any]  # (1,) packed model of the step to the sample
    _sample: NDArray[Any]  # (1,) record of y, lost and time
    _y: Array
    _lost: NDArray[Any]
    _clock: Array  # (1,) time in `_sample`

    def __init__(self, model: Model, interval: float | None = None) -> None:
        self._interval = 1.0 if interval is None else within("interval", interval, 0.0, above=True)
        self._made = None if isinstance(model, LinearModel) else _checked_maker(model)
        self.model = linear(model if self._made is None else self._made(self._interval))
        self._packed = self.model.pack()
        self._ones = np.ones(self.model.m)  # times a measurement: a number if that is whole
        known = self._made is None and self.model.dt is not None
        self._steps: list[float] = np.ravel(self.model.dt).tolist() if known else []

    def _begin_samples(self) -> None:
        """Go back to one step before the first sample."""
        self._y, self._lost = self._sample["y"][0], self._sample["lost"][0]
        self._clock = self._sample["time"]
        self.time: float | Decimal | None = None
        self._elapsed: float | None = None  # the kernels' time of the last sample
        self._origin: float | Decimal = 0.0  # and where that begins
        self.k = 0
        self._waiting = False
        self._step = self._interval
        self._use(self.model, self._packed[0])

    def put(self, measurement: Any, lost: Any = None, time: float | Decimal | None = None) -> None:
        """Take in one sample; see `agents.SelfTuningFilter.step`."""
        y, whole = self._checked(measurement)
        if lost is not None:
            y[flags(lost, y.shape)] = np.nan
            whole = math.isfinite(y.dot(self._ones))
        now, step = self._timed(time)
        self._follow(step, now)
        self._y[...] = y
        self._lost[...] = 0 if whole else np.isnan(y)
        self._clock[0] = self._elapsed = self._since_origin(now, step)
        self.time = now
        self._waiting = True

    @staticmethod
    def samples(recording: Any) -> Iterator[tuple[Array, float, dict[str, Any]]]:
        """Measurements of a `navgym.Recording` and their times; see `LiveLane`."""
        for y, time in zip(recording.measurements, recording.time.tolist(), strict=True):
            yield y, time, {}

    def _checked(self, measurement: Any) -> tuple[Array, bool]:
        """The measurement as (m,) floats of its own, and whether it is whole; ValueError for none."""
        if type(measurement) is np.ndarray and measurement.dtype == np.float64:
            y = measurement.copy()  # a subclass may mean more, such as a mask
        else:
            y = real_array("measurement", measurement, finite=False)
        m = len(self._y)
        if y.shape != (m,):
            raise ValueError(
                f"measurement must have shape ({m},), a number per row of the model's H, got "
                f"{y.shape}: pass NaN where a component was lost."
            )
        whole = math.isfinite(y.dot(self._ones))
        if not whole and np.isinf(y).any():
            raise ValueError(f"measurement must be finite or NaN, got {y}: mark it as lost.")
        return y, whole

    def _timed(self, time: float | Decimal | None) -> tuple[float | Decimal, float]:
        """Time of the sample, and the step to it, s; ValueError for one that is not after the last."""
        if time is None:
            step = self._usual()
            return (0.0 if self.time is None else float(self.time)) + step, step
        if type(time) is float and type(self.time) is float and self.time < time < math.inf:
            return time, time - self.time  # as most are
        now = checked_time(time)
        if self.time is None:
            return now, self._usual()
        step = since(now, self.time)
        if not step > 0.0:
            raise ValueError(
                f"time must be finite and increase, got {time} after {self.time}: drop samples that "
                "come late or twice; where the clock was set, call restart_clock() first."
            )
        return now, step

    def _since_origin(self, now: float | Decimal, step: float) -> float:
        """The sample's time as the kernels have it, s: small, and without a jump of the clock.

        Times that are floats are taken as they are, as a recording's are.
        """
        if self.time is None:
            if self._elapsed is None:
                self._origin = now if isinstance(now, Decimal) else 0.0
            else:
                self._origin = now - type(now)(self._elapsed + step)  # type: ignore[operator]
        return since(now, self._origin)

    # ---- the model of the step -----------------------------------------------------------------

    def _usual(self) -> float:
        """The step in s that the next sample is expected to take."""
        if not self._steps:
            return self._interval
        return self._steps[min(self.k, len(self._steps) - 1)]

    def _follow(self, step: float, now: float | Decimal) -> None:
        """Bring the model to a step that ends at `now`."""
        if self._made is not None:
            unsure = 0.0 if isinstance(now, Decimal) else 2.0 * math.ulp(now)
            if abs(step - self._step) > SAME_STEP * self._step + unsure:
                made = linear(self._made(step))
                self._use(made, made.pack()[0])
                self._step = step
            return
        usual = self._usual()
        if self._steps and abs(step - usual) > JITTER * usual:
            raise ValueError(
                f"time has moved by {step:.6g} s, and the model is made for steps of {usual:.6g} s: "
                "pass samples that were missed as lost ones, or give a function from a step to a "
                "model, for example model=navgym.LinearModel.white_acceleration."
            )
        if len(self._packed) > 1:
            self._use(self.model, self._packed[min(self.k, len(self._packed) - 1)])

    def _use(self, model: LinearModel, packed: Any) -> None:
        if (model.n, model.m) != (self.model.n, self.model.m):
            raise ValueError(
                f"the function that makes models made one of size {(model.n, model.m)} after one of "
                f"size {(self.model.n, self.model.m)}."
            )
        self._model[0] = packed


def linear(model: Any) -> LinearModel:
    """`model` if it is a LinearModel; TypeError if not."""
    if not isinstance(model, LinearModel):
        raise TypeError(
            f"the filter needs recordings with a LinearModel, got a {type(model).__name__}."
        )
    return model


def _checked_maker(model: Any) -> Callable[[float], LinearModel]:
    if not callable(model):
        raise TypeError(
            "model must be a navgym.LinearModel, or a function from a step in s to one, got "
            f"{type(model).__name__}."
        )
    made: Callable[[float], LinearModel] = model
    return made


def doubtful(model: Any, miss: Array, change: Array) -> Array:
    """What to add to P where innovations (m,), over the root of R, are `miss` and move by `change`."""
    H, R = model["H"], np.diag(model["R"])
    rate = H @ model["F"] - H  # of what a row sees, by the state
    wide: Array = model["P0"].copy()
    for seen, size in ((H, miss), (rate, change)):
        norm = np.square(seen).sum(axis=1)
        weight = np.divide(R * size**2, norm**2, out=np.zeros(len(R)), where=norm > 0.0)
        wide += (seen.T * weight) @ seen
    return wide
