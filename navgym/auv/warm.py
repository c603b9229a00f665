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

SCENARIOS = ("nominal", "position-only", "component-loss", "coordinated-turn")
STEPS = {"steps": 3}
# what takes longest to compile comes first, so that no process is left with it at the end
SLOW = ("cukf", "bank", "qivbf")

Job = tuple[str, Callable[[], Any]]


def kernels() -> list[Job]:
    """What there is to compile: a name, and what compiles it."""
    found: list[Job] = [
        (f"{what.__name__} {name}", partial(what, f"auv/{name}"))
        for what in (play, stream)
        for name in ("switch-D", "position-only")
    ]
    runs, seen = [], set()
    for scenario in SCENARIOS:
        turning = scenario == "coordinated-turn"
        for name, chosen in CATALOGUE.items():
            # one filter stands for its family; the linear ones need no turning model
            key = (chosen.family, scenario)
            if key not in seen and chosen.nonlinear >= turning:
                seen.add(key)
                runs.append((name, scenario))
    runs.sort(key=lambda job: SLOW.index(job[0]) if job[0] in SLOW else len(SLOW))
    return found + [(f"{n} on {s}", partial(filter_one, n, s)) for n, s in runs]


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
