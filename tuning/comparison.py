"""Several filters on the same recordings, paired: who is better, by how much, how surely."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from scipy import stats
from tqdm import tqdm

from navgym.core.checks import Array, one_of
from navgym.metrics import Consistency, PairedDifference, paired_difference, score
from navgym.metrics.blocks import Blocks
from navgym.metrics.measures import NIS, NLL, Judged, Measure, Quantity
from navgym.tuning.cases import Cases
from navgym.tuning.objectives import checked_measure, plain_quantities

CONFIDENCE = 0.95
RESAMPLES = 2000
LEAST = 8  # recordings that an interval over recordings needs
LOOKED = 60  # recordings whose covariances are held against their bands


class Filters(Protocol):
    """Whatever has filters by name, each with its space: a `navgym.problem.Problem`, for one."""

    def find(self, filter_name: str, /) -> Any:
        """The filter of that name; it has a `space`."""


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
        gain: 1 − mean / the reference's mean, or, of a logarithm, the reference's mean − mean; NaN where
            means have no meaning.
        gain_low: lower end of its interval, from pairs.
        gain_high: upper end.
        p_value: of "no different from the reference".
        score: 0 for the plain filter, 1 for the oracle; NaN without an oracle or headroom.
        relative: whether the gain is a share.
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
    relative: bool = True

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
        beside: per label, means of further quantities by name.
        quantities: those, by name.
        nis: per label, mean NIS per degree of freedom and its band; None where nothing came out.
        nees: likewise of NEES, where the truth is known.
        redrawn: per label, means of the measure over logs redrawn in blocks (R,), where recordings
            are too few for intervals over recordings.
    """

    rows: tuple[Row, ...]
    reference: str
    about: Mapping[str, Any]
    errors: Mapping[str, Array]
    microseconds: Mapping[str, float]
    squared: Mapping[str, Array]
    measure: Measure
    beside: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    quantities: Mapping[str, Quantity] = field(default_factory=dict)
    nis: Mapping[str, Consistency | None] = field(default_factory=dict)
    nees: Mapping[str, Consistency | None] = field(default_factory=dict)
    redrawn: Mapping[str, Array] = field(default_factory=dict)

    @property
    def runs(self) -> int:
        """Recordings per contender."""
        return len(next(iter(self.errors.values())))

    @property
    def intervals(self) -> str:
        """What intervals are over: "recordings", "blocks" of one log or few, or "" for none."""
        if self.runs >= LEAST:
            return "recordings"
        return "blocks" if self.redrawn else ""

    def __getitem__(self, label: str) -> Row:
        return self.rows[[r.label for r in self.rows].index(self._known(label))]

    def __contains__(self, label: str) -> bool:
        return label in self.errors

    def difference(self, label: str, other: str) -> PairedDifference:
        """`label` against `other`, paired; gains are shares, or differences of logarithms."""
        a, b = self._known(label), self._known(other)
        pairs = self.redrawn.get(a), self.redrawn.get(b)
        return _difference(self.errors[a], self.errors[b], self.measure.relative, pairs)

    def as_dict(self) -> dict[str, Any]:
        """Everything that another machine would find too, as JSON can hold it."""
        rows = [
            {k: _plain(v) for k, v in asdict(row).items()} | self._told_beside(row.label)
            for row in self.rows
        ]
        about = dict(self.about)
        named = {"measure": self.measure.axis, "reference": self.reference}
        return {
            "recordings": about, "runs": self.runs, **named, "intervals over": self.intervals or None,
            "rows": rows,
        }  # fmt: skip

    def _told_beside(self, label: str) -> dict[str, Any]:
        """Further quantities, NIS and NEES of a row."""
        found: dict[str, Any] = {
            self.quantities[name].axis: _plain(value)
            for name, value in self.beside.get(label, {}).items()
        }
        for name, told in (("NIS", self.nis.get(label)), ("NEES", self.nees.get(label))):
            if told is not None:
                found[f"{name} per degree of freedom"] = told.mean
                found[f"band of {name}"] = [told.low, told.high]
        return found

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
    blind: bool = False,
    covariances: bool = True,
) -> Comparison:
    """Run every entry on the same recordings.

    Recordings without truth are judged by what is foretold as well: the one-step error and the
    negative log-likelihood of every contender stand beside the measure.

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
        blind: whether what is foretold is wanted though the truth is known.
        covariances: whether NIS and NEES are looked at, which takes as long as the rest.

    Raises:
        ValueError: labels that are not distinct, an unknown `reference`.
    """
    labels = [e.label for e in entries]
    if len(set(labels)) < len(labels):
        raise ValueError(f"entries must have distinct labels, got {labels}.")
    one_of("entry", reference, labels)
    chosen = checked_measure(cases, measure)
    scale = plain_quantities(cases, chosen) if len(chosen.parts) > 1 else {}
    more = _beside(cases, chosen, blind)
    looked = cases.take(range(min(len(cases), LOOKED)))
    errors: dict[str, Array] = {}
    flags: dict[str, Any] = {}
    microseconds: dict[str, float] = {}
    beside: dict[str, dict[str, float]] = {}
    nis: dict[str, Consistency | None] = {}
    nees: dict[str, Consistency | None] = {}
    for entry in tqdm(entries, desc=progress, disable=not progress):
        label, found = entry.label, _judged(entry, cases, chosen, tuple(more))
        errors[label] = chosen.losses(found.quantities, scale)
        flags[label], microseconds[label] = found.flags, found.microseconds
        beside[label] = {name: float(found.quantities[name].mean()) for name in more}
        own = entry.parameters
        part = own[: len(looked)] if isinstance(own, list) else own
        if covariances:
            nis[label], nees[label] = looked.consistency(entry.filter, part, entry.interval)
    kept = {e.label: _trace(e, cases, chosen) for e in entries if e.label in keep}
    redrawn = _redrawn(entries, cases, chosen, errors, kept)
    ends = (plain or cases.plain, oracle or cases.problem.bound)
    rows = rows_of(entries, errors, flags, reference, ends, chosen, cases.problem, redrawn=redrawn)
    return Comparison(
        rows, reference, cases.about, errors, microseconds, kept, chosen, beside, more, nis, nees,
        redrawn,
    )  # fmt: skip


