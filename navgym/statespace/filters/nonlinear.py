"""Filters for nonlinear models: extended, unscented, cubature, and the two of them in turn (CUKF).

Every one works on any model: x_k = f(x_{k-1}) + w, z_k = h(x_k) + v (QIVBF eq. 5-6).
`move` is f and `sense` is h, applied to one of the lane's points; `move_slope` and `sense_slope`
are their Jacobians. Which model's arithmetic they compile to follows from the type of its record.

A sigma-point sum runs over the differences d_i from the centre point: with weights that sum to 1,

    mean = c + Σ ω_i d_i,    covariance = Σ ω_i d_i d_iᵀ − (mean − c)(mean − c)ᵀ,    i = 1 … 2n

are QIVBF eq. 9 and 11-13 exactly. ω_0 drops out, so a large negative one costs no digits, and
differences of angles are wrapped before anything is averaged.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import kernel, part
from navgym.core.health import NUMERICAL, settle
from navgym.core.linalg import correct, factorise, observe_vector, predict, whiten
from navgym.core.sizes import sample_size, state_size
from navgym.statespace import models, turn_model
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters.lane import (
    apply_innovation,
    estimate_lanes,
    expect,
    expect_nothing,
    fields,
    keep_prediction,
    padded,
    receive,
    report,
    score,
    start,
    watch,
    wrapped,
)

if TYPE_CHECKING:
    from navgym.problem import Filter

EXTENDED, SIGMA, ALTERNATING = 0, 1, 2  # a filter's option
CUBATURE = 1.0  # the spread a at which eq. 7 is the cubature rule: ω_0 = 0
SERIES = 1e-2  # turn angle below which a series replaces a difference that cancels


def lane_type(n: int, m: int) -> np.dtype[Any]:
    """Record of one lane: `local` is the linear model tangent to the nonlinear one."""
    f8 = np.float64
    extra = [
        ("points", f8, (2 * n + 1, n)),
        ("seen", f8, (2 * n + 1, m)),
        ("mean", f8, (max(n, m),)),  # of the differences from the centre point
        ("raw", f8, (m,)),  # the sample as it came
        ("cycles", np.int64, ()),  # samples of which something was received
        ("local", models.record(n, m), ()),
    ]
    return np.dtype(extra + fields(n, m))


def estimate(
    chosen: Filter, batch: StateSpaceBatch, table: Array, interval: int, everything: bool
) -> dict[str, Array]:
    """Run the filter `chosen` over a batch; see `navgym.estimation.run`."""
    table = padded(table, (1.0, 1.0, CUBATURE))
    batch = batch.without_scales()
    return estimate_lanes(sys.modules[__name__], batch, table, interval, chosen.option, everything)


def begin(lanes: NDArray[Any], records: NDArray[Any], parameters: NDArray[Any]) -> None:
    """Put the lanes (N,) at the start of their recordings."""
    start(lanes, records)
    lanes["local"]["rows"] = -1
    for name in ("n", "m"):
        lanes["local"][name] = lanes[name]
    if records.dtype == turn_model.RECORD:
        lanes["angle"][:, list(turn_model.CoordinatedTurnModel.angles)] = 1


def _by_model(linear: Callable[..., None], turning: Callable[..., None]) -> Callable[..., None]:
    """A function for kernels that compiles to `linear` or to `turning`, by its `model`'s record."""

    def function(lane, model, i):  # where nothing is compiled
        (turning if hasattr(model, "beacon") else linear)(lane, model, i)

    @overload(function, jit_options={"error_model": "numpy", "nogil": True, "forceinline": True})
    def choose(lane, model, i):
        return turning if "beacon" in model.fields else linear

    return function


# The linear model.


def _linear_move(lane, model, i):
    """Move point i: F x."""
    n = state_size(lane)
    for a in range(n):
        s = 0.0
        for b in range(n):
            s += model.F[a, b] * lane.points[i, b]
        lane.mean[a] = s
    for a in range(n):
        lane.points[i, a] = lane.mean[a]


def _linear_sense(lane, model, i):
    """See point i: H x."""
    for j in range(sample_size(lane)):
        s = 0.0
        for b in range(state_size(lane)):
            s += model.H[j, b] * lane.points[i, b]
        lane.seen[i, j] = s


