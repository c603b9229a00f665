"""Agents that tune filters while they run: training, portable policies, deployment.

Names load on first use, so that a trained policy runs without torch: `Policy`, `SelfTuningFilter`,
`Combiner`, `Mixture`, `LiveMixture`, and `shipped`, the policies that come with navgym.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

_HOME = {
    "Combiner": "navgym.agents.combiner.combiner",
    "LiveMixture": "navgym.agents.mixture.live",
    "Mixture": "navgym.agents.mixture.mixture",
    "Policy": "navgym.agents.policies.policy",
    "SelfTuningFilter": "navgym.agents.live.streaming",
    "shipped": "navgym.agents.policies.policy",
}

__all__ = ["Combiner", "LiveMixture", "Mixture", "Policy", "SelfTuningFilter", "shipped"]

if TYPE_CHECKING:
    from navgym.agents.combiner.combiner import Combiner
    from navgym.agents.live.streaming import SelfTuningFilter
    from navgym.agents.mixture.live import LiveMixture
    from navgym.agents.mixture.mixture import Mixture
    from navgym.agents.policies.policy import Policy, shipped


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