def _beside(cases: Cases, measure: Measure, blind: bool) -> dict[str, Quantity]:
    """What stands beside the measure where the truth is not known, or is not to be used."""
    if cases.has_truth and not blind:
        return {}
    wanted = {q.name: q for q in (cases.foretold, NLL)}
    return {name: q for name, q in wanted.items() if measure.parts != (q,)}


def _judged(entry: Entry, cases: Cases, measure: Measure, more: tuple[str, ...]) -> Judged:
    """The entry's runs, timed with its kernels loaded."""
    names = tuple(dict.fromkeys((*measure.quantities, *more)))
    if not isinstance(entry.parameters, list):
        cases.take([0]).judge(entry.filter, entry.parameters, names, entry.interval)
    return cases.judge(entry.filter, entry.parameters, names, entry.interval)


def _trace(entry: Entry, cases: Cases, measure: Measure) -> Array:
    return cases.trace(entry.filter, entry.parameters, measure.parts[0].name, entry.interval)


# ---- logs redrawn in blocks

_FROM_MEAN: Mapping[str, Callable[[Any], Any]] = MappingProxyType(
    {NLL.name: lambda mean: mean, NIS.name: lambda mean: np.abs(np.log(mean))}
)


def _redrawn(
    entries: Sequence[Entry],
    cases: Cases,
    measure: Measure,
    errors: Mapping[str, Array],
    kept: Mapping[str, Array],
) -> dict[str, Array]:
    """Means of the measure over redrawn logs, by label; nothing where recordings are enough, too short,
    or the measure is one of several parts.
    """
    if len(cases) >= LEAST or len(measure.parts) > 1:
        return {}
    traces = {
        e.label: kept[e.label] if e.label in kept else _trace(e, cases, measure) for e in entries
    }
    judged = cases.problem.scoring.scored(cases.batch, cases.span)
    heard = judged & np.any([np.isfinite(t) for t in traces.values()], axis=0)
    drawn = [Blocks.drawn(max(int(n), 1), RESAMPLES, i) for i, n in enumerate(heard.sum(axis=1))]
    if any(blocks is None for blocks in drawn):
        return {}
    value = _FROM_MEAN.get(measure.parts[0].name, np.sqrt)
    found = {}
    with np.errstate(divide="ignore", invalid="ignore"):
        for label, trace in traces.items():
            pieces = [(row[mask], b) for row, mask, b in zip(trace, heard, drawn, strict=True) if b]
            means = np.mean([value(b.means(x)) for x, b in pieces], axis=0)
            middle = np.mean([value(x.mean()) for x, _ in pieces])
            found[label] = means + (errors[label].mean() - middle)
    return found


def _ends(draws: Array) -> tuple[float, float]:
    """The interval of what was redrawn; NaN where it is not finite."""
    if not np.isfinite(draws).all():
        return math.nan, math.nan
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(draws, [tail, 1.0 - tail])
    return float(low), float(high)


