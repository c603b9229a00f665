"""What a filter believes: state-space models, and their packed form for the kernels."""

from __future__ import annotations

import dataclasses
import math
import operator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navgym.core.checks import Array, covariance, real_array
from navgym.core.frozen import Frozen

# Densities of the noise in [P, V] of one axis whose Q over 1 s is QIVBF table 2's, diag(1, .5) 1e-3:
# [[a, c], [c, b]] of `discrete` solved for it
_X0 = np.array([0.0, 1.0, 0.0, 1.0])
_TABLE_2 = 1e-3 * np.array([[13.0 / 12.0, -0.25], [-0.25, 0.5]])


def constant_velocity(dt: ArrayLike) -> Array:
    """Transition of [Px, Vx, Py, Vy] over `dt` s: (4, 4), or (T, 4, 4) for `dt` of shape (T,)."""
    step = real_array("dt", dt)
    if (step <= 0.0).any():
        raise ValueError(f"dt must be positive seconds, got {step.min()}.")
    transition = np.broadcast_to(np.eye(4), (*step.shape, 4, 4)).copy()
    transition[..., 0, 1] = transition[..., 2, 3] = step
    return transition


def process_noise(dt: ArrayLike, density: ArrayLike) -> Array:
    """Q of [Px, Vx, Py, Vy] over `dt` s under white noise of `density` in each axis's [P, V].

    ∫₀^dt e^{At} D e^{Aᵀt} dt with A = [0 1; 0 0], exactly: whether a log has one row or ten over
    the same time, the same Q comes out, Q(s + t) = F(t) Q(s) F(t)ᵀ + Q(t).

    Args:
        dt: s, a number or (T,).
        density: D, (2, 2): m²/s, m²/s², m²/s³; for white acceleration a²·diag(0, 1).

    Returns (4, 4), or (T, 4, 4).
    """
    t, (a, c, b) = real_array("dt", dt), np.asarray(density, dtype=np.float64).ravel()[[0, 1, 3]]
    Q = np.zeros((*t.shape, 4, 4))
    for p, v in ((0, 1), (2, 3)):
        Q[..., p, p] = a * t + c * t**2 + b * t**3 / 3.0
        Q[..., p, v] = Q[..., v, p] = c * t + b * t**2 / 2.0
        Q[..., v, v] = b * t
    return Q


def step_of(dt: Array) -> Array:
    """What a model takes as `dt`: the one step of even samples, (), or each sample's own, (T,)."""
    even = np.allclose(dt, dt[0], rtol=1e-6, atol=0.0)
    return np.asarray(np.median(dt)) if even else dt


