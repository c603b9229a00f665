"""What touches every kernel of the AUV once, in the usual sizes of models."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from navgym.auv.live_bank import LiveBank
from navgym.problem import PROBLEMS
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import combiner
from navgym.statespace.filters.catalogue import CATALOGUE
from navgym.statespace.filters.modes import MODE_SETS
from navgym.statespace.models import LinearModel
from navgym.warm import brief, play, stream

# groups of scenarios whose models have the same sizes, the larger first
SCENARIOS = (("switch-D", "component-loss", "coordinated-turn"), ("position-only",))
STEPS = {"steps": 3}

Job = tuple[str, Callable[[], Any]]


def kernels() -> list[list[Job]]:
    """What there is to compile: groups of a name, and what compiles it."""
    return [_group(scenarios) for scenarios in SCENARIOS]


def _group(scenarios: tuple[str, ...]) -> list[Job]:
    """The environment and every family of filters; the linear ones need no turning model."""
    found: list[Job] = [
        (f"{what.__name__} {scenarios[0]}", partial(what, f"auv/{scenarios[0]}"))
        for what in (play, stream)
    ]
    for scenario in scenarios:
        turning = scenario == "coordinated-turn"
        # one filter stands for its family
        family = {f.family: name for name, f in CATALOGUE.items() if f.nonlinear >= turning}
        found += [(f"{n} on {scenario}", partial(filter_one, n, scenario)) for n in family.values()]
    return found


def filter_one(name: str, scenario: str) -> None:
    """Run a filter, and a combiner on the bank, on three samples."""
    auv = PROBLEMS["auv"]
    batch = StateSpaceBatch.of([brief(auv, f"auv/{scenario}", **STEPS)])
    auv.run(name, batch, everything=True)
    if CATALOGUE[name].family == "bank" and combiner.fits(batch):
        table = CATALOGUE["bank"].space.array()[None]
        chosen = MODE_SETS["bank"]
        combiner.estimate(combiner.idle(chosen), chosen, batch, table, everything=True)
        live = LiveBank(_apart)
        for time in (1.0, 3.0):
            live.step(batch.y[0, 0], time=time)


def _apart(step: float) -> LinearModel:
    """Two axes that are alike at first: a live bank parts them."""
    return LinearModel(dt=step, R=np.diag([1.0, 1.0, step, 1.0]))
