"""Run an INS filter over recordings."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.ins import filtering as kernels
from navgym.ins.batch import InsBatch
from navgym.ins.catalogue import Ins
from navgym.ins.error_state import COLUMNS, LANE, STATES
from navgym.problem import Filter, Run

RULES = ("trust", "student", "correntropy", "variational", "bank", "oracle")  # the kernel's numbers
# where a filter does not expose a column
OFF = {
    "imu_noise_scale": 1.0, "dvl_noise_scale": 1.0, "fix_noise_scale": 1.0, "magnetic_noise_scale": 1.0,
    "fill": 0.0, "fill_variance": 1.0, "fill_growth": 0.0, "fill_turn_limit": 180.0, "gate": np.inf,
    "student_freedom": 4.0, "kernel_width": 50.0, "forgetting": 0.97, "vb_iterations": 3.0,
    "vibration_meter": 0.0,
}  # fmt: skip
NO_GATE = 1e4  # a gate of this and more is off


def run(chosen: Filter, batch: InsBatch, table: Array, interval: int, everything: bool) -> Run:
    """Run one INS filter over a batch; see `navgym.problem.Problem.run`."""
    if chosen.needs_scales and any(
        r.noise_scales is None or r.imu_scale is None for r in batch.recordings
    ):
        raise ValueError(
            f"filter {chosen.name!r} needs the true noise, which only simulated recordings carry: "
            "use ins_bank."
        )
    count, steps = batch.tapes.shape
    rows = full_table(chosen.space, table)
    lanes = np.zeros(count, LANE)
    kernels.begin(lanes, batch.models, rows[:, 0])
    lanes["length"] = batch.lengths
    rest = steps if everything else 0
    states = np.full((count, steps, STATES), np.nan)
    report = np.zeros((count, max(rest, 1)), kernels.REPORT)
    for name in ("innovation", "weights", "nis", "log_likelihood"):
        report[name] = np.nan
    covariances = np.full((count, rest, STATES, STATES), np.nan)
    kernels.run(
        lanes, batch.models, batch.sensors, batch.tapes, batch.events, rule_of(chosen.option, everything),
        rows, interval, states, report, covariances,
    )  # fmt: skip
    report = report[:, :rest]
    return Run(
        states=states,
        diverged=lanes["diverged"] > 0,
        covariances=covariances,
        innovations=report["innovation"],
        nis=report["nis"],
        log_likelihood=report["log_likelihood"],
        components=report["components"],
        extras={"weights": report["weights"]},
    )


def rule_of(option: Ins, judged: bool) -> NDArray[Any]:
    """The kernel's rule (1,) of a member of the family."""
    rule = np.zeros(1, kernels.RULE)
    rule["kind"], rule["judged"] = RULES.index(option.rule), judged
    return rule


def full_table(space: ParameterSpace, table: Array) -> Array:
    """`table` (..., parameters) of a space in the kernel's columns; those not exposed are off."""
    where = columns_of(space)
    found = np.broadcast_to([OFF[c] for c in COLUMNS], (*table.shape[:-1], len(COLUMNS))).copy()
    found[..., where >= 0] = table[..., where[where >= 0]]
    gate = found[..., COLUMNS.index("gate")]
    gate[gate >= NO_GATE] = np.inf
    return np.ascontiguousarray(found)


def columns_of(space: ParameterSpace) -> NDArray[np.int64]:
    """Where each of the kernel's columns stands in a space; -1 where it is not exposed."""
    names = space.names
    return np.array([names.index(c) if c in names else -1 for c in COLUMNS])
