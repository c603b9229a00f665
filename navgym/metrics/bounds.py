"""What no filter can beat: the Riccati limit without loss, Sinopoli's bounds under loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from navgym.core.checks import Array, real_array
from navgym.metrics.errors import share
from navgym.statespace.models import LinearModel


@dataclass(frozen=True, eq=False)
class SteadyState:
    """Where the covariance of a Kalman filter settles when nothing is lost.

    Args:
        predicted: P_{k|k-1}, (n, n).
        filtered: P_{k|k}, (n, n).
        gain: (n, m).
    """

    predicted: Array
    filtered: Array
    gain: Array


def steady_state(model: LinearModel) -> SteadyState:
    """Solution of the discrete algebraic Riccati equation of a model that does not change.

    Raises ValueError if the model varies in time, or if its covariance does not settle because a
    state that does not decay is not measured.
    """
    from scipy.linalg import solve_discrete_are  # heavy, and no environment needs it

    F, H, Q, R = _constant(model)
    remedy = "measure every state that does not decay on its own (positions, not only velocities)"
    try:
        predicted = np.asarray(solve_discrete_are(F.T, H.T, Q, R), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise ValueError(f"the model's covariance does not settle ({error}): {remedy}.") from None
    gain = np.asarray(np.linalg.solve(H @ predicted @ H.T + R, H @ predicted).T, dtype=np.float64)
    closed = np.eye(model.n) - gain @ H
    if not np.abs(np.linalg.eigvals(F @ closed)).max() < 1.0:
        raise ValueError(f"the model's covariance does not settle: {remedy}.")
    filtered = closed @ predicted @ closed.T + gain @ R @ gain.T
    return SteadyState(predicted, filtered, gain)


def rms(covariance: ArrayLike, indices: Sequence[int]) -> float:
    """Root mean square error over some states that a covariance (n, n) stands for."""
    diagonal = np.diagonal(real_array("covariance", covariance))
    return float(np.sqrt(diagonal[list(indices)].sum()))


def critical_arrival_rate(model: LinearModel) -> float:
    """Share of samples that must arrive for E[P] to stay bounded: 1 − 1/ρ(F)², at least 0.

    Exact where H is invertible, else a lower bound (Sinopoli et al. 2004, theorem 3).
    """
    radius = np.abs(np.linalg.eigvals(_constant(model)[0])).max()
    return float(max(0.0, 1.0 - 1.0 / max(radius, 1.0) ** 2))


@dataclass(frozen=True, eq=False)
class LossBounds:
    """Bounds of the mean predicted covariance under loss, (n, n) each: lower ≤ E[P] ≤ upper.

    They are infinite where it grows without bound.
    """

    lower: Array
    upper: Array


def loss_bounds(model: LinearModel, arrival_rate: float) -> LossBounds:
    """Bounds of lim E[P_{k|k-1}] of a Kalman filter when samples are lost independently.

    Lower: S = (1 − λ) F S Fᵀ + Q. Upper: the fixed point of the modified Riccati equation
    V = F V Fᵀ + Q − λ F V Hᵀ (H V Hᵀ + R)⁻¹ H V Fᵀ, by iteration from V = Q.

    Args:
        model: a model that does not change.
        arrival_rate: λ, the share of samples that arrive, 0 to 1: one minus the loss rate.

    Raises:
        ValueError: a model that varies, a rate outside 0..1.
        RuntimeError: the iteration does not settle (a rate hardly above the critical one).

    Source: B. Sinopoli et al., Kalman filtering with intermittent observations, IEEE Trans.
    Automatic Control 49 (2004), theorems 3 and 4.
    """
    from scipy.linalg import solve_discrete_lyapunov  # heavy, and no environment needs it

    F, _, Q, _ = _constant(model)
    rate = share("arrival_rate", arrival_rate)
    slack = np.sqrt(1.0 - rate) * F
    if not np.abs(np.linalg.eigvals(slack)).max() < 1.0:
        unbounded = np.full_like(Q, np.inf)
        return LossBounds(unbounded, unbounded)
    return LossBounds(solve_discrete_lyapunov(slack, Q), _modified_riccati(model, rate))


def _modified_riccati(model: LinearModel, rate: float, most: int = 100_000) -> Array:
    F, H, Q, R = _constant(model)
    V = Q
    for _ in range(most):
        W = H @ V @ F.T
        after = F @ V @ F.T + Q - rate * W.T @ np.linalg.solve(H @ V @ H.T + R, W)
        after = (after + after.T) / 2.0
        if np.trace(after) > 1e15 * max(np.trace(Q), np.trace(R)):
            return np.full_like(V, np.inf)
        if np.abs(after - V).max() <= 1e-13 * np.abs(after).max():
            return after
        V = after
    raise RuntimeError(
        f"the modified Riccati iteration did not settle in {most} rounds at arrival rate {rate}: "
        f"it is too close to the critical rate, {critical_arrival_rate(model):.6g} or above."
    )


def _constant(model: LinearModel) -> tuple[Array, Array, Array, Array]:
    F, H, Q, R = (np.asarray(getattr(model, name)) for name in ("F", "H", "Q", "R"))
    if any(a.ndim != 2 for a in (F, H, Q, R)):
        raise ValueError(
            f"model must not change in time, but it has {model.steps} steps of its own."
        )
    return F, H, Q, R
