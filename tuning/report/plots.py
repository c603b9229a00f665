"""Figures of the reports, as SVG that follows the page's colours in light and dark.

Lines and text that belong to the page are drawn in a stand-in colour, which becomes the page's own
text colour; data have colours of middle lightness, which read on both backgrounds.
"""

from __future__ import annotations

import io
import itertools
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.statespace.recording import Recording
from navgym.tuning.comparison import Comparison, Row
from navgym.tuning.report.page import Figure
from navgym.tuning.report.tables import best_label, by_mean
from navgym.tuning.study.run import Outcome

INK = "#010203"  # stands for the page's text colour
FAINT = "#8b93a0"
BEST, OWN, PLAIN, BAD = "#2a9268", "#d9822b", "#4a83c4", "#c9483c"
MORE = ("#8d6bb8", "#2f9aa8", "#b0892e", "#c05f93")
# of regimes, over again where there are more
TINTS = ("#8b93a0", "#d9822b", "#4a83c4", "#8d6bb8", "#2a9268", "#b0506b", "#7f8c2d", "#2f9fb0")
WIDTH = 10.0  # inches; the page scales it
# inches of the same drawing on a telephone, per column of panels beside the first
NARROW, COLUMN = 4.8, 1.3

STYLE: dict[Any, Any] = {
    "svg.fonttype": "path",
    "svg.hashsalt": "navgym",
    "font.size": 10.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.8,
    "ytick.major.width": 0.8,
    "grid.color": FAINT,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
}


@contextmanager
def drawing(caption: str, height: float, **grid: Any) -> Iterator[tuple[Any, list[Figure]]]:
    """Axes to draw on (`grid` as for `Figure.subplots`), and a list that then holds the figure."""
    made: list[Figure] = []
    with mpl.rc_context(STYLE):
        canvas = Canvas(figsize=(WIDTH, height), layout="constrained")
        yield canvas.subplots(**grid), made
        wide = _svg(canvas)
        canvas.set_size_inches(NARROW + COLUMN * (grid.get("ncols", 1) - 1), height)
        for axes in canvas.axes:
            _stack_legend(axes)
        for legend in canvas.legends[:]:
            legend.remove()
            above_all(canvas, legend.legend_handles, [t.get_text() for t in legend.get_texts()], 3)
        mpl.rcParams["svg.hashsalt"] = "navgym, narrow"  # both stand on one page
        made.append(Figure(wide, caption, _svg(canvas)))


def above_all(canvas: Any, handles: Sequence[Any], labels: Sequence[str], columns: int = 6) -> None:
    """One legend above all panels, which have titles where each could have its own; none for nothing."""
    if handles:
        canvas.legend(
            handles=handles, labels=labels, loc="outside upper left", ncols=columns, fontsize=9
        )


def _stack_legend(axes: Axes) -> None:
    """A legend that stands above the axes in many columns, in two."""
    legend: Any = axes.get_legend()
    if legend is None or legend._ncols < 3:  # matplotlib tells it nowhere else
        return
    labels = [text.get_text() for text in legend.get_texts()]
    axes.legend(
        handles=legend.legend_handles, labels=labels, loc="lower left", bbox_to_anchor=(0.0, 1.0),
        ncols=2, fontsize=9, borderaxespad=0.2,
    )  # fmt: skip


def wrapped(text: str, width: int = 28) -> str:
    """A label on as many lines as it needs beside a small figure."""
    return textwrap.fill(text, width)


def _svg(canvas: Canvas) -> str:
    """The drawing as SVG in the page's colours."""
    buffer = io.StringIO()
    canvas.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :].replace(INK, "currentColor")


def color_of(row: Row, best: str = "", own: Sequence[str] = ()) -> str:
    """Colour of a contender wherever it appears."""
    if row.bound:
        return FAINT
    if row.label == best:
        return BEST
    if row.label in own:
        return OWN
    return BAD if row.diverges else PLAIN


# ---- the ladder


