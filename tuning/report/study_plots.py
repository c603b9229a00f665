"""Figures of a study: what matters, where it is flat, how two parameters play together."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import FuncFormatter, MaxNLocator

from navgym.core.checks import Array
from navgym.core.parameters import Parameter, ParameterSpace
from navgym.tuning.report.page import Figure
from navgym.tuning.report.plots import BEST, FAINT, INK, OWN, PLAIN, drawing, wrapped
from navgym.tuning.study.run import Outcome, Trial
from navgym.tuning.study.sensitivity import Sweep

COLUMNS = 3  # panels in a row
GOOD_TO_BAD = LinearSegmentedColormap.from_list("", [BEST, "#b9c4bd", "#d7a27c"])
SHOWN = 0.5  # changes beyond this share are cut in sweeps
BAND = 0.03  # of the objective above its best, the colours of a contour end


def importance(shares: Mapping[str, float], dead: Sequence[str], caption: str) -> Figure:
    """Importances as bars, dead parameters pale."""
    names = list(shares)
    with drawing(caption, 0.7 + 0.34 * len(names)) as (axes, made):
        colors = [FAINT if name in dead else OWN for name in names]
        axes.barh(range(len(names)), list(shares.values()), 0.62, color=colors)
        for i, name in enumerate(names):
            text = f"{shares[name]:z.2f}" + ("  dead" if name in dead else "")
            axes.text(shares[name] + 0.01, i, text, va="center")
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        axes.set_xlim(0.0, max(shares.values()) * 1.15 or 1.0)
        axes.set_xlabel("PED-ANOVA importance, share")
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
    return made[0]


def slices(sweeps: Sequence[Sweep], outcome: Outcome, caption: str, unit: str = "%") -> Figure:
    """Per parameter: the metric around the winner with its interval, and all trials behind it.

    `unit` is that of changes: percent, or the metric's own where it has no shares.
    """
    rows = -(-len(sweeps) // COLUMNS)
    grid: dict[str, Any] = {"nrows": rows, "ncols": min(COLUMNS, len(sweeps)), "squeeze": False}
    with drawing(caption, 2.6 * rows, **grid) as (panels, made):
        for axes, sweep in itertools.zip_longest(panels.flat, sweeps):
            if sweep is None:
                axes.set_axis_off()
            else:
                _slice(axes, sweep, outcome)
        for row in panels:
            row[0].set_ylabel(wrapped(f"change against the winner, {unit}"))
    return made[0]


def _slice(axes: Axes, sweep: Sweep, outcome: Outcome) -> None:
    p = sweep.parameter
    size = 100.0 if sweep.relative else 1.0
    low, high, middle = (size * a for a in (sweep.low, sweep.high, sweep.change))
    highest = float(np.max(middle, initial=0.0, where=np.isfinite(middle)))
    top = min(size * SHOWN, max(0.04 * size, 1.25 * highest))
    x = np.array([p.warp(v) for v in sweep.values])
    spread = size * above_best(np.array([t.result for t in outcome.trials]), sweep.relative)
    places = [p.warp(float(p.check(t.values[p.name]))) for t in outcome.trials]
    axes.scatter(places, np.minimum(spread, top), s=7, color=FAINT, alpha=0.55, lw=0)
    axes.fill_between(x, low, high, color=PLAIN, alpha=0.22, lw=0)
    axes.plot(x, middle, ".-", color=PLAIN, lw=1.5, ms=5)
    axes.axvline(p.warp(sweep.chosen), color=OWN, lw=1.3)
    if sweep.flat is not None:
        first, last = map(p.warp, sweep.flat)
        axes.axvspan(first, last, ymax=0.04, color=BEST, alpha=0.8, lw=0)
    least = float(np.min(low, initial=0.0, where=np.isfinite(low)))
    axes.set_ylim(min(-0.06 * top, 1.2 * max(least, -top)), top * 1.04)
    axes.set_title(p.name)
    _scale(axes, p, "x")
    axes.grid(axis="y")


def above_best(results: Array, relative: bool) -> Array:
    """How far results are above the smallest, as shares of it where that makes sense."""
    known = results[np.isfinite(results)]
    best = float(known.min()) if len(known) else 0.0
    with np.errstate(invalid="ignore"):
        over = results - best
        return over / best if relative and best > 0.0 else over


def _scale(axes: Axes, p: Parameter, which: str) -> None:
    """Ticks of a parameter's own scale, labelled with its values."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    set_label = axes.set_xlabel if which == "x" else axes.set_ylabel
    set_limits = axes.set_xlim if which == "x" else axes.set_ylim
    set_limits(p.warp(p.low), p.warp(p.high))
    if p.choices:
        axis.set_ticks(range(len(p.choices)), list(p.choices))
    elif p.scale == "log":
        first, last = np.log10(p.low), np.log10(p.high)
        step = max(1, round((last - first) / 4))
        powers = np.arange(np.ceil(first - 1e-9), last + 1e-9, step)
        ends = powers if len(powers) > 1 else np.log10([p.low, np.sqrt(p.low * p.high), p.high])
        axis.set_ticks([float(v) * np.log(10.0) for v in ends], [f"{10.0**v:.4g}" for v in ends])
    elif p.scale == "log-complement":
        shown = [v for v in (0.6, 0.9, 0.97, 0.99, 0.997, 0.999, 0.9999) if p.low <= v <= p.high]
        axis.set_ticks([p.warp(v) for v in shown], [f"{v:g}" for v in shown])
    else:
        axis.set_major_locator(MaxNLocator(4, integer=p.integer))
        axis.set_major_formatter(FuncFormatter(lambda v, _: f"{p.unwarp(v):.3g}"))
    unit = "" if p.unit == "1" else f", {p.unit}"
    set_label(f"{p.symbol}{unit}")


