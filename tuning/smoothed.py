"""Logs judged against what a smoother makes of them, as if that were the truth."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

import navgym
from navgym.problem import problem_of

SMOOTHER = "smoother"
CAVEAT = (
    "The truth is no truth: it is what {0} smoothed of the same log. Errors say how far a filter is from that "
    "smoother, which favours {0}, its parameters and its model, and no error that both share shows in them."
)


def judged_by_smoother(recording: Any, parameters: Any = None) -> Any:
    """The recording with what its problem's plain filter smooths of it for its truth; `meta` says so.

    Args:
        recording: without truth.
        parameters: of the plain filter, as `navgym.smooth` takes them; its defaults by default.

    Raises ValueError where the truth is known, the plain filter cannot be smoothed, or it fails on its way.
    """
    problem = problem_of(recording)
    batch = problem.stack([recording])
    if batch.truth is not None:
        raise ValueError(
            "truth must not be 'smoother' for a log whose truth is known: leave --truth out."
        )
    plain = problem.plain_filter(batch)
    try:
        found = navgym.smooth(plain, recording, parameters)
    except ValueError as error:
        raise ValueError(
            f"truth={SMOOTHER!r} is not for this log: {error} Leave --truth out."
        ) from error
    if found.diverged or not np.isfinite(found.states).all():
        raise ValueError(
            f"truth={SMOOTHER!r} is not for this log: {plain} fails on its way. Leave --truth out."
        )
    told = SMOOTHER if parameters is None else f"{SMOOTHER}, {parameters}"
    meta = {**recording.meta, "truth": f"{plain} smoothed ({told}), not measured"}
    return dataclasses.replace(recording, truth=found.states, meta=meta)


def caveat(recording: Any) -> str:
    """What is to be known of figures on a recording whose truth was smoothed."""
    return CAVEAT.format(recording.meta["truth"].partition(" ")[0])
