"""The noise that recordings' models believe, in numbers that do not depend on how a log is cut."""

from __future__ import annotations

from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.problem import Believed
from navgym.statespace.batch import StateSpaceBatch


def noises(batch: StateSpaceBatch) -> dict[str, Believed]:
    """Standard deviations by sensor, and root densities of process noise by axis, of the first model.

    R is told as √R_ii of each row (its median over time), Q as √(Q_ii / dt) of the velocities, or of all
    states where the model names no velocity: for white acceleration that is the acceleration.
    """
    recording = batch.recordings[0]
    model = recording.model
    step = np.asarray(np.diff(recording.time, prepend=recording.time[0] - batch.step))
    if getattr(model, "dt", None) is not None:
        step = np.asarray(model.dt, dtype=np.float64)
    moving = list(getattr(model, "velocity", ())) or range(model.n)
    deviation, density = np.sqrt(_diagonal(model.R)), np.sqrt(_rate(model.Q, step))
    found = {}
    for sensor in dict.fromkeys(batch.sensors):
        rows = [i for i, own in enumerate(batch.sensors) if own == sensor]
        scale = (
            f"{sensor}_noise_scale" if len(set(batch.sensors)) > 1 else "measurement_noise_scale"
        )
        found[f"{sensor}_noise"] = Believed(tuple(deviation[rows].tolist()), scale)
    for axis in dict.fromkeys(batch.axes):
        states = [i for i in moving if batch.axes[i] == axis]
        several = len(set(batch.axes)) > 1
        name = f"{axis}_process_density" if several else "process_density"
        scale = f"{axis}_process_scale" if several else "process_noise_scale"
        if states:
            found[name] = Believed(tuple(density[states].tolist()), scale)
    return found


def _diagonal(matrix: Any) -> Array:
    """Diagonal (m,) of a covariance, its median over time."""
    each = np.diagonal(np.asarray(matrix, dtype=np.float64), axis1=-2, axis2=-1)
    return np.asarray(np.nanmedian(each, axis=0) if each.ndim == 2 else each)


def _rate(Q: Any, step: Array) -> Array:
    """Diagonal (n,) of Q per second, its median over time."""
    each = np.diagonal(np.asarray(Q, dtype=np.float64), axis1=-2, axis2=-1)
    rate = each / (step[..., None] if step.ndim else step)
    return np.asarray(np.median(rate, axis=0) if rate.ndim == 2 else rate)
