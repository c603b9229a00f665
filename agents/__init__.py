"""Agents that tune filters while they run: training, portable policies, deployment.

Names load on first use, so that a trained policy runs without torch: `Policy`, `SelfTuningFilter`,
`Combiner`, and `shipped`, the policies that come with navgym.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

_HOME = {
    "Combiner": "agents.combiner",
    "Policy": "agents.policy",
    "SelfTuningFilter": "agents.streaming",
    "shipped": "agents.policy",
}

__all__ = ["Combiner", "Policy", "SelfTuningFilter", "shipped"]

if TYPE_CHECKING:
    from agents.combiner import Combiner
    from agents.policy import Policy, shipped
    from agents.streaming import SelfTuningFilter


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'agents' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
