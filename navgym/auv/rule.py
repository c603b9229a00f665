"""The AUV's hand rule."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from navgym.core.checks import Array
from navgym.envs.rules import HandRule, Signal


class CovarianceMatching(HandRule):
    """Match Q to the innovations (Mehra 1972): the AUV's hand rule.

    A nominal Kalman filter beside the controlled one has innovations of covariance C = H P⁻ Hᵀ + R.
    The third difference of the measurements shows R alone. Where C exceeds R, the motion is not the
    model's, so Q grows with their ratio: q = 10 max(1, Ĉ/R̂), both as means over some five samples.
    R is left to the variational filter. The factor 10 was chosen on training recordings: with the
    model's own Q the variational filter blames R for a manoeuvre and shuts its gain.
    """

    FLOOR = 10.0

    steered = ("process_noise_scale",)

    def choose(self, signal: Signal) -> Mapping[str, Array]:
        """q from the innovations' power over the noise's."""
        innovations = signal("frozen.power_position.0.8")
        noise = signal("curvature.0.8")
        ratio = np.exp(2.0 * (innovations - noise))  # both are half logarithms
        return {"process_noise_scale": self.FLOOR * np.maximum(ratio, 1.0)}
