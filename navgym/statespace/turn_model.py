"""The coordinated turn seen from a beacon: the nonlinear model of the sigma-point filters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navgym.core.checks import Array, covariance, real_array
from navgym.core.frozen import Frozen
from navgym.statespace.models import check_matrix, check_vector

STATES, MEASUREMENTS = 5, 4
DEGREE = math.pi / 180.0

RECORD = np.dtype(
    [
        ("dt", np.float64),
        ("Q", np.float64, (STATES, STATES)),
        ("R", np.float64, (MEASUREMENTS, MEASUREMENTS)),
        ("x0", np.float64, (STATES,)),
        ("P0", np.float64, (STATES, STATES)),
        ("beacon", np.float64, (2,)),
    ]
)


@dataclass(frozen=True, eq=False)
class CoordinatedTurnModel(Frozen):
    """x_k = f(x_{k-1}) + w, w ~ N(0, Q);  z_k = h(x_k) + v, v ~ N(0, R)  (QIVBF eq. 5-6).

    The state is [Px, Vx, Py, Vy, ω] (m, m/s, rad/s): the linear model's four and a turn rate. So
    position and velocity keep their indices and metrics, no state is an angle that would need
    wrapping, and the motion is exact: over `dt` the velocity turns by a = ω dt,

        Px + (sin a / ω) Vx − ((1 − cos a) / ω) Vy      Vx cos a − Vy sin a
        Py + ((1 − cos a) / ω) Vx + (sin a / ω) Vy      Vx sin a + Vy cos a      ω

    Measured are, in this order, range (m) and bearing (rad) of the vehicle from the beacon, speed
    (m/s) and heading (rad). Angles are counted from the x axis toward the y axis, and any multiple
    of 2π may be added to a measured one. Mark what a vehicle does not measure as lost.

    The paper gives neither f nor h nor any number. The defaults are ours: an AUV of 1.5 m/s on
    turns of some 60 m radius, 175 m from the beacon, so that at 30 % loss its position is known to
    two thirds of a metre.

    Args:
        dt: step in s, a number or (T,); 1 s by default.
        Q: process noise covariance, (5, 5) or (T, 5, 5), positive semi-definite; by default white
            acceleration of (.02 m/s²)²·s and a turn rate that wanders by .05 °/s in a second.
        R: measurement noise covariance, (4, 4) or (T, 4, 4), positive definite; by default that of
            1 m, 1°, .1 m/s and 2°.
        x0: mean one step before the first measurement, (5,); [175, 0, 0, 1.5, 1.5 °/s] by default.
        P0: its covariance, (5, 5), positive definite; by default that of 1 m, .2 m/s and 1 °/s.
        beacon: its place (x, y) in m; the origin by default.

    Raises:
        ValueError: naming the field, for wrong shapes, non-finite values, a matrix that is no
            covariance, or an `x0` whose bearing or heading is undefined.
    """

    dt: Any = 1.0
    Q: Any = None
    R: Any = None
    x0: Any = None
    P0: Any = None
    beacon: Any = (0.0, 0.0)

    position: ClassVar[tuple[int, ...]] = (0, 2)
    velocity: ClassVar[tuple[int, ...]] = (1, 3)
    angles: ClassVar[tuple[int, ...]] = (1, 3)
    sensors: ClassVar[tuple[str, ...]] = ("range", "bearing", "speed", "heading")
    axes: ClassVar[tuple[str, ...]] = ("translation",) * 4 + ("turn",)
    n: ClassVar[int] = STATES
    m: ClassVar[int] = MEASUREMENTS

    def __post_init__(self) -> None:
        dt = real_array("dt", self.dt)
        if dt.ndim > 1 or dt.size == 0 or (dt <= 0.0).any():
            raise ValueError(f"dt must be positive seconds, a number or (T,), got {self.dt!r}.")
        fields = {
            "dt": dt,
            "Q": check_matrix("Q", _or(self.Q, _process_noise(dt)), (STATES, STATES), "n x n"),
            "R": check_matrix("R", _or(self.R, _R), (MEASUREMENTS, MEASUREMENTS), "m x m"),
            "x0": check_vector("x0", _or(self.x0, _X0), STATES),
            "P0": check_matrix("P0", _or(self.P0, _P0), (STATES, STATES), "n x n", stack=False),
            "beacon": check_vector("beacon", self.beacon, 2, "x and y"),
        }
        covariance("Q", fields["Q"], definite=False)
        covariance("R", fields["R"], definite=True)
        covariance("P0", fields["P0"], definite=True)
        _defined(fields["x0"], fields["beacon"])
        self._freeze(fields)
        lengths = self._lengths()
        if len(lengths) > 1:
            raise ValueError(f"dt, Q, R with a time axis must agree on its length, got {lengths}.")

    def _lengths(self) -> set[int]:
        stacked = [a for a, plain in ((self.dt, 0), (self.Q, 2), (self.R, 2)) if a.ndim > plain]
        return {len(a) for a in stacked}

    @property
    def steps(self) -> int | None:
        """Length of the time axis of dt, Q or R; None where the model does not change."""
        return next(iter(self._lengths()), None)

    def observe(self, states: ArrayLike) -> Array:
        """Noise-free measurements h(x) of `states` (..., 5): (..., 4), angles in (−π, π]."""
        x, vx, y, vy, _ = np.moveaxis(real_array("states", states), -1, 0)
        x, y = x - self.beacon[0], y - self.beacon[1]
        seen = np.hypot(x, y), np.arctan2(y, x), np.hypot(vx, vy), np.arctan2(vy, vx)
        return np.stack(seen, axis=-1)

    def pack(self) -> NDArray[Any]:
        """The model as records of `RECORD`, shape (1,) or (T,), for the kernels."""
        records = np.zeros(self.steps or 1, RECORD)
        for name in RECORD.names or ():
            records[name] = getattr(self, name)
        return records

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The model as plain arrays, for a file; `model_from_arrays` reads them back."""
        plain = {name: np.asarray(getattr(self, name)) for name in RECORD.names or ()}
        return {"kind": np.array("coordinated-turn")} | plain


