"""A policy as it is deployed, sample by sample with its fallback, over whole recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from navgym.agents.live.streaming import SelfTuningFilter
from navgym.agents.policies.policy import Policy
from navgym.core.checks import Array


def stream(policy: Policy, recordings: Sequence[Any], steps: int) -> tuple[Array, Array]:
    """Run `SelfTuningFilter` over recordings as if their samples came in live.

    Args:
        policy: of any environment.
        recordings: of its kind.
        steps: filter steps of the longest.

    Returns:
        States (N, steps, n), NaN past a recording's end, and per recording the share of decisions
        (N,) at which the fallback was in force.
    """
    states: list[Array] = []
    shares = np.zeros(len(recordings))
    live: SelfTuningFilter | None = None
    believed: Any = None
    for i, recording in enumerate(recordings):
        if live is None or recording.model is not believed:
            believed = recording.model
            step = float(recording.time[1] - recording.time[0])
            live = SelfTuningFilter(policy.manifest.filter, policy, believed, interval=step)
        live.reset()
        found = np.stack([estimate.state for estimate in live.follow(recording)])
        whole = np.full((steps, found.shape[1]), np.nan)
        whole[: len(found)] = found
        states.append(whole)
        shares[i] = live.fallback_decisions / max(live.decisions, 1)
    return np.stack(states), shares
