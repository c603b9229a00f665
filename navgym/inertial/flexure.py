"""The flexure model: a second-order Markov process per axis (IDAM eq. 2-3, corrected).

θ̈ + 2μ θ̇ + b² θ = w, with std(θ) = σ in the long run. It is kept as (2μ, b², σ), which stays
regular for oscillating, critically damped and overdamped axes alike; λ² = b² − μ² may have any
sign.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from navgym.core.checks import Array, real_array
from navgym.core.frozen import Frozen

ARCMIN = np.pi / (180.0 * 60.0)  # rad; frozen into kernels
CRITICAL = 2.146  # solves (1 + x) e⁻ˣ = 1/e: β τ of a critically damped axis (IDAM eq. 3)


@dataclass(frozen=True, eq=False)
class FlexureModel(Frozen):
    """Parameters of the deck's dynamic deformation, three axes.

    Args:
        damping: (3,) 2μ, 1/s.
        stiffness: (3,) b², 1/s².
        sigma: (3,) long-run standard deviation of θ, rad.
        deviation: (3, 3) standard deviations of ln damping, ln stiffness and ln sigma (columns)
            per axis (rows), where an identification knows them; else None.
        evidence: (3,) log evidence of the identification, where it has one; else None.
        diagnostics: what else an identification has to tell; arrays and numbers by name.

    Raises:
        ValueError: a value that is not positive and finite.
    """

    damping: Any
    stiffness: Any
    sigma: Any
    deviation: Any = None
    evidence: Any = None
    diagnostics: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        arrays: dict[str, Any] = {}
        for name in ("damping", "stiffness", "sigma"):
            value = real_array(name, getattr(self, name))
            value = np.repeat(value, 3) if value.shape in ((), (1,)) else value
            if value.shape != (3,):
                raise ValueError(f"{name} must be a number or one per axis, got {value.shape}.")
            if (value <= 0.0).any():
                raise ValueError(f"{name} must be positive on every axis, got {value}.")
            arrays[name] = value
        for name, shape in (("deviation", (3, 3)), ("evidence", (3,))):
            if getattr(self, name) is not None:
                arrays[name] = real_array(name, getattr(self, name), finite=False).reshape(shape)
        self._freeze(arrays | {"diagnostics": dict(self.diagnostics)})

    @classmethod
    def from_correlation_time(
        cls, tau: ArrayLike, sigma: ArrayLike, oscillation: ArrayLike = 0.0
    ) -> FlexureModel:
        """The model of IDAM section 5: b = 2.146/τ, λ = `oscillation` · μ, so μ = b/√(1 + (λ/μ)²).

        Args:
            tau: (3,) s, time in which the correlation of a critically damped axis falls to 1/e.
            sigma: (3,) rad.
            oscillation: λ/μ, or (3,) of them; 0 is critical damping, more than 0 oscillates.
        """
        b = CRITICAL / real_array("tau", tau)
        mu = b / np.sqrt(1.0 + real_array("oscillation", oscillation) ** 2)
        return cls(2.0 * mu, b**2, sigma)

    @property
    def frequency_squared(self) -> Array:
        """(3,) λ² = b² − μ², 1/s²; negative for an overdamped axis."""
        value: Array = self.stiffness - (self.damping / 2.0) ** 2
        return value

    @property
    def rate_sigma(self) -> Array:
        """(3,) long-run standard deviation of θ̇, rad/s: b σ."""
        value: Array = np.sqrt(self.stiffness) * self.sigma
        return value

    @property
    def noise_density(self) -> Array:
        """(3,) spectral density of w, rad²/s³: q = 4 μ b² σ² (IDAM eq. 3, corrected)."""
        value: Array = 2.0 * self.damping * self.stiffness * self.sigma**2
        return value

    def transition(self, dt: float) -> Array:
        """(3, 2, 2) exact transition of (θ, θ̇) over `dt` s (replaces IDAM eq. 80)."""
        mu = self.damping / 2.0
        c, s = _decaying(mu, self.stiffness, dt)
        phi = np.empty((3, 2, 2))
        phi[:, 0, 0] = c + mu * s
        phi[:, 0, 1] = s
        phi[:, 1, 0] = -self.stiffness * s
        phi[:, 1, 1] = c - mu * s
        return phi

    def stationary(self) -> Array:
        """(3, 2, 2) long-run covariance of (θ, θ̇): diag(σ², b²σ²)."""
        P = np.zeros((3, 2, 2))
        P[:, 0, 0], P[:, 1, 1] = self.sigma**2, self.rate_sigma**2
        return P

    def process_noise(self, dt: float) -> Array:
        """(3, 2, 2) exact covariance of what `dt` s add to (θ, θ̇).

        P∞ − Φ P∞ Φᵀ, for short steps in a form without cancellation: the integral of
        q [s; ṡ][s; ṡ]ᵀ by Gauss-Legendre quadrature, exact to rounding where a step resolves the
        process.
        """
        nodes, weights = np.polynomial.legendre.leggauss(12)
        Q = np.zeros((3, 2, 2))
        for x, w in zip(nodes, weights, strict=True):
            g = self.transition(dt * (x + 1.0) / 2.0)[:, :, 1]
            Q += w * dt / 2.0 * g[:, :, None] * g[:, None, :]
        F, P = self.transition(dt), self.stationary()
        long = np.maximum(self.damping, np.sqrt(self.stiffness)) * dt > 1.0
        result: Array = np.where(
            long[:, None, None],
            P - F @ P @ np.swapaxes(F, 1, 2),
            Q * self.noise_density[:, None, None],
        )
        return result

    def autocorrelation(self, lag: ArrayLike) -> Array:
        """(..., 3) R_θ(|lag|), rad² (IDAM eq. 17, corrected: R(0) = σ²)."""
        t = np.abs(real_array("lag", lag))[..., None]
        mu = self.damping / 2.0
        c, s = _decaying(mu, self.stiffness, t)
        value: Array = self.sigma**2 * (c + mu * s)
        return value

    def increment_autocorrelation(self, lag: ArrayLike, t0: float) -> Array:
        """(..., 3) autocorrelation of θ(t) − θ(t − t0), rad² (IDAM eq. 20)."""
        lag = real_array("lag", lag)
        R = self.autocorrelation
        value: Array = 2.0 * R(lag) - R(lag - t0) - R(lag + t0)
        return value

    def split_deviation(self, time: ArrayLike) -> Array:
        """(..., 3) rad, least standard deviation of the split between Φ and θ(0) after `time` s.

        σ/√(1 + βt/4) with β = b: gyros see θ(t) − θ(0) only; the constant between Φ and θ(0)
        follows from the model alone, and that is the limit of every estimate of θ.
        """
        t = real_array("time", time)[..., None]
        value: Array = self.sigma / np.sqrt(1.0 + np.sqrt(self.stiffness) * t / 4.0)
        return value


def _decaying(mu: Array, stiffness: Array, t: Any) -> tuple[Array, Array]:
    """e^−μt cos(λt) and e^−μt sin(λt)/λ, continued analytically to λ² ≤ 0.

    An overdamped axis is the difference of two decays, of which the slow one, at b²/(μ + |λ|),
    outlives e^−μt by far.
    """
    frequency_squared = stiffness - mu**2
    root = np.sqrt(np.abs(frequency_squared))
    x, decay = root * t, np.exp(-mu * t)
    safe = np.where(root > 0.0, root, 1.0)
    slow, fast = np.exp(-stiffness / (mu + root) * t), np.exp(-(mu + root) * t)
    waves = frequency_squared > 0.0
    c = np.where(waves, decay * np.cos(x), (slow + fast) / 2.0)
    s = np.where(waves, decay * np.sin(x) / safe, (slow - fast) / 2.0 / safe)
    near = decay * t * (1.0 - np.sign(frequency_squared) * x**2 / 6.0)
    return c, np.where(x > 1e-4, s, near)
