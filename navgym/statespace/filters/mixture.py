"""A mixture of fixed filters, whose states are weighed by what is seen of the sample: no truth, no future.

Each expert is a filter of the catalogue with parameters of its own, and runs as if it were alone. After each
row a linear softmax over causal features gives the weights; the estimate is the mixture's mean:

    z = clip((features − shift) ∘ gain)    w ∝ exp(z W + b)    x = Σ w_j x_j

What does not hold gets nothing: an expert whose numbers have failed, or that has for a while foretold the
position fixes far worse than the best of them. And while the mixture itself has foretold them worse than
the first expert, the reference, or sees what was not seen in training, the reference answers alone.

Batch and live run the same kernel.
"""

from __future__ import annotations

import math

import numpy as np

from navgym.core.checks import Array
from navgym.core.compile import kernel, part
from navgym.core.health import POWER_MEMORY
from navgym.statespace.filters.lane import BEHIND

# of the reference's innovations over √R, exponential means; then what is lost; then what the bank says
FEATURES = (
    "log_nis.0.8", "log_nis.0.95", "correlation.0.8", "correlation.0.95", "power_position.0.95",
    "power_velocity.0.8", "power_velocity.0.95", "lost.0.95", "since_received", "noise_position",
    "noise_velocity", "outliers", "manoeuvre", "late", "velocity_error",
)  # fmt: skip
TOLD = 6  # of them, the last ones, are read off the bank's weights
MEANS = len(FEATURES) - TOLD  # the others, which are kept from row to row
CLIP = 4.0  # of a normalised feature
FLOOR = 0.05  # keeps logarithms of squares finite
SLOW = 0.02  # share of a received fix in what mixture and reference are compared by
FIRST = 20  # received fixes before they are
WORSE = 0.05  # mean log-ratio of squared errors from which the mixture is left
RETURN = 20  # rows without a reason before it is back
MARGIN = (
    0.2  # of a feature's range in training, or of 1 where that is narrower, that it may lie outside
)
SOUND, UNSEEN, BEHIND_REFERENCE = range(3)  # why the reference answers


def memory(count: int, experts: int, rows: int) -> tuple[Array, ...]:
    """What is kept of `count` series between rows, as it is before the first.

    Feature means (N, MEANS); the last innovation over √R (N, m); each expert's mean log-error (N, K); the
    proposed weights (N, K), first of all the reference's; and (N, 4): the mixture's log-error over the
    reference's, fixes heard, the reason in force, rows without one.
    """
    weights = np.zeros((count, experts))
    weights[:, 0] = 1.0
    return (
        np.zeros((count, MEANS)), np.zeros((count, rows)), np.zeros((count, experts)), weights,
        np.zeros((count, 4)),
    )  # fmt: skip


@part
def log_root(square):
    """Half the logarithm of a mean square, floored."""
    return 0.5 * math.log(square + FLOOR)


@part
def blend(means, i, s, decay, value):
    """Move mean s of series i towards `value`."""
    means[i, s] += (1.0 - decay) * (value - means[i, s])


@part
def watch(i, k, innovations, nis, lost, root, kind, means, last):
    """Move the features by the reference's innovation; one that is no number moves nothing."""
    m = lost.shape[2]
    r = min(k, root.shape[1] - 1)
    power, count = np.zeros(2), np.zeros(2)
    product, now, before, heard = 0.0, 0.0, 0.0, 0
    for a in range(m):
        if not lost[i, k, a] and math.isfinite(innovations[i, k, 0, a]):
            e = innovations[i, k, 0, a] / root[i, r, a]
            power[kind[a]] += e * e
            count[kind[a]] += 1.0
            product += e * last[i, a]
            now += e * e
            before += last[i, a] * last[i, a]
            last[i, a] = e
            heard += 1
    if heard == 0 or not math.isfinite(nis[i, k]):
        return
    level = log_root(nis[i, k] / heard)
    cosine = product / math.sqrt(now * before + 1e-30)
    blend(means, i, 0, 0.8, level)
    blend(means, i, 1, 0.95, level)
    blend(means, i, 2, 0.8, cosine)
    blend(means, i, 3, 0.95, cosine)
    if count[0] > 0.0:
        blend(means, i, 4, 0.95, log_root(power[0] / count[0]))
    if count[1] > 0.0:
        blend(means, i, 5, 0.8, log_root(power[1] / count[1]))
        blend(means, i, 6, 0.95, log_root(power[1] / count[1]))


