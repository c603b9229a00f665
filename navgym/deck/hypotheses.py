"""Runs the bank's kernel over a batch: `deck_bank`'s four modes, and the oracle's one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.deck import alignment, alignment_model, bank, joint
from navgym.deck.batch import DeckBatch
from navgym.deck.model import DeckModel
from navgym.inertial.flexure import FlexureModel
from navgym.problem import Filter

MODES = ("calm", "rougher sea", "slam", "glitch")  # in the order of `extras["mode_weights"]`
KINDS = np.array([[bank.PLAIN, 0], [bank.PLAIN, 1], [bank.SLAM, 0], [bank.GLITCH, 0]])
_ONE = np.array([[bank.PLAIN, bank.BY_TAPE]])  # of the oracle, whose tape says which model holds
# the rougher sea over the believed one: σ, correlation time, and λ/μ
ROUGHER = (1.5, 0.6, 1.0)
NOTHING_KNOWN = np.zeros((1, 0, 3)), np.zeros((1, 0)), np.zeros((1, 0, 6))
LAGS = 2  # steps back to which θ̇ is told once more
# where a filter does not expose a column: no event, one mode that stays
OFF = np.array([0.2, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 50.0])


def rougher(flexure: FlexureModel) -> FlexureModel:
    """The rougher sea's flexure beside a believed one, whose own damping does not matter."""
    size, pace, oscillation = ROUGHER
    b = np.sqrt(flexure.stiffness) / pace
    mu = b / np.sqrt(1.0 + oscillation**2)
    return FlexureModel(2.0 * mu, b**2, size * flexure.sigma)


def flexures_of(model: DeckModel) -> list[FlexureModel]:
    """The flexure models that the modes point at."""
    return [model.flexure, rougher(model.flexure)]


def table_of(space: ParameterSpace, table: Array) -> Array:
    """`table` (..., parameters) of a space in the kernel's columns; those not exposed are off."""
    found = np.broadcast_to(OFF, (*table.shape[:-1], len(OFF))).copy()
    for i, name in enumerate(space.names):
        found[..., bank.COLUMNS.index(name)] = table[..., i]
    return found


def begin(lanes: NDArray[Any], models: NDArray[Any], kinds: NDArray[Any], lever_sd: Array) -> None:
    """Put lanes (N, J + 1) at the start: modes alike in probability, the pool their mixture.

    Args:
        lanes: of recordings.
        models: (N, M).
        kinds: (J, 2) as the kernel takes them.
        lever_sd: (N,) m.
    """
    which = np.maximum(kinds[[*range(len(kinds)), 0], 1], 0)
    joint.begin(lanes, models[:, which], lever_sd)
    lanes["chance"][:, :-1] = 1.0 / len(kinds)
    lanes["P"][:, -1] = lanes["P"][:, :-1].mean(axis=1)


@dataclass(frozen=True, eq=False)
class Bank:
    """A batch with a bank at its start, ready for the kernel.

    Args:
        batch: of N recordings.
        lanes: (N, J + 1) modes and pool.
        models: (N, M) flexure models.
        kinds: (J, 2) as the kernel takes them.
        rows: (N or 1, intervals, columns) parameters.
        interval: steps per row of those.
        noise: known variances and shares, or nothing.
    """

    batch: DeckBatch
    lanes: NDArray[Any]
    models: NDArray[Any]
    kinds: NDArray[Any]
    rows: Array
    interval: int
    noise: tuple[Array, Array, Array]

    @classmethod
    def of(cls, chosen: Filter, batch: DeckBatch, table: Array, interval: int) -> Bank:
        """The bank, or the oracle, at the start of a batch."""
        rows = np.ascontiguousarray(table_of(chosen.space, table))
        kinds = KINDS if chosen.option.bank else _ONE
        noise = NOTHING_KNOWN
        if chosen.option.truth:
            noise = known_noise(batch)
            batch, models = true_models(batch)
        else:
            packed = (alignment_model.pack(r, flexures_of(r.model)) for r in batch.recordings)
            models = np.stack(list(packed))
        lanes = np.zeros((len(batch), len(kinds) + 1), joint.LANE)
        begin(lanes, models, kinds, np.broadcast_to(rows[:, 0, bank.LEVER_SD], len(batch)))
        return cls(batch, lanes, models, kinds, rows, interval, noise)

    def run(self, first: int, last: int, outputs: Mapping[str, Array]) -> None:
        """Filter steps `first` to `last` of the tapes, from where the lanes are.

        Args:
            first: where the lanes are.
            last: the step after.
            outputs: of those steps; see `outputs_for`.
        """
        tapes = np.ascontiguousarray(self.batch.tapes[:, first:last])
        noise = (np.ascontiguousarray(n[:, first:last]) for n in self.noise)
        self.lanes["length"] = np.minimum(self.batch.lengths, last)[:, None]
        bank.run(
            self.lanes, self.models, self.kinds, tapes, first, self.rows, self.interval, *noise,
            *outputs.values(),
        )  # fmt: skip


