"""What touches every kernel of the deck once."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import navgym
from navgym.identification import RVM
from navgym.problem import PROBLEMS
from navgym.warm import brief, play, stream

SCENARIO = "deck/paper"

Job = tuple[str, Callable[[], Any]]


def kernels() -> list[list[Job]]:
    """What there is to compile: groups of a name, and what compiles it."""
    return [
        [
            ("deck environment", partial(play, SCENARIO)),
            ("live deck filter", partial(stream, SCENARIO)),
            ("alignment", align),
            ("identification", identify),
        ],
        [("deck bank", hypothesise)],
    ]


def align() -> None:
    """Run the filter on a few seconds."""
    navgym.estimate("alignment", brief(PROBLEMS["deck"], SCENARIO))


def hypothesise() -> None:
    """Run the bank on a few seconds, and sample by sample."""
    recording = brief(PROBLEMS["deck"], SCENARIO)
    navgym.estimate("deck_bank", recording)
    next(navgym.LiveDeckBank(recording.model, interval=recording.interval).follow(recording))


def identify() -> None:
    """Fit three points."""
    RVM().fit([0.0, 1.0, 2.0], [0.0, 1.0, 0.0])
