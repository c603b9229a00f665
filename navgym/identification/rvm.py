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

FINEST = 1e6  # max |y| over the noise: with more, α drowns in the rounding of Σ⁻¹ = βΦᵀΦ + A
ROUNDING = 1e-14  # what a mean leaves of a column that does not vary, as a share of its size
WIDEST = 1e140  # largest |y| whose square and its inverse are numbers
FIRST = 50  # basis functions to begin with


def gaussian(x: Array, z: Array, scale: float) -> Array:
    """(N, M) exp(−|x − z|² / scale²), for x (N, D) and z (M, D); `scale` as in Tipping (2001)."""
    first, *others = (_squares(a, b, scale) for a, b in zip(x.T, z.T, strict=True))
    for squares in others:
        first += squares
    np.negative(first, out=first)
    return np.asarray(np.exp(first, out=first))


def _squares(a: Array, b: Array, scale: float) -> Array:
    """(N, M) squared distances in one dimension.

    In place: to have a new page of memory takes longer than to fill it.
    """
    distance = np.subtract.outer(a, b)
    distance /= scale
    distance *= distance
    return distance


def spline(x: Array, z: Array) -> Array:
    """(N, M) linear spline kernel (Tipping 2001, eq. 52), a product over dimensions."""
    a, b = x[:, None, :], z[None, :, :]
    low = np.minimum(a, b)
    value = 1.0 + a * b + a * b * low - (a + b) / 2.0 * low**2 + low**3 / 3.0
    return np.asarray(np.prod(value, axis=-1))


