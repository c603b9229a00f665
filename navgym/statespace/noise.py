"""Noise by sensor and by axis of motion: what a user knows least, as parameters of any filter.

A model names the sensor of each measurement component (`LinearModel.sensors`) and the axis of each
state (`axes`). Where there are several, the noise of each has a scale: `position_noise_scale`
multiplies the variances of the position rows of R, `vertical_process_scale` those of the states of
axis "vertical" in Q; correlations stay. They act on the model before a filter sees it, so that every
filter that believes R and Q has them, beside its own `measurement_noise_scale` for all of R.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from navgym.core.checks import Array, one_of
from navgym.core.parameters import Parameter, ParameterSpace
from navgym.statespace.filters.spaces import ANY_SCALE

if TYPE_CHECKING:
    from navgym.problem import Filter
    from navgym.statespace.batch import StateSpaceBatch
    from navgym.statespace.models import LinearModel


def space(chosen: Filter, batch: StateSpaceBatch) -> ParameterSpace:
    """The noise scales that a filter has on a batch; none where one number says all, or knows all."""
    if chosen.needs_scales:
        return ParameterSpace(())
    sensors = [
        _scale(f"{name}_noise_scale", f"{name}'s rows of R") for name in _several(batch.sensors)
    ]
    axes = [
        _scale(f"{name}_process_scale", f"{name}'s states in Q") for name in _several(batch.axes)
    ]
    return ParameterSpace((*sensors, *axes))


def believing(batch: StateSpaceBatch, scales: Array) -> StateSpaceBatch:
    """The batch whose models' R and Q are scaled.

    Args:
        batch: N recordings.
        scales: (N or 1, number of parameters of `space`), in its order.
    """
    if (scales == 1.0).all():
        return batch
    sensors, axes = _several(batch.sensors), _several(batch.axes)
    models = np.repeat(batch.models, len(scales) if len(batch.models) == 1 else 1, axis=0)
    noise, motion = np.split(scales, [len(sensors)], axis=1)
    for name, names, own, factors in (
        ("R", batch.sensors, sensors, noise),
        ("Q", batch.axes, axes, motion),
    ):
        if own:
            root = np.sqrt(factors[:, [own.index(each) for each in names]])
            models[name] *= (root[:, :, None] * root[:, None, :])[:, None]
    return replace(batch, models=models)


def scaled(model: LinearModel, scales: Mapping[str, float]) -> LinearModel:
    """The model with its noise scaled by sensor and by axis, by the names of `space`.

    Raises ValueError for a sensor or an axis that it does not have.
    """
    names = {f"{n}_noise_scale": ("R", n) for n in _several(model.sensors)}
    names |= {f"{n}_process_scale": ("Q", n) for n in _several(model.axes)}
    changed = {"R": model.R, "Q": model.Q}
    for name, factor in scales.items():
        which, own = names[one_of("noise scale", name, names)]
        members = model.sensors if which == "R" else model.axes
        root = np.sqrt(np.where(np.array(members) == own, factor, 1.0))
        changed[which] = changed[which] * (root[:, None] * root)
    return replace(model, **changed)


def _several(names: Sequence[str]) -> list[str]:
    """Distinct names in order, if there are at least two."""
    distinct = list(dict.fromkeys(names))
    return distinct if len(distinct) > 1 else []


def _scale(name: str, what: str) -> Parameter:
    return Parameter(
        name, "s", "1", 0.01, 1000.0, "log", 1.0, at_start=True, widest=ANY_SCALE,
        equation=f"multiplies {what}, correlations kept",
    )  # fmt: skip
