"""Rules by hand: parameters from an environment's observations, nothing learnt."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from navgym.core.checks import Array

Signal = Callable[[str], Array]  # name of an element of the observation to its values (N,)


class HandRule:
    """Observation in, parameters out, for N recordings at once; what learning must beat."""

    steered: ClassVar[tuple[str, ...]]  # names of the parameters that it sets

    def begin(self, lanes: int, reference: Mapping[str, Any]) -> None:
        """Forget what was seen: `lanes` recordings start now, with parameters `reference`."""

    def choose(self, signal: Signal) -> Mapping[str, Array]:
        """Values (N,) of the steered parameters."""
        raise NotImplementedError
