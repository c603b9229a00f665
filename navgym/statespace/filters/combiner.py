"""A learned combiner on a frozen bank: a recurrent network that weighs the bank's modes anew.

The bank (`navgym.statespace.filters.bank`) runs as it is. After each of its steps a gated recurrent unit (Cho
et al. 2014) reads how the weights are spread over nodes and regimes, how well the sample was
predicted, and what was lost; it moves the log-weight of each R scale and of each regime. The
estimate is the mixture of the same modes under the new weights. Nothing flows back into the bank:
a bad network can spoil an answer, but never the filter, and no log-weight moves by more than
twice `BOUND`.

    u = clip((inputs − shift) ∘ gain)
    r = σ(W_r u + b_r + U_r h + c_r)    n = tanh(W_n u + b_n + r ∘ (U_n h + c_n))
    z = σ(W_z u + b_z + U_z h + c_z)    h = n + z ∘ (h − n)
    a = BOUND tanh((V h + d) / BOUND)   w'_jg ∝ w_jg exp(a_j + a_g)    (node j, regime g)

Inner loops run over units, and so become vector instructions in which each sum keeps its order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import kernel, part
from navgym.core.health import NUMERICAL
from navgym.statespace.batch import StateSpaceBatch, outputs
from navgym.statespace.filters.bank import (
    MEASUREMENT,
    OUTLIER_RATE,
    PROCESS,
    REGIME_STAY,
    SCALE_STAY,
    run_lanes,
    step,
)
from navgym.statespace.filters.lane import receive, report
from navgym.statespace.filters.modes import MODE_SETS, Modes, ModeSet, Structure
from navgym.statespace.filters.modes import pack as pack_modes

BOUND = 5.0  # of what is added to the log-weight of one node or one regime
CLIP = 8.0  # of a normalised input
FLOOR = 1e-4  # added to a marginal weight: below it all are alike
UNITS = 48  # usual number of hidden units
STATES = MEASURED = 4  # [Px, Vx, Py, Vy], all of them measured: what `look` is made for
RESIDUALS = (
    "share received", "log position residual", "log velocity residual", "position lag product",
    "velocity lag product", "position velocity product", "log NIS",
)  # fmt: skip
ARRAYS = ("shift", "gain", "W", "b", "U", "c", "V", "d")


# two axes, of each a position and a velocity, all of them measured
STRUCTURE = Structure((False, True) * 2, (0, 1, 0, 1), True, (0, 2), (1, 3))


def modes_of(chosen: ModeSet) -> Modes:
    """The modes of a bank whose weights a network can read."""
    return Modes.of(chosen, STRUCTURE)


def input_names(chosen: ModeSet) -> tuple[str, ...]:
    """What the network reads on a bank of `chosen` modes, in order."""
    modes = modes_of(chosen)
    nodes = tuple(f"log weight of R x {p:g}, {v:g}" for p, v in modes.scales[:, :2])
    regimes = tuple(f"log weight of {regime.name}" for regime in modes.regimes)
    return nodes + regimes + RESIDUALS


def moved_by(chosen: ModeSet) -> tuple[int, int]:
    """How many log-weights a network moves: of nodes and of regimes."""
    modes = modes_of(chosen)
    return len(modes.prior), len(modes.regimes)


def shapes(chosen: ModeSet, units: int) -> dict[str, tuple[int, ...]]:
    """Shapes of a network's `ARRAYS` with so many hidden units."""
    read, wide, moved = len(input_names(chosen)), 3 * units, sum(moved_by(chosen))
    return {
        "shift": (read,), "gain": (read,), "W": (read, wide), "b": (wide,), "U": (units, wide),
        "c": (wide,), "V": (units, moved), "d": (moved,),
    }  # fmt: skip