@part
def judge(i, k, innovations, lost, root, kind, errors, proposed, doubt):
    """Move each expert's mean log-error of the fixes, and the mixture's over the reference's."""
    r = min(k, root.shape[1] - 1)
    mixed, first, heard = 0.0, 0.0, 0
    for j in range(innovations.shape[2]):
        own = 0.0
        heard = 0
        for a in range(lost.shape[2]):
            if not lost[i, k, a] and kind[a] == 0:
                own += (innovations[i, k, j, a] / root[i, r, a]) ** 2
                heard += 1
        if heard > 0:
            own = math.log1p(own / heard) if math.isfinite(own) else 2.0 * BEHIND
            errors[i, j] += (1.0 - POWER_MEMORY) * (own - errors[i, j])
            first = own if j == 0 else first
    if heard == 0:
        return
    for a in range(lost.shape[2]):
        if not lost[i, k, a] and kind[a] == 0:
            e = 0.0
            for j in range(innovations.shape[2]):
                if proposed[i, j] > 0.0:
                    e += proposed[i, j] * innovations[i, k, j, a]
            mixed += (e / root[i, r, a]) ** 2
    ahead = math.log1p(mixed / heard) - first if math.isfinite(mixed) else 2.0 * BEHIND
    doubt[i, 0] += SLOW * (ahead - doubt[i, 0])
    doubt[i, 1] += 1.0


@part
def look(i, k, lost, told, means, features):
    """Count what was lost, and write the row's features."""
    received = 0
    for a in range(lost.shape[2]):
        received += 0 if lost[i, k, a] else 1
    blend(means, i, 7, 0.95, 1.0 - received / lost.shape[2])
    means[i, 8] = 0.0 if received > 0 else means[i, 8] + 1.0
    for s in range(MEANS):
        features[i, k, s] = means[i, s]
    features[i, k, 8] = 0.5 * math.log1p(means[i, 8])
    for s in range(TOLD):
        value = told[i, k, s]
        features[i, k, MEANS + s] = value if math.isfinite(value) else 0.0


@part
def propose(i, k, features, finite, errors, shift, gain, W, b, proposed):
    """The softmax over the experts that hold; returns whether there are any."""
    K = b.shape[0]
    best, top = math.inf, -math.inf
    for j in range(K):
        if finite[i, k, j]:
            best = min(best, errors[i, j])
    for j in range(K):
        proposed[i, j] = -math.inf
        if finite[i, k, j] and errors[i, j] - best < BEHIND:
            s = b[j]
            for f in range(shift.shape[0]):
                z = (features[i, k, f] - shift[f]) * gain[f]
                s += min(max(z, -CLIP), CLIP) * W[f, j]
            proposed[i, j] = s
            top = max(top, s)
    total = 0.0
    for j in range(K):
        proposed[i, j] = math.exp(proposed[i, j] - top) if proposed[i, j] > -math.inf else 0.0
        total += proposed[i, j]
    for j in range(K):
        proposed[i, j] = proposed[i, j] / total if total > 0.0 else (1.0 if j == 0 else 0.0)
    return total > 0.0


@part
def doubtful(i, k, features, low, high, doubt):
    """Why the reference should answer at this row, or SOUND."""
    for f in range(low.shape[0]):
        allowed = MARGIN * max(high[f] - low[f], 1.0)
        if features[i, k, f] < low[f] - allowed or features[i, k, f] > high[f] + allowed:
            return UNSEEN
    fallen = doubt[i, 2] == BEHIND_REFERENCE
    if doubt[i, 1] >= FIRST and doubt[i, 0] > (0.0 if fallen else WORSE):
        return BEHIND_REFERENCE
    return SOUND


