"""Deck filters under several hypotheses at once, compiled: an interacting multiple model (IMM).

Blom & Bar-Shalom 1988; not in IDAM. Every mode is the filter of `navgym.deck.joint`; what sets them apart:

- `PLAIN`: a Kalman filter, under one flexure model or another (a rougher sea).
- `SLAM`: θ̇ may jump within the step, and when in the step matters: a branch without a jump and one
  for each share of the step that was left, weighed by how well they foretell the rows, collapsed by
  moments.
- `GLITCH`: each row may be wrong: a mixture of two Gaussians per row (`update.mixture`).

Modes change as a Markov chain in continuous time: one stays for a second with probability `stay`, and
leaks alike to the others. A mode begins each step from the mixture of modes that it may have come from,
in moment form, and m, which has no memory, is left out. The last lane of a recording is the pool: the
mixture's own moments.
"""

from __future__ import annotations

import math

import numpy as np

from navgym.core.compile import packed, part
from navgym.core.health import NUMERICAL
from navgym.deck import alignment, joint
from navgym.deck.alignment import MEASUREMENTS, PROCESS, VELOCITY
from navgym.inertial import update

PLAIN, SLAM, GLITCH = range(3)
BY_TAPE = -1  # flexure of a mode that goes by the tape's own number
LEFT = np.array([1.0, 0.8, 0.6, 0.4, 0.2])  # shares of a step that a slam may leave
FARTHEST = 1e6  # standard deviations that an innovation counts at most: numbers stay finite
BRANCHES = 1 + len(LEFT)
NEGLIGIBLE = 1e-3  # of a step's probability: branches below are left out

# columns of the parameter row
COLUMNS = (
    "velocity_noise", "process_noise_scale", "mode_stay", "slam_rate", "slam_size", "glitch_rate",
    "glitch_velocity", "glitch_rate_size", "own_channels", "lever_sd", "kernel_width",
)  # fmt: skip
(
    OF_VELOCITY, OF_PROCESS, STAY, SLAM_RATE, SLAM_SIZE, GLITCH_CHANCE, GLITCH_VELOCITY, GLITCH_RATE,
    OWN, LEVER_SD, WIDTH,
) = range(len(COLUMNS))  # fmt: skip

f8, n = np.float64, joint.STATES
# one mode in one step, for who goes back over a recording
MEMORY = np.dtype(
    [
        ("chance", f8),  # of the mode, after the step
        ("x_from", f8, (n,)),  # where the mode began the step
        ("P_from", f8, (n, n)),
        ("x_prior", f8, (n,)),
        ("P_prior", f8, (n, n)),  # without a jump
        ("crossed", f8, (n, n)),  # covariance of x_prior with x_from
        ("x", f8, (n,)),
        ("P", f8, (n, n)),
        ("B", f8, (3, 6)),
        (
            "told",
            f8,
            (BRANCHES,),
        ),  # probability of each branch; all in the first where there is one
    ]
)


@part
def blend(P, a, other, b, v, n):
    """P ← a P + b other + a b v vᵀ, of the first n states."""
    for i in range(n):
        d = a * b * v[i]
        for k in range(n):
            P[i, k] = a * P[i, k] + b * other[i, k] + d * v[k]


@part
def begin_moments(P, w, other, v):
    """P ← w (other + v vᵀ)."""
    for i in range(v.shape[0]):
        d = w * v[i]
        for k in range(v.shape[0]):
            P[i, k] = w * other[i, k] + d * v[k]


@part
def mix(lanes, count, stay):
    """Let every mode begin from what it may have come from; `forecast` is how likely it is then."""
    pool = lanes[count]
    n = joint.AT.MEAN  # all but m
    leak = (1.0 - stay) / (count - 1) if count > 1 else 0.0
    for j in range(count):
        lane = lanes[j]
        own = (stay - leak) * lane.chance
        lane.forecast = own + leak
        if leak == 0.0:
            continue
        a, b = own / lane.forecast, leak / lane.forecast
        for i in range(n):
            lane.column[i] = lane.x[i] - pool.x[i]
        for i in range(n):
            lane.x[i] = pool.x[i] + a * lane.column[i]
        blend(lane.P, a, pool.P, b, lane.column, n)


