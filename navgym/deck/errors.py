"""Errors of deck filters: the four that matter, and the part of θ that gyros can see."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from navgym.core.checks import Array
from navgym.deck.batch import DeckBatch
from navgym.deck.settings import START
from navgym.inertial.flexure import ARCMIN

MEAN_SECONDS = 60.0  # what `theta_ac` takes off: slower errors are the split between Φ and θ(0)


@dataclass(frozen=True, eq=False)
class DeckErrors:
    """RMS errors over time of N runs, in arcmin (θ̇: arcmin/s); infinite where a run failed.

    Args:
        axes: (N, 3) per quantity, by axis.
        norm: (N,) per quantity: root of the mean squared length of the error vector.
    """

    axes: Mapping[str, Array]
    norm: Mapping[str, Array]


def deck_errors(
    batch: DeckBatch,
    states: Array,
    start: float = START,
    attitude: bool = True,
    span: tuple[float, float] = (0.0, 1.0),
) -> DeckErrors:
    """Errors of states (N, K, 24) over a batch, from `start` seconds on.

    Args:
        batch: recordings with truth.
        states: of the filter on each of them.
        start: s from the recording's start that are not scored.
        attitude: whether to compute attitude and static errors too, which takes longer.
        span: shares of each recording between which it is scored.

    Raises:
        ValueError: a recording lacks the truth, or is shorter than `start`.
    """
    if batch.truth is None:
        raise ValueError("errors need the truth (theta, theta_rate), which a recording lacks.")
    first = round(start / batch.step)
    if first >= batch.lengths.min():
        raise ValueError(
            f"start must leave something to score, got {start} s for a recording of "
            f"{batch.lengths.min() * batch.step:g} s."
        )
    axes: dict[str, list[Array]] = {}
    for i, length in enumerate(batch.lengths):
        begin, end = (round(share * length) for share in span)
        for name, error in run_errors(batch, i, states[i, :length], attitude).items():
            with np.errstate(invalid="ignore", over="ignore"):
                mean = np.sqrt((error[max(first, begin) : end] ** 2).mean(axis=0))
            axes.setdefault(name, []).append(np.where(np.isfinite(mean), mean, np.inf))
    stacked = {name: np.stack(rows) for name, rows in axes.items()}
    norm = {name: np.sqrt((value**2).sum(axis=1)) for name, value in stacked.items()}
    return DeckErrors(stacked, norm)


def run_errors(batch: DeckBatch, i: int, states: Array, attitude: bool = True) -> dict[str, Array]:
    """Errors over time of run i, (K, 3) each, in arcmin or arcmin/s, from states (K, 24)."""
    from navgym.deck.alignment import RATE, THETA
    from navgym.deck.estimation import attitude_error, attitudes

    tape, recording = batch.tapes[i, : len(states)], batch.recordings[i]
    theta = (states[:, THETA] - tape["theta"]) / ARCMIN
    found: dict[str, Any] = {
        "theta": theta,
        "theta_rate": (states[:, RATE] - tape["theta_rate"]) / ARCMIN,
        "theta_ac": theta - moving_mean(theta, round(MEAN_SECONDS / batch.step)),
    }
    if attitude:
        estimated, static = attitudes(tape, states)
        reference = recording.step_reference
        if reference is not None:
            found["attitude"] = attitude_error(estimated, reference)
        if recording.static is not None:
            found["static"] = (static - recording.static) / ARCMIN
    return found


def moving_mean(values: Array, count: int) -> Array:
    """Centred mean of (K, 3) over `count` samples; the ends are held beyond the record."""
    mean: Array = uniform_filter1d(values, max(count, 1), axis=0, mode="nearest")
    return mean
