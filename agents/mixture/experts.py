"""The fixed filters that a mixture is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.problem import Problem
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters.catalogue import CATALOGUE
from navgym.statespace.filters.modes import MODE_SETS, Modes, Structure
from navgym.tuned import SCALES

BANK, PLAIN = "bank", "kf"
PROCESS, TAU = "process_noise_scale", "prior_count"
# Never q below half the tuned, nor τ above three times: such filters run away where every second sample
# is lost.
PROCESS_FACTORS = (0.5, 3.0, 10.0)
TAU_FACTOR = 0.2
PLAIN_PROCESS = 5.0
FAMILIES = ("kalman", "qivbf", "bank")  # which experts may be of: what also runs sample by sample
MANOEUVRE = 10.0  # multiple of Q from which a regime is one


@dataclass(frozen=True)
class Expert:
    """A filter with parameters of its own.

    Args:
        filter: a name of `navgym.filters()`.
        parameters: as `navgym.estimate` takes them; what is missing stays at its default.
    """

    filter: str
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        chosen = CATALOGUE.get(self.filter)
        if chosen is None or chosen.family not in FAMILIES or chosen.needs_scales:
            raise ValueError(
                f"an expert must be a filter of linear models that needs no truth, got {self.filter!r}: "
                f"use one of {', '.join(known())}."
            )
        names = chosen.space.names
        own = {n: v for n, v in self.parameters.items() if n in names or not n.endswith(SCALES)}
        chosen.space.array(own)

    @property
    def own(self) -> dict[str, Any]:
        """The parameters that are the filter's own."""
        names = CATALOGUE[self.filter].space.names
        return {n: v for n, v in self.parameters.items() if n in names}

    @property
    def scales(self) -> dict[str, float]:
        """The others: scales of the model's noise, by sensor and axis."""
        return {n: float(v) for n, v in self.parameters.items() if n not in self.own}


def known() -> list[str]:
    """Filters that an expert may be."""
    return [n for n, f in CATALOGUE.items() if f.family in FAMILIES and not f.needs_scales]


def around(tuned: Expert) -> tuple[Expert, ...]:
    """The usual experts: the tuned filter first, then copies of it, the plain filter, the bank last."""
    space, values = CATALOGUE[tuned.filter].space, dict(tuned.parameters)
    changes = [(PROCESS, factor) for factor in PROCESS_FACTORS] + [(TAU, TAU_FACTOR)]
    copies = [
        Expert(tuned.filter, values | {name: _times(space[name], values, factor)})
        for name, factor in changes
        if name in space.names
    ]
    shared = tuned.scales
    return (
        tuned, *copies, Expert(PLAIN, {PROCESS: PLAIN_PROCESS, **shared}), Expert(BANK, shared),
    )  # fmt: skip


def _times(parameter: Any, values: Mapping[str, Any], factor: float) -> float:
    """A parameter's value times `factor`, inside what is admissible."""
    low, high = parameter.admissible
    return float(min(max(float(values.get(parameter.name, parameter.default)) * factor, low), high))


def meanings(structure: Structure) -> Array:
    """(J, 6) what each mode of the bank says: ln of √R of positions and of velocities, outliers, a
    manoeuvre, velocities that are late, velocities with an error of their own.

    Times the modes' weights: how noisy the sensors seem, and how probable the others.
    """
    modes = Modes.of(MODE_SETS[BANK], structure)
    speed = np.array(structure.velocities)
    logs = 0.5 * np.log(modes.scales)
    where = logs[:, ~speed].mean(axis=1) if not speed.all() else logs.mean(axis=1)
    fast = logs[:, speed].mean(axis=1) if speed.any() else logs.mean(axis=1)
    regimes = [
        (r.outliers, r.process >= MANOEUVRE, r.motion == "late", r.motion == "bias")
        for r in modes.regimes
    ]
    told = np.array(regimes, dtype=np.float64)[modes.regime]
    return np.column_stack([where[modes.node], fast[modes.node], told])


def kinds(problem: Problem, batch: StateSpaceBatch) -> NDArray[np.int64]:
    """(m,) 0 where a row is of a position fix, 1 where not; all 0 where none is.

    Raises ValueError for models that are not linear: no filter here is for them.
    """
    if not batch.linear:
        raise ValueError(
            "a mixture is made of filters for a LinearModel, and the recording's model is nonlinear: "
            "give the recording a LinearModel of what it measures."
        )
    fixes = problem.scoring.rows(batch).get("fixes")
    m = batch.y.shape[2]
    if fixes is None:
        return np.zeros(m, dtype=np.int64)
    return np.asarray(fixes[0] == 0.0, dtype=np.int64)
