"""The arguments of `navgym/DeckDeformation-v0`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from navgym.core.checks import one_of, within
from navgym.deck import spaces
from navgym.deck.recording import DualIMURecording
from navgym.deck.scenarios import DeckScenario
from navgym.envs.settings import LaneSettings

FEATURES = ("all", "gyro")
START = 60.0  # s, when scoring begins: before, the filter is still finding its alignment


@dataclass(frozen=True)
class DeckDeformationSettings(LaneSettings):
    """What a deck environment is made of.

    Args:
        overrides: fields of the scenario to change, for example `{"lever_error": 0.1}`.
        pool: simulate this many recordings once and draw from them; None makes a new one at each
            reset, which takes longer than filtering it. 7.3 kB per second of recording.
        recordings: replay these (`navgym.DualIMURecording`) instead of simulating.
        decision_interval: filter steps per decision; 20 are one second.
        reward: "composite", "absolute" or "likelihood".
        features: "all", or "gyro" to leave the velocity channels out of the observation.
        warmup: s that the reference filter runs before the first decision.
        ac_weight: of the fast part of θ in the composite reward.
        theta_price: of a θ worse than the reference's.
        own_channels: innovations of the sub IMU's own velocity and rate alone, once l is known: a
            wrong channel then stays in its own row however the IMUs are turned to one another.
    """

    scenario: str | DeckScenario | Sequence[str | DeckScenario] = "deck/switch-60"
    decision_interval: int = 20
    action_parameters: str | Sequence[str] = ("kernel_width", "velocity_noise")
    reward: str = "composite"
    features: str = "all"
    warmup: float = 60.0
    ac_weight: float = 0.5
    theta_price: float = 1.0
    own_channels: bool = False

    FILTER = "idam"
    SPACE = spaces.IDAM
    REWARDS = ("composite", "absolute", "likelihood")
    RECORDING = DualIMURecording
    SCENARIO = DeckScenario
    SEEN = (*LaneSettings.SEEN, "features", "warmup", "own_channels")

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("features", self.features, FEATURES)
        for name in ("warmup", "ac_weight", "theta_price"):
            within(name, getattr(self, name), 0.0)

    @property
    def identifies(self) -> bool:
        """Whether lanes identify the flexure anew on the way: where the agent sets how."""
        return "rvm_kernel_scale" in self.action_parameters
