"""What a run is judged by: quantities that filters' outputs hold, and measures made of them.

A *quantity* is one number per recording, the smaller the better: an error against the truth, or,
for logs without truth, how badly the filter predicts its own measurements. Of the latter a *one-step
error* is the root of the mean squared innovation of some rows, each square cut where the plain filter's
innovations would call it an outlier. A *measure* is a quantity, or the mean of several, each over the
plain filter's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navgym.core.checks import Array
from navgym.metrics.errors import DIVERGED_MULTIPLE


@dataclass(frozen=True)
class Quantity:
    """One number per recording.

    Args:
        name: as in code and results.
        label: what tables and axes call it.
        unit: physical unit, "" where there is none.
        needs_truth: whether it compares with the truth.
        worst: what a diverged run counts as: so many times the plain filter's, or, where `added`,
            so much more than the plain filter's.
        added: see `worst`; for logarithms, which have no zero to multiply or to take a share of.
        clip: of a one-step error: a row's innovation counts as at most so many robust deviations of
            the plain filter's.
    """

    name: str
    label: str
    unit: str
    needs_truth: bool = True
    worst: float = DIVERGED_MULTIPLE
    added: bool = False
    clip: float = math.inf

    @property
    def axis(self) -> str:
        """Label and unit."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    def ceiling(self, plain: Array) -> Array:
        """What a diverged run counts as (N,), given the plain filter's (N,)."""
        return plain + self.worst if self.added else plain * self.worst


# what every filter says of its own measurements
NLL = Quantity("nll", "innovation NLL", "nats per component", needs_truth=False, worst=10.0, added=True)  # fmt: skip
NIS = Quantity("nis", "|ln NIS|", "", needs_truth=False, worst=math.log(1e4), added=True)
# Two deviations: on A-KIT's tracks what four designs of 214 settings pick is then 0 to 3 % worse in
# position than the best of them (one pick of 36: 9 %); from three on it is up to 8 %, and without a cut
# up to 16 %, since the few steps after the longest gaps decide. `navgym headroom --akit FOLDER`.
CLIP = 2.0
ONE_STEP = Quantity("one_step", "one-step error over the plain filter's spread", "", needs_truth=False, clip=CLIP)  # fmt: skip
ROBUST = 1.4826  # a normal law's deviation over its median absolute value


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
    parts: tuple[Quantity, ...]
    limits: tuple[tuple[Quantity, float], ...] = ()

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Every quantity that has to be computed, by name."""
        return {q.name: q for q in (*self.parts, *(q for q, _ in self.limits))}

    @property
    def needs_truth(self) -> bool:
        """Whether recordings must carry the truth."""
        return any(q.needs_truth for q in self.quantities.values())

    @property
    def relative(self) -> bool:
        """Whether one filter's may be told as a share of another's: not so of logarithms."""
        return not self.parts[0].added

    @property
    def unit(self) -> str:
        """Physical unit; "" for a mean of ratios."""
        return self.parts[0].unit if len(self.parts) == 1 else ""

    @property
    def label(self) -> str:
        """What tables and axes call it."""
        if len(self.parts) == 1:
            return self.parts[0].label
        return f"mean of {' and '.join(q.label for q in self.parts)} over plain"

    @property
    def axis(self) -> str:
        """Label and unit."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    def ceiling(self, plain: Array) -> Array:
        """What a diverged run's measure is at least, given the plain filter's (N,)."""
        return self.parts[0].ceiling(plain)

    def losses(self, found: Mapping[str, Array], plain: Mapping[str, Array]) -> Array:
        """The measure of each run (n,), from its quantities and the plain filter's (N,)."""
        if len(self.parts) == 1:
            return found[self.parts[0].name]
        shares = [found[q.name] / plain[q.name].mean() for q in self.parts]
        return np.asarray(np.mean(shares, axis=0))


LIKELIHOOD = Measure("likelihood", "negative log-likelihood of an innovation component: needs no truth", (NLL,))  # fmt: skip
CONSISTENCY = Measure("consistency", "|ln| of the mean NIS per component, 0 if P tells the truth: needs no truth", (NIS,))  # fmt: skip

METRICS: Mapping[str, Any] = MappingProxyType(
    {
        "mean": lambda losses: float(losses.mean()),
        "median": lambda losses: float(np.median(losses)),
        "quantile 95 %": lambda losses: float(np.quantile(losses, 0.95)),
    }
)


ANYWHERE = (
    Measure("one_step", "one-step error of all rows, each over the plain filter's spread: needs no truth", (ONE_STEP,)),
    LIKELIHOOD,
    CONSISTENCY,
)  # fmt: skip


def by_name(*measures: Measure) -> Mapping[str, Measure]:
    """`measures` by name, then those that every problem has and that need no truth; the first is the
    default where the truth is known.
    """
    return MappingProxyType({m.name: m for m in (*measures, *ANYWHERE)})


def bounded(
    found: Judged, plain: Mapping[str, Array], quantities: Mapping[str, Quantity]
) -> dict[str, Array]:
    """Quantities (n,), where divergence has a price that is finite and high.

    A run that diverged (flagged, not finite, or worse than its ceiling) counts as exactly the
    ceiling: it can neither win nor drown the other runs.

    Args:
        found: of each run.
        plain: the same quantities of a filter that needs no tuning, on the same runs.
        quantities: what they are.
    """
    kept = {}
    for name, each in found.quantities.items():
        ceiling = quantities[name].ceiling(plain[name])
        bad = found.flags | ~np.isfinite(each) | ~(each <= ceiling)
        kept[name] = np.where(bad, ceiling, each)
    return kept


def spreads(innovations: Array) -> Array:
    """Robust deviation (N, m) of each row's innovations (N, T, m); infinite where there are none, or
    where more than half of them vanish.
    """
    known = np.isfinite(innovations)
    size = np.abs(np.where(known, innovations, 0.0))
    count = known.sum(axis=1)
    ordered = np.sort(np.where(known, size, np.inf), axis=1)
    middle = np.take_along_axis(ordered, np.maximum((count - 1) // 2, 0)[:, None, :], axis=1)[:, 0]
    return np.where((count > 0) & (middle > 0.0), ROBUST * middle, np.inf)


def cut_squares(innovations: Array, factors: Array, most: Array) -> Array:
    """Squared innovations (N, T, m), each row cut at `most` (N, m) and in units of 1/`factors` (N, m).

    NaN where nothing was received, and in rows whose factor is 0.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.minimum(np.abs(innovations), most[:, None, :]) * factors[:, None, :]
        return np.where(factors[:, None, :] != 0.0, size**2, np.nan)


def one_step_error(squares: Array) -> Array:
    """Root of the sum over rows of each row's mean over time, (N,), of `cut_squares` (N, T, m).

    For rows that are coordinates it is a length. NaN where nothing was received.
    """
    known = np.isfinite(squares)
    count = known.sum(axis=1)
    rows = np.where(known, squares, 0.0).sum(axis=1) / np.maximum(count, 1)
    return np.where(count.any(axis=1), np.sqrt(rows.sum(axis=1)), np.nan)


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