def ladder(found: Comparison, own: Sequence[str], caption: str, ranked: bool = True) -> Figure:
    """Mean error of each contender as bars with confidence intervals, the best on top.

    Bars that would leave the others invisible are cut, and say so. Not `ranked`, the bars keep the
    comparison's own order.
    """
    rows = sorted(found.rows, key=by_mean) if ranked else list(found.rows)
    best = best_label(found.rows)
    bars = found.measure.relative
    low, reach = (0.0, _reach(rows)) if bars else _span(rows)
    with drawing(caption, 0.6 + 0.34 * len(rows)) as (axes, made):
        for i, row in enumerate(rows):
            _bar(axes, i, row, low, reach, color_of(row, best, own), bars)
        axes.set_yticks(range(len(rows)), [_named(r) for r in rows])
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_xlim(low, low + (reach - low) * 1.17)
        axes.set_xlabel(
            f"{found.measure.axis}: mean over runs" if found.runs > 1 else found.measure.axis
        )
        axes.tick_params(axis="y", length=0)
        axes.grid(axis="x")
        axes.set_axisbelow(True)
        axes.spines["left"].set_visible(False)
        bounds = [r.mean for r in rows if r.bound and np.isfinite(r.mean)]
        if bounds:
            axes.axvline(min(bounds), color=FAINT, lw=1.0, ls=(0, (4, 3)))
    return made[0]


def _named(row: Row) -> str:
    return f"{row.label} (bound)" if row.bound else row.label


def _ends(row: Row) -> tuple[float, float]:
    """A row's interval, or its mean twice where it has none."""
    known = np.isfinite(row.low) and np.isfinite(row.high)
    return (row.low, row.high) if known else (row.mean, row.mean)


