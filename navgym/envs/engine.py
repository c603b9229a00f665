"""The one engine behind every AUV environment: N lanes, each with a filter and a recording."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym._checks import Array, one_of, positive_int
from navgym._compile import entry
from navgym.batch import Batch
from navgym.envs import kernels as K
from navgym.filters import kalman, qivbf, spaces
from navgym.models import LinearModel
from navgym.recording import Recording
from navgym.scenarios.auv import AUVScenario
from navgym.scenarios.seeds import SIZE, seeds
from navgym.simulation import find_scenario, simulate_many

REWARDS = ("difference", "over-oracle", "absolute", "likelihood")
COMMON_NAMES = (
    "curvature", "lost", "since_received", "noise_position", "noise_velocity", "widening", "change",
)  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What an AUV environment is made of; see `AUVDropoutEnv` for each argument."""

    scenario: str | AUVScenario | Sequence[str | AUVScenario] = "auv/switch-D"
    overrides: Mapping[str, Any] | None = None
    split: str = "train"
    pool: int | None = None
    recordings: Any = None  # a Recording or several
    decision_interval: int = 5
    action_parameters: str | Sequence[str] = (
        "vb_iterations", "prior_count", "forgetting", "process_noise_scale",
    )  # fmt: skip
    action: str = "absolute"
    reference: Mapping[str, Any] | None = None
    reward: str = "difference"
    reward_clip: float = 20.0

    def __post_init__(self) -> None:
        positive_int("decision_interval", self.decision_interval)
        one_of("action", self.action, ("absolute", "residual"))
        one_of("reward", self.reward, REWARDS)
        seeds(self.split, 0)
        if not self.reward_clip > 0.0:
            raise ValueError(f"reward_clip must be positive, got {self.reward_clip}.")
        if self.pool is not None:
            positive_int("pool", self.pool)
        given = self.action_parameters
        names = (given,) if isinstance(given, str) else tuple(given)
        space = spaces.QIVBF.subset(names)
        if not names or len(set(names)) != len(names):
            raise ValueError(f"action_parameters must be one or more distinct names, got {names}.")
        if isinstance(self.recordings, Recording):
            object.__setattr__(self, "recordings", (self.recordings,))
        for p in space:
            if p.at_start:
                raise ValueError(f"{p.name} acts at the start only: set it through `reference=`.")
        object.__setattr__(self, "action_parameters", names)


@dataclass(eq=False)
class Shelf:
    """Recordings made ready for agents.

    Args:
        tapes: (R, T) records, see `kernels.tape_type`.
        models: (R, K) packed models.
        stations: (R,) records: how a lane begins each recording.
        labels: what each recording is.
    """

    tapes: NDArray[Any]
    models: NDArray[Any]
    stations: NDArray[Any]
    labels: list[dict[str, Any]]


