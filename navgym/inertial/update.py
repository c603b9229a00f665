"""The update of an error-state filter, compiled: measurements one by one, sparse, weighted, judged.

    z_c = h_c(x) + v_c,   v_c ~ N(0, R_c) independent,   c = 0 ... m − 1

Each row of H = ∂h/∂x touches few of the n states: `H[c, a]` is its weight on state `index[c, a]`, for
a < `touched[c]` ≤ w. Rows are used one after the other, all linearised at the prediction, which equals
the block update since their noises are independent; the order matters to rounding only.

It knows states by number and sensors by row, and so serves any error-state filter. A filter is a
record type, `fields(n, m, w)` and what its own physics needs, and a step of its own:

    begin      lanes at x0, P0, and once `touch(lanes, rows)`: which states each row touches
    predict    x, P                                                         the filter's physics
    linearise  `innovation` z − h(x⁻), `H`, `R`, `used` of every row        the filter's sensors
    judge      NIS and log-likelihood, where they are wanted
    expect     x⁻ and the variance of every innovation
    weigh      or `gate`, or `trust`: what each row is worth, `weight` C; the update takes R/C
    correct    x and P                                        (`robust` is weigh and correct, iterated)
    check      health: a lane that failed or ran away is flagged

A sensor that is silent in a step has `used` 0, or an innovation of NaN and `hear` says so. For
instance an INS with a DVL of 18 states: a DVL's beam touches velocity, attitude and scale (w = 7), a
depth gauge one position and one bias, each with its R; m counts the rows of all sensors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.compile import part
from navgym.core.health import NUMERICAL, SPIKE, settle, watch_power

WIDTH_OFF = 50.0 - 1e-9  # a kernel of this width or more is a Kalman filter; 50, to rounding
FLOOR = 1e-12  # of a correntropy weight: R/C stays finite
LOG_2PI = math.log(2.0 * math.pi)
BEYOND = 10.0  # of a wrong row's standard deviations: farther off it tells nothing at all

_f8, _i8 = np.float64, np.int64
RULE = [  # fields of a record that says how `robust` updates
    ("iterations", _i8),  # fixed-point iterations of the weights; 1: from the innovation alone
    ("by_noise", _i8),  # 1: weights are judged by R and not by S
    ("printed_covariance", _i8),  # 1: IDAM eq. 51 as printed
]


def fields(n: int, m: int, w: int) -> list[tuple[str, Any, tuple[int, ...]]]:
    """Fields of a lane with n states and m rows that touch at most w states each."""
    return [
        ("x", _f8, (n,)),
        ("P", _f8, (n, n)),
        # what a filter fills in every step
        ("innovation", _f8, (m,)),
        ("H", _f8, (m, w)),
        ("R", _f8, (m,)),
        ("used", _i8, (m,)),
        # what the update finds
        ("weight", _f8, (m,)),
        ("variance", _f8, (m,)),  # diagonal of S = H P⁻ Hᵀ + R
        ("nis", _f8, ()),
        ("log_likelihood", _f8, ()),
        ("power", _f8, ()),
        ("diverged", _i8, ()),
        # which states the rows touch
        ("index", np.uint64, (m, w)),  # unsigned: numba need not ask whether it counts from the end
        ("touched", _i8, (m,)),
        # scratch
        ("x_prior", _f8, (n,)),
        ("P_prior", _f8, (n, n)),
        ("column", _f8, (n,)),
        ("PH", _f8, (m, n)),
        ("S", _f8, (m, m)),
        ("white", _f8, (m,)),
    ]


def touch(lanes: NDArray[Any], rows: Sequence[Sequence[int]]) -> None:
    """Tell lanes (N,) which states each of their m rows touches, in the order of the row's `H`.

    Raises ValueError where the lanes have another number of rows, too little room, or fewer states.
    """
    m, w = lanes.dtype["index"].shape
    n = lanes.dtype["x"].shape[0]
    if len(rows) != m or max(map(len, rows)) > w or any(not 0 <= j < n for r in rows for j in r):
        raise ValueError(
            f"rows must be {m}, of at most {w} states below {n} each, got {[list(r) for r in rows]}."
        )
    for c, row in enumerate(rows):
        lanes["index"][:, c, : len(row)] = row
        lanes["touched"][:, c] = len(row)


@part
def transpose(lane):
    """P ← Pᵀ: F P Fᵀ is F (F P)ᵀ, where F's few blocks act on rows."""
    for i in range(lane.x.shape[0]):
        for j in range(i):
            p = lane.P[i, j]
            lane.P[i, j] = lane.P[j, i]
            lane.P[j, i] = p


