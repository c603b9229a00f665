"""The engine behind the AUV environment: QIVBF on every lane, reference and frozen filter beside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from navgym.auv import kernels as K
from navgym.auv.intake import linear
from navgym.core.checks import Array
from navgym.envs.base import LaneEngine, Shelf
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import kalman, qivbf
from navgym.statespace.models import LinearModel
from navgym.statespace.recording import Recording

COMMON_NAMES = (
    "curvature", "lost", "since_received", "noise_position", "noise_velocity", "widening", "change",
)  # fmt: skip
# measure errors by what a filter reaches that knows all
ORACLE_REWARDS = ("over-oracle", "relative")


class Engine(LaneEngine):
    """N lanes of QIVBF; see `LaneEngine`."""

    INFO_NAMES: ClassVar[tuple[str, ...]] = (
        "rmse", "reference_rmse", "nis", "lost", "regime", "reward_term",
    )  # fmt: skip

    def _begin(self) -> None:
        given = self.settings.recordings
        if given is not None and not len(given):
            raise ValueError("recordings must hold at least one Recording, got none.")
        self.model = linear(self._scenarios[0].model if given is None else given[0].model)

    def _allocate(self, trail: bool) -> None:
        n, m = self.model.n, self.model.m
        self.lanes = np.zeros(self.count, qivbf.lane_type(n, m))
        self.stations = np.repeat(station_of(self.model, self._row(self.reference)), self.count)
        chosen = self.settings
        reward = chosen.REWARDS.index(chosen.reward)
        self._rule = np.array([(chosen.decision_interval, reward, chosen.reward_clip)], K.RULE)
        longest = self.shelf.tapes.shape[1] if trail else 0
        self.trail = np.full((self.count, longest, n), np.nan)

    @property
    def kernel(self) -> Any:
        """See `LaneEngine`."""
        return K.decide

    # ---- what there is to see and to do -------------------------------------------------

    @property
    def features(self) -> tuple[str, ...]:
        """One name per element of an observation."""
        return observation_names(self.settings.action_parameters)

    # ---- where recordings come from ----------------------------------------------------

    def _empty_shelf(self, lanes: int) -> Shelf:
        """A place per lane, for recordings that are simulated when the lane restarts."""
        models = [s.model for s in self._scenarios]
        sizes = {(m.n, m.m) for m in models}
        if len(sizes) > 1:
            raise ValueError(f"scenarios of one environment must share a model size, got {sizes}.")
        longest = max(s.steps for s in self._scenarios)
        return Shelf(
            tapes=np.zeros((lanes, longest), K.tape_type(*sizes.pop())),
            models=np.stack([models[0].pack()] * lanes),
            stations=np.repeat(station_of(self.model, self._row(self.reference)), lanes),
            labels=[{} for _ in range(lanes)],
            extra={},
        )

    def prepare(
        self,
        recordings: Sequence[Recording],
        rows: Sequence[Array],
        place: NDArray[Any] | None = None,
    ) -> Shelf:
        """Make recordings ready: run the reference filter, the frozen filter and the oracle.

        Args:
            recordings: what to prepare.
            rows: the reference filter's parameters for each.
            place: tapes (R, T) to write to, used if they have the right size.
        """
        for r in recordings:
            linear(r.model)
        batch = StateSpaceBatch.of(recordings)
        self._check_usable(batch)
        n, m = batch.models.dtype["x0"].shape[0], batch.y.shape[2]
        fits = place is not None and place.shape == batch.y.shape[:2]
        tapes = place if fits else np.zeros(batch.y.shape[:2], K.tape_type(n, m))
        assert tapes is not None
        tapes["y"], tapes["lost"], tapes["time"] = batch.y, batch.lost, batch.time
        tapes["truth"] = np.nan if batch.truth is None else batch.truth
        for i, r in enumerate(recordings):
            tapes["regime"][i, : len(r)] = np.nan if r.regime is None else r.regime
        pairs = zip(recordings, rows, strict=True)
        stations = np.concatenate([station_of(r.model, row) for r, row in pairs])
        stations["which"], stations["length"] = np.arange(len(recordings)), batch.lengths
        self._fill(tapes, batch, stations)
        labels = [{"recording": i, **dict(r.meta)} for i, r in enumerate(recordings)]
        return Shelf(tapes, batch.models, stations, labels, {})

    def _fill(self, tapes: NDArray[Any], batch: StateSpaceBatch, stations: NDArray[Any]) -> None:
        """Run the reference, the frozen and (if the reward asks for it) the oracle filter."""
        n, m, count = batch.models.dtype["x0"].shape[0], batch.y.shape[2], len(batch)
        frozen, oracles = (np.zeros(count, kalman.lane_type(n, m)) for _ in range(2))
        references = np.zeros(count, qivbf.lane_type(n, m))
        kalman.begin(frozen, batch.models, stations["row"])
        kalman.begin(oracles, batch.models, stations["row"])
        qivbf.begin(references, batch.models, stations["row"][:, None])
        scales = batch.scales if self.settings.reward in ORACLE_REWARDS else None
        scales = np.zeros((count, 0, 2)) if scales is None else scales
        K.prepare(
            tapes, batch.models, batch.lengths, frozen, references, oracles, stations.copy(), scales
        )
        if self.settings.reward == "relative":
            variances = zip(tapes["oracle_variance"], batch.lengths, strict=True)
            stations["scale"] = [float(each[:length].mean()) for each, length in variances]

    def _check_usable(self, batch: StateSpaceBatch) -> None:
        reward = self.settings.reward
        self.check_truth(batch.truth)
        if reward in ORACLE_REWARDS and batch.scales is None:
            raise ValueError(
                f"reward={reward!r} needs the true noise scales, which only simulated "
                "recordings carry: use reward='difference'."
            )

    # ---- life of a lane -------------------------------------------------------------

    def _start_lane(self, i: int, which: int, start: int | None) -> NDArray[np.float32]:
        lane, station = self.lanes[i : i + 1], self.stations[i : i + 1]
        qivbf.begin(lane, self.shelf.models[which : which + 1], station["row"][:, None])
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
        first: NDArray[np.float32] = obs[0]
        return first

    def _gather(self) -> tuple[Any, ...]:
        return (
            self.lanes, self.stations, self.shelf.models, self.shelf.tapes, self.table, self._rule,
            self._actions,
        )  # fmt: skip


def observation_names(action_parameters: Sequence[str]) -> tuple[str, ...]:
    """One name per element of an observation where the agent sets `action_parameters`."""
    signals = ("log_nis", "alarm", "correlation", "power_position", "power_velocity")
    streams = [
        f"{stream}.{s}.{d:g}" for stream in ("filter", "frozen") for s in signals for d in K.DECAYS
    ]
    common = [f"{name}.{d:g}" for name in COMMON_NAMES[:2] for d in K.DECAYS]
    own = [f"parameter.{name}" for name in action_parameters]
    return (*streams, *common, *COMMON_NAMES[2:], *own)


def station_of(model: LinearModel, row: Array) -> NDArray[Any]:
    """A station (1,) at the start of a recording, with parameters `row` in force."""
    station = np.zeros(1, K.station_type(model.n, model.m, len(row)))
    station["active"] = 1
    station["row"] = row
    station["position"][:, list(model.position)] = 1
    H = model.H.reshape(-1, model.m, model.n)[0]
    station["kind"] = [int(np.argmax(np.abs(each)) not in model.position) for each in H]
    return station