def rows_of(
    entries: Sequence[Entry],
    errors: Mapping[str, Array],
    flags: Mapping[str, Any],
    reference: str,
    ends: tuple[str, str],
    measure: Measure,
    problem: Filters,
    yardstick: str = "",
    redrawn: Mapping[str, Array] | None = None,
) -> tuple[Row, ...]:
    """A row per entry from errors and flags (N,) that are already there, by label.

    Args:
        entries: contenders with distinct labels.
        errors: the measure of each run.
        flags: each filter's own word that a run diverged.
        reference: label that gains are relative to.
        ends: labels of the filters that score 0 and 1.
        measure: what the errors are.
        problem: whose filters they are, or what has them.
        yardstick: label that divergence is judged by; the filter that scores 1 by default, or else
            the one that scores 0.
        redrawn: see `Comparison`.
    """
    again = redrawn or {}
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
        pair = again.get(entry.label), again.get(reference)
        gain = _difference(each, errors[reference], measure.relative, pair)
        ends_ = (means[0], means[1])
        rows.append(_row(entry, each, float(lost.mean()), gain, ends_, problem, measure, pair[0]))
    return tuple(rows)


def _row(
    entry: Entry,
    each: Array,
    lost: float,
    gain: PairedDifference,
    ends: tuple[float, float],
    problem: Filters,
    measure: Measure,
    redrawn: Array | None,
) -> Row:
    mean, low, high = _mean(each, redrawn)
    scheduled = isinstance(entry.parameters, list)
    values = problem.find(entry.filter).space.defaults | dict(
        {} if scheduled else entry.parameters or {}
    )
    known = all(map(math.isfinite, (*ends, mean)))
    with np.errstate(invalid="ignore"):
        median = float(np.median(each))
    return Row(
        entry.label, entry.filter, "schedule" if scheduled else values, entry.bound,
        mean, low, high, median, lost,
        gain.relative_gain, gain.gain_low, gain.gain_high, gain.p_value,
        float(score(mean, *ends)) if known else math.nan, measure.relative,
    )  # fmt: skip


Redrawn = tuple[Array | None, Array | None]


def _difference(
    a: Array, b: Array, relative: bool = True, redrawn: Redrawn = (None, None)
) -> PairedDifference:
    """`a` against `b`, paired. Of fewer than `LEAST` recordings there is no interval over recordings:
    that of their redrawn logs stands in, if there are such.
    """
    if len(a) >= LEAST:
        found = paired_difference(a, b, CONFIDENCE, RESAMPLES)
        if relative:
            return found
        gains = -found.mean_difference, -found.high, -found.low
        return replace(found, relative_gain=gains[0], gain_low=gains[1], gain_high=gains[2])
    finite = np.isfinite(a).all() and np.isfinite(b).all()
    d = float(a.mean() - b.mean()) if finite else math.nan
    low = high = gain_low = gain_high = math.nan
    gain = float(_gain(a.mean(), b.mean(), relative)) if finite else math.nan
    if finite and redrawn[0] is not None and redrawn[1] is not None:
        low, high = _ends(redrawn[0] - redrawn[1])
        gain_low, gain_high = _ends(np.asarray(_gain(redrawn[0], redrawn[1], relative)))
    failed = [float((~np.isfinite(x)).mean()) for x in (a, b)]
    with np.errstate(invalid="ignore"):
        middle = float(np.median(a - b))
    return PairedDifference(
        len(a), d, low, high, gain, gain_low, gain_high, math.nan, middle, failed[0], failed[1]
    )


def _gain(a: Any, b: Any, relative: bool) -> Any:
    """1 − a / b, NaN where b is no scale; b − a of logarithms."""
    if not relative:
        return b - a
    return 1.0 - np.divide(a, b, out=np.full(np.shape(b), np.nan), where=np.asarray(b) > 0.0)


def _mean(each: Array, redrawn: Array | None = None) -> tuple[float, float, float]:
    """Mean of independent runs with its t interval, or with that of redrawn logs; no interval where a
    run failed or there are too few.
    """
    if not np.isfinite(each).all():
        return math.inf, math.nan, math.nan
    mean = float(each.mean())
    if len(each) >= LEAST:
        factor = stats.t.ppf((1.0 + CONFIDENCE) / 2.0, len(each) - 1)
        around = float(factor * each.std(ddof=1) / math.sqrt(len(each)))
        return mean, mean - around, mean + around
    return mean, *(_ends(redrawn) if redrawn is not None else (math.nan, math.nan))


def _plain(value: Any) -> Any:
    """JSON has no infinity and no NaN."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