_X0 = np.array([175.0, 0.0, 0.0, 1.5, 1.5 * DEGREE])
_P0 = np.diag([1.0, 0.2, 1.0, 0.2, 1.0 * DEGREE]) ** 2
_R = np.diag([1.0, 1.0 * DEGREE, 0.1, 2.0 * DEGREE]) ** 2
_ACCELERATION, _WANDER = 0.02**2, (0.05 * DEGREE) ** 2  # densities, m²/s³ and rad²/s³


def _process_noise(dt: Array) -> Array:
    """Q of white acceleration along each axis, independent of direction, and of a wandering ω."""
    Q = np.zeros((*dt.shape, STATES, STATES))
    for p, v in ((0, 1), (2, 3)):
        Q[..., p, p] = _ACCELERATION * dt**3 / 3.0
        Q[..., p, v] = Q[..., v, p] = _ACCELERATION * dt**2 / 2.0
        Q[..., v, v] = _ACCELERATION * dt
    Q[..., 4, 4] = _WANDER * dt
    return Q


def _or(value: Any, default: Array) -> Any:
    return default if value is None else value


def _defined(x0: Array, beacon: Array) -> None:
    """Raise ValueError where the first bearing or heading would be undefined."""
    if x0[0] == beacon[0] and x0[2] == beacon[1]:
        raise ValueError(
            f"x0 must not lie on the beacon {beacon}, where no bearing is defined: move one of them."
        )
    if x0[1] == 0.0 and x0[3] == 0.0:
        raise ValueError(
            "x0 must have a velocity, or its heading is undefined, got Vx = Vy = 0: give it the "
            "speed that you expect."
        )
