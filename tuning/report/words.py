"""Findings as sentences, made from numbers, so that a page never says what its run did not show."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from navgym.metrics import PairedDifference
from navgym.metrics.measures import Measure
from navgym.tuning.comparison import Comparison, Row


def versus(found: Comparison, label: str, other: str) -> str:
    """`label` against `other` in one sentence, with the interval of the paired gain if there is one."""
    a, b = found[label], found[other]
    if a.diverges or b.diverges:
        return f"{_fate(a, found.measure.unit)}; {_fate(b, found.measure.unit)}."
    d = found.difference(label, other)
    if not math.isfinite(d.relative_gain):
        return f"{_fate(a, found.measure.unit)}; {_fate(b, found.measure.unit)}."
    if d.gain_low <= 0.0 <= d.gain_high:
        return f"`{label}` and `{other}` do not differ measurably ({amount(found, d)})."
    show, unit = _shown(found.measure)
    much = f"{show(abs(d.relative_gain))[1:]}{unit}"
    what = "error" if found.measure.needs_truth else found.measure.label
    way = "below" if d.relative_gain > 0 else "above"
    return f"The {what} of `{label}` is {much} {way} that of `{other}` ({_surely(found, d)})."


def _surely(found: Comparison, d: PairedDifference) -> str:
    """The interval of a gain's size."""
    if not math.isfinite(d.gain_low):
        return without_interval(found)
    show, unit = _shown(found.measure)
    low, high = sorted((abs(d.gain_low), abs(d.gain_high)))
    return f"95 % interval{_along(found)} {show(low)[1:]} to {show(high)[1:]}{unit}"


def _along(found: Comparison) -> str:
    return "" if found.intervals == "recordings" else " along the log"


def amount(found: Comparison, d: PairedDifference) -> str:
    """A gain with its unit and interval: "+3.1 %, 95 % interval +2.0 to +4.2"."""
    show, unit = _shown(found.measure)
    text = f"{show(d.relative_gain)}{unit}"
    if not math.isfinite(d.gain_low):
        return f"{text}, {without_interval(found)}"
    return f"{text}, 95 % interval{_along(found)} {show(d.gain_low)} to {show(d.gain_high)}"


def _shown(measure: Measure) -> tuple[Callable[[float], str], str]:
    if measure.relative:
        return (lambda x: f"{100 * x:+z.1f}"), " %"
    return (lambda x: f"{x:+z.3f}"), f" {measure.unit}".rstrip()


def without_interval(found: Comparison) -> str:
    """Why there is no interval."""
    what = "one recording" if found.runs == 1 else f"{found.runs} recordings"
    return f"{what}: no interval"


def _fate(row: Row, unit: str) -> str:
    if row.diverges:
        return f"`{row.label}` diverges in {100 * row.divergence_rate:.0f} % of the runs"
    return f"`{row.label}` has {row.mean:z.3f} {unit}".rstrip()


def best(found: Comparison) -> Row:
    """The row with the smallest error among those that anyone can have; of diverging ones if all do."""
    free = [r for r in found.rows if not r.bound] or list(found.rows)
    return min(free, key=lambda r: (r.diverges, not math.isfinite(r.mean), r.mean))


def nobody_better_than(found: Comparison, label: str) -> str:
    """Whether anything beats `label`, in one sentence."""
    rivals = [r.label for r in found.rows if not r.bound and r.label != label and not r.diverges]
    winners = [r for r in rivals if found.difference(r, label).gain_low > 0.0]
    if not winners:
        return f"Nothing beats `{label}` there."
    return f"{listed(winners)} beat `{label}` there."


def without_learning(found: Comparison, learners: Iterable[str], own: str) -> str:
    """Which of `learners`, which adapt by probability alone, beat the tuned filter `own`."""
    chosen = [name for name in learners if name in found]
    ahead = [name for name in chosen if found.difference(name, own).gain_low > 0.0]
    if not ahead:
        return f"None of {listed(chosen)} beats `{own}` here."
    verb, they, weigh = ("beats", "it", "weighs") if len(ahead) == 1 else ("beat", "they", "weigh")
    them = "it" if len(ahead) == 1 else "them"
    return (
        f"**{listed(ahead)} {verb} `{own}`, though nothing in {them} was tuned or learnt**: {they} "
        f"{weigh} fixed hypotheses about the noise by how well each explains the measurements. "
        f"Who just wants the best estimate here should take {them}; tuning and learning matter "
        "where one adaptive filter must do, or where no hypothesis fits."
    )


def listed(names: Iterable[str]) -> str:
    """`a`, `b` and `c`."""
    marked = [f"`{name}`" for name in names]
    return " and ".join([", ".join(marked[:-1]), marked[-1]]) if len(marked) > 1 else marked[0]
