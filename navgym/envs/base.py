"""What all engines share: where recordings come from, actions, random numbers, the life of a lane.

An engine holds N lanes, each a filter on a recording. The single environment is an engine with one
lane; `faces.py` has the two Gymnasium faces. What a lane does in one decision is a compiled kernel of
the engine's own.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array, positive_int
from navgym.core.compile import entry
from navgym.core.seeds import SIZE, seeds
from navgym.envs.actions import LIMIT, action_table, restlessness
from navgym.envs.columns import INFORMATION, REWARD
from navgym.envs.settings import LaneSettings
from navgym.simulation import find_scenario, simulate_many
from navgym.tuned import read_tuned


@dataclass(eq=False)
class Shelf:
    """Recordings made ready for agents.

    Args:
        tapes: (R, K) records of prepared samples.
        models: (R, ·) packed models.
        stations: (R,) records: how a lane begins each recording.
        labels: what each recording is.
        extra: further arrays with a row per recording, by name.
    """

    tapes: NDArray[Any]
    models: NDArray[Any]
    stations: NDArray[Any]
    labels: list[dict[str, Any]]
    extra: dict[str, NDArray[Any]]

    def put(self, i: int, made: Shelf) -> None:
        """Put the one recording of `made` in place i."""
        length = int(made.stations["length"][0])
        if not np.shares_memory(self.tapes, made.tapes):
            self.tapes[i, :length] = made.tapes[0]
        self.models[i], self.stations[i] = made.models[0], made.stations[0]
        self.labels[i] = made.labels[0]
        for name, array in made.extra.items():
            if array.ndim == 1:
                self.extra[name][i] = array[0]
            else:
                self.extra[name][i, : array.shape[1]] = array[0]


class LaneEngine:
    """N lanes of one environment; every random number of lane i comes from its own generator.

    Args:
        settings: what the environment is made of.
        lanes: how many.
        trail: whether to keep every state estimate of the current recordings (for rendering).
    """

    INFO_NAMES: ClassVar[tuple[str, ...]]  # columns of an outcome after the first three
    LIMIT: ClassVar[float] = LIMIT  # observations lie within plus or minus this

    # what an engine allocates in `_allocate`
    lanes: NDArray[Any]
    stations: NDArray[Any]
    trail: Array

    def __init__(self, settings: LaneSettings, lanes: int, trail: bool = False) -> None:
        self.settings = settings
        self.space = settings.SPACE
        # names of an outcome's columns after the first three; made once, as every step needs them
        self.info_fields: tuple[str, ...] = (*self.INFO_NAMES, *self.space.names)
        self.count = positive_int("num_envs", lanes)
        self._scenarios = self._find_scenarios()
        self.reference = self._reference_of(self._scenarios[0])
        self._references = [self._row(self._reference_of(s)) for s in self._scenarios]
        self._regimes = self._count_regimes()
        self._generators: list[np.random.Generator] = [
            np.random.default_rng() for _ in range(lanes)
        ]
        self._begin()
        self._shared = self._build_pool()
        self.shelf = self._shared or self._empty_shelf(lanes)
        self.table = self._action_table()
        self._actions = np.zeros((lanes, len(self.table)), dtype=np.float32)
        self._centres: Array | None = None if self._alike() else np.zeros(self._actions.shape)
        self._outcomes = np.zeros((lanes, INFORMATION + len(self.INFO_NAMES) + len(self.space)))
        self._allocate(trail)
        self._decide: Callable[..., Any] | None = None
        self._world = self._gather()

    # ---- what each engine says for itself ----------------------------------------------

    def _begin(self) -> None:
        """Whatever must be known before recordings are made."""

    def _allocate(self, trail: bool) -> None:
        """Allocate lanes, stations and the trail."""
        raise NotImplementedError

    def _empty_shelf(self, lanes: int) -> Shelf:
        """A place per lane, for recordings that are simulated when the lane restarts."""
        raise NotImplementedError

    def prepare(
        self,
        recordings: Sequence[Any],
        rows: Sequence[Array],
        place: NDArray[Any] | None = None,
    ) -> Shelf:
        """Make recordings ready.

        Args:
            recordings: what to prepare.
            rows: the reference filter's parameters for each.
            place: tapes (R, K) to write to, used if they have the right size.
        """
        raise NotImplementedError

    def _start_lane(self, i: int, which: int, start: int | None) -> NDArray[np.float32]:
        """Put lane i at the start of recording `which`; returns the first observation."""
        raise NotImplementedError

    def _gather(self) -> tuple[Any, ...]:
        """The kernel's arguments before the observations."""
        raise NotImplementedError

    @property
    def kernel(self) -> Any:
        """The compiled decision: takes what `_gather` holds, observations, outcomes and the trail."""
        raise NotImplementedError

    @property
    def features(self) -> tuple[str, ...]:
        """One name per element of an observation that the kernel writes."""
        raise NotImplementedError

    # ---- what an agent sees beyond what the kernel writes --------------------------------

    @property
    def observation_names(self) -> tuple[str, ...]:
        """One name per element of an observation."""
        return (*self.features, *(f"regime.{i}" for i in range(self._regimes)))

    def _count_regimes(self) -> int:
        """How many true regimes an observation tells of: none where they are hidden."""
        if self.settings.context == "hidden":
            return 0
        given = self.settings.recordings
        if given is None:
            return max(len(getattr(s, "regimes", ())) or 1 for s in self._scenarios)
        known = [r.meta.get("regimes") for r in given]
        if any(k is None or r.regime is None for k, r in zip(known, given, strict=True)):
            raise ValueError(
                'context="regime" needs the true regimes, which these recordings lack: use '
                'context="hidden".'
            )
        return max(map(len, known))

    def _tell_regime(self, i: int, observation: NDArray[np.float32]) -> None:
        """Write the true regime of lane i's latest sample at the end of its observation."""
        if self._regimes:
            station = self.stations[i]
            tape = self.shelf.tapes[int(station["which"])]
            regime = tape[max(int(station["k"]) - 1, 0)]["regime"]
            observation[-self._regimes :] = np.arange(self._regimes) == regime

    # ---- actions ---------------------------------------------------------------------------

    def _action_table(self) -> Array:
        chosen = self.settings
        names, residual = chosen.action_parameters, chosen.action == "residual"
        return action_table(
            self.space, names, self._row(self.reference), residual and self._alike()
        )

    def _alike(self) -> bool:
        """Whether residual actions start from the same parameters in every recording."""
        if self.settings.action != "residual":
            return True
        if self._shared is not None:
            rows = self._shared.stations["row"]
        else:
            rows = np.stack(self._references)
        return bool((rows == self._row(self.reference)).all())

    def _start_of(self, row: Array) -> Array:
        """Where parameters (P,) stand in what actions of `table` make, (k,)."""
        own = action_table(self.space, self.settings.action_parameters, row, residual=True)
        found: Array = (own[:, 1] - self.table[:, 1]) / self.table[:, 2]
        return found

    # ---- where recordings come from ----------------------------------------------------

    def _find_scenarios(self) -> tuple[Any, ...]:
        given, kind = self.settings.scenario, self.settings.SCENARIO
        names = (given,) if isinstance(given, (str, kind)) else tuple(given)
        if not names:
            raise ValueError("scenario must name at least one scenario, got none.")
        found = tuple(find_scenario(n, **dict(self.settings.overrides or {})) for n in names)
        for scenario, name in zip(found, names, strict=True):
            if not isinstance(scenario, kind):
                raise ValueError(  # noqa: TRY004
                    f"scenario {name!r} is of another kind ({type(scenario).__name__}): this "
                    f"environment plays a {kind.__name__}."
                )
        return found

    def _reference_of(self, scenario: Any) -> dict[str, Any]:
        """Parameters of the reference filter: those given, else the scenario's best fixed ones.

        Recordings of one's own have no scenario: the filter's defaults are their reference.
        """
        chosen = self.settings.reference
        if chosen is None:
            chosen = {} if self.settings.recordings is not None else scenario.reference
        elif isinstance(chosen, (str, os.PathLike)):
            chosen = read_tuned(chosen).parameters
        elif not isinstance(chosen, Mapping):
            chosen = self._each_reference()[0]
        if len(self.space.array(chosen)) > 1:
            raise ValueError(f"reference must hold one number per parameter, got {chosen!r}.")
        return self.space.defaults | dict(chosen)

    def _each_reference(self) -> Sequence[Mapping[str, Any]]:
        """The reference of each recording, where they were given as a list; ValueError for another number."""
        given: Any = self.settings.reference
        wanted = self.settings.recordings
        if wanted is None or len(given) != len(wanted):
            raise ValueError(
                f"reference must be one set of parameters, or with recordings= one for each: got "
                f"{len(given)} for {'none' if wanted is None else len(wanted)}."
            )
        found: Sequence[Mapping[str, Any]] = given
        return found

    def _rows(self, count: int) -> list[Array]:
        """The reference's parameters for each of `count` recordings that were given."""
        chosen = self.settings.reference
        if chosen is None or isinstance(chosen, (Mapping, str, os.PathLike)):
            return [self._row(self.reference)] * count
        return [self._row(self.space.defaults | dict(each)) for each in self._each_reference()]

    def check_truth(self, truth: Array | None) -> None:
        """ValueError where the reward needs a truth that recordings lack."""
        if truth is None and self.settings.reward != self.settings.BLIND:
            raise ValueError(
                f"reward={self.settings.reward!r} needs the truth, which these recordings lack: "
                f"use reward={self.settings.BLIND!r}."
            )

    def _row(self, reference: Mapping[str, Any]) -> Array:
        row: Array = self.space.array(reference)[0]
        return row

    def _build_pool(self) -> Shelf | None:
        given = self.settings.recordings
        if given is not None:
            if not len(given):
                raise ValueError("recordings must hold at least one recording, got none.")
            return self.prepare(list(given), self._rows(len(given)))
        if self.settings.pool is None:
            return None
        each = -(-self.settings.pool // len(self._scenarios))
        drawn = [
            (r, row)
            for s, row in zip(self._scenarios, self._references, strict=True)
            for r in simulate_many(s, seeds(self.settings.split, each))
        ][: self.settings.pool]
        return self.prepare([r for r, _ in drawn], [row for _, row in drawn])

    def _draw(self, rng: np.random.Generator) -> tuple[Any, Array]:
        """A new recording made with numbers from `rng`, and its reference parameters."""
        first = seeds(self.settings.split, 1)[0]
        which = int(rng.integers(len(self._scenarios)))
        seed = first + int(rng.integers(SIZE))
        return simulate_many(self._scenarios[which], [seed])[0], self._references[which]

    # ---- life of a lane -------------------------------------------------------------

    def seed(self, i: int, generator: np.random.Generator) -> None:
        """Give lane i its source of randomness."""
        self._generators[i] = generator

    def generator(self, i: int) -> np.random.Generator:
        """Lane i's source of randomness."""
        return self._generators[i]

    def restart(
        self, i: int, recording: int | None = None, start: int | None = None
    ) -> NDArray[np.float32]:
        """Put lane i at the start of a recording; returns its first observation.

        Args:
            i: the lane.
            recording: number in the pool or in the given recordings; None draws one.
            start: filter steps to take beforehand with the reference parameters; None: as many as
                the environment always takes.
        """
        if self._shared is None:
            if recording is not None:
                raise ValueError("options['recording'] needs recordings= or pool= to choose from.")
            which = i
            made, row = self._draw(self._generators[i])
            self.shelf.put(i, self.prepare([made], [row], self.shelf.tapes[i : i + 1]))
        else:
            count = len(self.shelf.stations)
            which = int(self._generators[i].integers(count)) if recording is None else recording
            if not 0 <= which < count:
                raise ValueError(f"options['recording'] must lie in 0..{count - 1}, got {which}.")
        return self.place(i, which, start)

    def place(self, i: int, which: int, start: int | None = None) -> NDArray[np.float32]:
        """Put lane i into recording `which` of its shelf without drawing; see `restart`."""
        length = int(self.shelf.stations["length"][which])
        if start is not None and not 0 <= start < length:
            raise ValueError(f"options['start'] must lie in 0..{length - 1}, got {start}.")
        station = self.stations[i : i + 1]
        station[...] = self.shelf.stations[which]
        station["which"] = which
        self.trail[i] = np.nan
        if self._centres is not None:
            self._centres[i] = self._start_of(station["row"][0])
        first = self._start_lane(i, which, start)
        self._tell_regime(i, first)
        return first

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
        if self._centres is not None:
            self._actions[...] = np.clip(self._actions, -1.0, 1.0) + self._centres
        out = self._outcomes
        out.fill(0.0)
        arguments = (*self._world, obs, out, self.trail)
        if self._decide is None:
            self._decide = entry(self.kernel, arguments)
        before = self.stations["row"].copy() if self.settings.jitter else None
        if not self._decide(*arguments):
            raise ValueError(f"action must be numbers in -1..1, got {actions}.")
        if before is not None:
            moved = restlessness(before, self.stations["row"], self.table)
            out[:, REWARD] -= self.settings.jitter * moved
        if self._regimes:
            for i in np.flatnonzero(self.stations["active"]).tolist():
                self._tell_regime(i, obs[i])
        return out

    def snapshot(self) -> dict[str, NDArray[Any]]:
        """Copies of what lanes hold between two steps, but for their generators; see `restore`."""
        return {"lanes": self.lanes.copy(), "stations": self.stations.copy()}

    def restore(self, snapshot: Mapping[str, NDArray[Any]]) -> None:
        """Put all lanes where `snapshot` of an engine with the same settings and recordings was.

        Raises ValueError for arrays of another type or number of lanes.
        """
        for name, own in self.snapshot().items():
            given = snapshot[name]
            if given.shape != own.shape or given.dtype != own.dtype:
                raise ValueError(
                    f"snapshot[{name!r}] is of another engine: it has shape {given.shape}, not "
                    f"{own.shape}, or other fields."
                )
            getattr(self, name)[...] = given

    def __getstate__(self) -> dict[str, Any]:
        """Machine code stays behind; a copy looks it up again."""
        return self.__dict__ | {"_decide": None, "_world": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore, and tie the kernel's arguments to this object's own arrays."""
        self.__dict__.update(state)
        self._world = self._gather()
