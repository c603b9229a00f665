"""What a run is judged by: quantities that filters' outputs hold, and measures made of them.

A *quantity* is one number per recording, the smaller the better: an error against the truth, or,
for logs without truth, how badly the filter predicts its own measurements. A *measure* is a quantity,
or the mean of several, each over the plain filter's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navgym._checks import Array, one_of
from navgym.metrics import DIVERGED_MULTIPLE


@dataclass(frozen=True)
class Quantity:
    """One number per recording.

    Args:
        label: what tables and axes call it.
        unit: physical unit, "" where there is none.
        needs_truth: whether it compares with the truth.
        worst: what a diverged run counts as: so many times the plain filter's, or, where `added`,
            so much more than the plain filter's.
        added: see `worst`; for logarithms, which have no zero to multiply.
    """

    label: str
    unit: str
    needs_truth: bool = True
    worst: float = DIVERGED_MULTIPLE
    added: bool = False

    def ceiling(self, plain: Array) -> Array:
        """What a diverged run counts as (N,), given the plain filter's (N,)."""
        return plain + self.worst if self.added else plain * self.worst


_LIKELIHOOD = Quantity("innovation NLL", "nats", needs_truth=False, worst=10.0, added=True)
_CONSISTENCY = Quantity("|ln NIS|", "", needs_truth=False, worst=math.log(1e4), added=True)

QUANTITIES: Mapping[str, Quantity] = MappingProxyType(
    {
        "rmse": Quantity("position RMSE", "m"),
        "theta_rate": Quantity("θ̇ RMSE", "′/s"),
        "theta_ac": Quantity("θ_ac RMSE", "′"),
        "theta": Quantity("θ RMSE", "′"),
        "attitude": Quantity("attitude RMSE", "′"),
        "nll": _LIKELIHOOD,
        "nis": _CONSISTENCY,
    }
)


@dataclass(frozen=True, eq=False)
class Judged:
    """What the runs of one filter came to.

    Args:
        quantities: (N,) each; infinite or NaN where a run failed.
        flags: (N,) the filter's own word that it diverged.
        microseconds: per filter step, of filtering alone.
    """

    quantities: Mapping[str, Array]
    flags: NDArray[np.bool_]
    microseconds: float


@dataclass(frozen=True)
class Measure:
    """What a study minimises, per recording.

    Args:
        name: as typed.
        summary: one line for listings.
        parts: quantities; several are each divided by the plain filter's mean, and averaged.
        limits: (quantity, share): it may not grow by more than that over the default parameters'.
    """

    name: str
    summary: str
    parts: tuple[str, ...]
    limits: tuple[tuple[str, float], ...] = ()

    @property
    def quantities(self) -> tuple[str, ...]:
        """Every quantity that has to be computed."""
        return tuple(dict.fromkeys((*self.parts, *(q for q, _ in self.limits))))

    @property
    def needs_truth(self) -> bool:
        """Whether recordings must carry the truth."""
        return any(QUANTITIES[q].needs_truth for q in self.quantities)

    @property
    def unit(self) -> str:
        """Physical unit; "" for a mean of ratios."""
        return QUANTITIES[self.parts[0]].unit if len(self.parts) == 1 else ""

    @property
    def label(self) -> str:
        """What tables and axes call it."""
        if len(self.parts) == 1:
            return QUANTITIES[self.parts[0]].label
        return f"mean of {' and '.join(QUANTITIES[q].label for q in self.parts)} over plain"

    @property
    def axis(self) -> str:
        """Label and unit."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    def ceiling(self, plain: Array) -> Array:
        """What a diverged run's measure is at least, given the plain filter's (N,)."""
        return QUANTITIES[self.parts[0]].ceiling(plain)

    def losses(self, found: Mapping[str, Array], plain: Mapping[str, Array]) -> Array:
        """The measure of each run (n,), from its quantities and the plain filter's (N,)."""
        if len(self.parts) == 1:
            return found[self.parts[0]]
        return np.asarray(np.mean([found[q] / plain[q].mean() for q in self.parts], axis=0))


_NLL = Measure("likelihood", "negative log-likelihood of an innovation component: needs no truth", ("nll",))  # fmt: skip
_NIS = Measure("consistency", "|ln| of the mean NIS per component, 0 if P tells the truth: needs no truth", ("nis",))  # fmt: skip

# per half, the default first
MEASURES: Mapping[str, Mapping[str, Measure]] = MappingProxyType(
    {
        "auv": {
            m.name: m for m in (Measure("rmse", "position RMSE, m", ("rmse",)), _NLL, _NIS)
        },
        "deck": {
            m.name: m
            for m in (
                Measure(
                    "composite",
                    "θ̇ and the fast part of θ, each over the plain filter's; θ may grow by 2 % at most",
                    ("theta_rate", "theta_ac"),
                    (("theta", 0.02),),
                ),
                Measure("theta_rate", "RMSE of θ̇, ′/s", ("theta_rate",)),
                Measure("theta_ac", "RMSE of θ less its 60 s mean, ′", ("theta_ac",)),
                Measure("theta", "RMSE of θ, ′", ("theta",)),
                Measure("attitude", "RMSE of the total attitude, ′", ("attitude",)),
                _NLL,
                _NIS,
            )
        },
    }
)  # fmt: skip

METRICS: Mapping[str, Any] = MappingProxyType(
    {
        "mean": lambda losses: float(losses.mean()),
        "median": lambda losses: float(np.median(losses)),
        "quantile 95 %": lambda losses: float(np.quantile(losses, 0.95)),
    }
)


def find_measure(half: str, name: str | None) -> Measure:
    """The measure called `name` for "auv" or "deck", its default for None; ValueError if unknown."""
    known = MEASURES[half]
    return next(iter(known.values())) if name is None else known[one_of("measure", name, known)]


def bounded(found: Judged, plain: Mapping[str, Array]) -> dict[str, Array]:
    """Quantities (n,), where divergence has a price that is finite and high.

    A run that diverged (flagged, not finite, or worse than its ceiling) counts as exactly the
    ceiling: it can neither win nor drown the other runs.

    Args:
        found: of each run.
        plain: the same quantities of a filter that needs no tuning, on the same runs.
    """
    kept = {}
    for name, each in found.quantities.items():
        ceiling = QUANTITIES[name].ceiling(plain[name])
        bad = found.flags | ~np.isfinite(each) | ~(each <= ceiling)
        kept[name] = np.where(bad, ceiling, each)
    return kept


def innovation_quantities(
    log_likelihood: ArrayLike, nis: ArrayLike, components: ArrayLike
) -> dict[str, Array]:
    """NLL per received component and |ln (NIS per component)| of runs, (N,) each.

    Args:
        log_likelihood: (N, T) of each innovation; NaN where nothing was received.
        nis: (N, T) likewise.
        components: (N, T) number of components received.
    """
    logs, squares = np.asarray(log_likelihood), np.asarray(nis)
    heard = np.isfinite(logs) & np.isfinite(squares)
    count = np.where(heard, np.asarray(components), 0).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        nll = -np.where(heard, logs, 0.0).sum(axis=-1) / count
        ratio = np.where(heard, squares, 0.0).sum(axis=-1) / count
        return {"nll": nll, "nis": np.abs(np.log(ratio))}
