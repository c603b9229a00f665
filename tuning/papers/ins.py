"""INS/DVL, the system of QIVBF eq. 3-4: tables on fresh missions and on real tracks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from navgym.tuning.papers import ins_tables as tables
from navgym.tuning.papers import ins_tracks as tracks
from navgym.tuning.papers.amounts import InsReproductionAmount
from navgym.tuning.papers.part import Part

__all__ = ["FULL", "QUICK", "InsReproductionAmount", "ins"]

FULL = InsReproductionAmount(runs=24, train=2, draws=5)
QUICK = InsReproductionAmount(runs=3, train=1, draws=1, duration=200.0)


def ins(size: InsReproductionAmount, folder: Path | None) -> Iterator[Part]:
    """Every part in turn.

    Args:
        size: how much to run.
        folder: of the A-KIT tracks with their inertial data; None leaves them out.
    """
    yield tables.matched(size)
    part, noisy = tables.noise(size)
    yield part
    part, silent = tables.silence(size)
    yield part
    yield tables.claim(size, noisy, silent)
    if folder is not None:
        yield tracks.reckoning(folder)
        yield tracks.outages(size, folder)
        yield tracks.fixes(size, folder)
