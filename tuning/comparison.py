"""Several filters on the same recordings, paired: who is better, by how much, how surely."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from scipy import stats
from tqdm import tqdm

from navgym._checks import Array, one_of
from navgym.estimation import parameter_space, run
from navgym.metrics import PairedDifference, divergence, paired_difference, run_rmse, score
from tuning.cases import Cases

CONFIDENCE = 0.95
RESAMPLES = 2000


@dataclass(frozen=True)
class Entry:
    """One contender.

    Args:
        label: what tables and plots call it.
        filter: a name of `navgym.filters()`.
        parameters: as `navgym.estimate` takes them; None for the defaults.
        bound: whether it needs the truth, and so bounds what can be reached.
        interval: filter steps per row of a schedule.
    """

    label: str
    filter: str
    parameters: Any = None
    bound: bool = False
    interval: int = 5


@dataclass(frozen=True)
class Row:
    """What one contender did: errors are position RMSE in m.

    Args:
        label: its name.
        filter: the filter's.
        parameters: the values that it ran with; "schedule" where they vary in time.
        bound: see `Entry`.
        mean: over runs; infinite if a run failed.
        low: lower end of the mean's confidence interval.
        high: upper end.
        median: over runs.
        divergence_rate: share of runs that were flagged, failed, or are ten times worse than the
            yardstick: the oracle where there is one, else the plain filter.
        gain: 1 − mean / the reference's mean, NaN where means have no meaning.
        gain_low: lower end of its interval, from pairs.
        gain_high: upper end.
        p_value: of "no different from the reference".
        score: 0 for the plain filter, 1 for the oracle; NaN without an oracle or headroom.
    """

    label: str
    filter: str
    parameters: Any
    bound: bool
    mean: float
    low: float
    high: float
    median: float
    divergence_rate: float
    gain: float
    gain_low: float
    gain_high: float
    p_value: float
    score: float

    @property
    def diverges(self) -> bool:
        """Whether its mean says nothing: one run in a hundred is enough to carry it away."""
        return self.divergence_rate > 0.01 or not math.isfinite(self.mean)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Rows in the order of their entries, and what they rest on.

    Args:
        rows: one per entry.
        reference: label of the row that gains are relative to.
        about: provenance of the recordings.
        errors: per label, position RMSE of each run (N,) in m.
        microseconds: per label, wall time per filter step here: the only part of a comparison
            that another machine gives otherwise.
        squared: per label, squared errors (N, T) in m², for those that were asked for.
    """

    rows: tuple[Row, ...]
    reference: str
    about: Mapping[str, Any]
    errors: Mapping[str, Array]
    microseconds: Mapping[str, float]
    squared: Mapping[str, Array] = field(default_factory=dict)

    def __getitem__(self, label: str) -> Row:
        return self.rows[[r.label for r in self.rows].index(self._known(label))]

    def __contains__(self, label: str) -> bool:
        return label in self.errors

    def difference(self, label: str, other: str) -> PairedDifference:
        """`label` against `other`, paired."""
        a, b = self.errors[self._known(label)], self.errors[self._known(other)]
        return paired_difference(a, b, CONFIDENCE, RESAMPLES)

    def as_dict(self) -> dict[str, Any]:
        """Everything that another machine would find too, as JSON can hold it."""
        rows = [{k: _plain(v) for k, v in asdict(row).items()} for row in self.rows]
        runs = len(next(iter(self.errors.values())))
        about = dict(self.about)
        return {"recordings": about, "runs": runs, "reference": self.reference, "rows": rows}

    def _known(self, label: str) -> str:
        return one_of("entry", label, self.errors)


def compare(
    entries: Sequence[Entry],
    cases: Cases,
    reference: str,
    plain: str = "kf",
    oracle: str = "oracle",
    keep: Sequence[str] = (),
    progress: str = "",
) -> Comparison:
    """Run every entry on the same recordings.

    Args:
        entries: contenders with distinct labels.
        cases: the recordings; fresh ones, if anything was tuned.
        reference: label that gains are relative to.
        plain: label of the filter that scores 0.
        oracle: label of the one that scores 1; without such an entry there are no scores.
        keep: labels whose squared errors over time are kept, for plots.
        progress: what to call the progress bar; none if empty.

    Raises:
        ValueError: labels that are not distinct, an unknown `reference`.
    """
    labels = [e.label for e in entries]
    if len(set(labels)) < len(labels):
        raise ValueError(f"entries must have distinct labels, got {labels}.")
    one_of("entry", reference, labels)
    errors: dict[str, Array] = {}
    flags: dict[str, Array] = {}
    microseconds: dict[str, float] = {}
    squared: dict[str, Array] = {}
    for entry in tqdm(entries, desc=progress, disable=not progress):
        found, microseconds[entry.label] = _timed(entry, cases)
        square = cases.squared(found["states"])
        errors[entry.label], flags[entry.label] = run_rmse(square), found["diverged"]
        if entry.label in keep:
            squared[entry.label] = square
    yardstick = errors.get(oracle, errors.get(plain))
    ends = [float(errors[x].mean()) if x in errors else math.nan for x in (plain, oracle)]
    rows = []
    for entry in entries:
        each = errors[entry.label]
        lost = float(divergence(each, flags[entry.label], yardstick).mean())
        rows.append(_row(entry, each, lost, errors[reference], (ends[0], ends[1])))
    return Comparison(tuple(rows), reference, cases.about, errors, microseconds, squared)


def _timed(entry: Entry, cases: Cases) -> tuple[dict[str, Array], float]:
    """The entry's estimates, and µs per filter step (kernels already loaded)."""
    first = cases.recordings[:1] if not isinstance(entry.parameters, list) else ()
    if first:
        Cases.of(first).errors(entry.filter, entry.parameters, entry.interval)
    began = time.perf_counter()
    found = run(entry.filter, cases.batch, entry.parameters, entry.interval)
    return found, (time.perf_counter() - began) / cases.batch.lost[..., 0].size * 1e6


def _row(
    entry: Entry, each: Array, lost: float, reference: Array, ends: tuple[float, float]
) -> Row:
    mean, low, high = _mean(each)
    gain = paired_difference(each, reference, CONFIDENCE, RESAMPLES)
    scheduled = isinstance(entry.parameters, list)
    values = parameter_space(entry.filter).defaults | dict(
        {} if scheduled else entry.parameters or {}
    )
    known = all(map(math.isfinite, (*ends, mean)))
    return Row(
        entry.label, entry.filter, "schedule" if scheduled else values, entry.bound,
        mean, low, high, float(np.median(each)), lost,
        gain.relative_gain, gain.gain_low, gain.gain_high, gain.p_value,
        float(score(mean, *ends)) if known else math.nan,
    )  # fmt: skip


def _mean(each: Array) -> tuple[float, float, float]:
    """Mean of independent runs with its t interval; no interval where a run failed."""
    if not np.isfinite(each).all():
        return math.inf, math.nan, math.nan
    half = 0.0
    if len(each) > 1:
        factor = stats.t.ppf((1.0 + CONFIDENCE) / 2.0, len(each) - 1)
        half = float(factor * each.std(ddof=1) / math.sqrt(len(each)))
    mean = float(each.mean())
    return mean, mean - half, mean + half


def _plain(value: Any) -> Any:
    """JSON has no infinity and no NaN."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
