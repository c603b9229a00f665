"""The recordings that candidates are tried on, and the errors that they make there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym._checks import Array
from navgym.batch import Batch
from navgym.estimation import run
from navgym.metrics import DIVERGED_MULTIPLE, divergence, run_rmse, squared_error
from navgym.recording import Recording
from navgym.scenarios import seeds
from navgym.simulation import find_scenario, simulate_many


@dataclass(frozen=True, eq=False)
class Cases:
    """Recordings with truth, stacked, and where they come from.

    Args:
        batch: the stacked recordings.
        position: the states whose error is scored.
        about: provenance as JSON can hold it: scenario, seeds, overrides.
        recordings: what was stacked, for regimes and plots; empty if only a batch was given.
    """

    batch: Batch
    position: tuple[int, ...] = (0, 2)
    about: Mapping[str, Any] = field(default_factory=dict)
    recordings: tuple[Recording, ...] = ()

    def __post_init__(self) -> None:
        if self.batch.truth is None:
            raise ValueError("cases need recordings with truth to score against: set truth=.")

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
        return cls.of(simulate_many(scenario, chosen, steps, **overrides), about)

    def __len__(self) -> int:
        return len(self.batch)

    @property
    def samples(self) -> int:
        """Filter steps of one pass over all recordings."""
        return int(self.batch.lengths.sum())

    def squared(self, states: Array) -> Array:
        """Squared position error (N, T) in m² of states (N, T, n); NaN past a recording's end."""
        assert self.batch.truth is not None
        return squared_error(states, self.batch.truth, self.position)

    def errors(
        self, filter_name: str, parameters: Any = None, decision_interval: int = 5
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Position RMSE of each run (N,) in m, infinite after a failure, and the filter's flags."""
        found = run(filter_name, self.batch, parameters, decision_interval)
        return run_rmse(self.squared(found["states"])), found["diverged"].astype(np.bool_)

    def bounded_errors(
        self, filter_name: str, parameters: Any, plain: Array, decision_interval: int = 5
    ) -> Array:
        """Position RMSE of each run (N,), where divergence has a price that is finite and high.

        A run that diverged (flagged, not finite, or DIVERGED_MULTIPLE times worse than `plain`,
        the errors (N,) of a filter that needs no tuning) counts as exactly that multiple: it can
        neither win nor drown the other runs.
        """
        each, flags = self.errors(filter_name, parameters, decision_interval)
        lost = divergence(each, flags, plain)
        return np.where(lost, DIVERGED_MULTIPLE * plain, each)

    def plain_errors(self) -> Array:
        """Errors (N,) of the filter that needs no tuning: `kf`, or `ekf` for a nonlinear model."""
        linear = "H" in (self.batch.models.dtype.names or ())
        return self.errors("kf" if linear else "ekf")[0]
