"""The hand rule of the INS."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from navgym.core.checks import Array
from navgym.envs.rules import HandRule, Signal


class TurnGate(HandRule):
    """Hold the last velocity until the gyros have turned: the hand rule of the INS.

    docs/science/ins.md: a vehicle that goes straight keeps its body velocity, one that turns does not. The
    variance grows with the time since the loss, and nothing stands in once the vehicle has turned by `LIMIT`.
    """

    LIMIT = 15.0 / 90.0  # of the observation's unit, a quarter of a circle
    HELD, GROWTH, NOTHING = 0.1, 0.03, 10.0  # m²/s², m²/s³, m²/s²

    steered = ("fill_variance",)

    def choose(self, signal: Signal) -> Mapping[str, Array]:
        """What the last velocity is worth."""
        since = np.expm1(signal("since"))
        held = np.minimum(self.HELD + self.GROWTH * since, self.NOTHING)
        return {"fill_variance": np.where(signal("turned") > self.LIMIT, self.NOTHING, held)}
