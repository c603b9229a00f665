"""Figures of the evaluation that no other report has."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from navgym.agents.evaluation.contest import Result
from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.tuning.report import plots
from navgym.tuning.report.page import Figure


def traces(
    result: Result,
    names: Sequence[str],
    colors: Mapping[str, str],
    space: ParameterSpace,
    caption: str,
) -> Figure:
    """Parameters over time on one recording, over the true regimes: a panel per parameter.

    Args:
        result: of an own condition.
        names: parameters to show.
        colors: of the contenders to show.
        space: of the filter, for scales and units.
        caption: of the figure.
    """
    assert result.time is not None
    grid: dict[str, Any] = {"nrows": len(names), "sharex": True, "squeeze": False}
    with plots.drawing(caption, 0.7 + 2.1 * len(names), **grid) as (panels, made):
        for axes, name in zip(panels[:, 0], names, strict=True):
            _panel(axes, result, name, colors, space)
        panels[-1, 0].set_xlabel("time, s")
        panels[-1, 0].set_xlim(result.time[0], result.time[-1])
        handles, shown = panels[0, 0].get_legend_handles_labels()
        regimes = result.labels[0].meta["regimes"] if result.labels else ()
        tints = itertools.islice(itertools.cycle(plots.TINTS), len(regimes))
        handles += [Patch(color=tint, alpha=0.22) for tint in tints]
        shown += [f"true regime: {name}" for name in regimes]
        panels[0, 0].legend(
            handles, shown, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, fontsize=9
        )
    return made[0]


def _panel(
    axes: Axes, result: Result, name: str, colors: Mapping[str, str], space: ParameterSpace
) -> None:
    p = space[name]
    assert result.time is not None
    for label, color in colors.items():
        values = result.chosen.get(label, {}).get(name)
        if values is not None:
            axes.plot(result.time, values, color=color, lw=1.4, label=label, drawstyle="steps-pre")
    if p.scale == "log":
        plots.plain_log(axes)
    axes.set_ylabel(f"{name}, {p.symbol}" + ("" if p.unit == "1" else f", {p.unit}"), fontsize=9)
    axes.grid(axis="y")
    if result.labels:
        plots.shade(axes, label_times(result), result.labels[0].regime, plots.TINTS)


def label_times(result: Result) -> Array:
    """When each label of the first recording holds from, s."""
    assert result.time is not None
    count = len(result.labels[0].regime)
    if count == len(result.time):
        return result.time
    found: Array = result.time[-1] - count + np.arange(float(count))
    return found
