"""Filters and readers of other packages, found by what those packages say of themselves.

A package that brings a filter, or a reader of some format, names it in its pyproject.toml, after the
problem that it is for and a dot:

    [project.entry-points."navgym.filters"]
    "auv.my_filter" = "my_package:FILTER"       # a `Plugin`

    [project.entry-points."navgym.readers"]
    "auv.my_format" = "my_package:read_it"      # a path and keyword options to a recording

Once it is installed, `my_filter` is a filter like ours: in `navgym.estimate`, studies, comparisons and
reports. What cannot be loaded is said once, and left out.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import metadata
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.core.parameters import Parameter, ParameterSpace
from navgym.problem import Filter, Problem, Run

FILTERS, READERS = "navgym.filters", "navgym.readers"
FAMILY = "plug-in"


@dataclass(frozen=True)
class Plugin:
    """A filter of one's own.

    Args:
        summary: one line for listings.
        parameters: what can be tuned.
        call: (recording, parameters by name) to columns by name, or an object with such attributes:
            `states` (T, n), and, as far as it has them, `covariances` (T, n, n), `innovations` (T, m; NaN
            where nothing was received), `nis` (T,) and `log_likelihood` (T,). Without innovations it is
            judged where the truth is known only.
        nonlinear: whether it takes any model, and not only a linear one.
    """

    summary: str
    parameters: tuple[Parameter, ...]
    call: Callable[[Any, Mapping[str, Any]], Any]
    nonlinear: bool = True


@functools.cache
def found(group: str) -> Mapping[str, Mapping[str, metadata.EntryPoint]]:
    """Entry points of a group by problem and name."""
    made: dict[str, dict[str, metadata.EntryPoint]] = {}
    for point in metadata.entry_points(group=group):
        problem, dot, name = point.name.partition(".")
        if not dot or not name:
            _say(point, "its name must be PROBLEM.NAME, such as auv.my_filter")
            continue
        made.setdefault(problem, {})[name] = point
    return made


def _say(point: metadata.EntryPoint, why: object) -> None:
    package = point.dist.name if point.dist is not None else point.value
    warnings.warn(f"{point.group}: {point.name} of {package} is left out: {why}.", stacklevel=2)


_PLUGGED: dict[int, tuple[Problem, Problem]] = {}  # by identity, with what it is of


def plugged(problem: Problem) -> Problem:
    """A problem with the filters and readers that other packages bring; itself where there are none."""
    kept = _PLUGGED.get(id(problem))
    if kept is None:
        kept = _PLUGGED[id(problem)] = (problem, _with(problem))
    return kept[1]


def _with(problem: Problem) -> Problem:
    brought = {n: p for n, p in _loaded(problem).items() if n not in problem.filters}
    readers = found(READERS).get(problem.name, {})
    if not brought and not readers:
        return problem
    filters = {name: _filter(name, plugin) for name, plugin in brought.items()}
    usual = problem.runner

    def runner(chosen: Filter, batch: Any, table: Array, interval: int, everything: bool) -> Run:
        plugin = brought.get(chosen.name) if chosen.family == FAMILY else None
        if plugin is None:
            return usual(chosen, batch, table, interval, everything)
        return _run(plugin, chosen, batch, table, everything)

    named = {name: point.value for name, point in readers.items() if name not in problem.readers}
    return replace(
        problem, filters={**problem.filters, **filters}, runner=runner,
        readers={**problem.readers, **named},
    )  # fmt: skip


def _loaded(problem: Problem) -> dict[str, Plugin]:
    made = {}
    for name, point in found(FILTERS).get(problem.name, {}).items():
        try:
            plugin = point.load()
        except Exception as error:  # somebody else's code
            _say(point, f"it cannot be imported ({type(error).__name__}: {error})")
            continue
        if not isinstance(plugin, Plugin):
            _say(point, f"it is a {type(plugin).__name__}, and no navgym.plugins.Plugin")
        elif name in problem.filters:
            _say(point, "there is a filter of that name already")
        else:
            made[name] = plugin
    return made


def _filter(name: str, plugin: Plugin) -> Filter:
    space = ParameterSpace(plugin.parameters)
    return Filter(name, plugin.summary, space, FAMILY, nonlinear=plugin.nonlinear)


def _run(plugin: Plugin, chosen: Filter, batch: Any, table: Array, everything: bool) -> Run:
    """A filter of one's own over a batch, recording by recording; one that raises has diverged.

    Raises ValueError for a schedule, for recordings that are not there, for outputs of a wrong shape.
    """
    if table.shape[1] > 1:
        raise ValueError(
            f"filter {chosen.name!r} is a plug-in, which takes one value of each parameter and no schedule."
        )
    if not batch.recordings:
        raise ValueError(
            f"filter {chosen.name!r} is a plug-in, and needs a batch that holds its recordings."
        )
    told = []
    for i, recording in enumerate(batch.recordings):
        row = table[min(i, len(table) - 1), 0]
        values = {p.name: p.show(v) for p, v in zip(chosen.space, row, strict=True)}
        try:
            told.append(_columns(plugin.call(recording, values)))
        except Exception as error:  # somebody else's code
            warnings.warn(f"{chosen.name} raised {type(error).__name__}: {error}", stacklevel=2)
            told.append({})
    shapes = _shapes(chosen.name, told, batch)
    steps = {n: batch.steps if everything or n == "states" else 0 for n in shapes}
    made = {n: np.full((len(told), steps[n], *shape), np.nan) for n, shape in shapes.items()}
    for i, columns in enumerate(told):
        for name, each in columns.items():
            length = min(int(batch.lengths[i]), steps[name])
            made[name][i, :length] = each[:length]
    inside = np.arange(batch.steps) < batch.lengths[:, None]
    lost = ~np.isfinite(made["states"]).all(axis=-1) & inside
    heard = np.isfinite(made["innovations"]).sum(axis=-1)
    return Run(
        made["states"], lost.any(axis=1), made["covariances"], made["innovations"], made["nis"],
        made["log_likelihood"], heard,
    )  # fmt: skip


NAMES = ("states", "covariances", "innovations", "nis", "log_likelihood")


def _columns(given: Any) -> dict[str, Array]:
    """What a call returned, by name."""
    take = given.get if isinstance(given, Mapping) else functools.partial(getattr, given)
    held = {name: take(name, None) for name in NAMES}
    return {n: np.asarray(each, dtype=np.float64) for n, each in held.items() if each is not None}


def _shapes(name: str, told: list[dict[str, Array]], batch: Any) -> dict[str, tuple[int, ...]]:
    """Shape of a sample of each column."""
    first = next((columns for columns in told if columns), {})
    if told and first and "states" not in first:
        raise ValueError(
            f"filter {name!r} must return states, got {', '.join(first) or 'nothing'}."
        )
    for i, columns in enumerate(told):
        for key, each in columns.items():
            if each.shape[:1] != (int(batch.lengths[i]),) or each.shape[1:] != first[key].shape[1:]:
                raise ValueError(
                    f"filter {name!r} must return {key} with a row per sample, ({int(batch.lengths[i])}, ...), "
                    f"got shape {each.shape}."
                )
    truth, measured = (
        batch.truth,
        np.asarray(getattr(batch.recordings[0], "measurements", np.empty((0, 1)))),
    )
    states = first["states"].shape[1:] if first else (1 if truth is None else truth.shape[-1],)
    return {
        "states": states, "covariances": (states[0], states[0]),
        "innovations": first["innovations"].shape[1:] if "innovations" in first else measured.shape[1:],
        "nis": (), "log_likelihood": (),
    }  # fmt: skip