def _linear_move_slope(lane, model, i):
    """F is its own Jacobian."""
    for a in range(state_size(lane)):
        for b in range(state_size(lane)):
            lane.local.F[a, b] = model.F[a, b]


def _linear_sense_slope(lane, model, i):
    """H is its own Jacobian."""
    for j in range(sample_size(lane)):
        lane.local.rows[j] = model.rows[j]
        for b in range(state_size(lane)):
            lane.local.H[j, b] = model.H[j, b]


# The coordinated turn seen from a beacon (`turn_model`): state [Px, Vx, Py, Vy, ω].


@part
def turn(omega, dt):
    """Sine and cosine of the turn a = ω dt, and the way along and across per unit of velocity.

    The way is a chord of length dt sin(a/2) / (a/2), half the turn off the old course: sin a / ω
    along and (1 − cos a) / ω across, but without their cancellation on a gentle turn.
    """
    half = 0.5 * omega * dt
    s = math.sin(half)
    c = math.cos(half)
    chord = dt if half == 0.0 else dt * s / half
    return 2.0 * s * c, 1.0 - 2.0 * s * s, chord * c, chord * s


def _turn_move(lane, model, i):
    """Move point i: its velocity turns by ω dt."""
    vx = lane.points[i, 1]
    vy = lane.points[i, 3]
    sine, cosine, along, across = turn(lane.points[i, 4], model.dt)
    lane.points[i, 0] += along * vx - across * vy
    lane.points[i, 1] = cosine * vx - sine * vy
    lane.points[i, 2] += across * vx + along * vy
    lane.points[i, 3] = sine * vx + cosine * vy


def _turn_sense(lane, model, i):
    """See point i: range, bearing, speed, heading."""
    dx = lane.points[i, 0] - model.beacon[0]
    dy = lane.points[i, 2] - model.beacon[1]
    vx = lane.points[i, 1]
    vy = lane.points[i, 3]
    lane.seen[i, 0] = math.sqrt(dx * dx + dy * dy)
    lane.seen[i, 1] = math.atan2(dy, dx)
    lane.seen[i, 2] = math.sqrt(vx * vx + vy * vy)
    lane.seen[i, 3] = math.atan2(vy, vx)


def _turn_move_slope(lane, model, i):
    """Jacobian of f at point i: linear in position and velocity; ω bends both."""
    F = lane.local.F
    vx = lane.points[i, 1]
    vy = lane.points[i, 3]
    omega = lane.points[i, 4]
    dt = model.dt
    angle = omega * dt
    sine, cosine, along, across = turn(omega, dt)
    across_slope = dt * along - 0.5 * (along * along + across * across)
    if abs(angle) < SERIES:
        along_slope = dt * dt * angle * (angle * angle / 30.0 - 1.0 / 3.0)  # to 1e-12 dt²
    else:
        along_slope = (dt * cosine - along) / omega
    for a in range(5):
        for b in range(5):
            F[a, b] = 0.0
    F[0, 0] = F[2, 2] = F[4, 4] = 1.0
    F[0, 1] = F[2, 3] = along
    F[0, 3] = -across
    F[2, 1] = across
    F[1, 1] = F[3, 3] = cosine
    F[1, 3] = -sine
    F[3, 1] = sine
    F[0, 4] = along_slope * vx - across_slope * vy
    F[1, 4] = -dt * (sine * vx + cosine * vy)
    F[2, 4] = across_slope * vx + along_slope * vy
    F[3, 4] = dt * (cosine * vx - sine * vy)


def _turn_sense_slope(lane, model, i):
    """Jacobian of h at point i; rows are range, bearing, speed, heading."""
    H = lane.local.H
    dx = lane.points[i, 0] - model.beacon[0]
    dy = lane.points[i, 2] - model.beacon[1]
    vx = lane.points[i, 1]
    vy = lane.points[i, 3]
    r = math.sqrt(dx * dx + dy * dy)
    v = math.sqrt(vx * vx + vy * vy)
    for j in range(4):
        for b in range(5):
            H[j, b] = 0.0
    H[0, 0] = dx / r
    H[0, 2] = dy / r
    H[1, 0] = -dy / (r * r)
    H[1, 2] = dx / (r * r)
    H[2, 1] = vx / v
    H[2, 3] = vy / v
    H[3, 1] = -vy / (v * v)
    H[3, 3] = vx / (v * v)


