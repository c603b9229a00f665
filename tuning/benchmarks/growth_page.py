"""What `scaling` has measured, as a page of tables and plots."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from navgym.tuning.benchmarks.scaling import Found, Growth, Point, Series
from navgym.tuning.report.plots import BEST, FAINT, MORE, OWN, PLAIN, drawing, plain_log

COLORS = (PLAIN, OWN, BEST, MORE[0])
PAPER, TEXT = "#ffffff", "#24292f"  # a picture in a page knows nothing of the page's colours
MB = 1e6
SPAN = 1.3  # by which a plot is higher and lower than what it shows
QUIET = 0.5  # load, from which on others are at work
NOISE = 2 * MB  # of memory: two processes that do the same differ by as much


def page(
    found: Sequence[tuple[Growth, Found]], command: str, machine: str, load: float, folder: str
) -> str:
    """The page as Markdown.

    Args:
        found: what was measured.
        command: that it was measured by.
        machine: where, in words.
        load: of the machine, by others.
        folder: where the pictures are, seen from the page.
    """
    busy = " Something else had been at work on these cores: where a curve jumps, it may be that."
    lines = [
        "# How fast: as work grows",
        "",
        f"Written by `{command}`. Every line of a table was measured in a process of its own: time is "
        "the median of its turns after a first one (of that alone where it is long), on one core where "
        "nothing else is said; memory is the most that the process ever held, with what it worked on, "
        "its imports and its compiled kernels.",
        "",
        f"{machine} before it began.{busy if load > QUIET else ''}",
        "",
    ]
    for growth, series in found:
        lines += [*_section(growth, series, folder), ""]
    return "\n".join(lines)


def _section(growth: Growth, found: Found, folder: str) -> list[str]:
    picture = f"![Time and memory by {growth.size}]({folder}/{file_name(growth)})"
    steep = " ".join(s for series, points in found if (s := steepest(growth, series, points)))
    said = [part for text in (growth.why, steep) if text for part in (text, "")]
    return [f"## {growth.title}", "", picture, "", *said, *_table(growth, found)]


def file_name(growth: Growth) -> str:
    """Of its picture."""
    return f"scaling-{growth.name}.svg"


# ---- the table


def _table(growth: Growth, found: Found) -> list[str]:
    head = [growth.size, "", "time", f"a {growth.unit}", f"{growth.unit}s/s"]
    head += [f"{growth.unit}s/s for each"] if growth.each else []
    head += ["memory", "for one more"]
    rows = [
        _row(growth, series, point, before)
        for series, points in found
        for before, point in zip([None, *points], points, strict=False)
    ]
    return [_line(head), _line(["---"] * len(head)), *map(_line, rows)]


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _row(growth: Growth, series: Series, point: Point, before: Point | None) -> list[str]:
    first = [f"{point.size:,}", _named(series)]
    if point.trouble:
        return [*first, point.trouble, *[""] * (4 + growth.each)]
    rate = point.units / point.seconds
    each = [f"{rate / point.size:,.0f}"] if growth.each else []
    pace = f"{rate:,.0f}" if rate >= 10.0 else f"{rate:.2g}"
    return [
        *first, in_words(point.seconds), in_words(point.seconds / point.units), pace, *each,
        f"{point.memory / MB:,.0f} MB", _more(point, before),
    ]  # fmt: skip


def _named(series: Series) -> str:
    """Its label, as code where it is some."""
    return f"`{series.label}`" if "(" in series.label else series.label


def _more(point: Point, before: Point | None) -> str:
    """Memory for one more of a size, where the difference to the size before can be seen."""
    if before is None or not point.memory - before.memory > NOISE:
        return ""
    more = (point.memory - before.memory) / (point.size - before.size)
    name, k = next(unit for unit in (("MB", MB), ("kB", 1e3), ("B", 0.0)) if more >= unit[1])
    return f"{more / (k or 1.0):,.3g} {name}"


def in_words(seconds: float) -> str:
    """A time in the unit that fits, three digits."""
    for name, k in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= k:
            return f"{seconds / k:.3g} {name}" if seconds < 1e3 * k else f"{seconds:,.0f} s"
    return f"{seconds * 1e6:.3g} µs"


def steepest(growth: Growth, series: Series, points: Sequence[Point]) -> str:
    """Between which sizes time grew most beyond proportion, as a sentence; "" where no work grows.

    More workers, for example, are not more work.
    """
    pairs = [(a, b) for a, b in itertools.pairwise(points) if b.units > a.units > 0]
    if not pairs:
        return ""
    a, b = max(pairs, key=lambda p: (p[1].seconds / p[0].seconds) / (p[1].size / p[0].size))
    return (
        f"{_named(series)}: {b.size / a.size:g} times the {growth.size} took at most "
        f"{b.seconds / a.seconds:.1f} times as long (from {a.size:,} to {b.size:,})."
    )


# ---- the plots


def pictures(found: Sequence[tuple[Growth, Found]]) -> Mapping[str, str]:
    """SVG by name of its file."""
    return {file_name(growth): picture(growth, series) for growth, series in found}


def picture(growth: Growth, found: Found) -> str:
    """Time for one unit and memory by size, as SVG on a ground of its own."""
    with drawing("", 3.4, ncols=2) as ((left, right), made):
        _curves(left, found, lambda p: growth.scale[1] * p.seconds / p.units)
        left.set_title(f"time for one {growth.unit}, {growth.scale[0]}")
        _curves(right, found, lambda p: p.memory / MB)
        _proportional(right, found)
        right.set_title("memory, MB")
        for axes in (left, right):
            axes.set_xlabel(growth.size)
            axes.grid()
    svg = made[0].svg.replace("currentColor", TEXT)
    head = svg.index(">") + 1
    return f'{svg[:head]}\n<rect width="100%" height="100%" fill="{PAPER}"/>{svg[head:]}'


def _curves(axes: Axes, found: Found, value: Callable[[Point], float]) -> None:
    """A curve per series, both axes logarithmic."""
    for (series, points), color in zip(found, COLORS, strict=False):
        sound = [p for p in points if not p.trouble]
        x, y = [p.size for p in sound], [value(p) for p in sound]
        axes.plot(x, y, "o-", color=color, lw=1.6, ms=4, label=series.label)
    sizes = sorted({p.size for _, points in found for p in points})
    axes.set_xscale("log")
    axes.set_xticks(sizes, [_short(size) for size in sizes])
    axes.xaxis.set_minor_locator(NullLocator())
    shown = [value(p) for _, points in found for p in points if not p.trouble] or [1.0]
    axes.set_ylim(min(shown) / SPAN, max(shown) * SPAN)
    plain_log(axes)


def _short(size: int) -> str:
    """1, 100, 10k, 1M."""
    for name, k in (("M", 10**6), ("k", 10**3)):
        if size >= k:
            return f"{size // k}{name}"
    return str(size)


def _proportional(axes: Axes, found: Found) -> None:
    """What the largest memory would grow from, if nothing but the work took any."""
    points = [p for _, points in found for p in points if not p.trouble]
    largest, low = max(points, key=lambda p: p.memory), axes.get_ylim()[0]
    ends = max(largest.size * low * MB / largest.memory, min(p.size for p in points)), largest.size
    axes.plot(
        ends, [largest.memory / MB * end / largest.size for end in ends],
        color=FAINT, lw=1.2, ls=(0, (4, 3)), label="proportional", zorder=0,
    )  # fmt: skip
    axes.legend(loc="upper left", fontsize=9)
