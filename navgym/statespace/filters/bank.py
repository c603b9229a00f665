"""Banks of Kalman filters over noise scales: interacting multiple models, and the outlier bank.

Modes stand on a grid: A scales of R by B regimes. Their transition matrix is a Kronecker product
of two leaks, so that mixing takes O(A B): along each axis a mode keeps its share, gives some to
its neighbours and spreads the rest. Mixing is done in moments (weight, weighted mean, weighted
second moment), which the transition maps linearly (Blom & Bar-Shalom 1988 in another order).

Where an outlier may occur, it is a second Gaussian *within* the step, not a mode that persists:
both updates are weighed by their likelihoods and collapsed to one by their moments.

Where regimes differ in how they lose samples, that a sample is lost, or not, is evidence as well.

The chains are in seconds, and what happens between two received samples is done at once, when the
second arrives: rows without a measurement only read from the modes as the last received sample left
them. So an estimate does not depend on how a log is cut.

Where two axes have the same model and lose the same components, all modes keep one covariance for
both (`axes` = 2); otherwise the state is treated as a whole (`axes` = 1). One kernel serves both.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import kernel, part
from navgym.core.health import NUMERICAL, settle
from navgym.core.linalg import predict
from navgym.core.sizes import model_size, sample_size, state_size
from navgym.statespace.batch import Batch, outputs
from navgym.statespace.filters.lane import (
    LOG_2PI,
    PERIOD,
    expect,
    fields,
    padded,
    receive,
    report,
    silence,
    start,
    watch,
)
from navgym.statespace.models import record

if TYPE_CHECKING:
    from navgym.problem import Filter

# columns of a parameter array
PROCESS, MEASUREMENT, SCALE_STAY, REGIME_STAY, OUTLIER_RATE = range(5)
OUTLIER_SCALE = 100.0
MAX_MODES = 32
CANCELLATION = 1e-6  # a variance shrunk by more than this in one update has lost digits: use Joseph
LOST_LEAK = 0.2  # leaks are this much smaller once nothing has been received for a `PERIOD`
# regimes without losses of their own lose at one unknown rate: Beta prior (lost, received) of it
LOST_BEFORE = (1.0, 19.0)


@dataclass(frozen=True)
class ModeSet:
    """The modes of a bank: scales[a] multiplies R, process[a][b] multiplies Q.

    Args:
        scales: multiples of R, one per row of the grid.
        process: multiples of Q, (A, B).
        outliers: whether regime b allows outliers, (B,).
        prior: to what shares the regimes' leak flows, (B,).
        near: share of the scales' leak that goes to the neighbouring rows.
        losses: for each regime (B,) the probabilities that a sample is lost after a received one
            and after a lost one; None where losses are independent and their rate unknown. Empty:
            losses tell nothing.
    """

    scales: tuple[float, ...]
    process: tuple[tuple[float, ...], ...]
    outliers: tuple[bool, ...] = (False,)
    prior: tuple[float, ...] = (1.0,)
    near: float = 0.0
    losses: tuple[tuple[float, float] | None, ...] = ()

    @property
    def shape(self) -> tuple[int, int]:
        """Grid size (A, B)."""
        return len(self.scales), len(self.prior)

    def table(self) -> Array:
        """Rows (R scale, Q scale, allows outliers, first weight) of the modes, (A·B, 4)."""
        a, b = self.shape
        return np.column_stack(
            [
                np.repeat(self.scales, b),
                np.ravel(self.process),
                np.tile(np.array(self.outliers, dtype=np.float64), a),
                np.tile(self.shares(), a) / a,
            ]
        )

    def shares(self) -> Array:
        """To what shares the regimes' leak flows, (B,)."""
        return np.array(self.prior) / sum(self.prior)

    def loss_table(self) -> Array:
        """`losses` as (B or 0, 2), NaN for None."""
        nothing = (math.nan, math.nan)
        return np.array([pair or nothing for pair in self.losses]).reshape(-1, 2)


