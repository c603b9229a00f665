"""How the modes of a bank are updated and weighed by a sample, and what their mixture says.

Where an outlier may occur, it is a further Gaussian *within* the step, not a mode that persists: the
updates are weighed by their likelihoods and collapsed to one by their moments.

As in `mixing`, inner loops run over modes.
"""

from __future__ import annotations

import math

from navgym.core.compile import part, sums
from navgym.core.health import NUMERICAL
from navgym.core.sizes import sample_size, state_size
from navgym.statespace.filters.lane import LOG_2PI
from navgym.statespace.filters.modes import BIAS

CANCELLATION = 1e-6  # a variance shrunk by more than this in one update has lost digits: use Joseph
TINY = 1e-300


@sums
def believe(lane, work, design, model, r, rate):
    """R_used: what the bank believes the measurement noise to be, in the mean of its modes."""
    axes, J = lane.axes, design.modes
    p, s_count = state_size(lane) // axes, sample_size(lane) // axes
    for i in range(sample_size(lane)):
        for k in range(sample_size(lane)):
            lane.R_used[i, k] = 0.0
    for i in range(s_count):
        for k in range(i + 1):
            grown = 0.0  # by outliers, in the mean
            for b in range(1, design.branches):
                factor = design.branch_root[b, i] * design.branch_root[b, k]
                grown += rate * design.branch_share[b] * (factor - 1.0)
            s0, s1 = 0.0, 0.0
            for j in range(J):
                s0 += work.before.weight[j] * design.root[i, j] * design.root[k, j]
            for j in range(design.plain, design.unbiased):
                s1 += work.before.weight[j] * design.root[i, j] * design.root[k, j]
            s = (s0 + grown * s1) * r * model.R[i, k]
            for c in range(design.biases // axes):
                for d in range(design.biases // axes):
                    h = model.H[i, design.velocity[c]] * model.H[k, design.velocity[d]]
                    if h != 0.0:
                        a, b = max(c, d), min(c, d)
                        for j in range(design.unbiased, J):
                            s += work.before.weight[j] * h * work.before.cov[p + a, p + b, j]
            for g in range(axes):
                lane.R_used[g * s_count + i, g * s_count + k] = s
                lane.R_used[g * s_count + k, g * s_count + i] = s


@part
def observe_modes(lane, work, design, model, lo, hi, extra):
    """H C⁻ of modes lo to hi, for the used rows."""
    mix, axes = work.before, lane.axes
    p = state_size(lane) // axes
    s_count = sample_size(lane) // axes
    count = 0
    for i in range(s_count):
        if lane.use[i]:
            work.used[count] = i
            count += 1
            for k in range(p + extra):
                for j in range(lo, hi):
                    work.HC[i, k, j] = 0.0
                for h in range(p + extra):
                    f = model.H[i, h] if h < p else model.H[i, design.velocity[h - p]]
                    if f != 0.0:
                        a, b = max(h, k), min(h, k)
                        for j in range(lo, hi):
                            work.HC[i, k, j] += f * mix.cov[a, b, j]
    work.count = count


@part
def judge_modes(lane, work, design, model, lo, hi, extra, branch, r):
    """Innovations of modes lo to hi under one branch: L, e = L⁻¹ (y − H m⁻), NIS, |S|^−½."""
    mix, axes = work.before, lane.axes
    p, s_count, count = state_size(lane) // axes, sample_size(lane) // axes, work.count
    for j in range(lo, hi):
        work.nis[branch, j] = 0.0
        work.odds[branch, j] = 1.0
    for u in range(count):
        i = work.used[u]
        for v in range(u + 1):
            k = work.used[v]
            f = r * model.R[i, k] * design.branch_root[branch, i] * design.branch_root[branch, k]
            for j in range(lo, hi):
                work.row[j] = f * (design.root[i, j] * design.root[k, j])
            for h in range(p + extra):
                f = model.H[k, h] if h < p else model.H[k, design.velocity[h - p]]
                if f != 0.0:
                    for j in range(lo, hi):
                        work.row[j] += f * work.HC[i, h, j]
            for w in range(v):
                h = work.used[w]
                for j in range(lo, hi):
                    work.row[j] -= work.L[branch, i, h, j] * work.L[branch, k, h, j]
            if u == v:
                for j in range(lo, hi):
                    d = 1.0 / math.sqrt(work.row[j])
                    work.d[branch, i, j] = d
                    work.odds[branch, j] *= d if axes == 1 else d * d
            else:
                for j in range(lo, hi):
                    work.L[branch, i, k, j] = work.row[j] * work.d[branch, k, j]
        for g in range(axes):
            y = lane.y[g * s_count + i]
            for j in range(lo, hi):
                work.row[j] = y
            for h in range(p + extra):
                f = model.H[i, h] if h < p else model.H[i, design.velocity[h - p]]
                if f != 0.0:
                    for j in range(lo, hi):
                        work.row[j] -= f * mix.mean[h * axes + g, j]
            for w in range(u):
                h = work.used[w]
                for j in range(lo, hi):
                    work.row[j] -= work.L[branch, i, h, j] * work.e[branch, g * s_count + h, j]
            for j in range(lo, hi):
                e = work.row[j] * work.d[branch, i, j]
                work.e[branch, g * s_count + i, j] = e
                work.nis[branch, j] += e * e


@part
def exp_falling(x):
    """e^x of x ≤ 0, to 3e-13: Padé's [4/4] of x/1024, squared ten times. Unlike libm's it vectorises."""
    x = max(x, -740.0) * (1.0 / 1024.0)
    y = x * x
    even, odd = 1680.0 + y * (180.0 + y), x * (840.0 + y * 20.0)
    s = (even + odd) / (even - odd)
    s *= s
    s *= s
    s *= s
    s *= s
    s *= s
    s *= s
    s *= s
    s *= s
    s *= s
    return s * s


@part
def weigh(lane, work, design, rate, received):
    """Weigh modes and branches by their likelihoods; notes the mixture's log-likelihood."""
    J, lo, hi = design.modes, design.plain, design.unbiased
    branches = design.branches if rate > 0.0 else 1
    least = math.inf
    for j in range(J):
        least = min(least, work.nis[0, j])
    for b in range(1, branches):
        for j in range(lo, hi):
            least = min(least, work.nis[b, j])
    for j in range(J):
        work.odds[0, j] *= exp_falling(0.5 * (least - work.nis[0, j]))
        work.likelihood[j] = work.odds[0, j]
    if branches > 1:
        for j in range(lo, hi):
            work.odds[0, j] *= 1.0 - rate
            work.likelihood[j] = work.odds[0, j]
        for b in range(1, branches):
            share = rate * design.branch_share[b]
            for j in range(lo, hi):
                work.odds[b, j] *= share * exp_falling(0.5 * (least - work.nis[b, j]))
                work.likelihood[j] += work.odds[b, j]
    total = 0.0
    for j in range(J):
        lane.after.weight[j] = work.before.weight[j] * work.likelihood[j]
        total += lane.after.weight[j]
    if not total > 0.0:
        lane.diverged = NUMERICAL
    each = 1.0 / total
    for j in range(J):
        lane.after.weight[j] *= each
    lane.log_likelihood = math.log(max(total, TINY)) - 0.5 * (least + received * LOG_2PI)


@part
def correct_modes(lane, work, design, model, lo, hi, extra, branch, r):
    """Update modes lo to hi under one branch, and merge it with the branches before by moments."""
    old, new, axes = work.before, lane.after, lane.axes
    p, s_count, count = state_size(lane) // axes, sample_size(lane) // axes, work.count
    size = p + extra
    for u in range(count):
        i = work.used[u]
        for k in range(size):
            for j in range(lo, hi):
                work.row[j] = work.HC[i, k, j]
            for w in range(u):
                h = work.used[w]
                for j in range(lo, hi):
                    work.row[j] -= work.L[branch, i, h, j] * work.G[h, k, j]
            for j in range(lo, hi):
                work.G[i, k, j] = work.row[j] * work.d[branch, i, j]
    exact = cancels(work, lo, hi, size, count)
    if exact:
        gain(work, design, model, lo, hi, p, size, count, branch)
    if branch > 0:  # the share of this branch among those so far
        for j in range(lo, hi):
            work.odds[0, j] += work.odds[branch, j]
            work.share[j] = work.odds[branch, j] / max(work.odds[0, j], TINY)
    for k in range(size):
        for g in range(axes):
            x = k * axes + g
            for j in range(lo, hi):
                work.move[x, j] = old.mean[x, j]
            for u in range(count):
                i = work.used[u]
                for j in range(lo, hi):
                    work.move[x, j] += work.G[i, k, j] * work.e[branch, g * s_count + i, j]
            if branch == 0:
                for j in range(lo, hi):
                    new.mean[x, j] = work.move[x, j]
            else:
                for j in range(lo, hi):
                    work.move[x, j] -= new.mean[x, j]
    each = 1.0 / axes
    for i in range(size):
        for k in range(i + 1):
            if exact:
                joseph_entry(work, design, model, lo, hi, size, count, branch, r, i, k)
            else:
                for j in range(lo, hi):
                    work.row[j] = old.cov[i, k, j]
                for u in range(count):
                    h = work.used[u]
                    for j in range(lo, hi):
                        work.row[j] -= work.G[h, i, j] * work.G[h, k, j]
            if branch == 0:
                for j in range(lo, hi):
                    new.cov[i, k, j] = work.row[j]
            else:
                for g in range(axes):
                    for j in range(lo, hi):
                        s = work.move[i * axes + g, j] * work.move[k * axes + g, j]
                        work.row[j] += (1.0 - work.share[j]) * s * each
                for j in range(lo, hi):
                    new.cov[i, k, j] += work.share[j] * (work.row[j] - new.cov[i, k, j])
    if branch > 0:
        for x in range(size * axes):
            for j in range(lo, hi):
                new.mean[x, j] += work.share[j] * work.move[x, j]


@part
def cancels(work, lo, hi, size, count):
    """Whether a variance of modes lo to hi shrinks so much that a difference has lost its digits."""
    lost = 0
    for k in range(size):
        for j in range(lo, hi):
            work.row[j] = 0.0
        for u in range(count):
            i = work.used[u]
            for j in range(lo, hi):
                work.row[j] += work.G[i, k, j] * work.G[i, k, j]
        for j in range(lo, hi):
            if not work.row[j] < (1.0 - CANCELLATION) * work.before.cov[k, k, j]:
                lost += 1
    return lost > 0


@part
def gain(work, design, model, lo, hi, p, size, count, branch):
    """Gains Kᵀ = L⁻ᵀ G, A = I − K H, and A C⁻: what Joseph's form is made of."""
    for u in range(count - 1, -1, -1):
        i = work.used[u]
        for k in range(size):
            for j in range(lo, hi):
                work.row[j] = work.G[i, k, j]
            for w in range(u + 1, count):
                h = work.used[w]
                for j in range(lo, hi):
                    work.row[j] -= work.L[branch, h, i, j] * work.K[h, k, j]
            for j in range(lo, hi):
                work.K[i, k, j] = work.row[j] * work.d[branch, i, j]
    for i in range(size):
        for k in range(size):
            for j in range(lo, hi):
                work.A[i, k, j] = 1.0 if i == k else 0.0
            for u in range(count):
                h = work.used[u]
                f = model.H[h, k] if k < p else model.H[h, design.velocity[k - p]]
                if f != 0.0:
                    for j in range(lo, hi):
                        work.A[i, k, j] -= f * work.K[h, i, j]
    for i in range(size):
        for k in range(size):
            for j in range(lo, hi):
                s = 0.0
                for h in range(size):
                    s += work.A[i, h, j] * work.before.cov[max(h, k), min(h, k), j]
                work.FC[i, k, j] = s


@part
def joseph_entry(work, design, model, lo, hi, size, count, branch, r, i, k):
    """Entry (i, k) of (I − K H) C⁻ (I − K H)ᵀ + K R Kᵀ, into `row`."""
    for j in range(lo, hi):
        s = 0.0
        for h in range(size):
            s += work.FC[i, h, j] * work.A[k, h, j]
        work.row[j] = s
    for u in range(count):
        a = work.used[u]
        for v in range(count):
            b = work.used[v]
            f = r * model.R[a, b] * design.branch_root[branch, a] * design.branch_root[branch, b]
            for j in range(lo, hi):
                scale = design.root[a, j] * design.root[b, j]
                work.row[j] += f * scale * work.K[a, i, j] * work.K[b, k, j]


@part
def group(lane, design, e):
    """Modes from ... to, how many errors of velocity sensors an axis has there, and the branch."""
    lo, hi, extra = design.plain, design.unbiased, 0
    if e == 0:
        lo -= lo
    elif e == 1:
        lo, hi, extra = hi, design.modes, design.biases // lane.axes
    return lo, hi, extra, max(e - 1, 0)


@sums
def combine(lane, work, design):
    """Mean and covariance of the modes after a sample, into x and P."""
    mix, axes, n, J = lane.after, lane.axes, state_size(lane), design.modes
    p = n // axes
    for i in range(p):
        for g in range(axes):
            r, x = i * axes + g, 0.0
            for j in range(J):
                x += mix.weight[j] * mix.mean[r, j]
            lane.x[g * p + i] = x
            for j in range(J):
                work.off[r, j] = mix.mean[r, j] - x
                work.move[r, j] = mix.weight[j] * work.off[r, j]
    for i in range(p):
        for k in range(i + 1):
            within = 0.0
            for j in range(J):
                within += mix.weight[j] * mix.cov[i, k, j]
            for g in range(axes):
                for h in range(axes):
                    a, b = i * axes + g, k * axes + h
                    s = within if g == h else 0.0
                    for j in range(J):
                        s += work.move[a, j] * work.off[b, j]
                    lane.P[g * p + i, h * p + k] = s
                    lane.P[h * p + k, g * p + i] = s


@part
def foretell(lane, work, design):
    """x⁻ = F x, P⁻ = F P Fᵀ + E Q of the mixture: what modes exchange changes no moment of it."""
    n, axes = state_size(lane), lane.axes
    p = n // axes
    for i in range(n):
        lane.x_prior[i] = 0.0
        for k in range(n):
            lane.T[i, k] = 0.0
            lane.P_prior[i, k] = 0.0
    for g in range(axes):
        for i in range(p):
            for h in range(p):
                lane.x_prior[g * p + i] += lane.F[i, h] * lane.origin[g * p + h]
                for k in range(n):
                    lane.T[g * p + i, k] += lane.F[i, h] * lane.origin_P[g * p + h, k]
    for b in range(design.regimes):
        w, kind = 0.0, design.motion[b] % BIAS
        for j in range(design.begin[b], design.begin[b + 1]):
            w += work.before.weight[j] * design.process[j]
        for g in range(axes):
            for i in range(p):
                for k in range(p):
                    lane.P_prior[g * p + i, g * p + k] += w * work.Q[kind, i, k]
    for i in range(n):
        for k in range(i + 1):
            first, own = (k // p) * p, k % p
            for h in range(p):
                lane.P_prior[i, k] += lane.T[i, first + h] * lane.F[own, h]
            lane.P_prior[k, i] = lane.P_prior[i, k]