class RVM:
    """Sparse Bayesian regression; `fit` sets the attributes.

    The constant w₀ has no prior: it is integrated out, so that an offset of the targets moves the
    intercept and nothing else, however large it is.

    Args:
        kernel: "gaussian"; "spline"; "precomputed" (x is the design matrix, (N, M)); or a function
            of (N, D) and (M, D) points that returns (N, M).
        scale: of the Gaussian kernel, in the unit of x.
        bias: whether there is a constant w₀; without one, targets are taken to be 0 far from the
            relevance vectors.
        noise: standard deviation of the noise, in the unit of y; None estimates it. At least a
            millionth of the largest target (less its mean, with a constant): see `sigma`.
        tolerance: of |Δ log α| at the end.
        limit: of steps; each adds, re-estimates or deletes one basis function.

    Attributes:
        relevance: (m,) indices of the relevance vectors, rising.
        weights: (m,) their posterior mean weights.
        intercept: posterior mean of the constant; 0 without one.
        covariance: posterior covariance of the weights, (m, m); with a constant (m+1, m+1), the
            constant in the last row and column.
        alpha: (m,) prior precisions of the weights.
        sigma: standard deviation of the noise.
        evidence: log p(y | α, σ²); with a constant, that of the density over which the constant is
            integrated, ∫ p(y | w₀, α, σ²) dw₀.
        trace: (iterations,) the log evidence after each step.
        iterations: number of steps.
        converged: whether the last step changed nothing, or hundreds of them raised the evidence by
            nothing to speak of; False where `limit` came first.

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
        bias: bool = True,
        noise: float | None = None,
        tolerance: float = 1e-3,
        limit: int = 10_000,
    ) -> None:
        if not callable(kernel):
            one_of("kernel", kernel, ("gaussian", "spline", "precomputed"))
        self.kernel, self.bias = kernel, bool(bias)
        self.scale = within("scale", scale, 0.0, above=True)
        self.noise = None if noise is None else within("noise", noise, 0.0, above=True)
        self.tolerance = within("tolerance", tolerance, 0.0, above=True)
        self.limit = positive_int("limit", limit)

    def fit(self, x: ArrayLike, y: ArrayLike) -> RVM:
        """Learn from points x, (N,) or (N, D), with targets y (N,); returns the machine itself."""
        points, targets = self._points(x), _numbers("y", y)
        if targets.shape != points.shape[:1] or len(targets) < 2:
            raise ValueError(
                f"y must hold one number per row of x, {len(points)}, and at least 2, "
                f"got shape {targets.shape}."
            )
        design, means = self._centred(self._design(points, points))
        length = np.sqrt(np.einsum("nm,nm->m", design, design))
        length[length == 0.0] = 1.0  # a function that is zero everywhere never becomes relevant
        design /= length
        unit, targets, mean = self._relative(targets)
        free = len(points) - self.bias
        found = _learn(
            np.ascontiguousarray(design), targets, free, self._first(free, design.shape[1]),
            self._precision(targets, unit), self.noise is None, FINEST**2, self.tolerance,
            self.limit,
        )  # fmt: skip
        self._keep(points, length / unit, unit, *found)
        self._anchor(len(points), means, mean)
        return self

    def _precision(self, targets: Array, unit: float) -> float:
        """1/σ² of the noise that is given, or where learning starts, in units of 1/unit²."""
        if self.noise is not None:
            return min(unit / self.noise, FINEST) ** 2
        return min(100.0 / max(float(np.var(targets)), 1e-300), FINEST**2)

    def _centred(self, values: Array) -> tuple[Array, Array]:
        """Columns less their means, and the means; as they are, and zeros, without a constant.

        What rounding leaves of a column that does not vary is taken for zero: it would pass for a
        function, or for a target.
        """
        if not self.bias:
            return values, np.zeros(values.shape[1])
        means = values.mean(axis=0)
        rest = values - means
        rest[:, np.abs(rest).max(axis=0) <= ROUNDING * np.abs(values).max(axis=0)] = 0.0
        return rest, means

    def _relative(self, y: Array) -> tuple[float, Array, float]:
        """A unit, the targets less their mean in it, and their mean in that of the data.

        In units of their own, tiny targets don't underflow and huge ones don't overflow.
        """
        largest = float(np.abs(y).max()) or 1.0
        if not 1.0 / WIDEST <= largest <= WIDEST:
            raise ValueError(
                f"y must have a largest magnitude of 0 or in {1 / WIDEST:g}..{WIDEST:g}, got "
                f"{largest:g}: give it in another unit."
            )
        rest, means = self._centred((y / largest)[:, None])
        unit = float(np.abs(rest).max()) or 1.0
        return largest * unit, rest[:, 0] / unit, largest * float(means[0])

    def _keep(
        self, points: Array, length: Array, unit: float, active: Any, alpha: Array, mean: Array,
        U: Array, beta: float, trace: Array, converged: bool,
    ) -> None:  # fmt: skip
        """Sort the kernel's answer and return to the units of the data."""
        order = np.argsort(active)
        self.relevance = active[order]
        own = length[self.relevance]
        self.weights, U = mean[order] / own, U[:, order] / own
        self._within = U.T @ U
        self.alpha = alpha[order] * own**2
        self.sigma = float(unit / np.sqrt(beta))
        self.trace = trace - (len(points) - self.bias) * np.log(unit)  # density per unit of y
        self.iterations, self.converged = len(trace), bool(converged)
        self._points_of_fit = points.shape
        self._vectors = None if self.kernel == "precomputed" else points[self.relevance]

    def _anchor(self, count: int, means: Array, mean: float) -> None:
        """Add the constant: it goes through the means of the targets and of the functions."""
        self._means, self._mean = means[self.relevance], mean
        self.intercept = float(mean - self._means @ self.weights)
        self.covariance = self._within
        if self.bias:
            self.trace = self.trace - 0.5 * np.log(count)  # of the integral over the constant
            across = -self._within @ self._means
            own = self.sigma**2 / count - across @ self._means
            self.covariance = np.block([[self._within, across[:, None]], [across, own]])
        self.evidence = float(self.trace[-1])

    @overload
    def predict(self, x: ArrayLike, deviation: Literal[False] = False) -> Array: ...

    @overload
    def predict(self, x: ArrayLike, deviation: Literal[True]) -> tuple[Array, Array]: ...

    def predict(self, x: ArrayLike, deviation: bool = False) -> Array | tuple[Array, Array]:
        """Mean of y at points x, (N,); with `deviation` also its standard deviation, noise included.

        Raises:
            RuntimeError: before `fit`.
            ValueError: points of another dimension than those of `fit`, or not finite.
        """
        if not hasattr(self, "weights"):
            raise RuntimeError("this RVM has learnt nothing yet: call fit(x, y) first.")
        design = self._functions(self._points(x)) - self._means
        mean: Array = design @ self.weights + self._mean
        if not deviation:
            return mean
        constant = self.sigma**2 / self._points_of_fit[0] if self.bias else 0.0
        variance = np.einsum("ni,ij,nj->n", design, self._within, design)
        return mean, np.sqrt(np.maximum(variance, 0.0) + constant + self.sigma**2)

    def _functions(self, points: Array) -> Array:
        """(N, m) the relevant functions at points like those of the fit."""
        width = self._points_of_fit[1]
        if points.shape[1] != width:
            raise ValueError(
                f"x must have {width} column{'s' * (width != 1)}, as in fit, got {points.shape[1]}: "
                "give points of the same dimension (one point of several numbers is x[None, :])."
            )
        if self._vectors is None:
            return points[:, self.relevance]
        return self._design(points, self._vectors)

    @staticmethod
    def _first(free: int, functions: int) -> Any:
        """Indices of basis functions, evenly spread, to begin with."""
        count = min(free, functions, FIRST)
        return np.round(np.linspace(0, functions - 1, count)).astype(np.int64)

    def _points(self, x: ArrayLike) -> Array:
        points = _numbers("x", x)
        points = points[:, None] if points.ndim == 1 else points
        if points.ndim != 2 or 0 in points.shape:
            raise ValueError(f"x must have shape (N,) or (N, D), got {points.shape}.")
        return points

    def _design(self, x: Array, z: Array) -> Array:
        if self.kernel == "precomputed":
            return x
        if not callable(self.kernel):
            with np.errstate(over="ignore", invalid="ignore"):
                if self.kernel == "gaussian":
                    return gaussian(x, z, self.scale)  # in 0..1 wherever points are
                return real_array("kernel 'spline' of these x (rescale them)", spline(x, z))
        value = real_array("kernel(x, z)", self.kernel(x, z))
        if value.shape != (len(x), len(z)):
            raise ValueError(
                f"kernel(x, z) must return shape {(len(x), len(z))}, got {value.shape}."
            )
        return value


def _numbers(field: str, value: ArrayLike) -> Array:
    """`value` as finite numbers; ValueError where some are masked."""
    if np.ma.is_masked(value):
        raise ValueError(
            f"{field} must be known, got {np.ma.getmaskarray(np.ma.asarray(value)).sum()} masked values: "
            "leave those points out of x and y, for example by x[~y.mask], y[~y.mask]."
        )
    return real_array(field, value)
