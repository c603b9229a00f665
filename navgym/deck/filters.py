"""The deck's family of filters: the alignment kernel, and identification of the flexure beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.deck import alignment as kernels
from navgym.deck import alignment_model, hypotheses
from navgym.deck.batch import DeckBatch
from navgym.deck.catalogue import Deck
from navgym.deck.increments import increments_of, rodrigues
from navgym.inertial.flexure import FlexureModel
from navgym.problem import Filter

# What shrinkage leans on: spread of (ln 2μ, ln b², ln σ) about the believed model, and how far fits miss
# the sampling limit. Wider, identification costs more in a steady sea than it wins in a changing one.
PRIOR_SPREAD, SAMPLING = 0.3, 2.0


@dataclass(frozen=True)
class Identified:
    """A flexure model put to use on the way.

    Args:
        step: filter step from which on it holds.
        model: the model.
    """

    step: int
    model: FlexureModel


def estimate(
    chosen: Filter, batch: DeckBatch, table: Array, interval: int, everything: bool
) -> dict[str, Any]:
    """Run the deck filter `chosen` over a batch.

    Args:
        chosen: entry of the catalogue.
        batch: mechanised recordings.
        table: (N or 1, intervals, parameters) in the order of the filter's space.
        interval: steps per row of `table`.
        everything: whether to return covariances and what belongs to each innovation.

    Returns:
        Arrays (N, K, ...): states; with `everything` also `report` (records `alignment.REPORT`)
        and covariances; `diverged` (N,); `flexures`, a list of `Identified` per recording.
    """
    count, steps = batch.tapes.shape
    option: Deck = chosen.option
    if option.truth or option.bank or option.joint:
        return hypotheses.estimate(chosen, batch, table, interval, everything)
    rows = np.ascontiguousarray(full_table(chosen.space, table))
    if option.printed:
        models = np.stack([printed_models(r) for r in batch.recordings])
    else:
        models = np.stack([alignment_model.pack(r) for r in batch.recordings])
    lanes = np.zeros(count, kernels.LANE)
    kernels.begin(lanes, models, rows[:, 0])
    world = (batch.tapes, rule_of(option, everything), rows, interval)
    rest = steps if everything else 0
    outputs = {
        "states": np.full((count, steps, kernels.STATES), np.nan),
        "report": np.full((count, rest), np.nan, kernels.REPORT),
        "covariances": np.full((count, rest, kernels.STATES, kernels.STATES), np.nan),
    }
    flexures: list[list[Identified]] = [[] for _ in range(count)]
    if option.method is None:
        lanes["length"] = batch.lengths
        kernels.run(lanes, models, *world, *outputs.values())
    else:
        _run_identifying(chosen, batch, table, lanes, models, world, outputs, flexures)
    return outputs | {"diverged": lanes["diverged"] > 0, "flexures": flexures}


def rule_of(option: Deck, judged: bool) -> NDArray[Any]:
    """The kernel's rule (1,) of a member of the family."""
    rule = np.zeros(1, kernels.RULE)
    rule["iterations"], rule["judged"], rule["own_channels"] = 1, judged, option.own
    for name in ("by_noise", "no_cross", "printed_covariance"):
        rule[name] = option.printed
    return rule


def full_table(space: ParameterSpace, table: Array) -> Array:
    """`table` (..., parameters) of a space in the kernel's columns; those not exposed are off."""
    where = columns_of(space)
    found = np.broadcast_to(kernels.OFF, (*table.shape[:-1], len(kernels.OFF))).copy()
    found[..., where >= 0] = table[..., where[where >= 0]]
    return found


def columns_of(space: ParameterSpace) -> NDArray[np.int64]:
    """Where each of the kernel's columns stands in a space; -1 where it is not exposed."""
    names = space.names
    return np.array([names.index(c) if c in names else -1 for c in kernels.COLUMNS])


def printed_models(recording: Any, flexure: FlexureModel | None = None) -> NDArray[Any]:
    """MODEL records of the printed filter: damping 2b whatever was identified (eq. 76)."""
    given = recording.model.flexure if flexure is None else flexure
    b = np.sqrt(given.stiffness)
    return alignment_model.pack(recording, [FlexureModel(2.0 * b, b**2, given.sigma)])


def _run_identifying(
    chosen: Filter,
    batch: DeckBatch,
    table: Array,
    lanes: NDArray[Any],
    models: NDArray[Any],
    world: tuple[Any, ...],
    outputs: dict[str, Array],
    flexures: list[list[Identified]],
) -> None:
    """Filter window by window; after each, identify the flexure anew and go on with it."""
    windows = np.broadcast_to(table[:, 0, chosen.space.index("identification_window")], len(lanes))
    every = np.maximum(1, np.round(windows / batch.step).astype(np.int64))
    ends = np.zeros(len(lanes), dtype=np.int64)
    while (ends < batch.lengths).any():
        ends = np.minimum(ends + every, batch.lengths)
        lanes["length"] = ends
        kernels.run(lanes, models, *world, *outputs.values())
        for i in map(int, np.flatnonzero(ends < batch.lengths)):
            end = int(ends[i])
            row = min((end - 1) // world[3], table.shape[1] - 1)
            options = dict(zip(chosen.space.names, table[min(i, len(table) - 1), row], strict=True))
            believed = batch.recordings[i].model.flexure
            found = identify_lane(
                chosen.option,
                batch.tapes[i],
                batch.step,
                believed,
                lanes[i],
                int(every[i]),
                options,
            )
            if found is not None:
                flexures[i].append(Identified(end, found))
                put_flexure(chosen.option, batch, int(i), models, found)


def identify_lane(
    option: Deck,
    tape: NDArray[Any],
    dt: float,
    believed: FlexureModel,
    lane: Any,
    window: int,
    options: Mapping[str, float],
) -> FlexureModel | None:
    """The flexure over a lane's last `window` steps, shrunk toward the believed one.

    Args:
        option: how the filter identifies.
        tape: (K,) of the lane's recording.
        dt: s per filter step.
        believed: the model to shrink toward.
        lane: the filter, after `lane["k"]` steps.
        window: steps to identify from.
        options: parameters by name, of which `rvm_kernel_scale` is used.

    Returns:
        The model, or None where the increments allow no identification (too many gaps, no motion,
        a failed lane).
    """
    from navgym.identification import identify, shrink

    end, l = int(lane["k"]), lane["x"][kernels.L].copy()  # noqa: E741
    if not np.isfinite(l).all():
        return None
    frame = "body" if option.printed else "inertial"
    increments = increments_of(tape[max(0, end - window) : end], rodrigues(l), frame)
    own = {"kernel_scale": options["rvm_kernel_scale"]} if option.method == "rvm" else {}
    assert option.method is not None
    try:
        found = identify(option.method, increments, dt, step=0.5, fewest=80, **own)
    except ValueError:
        return None
    if option.printed or not option.shrunk:
        return found
    return shrink(found, believed, PRIOR_SPREAD, SAMPLING)


def put_flexure(
    option: Deck, batch: DeckBatch, i: int, models: NDArray[Any], flexure: FlexureModel
) -> None:
    """Let lane i go on with another flexure model."""
    if option.printed:
        models[i] = printed_models(batch.recordings[i], flexure)
    else:
        alignment_model.write_flexure(models[i, 0], flexure)
