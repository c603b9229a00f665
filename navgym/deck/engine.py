"""The engine behind the deck environment: the 24-state filter on every lane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.deck import alignment, alignment_model, spaces
from navgym.deck import kernels as K
from navgym.deck.batch import DeckBatch
from navgym.deck.catalogue import Deck
from navgym.deck.filters import columns_of, full_table, identify_lane
from navgym.deck.mechanization import TAPE
from navgym.deck.recording import DualIMURecording
from navgym.deck.settings import FEATURES, DeckDeformationSettings
from navgym.envs.base import LaneEngine, Shelf
from navgym.envs.columns import TERMINATED
from navgym.inertial.flexure import FlexureModel

SIGNALS = ("alarm", "persistence", "rejected")
WINDOW = spaces.IDAM.index("identification_window")
SCALE = spaces.IDAM.index("rvm_kernel_scale")


class DeckEngine(LaneEngine):
    """N lanes of the deck filter; see `LaneEngine`.

    Memory: a recording of T seconds at 20 Hz takes T · 7.3 kB on the shelf; a lane takes 13 kB.
    """

    settings: DeckDeformationSettings
    INFO_NAMES: ClassVar[tuple[str, ...]] = (
        "theta_rate_rmse", "reference_theta_rate_rmse", "theta_ac_rmse", "reference_theta_ac_rmse",
        "theta_rmse", "reference_theta_rmse", "weight", "power", "regime", "reward_term",
    )  # fmt: skip

    def _begin(self) -> None:
        self._rule = rule_of(self.settings)
        self._filter_rule = np.zeros(1, alignment.RULE)
        self._filter_rule["iterations"] = 1
        self._filter_rule["judged"] = self.settings.reward == "likelihood"
        self._filter_rule["own_channels"] = self.settings.own_channels

    def _allocate(self, trail: bool) -> None:
        self.lanes = np.zeros(self.count, alignment.LANE)
        self.models = np.repeat(self.shelf.models[:1], self.count, axis=0)
        self.stations = np.repeat(station_of(self._row(self.reference)), self.count)
        longest = self.shelf.tapes.shape[1] if trail else 0
        self.trail = np.full(
            (self.count, longest, alignment.STATES + alignment.MEASUREMENTS), np.nan
        )
        self.believed: list[FlexureModel] = [self.shelf.extra["believed"][0]] * self.count

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
        models = np.zeros((lanes, 1), alignment_model.MODEL)
        return Shelf(
            tapes=np.zeros((lanes, longest), TAPE),
            models=models,
            stations=np.repeat(station_of(self._row(self.reference)), lanes),
            labels=[{} for _ in range(lanes)],
            extra={
                "scores": np.zeros((lanes, longest, K.SCORES + 1)),
                "means": np.zeros((lanes, 1, K.SCORES)),
                "checkpoints": np.zeros((lanes, 1), alignment.LANE),
                "believed": np.array([self._scenarios[0].model.flexure] * lanes, dtype=object),
                "steps": np.zeros((lanes, 1)),
            },
        )

    def prepare(
        self,
        recordings: Sequence[DualIMURecording],
        rows: Sequence[Array],
        place: NDArray[Any] | None = None,  # noqa: ARG002
    ) -> Shelf:
        """Make recordings ready: mechanise them and run the reference filter; see `LaneEngine`."""
        batch = DeckBatch.of(recordings)
        self.check_truth(batch.truth)
        count, steps = batch.tapes.shape
        models = np.stack([alignment_model.pack(r) for r in batch.recordings])
        stations = np.concatenate([station_of(row) for row in rows])
        stations["which"], stations["length"] = np.arange(count), batch.lengths
        lanes, checkpoints = (np.zeros(count, alignment.LANE) for _ in range(2))
        alignment.begin(lanes, models, full_table(self.space, stations["row"]))
        scores, means = np.zeros((count, steps, K.SCORES + 1)), np.zeros((count, K.SCORES))
        begun = stations.copy()
        checkpoints[...] = lanes
        K.rehearse(
            lanes, stations, models, batch.tapes, self._filter_rule, self._rule, self._starts(batch),
            checkpoints, begun, scores, means,
        )  # fmt: skip
        extra: dict[str, Any] = {
            "scores": scores,
            "means": means[:, None],
            "checkpoints": checkpoints[:, None],
            "believed": np.array([r.model.flexure for r in recordings], dtype=object),
            "steps": np.full((count, 1), batch.step),
        }
        labels = [{"recording": i, **dict(r.meta)} for i, r in enumerate(recordings)]
        return Shelf(batch.tapes, models, begun, labels, extra)

    def _starts(self, batch: DeckBatch) -> NDArray[np.int64]:
        """Where lanes begin: after the warm-up, if that leaves at least one decision."""
        warm = round(self.settings.warmup / batch.step)
        fits = batch.lengths > warm + self.settings.decision_interval
        return np.where(fits, warm, 0)

    # ---- life of a lane -------------------------------------------------------------

    def _start_lane(self, i: int, which: int, start: int | None) -> NDArray[np.float32]:
        lane, station, shelf = self.lanes[i : i + 1], self.stations[i : i + 1], self.shelf
        self.models[i] = shelf.models[which]
        self.believed[i] = shelf.extra["believed"][which]
        obs = np.zeros((1, len(self.observation_names)), dtype=np.float32)
        if start is None:
            lane[...] = shelf.extra["checkpoints"][which]
        else:
            row = station["row"].copy()
            station[...] = station_of(row[0])
            station["which"], station["length"] = which, shelf.stations["length"][which]
            alignment.begin(lane, self.models[i : i + 1], full_table(self.space, row))
        if start:
            rule = self._rule.copy()
            rule["interval"] = start
            K.decide(
                lane, station, self.models[i : i + 1], shelf.tapes, shelf.extra["scores"], self._means(),
                self._filter_rule, rule, self.table[:0], self._actions[i : i + 1, :0], obs,
                np.zeros((1, self._outcomes.shape[1])), self.trail[i : i + 1],
            )  # fmt: skip
        K.first_look(station, self._rule, self.table, obs)
        first: NDArray[np.float32] = obs[0]
        return first

    def step(self, actions: NDArray[Any], obs: NDArray[np.float32]) -> Array:
        """One decision of every active lane; see `LaneEngine`.

        Lanes that identify do so after each `identification_window`, with the kernel scale in force.
        """
        before = self.stations["k"].copy()
        out = super().step(actions, obs)
        if self.settings.identifies:
            self._identify(before, out)
        return out

    def _identify(self, before: NDArray[np.int64], out: Array) -> None:
        for i in np.flatnonzero((self.stations["active"] > 0) & (out[:, TERMINATED] == 0.0)):
            station = self.stations[i]
            which = int(station["which"])
            dt = float(self.shelf.extra["steps"][which].item())
            window = max(1, round(float(station["row"][WINDOW]) / dt))
            if int(station["k"]) // window == int(before[i]) // window:
                continue
            found = identify_lane(
                Deck("rvm"), self.shelf.tapes[which], dt, self.believed[i], self.lanes[i], window,
                {"rvm_kernel_scale": float(station["row"][SCALE])},
            )  # fmt: skip
            if found is not None:
                alignment_model.write_flexure(self.models[i, 0], found)

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """See `LaneEngine`; lanes that identify hold models of their own."""
        return super().snapshot() | {"models": self.models.copy()}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """See `LaneEngine`."""
        super().restore(snapshot)
        believed = self.shelf.extra["believed"]
        self.believed = [believed[which] for which in self.stations["which"]]

    def _means(self) -> Array:
        means: Array = self.shelf.extra["means"].reshape(-1, K.SCORES)
        return means

    def _gather(self) -> tuple[Any, ...]:
        return (
            self.lanes, self.stations, self.models, self.shelf.tapes, self.shelf.extra["scores"],
            self._means(), self._filter_rule, self._rule, self.table, self._actions,
        )  # fmt: skip


def observation_names(settings: DeckDeformationSettings) -> tuple[str, ...]:
    """One name per element of an observation of such an environment."""
    groups = ("velocity", "rate") if settings.features == "all" else ("rate",)
    found = [
        f"{group}.{signal}"
        for group in groups
        for signal in (*(f"log_nis.{d:g}" for d in K.DECAYS), *SIGNALS)
    ]
    own = [f"parameter.{name}" for name in settings.action_parameters]
    return (*found, "sea.10s", "sea.60s", *own)


def rule_of(settings: DeckDeformationSettings) -> NDArray[Any]:
    """The kernels' rule (1,)."""
    rule = np.zeros(1, K.RULE)
    rule["interval"] = settings.decision_interval
    rule["columns"] = columns_of(settings.SPACE)
    rule["kind"] = settings.REWARDS.index(settings.reward)
    rule["clip"], rule["ac_weight"] = settings.reward_clip, settings.ac_weight
    rule["theta_price"] = settings.theta_price
    rule["first_group"] = FEATURES.index(settings.features)
    return rule


def station_of(row: Array) -> NDArray[Any]:
    """A station (1,) at the start of a recording, with parameters `row` in force."""
    station = np.zeros(1, K.STATION)
    station["active"], station["row"] = 1, row
    return station
