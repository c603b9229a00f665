"""Sparse Bayesian regression: the relevance vector machine (Tipping 2001; Tipping & Faul 2003).

y(x) = Σ wᵢ K(x, xᵢ) + w₀ + noise, wᵢ ~ N(0, 1/αᵢ) (IDAM eq. 25-27, corrected). Each αᵢ is set where
the evidence p(y | α, σ²) is largest; most of them are infinite there, and what is left are the
relevance vectors. IDAM's condition of convergence (eq. 33) is an objective that Tipping (2001)
discards, since it is multimodal and has no lower bound: here the search stops when no log α moves.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from navgym.core.checks import Array, one_of, positive_int, real_array, within
from navgym.identification.kernels import fast_marginal_likelihood

_learn: Any = fast_marginal_likelihood  # typed by numba from its arguments

Kernel = Callable[[Array, Array], Any]

LARGEST_RATIO = (
    1e12  # of the variance of y over that of the noise, so that exact data end somewhere
)
FIRST = 50  # basis functions to begin with


def gaussian(x: Array, z: Array, scale: float) -> Array:
    """(N, M) exp(−|x − z|² / scale²), for x (N, D) and z (M, D); `scale` as in Tipping (2001)."""
    squared = sum((x[:, None, d] - z[None, :, d]) ** 2 for d in range(x.shape[1]))
    return np.asarray(np.exp(-squared / scale**2))


def spline(x: Array, z: Array) -> Array:
    """(N, M) linear spline kernel (Tipping 2001, eq. 52), a product over dimensions."""
    a, b = x[:, None, :], z[None, :, :]
    low = np.minimum(a, b)
    value = 1.0 + a * b + a * b * low - (a + b) / 2.0 * low**2 + low**3 / 3.0
    return np.asarray(np.prod(value, axis=-1))


class RVM:
    """Sparse Bayesian regression; `fit` sets the attributes.

    Args:
        kernel: "gaussian"; "spline"; "precomputed" (x is the design matrix, (N, M)); or a function
            of (N, D) and (M, D) points that returns (N, M).
        scale: of the Gaussian kernel, in the unit of x.
        bias: whether to add a constant to the basis.
        noise: standard deviation of the noise, in the unit of y; None estimates it.
        tolerance: of |Δ log α| at the end.
        limit: of steps; each adds, re-estimates or deletes one basis function.

    Attributes:
        relevance: (m,) indices of the relevance vectors, rising.
        weights: (m,) their posterior mean weights.
        intercept: posterior mean of the constant; 0 without one.
        covariance: posterior covariance of the weights; (m, m), or (m+1, m+1) where the constant
            is relevant too, then in the last row and column.
        alpha: prior precisions in the order of `covariance`.
        sigma: standard deviation of the noise.
        evidence: log p(y | α, σ²).
        trace: (iterations,) the log evidence after each step.
        iterations: number of steps.
        converged: whether the last step changed nothing.

    Raises:
        ValueError: an option or data that cannot be used.
    """

    relevance: Any
    weights: Array
    intercept: float
    covariance: Array
    alpha: Array
    sigma: float
    evidence: float
    trace: Array
    iterations: int
    converged: bool

    def __init__(
        self,
        kernel: str | Kernel = "gaussian",
        *,
        scale: float = 1.0,
        bias: bool = False,
        noise: float | None = None,
        tolerance: float = 1e-3,
        limit: int = 10_000,
    ) -> None:
        if not callable(kernel):
            one_of("kernel", kernel, ("gaussian", "spline", "precomputed"))
        self.kernel, self.bias = kernel, bias
        self.scale = within("scale", scale, 0.0, above=True)
        self.noise = None if noise is None else within("noise", noise, 0.0, above=True)
        self.tolerance = within("tolerance", tolerance, 0.0, above=True)
        self.limit = positive_int("limit", limit)

    def fit(self, x: ArrayLike, y: ArrayLike) -> RVM:
        """Learn from points x, (N,) or (N, D), with targets y (N,); returns the machine itself."""
        points, targets = self._points(x), real_array("y", y)
        if targets.shape != points.shape[:1] or len(targets) < 2:
            raise ValueError(
                f"y must hold one number per row of x, {len(points)}, and at least 2, "
                f"got shape {targets.shape}."
            )
        design = self._design(points, points)
        if self.bias:
            design = np.column_stack((design, np.ones(len(points))))
        length = np.sqrt(np.einsum("nm,nm->m", design, design))
        length[length == 0.0] = 1.0  # a function that is zero everywhere never becomes relevant
        design = np.ascontiguousarray(design / length)
        unit = float(np.abs(targets).max()) or 1.0  # keeps tiny targets away from underflow
        spread = max(float(np.var(targets / unit)), 1e-12)
        found = _learn(
            np.ascontiguousarray(design.T), design, targets / unit, self._first(*design.shape),
            100.0 / spread if self.noise is None else (unit / self.noise) ** 2,
            self.noise is None, LARGEST_RATIO / spread, self.tolerance, self.limit,
        )  # fmt: skip
        self._keep(points, length / unit, unit, *found)
        return self

    def _keep(
        self, points: Array, length: Array, unit: float, active: Any, alpha: Array, mean: Array,
        U: Array, beta: float, trace: Array, converged: bool,
    ) -> None:  # fmt: skip
        """Sort the kernel's answer and return to the units of the data."""
        order = np.argsort(active)  # the constant has the last index
        active, U = active[order], U[:, order]
        weights = mean[order] / length[active]
        constant = self.bias and len(active) > 0 and active[-1] == len(length) - 1
        self.relevance = active[:-1] if constant else active
        self.weights = weights[:-1] if constant else weights
        self.intercept = float(weights[-1]) if constant else 0.0
        self.covariance = (U.T @ U) / np.outer(length[active], length[active])
        self.alpha = alpha[order] * length[active] ** 2
        self.sigma = unit / np.sqrt(beta)
        self.trace = trace - len(points) * np.log(unit)  # density per unit of y
        self.evidence = float(self.trace[-1])
        self.iterations, self.converged = len(trace), bool(converged)
        self._constant = bool(constant)
        self._vectors = None if self.kernel == "precomputed" else points[self.relevance]

    @overload
    def predict(self, x: ArrayLike, deviation: Literal[False] = False) -> Array: ...

    @overload
    def predict(self, x: ArrayLike, deviation: Literal[True]) -> tuple[Array, Array]: ...

    def predict(self, x: ArrayLike, deviation: bool = False) -> Array | tuple[Array, Array]:
        """Mean of y at points x, (N,); with `deviation` also its standard deviation, noise included.

        Raises:
            RuntimeError: before `fit`.
        """
        if not hasattr(self, "weights"):
            raise RuntimeError("this RVM has learnt nothing yet: call fit(x, y) first.")
        points = self._points(x)
        if self._vectors is None:
            design = points[:, self.relevance]
        else:
            design = self._design(points, self._vectors)
        mean: Array = design @ self.weights + self.intercept
        if not deviation:
            return mean
        if self._constant:
            design = np.column_stack((design, np.ones(len(points))))
        variance = np.einsum("ni,ij,nj->n", design, self.covariance, design)
        return mean, np.sqrt(variance + self.sigma**2)

    @staticmethod
    def _first(points: int, functions: int) -> Any:
        """Indices of basis functions, evenly spread, to begin with; the constant is one of them."""
        count = min(points, functions, FIRST)
        return np.round(np.linspace(0, functions - 1, count)).astype(np.int64)

    def _points(self, x: ArrayLike) -> Array:
        points = real_array("x", x)
        points = points[:, None] if points.ndim == 1 else points
        if points.ndim != 2 or len(points) == 0:
            raise ValueError(f"x must have shape (N,) or (N, D), got {points.shape}.")
        return points

    def _design(self, x: Array, z: Array) -> Array:
        if self.kernel == "precomputed":
            return x
        if self.kernel == "gaussian":
            return gaussian(x, z, self.scale)
        if self.kernel == "spline":
            return spline(x, z)
        assert callable(self.kernel)
        value = real_array("kernel(x, z)", self.kernel(x, z))
        if value.shape != (len(x), len(z)):
            raise ValueError(
                f"kernel(x, z) must return shape {(len(x), len(z))}, got {value.shape}."
            )
        return value
