"""How the modes of a bank move and leak to each other between two received samples.

Mixing is done in moments (weight, weighted mean, weighted second moment), which the transition maps
linearly (Blom & Bar-Shalom 1988 in another order). The transition is the product of two leaks: with
T_N the leak between nodes and T_G that between regimes, T_N[a, a'] T_G[b, b'] leaks from mode (a, b) to
(a', b') if that exists, over the sum of these. A leak keeps a share, gives some to what stands beside,
and spreads the rest by the priors; so mixing takes O(J).

Arrays of modes have the mode as their last index, and inner loops run over modes: they become vector
instructions whatever the size of the model, and zeros of F and H are left out at no cost. Of symmetric
matrices only the lower triangle is kept. Lanes and scratch are those of `bank`.
"""

from __future__ import annotations

import math

from navgym.core.compile import part
from navgym.core.sizes import state_size
from navgym.statespace.filters.lane import PERIOD
from navgym.statespace.filters.modes import BIAS, LATE, MODEL

TINY = 1e-300


@part
def unfold(lane, design):
    """From one covariance for two axes to one for the whole state."""
    n = state_size(lane)
    p, mix = n // 2, lane.after
    for a in range(n):
        for b in range(n):
            same = a // p == b // p
            lane.F[a, b] = lane.F[a % p, b % p] if same else 0.0
            lane.Q[a, b] = lane.Q[a % p, b % p] if same else 0.0
    extra = design.biases // 2
    size = p + extra
    for j in range(design.modes):
        for r in range(n):
            lane.x_prior[r] = mix.mean[r, j]
        for r in range(n):
            mix.mean[r, j] = lane.x_prior[(r % p) * 2 + r // p]
        for r in range(2 * extra):  # errors of axis g stand together, as states do
            lane.x_prior[r] = mix.mean[n + r, j]
        for r in range(2 * extra):
            mix.mean[n + r, j] = lane.x_prior[(r % extra) * 2 + r // extra]
        for a in range(size):
            for b in range(a + 1):
                lane.T[a, b] = mix.cov[a, b, j]
        for a in range(n + 2 * extra):
            for b in range(a + 1):
                mix.cov[a, b, j] = 0.0
        for g in range(2):
            for a in range(size):
                row = g * p + a if a < p else n + g * extra + a - p
                for b in range(a + 1):
                    column = g * p + b if b < p else n + g * extra + b - p
                    mix.cov[row, column, j] = lane.T[a, b]
    lane.axes = 1


@part
def move_on(lane, design, model, q, t):
    """Add a row's motion of one axis: F ← F_k F, Q ← F_k Q F_kᵀ + q Q_k."""
    p = state_size(lane) // lane.axes
    dt = t - lane.row_time if lane.row_time <= t else PERIOD
    lane.row_time = t
    if lane.rows_since == 0:
        for i in range(p):
            for k in range(p):
                lane.F[i, k] = model.F[i, k]
                lane.Q[i, k] = q * model.Q[i, k]
        lane.fade = math.exp(-dt / design.memory)
    else:
        carry(lane, model, q, p)
        lane.fade *= math.exp(-dt / design.memory)


@part
def carry(lane, model, q, p):
    """A further row's F and Q."""
    for i in range(p):
        for k in range(p):
            s = 0.0
            for h in range(p):
                s += model.F[i, h] * lane.F[h, k]
            lane.T[i, k] = s
    for i in range(p):
        for k in range(p):
            lane.F[i, k] = lane.T[i, k]
    for i in range(p):
        for k in range(p):
            s = 0.0
            for h in range(p):
                s += model.F[i, h] * lane.Q[h, k]
            lane.T[i, k] = s
    for i in range(p):
        for k in range(i + 1):
            s = q * model.Q[i, k]
            for h in range(p):
                s += lane.T[i, h] * model.F[k, h]
            lane.Q[i, k] = s
            lane.Q[k, i] = s


@part
def motions(lane, work, design):
    """Q by kind of motion. What pushes a velocity that is measured late has moved the position."""
    p = state_size(lane) // lane.axes
    for i in range(p):
        for k in range(p):
            work.Q[MODEL, i, k] = lane.Q[i, k]
            work.Q[LATE, i, k] = lane.Q[i, k]
    for c in range(design.pairs // lane.axes):
        for k in range(p):
            moved = design.lag * work.Q[LATE, design.velocity[c], k]
            work.Q[LATE, design.position[c], k] += moved
    for c in range(design.pairs // lane.axes):
        for k in range(p):
            moved = design.lag * work.Q[LATE, k, design.velocity[c]]
            work.Q[LATE, k, design.position[c]] += moved


@part
def age_by(work, design, age, scale_stay, regime_stay):
    """What stays and what leaks over so many seconds; nothing to do where it is known already."""
    if work.known[0] == age and work.known[1] == scale_stay and work.known[2] == regime_stay:
        return
    work.known[0], work.known[1], work.known[2] = age, scale_stay, regime_stay
    work.node_stay = scale_stay**age
    out = 1.0 - work.node_stay
    for b in range(design.regimes):
        work.stay[b] = max(1.0 - design.leak[b] * (1.0 - regime_stay), 0.0) ** age
        stay = work.stay[b]
        for j in range(design.begin[b], design.begin[b + 1]):
            a = design.node[j]
            here = stay + (1.0 - stay) * design.to_regimes[a]
            away = stay * (design.spread[a] * design.to_nodes[b] + design.to_near[j])
            away += (1.0 - stay) * (design.spread[a] * design.to_all + design.to_near_nodes[a])
            work.norm[j] = 1.0 / (work.node_stay * here + out * away)


@part
def gather(lane, work, design):
    """Moments of the modes about the bank's mean: weight, w d, w (P + d dᵀ averaged over axes).

    Returns how many there are.
    """
    mix, axes, J = lane.after, lane.axes, design.modes
    p = state_size(lane) // axes
    for j in range(J):
        work.share[j] = mix.weight[j] * work.norm[j]
        work.moment[j, 0] = work.share[j]
    c = 1
    for i in range(p):
        for g in range(axes):
            r, origin = i * axes + g, lane.origin[g * p + i]
            for j in range(J):
                work.off[r, j] = mix.mean[r, j] - origin
                work.moment[j, c] = work.share[j] * work.off[r, j]
            c += 1
    each = 1.0 / axes
    for i in range(p):
        for k in range(i + 1):
            for j in range(J):
                work.row[j] = mix.cov[i, k, j]
            for g in range(axes):
                for j in range(J):
                    work.row[j] += each * work.off[i * axes + g, j] * work.off[k * axes + g, j]
            for j in range(J):
                work.moment[j, c] = work.share[j] * work.row[j]
            c += 1
    return c


@part
def leak(work, design, K):
    """Sum up what leaves: the nodes, by regime; the regimes, by node; and what of that comes back."""
    out = 1.0 - work.node_stay
    for c in range(K):
        work.total[c] = 0.0
    for a in range(design.nodes):
        for c in range(K):
            work.left[a, c] = 0.0
    for b in range(design.regimes):
        flow = 1.0 - work.stay[b]
        for c in range(K):
            work.held[b, c] = 0.0
        for j in range(design.begin[b], design.begin[b + 1]):
            a = design.node[j]
            for c in range(K):
                work.held[b, c] += design.spread[a] * work.moment[j, c]
                work.left[a, c] += flow * work.moment[j, c]
    for a in range(design.nodes):
        for c in range(K):
            work.total[c] += design.spread[a] * work.left[a, c]
    for a in range(design.nodes):
        for c in range(K):
            s = work.node_stay * work.left[a, c]
            work.came[a, c] = s + out * design.node_prior[a] * work.total[c]
        if design.below[a] > 0.0:
            for c in range(K):
                work.came[a, c] += out * design.below[a] * work.left[a - 1, c]
        if design.above[a] > 0.0:
            for c in range(K):
                work.came[a, c] += out * design.above[a] * work.left[a + 1, c]


@part
def receive_leaks(work, design, b, j, K):
    """What mode j of regime b holds after the leaks, into `total`."""
    a, out = design.node[j], 1.0 - work.node_stay
    kept, even = work.stay[b] * work.node_stay, work.stay[b] * out * design.node_prior[a]
    for c in range(K):
        s = kept * work.moment[j, c] + even * work.held[b, c]
        work.total[c] = s + design.regime_prior[b] * work.came[a, c]
    near = work.stay[b] * out
    if design.mode_below[j] > 0.0:
        for c in range(K):
            work.total[c] += near * design.mode_below[j] * work.moment[j - 1, c]
    if design.mode_above[j] > 0.0:
        for c in range(K):
            work.total[c] += near * design.mode_above[j] * work.moment[j + 1, c]


@part
def scatter(lane, work, design, K):
    """Each mode's mixed weight, mean and covariance from its moments."""
    mix, axes, J = work.mixed, lane.axes, design.modes
    p = state_size(lane) // axes
    for b in range(design.regimes):
        kept = work.stay[b] * work.node_stay
        for j in range(design.begin[b], design.begin[b + 1]):
            receive_leaks(work, design, b, j, K)
            mix.weight[j] = work.total[0]
            work.share[j] = 1.0 / max(work.total[0], TINY)
            work.kept[j] = kept * work.moment[j, 0] * work.share[j]
            for c in range(1, K):
                work.mixed_moment[j, c] = work.total[c]
    c = 1
    for i in range(p):
        for g in range(axes):
            r, origin = i * axes + g, lane.origin[g * p + i]
            for j in range(J):
                work.off[r, j] = work.mixed_moment[j, c] * work.share[j]
                mix.mean[r, j] = origin + work.off[r, j]
            c += 1
    each = 1.0 / axes
    for i in range(p):
        for k in range(i + 1):
            for j in range(J):
                mix.cov[i, k, j] = work.mixed_moment[j, c] * work.share[j]
            for g in range(axes):
                for j in range(J):
                    mix.cov[i, k, j] -= each * work.off[i * axes + g, j] * work.off[k * axes + g, j]
            c += 1


@part
def mix_biases(lane, work, design, noise):
    """A velocity sensor's error is kept where a mode is, and drawn anew where it was not before.

    With f the share of a mode that was there before, m and b its means then, d = m - m_mixed:
    E b = f b, cov(x, b) = f (C_xb + d bᵀ), cov(b) = f C_bb + (1 - f) B + f (1 - f) b bᵀ.
    """
    old, new, axes = lane.after, work.mixed, lane.axes
    p, extra = state_size(lane) // axes, design.biases // axes
    each = 1.0 / axes
    for c in range(extra):
        for i in range(p):
            for j in range(design.unbiased, design.modes):
                s = 0.0
                for g in range(axes):
                    d = old.mean[i * axes + g, j] - new.mean[i * axes + g, j]
                    s += d * old.mean[(p + c) * axes + g, j]
                new.cov[p + c, i, j] = work.kept[j] * (old.cov[p + c, i, j] + s * each)
        for k in range(c + 1):
            B = noise[design.velocity[c], design.velocity[k]]
            for j in range(design.unbiased, design.modes):
                s, f = 0.0, work.kept[j]
                for g in range(axes):
                    s += old.mean[(p + c) * axes + g, j] * old.mean[(p + k) * axes + g, j]
                fresh = (1.0 - f) * (B + f * s * each)
                new.cov[p + c, p + k, j] = f * old.cov[p + c, p + k, j] + fresh
    for r in range(p * axes, (p + extra) * axes):
        for j in range(design.unbiased, design.modes):
            new.mean[r, j] = work.kept[j] * old.mean[r, j]


@part
def predict_modes(lane, work, design, noise):
    """m⁻ = F m, C⁻ = F C Fᵀ + Q of every mode; an error of a velocity sensor fades to its law."""
    old, new, axes, J = work.mixed, work.before, lane.axes, design.modes
    p = state_size(lane) // axes
    for j in range(J):
        new.weight[j] = old.weight[j]
    for i in range(p):
        for g in range(axes):
            r = i * axes + g
            for j in range(J):
                new.mean[r, j] = 0.0
            for k in range(p):
                f = lane.F[i, k]
                if f != 0.0:
                    for j in range(J):
                        new.mean[r, j] += f * old.mean[k * axes + g, j]
    for i in range(p):
        for k in range(p):
            for j in range(J):
                work.FC[i, k, j] = 0.0
            for h in range(p):
                f = lane.F[i, h]
                if f != 0.0:
                    a, b = max(h, k), min(h, k)
                    for j in range(J):
                        work.FC[i, k, j] += f * old.cov[a, b, j]
    for i in range(p):
        for k in range(i + 1):
            for b in range(design.regimes):
                Q = work.Q[design.motion[b] % BIAS, i, k]
                for j in range(design.begin[b], design.begin[b + 1]):
                    new.cov[i, k, j] = design.process[j] * Q
            for h in range(p):
                f = lane.F[k, h]
                if f != 0.0:
                    for j in range(J):
                        new.cov[i, k, j] += f * work.FC[i, h, j]
    if design.biases > 0:
        predict_biases(lane, work, design, noise)


@part
def predict_biases(lane, work, design, noise):
    """Errors of velocity sensors: b⁻ = φ b, and their covariances, φ = e^(−Δt/memory)."""
    old, new, axes = work.mixed, work.before, lane.axes
    p, extra = state_size(lane) // axes, design.biases // axes
    fade = lane.fade
    for r in range(p * axes, (p + extra) * axes):
        for j in range(design.unbiased, design.modes):
            new.mean[r, j] = fade * old.mean[r, j]
    for c in range(extra):
        for i in range(p):
            for j in range(design.unbiased, design.modes):
                s = 0.0
                for h in range(p):
                    s += lane.F[i, h] * old.cov[p + c, h, j]
                new.cov[p + c, i, j] = fade * s
        for k in range(c + 1):
            B = (1.0 - fade * fade) * noise[design.velocity[c], design.velocity[k]]
            for j in range(design.unbiased, design.modes):
                s = fade * fade * old.cov[p + c, p + k, j]
                new.cov[p + c, p + k, j] = s + B