move = _by_model(_linear_move, _turn_move)
sense = _by_model(_linear_sense, _turn_sense)
move_slope = _by_model(_linear_move_slope, _turn_move_slope)
sense_slope = _by_model(_linear_sense_slope, _turn_sense_slope)


@part
def scale_noise(lane, model, r):
    """Set R_used = r R."""
    for i in range(sample_size(lane)):
        for j in range(sample_size(lane)):
            lane.R_used[i, j] = r * model.R[i, j]


@kernel
def extended_step(lane, model, t, received, q, r):
    """One sample of the extended filter: the Kalman filter of the model tangent to f and h."""
    n = state_size(lane)
    m = sample_size(lane)
    for i in range(n):
        lane.points[0, i] = lane.x[i]
        for j in range(n):
            lane.local.Q[i, j] = model.Q[i, j]
    for i in range(m):
        for j in range(m):
            lane.local.R[i, j] = model.R[i, j]
    scale_noise(lane, model, r)
    move_slope(lane, model, 0)
    predict(lane, lane.local, q)
    move(lane, model, 0)
    for i in range(n):
        lane.x_prior[i] = lane.points[0, i]
    sense_slope(lane, model, 0)
    sense(lane, model, 0)
    for j in range(m):
        # the y whose innovation under the tangent model, y − H x⁻, is the wrapped z − h(x⁻)
        v = wrapped(lane, j, lane.y[j] - lane.seen[0, j])
        lane.raw[j] = lane.y[j]
        lane.y[j] = v + observe_vector(lane.local, j, lane.x_prior)
    expect(lane, lane.local, received)
    if received > 0:
        apply_innovation(lane, lane.local)
    else:
        keep_prediction(lane)
    for j in range(m):
        lane.y[j] = lane.raw[j]
    watch(lane, model, t, received)
    settle(lane)


@part
def scatter(lane, a):
    """Put the points at x⁻ and x⁻ ± a √n L_i, L Lᵀ = P⁻ (QIVBF eq. 7; at a = 1 eq. 17-18, 21-22).

    QIVBF eq. 18, corrected: 2n points through one n × n factor, without an augmented noise part.
    L is left in the lane's A.
    """
    n = state_size(lane)
    for i in range(n):
        for j in range(i + 1):
            lane.A[i, j] = lane.P_prior[i, j]
    if not factorise(lane.A, n):
        lane.diverged = NUMERICAL
    reach = a * math.sqrt(n)
    for i in range(n):
        lane.points[0, i] = lane.x_prior[i]
        for j in range(n):
            d = reach * lane.A[i, j] if j <= i else 0.0
            lane.points[1 + j, i] = lane.x_prior[i] + d
            lane.points[1 + n + j, i] = lane.x_prior[i] - d


@part
def gather_states(lane, model, weight, q):
    """Prediction x⁻ = Σ ω χ, P⁻ = Σ ω (χ − x⁻)(χ − x⁻)ᵀ + q Q (QIVBF eq. 9, 20; see the file's head).

    QIVBF eq. 20, corrected: the cubature stage subtracts the mean before it squares.
    """
    n = state_size(lane)
    for b in range(n):
        s = 0.0
        for i in range(1, 2 * n + 1):
            lane.points[i, b] -= lane.points[0, b]
            s += lane.points[i, b]
        lane.mean[b] = weight * s
        lane.x_prior[b] = lane.points[0, b] + lane.mean[b]
    for b in range(n):
        for c in range(b + 1):
            s = 0.0
            for i in range(1, 2 * n + 1):
                s += lane.points[i, b] * lane.points[i, c]
            s = q * model.Q[b, c] + weight * s - lane.mean[b] * lane.mean[c]
            lane.P_prior[b, c] = s
            lane.P_prior[c, b] = s


