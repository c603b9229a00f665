"""The recordings that candidates are tried on, and the errors that they make there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym._checks import Array
from navgym.batch import Batch
from navgym.estimation import DECISION_INTERVAL, run
from navgym.metrics import degrees_of_freedom, run_rmse, squared_error
from navgym.recording import Recording
from navgym.scenarios import seeds
from navgym.simulation import find_scenario, simulate_many
from tuning.measures import QUANTITIES, bounded, innovation_quantities
from tuning.recipes import Recipe, remake, travelling


@dataclass(frozen=True, eq=False)
class Cases:
    """Recordings, stacked, and where they come from.

    Args:
        batch: the stacked recordings.
        position: the states whose error is scored.
        about: provenance as JSON can hold it: scenario, seeds, overrides.
        recordings: what was stacked, for regimes and plots; empty if only a batch was given.
        recipe: how they were made, if they can be made again; see `tuning.recipes`.
    """

    batch: Batch
    position: tuple[int, ...] = (0, 2)
    about: Mapping[str, Any] = field(default_factory=dict)
    recordings: tuple[Recording, ...] = ()
    recipe: Recipe | None = None

    half = "auv"
    plain_filters = ("kf", "ekf")  # need no tuning; the second for nonlinear models
    bound_filter = "oracle"

    def __reduce_ex__(self, protocol: Any) -> Any:
        return super().__reduce_ex__(protocol) if self.recipe is None else (remake, (self.recipe,))

    @classmethod
    def of(cls, recordings: Sequence[Recording], about: Mapping[str, Any] | None = None) -> Cases:
        """Stack `recordings`, which share one model size and one meaning of position."""
        batch = Batch.of(recordings)
        positions = {tuple(r.model.position) for r in recordings}
        if len(positions) > 1:
            raise ValueError(f"recordings must agree on their position states, got {positions}.")
        return cls(batch, positions.pop(), dict(about or {}), tuple(recordings))

    @classmethod
    def simulated(
        cls,
        scenario: str,
        split: str,
        count: int,
        start: int = 0,
        steps: int | None = None,
        **overrides: Any,
    ) -> Cases:
        """`count` recordings of `scenario` from the seeds of `split`, from its `start`-th on."""
        return _simulated(scenario, split, count, start, steps, **overrides)

    def __len__(self) -> int:
        return len(self.batch)

    @property
    def samples(self) -> int:
        """Filter steps of one pass over all recordings."""
        return int(self.batch.lengths.sum())

    @property
    def has_truth(self) -> bool:
        """Whether errors can be computed."""
        return self.batch.truth is not None

    @property
    def regimes(self) -> tuple[str, ...]:
        """Names of the true regimes; empty where they are not known."""
        known = bool(self.recordings) and all(r.regime is not None for r in self.recordings)
        return tuple(self.recordings[0].meta.get("regimes", ())) if known else ()

    @property
    def plain(self) -> str:
        """The filter that needs no tuning: `kf`, or `ekf` for a nonlinear model."""
        linear = "H" in (self.batch.models.dtype.names or ())
        return self.plain_filters[0 if linear else 1]

    def take(self, which: Sequence[int] | NDArray[np.int64]) -> Cases:
        """Some of the recordings, in the order of `which`."""
        chosen = tuple(self.recordings[i] for i in which) if self.recordings else ()
        return Cases(self.batch.take(which), self.position, self.about, chosen)

    def by_regime(self, values: Sequence[float]) -> list[Array]:
        """A parameter's schedule per recording: `values` by the true regime of each sample."""
        return [np.asarray(values, dtype=np.float64)[r.regime] for r in self.recordings]

    def squared(self, states: Array) -> Array:
        """Squared position error (N, T) in m² of states (N, T, n); NaN past a recording's end.

        Raises ValueError for recordings without truth.
        """
        if self.batch.truth is None:
            raise ValueError(
                "errors need recordings with truth to score against: set truth=, or measure "
                "by likelihood, which needs none."
            )
        return squared_error(states, self.batch.truth, self.position)

    def quantities(
        self,
        filter_name: str,
        parameters: Any,
        names: Sequence[str],
        decision_interval: int | None = None,
    ) -> tuple[dict[str, Array], NDArray[np.bool_]]:
        """Quantities (see `tuning.measures`) of each run (N,), and the filter's flags (N,)."""
        everything = any(not QUANTITIES[name].needs_truth for name in names)
        interval = decision_interval or DECISION_INTERVAL
        found = run(filter_name, self.batch, parameters, interval, everything)
        made: dict[str, Array] = {}
        if "rmse" in names:
            made["rmse"] = run_rmse(self.squared(found["states"]))
        if everything:
            components = degrees_of_freedom(self.batch.lost)
            made |= innovation_quantities(found["log_likelihood"], found["nis"], components)
        return {name: made[name] for name in names}, found["diverged"].astype(np.bool_)

    def errors(
        self, filter_name: str, parameters: Any = None, decision_interval: int = DECISION_INTERVAL
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Position RMSE of each run (N,) in m, infinite after a failure, and the filter's flags."""
        found, flags = self.quantities(filter_name, parameters, ("rmse",), decision_interval)
        return found["rmse"], flags

    def bounded_errors(
        self,
        filter_name: str,
        parameters: Any,
        plain: Array,
        decision_interval: int = DECISION_INTERVAL,
    ) -> Array:
        """Position RMSE of each run (N,) in m, a diverged run at its ceiling: see `bounded`."""
        each, flags = self.errors(filter_name, parameters, decision_interval)
        return bounded({"rmse": each}, flags, {"rmse": plain})["rmse"]

    def plain_errors(self) -> Array:
        """Errors (N,) of the filter that needs no tuning: `kf`, or `ekf` for a nonlinear model."""
        return self.errors(self.plain)[0]


@travelling
def _simulated(
    scenario: str, split: str, count: int, start: int, steps: int | None, **overrides: Any
) -> Cases:
    chosen = seeds(split, count, start)
    found = find_scenario(scenario, **overrides)
    about = {
        "scenario": scenario,
        "steps": found.steps if steps is None else steps,
        "split": split,
        "seeds": [chosen.start, chosen.stop - 1],
    }
    if overrides:
        about["overrides"] = {name: repr(value) for name, value in overrides.items()}
    return Cases.of(simulate_many(scenario, chosen, steps, **overrides), about)
