"""The recordings that candidates are tried on, and the errors that they make there."""

from __future__ import annotations

import time
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
from tuning.measures import QUANTITIES, Judged, bounded, innovation_quantities
from tuning.recipes import Recipe, remake, travelling


@dataclass(frozen=True, eq=False)
class Cases:
    """Recordings, stacked, and where they come from.

    Args:
        batch: the stacked recordings.
        position: the states whose error is scored.
        about: provenance as JSON can hold it: scenario, seeds, overrides.
        recordings: what was stacked, for regimes and plots; empty if only a batch was given.
        span: shares of each recording's samples between which it is scored, 0 to 1.
        recipe: how they were made, if they can be made again; see `tuning.recipes`.
    """

    batch: Batch
    position: tuple[int, ...] = (0, 2)
    about: Mapping[str, Any] = field(default_factory=dict)
    recordings: tuple[Recording, ...] = ()
    span: tuple[float, float] = (0.0, 1.0)
    recipe: Recipe | None = None

    half = "auv"
    plain_filters = ("kf", "ekf")  # need no tuning; the second for nonlinear models
    bound_filter = "oracle"

    def __reduce_ex__(self, protocol: Any) -> Any:
        return super().__reduce_ex__(protocol) if self.recipe is None else (remake, (self.recipe,))

    @classmethod
    def of(
        cls,
        recordings: Sequence[Recording],
        about: Mapping[str, Any] | None = None,
        span: tuple[float, float] = (0.0, 1.0),
    ) -> Cases:
        """Stack `recordings`, which share one model size and one meaning of position."""
        batch = Batch.of(recordings)
        positions = {tuple(r.model.position) for r in recordings}
        if len(positions) > 1:
            raise ValueError(f"recordings must agree on their position states, got {positions}.")
        return cls(batch, positions.pop(), dict(about or {}), tuple(recordings), span)

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
        return Cases(self.batch.take(which), self.position, self.about, chosen, self.span)

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
        return self._scored(squared_error(states, self.batch.truth, self.position))

    def _scored(self, each: Array) -> Array:
        """`each` (N, T), NaN outside the span that is scored."""
        if self.span == (0.0, 1.0):
            return each
        first, last = (np.round(share * self.batch.lengths)[:, None] for share in self.span)
        k = np.arange(each.shape[1])
        return np.where((k >= first) & (k < last), each, np.nan)

    def judge(
        self,
        filter_name: str,
        parameters: Any,
        names: Sequence[str],
        decision_interval: int | None = None,
    ) -> Judged:
        """Run a filter over every recording; its quantities (see `tuning.measures`) by `names`."""
        everything = any(not QUANTITIES[name].needs_truth for name in names)
        interval = decision_interval or DECISION_INTERVAL
        began = time.perf_counter()
        found = run(filter_name, self.batch, parameters, interval, everything)
        spent = 1e6 * (time.perf_counter() - began) / self.samples
        made: dict[str, Array] = {}
        if "rmse" in names:
            made["rmse"] = run_rmse(self.squared(found["states"]))
        if everything:
            components = degrees_of_freedom(self.batch.lost)
            logs, nis = (self._scored(found[name]) for name in ("log_likelihood", "nis"))
            made |= innovation_quantities(logs, nis, components)
        flags = found["diverged"].astype(np.bool_)
        return Judged({name: made[name] for name in names}, flags, spent)

    def trace(
        self, filter_name: str, parameters: Any, name: str, decision_interval: int | None = None
    ) -> Array:
        """A quantity over time, (N, T): squared errors (of "rmse"), or what each sample's innovation
        adds to "nll" or its NIS, per component; NaN where there is nothing to judge.
        """
        interval = decision_interval or DECISION_INTERVAL
        blind = not QUANTITIES[name].needs_truth
        found = run(filter_name, self.batch, parameters, interval, blind)
        if not blind:
            return self.squared(found["states"])
        heard = degrees_of_freedom(self.batch.lost)
        each = -found["log_likelihood"] if name == "nll" else found["nis"]
        return self._scored(np.where(heard > 0, each, np.nan) / np.maximum(heard, 1))

    def errors(
        self, filter_name: str, parameters: Any = None, decision_interval: int = DECISION_INTERVAL
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Position RMSE of each run (N,) in m, infinite after a failure, and the filter's flags."""
        found = self.judge(filter_name, parameters, ("rmse",), decision_interval)
        return found.quantities["rmse"], found.flags

    def bounded_errors(
        self,
        filter_name: str,
        parameters: Any,
        plain: Array,
        decision_interval: int = DECISION_INTERVAL,
    ) -> Array:
        """Position RMSE of each run (N,) in m, a diverged run at its ceiling: see `bounded`."""
        found = self.judge(filter_name, parameters, ("rmse",), decision_interval)
        return bounded(found, {"rmse": plain})["rmse"]

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
