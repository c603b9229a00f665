"""The AUV's environment on live data."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from navgym.auv import kernels as K
from navgym.auv.engine import linear, observation_names, station_of
from navgym.auv.settings import AUVDropoutSettings
from navgym.core.checks import Array, real_array, within
from navgym.core.health import NUMERICAL
from navgym.envs.base import TALLY
from navgym.envs.live import REFERENCE, LiveLane, flags, pooled
from navgym.statespace.filters import kalman, qivbf
from navgym.statespace.models import LinearModel

JITTER = 0.1  # by how much of it a step may miss the one that the model was made for
SAME_STEP = 1e-6  # relative difference of two steps that share a model, as in `models.step_of`

Model = LinearModel | Callable[[float], LinearModel]


class LiveAUV(LiveLane):
    """QIVBF twice, and the frozen Kalman filter beside it.

    Args:
        settings: of the environment.
        reference: parameters of the reference filter; residual actions start from them.
        model: what the filters believe, or, where samples come at uneven times, a function from a
            step in s to such a model. A model with a time axis holds sample by sample, its last
            one to the end.
        interval: s, for such a function: the step to the first sample, and to samples without a
            time of their own; 1 by default.
        rates: not for this filter.

    Raises:
        TypeError: a model of another kind.
        ValueError: an interval that is not positive.
    """

    def __init__(
        self,
        settings: AUVDropoutSettings,
        reference: Mapping[str, Any],
        model: Model,
        interval: float | None = None,
        rates: bool = False,
    ) -> None:
        super().__init__(settings, reference, observation_names(settings.action_parameters))
        if rates:
            raise ValueError("rates= is for filters of IMUs: leave it out.")
        self._interval = 1.0 if interval is None else within("interval", interval, 0.0, above=True)
        self._made = None if isinstance(model, LinearModel) else _checked_maker(model)
        self.model = linear(model if self._made is None else self._made(self._interval))
        n, m = self.model.n, self.model.m
        self.components = m
        station = station_of(self.model, self.reference)
        self._memory, parts = pooled(
            (qivbf.lane_type(n, m), 2), (kalman.lane_type(n, m), 1),
            (station.dtype, 2), (np.float64, TALLY),
        )  # fmt: skip
        self.lanes, self._frozen, self.stations, self.tally = parts
        self._before = self._memory.copy()
        self._sample = np.zeros(1, K.tape_type(n, m))
        self._packed = self.model.pack()
        known = self._made is None and self.model.dt is not None
        self._steps: list[float] = np.ravel(self.model.dt).tolist() if known else []
        self._model = self._packed[:1].copy()
        self._arguments = (
            self.lanes, self._frozen, self.stations, self._model, self._sample, self.table, self.tally,
        )  # fmt: skip
        self._views = [tuple(self.lanes[n][i : i + 1] for n in ("x", "P", "nis")) for i in (0, 1)]
        self._y, self._lost = self._sample["y"][0], self._sample["lost"][0]
        self.reset()

    def reset(self) -> None:
        """Go back to x0, P0, one step before the first sample."""
        self.time = None
        self.k = 0
        self._waiting = False
        self._step = self._interval
        self._use(self.model, self._packed[0])
        self.tally[:] = 0.0
        kalman.begin(self._frozen, self._model[None], self.reference[None])
        qivbf.begin(self.lanes, self._model[None], self.reference[None, None])
        self.stations[...] = station_of(self.model, self.reference)
        self.observation[...] = 0.0
        K.first_look(self.stations[:1], self.table, self.observation)  # type: ignore[no-untyped-call]

    # ---- samples ---------------------------------------------------------------------------

    def put(self, measurement: Any, lost: Any = None, time: float | None = None) -> None:
        """Take in one sample; see `agents.SelfTuningFilter.step`."""
        y = self._checked(measurement)
        if lost is not None:
            y[flags(lost, y.shape)] = np.nan
        now = self._checked_time(time)
        self._follow(now)
        self._y[...] = y
        self._lost[...] = 0 if math.isfinite(y.sum()) else np.isnan(y)
        self._sample["time"][0] = now
        self.time = now
        self._waiting = True

    def ready(self) -> bool:
        """Whether there is a sample to filter."""
        return self._waiting

    def step(self, look: bool) -> int:
        """Filter the sample; with `look` write the observation.

        Returns bits of the filters that failed and were started again: 1 the controlled one, 2
        the reference, 3 both.
        """
        self._waiting = False
        self.k += 1
        self._before[...] = self._memory
        failed = self._call(K.live, (*self._arguments, look, self.observation))
        if failed:
            failed = self._recover(failed, look)
        return failed & 3

    def answer(self, which: int) -> tuple[Array, Array, float]:
        """State, covariance and NIS of the controlled or the reference filter, copied."""
        x, P, nis = self._views[which]
        return x[0].copy(), P[0].copy(), nis.item()

    @staticmethod
    def samples(recording: Any) -> Iterator[tuple[Array, float, dict[str, Any]]]:
        """Measurements of a `navgym.Recording` and their times; see `LiveLane`."""
        for y, time in zip(recording.measurements, recording.time.tolist(), strict=True):
            yield y, time, {}

    def _checked(self, measurement: Any) -> Array:
        """The measurement as (m,) floats of its own; ValueError where it is none."""
        y = real_array("measurement", measurement, finite=False)
        m = len(self._y)
        if y.shape != (m,):
            raise ValueError(
                f"measurement must have shape ({m},), a number per row of the model's H, got "
                f"{y.shape}: pass NaN where a component was lost."
            )
        if not math.isfinite(y.sum()) and np.isinf(y).any():
            raise ValueError(f"measurement must be finite or NaN, got {y}: mark it as lost.")
        return y

    def _checked_time(self, time: float | None) -> float:
        if time is None:
            return (0.0 if self.time is None else self.time) + self._usual()
        now = float(time)
        if not np.isfinite(now) or (self.time is not None and now <= self.time):
            raise ValueError(
                f"time must be finite and increase, got {time} after {self.time}: drop samples that "
                "come late or twice."
            )
        return now

    # ---- the model of the step -----------------------------------------------------------------

    def _usual(self) -> float:
        """The step in s that the next sample is expected to take."""
        if not self._steps:
            return self._interval
        return self._steps[min(self.k, len(self._steps) - 1)]

    def _follow(self, now: float) -> None:
        """Bring the model to the step that ends at `now`."""
        step = self._usual() if self.time is None else now - self.time
        if self._made is not None:
            if abs(step - self._step) > SAME_STEP * self._step:
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
            self._model[0] = self._packed[min(self.k, len(self._packed) - 1)]

    def _use(self, model: LinearModel, packed: Any) -> None:
        if (model.n, model.m) != (self.model.n, self.model.m):
            raise ValueError(
                f"the function that makes models made one of size {(model.n, model.m)} after one of "
                f"size {(self.model.n, self.model.m)}."
            )
        self._model[0] = packed

    # ---- failures ----------------------------------------------------------------------------

    def _recover(self, failed: int, look: bool) -> int:
        if failed & 3 == 3:
            self._start_over(look)
        elif failed & 3:
            self._heal(failed)
        if self._frozen["diverged"][0] == NUMERICAL:
            kalman.begin(self._frozen, self._model[None], self.reference[None])
            self._frozen["x"], self._frozen["P"] = (self.lanes[n][REFERENCE] for n in ("x", "P"))
        return failed

    def _start_over(self, look: bool) -> None:
        """Both filters failed: go back to before the sample, widen what was believed, take it again.

        A sample that broke the numbers counts as lost; one that lies far off what was believed is
        what to believe now.
        """
        broken = (self.lanes["diverged"] == NUMERICAL).any()
        self._memory[...] = self._before
        x, P = self.lanes["x"][REFERENCE].copy(), self.lanes["P"][REFERENCE].copy()
        model, spread = self._model[0], 1.0
        if not np.isfinite(x).all():
            x, P = model["x0"], 0.0 * model["P0"]
        if broken:
            self._lost[...] = 1
        else:
            miss = (self._y - model["H"] @ (model["F"] @ x)) ** 2
            ratio = miss / np.diag(model["H"] @ model["P0"] @ model["H"].T + model["R"])
            spread = max(1.0, float(np.nanmax(ratio, initial=1.0)))
        qivbf.begin(self.lanes, self._model[None], self.reference[None, None])
        self.lanes["x"], self.lanes["P"] = x, P + spread * model["P0"]
        self._frozen["diverged"] = NUMERICAL  # starts again with them
        self._call(K.live, (*self._arguments, look, self.observation))
        self.tally[:] = 0.0


def _checked_maker(model: Any) -> Callable[[float], LinearModel]:
    if not callable(model):
        raise TypeError(
            "model must be a navgym.LinearModel, or a function from a step in s to one, got "
            f"{type(model).__name__}."
        )
    made: Callable[[float], LinearModel] = model
    return made