class Engine:
    """N lanes of one environment; every random number of lane i comes from its own generator.

    Args:
        settings: what the environment is made of.
        lanes: how many.
        trail: whether to keep every state estimate of the current recordings (for rendering).
    """

    def __init__(self, settings: Settings, lanes: int, trail: bool = False) -> None:
        self.settings = settings
        self.count = positive_int("num_envs", lanes)
        self._scenarios = self._find_scenarios()
        self.reference = self._reference_of(self._scenarios[0])
        self._generators: list[np.random.Generator] = [
            np.random.default_rng() for _ in range(lanes)
        ]
        self.model = self._any_model()
        self._shared = self._build_pool()
        self.shelf = self._shared or self._empty_shelf(lanes)
        self.table = self._action_table()
        self.lanes = np.zeros(lanes, qivbf.lane_type(self.model.n, self.model.m))
        self.stations = np.repeat(self._station(self.model, self._row(self.reference)), lanes)
        reward = REWARDS.index(settings.reward)
        self._rule = np.array([(settings.decision_interval, reward, settings.reward_clip)], K.RULE)
        self._actions = np.zeros((lanes, len(self.table)), dtype=np.float32)
        self._outcomes = np.zeros((lanes, K.INFO + len(spaces.QIVBF)))
        self._decide: Callable[..., Any] | None = None
        self._world = self._gather()
        longest = self.shelf.tapes.shape[1] if trail else 0
        self.trail = np.full((lanes, longest, self.model.n), np.nan)

    # ---- what there is to see and to do -------------------------------------------------

    @property
    def observation_names(self) -> tuple[str, ...]:
        """One name per element of an observation."""
        signals = ("log_nis", "alarm", "correlation", "power_position", "power_velocity")
        streams = [
            f"{stream}.{s}.{d:g}"
            for stream in ("filter", "frozen")
            for s in signals
            for d in K.DECAYS
        ]
        common = [f"{name}.{d:g}" for name in COMMON_NAMES[:2] for d in K.DECAYS]
        own = [f"parameter.{name}" for name in self.settings.action_parameters]
        return (*streams, *common, *COMMON_NAMES[2:], *own)

    def _action_table(self) -> Array:
        """Rows for `kernels.set_parameters`."""
        space = spaces.QIVBF.subset(self.settings.action_parameters)
        rows = []
        for p, (low, high, code, integer) in zip(space, space.table(), strict=True):
            residual = self.settings.action == "residual"
            column = spaces.QIVBF.index(p.name)
            own = p.warp(spaces.QIVBF.array(self.reference)[0, column])
            centre = own if residual else (low + high) / 2
            rows.append((column, centre, (high - low) / 2, low, high, code, integer, p.low, p.high))
        return np.array(rows, dtype=np.float64)

    # ---- where recordings come from ----------------------------------------------------

    def _find_scenarios(self) -> tuple[AUVScenario, ...]:
        given = self.settings.scenario
        names = (given,) if isinstance(given, (str, AUVScenario)) else tuple(given)
        if not names:
            raise ValueError("scenario must name at least one scenario, got none.")
        return tuple(find_scenario(name, **dict(self.settings.overrides or {})) for name in names)

    def _reference_of(self, scenario: AUVScenario) -> dict[str, Any]:
        """Parameters of the reference filter: those given, else the scenario's best fixed ones.

        Recordings of one's own have no scenario: the filter's defaults are their reference.
        """
        chosen = self.settings.reference
        if chosen is None:
            chosen = {} if self.settings.recordings is not None else scenario.reference
        if len(spaces.QIVBF.array(chosen)) > 1:
            raise ValueError(f"reference must hold one number per parameter, got {chosen!r}.")
        return spaces.QIVBF.defaults | dict(chosen)

    @staticmethod
    def _row(reference: Mapping[str, Any]) -> Array:
        row: Array = spaces.QIVBF.array(reference)[0]
        return row

    def _build_pool(self) -> Shelf | None:
        given = self.settings.recordings
        if given is not None:
            return self.prepare(list(given), [self._row(self.reference)] * len(given))
        if self.settings.pool is None:
            return None
        each = -(-self.settings.pool // len(self._scenarios))
        drawn = [
            (r, self._row(self._reference_of(s)))
            for s in self._scenarios
            for r in simulate_many(s, seeds(self.settings.split, each))
        ][: self.settings.pool]
        return self.prepare([r for r, _ in drawn], [row for _, row in drawn])

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
            stations=np.repeat(self._station(self.model, self._row(self.reference)), lanes),
            labels=[{} for _ in range(lanes)],
        )

    def _draw(self, rng: np.random.Generator) -> tuple[Recording, Array]:
        """A new recording made with numbers from `rng`, and its reference parameters."""
        first = seeds(self.settings.split, 1)[0]
        scenario = self._scenarios[int(rng.integers(len(self._scenarios)))]
        recording = simulate_many(scenario, [first + int(rng.integers(SIZE))])[0]
        return recording, self._row(self._reference_of(scenario))

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
            _linear(r.model)
        batch = Batch.of(recordings)
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
        stations = np.concatenate([self._station(r.model, row) for r, row in pairs])
        stations["which"], stations["length"] = np.arange(len(recordings)), batch.lengths
        self._fill(tapes, batch, stations)
        labels = [{"recording": i, **dict(r.meta)} for i, r in enumerate(recordings)]
        return Shelf(tapes, batch.models, stations, labels)

    def _fill(self, tapes: NDArray[Any], batch: Batch, stations: NDArray[Any]) -> None:
        """Run the reference, the frozen and (if the reward asks for it) the oracle filter."""
        n, m, count = batch.models.dtype["x0"].shape[0], batch.y.shape[2], len(batch)
        frozen, oracles = (np.zeros(count, kalman.lane_type(n, m)) for _ in range(2))
        references = np.zeros(count, qivbf.lane_type(n, m))
        kalman.begin(frozen, batch.models, stations["row"])
        kalman.begin(oracles, batch.models, stations["row"])
        qivbf.begin(references, batch.models, stations["row"][:, None])
        scales = batch.scales if self.settings.reward == "over-oracle" else None
        scales = np.zeros((count, 0, 2)) if scales is None else scales
        K.prepare(
            tapes, batch.models, batch.lengths, frozen, references, oracles, stations.copy(), scales
        )

    @staticmethod
    def _station(model: LinearModel, row: Array) -> NDArray[Any]:
        """A station (1,) at the start of a recording, with parameters `row` in force."""
        station = np.zeros(1, K.station_type(model.n, model.m, len(row)))
        station["active"] = 1
        station["row"] = row
        station["position"][:, list(model.position)] = 1
        H = model.H.reshape(-1, model.m, model.n)[0]
        station["kind"] = [int(np.argmax(np.abs(each)) not in model.position) for each in H]
        return station

    def _check_usable(self, batch: Batch) -> None:
        reward = self.settings.reward
        if reward != "likelihood" and batch.truth is None:
            raise ValueError(
                f"reward={reward!r} needs the truth, which these recordings lack: "
                "use reward='likelihood'."
            )
        if reward == "over-oracle" and batch.scales is None:
            raise ValueError(
                "reward='over-oracle' needs the true noise scales, which only simulated "
                "recordings carry: use reward='difference'."
            )

    def _any_model(self) -> LinearModel:
        given = self.settings.recordings
        if given is not None and not given:
            raise ValueError("recordings must hold at least one Recording, got none.")
        return _linear(self._scenarios[0].model if given is None else given[0].model)

    # ---- life of a lane -------------------------------------------------------------

    def seed(self, i: int, generator: np.random.Generator) -> None:
        """Give lane i its source of randomness."""
        self._generators[i] = generator

    def restart(self, i: int, recording: int | None = None, start: int = 0) -> NDArray[np.float32]:
        """Put lane i at the start of a recording; returns its first observation.

        Args:
            i: the lane.
            recording: number in the pool or in the given recordings; None draws one.
            start: samples to filter beforehand with the reference parameters.
        """
        if self._shared is None:
            if recording is not None:
                raise ValueError("options['recording'] needs recordings= or pool= to choose from.")
            which = i
            place = self.shelf.tapes[i : i + 1]
            made, row = self._draw(self._generators[i])
            self._place(i, self.prepare([made], [row], place))
        else:
            count = len(self.shelf.stations)
            which = int(self._generators[i].integers(count)) if recording is None else recording
            if not 0 <= which < count:
                raise ValueError(f"options['recording'] must lie in 0..{count - 1}, got {which}.")
        lane, station = self.lanes[i : i + 1], self.stations[i : i + 1]
        station[...] = self.shelf.stations[which]
        station["which"] = which
        qivbf.begin(lane, self.shelf.models[which : which + 1], station["row"][:, None])
        self.trail[i] = np.nan
        return self._first_observation(i, start)

    def _first_observation(self, i: int, start: int) -> NDArray[np.float32]:
        lane, station = self.lanes[i : i + 1], self.stations[i : i + 1]
        if not 0 <= start < station["length"][0]:
            raise ValueError(
                f"options['start'] must lie in 0..{station['length'][0] - 1}, got {start}."
            )
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

    def _place(self, i: int, made: Shelf) -> None:
        """Put a newly made recording on lane i's own place of the shelf."""
        length = int(made.stations["length"][0])
        if not np.shares_memory(self.shelf.tapes, made.tapes):
            self.shelf.tapes[i, :length] = made.tapes[0]
        self.shelf.models[i] = made.models[0]
        self.shelf.stations[i] = made.stations[0]
        self.shelf.labels[i] = made.labels[0]

    def label(self, i: int) -> dict[str, Any]:
        """What lane i's recording is: scenario, seed, number in the pool."""
        return copy.deepcopy(self.shelf.labels[int(self.stations["which"][i])])

    def step(self, actions: NDArray[Any], obs: NDArray[np.float32]) -> Array:
        """One decision of every active lane: fills `obs` (N, ·) and returns outcomes (N, ·).

        The outcomes are overwritten by the next step.

        Raises ValueError for actions (N, k) of another shape or with an element that is no number.
        """
        if actions.shape != self._actions.shape:
            single = self.count == 1 and actions.shape[:1] == (1,)
            wanted, got = (self._actions.shape, actions.shape)
            raise ValueError(
                f"action must have shape {wanted[1:] if single else wanted}, "
                f"got {got[1:] if single else got}."
            )
        self._actions[...] = actions  # the kernel is entered without a check of types
        out = self._outcomes
        out[...] = 0.0
        arguments = (*self._world, obs, out, self.trail)
        if self._decide is None:
            self._decide = entry(K.decide, arguments)
        if not self._decide(*arguments):
            raise ValueError(f"action must be numbers in -1..1, got {actions}.")
        return out

    def __getstate__(self) -> dict[str, Any]:
        """Machine code stays behind; a copy looks it up again."""
        return self.__dict__ | {"_decide": None, "_world": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore, and tie the kernel's arguments to this object's own arrays."""
        self.__dict__.update(state)
        self._world = self._gather()

    def _gather(self) -> tuple[Any, ...]:
        return (
            self.lanes, self.stations, self.shelf.models, self.shelf.tapes, self.table, self._rule,
            self._actions,
        )  # fmt: skip


INFO_NAMES = ("rmse", "reference_rmse", "nis", "lost", "regime", "reward_term")


def _linear(model: Any) -> LinearModel:
    if not isinstance(model, LinearModel):
        raise TypeError(
            f"the environment's filter needs recordings with a LinearModel, got a "
            f"{type(model).__name__}."
        )
    return model
