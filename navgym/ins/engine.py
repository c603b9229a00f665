"""The engine behind the INS environment: the error-state Kalman filter on every lane."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.envs.base import LaneEngine, Shelf
from navgym.inertial.blocks import SENSORS
from navgym.ins import filtering
from navgym.ins import kernels as K
from navgym.ins.batch import InsBatch
from navgym.ins.catalogue import Ins
from navgym.ins.error_state import LANE, MODEL
from navgym.ins.estimation import NO_GATE, OFF, columns_of, full_table, rule_of
from navgym.ins.layout import COLUMNS, GATE, STATES
from navgym.ins.measurements import EVENT, SENSOR
from navgym.ins.recording import InertialRecording
from navgym.ins.settings import INSDropoutSettings

SIGNAL_NAMES = (
    "since", "turned", "change", "twin.change", "spread", "twin.spread", "jolt", "jolt.most",
    "log_nis.0.8", "log_nis.0.97", "lost", "rate", "shake",
)  # fmt: skip


class InsEngine(LaneEngine):
    """N lanes of the INS filter; see `LaneEngine`.

    Memory: a recording of T seconds takes T · 6 kB on the shelf; a lane takes 14 kB.
    """

    settings: INSDropoutSettings
    INFO_NAMES: ClassVar[tuple[str, ...]] = (
        "position_rmse", "reference_position_rmse", "velocity_rmse", "reference_velocity_rmse", "nis",
        "silence", "regime", "reward_term",
    )  # fmt: skip

    def _begin(self) -> None:
        self._rule = environment_rule(self.settings)
        self._filter_rule = rule_of(Ins("trust"), False)
        self._report = np.zeros(1, filtering.REPORT)

    def _allocate(self, trail: bool) -> None:
        self.lanes = np.zeros(self.count, LANE)
        self.stations = np.repeat(station_of(self._row(self.reference)), self.count)
        longest = self.shelf.tapes.shape[1] if trail else 0
        self.trail = np.full((self.count, longest, STATES + 1), np.nan)

    @property
    def kernel(self) -> Any:
        """See `LaneEngine`."""
        return K.decide

    @property
    def features(self) -> tuple[str, ...]:
        """One name per element of an observation."""
        return observation_names(self.settings)

    # ---- where recordings come from ----------------------------------------------------

    def _empty_shelf(self, lanes: int) -> Shelf:
        longest = max(s.samples // s.samples_per_step for s in self._scenarios)
        events = max(events_of(s) for s in self._scenarios)
        return Shelf(
            tapes=np.zeros((lanes, longest), filtering.TAPE),
            models=np.zeros(lanes, MODEL),
            stations=np.repeat(station_of(self._row(self.reference)), lanes),
            labels=[{} for _ in range(lanes)],
            extra={
                "events": np.zeros((lanes, events), EVENT),
                "sensors": np.zeros((lanes, SENSORS), SENSOR),
                "scores": np.zeros((lanes, longest, K.SCORES)),
                "twin": np.zeros((lanes, longest, K.TWIN)),
                "means": np.zeros((lanes, 2)),
                "checkpoints": np.zeros(lanes, LANE),
            },
        )

    def prepare(
        self,
        recordings: Sequence[InertialRecording],
        rows: Sequence[Array],
        place: NDArray[Any] | None = None,  # noqa: ARG002
    ) -> Shelf:
        """Make recordings ready: sum up their increments and run the reference filter; see `LaneEngine`."""
        batch = InsBatch.of(recordings)
        self.check_truth(batch.truth)
        count, steps = batch.tapes.shape
        stations = np.concatenate([station_of(row) for row in rows])
        stations["which"], stations["length"] = np.arange(count), batch.lengths
        lanes, checkpoints = np.zeros(count, LANE), np.zeros(count, LANE)
        filtering.begin(lanes, batch.models, full_table(self.space, stations["row"]))
        checkpoints[...] = lanes
        twins = lanes.copy()
        begun = stations.copy()
        scores, told = (np.zeros((count, steps, n)) for n in (K.SCORES, K.TWIN))
        means = np.zeros((count, 2))
        K.rehearse(
            lanes, twins, stations, batch.models, batch.sensors, batch.tapes, batch.events,
            self._filter_rule, self._rule, GATE, self._starts(batch), self._report, checkpoints, begun,
            scores, told, means,
        )  # fmt: skip
        extra: dict[str, Any] = {
            "events": batch.events, "sensors": batch.sensors, "scores": scores, "twin": told,
            "means": means, "checkpoints": checkpoints,
        }  # fmt: skip
        labels = [{"recording": i, **dict(r.meta)} for i, r in enumerate(recordings)]
        return Shelf(batch.tapes, batch.models, begun, labels, extra)

    def _starts(self, batch: InsBatch) -> NDArray[np.int64]:
        """Where lanes begin: after the warm-up, if that leaves at least one decision."""
        warm = round(self.settings.warmup / batch.step)
        fits = batch.lengths > warm + self.settings.decision_interval
        return np.where(fits, warm, 0)

    # ---- life of a lane -------------------------------------------------------------

    def _start_lane(self, i: int, which: int, start: int | None) -> NDArray[np.float32]:
        lane, station, shelf = self.lanes[i : i + 1], self.stations[i : i + 1], self.shelf
        obs = np.zeros((1, len(self.observation_names)), dtype=np.float32)
        if start is None:
            lane[...] = shelf.extra["checkpoints"][which]
        else:
            row = station["row"].copy()
            station[...] = station_of(row[0])
            station["which"], station["length"] = which, shelf.stations["length"][which]
            filtering.begin(lane, shelf.models[which : which + 1], full_table(self.space, row))
        if start:
            rule = self._rule.copy()
            rule["interval"] = start
            K.decide(  # type: ignore[call-arg]
                lane, station, *self._world_of(), rule, GATE, self._report, self.table[:0],
                self._actions[i : i + 1, :0], obs, np.zeros((1, self._outcomes.shape[1])),
                self.trail[i : i + 1],
            )  # fmt: skip
        K.first_look(station, lane, self.table, obs)
        first: NDArray[np.float32] = obs[0]
        return first

    def _world_of(self) -> tuple[Any, ...]:
        """Arguments of `decide` from the models to the filter's rule."""
        shelf, extra = self.shelf, self.shelf.extra
        return (
            shelf.models, extra["sensors"], shelf.tapes, extra["events"], extra["scores"], extra["twin"],
            extra["means"], self._filter_rule,
        )  # fmt: skip

    def _gather(self) -> tuple[Any, ...]:
        return (
            self.lanes, self.stations, *self._world_of(), self._rule, GATE, self._report, self.table,
            self._actions,
        )  # fmt: skip


