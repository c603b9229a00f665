"""The update of an error-state filter sensor by sensor, compiled: up to three rows share one weight.

    r = H x + v,   v ~ N(0, R),   R diagonal,   r = predicted − measured, or the other way round

`navgym.inertial.update` treats rows one by one, each with a weight of its own. A Doppler log's ping that
is wrong is wrong as a whole, and a bank of noise scales is judged on the whole of it. So a block of rows
keeps T = H P Hᵀ and what every rule needs is three by three: hypotheses differ in R alone, S = T + R,
and each rule comes down to

    x = P Hᵀ a      P −= P Hᵀ W H P

    trust    a = S⁻¹ r                        W = S⁻¹
    student  the same with R/w, w = (ν + m)/(ν + E[rᵀR⁻¹r]), iterated (variational Student-t)
    mcc      the same with R/w, w = exp(−rᵀS⁻¹r / 2σ²): the correntropy criterion
    vb       the same with λR, λ inverse-gamma with a memory (Särkkä & Nummenmaa 2009, one scale)
    bank     a = Σ w_j a_j                    W = Σ w_j S_j⁻¹ − Σ w_j (a_j − a)(a_j − a)ᵀ

over S_j = T + s_j R, w_j ∝ π_j N(r; 0, S_j): one covariance, moment-matched, whatever the number of
hypotheses. Rows that a block lacks have T 0, R 1 and r 0, and change nothing.

A filter's lane has `block_fields`; its sensors fill `H`, `index`, `touched`, `rows`, `r` and `R`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.compile import part
from navgym.inertial.blocks import ROWS, SENSORS
from navgym.inertial.update import FLOOR, LOG_2PI

SCALES = np.array([0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0])  # of a bank's R
OUTLIER_RATE, OUTLIER = 0.05, 100.0  # each scale once more, so much larger
STAY = 0.97  # probability that a scale stays from one measurement to the next
VB_START = 4.0  # measurements that the first R counts for
VB_LEAST, VB_MOST = 0.1, 300.0  # bounds of λ: an R without bound runs away with a wrong prediction

_f8, _i8 = np.float64, np.int64


def block_fields(n: int, w: int) -> list[tuple[str, Any, tuple[int, ...]]]:
    """Fields of a lane with n states whose sensors touch at most w of them each."""
    return [
        ("P", _f8, (n, n)),
        ("H", _f8, (ROWS, w)),
        ("index", np.uint64, (w,)),
        ("touched", _i8, ()),
        ("rows", _i8, ()),
        ("r", _f8, (ROWS,)),
        ("R", _f8, (ROWS,)),
        # what the update finds
        ("dx", _f8, (n,)),
        ("block_nis", _f8, ()),  # rᵀ S⁻¹ r under R as it stands
        ("block_log", _f8, ()),  # log-likelihood of r, a bank's of its mixture
        ("weight", _f8, ()),  # what R was divided by
        # memory of each sensor
        ("chance", _f8, (SENSORS, len(SCALES))),
        ("count", _f8, (SENSORS,)),
        ("sum", _f8, (SENSORS,)),
        # scratch
        ("G", _f8, (ROWS, n)),
        ("GW", _f8, (ROWS, n)),
        ("T", _f8, (ROWS, ROWS)),
        ("S", _f8, (ROWS, ROWS)),
        ("W", _f8, (ROWS, ROWS)),
        ("a", _f8, (ROWS,)),
        ("b", _f8, (ROWS,)),
        ("each", _f8, (2 * len(SCALES), 4)),  # log weight and a_j of each hypothesis
    ]


def remember_nothing(lanes: NDArray[Any]) -> None:
    """Put the memories of lanes (N,) at their start."""
    lanes["chance"] = 1.0 / len(SCALES)
    lanes["count"] = lanes["sum"] = VB_START


# Loops over whole matrices are functions of arrays, see `navgym.inertial.update`.


@part
def gather_three(G, P, H, index, touched):
    """G ← H P of three rows, which touch few states."""
    for i in range(G.shape[1]):
        G[0, i], G[1, i], G[2, i] = 0.0, 0.0, 0.0
    for t in range(touched):
        h0, h1, h2, row = H[0, t], H[1, t], H[2, t], P[index[t]]
        for i in range(G.shape[1]):
            G[0, i] += h0 * row[i]
            G[1, i] += h1 * row[i]
            G[2, i] += h2 * row[i]


@part
def gather_one(G, P, H, index, touched):
    """The same of one row; the other two are zero."""
    for i in range(G.shape[1]):
        G[0, i], G[1, i], G[2, i] = 0.0, 0.0, 0.0
    for t in range(touched):
        h, row = H[0, t], P[index[t]]
        for i in range(G.shape[1]):
            G[0, i] += h * row[i]


@part
def take_off_three(P, GW, G):
    """P ← P − GWᵀ G of three rows."""
    for i in range(P.shape[0]):
        a, b, c = GW[0, i], GW[1, i], GW[2, i]
        for j in range(P.shape[1]):
            P[i, j] -= a * G[0, j] + b * G[1, j] + c * G[2, j]


@part
def take_off_one(P, GW, G):
    """The same of one row."""
    for i in range(P.shape[0]):
        a = GW[0, i]
        for j in range(P.shape[1]):
            P[i, j] -= a * G[0, j]


@part
def project_block(lane):
    """G = H P and T = H P Hᵀ; rows that are not there are filled in."""
    if lane.rows == ROWS:
        gather_three(lane.G, lane.P, lane.H, lane.index, lane.touched)
    else:
        gather_one(lane.G, lane.P, lane.H, lane.index, lane.touched)
    for c in range(ROWS):
        for d in range(ROWS):
            lane.T[c, d] = 0.0
        if c >= lane.rows:
            lane.R[c], lane.r[c] = 1.0, 0.0
    for c in range(lane.rows):
        for t in range(lane.touched):
            p = lane.G[c, lane.index[t]]
            for d in range(lane.rows):
                lane.T[c, d] += p * lane.H[d, t]


@part
def solve_block(lane, scale):
    """S = (T + scale R)⁻¹ in place of S and a = S r; returns rᵀ a and the logarithm of det(T + scale R).

    Rows that are not there have R 1 whatever the scale.
    """
    T, S = lane.T, lane.S
    s1, s2 = (scale if lane.rows > 1 else 1.0), (scale if lane.rows > 2 else 1.0)
    a, b, c = T[0, 0] + scale * lane.R[0], T[0, 1], T[0, 2]
    d, e, f = T[1, 1] + s1 * lane.R[1], T[1, 2], T[2, 2] + s2 * lane.R[2]
    m00, m01, m02 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * m00 + b * m01 + c * m02
    k = 1.0 / det
    S[0, 0], S[0, 1], S[0, 2] = k * m00, k * m01, k * m02
    S[1, 1], S[1, 2], S[2, 2] = k * (a * f - c * c), k * (b * c - a * e), k * (a * d - b * b)
    S[1, 0], S[2, 0], S[2, 1] = S[0, 1], S[0, 2], S[1, 2]
    nis = 0.0
    for i in range(ROWS):
        lane.a[i] = S[i, 0] * lane.r[0] + S[i, 1] * lane.r[1] + S[i, 2] * lane.r[2]
        nis += lane.r[i] * lane.a[i]
    return nis, math.log(det)


@part
def judge_block(lane):
    """NIS and log-likelihood of the block under R as it stands; `solve_block` has S and a for it."""
    nis, log_det = solve_block(lane, 1.0)
    lane.block_nis = nis
    lane.block_log = -0.5 * (nis + log_det + lane.rows * LOG_2PI)
    lane.weight = 1.0


@part
def misfit(lane, scale):
    """E[vᵀ R⁻¹ v] of the noise v after an update with scale R: residual and its variance.

    The residual is scale R a, and H P⁺ Hᵀ = scale R (I − S scale R).
    """
    total = 0.0
    for c in range(lane.rows):
        e = scale * lane.R[c] * lane.a[c]
        total += e * e / lane.R[c] + scale * (1.0 - lane.S[c, c] * scale * lane.R[c])
    return total


@part
def take_solution(lane):
    """W of a rule with one hypothesis."""
    for i in range(ROWS):
        for j in range(ROWS):
            lane.W[i, j] = lane.S[i, j]


@part
def weigh_student(lane, freedom, iterations):
    """Student-t noise with `freedom` degrees, by the variational fixed point."""
    for _ in range(iterations):
        m = lane.rows
        lane.weight = (freedom + m) / (freedom + misfit(lane, 1.0 / lane.weight))
        solve_block(lane, 1.0 / lane.weight)
    take_solution(lane)


@part
def weigh_correntropy(lane, width):
    """A weight by the correntropy criterion with a kernel of `width`."""
    lane.weight = max(math.exp(-0.5 * lane.block_nis / (width * width)), FLOOR)
    solve_block(lane, 1.0 / lane.weight)
    take_solution(lane)


@part
def weigh_gate(lane, limit):
    """Leave the block out where its NIS is beyond `limit`."""
    take_solution(lane)
    if lane.block_nis > limit:
        lane.weight = 0.0
        for i in range(ROWS):
            lane.a[i] = 0.0
            for j in range(ROWS):
                lane.W[i, j] = 0.0


@part
def weigh_variational(lane, sensor, keep, iterations):
    """λ of λR, inverse-gamma with shape ½ count and scale ½ sum, of which `keep` is remembered."""
    count, total = keep * lane.count[sensor], keep * lane.sum[sensor]
    scale = min(max(total / count, VB_LEAST), VB_MOST)
    for _ in range(iterations):
        solve_block(lane, scale)
        scale = (total + misfit(lane, scale)) / (count + lane.rows)
        scale = min(max(scale, VB_LEAST), VB_MOST)
    lane.count[sensor] = count + lane.rows
    lane.sum[sensor] = scale * lane.count[sensor]
    lane.weight = 1.0 / scale
    solve_block(lane, scale)
    take_solution(lane)


@part
def weigh_bank(lane, sensor):
    """Mix hypotheses over the scale of R by how well they foretell r, and remember how well each did."""
    count, best = SCALES.shape[0], -math.inf
    for j in range(count):
        prior = STAY * lane.chance[sensor, j] + (1.0 - STAY) / count
        for o in range(2):
            scale = SCALES[j] * (OUTLIER if o else 1.0)
            nis, log_det = solve_block(lane, scale)
            chance = prior * (OUTLIER_RATE if o else 1.0 - OUTLIER_RATE)
            h = 2 * j + o
            lane.each[h, 0] = math.log(chance) - 0.5 * (nis + log_det)
            for i in range(ROWS):
                lane.each[h, 1 + i] = lane.a[i]
            best = max(best, lane.each[h, 0])
    total, lane.weight = 0.0, 0.0
    for i in range(ROWS):
        lane.b[i] = 0.0
        for j in range(ROWS):
            lane.W[i, j] = 0.0
    for h in range(2 * count):
        w = math.exp(lane.each[h, 0] - best)
        lane.each[h, 0] = w
        total += w
        for i in range(ROWS):
            lane.b[i] += w * lane.each[h, 1 + i]
    for i in range(ROWS):
        lane.b[i] /= total
    for h in range(2 * count):
        scale = SCALES[h // 2] * (OUTLIER if h % 2 else 1.0)
        w = lane.each[h, 0] / total
        if w > 1e-9:
            solve_block(lane, scale)
            for i in range(ROWS):
                di = lane.each[h, 1 + i] - lane.b[i]
                for j in range(ROWS):
                    dj = lane.each[h, 1 + j] - lane.b[j]
                    lane.W[i, j] += w * (lane.S[i, j] - di * dj)
        lane.weight += w / scale
    for j in range(count):
        lane.chance[sensor, j] = (lane.each[2 * j, 0] + lane.each[2 * j + 1, 0]) / total
    for i in range(ROWS):
        lane.a[i] = lane.b[i]
    lane.block_log = math.log(total) + best - 0.5 * lane.rows * LOG_2PI


@part
def apply_block(lane):
    """dx = P Hᵀ a and P −= P Hᵀ W H P."""
    n, m = lane.P.shape[0], lane.rows
    for i in range(n):
        lane.dx[i] = 0.0
    for c in range(m):
        a, w0, w1, w2 = lane.a[c], lane.W[c, 0], lane.W[c, 1], lane.W[c, 2]
        for i in range(n):
            lane.dx[i] += a * lane.G[c, i]
        if m == ROWS:
            for i in range(n):
                lane.GW[c, i] = w0 * lane.G[0, i] + w1 * lane.G[1, i] + w2 * lane.G[2, i]
        else:
            for i in range(n):
                lane.GW[c, i] = w0 * lane.G[0, i]
    if m == ROWS:
        take_off_three(lane.P, lane.GW, lane.G)
    else:
        take_off_one(lane.P, lane.GW, lane.G)
