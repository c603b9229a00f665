"""What every smoother needs (Rauch, Tung & Striebel 1965)."""

from __future__ import annotations

import numpy as np

from navgym.core.checks import Array

RIDGE = 1e-13  # of unit diagonals, before they are solved


def smoothing_gain(crossed: Array, P: Array) -> Array:
    """crossedᵀ P⁻¹, how much a state moves by what comes to light of a later one.

    Args:
        crossed: (..., p, q) covariance of the later state with this one.
        P: (..., p, p) covariance of the later state; one without variance has no gain.

    Returns (..., q, p).
    """
    sd = np.sqrt(np.diagonal(P, axis1=-2, axis2=-1))
    unit = 1.0 / np.where(sd > 0.0, sd, 1.0)
    scaled = P * unit[..., :, None] * unit[..., None, :]
    p = np.arange(P.shape[-1])
    scaled[..., p, p] += np.where(sd > 0.0, RIDGE, 1.0)
    solved = np.linalg.solve(scaled, crossed * unit[..., :, None]) * unit[..., :, None]
    found: Array = solved.swapaxes(-1, -2)
    return found
