"""Data that nobody can change by accident."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np


class Frozen:
    """Base of frozen dataclasses of arrays, which stay read-only in copies and after pickling, and print short."""

    def __init_subclass__(cls) -> None:
        """Keep `dataclass` from making a repr that prints every number."""
        if "__repr__" not in cls.__dict__:
            cls.__repr__ = Frozen.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        known = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}  # type: ignore[arg-type]
        told = [f"{n}={short}" for n, value in known.items() if (short := _short(value))]
        return f"{type(self).__name__}({', '.join(told)})"

    def _freeze(self, fields: Mapping[str, Any]) -> None:
        """Set `fields`, the arrays among them read-only."""
        for name, value in fields.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            object.__setattr__(self, name, value)

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Restore from a pickle or a copy, neither of which keeps arrays read-only."""
        self._freeze(state)


FEW, LONG = 4, 300  # numbers of an array, and letters of a field, that are printed


def _short(value: Any) -> str:
    """A field's value in a few letters; "" for what is left out."""
    if value is None or (isinstance(value, Mapping) and not value):
        return ""
    if isinstance(value, np.ndarray):
        if value.ndim < 2 and value.size <= FEW:
            return f"[{', '.join(f'{x:.6g}' for x in np.ravel(value))}]"
        return f"<{value.dtype} {value.shape}>"
    if isinstance(value, Mapping):
        return f"{{{', '.join(map(str, value))}}}"
    text = repr(value)
    return text if len(text) <= LONG else f"{text[: LONG - 3]}..."
