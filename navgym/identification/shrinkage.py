"""Shrinkage of an identified model toward what was believed before."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from navgym.core.checks import Array, real_array, within
from navgym.inertial.flexure import FlexureModel


def shrink(
    model: FlexureModel,
    prior: FlexureModel,
    spread: ArrayLike | None = None,
    sampling: float = 0.0,
) -> FlexureModel:
    """Weigh an identified model and a prior one by their precisions, in logarithms.

    A trailing window of a minute or two alone does worse than no identification at all: its
    sampling error exceeds what the sea changes. With m and p the logarithms of (2μ, b², σ), C the
    covariance of m and S that of p, the answer is (C⁻¹ + S⁻¹)⁻¹ (C⁻¹ m + S⁻¹ p) per axis.

    Args:
        model: identified; its `deviation` (or `diagnostics["covariance"]`, which also knows that
            errors of b and σ offset each other) says how well.
        prior: believed before, such as the identification of a longer record.
        spread: how far the truth may be from the prior, as standard deviations of (ln 2μ, ln b²,
            ln σ): a number, (3,), or (3, 3) with an axis per row; by default `prior.deviation`.
        sampling: multiple of the sampling limit of (ln 2μ, ln b², ln σ) under the prior,
            (2, 2, 1)/√(bW) for a record of W seconds, to add to the model's own deviation. A fit that
            went wrong claims a certainty that is wrong too; this one does not depend on it.

    Returns:
        The model between both, with its `deviation` and `diagnostics["covariance"]`.

    Raises:
        ValueError: no deviation, or a spread that is not positive.
    """
    believed = _spread(prior, spread)
    own = _covariance(model) + _limit(model, prior, within("sampling", sampling, 0.0))
    m, p = _logarithms(model), _logarithms(prior)
    posterior = np.empty((3, 3, 3))
    mean = np.empty((3, 3))
    for axis in range(3):
        S = np.diag(believed[axis] ** 2)
        gain = np.linalg.solve(S + own[axis], S).T  # S (S + C)⁻¹: no inverse of a singular C
        mean[axis] = p[axis] + gain @ (m[axis] - p[axis])
        rest = np.eye(3) - gain
        posterior[axis] = rest @ S @ rest.T + gain @ own[axis] @ gain.T
    damping, stiffness, sigma = np.exp(mean).T
    return FlexureModel(
        damping, stiffness, sigma,
        deviation=np.sqrt(np.einsum("aii->ai", posterior)),
        evidence=model.evidence,
        diagnostics={**model.diagnostics, "covariance": posterior},
    )  # fmt: skip


def _limit(model: FlexureModel, prior: FlexureModel, multiple: float) -> Array:
    """(3, 3, 3) covariance of the sampling limit under the prior, times `multiple` squared."""
    if multiple == 0.0:
        return np.zeros((3, 3, 3))
    if "duration" not in model.diagnostics:
        raise ValueError("sampling needs a model that `identify` made: its record has a duration.")
    limit = 1.0 / np.sqrt(np.sqrt(prior.stiffness) * model.diagnostics["duration"])
    each = multiple * limit[:, None] * np.array([2.0, 2.0, 1.0])
    return np.asarray(each[:, :, None] * each[:, None, :] * np.eye(3))


def _logarithms(model: FlexureModel) -> Array:
    """(3, 3) ln 2μ, ln b², ln σ (columns) per axis (rows)."""
    return np.asarray(np.log(np.column_stack((model.damping, model.stiffness, model.sigma))))


def _spread(prior: FlexureModel, spread: ArrayLike | None) -> Array:
    if spread is None and prior.deviation is None:
        raise ValueError("spread must be given where the prior has no deviation, for example 0.5.")
    given = real_array("spread", prior.deviation if spread is None else spread)
    if given.shape not in {(), (3,), (3, 3)} or (given <= 0.0).any():
        raise ValueError(
            f"spread must be positive: a number, (3,) or (3, 3), got {np.array(spread)!r}."
        )
    return np.broadcast_to(given, (3, 3))


def _covariance(model: FlexureModel) -> Array:
    """(3, 3, 3) of the logarithms, per axis."""
    if "covariance" in model.diagnostics:
        return np.asarray(model.diagnostics["covariance"], dtype=float)
    if model.deviation is None:
        raise ValueError(
            "model must have a deviation, as identified models do: give FlexureModel one."
        )
    return np.asarray(np.stack([np.diag(row**2) for row in model.deviation]))
