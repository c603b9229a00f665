"""The deck filter with the mean rate as a state of its own: what the gyros match, and when, exactly.

Two gyros match the mean of θ̇ over a step, m = (θ(t) − θ(t−dt))/dt, and not its value at the end. The
flexure's noise drives both: v = m − θ̇ is correlated with what drives θ̇ by −q dt/2. With m a state that
has no memory, the model is exact for any flexure:

    m⁻ = [(F00 − 1) θ + F01 θ̇]/dt,   Q_mθ = q00/dt,   Q_mr = q01/dt,   Q_mm = q00/dt²,

rate rows point at m, turned by C_m at mid-step, and their R is the gyros' noise alone.

Two more blocks of states: the error δr of the lever arm, a constant that moves V_r by C_m (ω × δr), and
θ̇ as it was one and two steps ago, which later measurements go on improving. Everything else is
`navgym.deck.alignment`'s.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import part
from navgym.deck import alignment
from navgym.deck.alignment import COLUMNS, MEASUREMENTS, PROCESS, VELOCITY
from navgym.inertial import update
from navgym.inertial.states import Layout, State
from navgym.inertial.strapdown import matrix

LAYOUT = Layout(
    *alignment.LAYOUT.states,
    State("LEVER", "δr", "m", "error of the lever arm"),
    State("LAGGED", "θ̇₋₁", "rad/s", "rate of the dynamic deformation a step ago"),
    State("LAGGED2", "θ̇₋₂", "rad/s", "the same two steps ago"),
    State("MEAN", "m", "rad/s", "mean of θ̇ over the step"),
)
AT = LAYOUT.first
STATES = LAYOUT.size
LEVER, LAGGED = LAYOUT.slices[-4:-2]
ROWS = (LAYOUT.indices("L", "DV", "VR"),) * 3 + (LAYOUT.indices("L", "PHI", "EPS", "MEAN"),) * 3

WALK = 1e-3  # m/s/√s, of δV, where lever errors are states: what a constant error leaves out
ENTRY, ENTRY_SECONDS = (
    0.2,
    10.0,
)  # m/s and s: there V_r is trusted as little at first, and then more

f8, i8 = np.float64, np.int64


LANE = np.dtype(
    [
        *update.fields(STATES, MEASUREMENTS, max(map(len, ROWS))),
        ("row", f8, (len(COLUMNS),)),
        ("model_error", f8, (3,)),  # none: for reports
        ("k", i8),
        ("length", i8),
        ("spike", f8, (MEASUREMENTS,)),  # variance of a wrong row beside R
        ("chance", f8),  # of a mode, after the step
        ("forecast", f8),  # of a mode, before it
        # scratch
        ("B", f8, (3, 6)),  # V_r = B (θ, θ̇) − const, at the last step
        ("M", f8, (3, 6)),
        ("C_s", f8, (3, 3)),
        ("C_m", f8, (3, 3)),
        ("E", f8, (3, 3)),  # what an error of the lever arm adds to V_r: C_m (ω × e_a)
        ("A", f8, (3, 3)),  # C_im^is
        ("G", f8, (3, 3)),  # (I + l×)⁻¹; before, by how much E has moved
        ("own", f8, (2, 3)),
        ("S0", f8, (MEASUREMENTS, MEASUREMENTS)),
        ("told", f8, (MEASUREMENTS,)),  # of branches: log-likelihood, then probability
        ("x_sum", f8, (STATES,)),
        ("P_sum", f8, (STATES, STATES)),
        ("crossed", f8, (STATES, STATES)),  # F P: covariance of x⁻ with x as it was
    ]
)


def begin(lanes: NDArray[Any], models: NDArray[Any], lever_sd: Array) -> None:
    """Put lanes (N, J) at the start of recordings.

    Args:
        lanes: J for each recording.
        models: (N, J) records of `alignment_model.MODEL`, one per lane.
        lever_sd: (N,) m, standard deviation of the lever arm's error along each axis; 0: there is none.
    """
    flat, each = lanes.reshape(-1), models.reshape(-1)
    flat[...] = np.zeros((), LANE)
    lanes["row"] = alignment.OFF
    first, lever = np.arange(alignment.STATES), list(LAYOUT.indices("LEVER"))
    flat["P"][:, first, first] = each["start"] ** 2
    lanes["P"][:, :, lever, lever] = lever_sd[:, None, None] ** 2
    flat["E"] = _cross(each["omega"])
    flat["B"][:, :, :3] = flat["E"] @ each["lever"]
    flat["B"][:, :, 3:] = each["lever"]
    flat["length"] = 2**62
    update.touch(flat, ROWS)


def _cross(v: Array) -> Array:
    """(N, 3, 3) v× of vectors (N, 3)."""
    return np.cross(v[:, None, :], np.eye(3)).swapaxes(1, 2)


# ---- prediction


@part
def remember(lane, model):
    """m⁻ and the lagged rates from θ and θ̇ as they still are."""
    x = lane.x
    for a in range(3):
        x[AT.LAGGED2 + a] = x[AT.LAGGED + a]
        x[AT.LAGGED + a] = x[AT.RATE + a]
        F = model.transition
        moved = (F[a, 0, 0] - 1.0) * x[AT.THETA + a] + F[a, 0, 1] * x[AT.RATE + a]
        x[AT.MEAN + a] = moved / model.dt


@part
def remember_rows(lane, model):
    """The same of the rows of P, and what δr adds to V_r as E moves by G."""
    P = lane.P
    for a in range(3):
        g0, g1, g2 = lane.G[a, 0], lane.G[a, 1], lane.G[a, 2]
        f00 = (model.transition[a, 0, 0] - 1.0) / model.dt
        f01 = model.transition[a, 0, 1] / model.dt
        for j in range(STATES):
            P[AT.LAGGED2 + a, j] = P[AT.LAGGED + a, j]
            P[AT.LAGGED + a, j] = P[AT.RATE + a, j]
        for j in range(STATES):
            P[AT.VR + a, j] += (
                g0 * P[AT.LEVER, j] + g1 * P[AT.LEVER + 1, j] + g2 * P[AT.LEVER + 2, j]
            )
        for j in range(STATES):
            P[AT.MEAN + a, j] = f00 * P[AT.THETA + a, j] + f01 * P[AT.RATE + a, j]


@part
def lever_moves(lane, tape):
    """G ← C_m (ω × e_a) less what it was, which is E; C_m is at the step's end."""
    w = tape.omega
    for i in range(3):
        c0, c1, c2 = lane.C_m[i, 0], lane.C_m[i, 1], lane.C_m[i, 2]
        e0, e1, e2 = c1 * w[2] - c2 * w[1], c2 * w[0] - c0 * w[2], c0 * w[1] - c1 * w[0]
        lane.G[i, 0], lane.G[i, 1], lane.G[i, 2] = (
            e0 - lane.E[i, 0], e1 - lane.E[i, 1], e2 - lane.E[i, 2],
        )  # fmt: skip
        lane.E[i, 0], lane.E[i, 1], lane.E[i, 2] = e0, e1, e2