@part
def pool_up(lanes, count):
    """The mixture's mean and covariance, into the pool."""
    pool = lanes[count]
    n = pool.x.shape[0]
    for i in range(n):
        s = 0.0
        for j in range(count):
            s += lanes[j].chance * lanes[j].x[i]
        pool.x[i] = s
    for j in range(count):
        lane = lanes[j]
        w = lane.chance
        for i in range(n):
            lane.column[i] = lane.x[i] - pool.x[i]
        if j == 0:
            begin_moments(pool.P, w, lane.P, lane.column)
        else:
            update.add_moments(pool.P, w, lane.P, lane.column)


@part
def weigh_branches(lane, model, size, chance):
    """Posterior probabilities of no jump (0) and of one that left LEFT[b − 1] of the step, into `told`.

    A jump J of axis a moves row c by J u_c, rate rows through m and velocity rows through V_r, and adds
    J² u uᵀ to S. Returns the log-likelihood of all.
    """
    update.innovate(lane)
    for c in range(MEASUREMENTS):
        for d in range(c + 1):
            lane.S0[c, d] = lane.S[c, d]
    top, total = -math.inf, 0.0
    for b in range(BRANCHES):
        f = LEFT[b - 1] if b > 0 else 0.0
        for c in range(MEASUREMENTS):
            for d in range(c + 1):
                lane.S[c, d] = lane.S0[c, d]
        for a in range(3 if b > 0 else 0):
            for i in range(3):
                u = 0.0
                for j in range(3):
                    u += lane.H[i, 6 + j] * (lane.B[j, a] * f * model.dt + lane.B[j, 3 + a])
                lane.white[i] = u
                lane.white[3 + i] = f * lane.H[3 + i, 9 + a]
            variance = (size * model.start[alignment.AT.RATE + a]) ** 2
            for c in range(MEASUREMENTS):
                for d in range(c + 1):
                    lane.S[c, d] += variance * lane.white[c] * lane.white[d]
        update.whiten(lane)
        prior = math.log(chance / LEFT.shape[0] if b > 0 else 1.0 - chance)
        lane.told[b] = prior + (0.0 if math.isnan(lane.nis) else lane.log_likelihood)
        top = max(top, lane.told[b])
    for b in range(BRANCHES):
        lane.told[b] = math.exp(lane.told[b] - top)
        total += lane.told[b]
    for b in range(BRANCHES):
        lane.told[b] /= total
        if lane.told[b] < NEGLIGIBLE:
            lane.told[b] = 0.0
    return top + math.log(total)


@part
def keep_prior(lane):
    """x⁻ and P⁻ for the next branch, and sums at zero; `expect` has put x⁻ aside."""
    n = lane.x.shape[0]
    for i in range(n):
        lane.x_sum[i] = 0.0
        for k in range(n):
            lane.P_sum[i, k] = 0.0
    update.copy(lane.P_prior, lane.P)


@part
def add_branch(lane, w, last):
    """Add a branch's moments about x⁻; x and P go back to the prior, or become the collapsed ones."""
    n = lane.x.shape[0]
    for i in range(n):
        lane.column[i] = lane.x[i] - lane.x_prior[i]
    for i in range(n):
        lane.x_sum[i] += w * lane.column[i]
    update.add_moments(lane.P_sum, w, lane.P, lane.column)
    for i in range(n):
        lane.x[i] = lane.x_prior[i] + (lane.x_sum[i] if last else 0.0)
    if last:
        update.copy(lane.P, lane.P_sum)
        update.take_off(lane.P, lane.x_sum, 1.0)
    else:
        update.copy(lane.P, lane.P_prior)


