"""QIVBF, figure by figure beside what it claims, and what a reader of it will ask next."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from navgym.tuning.papers import qivbf_figures as figures
from navgym.tuning.papers import qivbf_findings as findings
from navgym.tuning.papers.amounts import ReproductionAmount
from navgym.tuning.papers.part import Part, page, results
from navgym.tuning.papers.seas import seas

__all__ = ["FULL", "QUICK", "Part", "ReproductionAmount", "auv", "page", "results"]

FULL = ReproductionAmount(runs=300, train=40, trials=200, draws=10)
QUICK = ReproductionAmount(runs=20, train=10, trials=6, draws=2, steps=200)


def auv(size: ReproductionAmount, seed: int, out: Path, folder: Path | None) -> Iterator[Part]:
    """Every part of the reproduction in turn: the paper's figures, then what else was found.

    Args:
        size: how much to run.
        seed: of the studies' samplers.
        out: folder of the studies, which resume.
        folder: of the A-KIT tracks; None leaves them out.
    """
    yield from figures.figures(size)
    yield findings.losses(size)
    yield findings.headroom(size, seed, out)
    yield findings.bank(size)
    yield seas(size, folder)
    yield findings.turn(size)
    if folder is not None:
        yield findings.tracks(size, folder)
