"""Findings as sentences, made from numbers, so that a page never says what its run did not show."""

from __future__ import annotations

from collections.abc import Iterable

from navgym.tuning.comparison import Comparison, Row


def versus(found: Comparison, label: str, other: str) -> str:
    """`label` against `other` in one sentence, with the interval of the paired gain."""
    a, b = found[label], found[other]
    if a.diverges or b.diverges:
        return f"{_fate(a, found.measure.unit)}; {_fate(b, found.measure.unit)}."
    d = found.difference(label, other)
    ends = sorted((abs(100 * d.gain_low), abs(100 * d.gain_high)))
    if d.gain_low <= 0.0 <= d.gain_high:
        return (
            f"`{label}` and `{other}` do not differ measurably ({100 * d.relative_gain:+.1f} %, "
            f"95 % interval {100 * d.gain_low:+.1f} to {100 * d.gain_high:+.1f} %)."
        )
    way = "below" if d.relative_gain > 0 else "above"
    return (
        f"The error of `{label}` is {abs(100 * d.relative_gain):.1f} % {way} that of `{other}` "
        f"(95 % interval {ends[0]:.1f} to {ends[1]:.1f} %)."
    )


def _fate(row: Row, unit: str) -> str:
    if row.diverges:
        return f"`{row.label}` diverges in {100 * row.divergence_rate:.0f} % of the runs"
    return f"`{row.label}` has {row.mean:.3f} {unit}".rstrip()


def best(found: Comparison) -> Row:
    """The row with the smallest error among those that anyone can have."""
    return min((r for r in found.rows if not r.bound), key=lambda r: r.mean)


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