def _reach(rows: Sequence[Row]) -> float:
    """Length that shows the contenders which work: at most four times their median."""
    sound = sorted((r for r in rows if not r.diverges), key=lambda r: r.mean)
    if not sound:
        return 1.0
    shown = [r for r in sound if r.mean <= 4.0 * sound[len(sound) // 2].mean] or sound
    return 1.05 * max(_ends(r)[1] for r in shown) or 1.0


def _span(rows: Sequence[Row]) -> tuple[float, float]:
    """Ends that show the contenders which work, of a measure that may be negative: no further from the
    best than four times the median one.
    """
    sound = sorted((r for r in rows if not r.diverges), key=lambda r: r.mean)
    if not sound:
        return 0.0, 1.0
    best, middle = sound[0].mean, sound[len(sound) // 2].mean
    shown = [r for r in sound if r.mean - best <= max(4.0 * (middle - best), 1e-9)]
    low, high = min(_ends(r)[0] for r in shown), max(_ends(r)[1] for r in shown)
    margin = 0.08 * (high - low) or 0.1 * max(abs(low), 1e-3)
    return low - margin, high + margin


def _bar(axes: Axes, i: int, row: Row, low: float, reach: float, color: str, bar: bool) -> None:
    cut = not row.mean <= reach
    end, width = (reach if cut else row.mean), reach - low
    face = (color, 0.0 if row.bound else 0.25 if row.diverges else 0.9)
    if bar:
        axes.barh(i, end, 0.66, facecolor=face, edgecolor=color, lw=1.0)
    else:
        axes.plot(end, i, ">" if cut else "o", mfc=face, mec=color, ms=8)
    first, last = _ends(row)
    if not cut and last > first:
        axes.plot([first, last], [i, i], color=INK, lw=1.4, solid_capstyle="butt")
    text = f"{row.mean:z.3f}" if not cut else f"{row.mean:,.4g} →"
    if not np.isfinite(row.mean):
        text = "no number →"
    if row.diverges:
        text += f"  {100 * row.divergence_rate:.0f} % of runs diverge"
    inside = cut and row.diverges
    x, side = (low + 0.985 * width, "right") if inside else (end + 0.012 * width, "left")
    x = x if cut or not np.isfinite(last) else max(x, last + 0.012 * width)
    axes.text(x, i, text, va="center", ha=side)


def plain_log(axes: Axes) -> None:
    """Logarithmic y axis of what is drawn, with plain numbers at a few steps per decade."""
    if axes.get_ylim()[1] <= 0.0:  # nothing was drawn that has a logarithm
        return
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    decades = np.log10(high / low)
    subs = (
        (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if decades < 1.5 else (1.0, 3.0) if decades < 3 else (1.0,)
    )
    axes.yaxis.set_major_locator(LogLocator(subs=subs, numticks=12))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter("{x:g}")


# ---- errors in time


def moving_rms(squared: Array, window: int = 20) -> Array:
    """Root of the mean of the last `window` squared errors at each time, (T,)."""
    total = np.cumsum(np.concatenate([[0.0], squared]))
    first = np.maximum(np.arange(len(squared)) - window + 1, 0)
    last = np.arange(1, len(squared) + 1)
    mean: Array = (total[last] - total[first]) / (last - first)
    return np.sqrt(mean)


def example(
    recording: Recording,
    squared: Mapping[str, Array],
    colors: Mapping[str, str],
    beliefs: Mapping[str, Array],
    caption: str,
) -> Figure:
    """One recording: error of a few filters over the true regimes, and what the bank believes.

    Args:
        recording: simulated, so that its regimes are known.
        squared: per label, squared error (T,) in m².
        colors: per label.
        beliefs: per regime name, the bank's probability (T,) of it.
        caption: of the figure.
    """
    grid: dict[str, Any] = {"nrows": 2, "sharex": True, "height_ratios": (2.2, 1)}
    with drawing(caption, 4.6, **grid) as ((above, below), made):
        for label, square in squared.items():
            above.plot(recording.time, moving_rms(square), color=colors[label], lw=1.5, label=label)
        plain_log(above)
        above.set_ylabel("position error, m\n(RMS of the last 20 s)")
        above.grid(axis="y")
        names = recording.meta["regimes"]
        tints = dict(zip(names, itertools.cycle(TINTS), strict=False))
        for axes in (above, below):
            shade(axes, recording.time, recording.regime, [tints[name] for name in names])
        handles, labels = above.get_legend_handles_labels()
        handles += [Patch(color=tints[name], alpha=0.22) for name in names]
        labels += [f"true regime: {name}" for name in names]
        above.legend(
            handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=9,
            borderaxespad=0.2,
        )  # fmt: skip
        for name, belief in beliefs.items():
            below.plot(recording.time, belief, color=tints[name], lw=1.4)
        below.set_ylim(-0.03, 1.03)
        below.set_yticks([0, 0.5, 1])
        below.set_ylabel("what the bank\nbelieves")
        below.set_xlabel("time, s")
        below.set_xlim(recording.time[0], recording.time[-1])
    return made[0]


def shade(axes: Axes, time: Array, regime: NDArray[np.int64], tints: Sequence[str]) -> None:
    """Tint the spans of each true regime."""
    for start, stop, label in _spans(regime):
        end = time[min(stop, len(time) - 1)]
        axes.axvspan(time[start], end, color=tints[label % len(tints)], alpha=0.16, lw=0)


def _spans(labels: NDArray[np.int64]) -> Iterator[tuple[int, int, int]]:
    """(first, one past the last, label) of each run of equal labels."""
    edges = [0, *(np.flatnonzero(np.diff(labels)) + 1).tolist(), len(labels)]
    for start, stop in itertools.pairwise(edges):
        yield start, stop, int(labels[start])


class Labelled(Protocol):
    """Something with a true regime at each moment."""

    @property
    def regime(self) -> NDArray[np.int64]:
        """(T,) labels."""

    @property
    def meta(self) -> Mapping[str, Any]:
        """Holds the names of the labels, `regimes`."""


def after_switch(
    recordings: Sequence[Labelled],
    squared: Mapping[str, Array],
    colors: Mapping[str, str],
    caption: str,
    before: int = 15,
    after: int = 50,
    axis: str = "position RMSE, m",
) -> Figure:
    """RMSE over all switches into each regime, aligned at the switch, with 95 % bands.

    Args:
        recordings: what the errors belong to, one sample per second.
        squared: per label, squared errors (N, T).
        colors: per label.
        caption: of the figure.
        before: seconds to show before a switch.
        after: and after it.
        axis: what the errors are.
    """
    names = recordings[0].meta["regimes"]
    columns = len(names) if len(names) <= 4 else 3
    rows = -(-len(names) // columns)
    grid = {"ncols": columns, "nrows": rows, "sharey": True, "sharex": True, "squeeze": False}
    with drawing(caption, 3.3 * rows if rows == 1 else 2.7 * rows, **grid) as (panels, made):
        curves: list[Array] = []
        for spare in panels.flat[len(names) :]:
            spare.set_visible(False)
        for label, (axes, name) in enumerate(zip(panels.flat, names, strict=False)):
            places = list(_switches(recordings, label, before, after))
            for key, errors in squared.items():
                if len(places) > 1:  # a band needs two
                    windows = np.array([errors[i, k - before : k + after] for i, k in places])
                    x = np.arange(-before, after)
                    curves.append(_band(axes, x, windows, colors[key], key))
            axes.axvline(0.0, color=INK, lw=0.8, ls=(0, (2, 2)))
            axes.set_title(f"into {name} ({len(places)})")
            axes.set_xlabel("s after the switch")
            axes.grid(axis="y")
        drawn = [c[np.isfinite(c) & (c > 0.0)] for c in curves]
        if any(map(len, drawn)):  # bands may reach far below
            ends = np.concatenate(drawn)
            panels[0][0].set_ylim(0.8 * ends.min(), 1.25 * ends.max())
        plain_log(panels[0][0])
        for axes in panels[:, 0]:
            axes.set_ylabel(axis)
        above_all(panels[0][0].figure, *panels[0][0].get_legend_handles_labels())
    return made[0]


def _switches(
    recordings: Sequence[Labelled], label: int, before: int, after: int
) -> Iterator[tuple[int, int]]:
    """(recording, sample) of every switch into a regime that lasts as long as the window."""
    for i, recording in enumerate(recordings):
        for start, stop, now in _spans(recording.regime):
            if now == label and start >= before and stop - start >= after:
                yield i, start


def _band(axes: Axes, x: NDArray[Any], windows: Array, color: str, label: str) -> Array:
    """Draw the RMS of windows (N, T) with its 95 % band; returns it, (T,)."""
    with np.errstate(invalid="ignore"):
        mean = np.where(np.isfinite(windows), windows, np.nan).mean(
            axis=0
        )  # a failure leaves a gap
    half = 1.96 * windows.std(axis=0, ddof=1) / np.sqrt(len(windows))
    least = mean / 100.0  # a band that reaches 0 has no lower end on a logarithmic axis
    axes.fill_between(
        x, np.sqrt(np.maximum(mean - half, least)), np.sqrt(mean + half),
        color=color, alpha=0.25, lw=0,
    )  # fmt: skip
    root: Array = np.sqrt(mean)
    axes.plot(x, root, color=color, lw=1.5, label=label)
    return root


# ---- the study


def history(
    outcome: Outcome, default: float, caption: str, axis: str = "position RMSE, m"
) -> Figure:
    """Every trial, the best so far, and where the defaults stand; what is far off is cut."""
    results = np.array([t.result for t in outcome.trials])
    count = np.arange(1, len(results) + 1)
    low, top = history_span(results, default)
    with drawing(caption, 2.9) as (axes, made):
        near = results <= top
        axes.scatter(count[near], results[near], s=16, color=FAINT, alpha=0.8, lw=0, label="trial")
        axes.scatter(
            count[~near], np.full((~near).sum(), top), s=16, color=FAINT, alpha=0.8, lw=0,
            marker="^", label="beyond the axis",
        )  # fmt: skip
        axes.axhline(default, color=PLAIN, lw=1.2, ls=(0, (4, 3)), label="default parameters")
        axes.step(
            count,
            np.minimum.accumulate(results),
            where="post",
            color=OWN,
            lw=1.8,
            label="best so far",
        )
        axes.set_ylim(low - 0.06 * (top - low), top * 1.04)
        axes.set_xlabel("trial")
        axes.set_ylabel(wrapped(f"objective: {axis}"))
        axes.grid(axis="y")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=9)
    return made[0]


def history_span(results: Array, default: float) -> tuple[float, float]:
    """Lowest result, and where the axis is cut: some way above the defaults, if they came to a number."""
    known = results[np.isfinite(results)]
    low = float(known.min()) if len(known) else 0.0
    middle = float(np.median(known)) if len(known) else 1.0
    usual = default if np.isfinite(default) else middle
    top = max(low + 0.8 * abs(low), usual + 0.2 * abs(usual))
    if low < 0.0:  # a logarithm: nothing to take shares of
        top = max(usual, middle) + 0.2 * (max(usual, middle) - low)
    return low, top if top > low else low + 1.0


# ---- real tracks


def track(
    recording: Recording,
    states: Mapping[str, Array],
    colors: Mapping[str, str],
    caption: str,
    window: int = 40,
) -> Figure:
    """A real track from above, with what was lost; beside it the stretch around the longest gap."""
    grid = {"ncols": 2, "width_ratios": (1, 1.25)}
    lost = recording.lost.all(axis=1)
    first = _longest_gap(lost, window)
    near = slice(first, first + window)
    with drawing(caption, 4.6, **grid) as ((far, close), made):
        _path(far, recording, slice(None), lost)
        north, east = recording.truth[near, 0], recording.truth[near, 2]
        far.plot(east.mean(), north.mean(), "o", ms=26, mfc="none", mec=INK, mew=1.2)
        far.set_title("the whole track")
        _path(close, recording, near, lost)
        fixes = np.where(lost[near, None], np.nan, recording.measurements[near])
        close.plot(fixes[:, 2], fixes[:, 0], "+", color=INK, ms=7, mew=1.0)
        for label, state in states.items():
            close.plot(state[near, 2], state[near, 0], ".-", color=colors[label], lw=1.4, ms=4)
        close.set_title("inside the circle, 40 s around the longest gap")
        for axes in (far, close):
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_xlabel("east, m")
            axes.set_ylabel("north, m")
            axes.grid()
        _track_legend(close, {label: colors[label] for label in states})
    return made[0]


def _path(axes: Axes, recording: Recording, part: slice, lost: NDArray[np.bool_]) -> None:
    north, east = recording.truth[part, 0], recording.truth[part, 2]
    gone = lost[part]
    axes.plot(east, north, color=FAINT, lw=1.4)
    axes.plot(east[gone], north[gone], "x", color=BAD, ms=4 if len(east) > 100 else 6, mew=1.0)


def _track_legend(axes: Axes, colors: Mapping[str, str]) -> None:
    handles = [
        Line2D([], [], color=FAINT, lw=1.4, label="reference"),
        Line2D([], [], color=BAD, marker="x", ls="", label="sample lost here"),
        Line2D([], [], color=INK, marker="+", ls="", label="position fix"),
        *(Line2D([], [], color=c, marker=".", label=label) for label, c in colors.items()),
    ]
    axes.legend(handles=handles, fontsize=9, loc="best")


def _longest_gap(lost: NDArray[np.bool_], window: int) -> int:
    """First sample of the window that has the longest run of losses in its middle."""
    gaps = [(b - a, a) for a, b, now in _spans(lost.astype(np.int64)) if now]
    length, start = max(gaps, default=(0, 0))
    return int(np.clip(start + length // 2 - window // 2, 0, max(len(lost) - window, 0)))


def _height(row: Row) -> tuple[float, float]:
    """Height of a bar and half its interval; none where there is no number."""
    half = row.high - row.mean
    return row.mean if np.isfinite(row.mean) else 0.0, half if np.isfinite(half) else 0.0


def by_loss(
    found: Mapping[str, Comparison], labels: Sequence[str], colors: Mapping[str, str], caption: str
) -> Figure:
    """Mean error of a few contenders at each loss rate, with intervals."""
    with drawing(caption, 3.4) as (axes, made):
        places = np.arange(len(found))
        step = 0.8 / len(labels)
        for j, label in enumerate(labels):
            rows = [comparison[label] for comparison in found.values()]
            x = places + (j - (len(labels) - 1) / 2) * step
            mean, half = (np.array(a) for a in zip(*map(_height, rows), strict=True))
            axes.bar(x, mean, step * 0.86, yerr=half, color=colors[label], ecolor=INK, label=label)
        axes.set_xticks(places, list(found))
        axes.set_ylabel("position RMSE, m")
        axes.grid(axis="y")
        axes.set_axisbelow(True)
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=9)
    return made[0]