def contour(
    outcome: Outcome, space: ParameterSpace, names: tuple[str, str], chosen: Trial, caption: str,
    relative: bool = True, unit: str = "%",
) -> Figure:  # fmt: skip
    """The objective over two parameters, from the trials, and where the winner stands.

    Not `relative`, objectives are told as differences, in `unit`.
    """
    first, second = (space[name] for name in names)
    x, y = (
        np.array([p.warp(float(p.check(t.values[p.name]))) for t in outcome.trials])
        for p in (first, second)
    )
    above = above_best(np.array([t.result for t in outcome.trials]), relative)
    size = 100.0 if relative else 1.0
    with drawing(caption, 4.2) as (axes, made):
        color = size * np.minimum(np.where(np.isfinite(above), above, np.inf), _far(above))
        order = np.argsort(-color)
        dots = axes.scatter(
            x[order], y[order], c=color[order], cmap=GOOD_TO_BAD, s=40, lw=0, alpha=0.9
        )
        _levels(axes, x, y, color)
        place = [p.warp(float(p.check(chosen.values[p.name]))) for p in (first, second)]
        axes.plot(*place, "o", ms=13, mfc="none", mec=INK, mew=1.6)
        bar = axes.figure.colorbar(dots, ax=axes, pad=0.02)
        bar.set_label(wrapped(f"above the best trial, {unit} (cut)"))
        bar.outline.set_visible(False)
        for p, which in ((first, "x"), (second, "y")):
            _scale(axes, p, which)
        axes.set_xlabel(f"{first.name} ({first.symbol})")
        axes.set_ylabel(f"{second.name} ({second.symbol})")
    return made[0]


def _far(above: Array) -> float:
    """Where the colours end: what half of the trials stay below, at least `BAND`."""
    known = above[np.isfinite(above)]
    return max(BAND, float(np.median(known))) if len(known) else BAND


