"""Comparisons as tables, for pages and terminals alike."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from navgym.core.parameters import ParameterSpace
from navgym.tuning.comparison import Comparison, Row
from navgym.tuning.report.page import Table

NOTHING = "–"


def ladder(
    found: Comparison, own: Sequence[str] = (), caption: str = "", ranked: bool = True
) -> Table:
    """A comparison from the smallest to the largest error, or (not `ranked`) in its own order."""
    rows = sorted(found.rows, key=lambda r: r.mean) if ranked else list(found.rows)
    scored = any(math.isfinite(r.score) for r in rows)
    head = ["filter", found.measure.axis, "median", "diverged", f"gain over {found.reference}", "p"]
    head += ["score"] if scored else []
    head.append("µs/step")
    cells = []
    for row in rows:
        line = [_label(row), error(row), metres(row.median), percent(row.divergence_rate)]
        line += [NOTHING, NOTHING] if row.label == found.reference else [gain(row), p_value(row)]
        line += [NOTHING if row.diverges else number(row.score)] if scored else []
        cells.append([*line, f"{found.microseconds[row.label]:.1f}"])
    return Table(head, cells, caption, kinds(rows, own))


def _label(row: Row) -> str:
    return f"{row.label} (bound)" if row.bound else row.label


def kinds(rows: Sequence[Row], own: Sequence[str] = ()) -> list[str]:
    """Which rows to set off: bounds, what diverged, the best that can be had, what was tuned."""
    best = _best(rows).label
    return [
        "bound" if r.bound
        else "diverged" if r.diverges
        else "best" if r.label == best
        else "own" if r.label in own
        else ""
        for r in rows
    ]  # fmt: skip


def by_condition(
    found: Mapping[str, Comparison],
    own: Sequence[str] = (),
    caption: str = "",
    order: str | None = None,
) -> Table:
    """One column of errors per comparison, the best of each in bold; sorted by column `order`."""
    key = found[order or next(iter(found))]
    rows = sorted(key.rows, key=lambda r: r.mean)
    best = {name: _best(c.rows).label for name, c in found.items()}
    cells = [
        [_label(r), *(_bold(error(c[r.label]), best[name] == r.label) for name, c in found.items())]
        for r in rows
    ]
    marks = []
    for row in rows:
        lost = all(c[row.label].diverges for c in found.values())
        kind = "bound" if row.bound else "diverged" if lost else ""
        marks.append("own" if row.label in own and not kind else kind)
    return Table(["filter", *found], cells, caption, marks)


def _best(rows: Sequence[Row]) -> Row:
    return min((r for r in rows if not r.bound), key=lambda r: r.mean)


def _bold(text: str, really: bool) -> str:
    return f"**{text}**" if really else text


def parameters(space: ParameterSpace, sets: Mapping[str, Mapping[str, Any]], caption: str) -> Table:
    """Parameter sets beside each other, with symbol and range."""
    head = ["parameter", "symbol", "range", *sets]
    rows = []
    for p in space:
        limits = " | ".join(p.choices) if p.choices else f"{p.low:g} … {p.high:g}"
        values = [value(values.get(p.name, p.show(p.default))) for values in sets.values()]
        rows.append([p.name, p.symbol, limits, *values])
    return Table(head, rows, caption, text_columns=(0, 1))


def value(value: Any) -> str:
    """A parameter, short."""
    return value if isinstance(value, str) else f"{value:.4g}"


def error(row: Row) -> str:
    """Mean with half its interval; the median where the mean says nothing."""
    if row.diverges:
        return "diverges"
    return f"{row.mean:.3f} ± {row.high - row.mean:.3f}"


def metres(value: float) -> str:
    """A length, short."""
    if not math.isfinite(value):
        return NOTHING
    return f"{value:.3f}" if value < 10 else f"{value:,.0f}"


def percent(value: float) -> str:
    """A share, in whole percent unless it is small."""
    return f"{100 * value:.1f} %" if 0.0 < value < 0.1 else f"{100 * value:.0f} %"


def gain(row: Row) -> str:
    """Relative gain with its interval."""
    if row.diverges or not math.isfinite(row.gain):
        return NOTHING
    return f"{100 * row.gain:+.1f} % [{100 * row.gain_low:+.1f}, {100 * row.gain_high:+.1f}]"


def p_value(row: Row) -> str:
    """A p-value, no more exact than its permutations allow."""
    if row.diverges or not math.isfinite(row.p_value):
        return NOTHING
    return "≤ .001" if row.p_value <= 0.001 else f"{row.p_value:.3f}".lstrip("0")


def number(value: float) -> str:
    """A score."""
    return f"{value:.2f}" if math.isfinite(value) else NOTHING