@part
def hear(lane):
    """Use the rows whose innovation is a number; returns how many."""
    count = 0
    for c in range(lane.innovation.shape[0]):
        lane.used[c] = 0 if math.isnan(lane.innovation[c]) else 1
        count += lane.used[c]
    return count


# Loops over whole matrices are functions of arrays: in a lane's own fields, whose addresses it cannot
# tell apart, the compiler takes one number at a time (a factor of three; the numbers are the same)


@part
def take_off(P, v, sign):
    """P ← P − sign v vᵀ."""
    for i in range(v.shape[0]):
        a = sign * v[i]
        for j in range(v.shape[0]):
            P[i, j] -= a * v[j]


@part
def copy(P, other):
    """P ← other."""
    for i in range(P.shape[0]):
        for j in range(P.shape[1]):
            P[i, j] = other[i, j]


@part
def add_moments(P, w, other, v):
    """P ← P + w (other + v vᵀ)."""
    for i in range(v.shape[0]):
        d = w * v[i]
        for j in range(v.shape[0]):
            P[i, j] += w * other[i, j] + d * v[j]


@part
def add_rows(column, P, H, index, count):
    """column ← sum of `count` rows of P, by number in `index` and times H."""
    for i in range(column.shape[0]):
        column[i] = 0.0
    for a in range(count):
        h, row = H[a], P[index[a]]
        for i in range(column.shape[0]):
            column[i] += h * row[i]


@part
def project(lane, c):
    """column = P H_cᵀ for row c, and H_c P H_cᵀ, which is returned."""
    add_rows(lane.column, lane.P, lane.H[c], lane.index[c], lane.touched[c])
    total = 0.0
    for a in range(lane.touched[c]):
        total += lane.H[c, a] * lane.column[lane.index[c, a]]
    return total


# `spread` adds up several sums at once, each in its own order: one alone would wait for itself


@part
def spread(lane, c):
    """H_c P H_cᵀ from the few states that row c touches."""
    P, total = lane.P, 0.0
    w = lane.touched[c]
    for a in range(0, w - 3, 4):
        i0, i1 = lane.index[c, a], lane.index[c, a + 1]
        i2, i3 = lane.index[c, a + 2], lane.index[c, a + 3]
        s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
        for b in range(w):
            h, j = lane.H[c, b], lane.index[c, b]
            s0 += h * P[i0, j]
            s1 += h * P[i1, j]
            s2 += h * P[i2, j]
            s3 += h * P[i3, j]
        total += lane.H[c, a] * s0
        total += lane.H[c, a + 1] * s1
        total += lane.H[c, a + 2] * s2
        total += lane.H[c, a + 3] * s3
    for a in range(w - w % 4, w):
        s, i = 0.0, lane.index[c, a]
        for b in range(w):
            s += lane.H[c, b] * P[i, lane.index[c, b]]
        total += lane.H[c, a] * s
    return total


@part
def shift(lane, c):
    """H_c (x − x⁻): by how much the updates so far have moved the prediction of row c."""
    total = 0.0
    for a in range(lane.touched[c]):
        j = lane.index[c, a]
        total += lane.H[c, a] * (lane.x[j] - lane.x_prior[j])
    return total


@part
def innovate(lane):
    """S = H P⁻ Hᵀ + R, its lower triangle."""
    S = lane.S
    for c in range(lane.innovation.shape[0]):
        project(lane, c)
        for i in range(lane.x.shape[0]):
            lane.PH[c, i] = lane.column[i]
        for d in range(c + 1):
            s = 0.0
            for a in range(lane.touched[d]):
                s += lane.H[d, a] * lane.PH[c, lane.index[d, a]]
            S[c, d] = s
        S[c, c] += lane.R[c]