@part
def absorb(lane, model, kind, size, chance, wrong, width):
    """The update of a mode: one branch, or where θ̇ may have jumped those that are not negligible."""
    likelihood, kept, last = 0.0, 1.0, 0
    update.expect(lane)
    update.bound(lane, FARTHEST)
    update.weigh(lane, width, 0, 0)
    for c in range(MEASUREMENTS):
        lane.R[c] /= lane.weight[c]
    if kind == SLAM:
        likelihood, kept = weigh_branches(lane, model, size, chance), 0.0
        for b in range(BRANCHES):
            kept += lane.told[b]
            last = b if lane.told[b] > 0.0 else last
    several = last > 0 and lane.told[last] < kept
    if several:
        keep_prior(lane)
    nis = 0.0
    for b in range(last + 1):
        w = lane.told[b] / kept if last > 0 else 1.0
        if w == 0.0:
            continue
        if b > 0:
            for a in range(3):
                variance = (size * model.start[alignment.AT.RATE + a]) ** 2
                joint.jump(lane, model.dt, a, variance, LEFT[b - 1])
        update.mixture(lane, wrong)
        nis += w * lane.nis
        if several:
            add_branch(lane, w, b == last)
    if kind == SLAM:
        lane.nis, lane.log_likelihood = nis, likelihood


@part
def weigh_modes(lanes, count):
    """Each mode's probability after the step, and the bank's log-likelihood, into the pool."""
    pool = lanes[count]
    top = -math.inf
    for j in range(count):
        top = max(top, math.log(lanes[j].forecast) + lanes[j].log_likelihood)
    total = 0.0
    for j in range(count):
        lane = lanes[j]
        lane.chance = math.exp(math.log(lane.forecast) + lane.log_likelihood - top)
        total += lane.chance
    if not total > 0.0 or not math.isfinite(top):
        pool.diverged = NUMERICAL
    for j in range(count):
        lanes[j].chance /= total
        if lanes[j].diverged > 0:
            pool.diverged = NUMERICAL
    pool.log_likelihood = top + math.log(total)


@part
def tell(lanes, count):
    """Innovations, their variance, NIS and trust in each row, as the modes foretold them together."""
    pool = lanes[count]
    pool.nis = 0.0
    heard = 0
    for c in range(MEASUREMENTS):
        pool.used[c] = lanes[0].used[c]
        heard += pool.used[c]
        mean, square, weight = 0.0, 0.0, 0.0
        for j in range(count):
            lane = lanes[j]
            e, w = lane.innovation[c], lane.forecast
            mean += w * e
            square += w * (lane.variance[c] + e * e)
            weight += lane.chance * lane.weight[c]
        pool.innovation[c] = mean
        pool.variance[c] = max(square - mean * mean, 0.0)
        pool.weight[c] = weight
    for j in range(count):
        pool.nis += lanes[j].forecast * lanes[j].nis
    if heard == 0:
        pool.nis = math.nan
        pool.log_likelihood = math.nan


@part
def configure(lanes, count, row):
    """Put a row of parameters in force."""
    for j in range(count):
        lane = lanes[j]
        lane.row[VELOCITY] = row[OF_VELOCITY]
        lane.row[PROCESS] = row[OF_PROCESS]
        for i in range(3):
            lane.spike[i] = row[GLITCH_VELOCITY] ** 2
            lane.spike[3 + i] = row[GLITCH_RATE] ** 2


@part
def keep_before(lane, memory):
    """Put aside where a mode begins a step."""
    for i in range(lane.x.shape[0]):
        memory.x_from[i] = lane.x[i]
    update.copy(memory.P_from, lane.P)


@part
def keep_between(lane, memory):
    """And what it foretells."""
    for i in range(lane.x.shape[0]):
        memory.x_prior[i] = lane.x[i]
    update.copy(memory.P_prior, lane.P)
    update.copy(memory.crossed, lane.crossed)


@part
def keep_after(lane, memory, kind):
    """And where it arrives."""
    for b in range(BRANCHES):
        memory.told[b] = lane.told[b] if kind == SLAM else (1.0 if b == 0 else 0.0)
    for i in range(3):
        for a in range(6):
            memory.B[i, a] = lane.B[i, a]
    for i in range(lane.x.shape[0]):
        memory.x[i] = lane.x[i]
    update.copy(memory.P, lane.P)


