"""Several filters on the same recordings, paired: who is better, by how much, how surely."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import stats
from tqdm import tqdm

from navgym.core.checks import Array, one_of
from navgym.metrics import PairedDifference, paired_difference, score
from navgym.metrics.measures import Judged, Measure
from navgym.problem import Problem
from navgym.tuning.cases import Cases
from navgym.tuning.objectives import checked_measure, plain_quantities

CONFIDENCE = 0.95
RESAMPLES = 2000


@dataclass(frozen=True)
class Entry:
    """One contender.

    Args:
        label: what tables and plots call it.
        filter: one of the problem's.
        parameters: as `navgym.estimate` takes them; None for the defaults.
        bound: whether it needs the truth, and so bounds what can be reached.
        interval: filter steps per row of a schedule; None for the problem's usual.
    """

    label: str
    filter: str
    parameters: Any = None
    bound: bool = False
    interval: int | None = None


@dataclass(frozen=True)
class Row:
    """What one contender did, by the comparison's measure.

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
            yardstick: the bound where there is one, else the plain filter.
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
        """Whether its mean says nothing, as where more than one run in a hundred is lost."""
        return self.divergence_rate > 0.01 or not math.isfinite(self.mean)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Rows in the order of their entries, and what they rest on.

    Args:
        rows: one per entry.
        reference: label of the row that gains are relative to.
        about: provenance of the recordings.
        errors: per label, the measure of each run (N,).
        microseconds: per label, wall time per filter step here: the only part of a comparison
            that another machine gives otherwise.
        squared: per label, squared errors over time (N, T), for those that were asked for.
        measure: what runs are judged by.
    """

    rows: tuple[Row, ...]
    reference: str
    about: Mapping[str, Any]
    errors: Mapping[str, Array]
    microseconds: Mapping[str, float]
    squared: Mapping[str, Array]
    measure: Measure

    def __getitem__(self, label: str) -> Row:
        return self.rows[[r.label for r in self.rows].index(self._known(label))]

    def __contains__(self, label: str) -> bool:
        return label in self.errors

    def difference(self, label: str, other: str) -> PairedDifference:
        """`label` against `other`, paired."""
        return _difference(self.errors[self._known(label)], self.errors[self._known(other)])

    def as_dict(self) -> dict[str, Any]:
        """Everything that another machine would find too, as JSON can hold it."""
        rows = [{k: _plain(v) for k, v in asdict(row).items()} for row in self.rows]
        runs = len(next(iter(self.errors.values())))
        about = dict(self.about)
        named = {"measure": self.measure.axis, "reference": self.reference}
        return {"recordings": about, "runs": runs, **named, "rows": rows}

    def _known(self, label: str) -> str:
        return one_of("entry", label, self.errors)


def compare(
    entries: Sequence[Entry],
    cases: Cases,
    reference: str,
    plain: str | None = None,
    oracle: str | None = None,
    keep: Sequence[str] = (),
    progress: str = "",
    measure: str | None = None,
) -> Comparison:
    """Run every entry on the same recordings.

    Args:
        entries: contenders with distinct labels.
        cases: the recordings; fresh ones, if anything was tuned.
        reference: label that gains are relative to.
        plain: label of the filter that scores 0; by default the one that needs no tuning.
        oracle: label of the one that scores 1, by default the one that knows the truth; without such an
            entry there are no scores.
        keep: labels whose squared errors over time are kept, for plots.
        progress: what to call the progress bar; none if empty.
        measure: one of the problem's measures, the first by default.

    Raises:
        ValueError: labels that are not distinct, an unknown `reference`.
    """
    labels = [e.label for e in entries]
    if len(set(labels)) < len(labels):
        raise ValueError(f"entries must have distinct labels, got {labels}.")
    one_of("entry", reference, labels)
    chosen = checked_measure(cases, measure)
    scale = plain_quantities(cases, chosen) if len(chosen.parts) > 1 else {}
    errors: dict[str, Array] = {}
    flags: dict[str, Any] = {}
    microseconds: dict[str, float] = {}
    for entry in tqdm(entries, desc=progress, disable=not progress):
        found = _judged(entry, cases, chosen)
        errors[entry.label] = chosen.losses(found.quantities, scale)
        flags[entry.label], microseconds[entry.label] = found.flags, found.microseconds
    kept = {e.label: _trace(e, cases, chosen) for e in entries if e.label in keep}
    ends = (plain or cases.plain, oracle or cases.problem.bound)
    rows = rows_of(entries, errors, flags, reference, ends, chosen, cases.problem)
    return Comparison(rows, reference, cases.about, errors, microseconds, kept, chosen)


def _judged(entry: Entry, cases: Cases, measure: Measure) -> Judged:
    """The entry's runs, timed with its kernels loaded."""
    names = tuple(measure.quantities)
    if not isinstance(entry.parameters, list):
        cases.take([0]).judge(entry.filter, entry.parameters, names, entry.interval)
    return cases.judge(entry.filter, entry.parameters, names, entry.interval)


