"""Data that nobody can change by accident."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


class Frozen:
    """Base of frozen dataclasses of arrays, which stay read-only in copies and after pickling."""

    def _freeze(self, fields: Mapping[str, Any]) -> None:
        """Set `fields`, the arrays among them read-only."""
        for name, value in fields.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            object.__setattr__(self, name, value)

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Restore from a pickle or a copy, neither of which keeps arrays read-only."""
        self._freeze(state)
