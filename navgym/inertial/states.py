"""The states of an error-state filter, declared once with names and units; indices and slices follow.

What comes out of here is frozen into kernels.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

_named: Any = namedtuple  # its names are known at run time only


@dataclass(frozen=True)
class State:
    """One block of states.

    Args:
        name: an identifier.
        symbol: the letter that the equations use.
        unit: "1" where there is none.
        meaning: in a few words.
        size: how many states.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    size: int = 3


class Layout:
    """Where each block of states stands in x.

    Args:
        states: the blocks, in order.
    """

    def __init__(self, *states: State) -> None:
        names = [s.name for s in states]
        if len(set(names)) < len(names):
            raise ValueError(f"names of states must be distinct, got {names}.")
        self.states = states
        ends = [0]
        for s in states:
            ends.append(ends[-1] + s.size)
        self.size: int = ends[-1]
        self.slices: tuple[slice, ...] = tuple(slice(a, b) for a, b in pairwise(ends))
        # first.NAME, the first state of a block: a named tuple, which kernels read as constants
        self.first = _named("first", names)(*ends[:-1])

    def indices(self, *names: str) -> tuple[int, ...]:
        """The states of some blocks, in the order of `names`."""
        sizes = {s.name: s.size for s in self.states}
        return tuple(getattr(self.first, n) + i for n in names for i in range(sizes[n]))