def _trace(entry: Entry, cases: Cases, measure: Measure) -> Array:
    return cases.trace(entry.filter, entry.parameters, measure.parts[0].name, entry.interval)


def rows_of(
    entries: Sequence[Entry],
    errors: Mapping[str, Array],
    flags: Mapping[str, Any],
    reference: str,
    ends: tuple[str, str],
    measure: Measure,
    problem: Problem,
    yardstick: str = "",
) -> tuple[Row, ...]:
    """A row per entry from errors and flags (N,) that are already there, by label.

    Args:
        entries: contenders with distinct labels.
        errors: the measure of each run.
        flags: each filter's own word that a run diverged.
        reference: label that gains are relative to.
        ends: labels of the filters that score 0 and 1.
        measure: what the errors are.
        problem: whose filters they are.
        yardstick: label that divergence is judged by; the filter that scores 1 by default, or else
            the one that scores 0.
    """
    plain, oracle = ends
    limit = errors.get(yardstick or oracle, errors.get(plain))
    scored = measure.needs_truth  # a likelihood has no zero to score from
    means = [float(errors[x].mean()) if scored and x in errors else math.nan for x in ends]
    rows = []
    for entry in entries:
        each = errors[entry.label]
        lost = flags[entry.label] | ~np.isfinite(each)
        if limit is not None:
            lost = lost | (each > measure.ceiling(limit))
        rows.append(
            _row(entry, each, float(lost.mean()), errors[reference], (means[0], means[1]), problem)
        )
    return tuple(rows)


def _row(
    entry: Entry,
    each: Array,
    lost: float,
    reference: Array,
    ends: tuple[float, float],
    problem: Problem,
) -> Row:
    mean, low, high = _mean(each)
    gain = _difference(each, reference)
    scheduled = isinstance(entry.parameters, list)
    values = problem.find(entry.filter).space.defaults | dict(
        {} if scheduled else entry.parameters or {}
    )
    known = all(map(math.isfinite, (*ends, mean)))
    return Row(
        entry.label, entry.filter, "schedule" if scheduled else values, entry.bound,
        mean, low, high, float(np.median(each)), lost,
        gain.relative_gain, gain.gain_low, gain.gain_high, gain.p_value,
        float(score(mean, *ends)) if known else math.nan,
    )  # fmt: skip


def _difference(a: Array, b: Array) -> PairedDifference:
    """`a` against `b`, paired; without intervals where there is a single pair (one log)."""
    if len(a) > 1:
        return paired_difference(a, b, CONFIDENCE, RESAMPLES)
    d, gain = float(a[0] - b[0]), float(1.0 - a[0] / b[0]) if b[0] > 0.0 else math.nan
    nan = math.nan
    failed = [float(not math.isfinite(x)) for x in (a[0], b[0])]
    return PairedDifference(1, d, nan, nan, gain, nan, nan, nan, d, failed[0], failed[1])


def _mean(each: Array) -> tuple[float, float, float]:
    """Mean of independent runs with its t interval; no interval where a run failed."""
    if not np.isfinite(each).all():
        return math.inf, math.nan, math.nan
    around = 0.0
    if len(each) > 1:
        factor = stats.t.ppf((1.0 + CONFIDENCE) / 2.0, len(each) - 1)
        around = float(factor * each.std(ddof=1) / math.sqrt(len(each)))
    mean = float(each.mean())
    return mean, mean - around, mean + around


def _plain(value: Any) -> Any:
    """JSON has no infinity and no NaN."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
