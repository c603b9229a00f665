"""What a filter believes: state-space models, and their packed form for the kernels."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navgym.core.checks import Array, covariance, real_array
from navgym.core.frozen import Frozen

TABLE_2_Q = 1e-3 * np.diag([1.0, 0.5, 1.0, 0.5])  # QIVBF table 2


def constant_velocity(dt: ArrayLike) -> Array:
    """Transition of [Px, Vx, Py, Vy] over `dt` s: (4, 4), or (T, 4, 4) for `dt` of shape (T,)."""
    step = real_array("dt", dt)
    if (step <= 0.0).any():
        raise ValueError(f"dt must be positive seconds, got {step.min()}.")
    transition = np.broadcast_to(np.eye(4), (*step.shape, 4, 4)).copy()
    transition[..., 0, 1] = transition[..., 2, 3] = step
    return transition


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
        Q: process noise covariance, (n, n), positive semi-definite; QIVBF table 2 by default.
        R: measurement noise covariance, (m, m), positive definite; the identity by default.
        x0: initial mean, (n,); [0, 1, 0, 1] by default (zeros where `F` is given).
        P0: initial covariance, (n, n), positive definite; the identity by default.
        dt: step in s, a number or (T,), for the constant-velocity model; 1 s by default.
        position: indices of the states that make up a position error.
        velocity: indices of the states that make up a velocity error.

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

    angles: ClassVar[tuple[int, ...]] = ()  # measurements in rad that wrap

    def __post_init__(self) -> None:
        F, dt = _transition(self.F, self.dt)
        if F.ndim not in (2, 3) or F.shape[-1] != F.shape[-2] or F.shape[-1] == 0:
            raise ValueError(f"F must be a square matrix (n, n) or (T, n, n), got {F.shape}.")
        n = F.shape[-1]
        default = n == 4
        H = check_matrix("H", np.eye(n) if self.H is None else self.H, (None, n), "n columns")
        m = H.shape[-2]
        Q = check_matrix(
            "Q", _default(self.Q, TABLE_2_Q if default else np.eye(n)), (n, n), "n x n"
        )
        R = check_matrix("R", _default(self.R, np.eye(m)), (m, m), "one row per measurement")
        x0_default = np.array([0.0, 1.0, 0.0, 1.0]) if default else np.zeros(n)
        x0 = check_vector("x0", _default(self.x0, x0_default), n)
        P0 = check_matrix("P0", _default(self.P0, np.eye(n)), (n, n), "n x n", stack=False)
        covariance("Q", Q, definite=False)
        covariance("R", R, definite=True)
        covariance("P0", P0, definite=True)
        lengths = {a.shape[0] for a in (F, H, Q, R) if a.ndim == 3}
        if len(lengths) > 1:
            raise ValueError(
                f"F, H, Q, R with a time axis must agree on its length, got {lengths}."
            )
        self._freeze({"F": F, "H": H, "Q": Q, "R": R, "x0": x0, "P0": P0, "dt": dt})
        pairs = (("position", (0, 2)), ("velocity", (1, 3)))
        for name, usual in pairs:
            object.__setattr__(self, name, _indices(name, getattr(self, name), usual, n))

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
        """Constant velocity pushed by white acceleration: Q = acceleration² G Gᵀ, G = [dt²/2, dt].

        Args:
            dt: step in s, a number or (T,).
            acceleration: standard deviation, m/s².
            position_noise: standard deviation of a position fix, m.
            velocity_noise: of a velocity, m/s; None if no velocity is measured.
            x0: initial state, (4,).
            P0: its covariance, (4, 4); the identity by default.
        """
        step = real_array("dt", dt)
        gain = np.stack([step**2 / 2, step], axis=-1)
        block = acceleration**2 * gain[..., :, None] * gain[..., None, :]
        Q = np.zeros((*step.shape, 4, 4))
        Q[..., :2, :2] = Q[..., 2:, 2:] = block
        if velocity_noise is None:
            H, R = np.eye(4)[[0, 2]], position_noise**2 * np.eye(2)
        else:
            H, R = np.eye(4), np.diag([position_noise**2, velocity_noise**2] * 2)
        return cls(dt=dt, H=H, Q=Q, R=R, x0=x0, P0=P0)

    @property
    def n(self) -> int:
        """Number of states."""
        return int(self.F.shape[-1])

    @property
    def m(self) -> int:
        """Number of measurement components."""
        return int(self.H.shape[-2])

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
        records["rows"] = _selected(records["H"])
        return records

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The model as plain arrays, for a file; `model_from_arrays` reads them back."""
        names = ("F", "H", "Q", "R", "x0", "P0", "dt", "position", "velocity")
        fields = {name: getattr(self, name) for name in names}
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


def check_matrix(
    field: str, value: Any, shape: tuple[int | None, int], because: str, stack: bool = True
) -> Array:
    """`value` as a new float64 array of `shape`, or a stack of such; ValueError naming the field."""
    array = real_array(field, value)
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
        return usual if n == 4 else (tuple(range(n)) if field == "position" else ())
    try:
        indices = tuple(operator.index(i) for i in value)
    except TypeError:
        indices = (-1,)
    if any(not 0 <= i < n for i in indices) or len(set(indices)) != len(indices):
        raise ValueError(f"{field} must be distinct state indices in 0..{n - 1}, got {value!r}.")
    return indices