def _grid(scales: tuple[float, ...], process: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
    return tuple(process for _ in scales)


def _listed(pairs: tuple[tuple[float, float], ...]) -> ModeSet:
    """Modes given one by one as (R scale, Q scale), each leaking evenly to all others."""
    return ModeSet(tuple(r for r, _ in pairs), tuple((q,) for _, q in pairs))


_SCALES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
BANK = ModeSet(
    _SCALES, _grid(_SCALES, (1.0, 1.0, 100.0)), (False, True, False), (4.0, 2.0, 1.0), 0.1
)
BANK_BURSTS = ModeSet(
    _SCALES, _grid(_SCALES, (1.0, 1.0, 100.0, 1.0)), (False, True, False, False),
    (4.0, 2.0, 1.0, 1.0), 0.1, (None, None, None, (0.03, 0.9)),
)  # fmt: skip
IMM = _listed(((0.25, 1.0), (1.0, 1.0), (25.0, 1.0), (100.0, 1.0), (1.0, 100.0), (100.0, 100.0)))
IMM_WIDE = _listed(
    tuple((r, 1.0) for r in _SCALES) + tuple((r, 100.0) for r in (0.1, 0.3, 1.0, 3.0, 10.0))
)
MODE_SETS = {"bank": BANK, "bank_bursts": BANK_BURSTS, "imm": IMM, "imm_wide": IMM_WIDE}


def lane_type(n: int, m: int, axes: int) -> np.dtype[Any]:
    """Record of one bank over n states and m measurements, `axes` of them sharing a covariance.

    It has room for `MAX_MODES` modes, so that all mode sets share one compiled kernel.
    """
    f8 = np.float64
    j, p, s = MAX_MODES, n // axes, m // axes
    own = [
        ("mean", f8, (j, p, axes)),
        ("cov", f8, (j, p, p)),
        ("weight", f8, (j,)),
        # as the last received sample left it, and the motion since then
        ("kept_mean", f8, (j, p, axes)),
        ("kept_cov", f8, (j, p, p)),
        ("kept_weight", f8, (j,)),
        ("kept_x", f8, (n,)),
        ("kept_P", f8, (n, n)),
        ("rows_since", np.int64, ()),
        ("whole", _motion(n), ()),
        ("axis", _motion(p), ()),
        ("grid", np.int64, (2,)),  # numbers of R scales and of regimes
        ("moment", f8, (j, 1 + p * axes + p * p)),
        ("losing", f8, (3,)),  # was the last sample lost; lost outside bursts; of how many
        ("total", f8, (1 + p * axes + p * p,)),
        ("row", f8, (j, 1 + p * axes + p * p)),
        # scratch of the modes' updates; a mode has a second branch where outliers are allowed
        ("m_prior", f8, (p, axes)),
        ("nis_mode", f8, (j, 2)),
        ("root_det", f8, (j, 2)),
        ("branch_m", f8, (j, 2, p, axes)),
        ("branch_C", f8, (j, 2, p, p)),
        ("HC", f8, (s, p)),
        ("L", f8, (s, s)),
        ("G", f8, (s, p)),
        ("e", f8, (s, axes)),
        ("FT", f8, (p, p)),
    ]
    return np.dtype(own + fields(n, m))


def _motion(n: int) -> np.dtype[Any]:
    """Record of a motion of n states over several rows: F, Q, and scratch."""
    return np.dtype([("n", np.int64), *((name, np.float64, (n, n)) for name in ("F", "Q", "T"))])


def separable(models: NDArray[Any]) -> bool:
    """Whether the packed models (K,) treat two halves of the state alike and apart."""
    n, m = models["F"].shape[-1], models["H"].shape[-2]
    if n % 2 or m % 2:
        return False
    for name in ("F", "H", "Q", "R", "P0"):
        M = models[name]
        r, c = M.shape[-2] // 2, M.shape[-1] // 2
        apart = not M[:, :r, c:].any() and not M[:, r:, :c].any()
        if not apart or not np.array_equal(M[:, :r, :c], M[:, r:, c:]):
            return False
    return True


def half(models: NDArray[Any]) -> NDArray[Any]:
    """The models of one axis of separable models."""
    n, m = models["F"].shape[-1] // 2, models["H"].shape[-2] // 2
    small = np.zeros(models.shape, record(n, m))
    for name in ("F", "H", "Q", "R", "P0"):
        r, c = small[name].shape[-2:]
        small[name] = models[name][..., :r, :c]
    small["x0"] = models["x0"][..., :n]
    small["rows"] = models["rows"][..., :m]
    small["n"], small["m"] = n, m
    return small


def estimate(
    chosen: Filter, batch: Batch, table: Array, interval: int, everything: bool
) -> dict[str, Array]:
    """Run the bank `chosen` over a batch; see `navgym.estimation.run`.

    A recording begins with one covariance for both axes if its model allows it, and goes on with
    the whole state from the first sample that the axes do not lose alike: an estimate depends
    neither on later samples nor on other recordings.
    """
    modes = MODE_SETS[chosen.option]
    n, m = batch.models.dtype["x0"].shape[0], batch.y.shape[2]
    found: dict[str, Any] = outputs(batch, n, m, everything)
    count, steps = batch.y.shape[:2]
    found["weights"] = np.full((count, steps if everything else 0, *modes.shape), np.nan)
    lanes = run_lanes(run, batch, table, interval, modes, found)
    return found | {"diverged": lanes["diverged"] > 0}


def run_lanes(
    runner: Callable[..., None],
    batch: Batch,
    table: Array,
    interval: int,
    modes: ModeSet,
    found: dict[str, Any],
) -> NDArray[Any]:
    """Run `runner` (`run`, or one that is called alike) over a batch; returns the final lanes.

    Args:
        runner: takes lanes, what they filter, and the arrays of `found`, in this order.
        batch: stacked recordings.
        table: parameters, (N or 1, intervals, up to 5).
        interval: samples per row of the table.
        modes: of the bank.
        found: arrays (N, ...) that the runner writes to.
    """
    n, m = batch.models.dtype["x0"].shape[0], batch.y.shape[2]
    count = len(batch)
    table = padded(table, (1.0, 1.0, 0.97, 1.0, 0.0))
    until = np.array([_alike_until(batch, i) for i in range(count)])
    whole = np.zeros(count, lane_type(n, m, 1))
    begin(whole, batch.models, modes, 1)
    first = np.flatnonzero(until > 0)
    if len(first):
        shared = np.zeros(len(first), lane_type(n, m, 2))
        begin(shared, batch.models[first], modes, 2)
        shared["length"] = until[first]
        _run_some(runner, batch, table, interval, modes, shared, first, found)
        whole[first] = unfolded(shared, whole.dtype)
    then = np.flatnonzero(until < batch.lengths)
    if len(then):
        rest = whole[then]
        rest["length"] = batch.lengths[then]
        _run_some(runner, batch, table, interval, modes, rest, then, found)
        whole[then] = rest
    return whole


def _alike_until(batch: Batch, i: int) -> int:
    """Number of samples for which recording i may keep one covariance for both axes."""
    if not separable(batch.models[i]):
        return 0
    half_m = batch.y.shape[2] // 2
    apart = (batch.lost[i, :, :half_m] != batch.lost[i, :, half_m:]).any(axis=1)
    apart = apart[: batch.lengths[i]]
    return int(np.argmax(apart)) if apart.any() else int(batch.lengths[i])


def _run_some(
    runner: Callable[..., None],
    batch: Batch,
    table: Array,
    interval: int,
    modes: ModeSet,
    lanes: NDArray[Any],
    chosen: NDArray[np.int64],
    found: dict[str, Array],
) -> None:
    """Run the lanes of the recordings `chosen`, and put what they say into `found`."""
    everyone = len(chosen) == len(batch)
    pick = slice(None) if everyone else chosen  # a slice is a view: nothing is copied
    models = batch.models[pick]
    small = half(models) if lanes["mean"].shape[-1] == 2 else models
    mine = {name: array[pick] for name, array in found.items()}
    runner(
        lanes, models, small, batch.y[pick], batch.lost[pick], batch.time[pick],
        table if len(table) == 1 else table[pick], interval, modes.table(),
        modes.shares(), modes.near, modes.loss_table(), *mine.values(),
    )  # fmt: skip
    if not everyone:
        for name, array in mine.items():
            found[name][pick] = array


def unfolded(shared: NDArray[Any], whole: np.dtype[Any]) -> NDArray[Any]:
    """Lanes that shared a covariance between two axes, as lanes of the record `whole`."""
    lanes = np.zeros(shared.shape, whole)
    for name in whole.names or ():
        if whole[name] == shared.dtype[name]:
            lanes[name] = shared[name]
    count, modes, p, axes = shared["mean"].shape
    for mean, cov in (("mean", "cov"), ("kept_mean", "kept_cov")):
        stacked = np.swapaxes(shared[mean], 2, 3).reshape(count, modes, axes * p)
        lanes[mean] = stacked[..., None]
        for g in range(axes):
            own = slice(g * p, (g + 1) * p)
            lanes[cov][:, :, own, own] = shared[cov]
    lanes["axis"] = shared["whole"]
    return lanes


def begin(lanes: NDArray[Any], models: NDArray[Any], modes: ModeSet, axes: int) -> None:
    """Put the lanes (N,) at the start: every mode at x0, P0, weights at their prior."""
    start(lanes, models)
    p = lanes["cov"].shape[-1]
    x0 = models["x0"][:, 0].reshape(len(lanes), axes, p)
    lanes["mean"] = np.swapaxes(x0, 1, 2)[:, None]
    lanes["cov"] = models["P0"][:, 0, :p, :p][:, None]
    lanes["grid"] = modes.shape
    for name in ("whole", "axis"):
        lanes[name]["n"] = lanes[name]["F"].shape[-1]
    lanes["losing"] = (0.0, LOST_BEFORE[0], sum(LOST_BEFORE))
    lanes["weight"][:, : len(modes.table())] = modes.table()[:, 3]


@part
def keep(lane):
    """Note the modes as they are: after the last sample of which something was received."""
    p, axes = lane.m_prior.shape
    for j in range(lane.grid[0] * lane.grid[1]):
        lane.kept_weight[j] = lane.weight[j]
        for i in range(p):
            for g in range(axes):
                lane.kept_mean[j, i, g] = lane.mean[j, i, g]
            for k in range(p):
                lane.kept_cov[j, i, k] = lane.cov[j, i, k]
    for i in range(state_size(lane)):
        lane.kept_x[i] = lane.x[i]
        for k in range(state_size(lane)):
            lane.kept_P[i, k] = lane.P[i, k]


@part
def recall(lane):
    """Go back to what `keep` noted."""
    p, axes = lane.m_prior.shape
    for j in range(lane.grid[0] * lane.grid[1]):
        lane.weight[j] = lane.kept_weight[j]
        for i in range(p):
            for g in range(axes):
                lane.mean[j, i, g] = lane.kept_mean[j, i, g]
            for k in range(p):
                lane.cov[j, i, k] = lane.kept_cov[j, i, k]
    for i in range(state_size(lane)):
        lane.x[i] = lane.kept_x[i]
        for k in range(state_size(lane)):
            lane.P[i, k] = lane.kept_P[i, k]


@part
def move_on(motion, model, q, anew):
    """Add a row's motion: F ← F_k F, Q ← F_k Q F_kᵀ + q Q_k; only the row's own where `anew`."""
    n = model_size(motion)
    if anew:
        for i in range(n):
            for k in range(n):
                motion.F[i, k] = model.F[i, k]
                motion.Q[i, k] = q * model.Q[i, k]
        return
    for i in range(n):
        for k in range(n):
            s = 0.0
            for h in range(n):
                s += model.F[i, h] * motion.F[h, k]
            motion.T[i, k] = s
    for i in range(n):
        for k in range(n):
            motion.F[i, k] = motion.T[i, k]
    for i in range(n):
        for k in range(n):
            s = 0.0
            for h in range(n):
                s += model.F[i, h] * motion.Q[h, k]
            motion.T[i, k] = s
    for i in range(n):
        for k in range(i + 1):
            s = q * model.Q[i, k]
            for h in range(n):
                s += motion.T[i, h] * model.F[k, h]
            motion.Q[i, k] = s
            motion.Q[k, i] = s


@part
def begin_row(lane, model, small, q, received):
    """Bring the modes to the last received sample, and the motion since then to this row."""
    anew = lane.rows_since == 0
    if not anew:
        recall(lane)
    elif received == 0:
        keep(lane)
    move_on(lane.whole, model, q, anew)
    move_on(lane.axis, small, q, anew)
    lane.rows_since = 0 if received > 0 else lane.rows_since + 1


@part
def gather(lane):
    """Moments of the modes about the bank's mean: weight, w d, w (P + d dᵀ averaged over axes)."""
    J = lane.grid[0] * lane.grid[1]
    _, p, axes = lane.mean.shape
    for j in range(J):
        w = lane.weight[j]
        lane.moment[j, 0] = w
        for i in range(p):
            for g in range(axes):
                lane.moment[j, 1 + i * axes + g] = w * (lane.mean[j, i, g] - lane.x[g * p + i])
        for i in range(p):
            for k in range(p):
                s = 0.0
                for g in range(axes):
                    s += (lane.mean[j, i, g] - lane.x[g * p + i]) * (
                        lane.mean[j, k, g] - lane.x[g * p + k]
                    )
                lane.moment[j, 1 + p * axes + i * p + k] = w * (lane.cov[j, i, k] + s / axes)


@part
def leak_scales(lane, stay, near):
    """Along the R scales: keep `stay`, give `near` of the rest to neighbours, spread what is left."""
    A, B = lane.grid[0], lane.grid[1]
    K = lane.total.shape[0]
    leak = 1.0 - stay
    near = near if A > 1 else 0.0  # nothing leaks to neighbours where there are none
    even = leak * (1.0 - near) / A
    for b in range(B):
        for c in range(K):
            s = 0.0
            for a in range(A):
                lane.row[a, c] = lane.moment[a * B + b, c]
                s += lane.row[a, c]
            lane.total[c] = s
        for a in range(A):
            below = 0.0 if a == 0 else leak * near * (1.0 if a == 1 else 0.5)
            above = 0.0 if a == A - 1 else leak * near * (1.0 if a == A - 2 else 0.5)
            for c in range(K):
                s = stay * lane.row[a, c] + even * lane.total[c]
                if a > 0:
                    s += below * lane.row[a - 1, c]
                if a < A - 1:
                    s += above * lane.row[a + 1, c]
                lane.moment[a * B + b, c] = s


@part
def leak_regimes(lane, stay, prior):
    """Along the regimes: keep `stay`, let the rest flow to the prior shares."""
    A, B = lane.grid[0], lane.grid[1]
    for a in range(A):
        for c in range(lane.total.shape[0]):
            s = 0.0
            for b in range(B):
                s += lane.moment[a * B + b, c]
            for b in range(B):
                j = a * B + b
                lane.moment[j, c] = stay * lane.moment[j, c] + (1.0 - stay) * prior[b] * s


@part
def scatter(lane):
    """Each mode's mixed mean and covariance from its moments."""
    J = lane.grid[0] * lane.grid[1]
    _, p, axes = lane.mean.shape
    for j in range(J):
        w = lane.moment[j, 0]
        lane.weight[j] = w
        d = 1.0 / max(w, 1e-300)
        for i in range(p):
            for g in range(axes):
                lane.m_prior[i, g] = lane.moment[j, 1 + i * axes + g] * d
        for i in range(p):
            for k in range(p):
                s = 0.0
                for g in range(axes):
                    s += lane.m_prior[i, g] * lane.m_prior[k, g]
                lane.cov[j, i, k] = lane.moment[j, 1 + p * axes + i * p + k] * d - s / axes
        for i in range(p):
            for g in range(axes):
                lane.mean[j, i, g] = lane.x[g * p + i] + lane.m_prior[i, g]


@part
def chance_of_loss(lane, losses, b, lost):
    """How likely regime b was to lose the sample, if `lost`, or else to let it through."""
    chance = losses[b, 1] if lane.losing[0] > 0.0 else losses[b, 0]
    if math.isnan(chance):
        chance = lane.losing[1] / lane.losing[2]
    return chance if lost else 1.0 - chance


@part
def judge_loss(lane, losses, lost):
    """Weigh the regimes by whether the sample is lost; learn the rate outside of bursts.

    The rate's counts grow by the weight of the regimes that share it: an assumed-density filter.
    """
    A, B = lane.grid[0], lane.grid[1]
    total = 0.0
    for b in range(B):
        chance = chance_of_loss(lane, losses, b, lost)
        for a in range(A):
            lane.weight[a * B + b] *= chance
            total += lane.weight[a * B + b]
    shared = 0.0
    for b in range(B):
        for a in range(A):
            lane.weight[a * B + b] /= total
            if math.isnan(losses[b, 0]):
                shared += lane.weight[a * B + b]
    lane.losing[0] = 1.0 if lost else 0.0
    lane.losing[1] += shared * lane.losing[0]
    lane.losing[2] += shared


@part
def predict_mode(lane, axis, j, q):
    """m⁻ = F m, C⁻ = F C Fᵀ + q Q of mode j, in place."""
    p, axes = lane.m_prior.shape
    for i in range(p):
        for g in range(axes):
            s = 0.0
            for k in range(p):
                s += axis.F[i, k] * lane.mean[j, k, g]
            lane.m_prior[i, g] = s
    for i in range(p):
        for k in range(p):
            s = 0.0
            for h in range(p):
                s += axis.F[i, h] * lane.cov[j, h, k]
            lane.FT[i, k] = s
    for i in range(p):
        for k in range(i + 1):
            s = q * axis.Q[i, k]
            for h in range(p):
                s += lane.FT[i, h] * axis.F[k, h]
            lane.cov[j, i, k] = s
            lane.cov[j, k, i] = s
    for i in range(p):
        for g in range(axes):
            lane.mean[j, i, g] = lane.m_prior[i, g]


@part
def joseph_mode(lane, small, j, branch, r):
    """Covariance of an update as (I − K H) C (I − K H)ᵀ + r K R Kᵀ. Overwrites G by Kᵀ = L⁻ᵀ G."""
    p = lane.m_prior.shape[0]
    s_count = lane.L.shape[0]
    for i in range(s_count - 1, -1, -1):
        for k in range(p):
            s = lane.G[i, k]
            for h in range(i + 1, s_count):
                s -= lane.L[h, i] * lane.G[h, k]
            lane.G[i, k] = s / lane.L[i, i]
    for i in range(p):
        for k in range(p):
            s = 1.0 if i == k else 0.0
            for h in range(s_count):
                s -= lane.G[h, i] * small.H[h, k]
            lane.A[i, k] = s
    for i in range(p):
        for k in range(p):
            s = 0.0
            for h in range(p):
                s += lane.A[i, h] * lane.cov[j, h, k]
            lane.T[i, k] = s
    for i in range(p):
        for k in range(i + 1):
            s = 0.0
            for h in range(p):
                s += lane.T[i, h] * lane.A[k, h]
            for h in range(s_count):
                for g in range(s_count):
                    s += r * small.R[h, g] * lane.G[h, i] * lane.G[g, k]
            lane.branch_C[j, branch, i, k] = s
            lane.branch_C[j, branch, k, i] = s


@part
def update_mode(lane, small, j, branch, r):
    """Kalman update of mode j under r R into `branch`; notes its NIS and √|S|. False if S fails."""
    p, axes = lane.m_prior.shape
    s_count = lane.L.shape[0]
    ok = True
    for i in range(s_count):
        for k in range(p):
            s = 0.0
            if small.rows[i] >= 0:
                s = lane.cov[j, small.rows[i], k]
            else:
                for h in range(p):
                    s += small.H[i, h] * lane.cov[j, h, k]
            lane.HC[i, k] = s
    root = 1.0
    nis = 0.0
    for i in range(s_count):
        for k in range(i + 1):
            s = 0.0
            if lane.use[i] and lane.use[k]:
                s = r * small.R[i, k]
                for h in range(p):
                    s += lane.HC[i, h] * small.H[k, h]
            elif i == k:
                s = 1.0
            for h in range(k):
                s -= lane.L[i, h] * lane.L[k, h]
            if i == k:
                if not s > 0.0:
                    ok = False
                lane.L[i, i] = math.sqrt(max(s, 1e-300))
            else:
                lane.L[i, k] = s / lane.L[k, k]
        d = 1.0 / lane.L[i, i]
        root *= d
        for g in range(axes):
            s = 0.0
            if lane.use[i]:
                s = lane.y[g * s_count + i]
                for h in range(p):
                    s -= small.H[i, h] * lane.mean[j, h, g]
            for h in range(i):
                s -= lane.L[i, h] * lane.e[h, g]
            lane.e[i, g] = s * d
            nis += lane.e[i, g] * lane.e[i, g]
        for k in range(p):
            s = lane.HC[i, k] if lane.use[i] else 0.0
            for h in range(i):
                s -= lane.L[i, h] * lane.G[h, k]
            lane.G[i, k] = s * d
    for i in range(p):
        for g in range(axes):
            s = lane.mean[j, i, g]
            for h in range(s_count):
                s += lane.G[h, i] * lane.e[h, g]
            lane.branch_m[j, branch, i, g] = s
        for k in range(i + 1):
            s = lane.cov[j, i, k]
            for h in range(s_count):
                s -= lane.G[h, i] * lane.G[h, k]
            lane.branch_C[j, branch, i, k] = s
            lane.branch_C[j, branch, k, i] = s
    for i in range(p):
        if not lane.branch_C[j, branch, i, i] > CANCELLATION * lane.cov[j, i, i]:
            joseph_mode(lane, small, j, branch, r)
            break
    density = root
    for _ in range(1, axes):
        density *= root
    lane.nis_mode[j, branch] = nis
    lane.root_det[j, branch] = density
    return ok


@part
def collapse(lane, j, share):
    """Mode j's two branches, the second of weight `share`, as one Gaussian of the same moments."""
    p, axes = lane.m_prior.shape
    for i in range(p):
        for g in range(axes):
            a, b = lane.branch_m[j, 0, i, g], lane.branch_m[j, 1, i, g]
            lane.mean[j, i, g] = a + share * (b - a)
    for i in range(p):
        for k in range(p):
            s = 0.0
            for g in range(axes):
                s += (lane.branch_m[j, 1, i, g] - lane.branch_m[j, 0, i, g]) * (
                    lane.branch_m[j, 1, k, g] - lane.branch_m[j, 0, k, g]
                )
            a, b = lane.branch_C[j, 0, i, k], lane.branch_C[j, 1, i, k]
            lane.cov[j, i, k] = a + share * (b - a) + share * (1.0 - share) * s / axes


@part
def update_modes(lane, small, modes, r, rate, received):
    """Update every mode and its weight by the sample; the mixture's log-likelihood is noted."""
    J = lane.grid[0] * lane.grid[1]
    p, axes = lane.m_prior.shape
    least = math.inf
    for j in range(J):
        if not update_mode(lane, small, j, 0, r * modes[j, 0]):
            lane.diverged = NUMERICAL
        least = min(least, lane.nis_mode[j, 0])
        if modes[j, 2] > 0.0 and rate > 0.0:
            if not update_mode(lane, small, j, 1, r * modes[j, 0] * OUTLIER_SCALE):
                lane.diverged = NUMERICAL
            least = min(least, lane.nis_mode[j, 1])
    total = 0.0
    for j in range(J):
        likelihood = lane.root_det[j, 0] * math.exp(0.5 * (least - lane.nis_mode[j, 0]))
        if modes[j, 2] > 0.0 and rate > 0.0:
            other = rate * lane.root_det[j, 1] * math.exp(0.5 * (least - lane.nis_mode[j, 1]))
            likelihood = (1.0 - rate) * likelihood + other
            collapse(lane, j, other / max(likelihood, 1e-300))
        else:
            for i in range(p):
                for g in range(axes):
                    lane.mean[j, i, g] = lane.branch_m[j, 0, i, g]
                for k in range(p):
                    lane.cov[j, i, k] = lane.branch_C[j, 0, i, k]
        lane.weight[j] *= likelihood
        total += lane.weight[j]
    if not total > 0.0:
        lane.diverged = NUMERICAL
    for j in range(J):
        lane.weight[j] /= total
    lane.log_likelihood = math.log(max(total, 1e-300)) - 0.5 * (least + received * LOG_2PI)


@part
def combine(lane):
    """The bank's estimate: mean and covariance of the mixture."""
    J = lane.grid[0] * lane.grid[1]
    _, p, axes = lane.mean.shape
    n = state_size(lane)
    for g in range(axes):
        for i in range(p):
            s = 0.0
            for j in range(J):
                s += lane.weight[j] * lane.mean[j, i, g]
            lane.x[g * p + i] = s
    for i in range(n):
        for k in range(n):
            lane.P[i, k] = 0.0
    for j in range(J):
        w = lane.weight[j]
        for g in range(axes):
            for i in range(p):
                for k in range(p):
                    lane.P[g * p + i, g * p + k] += w * lane.cov[j, i, k]
                d = lane.mean[j, i, g] - lane.x[g * p + i]
                for h in range(axes):
                    for k in range(p):
                        s = d * (lane.mean[j, k, h] - lane.x[h * p + k])
                        lane.P[g * p + i, h * p + k] += w * s


@kernel
def step(
    lane, model, small, modes, prior, near, losses, t, received, q, r, scale_stay, regime_stay, rate
):  # fmt: skip
    """One sample: mix, predict, judge, update, combine. The sample lies in the lane (`receive`).

    Where a loss is evidence (`losses`) it counts row by row, and so does the mixing.
    """
    m = sample_size(lane)
    begin_row(lane, model, small, q, received)
    silent = silence(lane, t)
    age = min(silent, PERIOD) + LOST_LEAK * max(silent - PERIOD, 0.0)
    gather(lane)
    leak_scales(lane, scale_stay**age, near)
    if lane.grid[1] > 1:
        leak_regimes(lane, regime_stay**age, prior)
    scatter(lane)
    if losses.shape[0] > 0:
        judge_loss(lane, losses, received == 0)
        lane.rows_since = 0
        lane.heard = t
    mean_q, mean_r = 0.0, 0.0
    for j in range(lane.grid[0] * lane.grid[1]):
        mean_q += lane.weight[j] * modes[j, 1]
        mean_r += lane.weight[j] * modes[j, 0] * (1.0 + modes[j, 2] * rate * (OUTLIER_SCALE - 1.0))
        predict_mode(lane, lane.axis, j, modes[j, 1])
    predict(lane, lane.whole, mean_q)
    for i in range(m):
        for j in range(m):
            lane.R_used[i, j] = r * mean_r * model.R[i, j]
    expect(lane, model, received)
    watch(lane, model, t, received)
    if received > 0:
        update_modes(lane, small, modes, r, rate, received)
    combine(lane)
    settle(lane)


@kernel
def run(
    lanes, models, smalls, y, lost, time, parameters, interval, modes, prior, near, losses,
    states, covariances, innovations, nis, log_likelihoods, weights,
):  # fmt: skip
    """Filter every series with parameters (N or 1, intervals, 5)."""
    for i in range(lanes.shape[0]):
        lane = lanes[i]
        p = min(i, parameters.shape[0] - 1)
        for k in range(lane.k, min(lane.length, y.shape[1])):
            row = parameters[p, min(k // interval, parameters.shape[1] - 1)]
            now = min(k, models.shape[1] - 1)
            received = receive(lane, y, lost, i, k)
            step(
                lane, models[i, now], smalls[i, now], modes, prior, near, losses, time[i, k],
                received, row[PROCESS], row[MEASUREMENT], row[SCALE_STAY], row[REGIME_STAY],
                row[OUTLIER_RATE],
            )  # fmt: skip
            report(lane, i, k, states, covariances, innovations, nis, log_likelihoods)
            if weights.shape[1] > 0:
                for j in range(lane.grid[0] * lane.grid[1]):
                    weights[i, k, j // weights.shape[3], j % weights.shape[3]] = lane.weight[j]
