"""What touches every kernel of the INS once."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import navgym
from navgym.problem import PROBLEMS
from navgym.warm import brief, play, stream

SCENARIO = "ins/nominal"

Job = tuple[str, Callable[[], Any]]


def kernels() -> list[list[Job]]:
    """What there is to compile: groups of a name, and what compiles it."""
    return [
        [
            ("INS environment", partial(play, SCENARIO)),
            ("INS filters", navigate),
            ("live INS filter", partial(stream, SCENARIO)),
        ]
    ]


def navigate() -> None:
    """Run a filter on a few seconds."""
    navgym.estimate("ins_kf", brief(PROBLEMS["ins"], SCENARIO))
