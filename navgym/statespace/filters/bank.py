"""Banks of Kalman filters over noise scales and regimes: interacting multiple models.

What the modes are stands in `modes`; how they move and leak to each other in `mixing`; how a sample
updates and weighs them in `updating`.

The chains are in seconds, and what happens between two received samples is done at once, when the
second arrives: rows without a measurement only read from the modes as the last received sample left
them. So an estimate does not depend on how a log is cut.

Where two axes have the same model and lose the same components, all modes keep one covariance for
both; from the first sample that they do not lose alike the state is treated as a whole.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import kernel, part
from navgym.core.health import settle
from navgym.core.sizes import sample_size, state_size
from navgym.statespace.batch import StateSpaceBatch, outputs
from navgym.statespace.filters.lane import (
    PERIOD,
    expect,
    fields,
    keep_prediction,
    padded,
    receive,
    report,
    silence,
    start,
    watch,
)
from navgym.statespace.filters.mixing import (
    age_by,
    gather,
    leak,
    mix_biases,
    motions,
    move_on,
    predict_modes,
    scatter,
    unfold,
)
from navgym.statespace.filters.modes import (
    BIAS,
    BRANCHES,
    MODE_SETS,
    MOST_MODES,
    MOST_NODES,
    MOST_REGIMES,
    Structure,
    pack,
)
from navgym.statespace.filters.updating import (
    believe,
    combine,
    correct_modes,
    foretell,
    group,
    judge_modes,
    observe_modes,
    weigh,
)

if TYPE_CHECKING:
    from navgym.problem import Filter

# columns of a parameter array
PROCESS, MEASUREMENT, SCALE_STAY, REGIME_STAY, OUTLIER_RATE = range(5)
LOST_LEAK = 0.2  # leaks are this much smaller once nothing has been received for a `PERIOD`


def mixture_type(n: int) -> np.dtype[Any]:
    """Record of a mixture of Gaussians over n states, and over the errors of velocity sensors.

    Row i·axes + g of `mean` is state i of axis g, or a bias; `cov` is that of one axis.
    """
    f8, N = np.float64, n + n // 2
    return np.dtype(
        [
            ("mean", f8, (N, MOST_MODES)),
            ("cov", f8, (N, N, MOST_MODES)),
            ("weight", f8, (MOST_MODES,)),
        ]
    )


def lane_type(n: int, m: int) -> np.dtype[Any]:
    """Record of one bank over n states and m measurements. All mode sets share it."""
    f8, i8 = np.float64, np.int64
    own = [
        ("after", mixture_type(n), ()),  # as the last received sample left it
        ("origin", f8, (n,)),  # its mean, and its covariance
        ("origin_P", f8, (n, n)),
        ("axes", i8, ()),  # how many share a covariance
        ("rows_since", i8, ()),
        ("row_time", f8, ()),
        ("fade", f8, ()),  # of a velocity sensor's error since then
        # motion of one axis since the last received sample
        ("F", f8, (n, n)),
        ("Q", f8, (n, n)),
    ]
    return np.dtype(own + fields(n, m))


def work_type(n: int, m: int) -> np.dtype[Any]:
    """Record of the scratch of one step; lanes share it."""
    f8, i8, N, J = np.float64, np.int64, n + n // 2, MOST_MODES
    K = 1 + n + n * (n + 1) // 2
    return np.dtype(
        [
            ("mixed", mixture_type(n), ()),
            ("before", mixture_type(n), ()),  # predicted
            ("known", f8, (3,)),  # what the leaks below are for: age, and the two parameters
            ("stay", f8, (MOST_REGIMES,)),
            ("node_stay", f8, ()),
            ("norm", f8, (J,)),
            ("moment", f8, (J, K)),
            ("mixed_moment", f8, (J, K)),
            ("left", f8, (MOST_NODES, K)),  # what leaves the regimes, by node
            ("came", f8, (MOST_NODES, K)),
            ("held", f8, (MOST_REGIMES, K)),  # what leaves the nodes, by regime
            ("total", f8, (K,)),
            ("kept", f8, (J,)),
            ("Q", f8, (BIAS, n, n)),  # by kind of motion
            ("FC", f8, (N, N, J)),
            ("used", i8, (m,)),
            ("count", i8),
            ("HC", f8, (m, N, J)),
            ("L", f8, (BRANCHES, m, m, J)),
            ("d", f8, (BRANCHES, m, J)),  # 1 / L_ii
            ("e", f8, (BRANCHES, m, J)),
            ("nis", f8, (BRANCHES, J)),
            ("odds", f8, (BRANCHES, J)),
            ("G", f8, (m, N, J)),
            ("K", f8, (m, N, J)),
            ("A", f8, (N, N, J)),
            ("move", f8, (N, J)),
            ("row", f8, (J,)),
            ("share", f8, (J,)),
            ("off", f8, (n, J)),
            ("likelihood", f8, (J,)),
        ]
    )  # fmt: skip


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


def estimate(
    chosen: Filter, batch: StateSpaceBatch, table: Array, interval: int, everything: bool
) -> dict[str, Array]:
    """Run the bank `chosen` over a batch; see `navgym.estimation.run`.

    Beside what every filter says: `weights` of the modes (N, T, J), of their `regimes` (N, T, B) and
    of their `nodes` (N, T, A).
    """
    structure = Structure.of(batch)
    n, m = batch.models.dtype["x0"].shape[0], batch.y.shape[2]
    modes, design = pack(MODE_SETS[chosen.option], structure, n)
    found: dict[str, Any] = outputs(batch, n, m, everything)
    count, steps = batch.y.shape[:2]
    found["weights"] = np.full((count, steps if everything else 0, modes.count), np.nan)
    lanes = run_lanes(run, batch, table, interval, structure, design, found)
    found["regimes"] = found["weights"] @ _members(modes.regime, len(modes.regimes))
    found["nodes"] = found["weights"] @ _members(modes.node, len(modes.prior))
    return found | {"diverged": lanes["diverged"] > 0}


def _members(group: NDArray[np.int64], count: int) -> Array:
    """(J, count) of 0 and 1: which mode is in which group."""
    return np.asarray(group[:, None] == np.arange(count), dtype=np.float64)


def run_lanes(
    runner: Callable[..., None],
    batch: StateSpaceBatch,
    table: Array,
    interval: int,
    structure: Structure,
    design: NDArray[Any],
    found: dict[str, Any],
) -> NDArray[Any]:
    """Run `runner` (`run`, or one that is called alike) over a batch; returns the final lanes.

    Args:
        runner: takes lanes, work, design, what they filter, and the arrays of `found`, in this order.
        batch: stacked recordings.
        table: parameters, (N or 1, intervals, up to 5).
        interval: samples per row of the table.
        structure: of the models.
        design: of the bank, as `pack` makes it.
        found: arrays (N, ...) that the runner writes to.
    """
    n, m = batch.models.dtype["x0"].shape[0], batch.y.shape[2]
    lanes = np.zeros(len(batch), lane_type(n, m))
    noises = structure.noise(batch.models)
    begin(lanes, batch.models, noises, design, axes_of(batch.models, structure))
    lanes["length"] = batch.lengths
    runner(
        lanes, np.zeros(1, work_type(n, m)), design, batch.models, noises,
        batch.y, batch.lost, batch.time, padded(table, (1.0, 1.0, 0.97, 1.0, 0.0)), interval,
        *found.values(),
    )  # fmt: skip
    return lanes


def axes_of(models: NDArray[Any], structure: Structure) -> NDArray[np.int64]:
    """How many axes of packed models (N, K) share a covariance at the start, (N,)."""
    m, n = models["H"].shape[-2:]
    p, s = n // 2, m // 2
    alike = structure.sensors[:s] == structure.sensors[s:]
    for states in (structure.position, structure.velocity):
        c = len(states) // 2
        alike = alike and tuple(i + p for i in states[:c]) == states[c:]
    return np.array([2 if alike and separable(own) else 1 for own in models])


def begin(
    lanes: NDArray[Any],
    models: NDArray[Any],
    noises: Array,
    design: NDArray[Any],
    axes: NDArray[np.int64],
) -> None:
    """Put the lanes (N,) at the start: every mode at x0, P0, weights at their prior.

    Args:
        lanes: (N,) of `lane_type`.
        models: (N, K) packed models.
        noises: of the velocity sensors, (N or 1, K or 1, n, n), see `Structure.noise`.
        design: of the bank, as `pack` makes it.
        axes: how many axes of each share a covariance, (N,): 1 or 2.
    """
    start(lanes, models)
    n = lanes["x"].shape[1]
    after = lanes["after"]
    for i, count in enumerate(axes):
        p, errors = n // count, int(design["biases"][0]) // count
        x0 = models["x0"][i, 0].reshape(count, p)
        after["mean"][i, :n] = x0.T.reshape(n, 1)
        after["cov"][i, :p, :p] = models["P0"][i, 0, :p, :p, None]
        own = design["velocity"][0, :errors]
        law = noises[min(i, len(noises) - 1), 0][np.ix_(own, own)]
        after["cov"][i, p : p + errors, p : p + errors] = law[:, :, None]
    after["weight"] = design["first"][0]
    lanes["origin"], lanes["origin_P"] = models["x0"][:, 0], models["P0"][:, 0]
    lanes["axes"] = axes
    lanes["row_time"] = np.nan


@part
def parted(lane):
    """Whether the two axes of a sample do not lose the same components."""
    half = sample_size(lane) // 2
    apart = False
    for i in range(half):
        apart = apart or lane.use[i] != lane.use[i + half]
    return apart


@kernel
def step(
    lane, work, design, model, noise, t, received, q, r, scale_stay, regime_stay, rate
):  # fmt: skip
    """One sample: mix, predict, judge, update, combine. The sample lies in the lane (`receive`)."""
    n = state_size(lane)
    if lane.axes == 2 and parted(lane):
        unfold(lane, design)
    move_on(lane, design, model, q, t)
    silent = silence(lane, t)
    age = min(silent, PERIOD) + LOST_LEAK * max(silent - PERIOD, 0.0)
    age_by(work, design, age, scale_stay, regime_stay)
    K = gather(lane, work, design)
    leak(work, design, K)
    scatter(lane, work, design, K)
    if design.biases > 0:
        mix_biases(lane, work, design, noise)
    motions(lane, work, design)
    predict_modes(lane, work, design, noise)
    foretell(lane, work, design)
    if received > 0:
        believe(lane, work, design, model, r, rate)
    expect(lane, model, received)
    watch(lane, model, t, received)
    lane.rows_since += 1
    if received > 0:
        groups = 1 + design.branches if rate > 0.0 else 2
        for e in range(groups):
            lo, hi, extra, branch = group(lane, design, e)
            if branch == 0:
                observe_modes(lane, work, design, model, lo, hi, extra)
            judge_modes(lane, work, design, model, lo, hi, extra, branch, r)
        weigh(lane, work, design, rate, received)
        for e in range(groups):
            lo, hi, extra, branch = group(lane, design, e)
            correct_modes(lane, work, design, model, lo, hi, extra, branch, r)
        combine(lane, work, design)
        for i in range(n):
            lane.origin[i] = lane.x[i]
            for k in range(n):
                lane.origin_P[i, k] = lane.P[i, k]
        lane.rows_since = 0
    else:
        keep_prediction(lane)
    settle(lane)


@kernel
def run(
    lanes, works, designs, models, noises, y, lost, time, parameters, interval,
    states, covariances, innovations, nis, log_likelihoods, weights,
):  # fmt: skip
    """Filter every series with parameters (N or 1, intervals, 5)."""
    work, design = works[0], designs[0]
    for i in range(lanes.shape[0]):
        lane = lanes[i]
        p = min(i, parameters.shape[0] - 1)
        for k in range(lane.k, min(lane.length, y.shape[1])):
            row = parameters[p, min(k // interval, parameters.shape[1] - 1)]
            now = min(k, models.shape[1] - 1)
            received = receive(lane, y, lost, i, k)
            step(
                lane, work, design, models[i, now],
                noises[min(i, noises.shape[0] - 1), min(k, noises.shape[1] - 1)], time[i, k],
                received, row[PROCESS], row[MEASUREMENT], row[SCALE_STAY], row[REGIME_STAY],
                row[OUTLIER_RATE],
            )  # fmt: skip
            report(lane, i, k, states, covariances, innovations, nis, log_likelihoods)
            if weights.shape[1] > 0:
                show_weights(lane, work, design, received, weights, i, k)


@kernel
def part_axes(lanes, designs):
    """From one covariance for two axes to one for the whole state, lane by lane."""
    for i in range(lanes.shape[0]):
        if lanes[i].axes == 2:
            unfold(lanes[i], designs[0])


@part
def show_weights(lane, work, design, received, weights, i, k):
    """Write the weights of the modes, after a sample or at a row without one."""
    for j in range(design.modes):
        w = lane.after.weight[j] if received > 0 else work.before.weight[j]
        weights[i, k, j] = w
