"""Conditions drawn anew for each training recording, so that a policy meets more than one sea."""

from __future__ import annotations

from typing import Any

import numpy as np

from navgym.problem import problem_of

STREAM = 0xC0  # first word of the seed sequences: no simulator's


def drawn(scenario: Any, ranges: Any, seed: int) -> Any:
    """`scenario` under conditions that depend on `seed` alone.

    Args:
        scenario: of any problem.
        ranges: of that problem, a dataclass `Training.ranges`.
        seed: of the draws.

    Raises TypeError for ranges of another problem.
    """
    training = problem_of(scenario).training
    if not isinstance(ranges, training.ranges):
        raise TypeError(
            f"{type(ranges).__name__} are no conditions of {scenario.name}: of another kind."
        )
    rng = np.random.default_rng(np.random.SeedSequence([STREAM, seed]))
    return training.draw(scenario, ranges, rng)
