"""A lane of the INS environment on live data: one IMU sample at a time, other sensors as they come."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array, one_of, real_array, within
from navgym.envs.columns import TALLY
from navgym.envs.live import LiveLane, checked_time, flags, pooled, since
from navgym.inertial.preintegration import preintegrate
from navgym.ins import filtering
from navgym.ins import kernels as K
from navgym.ins.catalogue import Ins
from navgym.ins.engine import environment_rule, observation_names, station_of
from navgym.ins.error_state import LANE
from navgym.ins.estimation import full_table, rule_of
from navgym.ins.layout import GATE, STATES
from navgym.ins.measurements import EVENT
from navgym.ins.model import InsModel
from navgym.ins.recording import nine_digits
from navgym.ins.settings import INSDropoutSettings
from navgym.ins.tape import AROUND, EARLY, events_of, look_back, pack_model, pack_sensors, shake

SHAPE = (2, 3)  # an IMU sample: angle and velocity increments
USUAL_INTERVAL = 0.01  # s between IMU samples
LATE = 0.02  # by how much of it an IMU's step may miss the interval, as in `InertialRecording`
MOST_EVENTS = 64  # of one step


@dataclass
class _Step:
    """What a step was filtered from, and the state before it: to filter it again.

    Args:
        number: of the step, from 0 on.
        memory: lanes and stations before it.
        angle: (AROUND + per, 3) increments, those before the step first.
        velocity: likewise.
        history: how many samples before the step there were.
        filled: IMU samples that were filled in.
        time: s, of its end.
        row: parameters of the controlled filter.
        events: of the step, by sample and sensor.
    """

    number: int
    memory: NDArray[np.uint8]
    angle: Array
    velocity: Array
    history: int
    filled: int
    time: float
    row: Array
    events: list[tuple[int, int, Array, float]] = field(default_factory=list)


class LiveINS(LiveLane):
    """The INS filter, its reference and that one's twin on one IMU and what other sensors say.

    A sample is the IMU's, (2, 3) or 6 numbers: angle increments (rad), velocity increments (m/s); or a
    mapping that holds it as "imu", and beside it measurements by the names of the model's sensors: an array,
    None or NaN where one should have come and did not, or a pair of it and the time when it was valid.
    What arrives late is filtered at its own moment, if that lies within the latencies of the model's sensors:
    the steps since then are filtered again.

    Args:
        settings: of the environment.
        reference: parameters of the reference filter; residual actions start from them.
        model: what the filters believe.
        interval: s between IMU samples; 0.01 by default.
        rates: whether samples hold rates (rad/s) and specific forces (m/s²); else increments.

    Raises TypeError for a model of another kind.
    """

    components = 11

    def __init__(
        self,
        settings: INSDropoutSettings,
        reference: Mapping[str, Any],
        model: InsModel,
        interval: float | None = None,
        rates: bool = False,
    ) -> None:
        super().__init__(settings, reference, observation_names(settings))
        if not isinstance(model, InsModel):
            raise TypeError(f"model must be an InsModel, got {type(model).__name__}.")
        usual = USUAL_INTERVAL if interval is None else interval
        self.model = model
        self.interval = nine_digits(within("interval", usual, 0.0, above=True))
        self._unit = self.interval if rates else 1.0
        self._warmup = settings.warmup
        self._names = list(model.sensors)
        self._memory, parts = pooled((LANE, 3), (K.STATION, 2))
        self.lanes, self.stations = parts
        self.tally, self._scratch = np.zeros(TALLY), np.zeros(TALLY)
        self._model, self._sensors = pack_model(model, self.interval), pack_sensors(model)
        self._tape, self._events = np.zeros(1, filtering.TAPE), np.zeros(MOST_EVENTS, EVENT)
        self._own_row = full_table(settings.SPACE, self.reference)
        latest = max((s.latency for s in model.sensors.values()), default=0.0)
        step = self.interval * model.samples_per_step
        self._past: deque[_Step] = deque(maxlen=math.ceil(latest / step) + 2 if latest else 1)
        self._keeps = latest > 0.0
        self._arguments = (
            self.lanes, self.stations, self._model, self._sensors, self._tape, self._events,
            rule_of(Ins("trust"), False), environment_rule(settings), GATE,
            np.zeros(1, filtering.REPORT), self.table,
        )  # fmt: skip
        self.reset()

    @property
    def warmup(self) -> int:
        """Filter steps with the reference's parameters before the first decision."""
        return round(self._warmup / (self.interval * self.model.samples_per_step))

    def reset(self) -> None:
        """Begin anew with the next sample, at the model's start."""
        self.time = None
        self._count = self._steps = 0
        self._pending: list[tuple[Array, bool]] = []
        self._history = np.zeros((0, 2, 3))
        self._last = np.full(SHAPE, np.nan)
        self._heard: list[tuple[int, int, Array, float]] = []
        self._past.clear()
        self._begin()

    def _begin(self) -> None:
        filtering.begin(self.lanes, np.repeat(self._model, 3), self._own_row)
        self.stations[...] = station_of(self.reference)
        self.tally[:] = 0.0
        self.observation[...] = 0.0
        K.first_look(self.stations[:1], self.lanes[:1], self.table, self.observation)  # type: ignore[no-untyped-call]

    # ---- samples ---------------------------------------------------------------------------

    def put(self, measurement: Any, lost: Any = None, time: float | Decimal | None = None) -> None:
        """Take in one sample; see the class.

        Raises ValueError for a wrong shape, a sensor that the model does not know, infinity, or a time that
        does not move by the interval. Nothing has changed then.
        """
        given = dict(measurement) if isinstance(measurement, Mapping) else {"imu": measurement}
        sample = _checked(given.pop("imu", np.full(SHAPE, np.nan)), self._unit)
        if lost is not None:
            sample[flags(lost, SHAPE)] = np.nan
        now = self._checked_time(time)
        heard = [self._event(name, value, now) for name, value in given.items()]
        self.time = now
        whole = math.isfinite(sample.sum())
        if whole:
            self._last = sample
        elif np.isnan(self._last).any():
            return  # before the first whole sample nothing can be held
        self._count += 1
        self._pending.append((self._last if not whole else sample, not whole))
        self._heard += [(self._count + o, which, z, at) for o, which, z, at in heard]

    def _event(self, name: str, value: Any, now: float | Decimal) -> tuple[int, int, Array, float]:
        """Samples since the current one (0 or less), sensor, numbers, and time of a measurement."""
        which = self._names.index(one_of("sensor of the model", name, self._names))
        moment: float | Decimal = now
        if isinstance(value, tuple) and len(value) == 2 and not np.isscalar(value[0]):
            value, moment = value[0], checked_time(value[1])
        rows = self.model.sensors[name].rows
        found = np.full(rows, np.nan) if value is None else real_array(name, value, finite=False)
        found = found.reshape(-1)
        if found.shape != (rows,) or np.isinf(found).any():
            raise ValueError(
                f"{name} must be {rows} finite numbers, or NaN where lost, got {value!r}."
            )
        offset = round(since(moment, now) / self.interval - EARLY)
        if offset > 0:
            raise ValueError(
                f"{name} must have been valid by now, {now} s, got {moment}: bring both to one clock."
            )
        return offset, which, found, float(moment)

    def _checked_time(self, time: float | Decimal | None) -> float | Decimal:
        if time is None:
            return (0.0 if self.time is None else float(self.time)) + self.interval
        now = checked_time(time)
        if self.time is None:
            return now
        step = since(now, self.time)
        unsure = 0.0 if isinstance(now, Decimal) else 2.0 * math.ulp(now)
        if not abs(step - self.interval) <= LATE * self.interval + unsure:
            raise ValueError(
                f"time must move by the interval of {self.interval:.6g} s, got {time} after "
                f"{self.time}: pass missed samples as lost ones; where the clock was set, call "
                "restart_clock() first."
            )
        return now

    def ready(self) -> bool:
        """Whether the samples of a filter step are there."""
        return len(self._pending) >= self.model.samples_per_step

    def step(self, look: bool) -> int:
        """Filter the step's samples; with `look` write the observation.

        Returns bits of the filters that failed: 1 the controlled one, 2 the reference. Where one did, it goes
        on from the other; where both did, both begin anew at the model's start.
        """
        per = self.model.samples_per_step
        assert self.time is not None
        samples = np.stack([s for s, _ in self._pending[:per]])
        whole = np.concatenate([self._history, samples])
        now = _Step(
            self._steps,
            self._memory.copy() if self._keeps else self._memory,
            np.ascontiguousarray(whole[:, 0]),
            np.ascontiguousarray(whole[:, 1]),
            len(self._history),
            sum(made_up for _, made_up in self._pending[:per]),
            float(self.time),
            self.stations["row"][0].copy(),
        )
        del self._pending[:per]
        self._history = whole[-AROUND:]
        self._steps += 1
        self._sort_in(now)
        failed = self._filter(now, self.tally, look)
        if self._keeps:
            self._past.append(now)
        if failed == 3:
            self._begin()
        elif failed:
            self._heal(failed)
        return failed

    def _sort_in(self, now: _Step) -> None:
        """Give the step its events; those of earlier moments go to theirs, which are filtered again."""
        per, late = self.model.samples_per_step, []
        for event in self._heard:
            number = (event[0] - 1) // per
            if number == now.number:
                now.events.append(event)
            elif number < now.number:
                late.append((number, event))
        self._heard = [e for e in self._heard if (e[0] - 1) // per > now.number]
        reached = {step.number: step for step in self._past}
        late = [(number, event) for number, event in late if number in reached]
        if not late:
            return
        for number, event in late:
            reached[number].events.append(event)
        first = min(number for number, _ in late)
        self._memory[:] = reached[first].memory
        for step in self._past:
            if step.number >= first:
                step.memory = self._memory.copy()
                self.stations["row"][0] = step.row
                self._filter(step, self._scratch, False)
        self.stations["row"][0] = now.row
        now.memory = self._memory.copy()

    def _filter(self, step: _Step, tally: Array, look: bool) -> int:
        """Filter one step, from what it holds."""
        per, history, h = self.model.samples_per_step, step.history, self.interval
        tape = self._tape
        preintegrate(step.angle[history:], step.velocity[history:], h, per, tape)  # type: ignore[no-untyped-call]
        shake(step.velocity[history:], h, per, tape["shake"])  # type: ignore[no-untyped-call]
        tape["gap"], tape["time"], tape["imu_scale"] = h * step.filled, step.time, np.nan
        step.events.sort(key=lambda event: event[:2])
        chosen = step.events[:MOST_EVENTS]
        tape["first"], tape["count"] = 0, len(chosen)
        events = self._events[: len(chosen)]
        events[...] = np.zeros((), EVENT)
        for record, (_, sensor, numbers, moment) in zip(events, chosen, strict=True):
            lost = bool(np.isnan(numbers).any())
            record["sensor"], record["lost"], record["time"] = sensor, lost, moment
            record["z"][: len(numbers)] = 0.0 if lost else numbers
            record["scale"] = np.nan
        base = step.number * per - history
        sample = np.array([event[0] - base for event in chosen], dtype=np.int64)
        end = np.full(len(chosen), history + per, dtype=np.int64)
        look_back(step.angle, step.velocity, sample, end, h, events)  # type: ignore[no-untyped-call]
        return self._call(K.live, (*self._arguments, tally, look, self.observation))

    def answer(self, which: int) -> tuple[Array, Array, float]:
        """State, covariance and NIS of the controlled or the reference filter, copied."""
        lane = self.lanes[which]
        return lane["x"].copy(), lane["P"].copy(), lane["nis"].item()

    @staticmethod
    def samples(recording: Any) -> Iterator[tuple[Any, float, dict[str, Any]]]:
        """Samples of an `InertialRecording`, measurements as late as the model's latencies; see `LiveLane`."""
        r, per, h = recording, recording.model.samples_per_step, recording.interval
        events, sample = events_of(r)
        sensors = list(r.model.sensors.items())
        arriving: dict[int, dict[str, Any]] = {}
        for event, at in zip(events, sample.tolist(), strict=True):
            name, sensor = sensors[int(event["sensor"])]
            value = (
                np.full(sensor.rows, np.nan) if event["lost"] else event["z"][: sensor.rows].copy()
            )
            late = min(at + round(sensor.latency / h), r.steps * per)
            while name in arriving.setdefault(late, {}):
                late += 1
            arriving[late][name] = (value, float(event["time"]))
        whole = np.stack([r.angle, r.velocity], axis=1)
        for k in range(r.steps * per):
            more = arriving.get(k + 1)
            imu = whole[k]
            yield imu if more is None else {"imu": imu, **more}, float(r.time[k]), {}


def _checked(measurement: Any, unit: float) -> Array:
    """An IMU sample (2, 3) in increments, its own copy; ValueError where it is none."""
    sample = real_array("measurement", measurement, finite=False) * unit
    if sample.shape not in (SHAPE, (6,)):
        raise ValueError(
            "measurement must have shape (2, 3), angle and velocity increments of the IMU, got "
            f"{sample.shape}: pass NaN where a sample was lost, and other sensors by name, for "
            "example {'imu': ..., 'dvl': ...}."
        )
    if not math.isfinite(sample.sum()) and np.isinf(sample).any():
        raise ValueError(f"measurement must be finite or NaN, got {measurement}: mark it as lost.")
    return sample.reshape(SHAPE)


__all__ = ["STATES", "LiveINS"]
