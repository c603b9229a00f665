"""Which of a table of settings a recording's own fixes choose, afterwards."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.agents.mixture.experts import BANK, PROCESS, TAU, Expert
from navgym.core.checks import Array
from navgym.statespace.filters.catalogue import CATALOGUE
from navgym.tuning.cases import Cases
from navgym.tuning.worth import design

PROCESS_FACTORS = (0.5, 1.0, 2.0, 4.0, 10.0, 30.0)
TAU_FACTORS = (0.2, 0.5, 1.0, 2.0)


@dataclass(frozen=True, eq=False)
class Retuned:
    """What the fixes of recordings have chosen.

    Args:
        settings: the table of S settings; the tuned one first.
        fixes: (S, N) one-step error of the fixes, m; infinite where a setting fails.
        truth: (S, N) error against the truth; None where that is not known.
        which: (N,) the setting with the least error of the fixes.
    """

    settings: tuple[Expert, ...]
    fixes: Array
    truth: Array | None
    which: NDArray[np.int64]

    @property
    def gain(self) -> float:
        """1 − error of the fixes of what was chosen / that of the tuned setting."""
        return self._gain(self.fixes)

    @property
    def true_gain(self) -> float | None:
        """The same against the truth; None where that is not known."""
        return None if self.truth is None else self._gain(self.truth)

    def _gain(self, errors: Array) -> float:
        own = errors[self.which, np.arange(len(self.which))]
        return float(1.0 - own.mean() / errors[0].mean())

    def picked(self, i: int) -> Expert:
        """The setting of recording i."""
        return self.settings[int(self.which[i])]


def settings_around(tuned: Expert, spread: int = 0) -> tuple[Expert, ...]:
    """The table: the tuned filter first, its process noise and memory varied, the bank last.

    Args:
        tuned: around whom.
        spread: so many further settings from all over the filter's space.
    """
    space, values = CATALOGUE[tuned.filter].space, dict(tuned.parameters)
    axes = [(n, f) for n, f in ((PROCESS, PROCESS_FACTORS), (TAU, TAU_FACTORS)) if n in space.names]
    found = [tuned]
    for factors in itertools.product(*(f for _, f in axes)):
        if any(f != 1.0 for f in factors):
            pairs = zip(axes, factors, strict=True)
            changed = {n: _times(space[n], values, f) for (n, _), f in pairs}
            found.append(Expert(tuned.filter, values | changed))
    if spread > 0:
        found += [Expert(tuned.filter, v | tuned.scales) for v in design(space, spread + 1, 0)]
    if tuned.filter != BANK:
        found.append(Expert(BANK, tuned.scales))
    return tuple(found)


def _times(parameter: Any, values: Any, factor: float) -> float:
    low, high = parameter.admissible
    return float(min(max(float(values.get(parameter.name, parameter.default)) * factor, low), high))


def chosen(fixes: Array) -> NDArray[np.int64]:
    """(N,) number of the setting with the least error of the fixes (S, N); the first where none is known."""
    found: NDArray[np.int64] = np.where(np.isfinite(fixes), fixes, np.inf).argmin(axis=0)
    return found


def retuned(cases: Cases, settings: Sequence[Expert]) -> Retuned:
    """Run every setting over recordings, and let the fixes of each choose."""
    fixes, truth = [], []
    for each in settings:
        run = cases.problem.run(each.filter, cases.batch, dict(each.parameters), everything=True)
        fixes.append(cases.foretold_errors(run))
        truth += [cases.true_errors(run)] if cases.has_truth else []
    errors = np.stack(fixes)
    known = np.stack(truth) if cases.has_truth else None
    return Retuned(tuple(settings), errors, known, chosen(errors))
