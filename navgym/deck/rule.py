"""The deck's hand rule."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.envs.rules import HandRule, Signal


class ResidualSign(HandRule):
    """Read the sign of what follows a large gyro residual: the deck's hand rule.

    docs/science/idam.md#scenarios-and-headroom.

    If the next residual points the other way, a glitch got into the estimate: the kernel narrows to
    `NARROW` at once. If it points the same way, a slam was rejected: the kernel widens by half, once per
    decision. Without alarms the width drifts back to `QUIET`. Constants were chosen on training recordings.
    """

    NARROW, WIDE, QUIET = 3.5, 20.0, 15.0
    NEGATIVE, POSITIVE = -0.05, 0.12  # mean ratio of successive residuals that counts
    ALARMS = 0.01  # share of large residuals from which on anything is done
    BACK = 0.1  # share of the way back, per decision

    steered = ("kernel_width",)

    def begin(self, lanes: int, reference: Mapping[str, Any]) -> None:
        """Every recording starts with the width in force."""
        self._log_width = np.full(lanes, np.log(reference["kernel_width"]))

    def choose(self, signal: Signal) -> Mapping[str, Array]:
        """The width of each recording's kernel."""
        sign = signal("rate.persistence")
        loud = signal("rate.alarm") > self.ALARMS
        width = self._log_width
        quiet = width + self.BACK * (np.log(self.QUIET) - width)
        width = np.where(loud, width + np.where(sign > self.POSITIVE, np.log(1.5), 0.0), quiet)
        width = np.where(loud & (sign < self.NEGATIVE), np.log(self.NARROW), width)
        self._log_width = np.clip(width, np.log(self.NARROW), np.log(self.WIDE))
        return {"kernel_width": np.exp(self._log_width)}