@part
def judge(lane):
    """NIS and log-likelihood of the used innovations under S = H P⁻ Hᵀ + R, unweighted."""
    innovate(lane)
    whiten(lane)


@part
def whiten(lane):
    """NIS and log-likelihood of the used innovations under S, which is overwritten."""
    S, count, log_det, nis = lane.S, 0, 0.0, 0.0
    for c in range(lane.innovation.shape[0]):  # Cholesky factor in place, innovation whitened
        if not lane.used[c]:
            for d in range(c):
                S[c, d] = 0.0
            S[c, c] = 1.0
        for d in range(c + 1):
            s = S[c, d]
            if not lane.used[d] and d < c:
                s = 0.0
            for a in range(d):
                s -= S[c, a] * S[d, a]
            S[c, d] = math.sqrt(s) if d == c else s / S[d, d]
        z = lane.innovation[c] if lane.used[c] else 0.0
        for d in range(c):
            z -= S[c, d] * lane.white[d]
        lane.white[c] = z / S[c, c]
        if lane.used[c]:
            count += 1
            nis += lane.white[c] ** 2
            log_det += 2.0 * math.log(S[c, c])
    lane.nis = nis if count > 0 else math.nan
    lane.log_likelihood = -0.5 * (nis + log_det + count * LOG_2PI) if count > 0 else math.nan


@part
def expect(lane):
    """x⁻ is x, and what variance each innovation should have: R + H P⁻ Hᵀ."""
    for c in range(lane.innovation.shape[0]):
        lane.variance[c] = spread(lane, c) + lane.R[c]
    for i in range(lane.x.shape[0]):
        lane.x_prior[i] = lane.x[i]


@part
def trust(lane):
    """Every row has weight 1."""
    for c in range(lane.innovation.shape[0]):
        lane.weight[c] = 1.0


@part
def gate(lane, limit):
    """Weight 0 for rows whose innovation is beyond `limit` standard deviations, 1 for the others.

    A row that is left out still counts in `check`: a filter that believes nothing has run away.
    """
    for c in range(lane.innovation.shape[0]):
        e = lane.innovation[c]
        lane.weight[c] = 0.0 if e * e > limit * limit * lane.variance[c] else 1.0


@part
def weigh(lane, width, by_noise, iteration):
    """Weights by the correntropy criterion with a kernel of `width` (IDAM eq. 45, 53).

    Judged by S = H P Hᵀ + R, or by R alone, where a predictable innovation is rejected as soon as
    H P Hᵀ ≫ R. Beyond the first iteration the residual stands for the innovation.
    """
    for c in range(lane.innovation.shape[0]):
        lane.weight[c] = 1.0
        if width < WIDTH_OFF and lane.used[c]:
            e = lane.innovation[c]
            if iteration > 0:
                e -= shift(lane, c)
            scale = lane.R[c] if by_noise else lane.variance[c]
            lane.weight[c] = max(math.exp(-0.5 * e * e / (width * width * scale)), FLOOR)


@part
def correct(lane, printed_covariance):
    """x and P by the used rows in turn, each with R/C (IDAM eq. 50-52, corrected)."""
    n = lane.x.shape[0]
    for c in range(lane.innovation.shape[0]):
        if not lane.used[c] or lane.weight[c] == 0.0:
            continue
        R = lane.R[c] / lane.weight[c]
        S = project(lane, c) + R
        if not S > 0.0:
            lane.diverged = NUMERICAL
            S = math.nan
        e = (lane.innovation[c] - shift(lane, c)) / S
        root = 1.0 / math.sqrt(S)
        if printed_covariance:  # Pzz = H P Hᵀ C + R there: too little by the factor C
            root *= math.sqrt(lane.weight[c])
        for i in range(n):
            lane.x[i] += lane.column[i] * e
        for i in range(n):
            lane.column[i] *= root
        take_off(lane.P, lane.column, 1.0)


