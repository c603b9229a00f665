"""Any learned thing that estimates by itself, by its file: a policy or a mixture."""

from __future__ import annotations

import os
from typing import TypeAlias

from navgym.agents.mixture.mixture import KIND as MIXTURE
from navgym.agents.mixture.mixture import Mixture
from navgym.agents.policies import portable
from navgym.agents.policies.policy import Policy
from navgym.core.storage import parse_json, settings_text

Agent: TypeAlias = Policy | Mixture


def load_agent(path: str | os.PathLike[str]) -> Agent:
    """A policy or a mixture, whichever the file holds.

    Raises:
        FileNotFoundError: one of the two files is missing.
        ValueError: a truncated or foreign file, or one that does not fit this navgym.
    """
    return Mixture.load(path) if kind_of(path) == MIXTURE else Policy.load(path)


def kind_of(path: str | os.PathLike[str]) -> str:
    """What a file says that it holds, "" where it says nothing that can be read."""
    beside = portable.pair(path)[1]
    if not beside.is_file():
        return ""
    try:
        return str(dict(parse_json(settings_text(beside))).get("kind", ""))
    except (ValueError, TypeError):
        return ""