def outputs_for(
    count: int, steps: int, modes: int, everything: bool, memories: bool = False
) -> dict[str, NDArray[Any]]:
    """What the kernel writes, NaN so far, by name and in its order.

    Args:
        count: recordings.
        steps: of the longest.
        modes: of the bank.
        everything: False: nothing but states.
        memories: whether each mode's steps are kept, see `bank.MEMORY`: 170 kB a step with four modes.
    """
    rest, n = steps if everything else 0, alignment.STATES
    return {
        "states": np.full((count, steps, n), np.nan),
        "report": np.full((count, rest), np.nan, alignment.REPORT),
        "covariances": np.full((count, rest, n, n), np.nan),
        "mode_weights": np.full((count, rest, modes), np.nan),
        "theta_rate_lagged": np.full((count, rest, LAGS, 3), np.nan),
        "memories": np.zeros((count, steps if memories else 0, modes), bank.MEMORY),
    }


def estimate(
    chosen: Filter, batch: DeckBatch, table: Array, interval: int, everything: bool
) -> dict[str, Any]:
    """Run a bank, or the oracle, over a batch; see `navgym.deck.filters.estimate`.

    Returns also `mode_weights` (N, K, J) and `theta_rate_lagged` (N, K, LAGS, 3), with `everything`.
    """
    count, steps = batch.tapes.shape
    own = Bank.of(chosen, batch, table, interval)
    outputs: dict[str, Any] = outputs_for(count, steps, len(own.kinds), everything)
    own.run(0, steps, outputs)
    del outputs["memories"]
    if not chosen.option.bank:
        del outputs["mode_weights"]
    flexures: list[list[Any]] = [[] for _ in range(count)]
    return outputs | {"diverged": own.lanes["diverged"][:, -1] > 0, "flexures": flexures}


def true_models(batch: DeckBatch) -> tuple[DeckBatch, NDArray[Any]]:
    """The batch with each step's own flexure model, and those models."""
    tapes, packed = batch.tapes.copy(), []
    for i, r in enumerate(batch.recordings):
        rows, which = np.unique(r.true_flexure, axis=0, return_inverse=True)
        models = [FlexureModel(row[:3], row[3:6], row[6:]) for row in rows]
        tapes["model"][i, : len(which)] = which.ravel()
        packed.append(alignment_model.pack(r, models))
        packed[-1]["start"] = packed[-1]["start"][which.ravel()[0]]
    most = max(len(p) for p in packed)
    stacked = [np.concatenate([p, p[[-1] * (most - len(p))]]) for p in packed]
    return replace(batch, tapes=tapes), np.stack(stacked)


def known_noise(batch: DeckBatch) -> tuple[Array, Array, Array]:
    """Variances of jumps and disturbances, and the shares of steps that jumps left: the oracle's."""
    count, steps = batch.tapes.shape
    impulse, disturbance = np.zeros((count, steps, 3)), np.zeros((count, steps, 6))
    left = np.zeros((count, steps))
    for i, r in enumerate(batch.recordings):
        impulse[i, : r.steps] = r.impulse_variance
        disturbance[i, : r.steps] = r.disturbance_variance
        if r.impulse_left is not None:
            left[i, : r.steps] = r.impulse_left[:, 0]
    return impulse, left, disturbance
