"""What this machine has."""

from __future__ import annotations

import os


def cores() -> int:
    """Cores that this process may use."""
    own = getattr(os, "sched_getaffinity", None)  # where the system can tell
    return len(own(0)) if own else os.cpu_count() or 1