@dataclass(frozen=True, eq=False)
class LinearModel(Frozen):
    """x_k = F x_{k-1} + w, w ~ N(0, Q);  z_k = H x_k + v, v ~ N(0, R)  (QIVBF eq. 1, corrected).

    The state [Px, Vx, Py, Vy] (m, m/s) with constant velocity over `dt` seconds is the default;
    pass `F` for any other linear model. `F`, `H`, `Q` and `R` may carry a leading time axis
    (T, ...) where they change from sample to sample (irregular sampling: `dt` of shape (T,)).
    `x0`, `P0` hold one step before the first measurement. `position` and `velocity` name the
    state indices over which errors are reported.

    Args:
        F: transition, (n, n) or (T, n, n). Give `F` or `dt`; both only where they agree.
        H: measurement matrix, (m, n); the identity by default (all states measured).
        Q: process noise covariance, (n, n), positive semi-definite. By default, for `dt`, that of
            the noise in continuous time which over 1 s is QIVBF table 2's, over any other step as
            much of it as the step is long; for an `F` of one's own the identity.
        R: measurement noise covariance, (m, m), positive definite; the identity by default. With
            a time axis, a component whose variance is NaN or 0 at a sample has no known accuracy
            there: such a row serves only where the measurement is lost (a `Recording` checks it).
        x0: initial mean, (n,); [0, 1, 0, 1] by default (zeros where `F` is given).
        P0: initial covariance, (n, n), positive definite; the identity by default.
        dt: step in s, a number or (T,), for the constant-velocity model; 1 s by default.
        position: indices of the states that make up a position error; (0, 2) by default, of an
            `F` of one's own all states.
        velocity: indices of the states that make up a velocity error; (1, 3) by default, of an
            `F` of one's own none.
        sensors: for each measurement component the name of its sensor, (m,): the noise of each
            sensor has a scale of its own that can be tuned (`navgym.statespace.noise`). By
            default "position" and "velocity" by the states that a row of H observes.
        axes: for each state the name of its axis of motion, (n,): likewise for process noise.
            By default there is one.

    Raises:
        ValueError: naming the field, for wrong shapes, non-finite values, or a matrix that is no
            covariance.
    """

    F: Any = None
    H: Any = None
    Q: Any = None
    R: Any = None
    x0: Any = None
    P0: Any = None
    dt: Any = None
    position: Any = None
    velocity: Any = None
    sensors: Any = None
    axes: Any = None

    angles: ClassVar[tuple[int, ...]] = ()  # measurements in rad that wrap

    def __post_init__(self) -> None:
        F, dt = _transition(self.F, self.dt)
        if F.ndim not in (2, 3) or F.shape[-1] != F.shape[-2] or F.shape[-1] == 0:
            raise ValueError(f"F must be a square matrix (n, n) or (T, n, n), got {F.shape}.")
        n = F.shape[-1]
        H = check_matrix("H", np.eye(n) if self.H is None else self.H, (None, n), "n columns")
        m = H.shape[-2]
        Q = self.Q if self.Q is not None else np.eye(n) if dt is None else _table_2(dt)
        Q = check_matrix("Q", Q, (n, n), "n x n")
        R = check_matrix(
            "R", _default(self.R, np.eye(m)), (m, m), "one row per measurement", finite=False
        )
        R = _unknown(R)
        x0 = check_vector("x0", _default(self.x0, np.zeros(n) if dt is None else _X0), n)
        P0 = check_matrix("P0", _default(self.P0, np.eye(n)), (n, n), "n x n", stack=False)
        covariance("Q", Q, definite=False)
        covariance("R", _filled(R), definite=True)
        covariance("P0", P0, definite=True)
        lengths = {a.shape[0] for a in (F, H, Q, R) if a.ndim == 3}
        if len(lengths) > 1:
            raise ValueError(
                f"F, H, Q, R with a time axis must agree on its length, got {lengths}."
            )
        self._freeze({"F": F, "H": H, "Q": Q, "R": R, "x0": x0, "P0": P0, "dt": dt})
        usual = dt is not None
        for name, moving, own in (("position", (0, 2), tuple(range(n))), ("velocity", (1, 3), ())):
            value = getattr(self, name)
            object.__setattr__(self, name, _indices(name, value, moving if usual else own, n))
        sensors = _sensors(H, self.position, self.velocity)
        for name, default in (("sensors", sensors), ("axes", ("all",) * n)):
            object.__setattr__(self, name, _names(name, getattr(self, name), default))

    @classmethod
    def white_acceleration(
        cls,
        dt: ArrayLike,
        acceleration: float = 0.1,
        position_noise: float = 1.0,
        velocity_noise: float | None = 0.1,
        x0: ArrayLike | None = None,
        P0: ArrayLike | None = None,
    ) -> LinearModel:
        """Constant velocity pushed by white acceleration: Q = a² [dt³/3, dt²/2; dt²/2, dt] per axis.

        The noise is white in continuous time, so that a gap of 100 s says the same as 100 rows
        without a measurement.

        Args:
            dt: step in s, a number or (T,).
            acceleration: a, its root density, m/s²/√Hz: over t s the velocity wanders by a √t m/s.
            position_noise: standard deviation of a position fix, m.
            velocity_noise: of a velocity, m/s; None if no velocity is measured.
            x0: initial state, (4,).
            P0: its covariance, (4, 4); the identity by default.
        """
        Q = process_noise(dt, np.diag([0.0, acceleration**2]))
        if velocity_noise is None:
            H, R = np.eye(4)[[0, 2]], position_noise**2 * np.eye(2)
        else:
            H, R = np.eye(4), np.diag([position_noise**2, velocity_noise**2] * 2)
        return cls(dt=dt, H=H, Q=Q, R=R, x0=x0, P0=P0)

    @classmethod
    def from_continuous(
        cls, A: ArrayLike, density: ArrayLike, dt: ArrayLike, **fields: Any
    ) -> LinearModel:
        """The model of dx = A x dt + noise, exactly, over steps of any length.

        F = e^{A dt} and Q = ∫₀^dt e^{As} D e^{Aᵀs} ds (van Loan 1978): a model of one's own whose
        estimates do not depend on how a log is cut.

        Args:
            A: (n, n), 1/s.
            density: D of the white noise, (n, n), per s.
            dt: step in s, a number or (T,).
            fields: H, R, x0, P0, position, velocity, sensors, axes as of the class.
        """
        from scipy.linalg import expm  # heavy, and seldom wanted

        drift = real_array("A", A)
        n = len(drift)
        D = check_matrix("density", density, (n, n), "n x n", stack=False)
        check_matrix("A", drift, (n, n), "n x n", stack=False)
        blocks = np.block([[-drift, D], [np.zeros((n, n)), drift.T]])
        step = real_array("dt", dt)
        if (step <= 0.0).any():
            raise ValueError(f"dt must be positive seconds, got {step.min()}.")
        # over a long step e^{−A dt} grows without bound, so: over a short one, doubled and doubled
        halvings = max(0, math.ceil(math.log2(max(np.abs(drift).sum() * step.max(), 1.0))))
        found = expm(blocks * (step / 2.0**halvings)[..., None, None])
        F = np.swapaxes(found[..., n:, n:], -1, -2)
        Q = F @ found[..., :n, n:]
        for _ in range(halvings):
            Q = F @ Q @ np.swapaxes(F, -1, -2) + Q
            F = F @ F
        return cls(F=F, Q=(Q + np.swapaxes(Q, -1, -2)) / 2.0, **fields)

    @property
    def n(self) -> int:
        """Number of states."""
        return int(self.F.shape[-1])

    @property
    def m(self) -> int:
        """Number of measurement components."""
        return int(self.H.shape[-2])

    @property
    def deaf(self) -> NDArray[np.bool_]:
        """Where R knows no variance of a component, so that it must be lost: (m,) or (T, m)."""
        unknown: NDArray[np.bool_] = np.isnan(np.diagonal(self.R, axis1=-2, axis2=-1))
        return unknown

    @property
    def steps(self) -> int | None:
        """Length of the time axis of F, H, Q or R; None where the model does not change."""
        lengths = [a.shape[0] for a in (self.F, self.H, self.Q, self.R) if a.ndim == 3]
        return lengths[0] if lengths else None

    def observe(self, states: ArrayLike) -> Array:
        """Noise-free measurements H x of `states` (n,) or (T, n): (m,) or (T, m)."""
        x = real_array("states", states)
        seen: Array = x @ self.H.T if self.H.ndim == 2 else np.einsum("...ij,...j->...i", self.H, x)
        return seen

    def pack(self) -> NDArray[Any]:
        """The model as records of `record(n, m)`, shape (1,) or (T,), for the kernels."""
        records = np.zeros(self.steps or 1, record(self.n, self.m))
        for name in ("F", "H", "Q", "R", "x0", "P0"):
            records[name] = getattr(self, name)
        records["R"] = _filled(records["R"])
        records["n"], records["m"] = self.n, self.m
        records["rows"] = _selected(records["H"])
        return records

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The model as plain arrays, for a file; `model_from_arrays` reads them back."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        known = {name: np.asarray(value) for name, value in fields.items() if value is not None}
        return {"kind": np.array("linear")} | known


