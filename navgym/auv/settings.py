"""The arguments of `navgym/AUVDropout-v0`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from navgym.auv.scenarios import AUVScenario
from navgym.envs.settings import LaneSettings
from navgym.statespace.filters import spaces
from navgym.statespace.recording import Recording


@dataclass(frozen=True)
class AUVDropoutSettings(LaneSettings):
    """What an AUV environment is made of.

    Args:
        overrides: fields of the scenario to change, for example `{"loss": 0.3}`.
        pool: simulate this many recordings once and draw from them; None makes a new one at each
            reset. About 0.3 MB per 800 samples.
        recordings: replay these (`navgym.Recording`) instead of simulating.
        decision_interval: samples per step.
        reward: "difference", "relative", "over-oracle", "absolute" or "likelihood".
    """

    scenario: str | AUVScenario | Sequence[str | AUVScenario] = "auv/switch-D"
    decision_interval: int = 5
    action_parameters: str | Sequence[str] = (
        "vb_iterations", "prior_count", "forgetting", "process_noise_scale",
    )  # fmt: skip
    reward: str = "difference"

    FILTER = "qivbf"
    SPACE = spaces.QIVBF
    REWARDS = ("difference", "over-oracle", "absolute", "likelihood", "relative")
    RECORDING = Recording
    SCENARIO = AUVScenario