@packed
def run(
    lanes, models, kinds, tapes, first, table, interval, impulse, left, disturbance,
    outputs, reports, covariances, chances, lagged, memories,
):  # fmt: skip
    """Filter each recording's lanes to their `length` or the tape's end.

    Args:
        lanes: (N, J + 1) as `joint.begin` or an earlier run left them.
        models: (N, M) records of `alignment_model.MODEL`.
        kinds: (J, 2) kind of each mode, and which model is its flexure.
        tapes: (N, K).
        first: the filter step that the tapes begin with.
        table: (N or 1, intervals, 11) parameters; row k // interval holds in step k, the last to the end.
        interval: steps per row of `table`.
        impulse: (N, K, 3) known variance of jumps of θ̇, or (N, 0, 3).
        left: (N, K) shares of the step that those left, or (N, 0).
        disturbance: (N, K, 6) known variance to add to R, or (N, 0, 6).
        outputs: (N, K, 24) states.
        reports: (N, K or 0) `alignment.REPORT`.
        covariances: (N, K or 0, 24, 24).
        chances: (N, K or 0, J) probabilities of the modes.
        lagged: (N, K or 0, 2, 3) θ̇ one and two steps before.
        memories: (N, K or 0, J) `MEMORY`.
    """
    nothing, none = np.zeros(3), np.zeros(MEASUREMENTS)
    count, known = kinds.shape[0], impulse.shape[1] > 0
    for i in range(len(lanes)):
        own, pool = lanes[i], lanes[i, count]
        for k in range(pool.k - first, min(pool.length - first, tapes.shape[1])):
            last = table.shape[1] - 1
            row = table[min(i, table.shape[0] - 1), min((k + first) // interval, last)]
            tape = tapes[i, k]
            jump, extra = (impulse[i, k], disturbance[i, k]) if known else (nothing, none)
            share = left[i, k] if known else 0.0
            dt = models[i, 0].dt
            configure(own, count, row)
            mix(own, count, row[STAY] ** dt)
            struck = 1.0 - math.exp(-row[SLAM_RATE] * dt)
            for j in range(count):
                lane, kind = own[j], kinds[j, 0]
                model = models[i, tape.model if kinds[j, 1] == BY_TAPE else kinds[j, 1]]
                if memories.shape[1] > 0:
                    keep_before(lane, memories[i, k, j])
                joint.predict(lane, model, tape, jump, share)
                if memories.shape[1] > 0:
                    keep_between(lane, memories[i, k, j])
                joint.look(lane, model, tape, row[OWN] > 0.0)
                for c in range(MEASUREMENTS):
                    lane.R[c] += extra[c]
                wrong = row[GLITCH_CHANCE] if kind == GLITCH else 0.0
                absorb(lane, model, kind, row[SLAM_SIZE], struck, wrong, row[WIDTH])
                if memories.shape[1] > 0:
                    keep_after(lane, memories[i, k, j], kind)
                lane.k += 1
            weigh_modes(own, count)
            for j in range(count if memories.shape[1] > 0 else 0):
                memories[i, k, j].chance = own[j].chance
            pool_up(own, count)
            tell(own, count)
            update.check(pool)
            pool.k += 1
            for a in range(outputs.shape[2]):
                outputs[i, k, a] = pool.x[a]
            if reports.shape[1] > 0:
                alignment.write_report(pool, reports[i, k])
            for a in range(alignment.STATES if covariances.shape[1] > 0 else 0):
                for b in range(alignment.STATES):
                    covariances[i, k, a, b] = pool.P[a, b]
            for j in range(count if chances.shape[1] > 0 else 0):
                chances[i, k, j] = own[j].chance
            for b in range(2 if lagged.shape[1] > 0 else 0):
                for a in range(3):
                    lagged[i, k, b, a] = pool.x[joint.AT.LAGGED + 3 * b + a]
