"""IDAM, figure by figure beside what it claims, and what a reader of it will ask next."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from navgym.tuning.papers import idam_figures, idam_limits, idam_recordings, idam_seas, idam_ship
from navgym.tuning.papers.amounts import DeckReproductionAmount
from navgym.tuning.papers.part import Part

__all__ = ["FULL", "QUICK", "DeckReproductionAmount", "deck"]

FULL = DeckReproductionAmount(runs=60, train=24, identifications=40)
QUICK = DeckReproductionAmount(runs=3, train=2, identifications=2, duration=125.0)


def deck(
    size: DeckReproductionAmount, repoimu: Path | None, multi_imu: Path | None
) -> Iterator[Part]:
    """Every part of the reproduction in turn: the paper's figures, then what else was found.

    Args:
        size: how much to run.
        repoimu: folder of the RepoIMU recordings; None leaves the pendulum out.
        multi_imu: of the multi-IMU ones; None leaves the quadrotor out.
    """
    trials = idam_figures.Trials.of(size)
    yield from idam_figures.section_5(size, trials)
    yield from idam_ship.section_6(trials)
    yield idam_limits.identification(size)
    yield idam_limits.levers(size)
    yield idam_limits.limits(size)
    yield idam_seas.robustness(size)
    yield idam_seas.switching(size)
    yield idam_seas.sea_state(size)
    if repoimu is not None:
        yield idam_recordings.pendulum(repoimu)
    if multi_imu is not None:
        yield idam_recordings.quadrotor(multi_imu)
