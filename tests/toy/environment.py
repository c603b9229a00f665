"""`navgym/ToyWalk-v0`: engine, both faces, painter and live lane."""

import math

import numpy as np

from navgym.core.checks import within
from navgym.envs.base import LaneEngine, Shelf
from navgym.envs.canvas import Canvas
from navgym.envs.columns import TALLY
from navgym.envs.faces import LaneEnv, LaneVectorEnv
from navgym.envs.live import LiveLane
from tests.toy import kernels as K
from tests.toy.filtering import WalkBatch, packed
from tests.toy.settings import ToyWalkSettings
from tests.toy.world import WalkModel


def observation_names(parameters):
    """One name per element of an observation."""
    signals = (*(f"log_nis.{d:g}" for d in K.DECAYS), "lost")
    return (*signals, *(f"parameter.{name}" for name in parameters))


def station_of(row):
    """A station (1,) at the start of a walk, with parameters `row` in force."""
    station = np.zeros(1, K.STATION)
    station["active"], station["row"] = 1, row
    return station


class WalkEngine(LaneEngine):
    """N lanes of the toy's filter."""

    INFO_NAMES = ("rmse", "reference_rmse", "nis", "regime", "reward_term")
    kernel = K.decide

    @property
    def features(self):
        return observation_names(self.settings.action_parameters)

    def _allocate(self, trail):
        s = self.settings
        self.lanes = np.zeros(self.count, K.LANE)
        self.stations = np.repeat(station_of(self._row(self.reference)), self.count)
        rule = (s.decision_interval, s.REWARDS.index(s.reward), s.reward_clip)
        self._rule = np.array([rule], K.RULE)
        longest = self.shelf.tapes.shape[1] if trail else 0
        self.trail = np.full((self.count, longest, 1), np.nan)

    def _empty_shelf(self, lanes):
        longest = max(s.steps for s in self._scenarios)
        station = station_of(self._row(self.reference))
        return Shelf(
            tapes=np.zeros((lanes, longest), K.TAPE),
            models=np.zeros(lanes, K.MODEL),
            stations=np.repeat(station, lanes),
            labels=[{} for _ in range(lanes)],
            extra={},
        )

    def prepare(self, recordings, rows, place=None):
        batch = WalkBatch.of(recordings)
        self.check_truth(batch.truth)
        tapes = np.zeros(batch.y.shape, K.TAPE)
        tapes["y"] = batch.y
        tapes["truth"] = np.nan if batch.truth is None else batch.truth[..., 0]
        for i, r in enumerate(recordings):
            tapes["time"][i, : len(r)] = r.time
            tapes["regime"][i, : len(r)] = np.nan if r.regime is None else r.regime
        stations = np.concatenate([station_of(row) for row in rows])
        stations["which"], stations["length"] = np.arange(len(recordings)), batch.lengths
        models, references = packed(recordings), np.zeros(len(recordings), K.LANE)
        K.begin(references, models)
        K.prepare(references, models, tapes, stations)
        labels = [{"recording": i, **r.meta} for i, r in enumerate(recordings)]
        return Shelf(tapes, models, stations, labels, {})

    def _start_lane(self, i, which, start):
        lane, station = self.lanes[i : i + 1], self.stations[i : i + 1]
        K.begin(lane, self.shelf.models[which : which + 1])
        obs = np.zeros((1, len(self.observation_names)), dtype=np.float32)
        if start:
            rule = self._rule.copy()
            rule["interval"] = start
            K.decide(
                lane, station, self.shelf.models, self.shelf.tapes, self.table[:0], rule,
                self._actions[i : i + 1, :0], obs, np.zeros((1, self._outcomes.shape[1])),
                self.trail[i : i + 1],
            )  # fmt: skip
        K.first_look(station, self.table, obs)
        return obs[0]

    def _gather(self):
        return (
            self.lanes, self.stations, self.shelf.models, self.shelf.tapes, self.table, self._rule,
            self._actions,
        )  # fmt: skip