@part
def bound(lane, limit):
    """Cut innovations beyond `limit` standard deviations there, so that likelihoods stay numbers."""
    for c in range(lane.innovation.shape[0]):
        most = limit * math.sqrt(lane.variance[c])
        lane.innovation[c] = min(max(lane.innovation[c], -most), most)


@part
def mixture(lane, chance):
    """x and P by the used rows in turn, each wrong with probability `chance`; `expect` comes first.

    A wrong row's noise has variance `spike` beside R. Both ways its gain lies along P Hᵀ, so that the
    two posteriors, with weights w0 + w1 = 1 and S1 = S0 + spike, are one of the same moments by

        x += P Hᵀ (w0/S0 + w1/S1) e,   P −= P Hᵀ H P [w0/S0 + w1/S1 − w0 w1 (1/S0 − 1/S1)² e²].

    A row beyond `BEYOND` deviations of S1 is another kind of wrong, and moves nothing where it is wrong.
    Writes the log-likelihood of the rows, their NIS under the mixture's variance, and as `weight`
    w0, the probability that a row is right. With `chance` 0 it is a Kalman filter's update.
    """
    n, total, nis, count = lane.x.shape[0], 0.0, 0.0, 0
    for c in range(lane.innovation.shape[0]):
        lane.weight[c] = 1.0
        lane.variance[c] += chance * lane.spike[c]
        if not lane.used[c]:
            continue
        S = project(lane, c) + lane.R[c]
        if not S > 0.0:
            lane.diverged = NUMERICAL
            S = math.nan
        e = lane.innovation[c] - shift(lane, c)
        gain = 1.0 / S
        shrink = gain
        told = -0.5 * (e * e * gain + math.log(S) + LOG_2PI)
        if chance > 0.0:
            wide = 1.0 / (S + lane.spike[c])
            right = told + math.log(1.0 - chance)
            wrong = math.log(chance) - 0.5 * (e * e * wide - math.log(wide) + LOG_2PI)
            top = max(right, wrong)
            told = top + math.log(math.exp(right - top) + math.exp(wrong - top))
            w0, w1 = math.exp(right - told), math.exp(wrong - told)
            if e * e * wide > BEYOND * BEYOND:
                wide = 0.0
            shrink = w0 * gain + w1 * wide - w0 * w1 * ((gain - wide) * e) ** 2
            gain = w0 * gain + w1 * wide
            lane.weight[c] = w0
        total += told
        nis += e * e / (S + chance * lane.spike[c])
        count += 1
        for i in range(n):
            lane.x[i] += lane.column[i] * (gain * e)
        root, sign = math.sqrt(abs(shrink)), 1.0 if shrink > 0.0 else -1.0
        for i in range(n):
            lane.column[i] *= root
        take_off(lane.P, lane.column, sign)
    lane.nis = nis if count > 0 else math.nan
    lane.log_likelihood = total if count > 0 else 0.0


@part
def robust(lane, rule, width):
    """`weigh` and `correct`, `rule.iterations` times from the same prediction; `expect` comes first.

    The rule's fields are those of `RULE`.
    """
    n = lane.x.shape[0]
    if rule.iterations > 1:
        for i in range(n):
            for j in range(n):
                lane.P_prior[i, j] = lane.P[i, j]
    weigh(lane, width, rule.by_noise, 0)
    correct(lane, rule.printed_covariance)
    for iteration in range(1, rule.iterations):
        weigh(lane, width, rule.by_noise, iteration)
        for i in range(n):
            lane.x[i] = lane.x_prior[i]
            for j in range(n):
                lane.P[i, j] = lane.P_prior[i, j]
        correct(lane, rule.printed_covariance)


@part
def check(lane):
    """Flag a lane that failed or ran away (see `navgym.core.health`); a failed one answers NaN."""
    power, count = 0.0, 0
    for c in range(lane.innovation.shape[0]):
        if lane.used[c]:
            power += min(lane.innovation[c] ** 2 / lane.variance[c], SPIKE)
            count += 1
    if count > 0:
        watch_power(lane, power, count)
    settle(lane)
