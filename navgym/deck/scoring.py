"""What a deck's estimates are judged by: deformation, its rate, and attitude."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.deck.alignment import FLEXING
from navgym.deck.batch import DeckBatch
from navgym.deck.errors import deck_errors, run_errors
from navgym.deck.settings import START
from navgym.inertial.flexure import ARCMIN
from navgym.metrics.consistency import nees as normalised
from navgym.problem import Believed, Run, Span


def errors(batch: DeckBatch, states: Array, names: Sequence[str], span: Span) -> dict[str, Array]:
    """RMSE of θ̇, of the fast part of θ, of θ and of the attitude, by name; see `Scoring.errors`.

    The alignment, up to `START`, is left out.
    """
    norm = deck_errors(batch, states, attitude="attitude" in names, span=span).norm
    return {name: norm[name] for name in names}


def squared(batch: DeckBatch, states: Array, name: str, span: Span) -> Array:
    """Squared lengths of errors over time (N, K), arcmin² (of θ̇: (arcmin/s)²), alignment and all."""
    found = np.full(states.shape[:2], np.nan)
    for i, length in enumerate(batch.lengths):
        error = run_errors(batch, i, states[i, :length], name == "attitude")[name]
        begin, end = (round(share * length) for share in span)
        found[i, begin:end] = (error[begin:end] ** 2).sum(axis=1)
    return found


def scored(batch: DeckBatch, span: Span) -> NDArray[np.bool_]:
    """Which steps' innovations (N, K) are judged: within the span, the alignment left out.

    Raises ValueError for a recording that is shorter than that.
    """
    begin = round(START / batch.step)
    first, last = (np.array([round(share * n) for n in batch.lengths]) for share in span)
    first = np.maximum(first, begin)
    for low, high in zip(first, last, strict=True):
        if low >= high:
            raise ValueError(
                f"recordings must be longer than the {START:g} s that are not scored, got "
                f"{high * batch.step:g} s."
            )
    k = np.arange(batch.steps)
    inside: NDArray[np.bool_] = (k >= first[:, None]) & (k < last[:, None])
    return inside


def nees(batch: DeckBatch, run: Run) -> Array:
    """Normalised error squared of θ and θ̇ per degree of freedom, (N, K)."""
    truth = batch.truth
    assert truth is not None
    own, P = run.states[..., FLEXING], run.covariances[..., FLEXING, FLEXING]
    found: Array = normalised(own, P, truth) / truth.shape[-1]
    return found


def rows(batch: DeckBatch) -> dict[str, Array]:
    """Innovations (N, 6) of the matched rates, ′/s; see `Scoring.rows`.

    The first three rows match velocities: what they foretell is the lever arm more than the deck.
    """
    factors = np.zeros((len(batch), 6))
    factors[:, 3:] = 1.0 / ARCMIN
    return {"rates": factors}


def noises(batch: DeckBatch) -> dict[str, Believed]:
    """Root densities of the believed flexure's noise by axis, rad/s²/√Hz; see `Problem.noises`."""
    density = batch.recordings[0].model.flexure.noise_density
    deviations = tuple(np.sqrt(density).tolist())
    return {"flexure_density": Believed(deviations, "process_noise_scale")}
