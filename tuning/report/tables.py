"""Comparisons as tables, for pages and terminals alike."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from navgym.core.parameters import ParameterSpace
from navgym.metrics import Consistency
from navgym.tuning.comparison import LEAST, Comparison, Row
from navgym.tuning.report.page import Table

NOTHING = "–"


def ladder(
    found: Comparison, own: Sequence[str] = (), caption: str = "", ranked: bool = True
) -> Table:
    """A comparison from the smallest to the largest error, or (not `ranked`) in its own order.

    Medians and p-values stand there where there are recordings enough for intervals over them; of
    recordings without truth what each filter foretells; of all of them NIS, and NEES where the truth is
    known, per degree of freedom, with the band in which a covariance that tells the truth has them.
    """
    columns = _columns(found)
    rows = sorted(found.rows, key=by_mean) if ranked else list(found.rows)
    cells = [[_label(row), *(show(row) for show in columns.values())] for row in rows]
    return Table(["filter", *columns], cells, caption, kinds(rows, own))


def _columns(found: Comparison) -> dict[str, Callable[[Row], str]]:
    """Cells of a row by head of its column."""
    many = found.runs >= LEAST
    made: dict[str, Callable[[Row], str]] = {found.measure.axis: error}
    for name, quantity in found.quantities.items():
        made[quantity.axis] = functools.partial(_beside, found.beside, name)
    if many:
        made["median"] = lambda r: size(r.median)
    made["diverged"] = lambda r: percent(r.divergence_rate)
    made[gain_head(found)] = lambda r: NOTHING if r.label == found.reference else gain(r)
    if many:
        made["p"] = lambda r: NOTHING if r.label == found.reference else p_value(r)
    if any(math.isfinite(r.score) for r in found.rows):
        made["score"] = lambda r: NOTHING if r.diverges else number(r.score)
    for name, told in (("NIS", found.nis), ("NEES", found.nees)):
        known = next((each for each in told.values() if each is not None), None)
        if known is not None:
            made[f"{name} ({band(known)})"] = functools.partial(_in_band, told)
    made["µs/step"] = lambda r: f"{found.microseconds[r.label]:.1f}"
    return made


def gain_head(found: Comparison) -> str:
    """What the column of gains is called: shares, or a difference of logarithms."""
    unit = "" if found.measure.relative else f", {found.measure.unit or 'absolute'}"
    return f"gain over {found.reference}{unit}"


def by_mean(row: Row) -> tuple[bool, float]:
    """Key that sorts rows by their mean, those without one last."""
    return not math.isfinite(row.mean), row.mean if math.isfinite(row.mean) else 0.0


def band(told: Consistency) -> str:
    """Where a covariance that tells the truth has its mean."""
    return f"{told.low:.2f} … {told.high:.2f}"


def consistent(told: Consistency | None) -> str:
    """NIS or NEES per degree of freedom, marked where it is outside its band."""
    if told is None or not math.isfinite(told.mean):
        return NOTHING
    mark = "" if told.consistent else " ↑" if told.mean > told.high else " ↓"
    return f"{told.mean:.2f}{mark}" if told.mean < 100 else f"{told.mean:,.0f}{mark}"


def _beside(told: Mapping[str, Mapping[str, float]], name: str, row: Row) -> str:
    """A further quantity of a row."""
    return NOTHING if row.diverges else size(told[row.label][name])


def _in_band(told: Mapping[str, Consistency | None], row: Row) -> str:
    """NIS or NEES of a row."""
    return consistent(told.get(row.label))


def _label(row: Row) -> str:
    return f"{row.label} (bound)" if row.bound else row.label


def kinds(rows: Sequence[Row], own: Sequence[str] = ()) -> list[str]:
    """Which rows to set off: bounds, what diverged, the best that can be had, what was tuned."""
    best = best_label(rows)
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
    rows = sorted(key.rows, key=by_mean)
    best = {name: best_label(c.rows) for name, c in found.items()}
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


def best_label(rows: Sequence[Row]) -> str:
    """Label of the best that can be had; "" if nothing worked."""
    sound = [r for r in rows if not r.bound and not r.diverges]
    return min(sound, key=by_mean).label if sound else ""


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
    """Mean with half its interval, if there is one."""
    if row.diverges:
        return "diverges"
    half = max(row.high - row.mean, row.mean - row.low)
    around = f" ± {half:.3f}" if math.isfinite(half) else ""
    return f"{row.mean:z.3f}{around}"


def size(value: float) -> str:
    """A quantity, short."""
    if not math.isfinite(value):
        return NOTHING
    return f"{value:z.3f}" if abs(value) < 10 else f"{value:,.0f}"


def percent(value: float) -> str:
    """A share, in whole percent unless it is small."""
    if not math.isfinite(value):
        return NOTHING
    return f"{100 * value:.1f} %" if 0.0 < value < 0.1 else f"{100 * value:.0f} %"


def share(value: float, signed: bool = True) -> str:
    """A share in percent with one decimal; never "-0.0"."""
    return f"{100 * value:+z.1f} %" if signed else f"{100 * value:z.1f} %"


def gain(row: Row) -> str:
    """The gain with its interval, if there is one."""
    if row.diverges or not math.isfinite(row.gain):
        return NOTHING
    show = _in_percent if row.relative else _in_units
    ends = f" [{show(row.gain_low)}, {show(row.gain_high)}]" if math.isfinite(row.gain_low) else ""
    return f"{show(row.gain)}{' %' if row.relative else ''}{ends}"


def _in_percent(value: float) -> str:
    return f"{100 * value:+z.1f}"


def _in_units(value: float) -> str:
    return f"{value:+z.3f}"


def p_value(row: Row) -> str:
    """A p-value, no more exact than its permutations allow."""
    if row.diverges or not math.isfinite(row.p_value):
        return NOTHING
    return "≤ .001" if row.p_value <= 0.001 else f"{row.p_value:.3f}".lstrip("0")


def number(value: float) -> str:
    """A score."""
    return f"{value:.2f}" if math.isfinite(value) else NOTHING