def record(n: int, m: int) -> np.dtype[Any]:
    """Record of one packed model. Sizes are part of the type, so kernels know them."""
    f8 = np.float64
    return np.dtype(
        [
            ("F", f8, (n, n)),
            ("H", f8, (m, n)),
            ("Q", f8, (n, n)),
            ("R", f8, (m, m)),
            ("x0", f8, (n,)),
            ("P0", f8, (n, n)),
            ("rows", np.int64, (m,)),
            ("n", np.int64),
            ("m", np.int64),
        ]
    )


def _selected(H: Array) -> NDArray[np.int64]:
    """For each row of H the state that it copies, or -1: spares kernels a matrix product."""
    unit = (H == 1.0).sum(-1) == 1
    others = (H != 0.0).sum(-1) == 1
    return np.where(unit & others, np.argmax(H == 1.0, axis=-1), -1)


def _transition(F: Any, dt: Any) -> tuple[Array, Array | None]:
    """The transition, and the step that it was made from, if it was."""
    if F is not None and dt is None:
        return real_array("F", F), None
    step = real_array("dt", 1.0 if dt is None else dt)
    made = constant_velocity(step)
    if F is not None and not np.array_equal(real_array("F", F), made):
        raise ValueError(
            f"give F or dt, not both, or an F that is the constant velocity over dt={dt!r}; got "
            f"F={F!r}. To change the step of a model, replace both: F=None, dt=..."
        )
    return made, step


