"""What can be tuned, and the arguments of `navgym/ToyWalk-v0`."""

from collections.abc import Sequence
from dataclasses import dataclass

from navgym.core.parameters import Parameter, ParameterSpace
from navgym.envs.settings import LaneSettings
from tests.toy.world import WalkRecording, WalkScenario

SPACE = ParameterSpace(
    (Parameter("process_noise_scale", "q", "1", 0.1, 1000.0, "log", 1.0, equation="multiplies Q"),)
)


@dataclass(frozen=True)
class ToyWalkSettings(LaneSettings):
    """What a toy environment is made of.

    Args:
        reward: "difference" or "likelihood".
    """

    scenario: str | WalkScenario | Sequence[str | WalkScenario] = "toy/switch"
    decision_interval: int = 5
    action_parameters: str | Sequence[str] = ("process_noise_scale",)
    reward: str = "difference"

    FILTER = "walk_kf"
    SPACE = SPACE
    REWARDS = ("difference", "likelihood")
    RECORDING = WalkRecording
    SCENARIO = WalkScenario
