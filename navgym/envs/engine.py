"""The one engine behind every AUV environment: N lanes, each with a filter and a recording."""

from __future__ import annotations

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
AT_START_ONLY = ("initial_count", "initial_scale")
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
    recordings: Sequence[Recording] | None = None
    decision_interval: int = 5
    action_parameters: tuple[str, ...] = (
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
        names = tuple(self.action_parameters)
        space = spaces.QIVBF.subset(names)
        if not names or len(set(names)) != len(names):
            raise ValueError(f"action_parameters must be one or more distinct names, got {names}.")
        for name in space.names:
            if name in AT_START_ONLY:
                raise ValueError(f"{name} acts at the start only: set it through `reference=`.")
        object.__setattr__(self, "action_parameters", names)


@dataclass(eq=False)
class Shelf:
    """Recordings made ready for agents: their tapes (R, T), models (R, K) and lengths (R,)."""

    tapes: NDArray[Any]
    models: NDArray[Any]
    lengths: NDArray[np.int64]
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
        self.reference = self._find_reference()
        self._row = spaces.QIVBF.array(self.reference)[0]
        self._generators: list[np.random.Generator] = [
            np.random.default_rng() for _ in range(lanes)
        ]
        self._shared = self._build_pool()
        self.model = self._any_model()
        self.shelf = self._shared or self._empty_shelf(lanes)
        self.table = self._action_table()
        self.lanes = np.zeros(lanes, qivbf.lane_type(self.model.n, self.model.m))
        self._first = self._station(self.model)
        self.stations = np.repeat(self._first, lanes)
        reward = REWARDS.index(settings.reward)
        self._rule = np.array([(settings.decision_interval, reward, settings.reward_clip)], K.RULE)
        self._action_shape = (lanes, len(self.table))
        self._outcome_shape = (lanes, K.INFO + len(self._row))
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
            centre = p.warp(self._row[column]) if residual else (low + high) / 2
            rows.append((column, centre, (high - low) / 2, low, high, code, integer, p.low, p.high))
        return np.array(rows, dtype=np.float64)

    # ---- where recordings come from ----------------------------------------------------

    def _find_scenarios(self) -> tuple[AUVScenario, ...]:
        given = self.settings.scenario
        names = (given,) if isinstance(given, (str, AUVScenario)) else tuple(given)
        if not names:
            raise ValueError("scenario must name at least one scenario, got none.")
        return tuple(find_scenario(name, **dict(self.settings.overrides or {})) for name in names)

    def _find_reference(self) -> dict[str, Any]:
        """Parameters of the reference filter: given, else the scenario's, over the defaults."""
        given = self.settings.reference
        chosen = self._scenarios[0].reference if given is None else given
        spaces.QIVBF.array(chosen)
        return spaces.QIVBF.defaults | dict(chosen)

    def _build_pool(self) -> Shelf | None:
        if self.settings.recordings is not None:
            return self.prepare(list(self.settings.recordings))
        if self.settings.pool is None:
            return None
        each = -(-self.settings.pool // len(self._scenarios))
        made = [
            r for s in self._scenarios for r in simulate_many(s, seeds(self.settings.split, each))
        ]
        return self.prepare(made[: self.settings.pool])

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
            lengths=np.zeros(lanes, dtype=np.int64),
            labels=[{} for _ in range(lanes)],
        )

    def _draw(self, rng: np.random.Generator) -> Recording:
        """Simulate a new recording with numbers from `rng`."""
        first = seeds(self.settings.split, 1)[0]
        scenario = self._scenarios[int(rng.integers(len(self._scenarios)))]
        return simulate_many(scenario, [first + int(rng.integers(SIZE))])[0]

    def prepare(
        self, recordings: Sequence[Recording], place: NDArray[Any] | None = None
    ) -> Shelf:
        """Make recordings ready: run the reference filter, the frozen filter and the oracle.

        The tapes (R, T) are written to `place`, if there is one of the right size.
        """
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
        self._fill(tapes, batch, recordings[0].model)
        labels = [{"recording": i, **dict(r.meta)} for i, r in enumerate(recordings)]
        return Shelf(tapes, batch.models, batch.lengths, labels)

    def _fill(self, tapes: NDArray[Any], batch: Batch, model: LinearModel) -> None:
        """Run the reference, the frozen and (if the reward asks for it) the oracle filter."""
        n, m, count = model.n, model.m, len(batch)
        frozen, oracles = (np.zeros(count, kalman.lane_type(n, m)) for _ in range(2))
        references = np.zeros(count, qivbf.lane_type(n, m))
        kalman.begin(frozen, batch.models, self._row)
        kalman.begin(oracles, batch.models, self._row)
        qivbf.begin(references, batch.models, self._row[None, None])
        stations = np.repeat(self._station(model), count)
        scales = batch.scales if self.settings.reward == "over-oracle" else None
        scales = np.zeros((count, 0, 2)) if scales is None else scales
        K.prepare(tapes, batch.models, batch.lengths, frozen, references, oracles, stations, scales)

    def _station(self, model: LinearModel) -> NDArray[Any]:
        """A station (1,) at the start, with the reference parameters in force."""
        station = np.zeros(1, K.station_type(model.n, model.m, len(self._row)))
        station["active"] = 1
        station["row"] = self._row
        station["position"][:, list(model.position)] = 1
        H = model.H.reshape(-1, model.m, model.n)[0]
        station["kind"] = [int(np.argmax(np.abs(row)) not in model.position) for row in H]
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
        model = self._scenarios[0].model if given is None else given[0].model
        if not isinstance(model, LinearModel):
            raise TypeError(f"the filter needs a LinearModel, got a {type(model).__name__}.")
        return model

    # ---- life of a lane -------------------------------------------------------------

    def seed(self, i: int, generator: np.random.Generator) -> None:
        """Give lane i its source of randomness."""
        self._generators[i] = generator

    def restart(self, i: int) -> None:
        """Put lane i at the start of a new recording."""
        if self._shared is None:
            place = self.shelf.tapes[i : i + 1]
            self._place(i, self.prepare([self._draw(self._generators[i])], place))
            which = i
        else:
            which = int(self._generators[i].integers(len(self.shelf.lengths)))
        lane, station = self.lanes[i : i + 1], self.stations[i : i + 1]
        qivbf.begin(lane, self.shelf.models[which : which + 1], self._row[None, None])
        station[...] = self._first
        station["which"], station["length"] = which, self.shelf.lengths[which]
        self.trail[i] = np.nan

    def _place(self, i: int, made: Shelf) -> None:
        """Put a newly made recording on lane i's own place of the shelf."""
        length = int(made.lengths[0])
        if not np.shares_memory(self.shelf.tapes, made.tapes):
            self.shelf.tapes[i, :length] = made.tapes[0]
        self.shelf.models[i] = made.models[0]
        self.shelf.lengths[i] = length
        self.shelf.labels[i] = made.labels[0]

    def label(self, i: int) -> dict[str, Any]:
        """What lane i's recording is: scenario, seed, number in the pool."""
        return dict(self.shelf.labels[int(self.stations["which"][i])])

    def look(self, i: int) -> NDArray[np.float32]:
        """Observation of lane i right after `restart`: no sample yet."""
        obs = np.zeros((1, len(self.observation_names)), dtype=np.float32)
        K.first_look(self.stations[i : i + 1], self.table, obs)
        first: NDArray[np.float32] = obs[0]
        return first

    def step(self, actions: NDArray[np.float32], obs: NDArray[np.float32]) -> Array:
        """One decision of every active lane: fills `obs` (N, ·) and returns outcomes (N, ·).

        Raises ValueError for an action of another shape or with an element that is no number.
        """
        if actions.shape != self._action_shape:
            raise ValueError(
                f"action must have shape {self._action_shape[1:]}, got {actions.shape[1:]}."
            )
        if not actions.flags.c_contiguous:
            actions = np.ascontiguousarray(actions)
        out = np.zeros(self._outcome_shape)
        arguments = (*self._world, actions, obs, out, self.trail)
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
        )  # fmt: skip


INFO_NAMES = ("rmse", "reference_rmse", "nis", "lost", "regime", "reward_term")