@part
def push(lane, dt, a, q00, q01, q11):
    """P ← P + what drives θ and θ̇ of axis a with covariance q, V_r and m with them."""
    alignment.drive(lane, a, q00, q01, q11, True)
    P, B, h = lane.P, lane.B, 1.0 / dt
    P[AT.MEAN + a, AT.MEAN + a] += q00 * h * h
    P[AT.MEAN + a, AT.THETA + a] += q00 * h
    P[AT.THETA + a, AT.MEAN + a] += q00 * h
    P[AT.MEAN + a, AT.RATE + a] += q01 * h
    P[AT.RATE + a, AT.MEAN + a] += q01 * h
    for i in range(3):
        q = (B[i, a] * q00 + B[i, 3 + a] * q01) * h
        P[AT.VR + i, AT.MEAN + a] += q
        P[AT.MEAN + a, AT.VR + i] += q


@part
def jump(lane, dt, a, variance, left):
    """P ← P + a jump of axis a's θ̇ of that variance, when a share `left` of the step was still to come."""
    push(lane, dt, a, variance * (left * dt) ** 2, variance * left * dt, variance)


@part
def predict(lane, model, tape, impulse, left):
    """x⁻ and P⁻; known jumps of θ̇ of variance `impulse` (3,) left a share `left` of the step."""
    matrix(tape.q_mid, lane.C_s)
    alignment.lever_step(lane, model, tape)
    remember(lane, model)
    lever_moves(lane, tape)
    for i in range(3):
        for a in range(3):
            lane.x[AT.VR + i] += lane.G[i, a] * lane.x[AT.LEVER + a]
    alignment.move_state(lane, model, tape)
    for again in range(2):  # F P Fᵀ is F (F P)ᵀ
        if again:
            update.transpose(lane)
        remember_rows(lane, model)
        alignment.move_rows(lane, model, tape)
        if again == 0:
            update.copy(lane.crossed, lane.P)
    alignment.add_sensor_noise(lane, model, tape)
    scale, still = lane.row[PROCESS], left * model.dt
    for a in range(3):
        q00 = scale * model.noise[a, 0, 0] + impulse[a] * still * still
        q01 = scale * model.noise[a, 0, 1] + impulse[a] * still
        push(lane, model.dt, a, q00, q01, scale * model.noise[a, 1, 1] + impulse[a])
    if lane.P[AT.LEVER, AT.LEVER] > 0.0:
        for i in range(3):
            lane.P[AT.DV + i, AT.DV + i] += WALK * WALK * model.dt


# ---- measurements


@part
def to_middle(lane, model, tape):
    """C_m at the step's middle from that at its end, to second order in the step's turn."""
    h = 0.5 * model.dt
    w0, w1, w2 = h * tape.w_m[0], h * tape.w_m[1], h * tape.w_m[2]
    C = lane.C_m
    for j in range(3):
        a, b, c = C[0, j], C[1, j], C[2, j]
        x, y, z = w1 * c - w2 * b, w2 * a - w0 * c, w0 * b - w1 * a
        C[0, j] = a - x + 0.5 * (w1 * z - w2 * y)
        C[1, j] = b - y + 0.5 * (w2 * x - w0 * z)
        C[2, j] = c - z + 0.5 * (w0 * y - w1 * x)


@part
def look(lane, model, tape, own_channels):
    """Innovations, H, R and which rows are used; by the sub's own channels once l is known."""
    to_middle(lane, model, tape)
    alignment.look(lane, tape, AT.MEAN, own_channels)
    velocity = lane.row[VELOCITY] ** 2
    if lane.P[AT.LEVER, AT.LEVER] > 0.0:
        velocity += (ENTRY * math.exp(-lane.k * model.dt / ENTRY_SECONDS)) ** 2
    for i in range(3):
        lane.R[i] = velocity
        lane.R[3 + i] = model.rate
        lane.used[i] = 1
        lane.used[3 + i] = 1 if tape.gap == 0 else 0