@part
def gather_measurements(lane, a):
    """Put z − Ẑ into the lane's innovation and z, Pzz into S, Pxzᵀ into W.

    QIVBF eq. 11-13 and 24-25. QIVBF eq. 25, corrected: Pzz subtracts Ẑ Ẑᵀ, and the second line is
    Pxz. Rows that were not received become identity rows, as in `linalg.innovate`.
    """
    n = state_size(lane)
    m = sample_size(lane)
    weight = 0.5 / (n * a * a)
    for j in range(m):
        s = 0.0
        for i in range(1, 2 * n + 1):
            lane.seen[i, j] = wrapped(lane, j, lane.seen[i, j] - lane.seen[0, j])
            s += lane.seen[i, j]
        lane.mean[j] = weight * s
        lane.z[j] = 0.0
        if lane.use[j]:
            lane.z[j] = wrapped(lane, j, lane.y[j] - lane.seen[0, j] - lane.mean[j])
            lane.innovation[j] = lane.z[j]
    for j in range(m):
        for k in range(j + 1):
            s = 0.0
            for i in range(1, 2 * n + 1):
                s += lane.seen[i, j] * lane.seen[i, k]
            s = lane.R_used[j, k] + weight * s - lane.mean[j] * lane.mean[k]
            both = lane.use[j] and lane.use[k]
            lane.S[j, k] = s if both else (1.0 if j == k else 0.0)
        for b in range(n):
            # χ_i − x⁻ is ± a √n times column i of L, which `scatter` left in A
            s = 0.0
            for i in range(b + 1):
                s += lane.A[b, i] * (lane.seen[1 + i, j] - lane.seen[1 + n + i, j])
            lane.W[j, b] = weight * a * math.sqrt(n) * s if lane.use[j] else 0.0


@kernel
def sigma_step(lane, model, t, received, q, r, a):
    """One sample through sigma points of spread a: an unscented stage, or at a = 1 a cubature one."""
    n = state_size(lane)
    for i in range(n):
        lane.x_prior[i] = lane.x[i]
        for j in range(n):
            lane.P_prior[i, j] = lane.P[i, j]
    scatter(lane, a)
    for i in range(2 * n + 1):
        move(lane, model, i)
    gather_states(lane, model, 0.5 / (n * a * a), q)
    expect_nothing(lane)
    if received > 0:
        scale_noise(lane, model, r)
        # QIVBF eq. 10, corrected: h takes new points of (x⁻, P⁻), as in eq. 22. Those of eq. 8
        # carry no Q, and with them the filter is not the Kalman filter of a linear model.
        scatter(lane, a)
        for i in range(2 * n + 1):
            sense(lane, model, i)
        gather_measurements(lane, a)
        score(lane, received, whiten(lane))
        # QIVBF eq. 16, 26, corrected: P = P⁻ − K Pzz Kᵀ; K Pzz Kᵀ = WᵀW after `whiten`
        correct(lane)
    else:
        keep_prediction(lane)
    watch(lane, model, t, received)
    settle(lane)


@kernel
def run(
    lanes, models, y, lost, time, scales, parameters, interval, method,
    states, covariances, innovations, nis, log_likelihoods,
):  # fmt: skip
    """Filter every series: parameters (·, ·, 3) are q, r and a; `scales` are unused.

    QIVBF steps 1-8, corrected: a cycle of CUKF takes two received samples, the unscented stage the
    first and the cubature stage the second, so that no measurement is used twice.
    """
    for i in range(lanes.shape[0]):
        lane = lanes[i]
        p = min(i, parameters.shape[0] - 1)
        for k in range(lane.k, min(lane.length, y.shape[1])):
            model = models[i, min(k, models.shape[1] - 1)]
            j = min(k // interval, parameters.shape[1] - 1)
            received = receive(lane, y, lost, i, k)
            q = parameters[p, j, 0]
            r = parameters[p, j, 1]
            if method == EXTENDED:
                extended_step(lane, model, time[i, k], received, q, r)
            else:
                cubature = method == ALTERNATING and lane.cycles % 2 == 1
                a = CUBATURE if cubature else parameters[p, j, 2]
                sigma_step(lane, model, time[i, k], received, q, r, a)
            lane.cycles += 1 if received > 0 else 0
            report(lane, i, k, states, covariances, innovations, nis, log_likelihoods)
