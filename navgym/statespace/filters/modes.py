"""What a bank believes possible: its modes as data, and their packed form for the kernel.

A mode is a node, which says how much noisier than the model the measurements are, in a regime, which
says how the vehicle moves and whether outliers occur. Nodes and regimes are two chains that leak
apart from each other; not every node exists in every regime, and what would leak to a mode that does
not exist is spread over those that do.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array

if TYPE_CHECKING:
    from navgym.statespace.batch import StateSpaceBatch

# what stands here is frozen into kernels
MOST_MODES = 104
MOST_NODES = 32
MOST_REGIMES = 12
BRANCHES = 3  # no outlier, and two kinds of it
MODEL, LATE, BIAS = range(3)  # what moves the state in a regime
NEIGHBOURS = 1.25  # nodes whose scales differ by no more than this, in ln, leak to each other

Motion = Literal["model", "late", "bias"]
_MOTIONS: dict[Motion, int] = {"model": MODEL, "late": LATE, "bias": BIAS}


@dataclass(frozen=True)
class Node:
    """How noisy the sensors are.

    Args:
        position: multiple of R, of rows that measure positions (of all rows where the model knows
            no velocities).
        velocity: of rows that measure velocities.
        process: multiple of Q, beside the regime's.
        prior: relative share of the leak that flows to this node.
    """

    position: float
    velocity: float
    process: float = 1.0
    prior: float = 1.0


@dataclass(frozen=True)
class Regime:
    """How the vehicle moves, and whether a sample may be an outlier.

    Args:
        name: for plots and tables.
        prior: relative share of the leak that flows to this regime.
        leak: its leak over that of `regime_stay`.
        process: multiple of Q.
        outliers: whether outliers occur.
        motion: "model"; "late": the velocity is `ModeSet.lag` s older than the position; "bias": the velocity
            sensor has an error that is forgotten in `ModeSet.memory` s.
        nodes: (position, velocity) scales of the nodes that exist in this regime; None for all.
    """

    name: str
    prior: float
    leak: float = 1.0
    process: float = 1.0
    outliers: bool = False
    motion: Motion = "model"
    nodes: tuple[tuple[float, float], ...] | None = None


@dataclass(frozen=True)
class ModeSet:
    """The modes of a bank.

    Args:
        nodes: see `Node`.
        regimes: see `Regime`.
        near: share of a node's leak that goes to those beside it in the list whose scales are near.
        outliers: (share, factor on position rows, factor on velocity rows) of R for each kind of
            outlier; shares add up to one.
        sensors: multiples of R that each sensor may have alone where several measure the same kind
            of thing; such nodes have a `sensor_prior`.
        sensor_prior: prior of those nodes.
        lag: s.
        memory: time constant of a velocity sensor's error, s.
    """

    nodes: tuple[Node, ...]
    regimes: tuple[Regime, ...] = (Regime("model", 1.0),)
    near: float = 0.0
    outliers: tuple[tuple[float, float, float], ...] = ((1.0, 100.0, 100.0),)
    sensors: tuple[float, ...] = ()
    sensor_prior: float = 0.3
    lag: float = 0.75
    memory: float = -1.0 / math.log(0.9)


def _even(*scales: float, prior: float = 1.0) -> tuple[Node, ...]:
    """Nodes whose scale is the same for all rows."""
    return tuple(Node(s, s, prior=prior) for s in scales)


def _pairs(*scales: float) -> tuple[tuple[float, float], ...]:
    return tuple((s, s) for s in scales)


def _listed(*pairs: tuple[float, float]) -> ModeSet:
    """Modes given one by one as (R scale, Q scale), each leaking evenly to all others."""
    return ModeSet(tuple(Node(r, r, q) for r, q in pairs))


_TEN = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
_UNEVEN = (
    (1.0, 0.05), (1.0, 10.0), (1.0, 30.0), (0.1, 1.0), (10.0, 1.0), (30.0, 1.0), (10.0, 300.0),
    (300.0, 10.0),
)  # fmt: skip
_SHARP = ((1.0, 1.0), (1.0, 0.05))  # a lag or an error shows where the velocity sensor is precise
BANK = ModeSet(
    nodes=(*_even(*_TEN), *(Node(p, v, prior=0.3) for p, v in _UNEVEN)),
    regimes=(
        Regime("calm", 4.0),
        Regime("manoeuvre", 0.5, process=100.0),
        Regime("hard manoeuvre", 0.05, 4 / 3, process=1000.0, nodes=_pairs(0.3, 1.0, 3.0)),
        Regime("late", 0.5, 2 / 3, motion="late", nodes=_SHARP),
        Regime("late, manoeuvre", 0.25, process=10.0, motion="late", nodes=_pairs(1.0)),
        Regime("outliers", 2.0, outliers=True),
        Regime(
            "manoeuvre, outliers", 0.25, process=100.0, outliers=True,
            nodes=_pairs(0.3, 1.0, 3.0, 10.0, 30.0, 100.0),
        ),
        Regime("velocity error", 0.3, 2 / 3, motion="bias", nodes=_SHARP),
    ),
    near=0.1,
    outliers=((0.7, 100.0, 100.0), (0.3, 100.0, 1.0)),
    sensors=(0.1, 10.0, 30.0),
)  # fmt: skip
_EIGHT = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
BANK_2026 = ModeSet(
    nodes=_even(*_EIGHT),
    regimes=(
        Regime("calm", 4.0), Regime("manoeuvre", 1.0, process=100.0),
        Regime("outliers", 2.0, outliers=True),
    ),
    near=0.1,
)  # fmt: skip
IMM = _listed((0.25, 1.0), (1.0, 1.0), (25.0, 1.0), (100.0, 1.0), (1.0, 100.0), (100.0, 100.0))
IMM_WIDE = _listed(
    *((r, 1.0) for r in _EIGHT), *((r, 100.0) for r in (0.1, 0.3, 1.0, 3.0, 10.0))
)  # fmt: skip
MODE_SETS = {"bank": BANK, "bank_2026": BANK_2026, "imm": IMM, "imm_wide": IMM_WIDE}


@dataclass(frozen=True)
class Structure:
    """What a bank knows of a model: which rows measure what, and which state moves which.

    Args:
        velocities: whether each row measures velocities, (m,); all False where the model does not
            tell positions from velocities.
        sensors: number of the sensor of each row, (m,).
        moving: whether velocities are what moves the positions, and both are measured.
        position: states that are positions, in the order of `velocity`.
        velocity: states that are velocities.
    """

    velocities: tuple[bool, ...]
    sensors: tuple[int, ...]
    moving: bool
    position: tuple[int, ...]
    velocity: tuple[int, ...]

    @classmethod
    def of(cls, batch: StateSpaceBatch) -> Structure:
        """The structure that all models of a batch have in common."""
        return cls.among(batch.models, batch.position, batch.velocity, batch.sensors)

    @classmethod
    def among(
        cls,
        models: NDArray[Any],
        positions: tuple[int, ...],
        velocities: tuple[int, ...],
        sensors: tuple[str, ...],
    ) -> Structure:
        """The structure that packed models (...) have in common; see `StateSpaceBatch` for the rest."""
        position, velocity = list(positions), list(velocities)
        H = models["H"].reshape(-1, *models["H"].shape[-2:])
        F = models["F"].reshape(-1, *models["F"].shape[-2:])
        seen = (H != 0.0).any(axis=0)
        others = np.delete(seen, position + velocity, axis=1).any(axis=1)
        where, speed = seen[:, position].any(axis=1), seen[:, velocity].any(axis=1)
        told = bool((where != speed).all() and not others.any() and where.any() and speed.any())
        names = list(dict.fromkeys(sensors))
        moving = told and len(position) == len(velocity)
        if moving:
            moving = bool((F[:, position, velocity] != 0.0).all()) and all(
                (np.linalg.matrix_rank(h[rows][:, states]) == len(states)).all()
                for rows, states in ((where, position), (speed, velocity))
                for h in np.unique(H, axis=0)
            )
        return cls(
            velocities=tuple(bool(s) for s in speed) if told else (False,) * len(seen),
            sensors=tuple(names.index(s) for s in sensors) or (0,) * len(seen),
            moving=moving,
            position=tuple(position) if moving else (),
            velocity=tuple(velocity) if moving else (),
        )

    def noise(self, models: NDArray[Any]) -> Array:
        """Covariance of what the velocity sensors say of the velocities, (N, K, n, n).

        (Hᵀ R⁻¹ H)⁻¹ over their rows; zeros elsewhere. (1, 1, n, n) of zeros where not `moving`.
        """
        n = models["F"].shape[-1]
        if not self.moving:
            return np.zeros((1, 1, n, n))
        found = np.zeros((*models.shape, n, n))
        rows, states = np.flatnonzero(self.velocities), list(self.velocity)
        h = models["H"][..., rows, :][..., states]
        R = models["R"][..., rows, :][..., rows]
        information = np.swapaxes(h, -1, -2) @ np.linalg.solve(R, h)
        found[..., np.array(states)[:, None], states] = np.linalg.inv(information)
        return found


@dataclass(frozen=True, eq=False)
class Modes:
    """The modes of a set that a model has, in the order in which a bank weighs them.

    Args:
        scales: multiple of R of each row, by node, (A, m).
        process: multiple of Q by node, (A,).
        prior: share of the leak that flows to each node, (A,).
        regimes: those that the model can have; first those without outliers, last those with a bias.
        node: of each mode, (J,); modes stand regime by regime.
        regime: of each mode, (J,).
        names: of the nodes, (A,).
    """

    scales: Array
    process: Array
    prior: Array
    regimes: tuple[Regime, ...]
    node: NDArray[np.int64]
    regime: NDArray[np.int64]

    @property
    def count(self) -> int:
        """Number of modes J."""
        return len(self.node)

    @classmethod
    def of(cls, chosen: ModeSet, structure: Structure) -> Modes:
        """The modes of `chosen` under a model of this structure."""
        speed = np.array(structure.velocities)
        both = bool(speed.any() and not speed.all())
        nodes = [n for n in chosen.nodes if both or n.position == n.velocity]
        scales = [np.where(speed, n.velocity, n.position) for n in nodes]
        several = _sensors_apart(structure) if chosen.sensors else []
        apart = [(np.array(structure.sensors) == s, f) for s in several for f in chosen.sensors]
        if len(nodes) + len(apart) > MOST_NODES or len(several) > 4:
            apart = []  # so many sensors share their scales
        scales += [np.where(own, f, 1.0) for own, f in apart]
        priors = [n.prior for n in nodes] + [chosen.sensor_prior] * len(apart)
        process = [n.process for n in nodes] + [1.0] * len(apart)
        kept = [r for r in chosen.regimes if structure.moving or r.motion == "model"]
        kept.sort(key=lambda r: (r.motion == "bias", r.outliers))
        pairs = [(n.position, n.velocity) for n in nodes]
        pairs += [(math.nan, math.nan)] * len(apart)
        at = [
            (a, b)
            for b, regime in enumerate(kept)
            for a, pair in enumerate(pairs)
            if regime.nodes is None or pair in regime.nodes
        ]
        node, regime_of = np.array(at).T
        return cls(
            np.array(scales, dtype=np.float64), np.array(process), np.array(priors) / sum(priors),
            tuple(kept), node, regime_of,
        )  # fmt: skip

    @property
    def shares(self) -> Array:
        """Share of the leak that flows to each regime, (B,)."""
        prior = np.array([r.prior for r in self.regimes])
        return prior / prior.sum()

    @property
    def first(self) -> Array:
        """Weights before the first sample, (J,)."""
        weight = self.prior[self.node] * self.shares[self.regime]
        return np.asarray(weight / weight.sum())

    def near(self, share: float) -> Array:
        """Part of each node's leak that flows to the node before and behind it in the list, (A, A).

        `share`, divided between the two, where its scales are near (`NEIGHBOURS`) in every row.
        """
        log = np.log(np.column_stack([self.scales, self.process]))
        close = np.abs(np.diff(log, axis=0)).max(axis=1, initial=0.0) <= NEIGHBOURS
        beside = np.diag(close, 1) | np.diag(close, -1)
        return np.asarray(share * beside / np.maximum(beside.sum(axis=1, keepdims=True), 1))

    def table(self) -> Array:
        """Rows (Q scale, R scale of each row of H) of the modes, (J, 1 + m)."""
        q = np.array([self.regimes[b].process for b in self.regime]) * self.process[self.node]
        return np.column_stack([q, self.scales[self.node]])


def _sensors_apart(structure: Structure) -> list[int]:
    """Sensors that share what they measure, position or velocity, with another one."""
    kinds = {(s, v) for s, v in zip(structure.sensors, structure.velocities, strict=True)}
    shared = [s for s, v in sorted(kinds) if sum(1 for _, other in kinds if other == v) > 1]
    return list(dict.fromkeys(shared))


def design_type(n: int, m: int) -> np.dtype[Any]:
    """Record of the modes of a model with n states and m measurements, as the kernel reads them."""
    f8, i8, u8, J = np.float64, np.int64, np.uint64, MOST_MODES
    return np.dtype(
        [
            # ends: of all modes, of those without outliers, without bias; unsigned, or else loops from
            # one to another would have to count from the end for a negative index: no vectors
            ("modes", u8), ("plain", u8), ("unbiased", u8),
            ("nodes", i8), ("regimes", i8), ("branches", i8),
            ("pairs", i8), ("biases", i8),  # of position and velocity; errors of velocity sensors
            ("begin", u8, (MOST_REGIMES + 1,)),  # first mode of each regime
            ("node", i8, (J,)),
            ("motion", i8, (MOST_REGIMES,)),
            ("leak", f8, (MOST_REGIMES,)),
            ("first", f8, (J,)),  # weights before the first sample
            # of what leaks by the priors, how much meets a mode: from a node to all regimes, from a
            # regime to all nodes, to all; from a mode to its near ones, from a node to near nodes
            ("to_regimes", f8, (MOST_NODES,)), ("to_nodes", f8, (MOST_REGIMES,)), ("to_all", f8),
            ("to_near", f8, (J,)), ("to_near_nodes", f8, (MOST_NODES,)),
            ("regime_prior", f8, (MOST_REGIMES,)),
            ("node_prior", f8, (MOST_NODES,)),
            ("spread", f8, (MOST_NODES,)),  # share of a node's leak that flows by the priors
            # share of the leak of the node before, and of the one behind, that flows to a node, and
            # to a mode if that has such a neighbour
            ("below", f8, (MOST_NODES,)), ("above", f8, (MOST_NODES,)),
            ("mode_below", f8, (J,)), ("mode_above", f8, (J,)),
            ("process", f8, (J,)),
            ("root", f8, (m, J)),  # √ of the R scale of each row
            ("branch_root", f8, (BRANCHES, m)),
            ("branch_share", f8, (BRANCHES,)),  # of the outliers
            ("position", i8, (n,)), ("velocity", i8, (n,)),
            ("lag", f8), ("memory", f8),
        ]
    )  # fmt: skip


def pack(chosen: ModeSet, structure: Structure, n: int) -> tuple[Modes, NDArray[Any]]:
    """The modes that a model of n states has, and their record (1,)."""
    modes = Modes.of(chosen, structure)
    m = modes.scales.shape[1]
    design = np.zeros(1, design_type(n, m))
    d = design[0]
    J, A, B = modes.count, len(modes.prior), len(modes.regimes)
    if max(J / MOST_MODES, A / MOST_NODES, B / MOST_REGIMES) > 1.0:
        raise ValueError(
            f"a bank has at most {MOST_MODES} modes, {MOST_NODES} nodes and {MOST_REGIMES} regimes, "
            f"got {J}, {A} and {B}."
        )
    bias = np.array([r.motion == "bias" for r in modes.regimes])
    outlying = np.array([r.outliers for r in modes.regimes])
    d["modes"], d["nodes"], d["regimes"] = J, A, B
    d["plain"] = (~(outlying | bias))[modes.regime].sum()
    d["unbiased"] = (~bias)[modes.regime].sum()
    d["branches"] = 1 + len(chosen.outliers)
    d["pairs"] = len(structure.velocity)
    d["biases"] = len(structure.velocity) if bias.any() else 0
    d["begin"][: B + 1] = np.searchsorted(modes.regime, np.arange(B + 1))
    d["node"][:J] = modes.node
    d["motion"][:B] = [_MOTIONS[r.motion] for r in modes.regimes]
    d["leak"][:B] = [r.leak for r in modes.regimes]
    d["regime_prior"][:B], d["node_prior"][:A] = modes.shares, modes.prior
    near = modes.near(chosen.near)
    d["spread"][:A] = 1.0 - near.sum(axis=1)
    d["below"][1:A], d["above"][: A - 1] = np.diagonal(near, 1), np.diagonal(near, -1)
    beside = (np.diff(modes.node) == 1) & (np.diff(modes.regime) == 0)
    d["mode_below"][1:J] = np.where(beside, d["below"][modes.node[1:]], 0.0)
    d["mode_above"][: J - 1] = np.where(beside, d["above"][modes.node[:-1]], 0.0)
    d["first"][:J] = modes.first
    _reach(d, modes, near)
    table = modes.table()
    d["process"][:J], d["root"][:, :J] = table[:, 0], np.sqrt(table[:, 1:].T)
    d["branch_root"] = 1.0
    for b, (share, position, velocity) in enumerate(chosen.outliers, start=1):
        d["branch_share"][b] = share
        d["branch_root"][b] = np.sqrt(np.where(structure.velocities, velocity, position))
    d["position"][: len(structure.position)] = structure.position
    d["velocity"][: len(structure.velocity)] = structure.velocity
    d["lag"], d["memory"] = chosen.lag, chosen.memory
    return modes, design


def _reach(d: Any, modes: Modes, near: Array) -> None:
    """Which share of each leak meets modes that exist: by it the leaks of a mode add up to one."""
    A, B, J = int(d["nodes"]), int(d["regimes"]), modes.count
    exists = np.zeros((A, B))
    exists[modes.node, modes.regime] = 1.0
    d["to_regimes"][:A] = exists @ modes.shares
    d["to_nodes"][:B] = modes.prior @ exists
    d["to_all"] = modes.prior @ exists @ modes.shares
    d["to_near"][:J] = (near @ exists)[modes.node, modes.regime]
    d["to_near_nodes"][:A] = near @ d["to_regimes"][:A]


def facts(chosen: ModeSet) -> dict[str, Any]:
    """A mode set as JSON can hold it: what a network that reads its weights relies on."""
    return dataclasses.asdict(chosen)
