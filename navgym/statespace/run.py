"""Run a filter of state-space models over a batch."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

from navgym.core.checks import Array
from navgym.estimation import Estimate
from navgym.metrics.consistency import degrees_of_freedom
from navgym.problem import Filter, Run
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters.catalogue import CATALOGUE

STANDARD = ("states", "covariances", "innovations", "nis", "log_likelihood", "diverged")


def run(
    chosen: Filter, batch: StateSpaceBatch, table: Array, interval: int, everything: bool
) -> Run:
    """Run one filter over a batch; see `navgym.problem.Problem.run`.

    Args:
        chosen: which.
        batch: stacked recordings.
        table: (N or 1, intervals, parameters).
        interval: samples per row of `table`.
        everything: whether more than states is wanted.

    Raises:
        ValueError: a model that is not linear, or true noise scales that are missing.
    """
    _check_linear(chosen, batch)
    if chosen.needs_scales and batch.scales is None:
        raise ValueError(
            f"filter {chosen.name!r} needs the true noise scales, which only simulated recordings "
            "carry: use process_scale and measurement_scale of Recording, or another filter."
        )
    family = importlib.import_module(f"navgym.statespace.filters.{chosen.family}")
    return as_run(family.estimate(chosen, batch, table, interval, everything), batch, everything)


def as_run(found: Mapping[str, Array], batch: StateSpaceBatch, everything: bool) -> Run:
    """What kernels wrote, by name, as a `Run`."""
    heard = degrees_of_freedom(batch.lost)
    extras = {name: each for name, each in found.items() if name not in STANDARD}
    standard: dict[str, Any] = {name: found[name] for name in STANDARD}
    return Run(**standard, components=heard if everything else heard[:, :0], extras=extras)


def _check_linear(chosen: Filter, batch: StateSpaceBatch) -> None:
    """ValueError where a filter for linear models is given another one."""
    if chosen.nonlinear or batch.linear:
        return
    able = ", ".join(f.name for f in CATALOGUE.values() if f.nonlinear)
    raise ValueError(
        f"filter {chosen.name!r} needs a LinearModel, but the recording's model is nonlinear: "
        f"use one of {able}, or give the recording a LinearModel of what it measures."
    )


def estimate(chosen: Filter, batch: StateSpaceBatch, run: Run) -> Estimate:  # noqa: ARG001
    """What a filter made of a batch's only recording."""
    return Estimate.of(run, batch.time_of(0))