@part
def answer(i, k, guarded, reason, finite, errors, proposed, doubt, weights, reasons):
    """The row's weights: those proposed, or the reference's alone while there is a reason."""
    if reason != SOUND:
        doubt[i, 2], doubt[i, 3] = reason, 0.0
    elif doubt[i, 2] != SOUND:
        doubt[i, 3] += 1.0
        if doubt[i, 3] >= RETURN:
            doubt[i, 2] = SOUND
    holds = finite[i, k, 0] and proposed[i, 0] > 0.0
    fallen = guarded and doubt[i, 2] != SOUND and holds
    for j in range(proposed.shape[1]):
        weights[i, k, j] = (1.0 if j == 0 else 0.0) if fallen else proposed[i, j]
    reasons[i, k] = int(doubt[i, 2]) if fallen else SOUND


@kernel
def weigh(
    innovations, nis, lost, root, kind, told, finite, shift, gain, low, high, W, b, guarded,
    means, last, errors, proposed, doubt, before, features, weights, reasons,
):  # fmt: skip
    """Weights (N, T, K) of the experts at each row.

    Args:
        innovations: (N, T, K, m) of the experts, the reference first.
        nis: (N, T) of the reference.
        lost: (N, T, m).
        root: (N, 1 or T, m) √R of each row.
        kind: (m,) 0 where a row is of a position fix, 1 where not.
        told: (N, T, TOLD) what the bank's weights say.
        finite: (N, T, K) where an expert's state is one.
        shift: (F,) subtracted from the features.
        gain: (F,) multiplies them then.
        low: (F,) smallest feature in training.
        high: (F,) largest one.
        W: (F, K) weights of features.
        b: (K,) biases.
        guarded: whether the reference answers while there is a reason.
        means: see `memory`; this and the next four go on from row to row.
        last: see `memory`.
        errors: see `memory`.
        proposed: see `memory`.
        doubt: see `memory`.
        before: written: (N, T, K) weights in force when the row came.
        features: written: (N, T, F).
        weights: written: (N, T, K).
        reasons: written: (N, T) why the reference answers, or 0.
    """
    for i in range(lost.shape[0]):
        for k in range(lost.shape[1]):
            for j in range(b.shape[0]):
                before[i, k, j] = proposed[i, j]
            watch(i, k, innovations, nis, lost, root, kind, means, last)
            judge(i, k, innovations, lost, root, kind, errors, proposed, doubt)
            look(i, k, lost, told, means, features)
            propose(i, k, features, finite, errors, shift, gain, W, b, proposed)
            reason = doubtful(i, k, features, low, high, doubt)
            answer(i, k, guarded, reason, finite, errors, proposed, doubt, weights, reasons)


@kernel
def learn(z, errors, worth, able, W, b, slope, slope_b):
    """Σ worth |Σ w_j e_j|² over rows, w the softmax over experts that are `able`; writes its slopes.

    Args:
        z: (R, F) normalised features.
        errors: (R, K, d) of each expert.
        worth: (R,).
        able: (R, K).
        W: (F, K).
        b: (K,).
        slope: written: (F, K) by W.
        slope_b: written: (K,) by b.
    """
    K, d = errors.shape[1], errors.shape[2]
    w, g, miss = np.zeros(K), np.zeros(K), np.zeros(d)
    total = 0.0
    slope[:], slope_b[:] = 0.0, 0.0
    for r in range(z.shape[0]):
        top, s = -math.inf, 0.0
        for j in range(K):
            w[j] = b[j]
        for f in range(z.shape[1]):
            for j in range(K):
                w[j] += z[r, f] * W[f, j]
        for j in range(K):
            if able[r, j]:
                top = max(top, w[j])
        for j in range(K):
            w[j] = math.exp(w[j] - top) if able[r, j] else 0.0
            s += w[j]
        miss[:] = 0.0
        for j in range(K):
            w[j] /= s
            for a in range(d):
                miss[a] += w[j] * errors[r, j, a]
        mean = 0.0
        for j in range(K):
            g[j] = 0.0
            for a in range(d):
                g[j] += 2.0 * worth[r] * miss[a] * errors[r, j, a]
            mean += w[j] * g[j]
        for a in range(d):
            total += worth[r] * miss[a] * miss[a]
        for j in range(K):
            g[j] = w[j] * (g[j] - mean)
            slope_b[j] += g[j]
        for f in range(z.shape[1]):
            for j in range(K):
                slope[f, j] += z[r, f] * g[j]
    return total