def _default(value: Any, default: Array) -> Any:
    return default if value is None else value


def _table_2(dt: Array) -> Array:
    return process_noise(dt, _TABLE_2)


def _unknown(R: Array) -> Array:
    """R with NaN for each component, and its covariances, whose variance is NaN or 0 in a stack.

    Raises ValueError for a variance that is missing where there is no time axis.
    """
    variances = np.diagonal(R, axis1=-2, axis2=-1)
    missing = np.isnan(variances) | (variances == 0.0)
    if missing.any() and R.ndim == 2:
        raise ValueError(
            f"R must be finite and positive on its diagonal, got {variances}: a component without "
            "a known accuracy needs an R with a time axis, (T, m, m), and must be lost there."
        )
    either = missing[..., :, None] | missing[..., None, :]
    if not np.isfinite(R[~either]).all():
        raise ValueError("R must be finite, got NaN or infinity: mark the sample as lost.")
    return np.where(either, np.nan, R)


def _filled(R: Array) -> Array:
    """R with the variance last known (or else next known) where a component has none, apart.

    Such a component is lost there; but fills and a bank's modes use the noise of what is lost.
    """
    known = ~np.isnan(np.diagonal(R, axis1=-2, axis2=-1))
    if known.all():
        return R
    steps = np.arange(len(R))[:, None]
    last = np.maximum.accumulate(np.where(known, steps, -1), axis=0)
    last = np.where(last < 0, known.argmax(axis=0), last)
    components = np.arange(R.shape[-1])
    variances = np.nan_to_num(R[last, components, components], nan=1.0)
    return np.where(np.isnan(R), variances[:, :, None] * np.eye(R.shape[-1]), R)


def _sensors(H: Array, position: tuple[int, ...], velocity: tuple[int, ...]) -> tuple[str, ...]:
    """What each row of H measures: "position", "velocity", or one word for all."""
    seen = (H != 0.0).reshape(-1, *H.shape[-2:]).any(axis=0)
    if not velocity:
        return ("measurement",) * len(seen)
    kinds = ("position", position), ("velocity", velocity)
    rows = [{name for name, own in kinds if row[list(own)].any()} for row in seen]
    only = {name for name, own in kinds for row in rows if row == {name}}
    pure = all(len(row) == 1 for row in rows) and len(only) > 0
    return tuple(row.pop() for row in rows) if pure else ("measurement",) * len(seen)


def _names(field: str, value: Any, default: tuple[str, ...]) -> tuple[str, ...]:
    if value is None:
        return default
    names = () if isinstance(value, str) else tuple(np.ravel(value).tolist())
    if len(names) != len(default) or not all(
        isinstance(n, str) and n.isidentifier() for n in names
    ):
        raise ValueError(
            f"{field} must be {len(default)} names (letters, digits and _), got {value!r}."
        )
    return names


def check_matrix(
    field: str,
    value: Any,
    shape: tuple[int | None, int],
    because: str,
    stack: bool = True,
    finite: bool = True,
) -> Array:
    """`value` as a new float64 array of `shape`, or a stack of such; ValueError naming the field."""
    array = real_array(field, value, finite=finite)
    rows, columns = shape
    right = array.ndim in ((2, 3) if stack else (2,)) and array.shape[-1] == columns
    if not right or array.shape[-2] == 0 or (rows is not None and array.shape[-2] != rows):
        wanted = f"({'m' if rows is None else rows}, {columns})"
        raise ValueError(f"{field} must have shape {wanted} ({because}), got {array.shape}.")
    return array


def check_vector(field: str, value: Any, length: int, because: str = "one per state") -> Array:
    """`value` as a new float64 array (length,); ValueError naming the field."""
    array = real_array(field, value)
    if array.shape != (length,):
        raise ValueError(f"{field} must have shape ({length},), {because}, got {array.shape}.")
    return array


def _indices(field: str, value: Any, usual: tuple[int, ...], n: int) -> tuple[int, ...]:
    if value is None:
        return usual
    try:
        indices = tuple(operator.index(i) for i in value)
    except TypeError:
        indices = (-1,)
    if any(not 0 <= i < n for i in indices) or len(set(indices)) != len(indices):
        raise ValueError(f"{field} must be distinct state indices in 0..{n - 1}, got {value!r}.")
    return indices
