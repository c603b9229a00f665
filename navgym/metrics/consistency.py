"""Whether a filter's covariance tells the truth: NIS and NEES against their chi-square laws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navgym.core.checks import Array, real_array
from navgym.metrics.errors import share


def degrees_of_freedom(lost: ArrayLike) -> NDArray[np.int64]:
    """Degrees of freedom of each sample's NIS: how many components were received, (..., T)."""
    received = np.logical_not(np.asarray(lost, dtype=np.bool_))
    return np.asarray(received.sum(axis=-1), dtype=np.int64)


def nees(
    states: ArrayLike,
    covariances: ArrayLike,
    truth: ArrayLike,
    indices: Sequence[int] | None = None,
) -> Array:
    """Normalised estimation error squared, eᵀ P⁻¹ e, (..., T).

    For a filter whose model is right it is chi-square with as many degrees of freedom as states.
    Its values are correlated in time: average over runs at one time, not along one run.

    Args:
        states: (..., T, n) estimates.
        covariances: (..., T, n, n).
        truth: (..., T, n); NaN marks samples that are not scored.
        indices: some of the states; all by default.

    Returns NaN where nothing is scored or the filter failed.
    """
    x, true = real_array("states", states, finite=False), real_array("truth", truth, finite=False)
    P = real_array("covariances", covariances, finite=False)
    if P.shape != (*x.shape, x.shape[-1]) or true.shape != x.shape:
        raise ValueError(
            "states (..., T, n), covariances (..., T, n, n) and truth (..., T, n) must match, got "
            f"{x.shape}, {P.shape} and {true.shape}."
        )
    chosen = np.arange(x.shape[-1]) if indices is None else np.asarray(indices)
    e, P = (x - true)[..., chosen], P[..., chosen[:, None], chosen]
    known = np.isfinite(e).all(axis=-1) & np.isfinite(P).all(axis=(-2, -1))
    found = np.full(known.shape, np.nan)
    e = e[known]
    try:
        weighted = np.linalg.solve(P[known], e[..., None])[..., 0]
    except np.linalg.LinAlgError:
        raise ValueError(
            "covariances must be positive definite over the chosen states, but one is singular: "
            "name the uncertain states with indices=."
        ) from None
    found[known] = (e * weighted).sum(axis=-1)
    return found


def nis_band(dof: ArrayLike, confidence: float = 0.95) -> tuple[Array, Array]:
    """Band that holds `confidence` of a sample's NIS (or NEES) if the model is right.

    Args:
        dof: degrees of freedom of each sample, any shape; NaN bounds where 0.
        confidence: share inside, half of the rest on each side.

    Returns the lower and the upper bounds, of the shape of `dof`.
    """
    from scipy import stats  # heavy, and no environment needs it

    k = real_array("dof", dof)
    tail = (1.0 - share("confidence", confidence)) / 2.0
    if (k < 0.0).any():
        raise ValueError(f"dof must be at least 0, got {k.min()}.")
    k = np.where(k > 0.0, k, np.nan)
    return np.asarray(stats.chi2.ppf(tail, k)), np.asarray(stats.chi2.isf(tail, k))


def mean_nis_band(
    dof: ArrayLike, confidence: float = 0.95, axis: int | None = None
) -> tuple[Array, Array]:
    """Band of the mean of independent NIS over `axis` (None: over all).

    A sum of chi-squares is chi-square with the sum of their degrees of freedom, which takes in
    samples with lost components; samples without any (0) are left out of the mean.
    """
    k = real_array("dof", dof)
    count = np.where((k > 0.0).any(axis=axis), (k > 0.0).sum(axis=axis), np.nan)
    low, high = nis_band(k.sum(axis=axis), confidence)
    return low / count, high / count


@dataclass(frozen=True)
class Consistency:
    """Whether a filter's covariance tells the truth.

    Args:
        samples: how many NIS (or NEES) were judged.
        mean: their mean.
        low: lower end of the band in which the mean of as many independent ones lies.
        high: its upper end.
        inside: share of samples inside their own band; `confidence` of them is right.
    """

    samples: int
    mean: float
    low: float
    high: float
    inside: float

    @property
    def consistent(self) -> bool:
        """Whether the mean lies in its band: above it the filter is overconfident."""
        return self.low <= self.mean <= self.high


def consistency(nis: ArrayLike, dof: ArrayLike, confidence: float = 0.95) -> Consistency:
    """Judge normalised squares by their chi-square laws.

    Args:
        nis: NIS of any shape (or NEES at one time over runs); NaN where nothing was received.
        dof: degrees of freedom of each, or one number for all; see `degrees_of_freedom`.
        confidence: of both bands.

    Raises ValueError if there is nothing to judge.
    """
    values = real_array("nis", nis, finite=False)
    k = np.broadcast_to(real_array("dof", dof), values.shape)
    judged = ~np.isnan(values) & (k > 0)
    if not judged.any():
        raise ValueError("nis holds no sample with degrees of freedom: nothing was received.")
    values, k = values[judged], k[judged]
    (low, high), (floor, ceiling) = mean_nis_band(k, confidence), nis_band(k, confidence)
    inside = (floor <= values) & (values <= ceiling)
    return Consistency(
        len(values), float(values.mean()), float(low), float(high), float(inside.mean())
    )


def per_degree(
    squares: ArrayLike, dof: ArrayLike, confidence: float = 0.95, independent: float | None = None
) -> Consistency:
    """Judge NIS or NEES per degree of freedom: the mean is 1 for a covariance that tells the truth.

    Args:
        squares: NIS or NEES of any shape; NaN where there is nothing to judge.
        dof: degrees of freedom of each.
        confidence: of both bands.
        independent: how many of all degrees of freedom are independent; all of them by default. Errors
            of estimates are correlated in time, so for NEES count those of one moment.

    Raises ValueError if there is nothing to judge.
    """
    found = consistency(squares, dof, confidence)
    values = real_array("squares", squares, finite=False)
    k = np.broadcast_to(real_array("dof", dof), values.shape)
    judged = ~np.isnan(values) & (k > 0)
    total = float(k[judged].sum())
    free = total if independent is None else independent
    low, high = nis_band(free, confidence)
    return Consistency(
        found.samples,
        float(values[judged].sum() / total),
        float(low / free),
        float(high / free),
        found.inside,
    )