def _levels(axes: Axes, x: Array, y: Array, color: Array) -> None:
    """Lines of equal objective through the trials, where they span an area."""
    points = np.unique(np.column_stack([x, y]), axis=0)
    if len(points) < 10 or min(np.ptp(x), np.ptp(y)) == 0.0:
        return
    levels = [0.2 * color.max(), 0.5 * color.max()]
    try:
        axes.tricontour(x, y, color, levels=levels, colors=[FAINT], linewidths=0.9)
    except (RuntimeError, ValueError):  # trials on one line, which no triangle spans
        return


def front(outcome: Outcome, chosen: Trial, axis: str, caption: str) -> Figure:
    """What was minimised against time per step: all trials, and the ones that nothing beats in both."""
    best = outcome.front or (outcome.best,)
    with drawing(caption, 3.4) as (axes, made):
        reached = best[-1].result
        top = reached + 0.6 * abs(reached)
        cost = np.array([t.cost or np.nan for t in outcome.trials])
        result = np.array([t.result for t in outcome.trials])
        axes.scatter(
            cost, np.minimum(result, top), s=14, color=FAINT, lw=0, alpha=0.8, label="trial"
        )
        axes.plot([t.cost for t in best], [t.result for t in best], "o-", color=OWN, label="front")
        axes.plot(chosen.cost, chosen.result, "o", ms=13, mfc="none", mec=INK, label="chosen")
        axes.set_xlabel("µs per filter step")
        axes.set_ylabel(axis)
        axes.grid()
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=9, ncols=3)
    return made[0]


def over_time(
    time: Array, traces: Mapping[str, Array], colors: Mapping[str, str], axis: str, caption: str,
    squared: bool = True, bins: int = 80, place: str = "time, s",
) -> Figure:  # fmt: skip
    """Mean over runs in bins of time, with 95 % bands over runs; roots of it for squared errors.

    Args:
        time: (T,) s.
        traces: per label, (N, T); NaN is left out.
        colors: per label.
        axis: of the quantity.
        caption: of the figure.
        squared: whether traces are squared errors.
        bins: of time.
        place: label of the axis of time.
    """
    edges = np.linspace(0, len(time), min(bins, len(time)) + 1).astype(np.int64)
    with drawing(caption, 3.0) as (axes, made):
        for label, trace in traces.items():
            x, middle, around = _binned(time, trace, edges)
            if not len(x):
                continue
            low, high = middle - around, middle + around
            if squared:
                low, middle, high = (np.sqrt(np.maximum(a, 0.0)) for a in (low, middle, high))
            axes.fill_between(x, low, high, color=colors[label], alpha=0.2, lw=0)
            axes.plot(x, middle, color=colors[label], lw=1.5, label=label)
        axes.set_xlabel(place)
        axes.set_ylabel(wrapped(axis))
        heard = np.flatnonzero(
            np.any([np.isfinite(t).any(axis=0) for t in traces.values()], axis=0)
        )
        if len(heard) > 1:
            axes.set_xlim(time[heard[0]], time[heard[-1]])
        if squared:
            axes.set_ylim(bottom=0.0)
        axes.grid(axis="y")
        if axes.has_data():
            axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=9, ncols=4)
    return made[0]


def _binned(time: Array, trace: Array, edges: Any) -> tuple[Array, Array, Array]:
    """Bin centres, mean over runs, and half the width of its interval."""
    rows = []
    for first, last in itertools.pairwise(edges):
        piece = trace[:, first:last]
        known = np.isfinite(piece)
        count = known.sum(axis=1)
        runs = np.where(known, piece, 0.0).sum(axis=1)[count > 0] / count[count > 0]
        if len(runs):
            half = 1.96 * runs.std(ddof=1) / np.sqrt(len(runs)) if len(runs) > 1 else 0.0
            rows.append((time[first:last].mean(), runs.mean(), half))
    x, middle, half_ = np.array(rows).reshape(-1, 3).T
    return x, middle, half_