def pack(modes: ModeSet, arrays: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """The network as a record (1,) for the kernel; gates in the order r, z, n along columns."""
    sizes = shapes(modes, len(arrays["U"]))
    network = np.zeros(1, np.dtype([(name, np.float64, sizes[name]) for name in ARRAYS]))
    for name in ARRAYS:
        network[name] = arrays[name]
    return network


def idle(modes: ModeSet) -> NDArray[Any]:
    """A network of the usual size that moves nothing: the bank itself."""
    return pack(modes, {name: np.zeros(shape) for name, shape in shapes(modes, UNITS).items()})


def fits(batch: StateSpaceBatch) -> bool:
    """Whether a network can read a bank on this batch: models that tell it what it was taught."""
    if "H" not in (batch.models.dtype.names or ()):
        return False
    if batch.models.dtype["x0"].shape != (STATES,) or batch.y.shape[2] != MEASURED:
        return False
    found = Structure.of(batch)
    return (found.velocities, found.position, found.velocity, found.moving) == (
        STRUCTURE.velocities, STRUCTURE.position, STRUCTURE.velocity, True,
    ) and len(Modes.of(MODE_SETS["bank"], found).prior) == moved_by(MODE_SETS["bank"])[0]  # fmt: skip


def memory_type(read: int, units: int, moved: int, modes: int) -> np.dtype[Any]:
    """Record of what the network keeps of one series between samples, and of its scratch."""
    f8 = np.float64
    return np.dtype(
        [
            ("h", f8, (units,)),
            ("z", f8, (MEASURED,)),  # whitened innovation of the last sample that was received
            ("input", f8, (read,)),
            ("now", f8, (3 * units,)),
            ("past", f8, (3 * units,)),
            ("factor", f8, (moved,)),
            ("bank", f8, (modes,)),
            ("weight", f8, (modes,)),
            ("off", f8, (STATES,)),
            ("x", f8, (STATES,)),
            ("P", f8, (STATES, STATES)),
        ]
    )


def estimate(
    network: NDArray[Any],
    modes: ModeSet,
    batch: StateSpaceBatch,
    table: Array,
    everything: bool,
    watch: bool = False,
) -> dict[str, Array]:
    """Run a bank and a network on it over a batch.

    Args:
        network: as `pack` makes it.
        modes: of the bank.
        batch: recordings of 4 states and 4 measurements.
        table: the bank's parameters (1, 1, 5).
        everything: whether more than `states` and `diverged` is wanted: as in
            `navgym.estimation.run`, innovations, NIS and likelihood being the bank's own.
        watch: whether to add what a training needs: `inputs` (N, T, ·), the modes' `means`
            (N, T, J, 4) and the bank's own weights `bank_weights` (N, T, J).
    """
    count, steps = batch.y.shape[:2]
    found: dict[str, Any] = outputs(batch, STATES, MEASURED, everything)
    read, units = network["W"].shape[1], network["U"].shape[1]
    own, design = pack_modes(modes, STRUCTURE, STATES)
    J, moved = own.count, len(own.prior) + len(own.regimes)
    watched = steps if watch else 0
    found["weights"] = np.full((count, steps if everything else 0, J), np.nan)
    found["inputs"] = np.full((count, watched, read), np.nan)
    found["means"] = np.full((count, watched, J, STATES), np.nan)
    found["bank_weights"] = np.full((count, watched, J), np.nan)
    kind = memory_type(read, units, moved, J)
    found["memories"] = np.zeros(count, kind)
    lanes = run_lanes(partial(run, network), batch, table, 1, STRUCTURE, design, found)
    del found["memories"]
    if not watch:
        for name in ("inputs", "means", "bank_weights"):
            del found[name]
    return found | {"diverged": lanes["diverged"] > 0}


@part
def tanh(x):
    """Hyperbolic tangent to 1e-15: Padé's [5/6] of x/8, doubled thrice. Unlike libm's it vectorises."""
    x = min(max(x, -20.0), 20.0) * 0.125
    y = x * x
    t = x * (10395.0 + y * (1260.0 + y * 21.0)) / (10395.0 + y * (4725.0 + y * (210.0 + y)))
    t = 2.0 * t / (1.0 + t * t)  # tanh 2x = 2 tanh x / (1 + tanh² x)
    t = 2.0 * t / (1.0 + t * t)
    return 2.0 * t / (1.0 + t * t)


@part
def signed_root(x):
    """x drawn towards zero where it is large, with its sign."""
    return x / math.sqrt(1.0 + abs(x))


@part
def look(lane, work, design, memory, received):
    """Write the network's inputs: log marginals of the weights, residuals, what was received."""
    A, B = design.nodes, design.regimes
    for a in range(A + B):
        memory.input[a] = FLOOR
    for b in range(B):
        for j in range(design.begin[b], design.begin[b + 1]):
            w = lane.after.weight[j] if received > 0 else work.before.weight[j]
            memory.bank[j] = w
            memory.input[design.node[j]] += w
            memory.input[A + b] += w
    for a in range(A + B):
        memory.input[a] = math.log(memory.input[a])
    m = lane.y.shape[0]
    half, at = m // 2, A + B
    memory.input[at] = received / m
    for i in range(1, len(RESIDUALS)):
        memory.input[at + i] = 0.0
    if received > 0:
        # sums over the two axes: they do not change when the axes are turned
        for i in range(half):
            u, v = lane.z[i], lane.z[i + half]
            memory.input[at + 1 + i] = math.log(0.01 + u * u + v * v)
            lagged = u * memory.z[i] + v * memory.z[i + half]
            memory.input[at + 1 + half + i] = signed_root(lagged)
        for i in range(m):
            memory.z[i] = lane.z[i]
        crossed = lane.z[0] * lane.z[1] + lane.z[half] * lane.z[half + 1]
        memory.input[at + 5] = signed_root(crossed)
        memory.input[at + 6] = math.log(0.01 + lane.nis)


@part
def think(network, memory):
    """One step of the recurrent unit; leaves exp(a) of each R scale and regime in `factor`."""
    read, wide = network.W.shape
    units = wide // 3
    for o in range(wide):
        memory.now[o] = network.b[o]
        memory.past[o] = network.c[o]
    for i in range(read):
        u = (memory.input[i] - network.shift[i]) * network.gain[i]
        u = min(max(u, -CLIP), CLIP)
        for o in range(wide):
            memory.now[o] += network.W[i, o] * u
    for i in range(units):
        h = memory.h[i]
        for o in range(wide):
            memory.past[o] += network.U[i, o] * h
    for o in range(2 * units):
        memory.now[o] = 0.5 + 0.5 * tanh(0.5 * (memory.now[o] + memory.past[o]))
    for o in range(units):
        n = tanh(memory.now[2 * units + o] + memory.now[o] * memory.past[2 * units + o])
        memory.h[o] = n + memory.now[units + o] * (memory.h[o] - n)
    moved = network.d.shape[0]
    for j in range(moved):
        memory.factor[j] = network.d[j]
    for i in range(units):
        h = memory.h[i]
        for j in range(moved):
            memory.factor[j] += network.V[i, j] * h
    for j in range(moved):
        memory.factor[j] = math.exp(BOUND * tanh(memory.factor[j] / BOUND))


@part
def reweigh(lane, work, design, memory, received):
    """The modes' new weights, and the mean of the mixture; NaN where the bank failed."""
    axes, A = lane.axes, design.nodes
    p = memory.x.shape[0] // axes
    total = 0.0
    for b in range(design.regimes):
        for j in range(design.begin[b], design.begin[b + 1]):
            w = memory.bank[j] * (memory.factor[design.node[j]] * memory.factor[A + b])
            memory.weight[j] = w
            total += w
    for j in range(design.modes):
        memory.weight[j] /= total
    for g in range(axes):
        for i in range(p):
            s = math.nan if lane.diverged == NUMERICAL else 0.0
            for j in range(design.modes):
                s += memory.weight[j] * mean_of(lane, work, received, i * axes + g, j)
            memory.x[g * p + i] = s


@part
def mean_of(lane, work, received, row, j):
    """Row of mode j's mean, after a sample or at a row without one."""
    return lane.after.mean[row, j] if received > 0 else work.before.mean[row, j]


@part
def spread(lane, work, design, memory, received):
    """Covariance of the mixture under the new weights; NaN where the bank failed."""
    axes, n = lane.axes, memory.x.shape[0]
    p = n // axes
    for i in range(n):
        for k in range(n):
            memory.P[i, k] = 0.0
    for j in range(design.modes):
        w = memory.weight[j]
        for r in range(n):
            memory.off[(r % axes) * p + r // axes] = mean_of(lane, work, received, r, j)
        for i in range(n):
            memory.off[i] -= memory.x[i]
        for i in range(n):
            for k in range(n):
                s = memory.off[i] * memory.off[k]
                if i // p == k // p:
                    a, b = max(i % p, k % p), min(i % p, k % p)
                    if received > 0:
                        s += lane.after.cov[a, b, j]
                    else:
                        s += work.before.cov[a, b, j]
                memory.P[i, k] += w * s


@kernel
def run(
    networks, lanes, works, designs, models, noises, y, lost, time, parameters, interval,
    states, covariances, innovations, nis, log_likelihoods, weights, inputs, means, bank_weights,
    memories,
):  # fmt: skip
    """Filter every series with the bank, and weigh its modes anew after each sample."""
    network, work, design = networks[0], works[0], designs[0]
    for i in range(lanes.shape[0]):
        lane, memory = lanes[i], memories[i]
        row = min(i, parameters.shape[0] - 1)
        for k in range(lane.k, min(lane.length, y.shape[1])):
            now = min(k, models.shape[1] - 1)
            chosen = parameters[row, min(k // interval, parameters.shape[1] - 1)]
            received = receive(lane, y, lost, i, k)
            step(
                lane, work, design, models[i, now],
                noises[min(i, noises.shape[0] - 1), min(k, noises.shape[1] - 1)], time[i, k],
                received, chosen[PROCESS], chosen[MEASUREMENT], chosen[SCALE_STAY],
                chosen[REGIME_STAY], chosen[OUTLIER_RATE],
            )  # fmt: skip
            look(lane, work, design, memory, received)
            think(network, memory)
            reweigh(lane, work, design, memory, received)
            report(lane, i, k, states, covariances, innovations, nis, log_likelihoods)
            replace(lane, work, design, memory, received, i, k, states, covariances, weights)
            if inputs.shape[1] > 0:
                show(lane, work, design, memory, received, i, k, inputs, means, bank_weights)


@part
def replace(lane, work, design, memory, received, i, k, states, covariances, weights):
    """Write the new estimate over the bank's own."""
    n = memory.x.shape[0]
    for a in range(n):
        states[i, k, a] = memory.x[a]
    if covariances.shape[1] > 0:
        spread(lane, work, design, memory, received)
        for a in range(n):
            for b in range(n):
                covariances[i, k, a, b] = memory.P[a, b]
        for j in range(design.modes):
            weights[i, k, j] = memory.weight[j]


@part
def show(lane, work, design, memory, received, i, k, inputs, means, bank_weights):
    """Write what the network reads, and what it weighs."""
    n, axes = memory.x.shape[0], lane.axes
    p = n // axes
    for a in range(memory.input.shape[0]):
        inputs[i, k, a] = memory.input[a]
    for j in range(design.modes):
        bank_weights[i, k, j] = memory.bank[j]
        for r in range(n):
            row = (r % axes) * p + r // axes
            means[i, k, j, row] = mean_of(lane, work, received, r, j)