class WalkPainter(Canvas):
    """Truth and estimate over time."""

    def draw(self, engine, rows):
        k, which = (int(engine.stations[name][0]) for name in ("k", "which"))
        tape = engine.shelf.tapes[which][: max(k, 1)]
        axes = self._figure.add_subplot()
        axes.plot(tape["time"], tape["truth"], color="#444444", label="truth")
        axes.plot(tape["time"], engine.trail[0, : max(k, 1), 0], color="#0a6ebd", label="estimate")
        axes.set(xlabel="time, s", ylabel="x, m")
        axes.legend()


class ToyWalkEnv(LaneEnv):
    """Choose how much a filter believes that a walk wanders.

    ## Description
    A scalar walks at random, gently or roughly, and some measurements of it get lost. The agent sets
    the process noise of a Kalman filter.

    ## Action Space
    `Box(-1, 1, (k,), float32)`, an element per name in `action_parameters`.

    {parameters}

    ## Observation Space
    `Box(-5, 5, (3 + k,), float32)`: two exponential means of half the logarithm of the NIS, the
    share of lost samples, and the parameters in force in their range.

    ## Rewards
    `reward="difference"`: minus the squared error less the reference filter's, m². `"likelihood"`:
    mean log-likelihood of the innovations.

    ## Starting State
    The filter holds x0, P0 one sample before the first measurement.

    ## Episode End
    `terminated` if the filter diverges, `truncated` at the recording's end.

    ## Arguments
    {arguments}

    ```python
    >>> import gymnasium
    >>> env = gymnasium.make("navgym/ToyWalk-v0", scenario="toy/switch")
    >>> obs, info = env.reset(seed=1)
    >>> obs.shape
    (4,)

    ```

    ## Version History
    * v0: first version
    """

    SETTINGS = ToyWalkSettings
    ENGINE = WalkEngine
    PAINTER = WalkPainter


class ToyWalkVectorEnv(LaneVectorEnv):
    """The batch face of `ToyWalkEnv`."""

    SETTINGS = ToyWalkSettings
    ENGINE = WalkEngine
    PAINTER = WalkPainter


class LiveWalk(LiveLane):
    """The toy's filter twice, sample by sample."""

    components = 1

    def __init__(self, settings, reference, model, interval=None, rates=False):
        super().__init__(settings, reference, observation_names(settings.action_parameters))
        if not isinstance(model, WalkModel):
            raise TypeError(f"model must be a WalkModel, got {type(model).__name__}.")
        if rates:
            raise ValueError("rates= is for filters of IMUs: leave it out.")
        self._interval = model.step if interval is None else interval
        within("interval", self._interval, 0.0, above=True)
        self._model = np.array(
            [tuple(getattr(model, name) for name in K.MODEL.names)], dtype=K.MODEL
        )
        self.lanes, self.stations = np.zeros(2, K.LANE), np.zeros(2, K.STATION)
        self.tally, self._sample = np.zeros(TALLY), np.zeros(1, K.TAPE)
        self._arguments = (
            self.lanes, self.stations, self._model, self._sample, self.table, self.tally,
        )  # fmt: skip
        self.reset()

    def reset(self):
        self.time, self._waiting = None, False
        K.begin(self.lanes, np.repeat(self._model, 2))
        self.stations[...] = station_of(self.reference)
        self.tally[:] = 0.0
        K.first_look(self.stations[:1], self.table, self.observation)

    def put(self, measurement, lost=None, time=None):
        y = float(measurement)
        if math.isinf(y):
            raise ValueError(f"measurement must be finite or NaN, got {y}: mark it as lost.")
        now = (self.time or 0.0) + self._interval if time is None else float(time)
        if self.time is not None and now <= self.time:
            raise ValueError(f"time must increase, got {time} after {self.time}.")
        self._sample["y"] = math.nan if lost else y
        self._sample["time"] = self.time = now
        self._waiting = True

    def ready(self):
        return self._waiting

    def step(self, look):
        self._waiting = False
        failed = self._call(K.live, (*self._arguments, look, self.observation))
        if failed == 3:
            K.begin(self.lanes, np.repeat(self._model, 2))
        elif failed:
            self._heal(failed)
        return failed

    def answer(self, which):
        lane = self.lanes[which]
        return lane["x"].copy(), lane["P"].copy(), lane["nis"].item()

    @staticmethod
    def samples(recording):
        for y, time in zip(recording.measurements.tolist(), recording.time.tolist(), strict=True):
            yield y, time, {}