def events_of(scenario: Any) -> int:
    """How many measurements a recording of a scenario can hold."""
    s = scenario
    periods = (s.dvl_period, s.depth_period, s.magnetometer_period, s.fix_period, s.water_period)
    every = [max(1, round(p * s.rate)) for p in periods if p > 0.0]
    return max(1, sum(s.samples // e for e in every))


def observation_names(settings: INSDropoutSettings) -> tuple[str, ...]:
    """One name per element of an observation of such an environment."""
    return (*SIGNAL_NAMES, *(f"parameter.{name}" for name in settings.action_parameters))


def environment_rule(settings: INSDropoutSettings) -> NDArray[Any]:
    """The kernels' rule (1,)."""
    rule = np.zeros(1, K.RULE)
    rule["interval"] = settings.decision_interval
    rule["kind"] = settings.REWARDS.index(settings.reward)
    rule["clip"] = settings.reward_clip
    rule["columns"] = columns_of(settings.SPACE)
    rule["off"], rule["no_gate"] = [OFF[c] for c in COLUMNS], NO_GATE
    return rule


def station_of(row: Array) -> NDArray[Any]:
    """A station (1,) at the start of a recording, with parameters `row` in force."""
    station = np.zeros(1, K.STATION)
    station["active"], station["row"] = 1, row
    return station
