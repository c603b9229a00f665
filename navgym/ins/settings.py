"""The arguments of `navgym/INSDropout-v0`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from navgym.core.checks import within
from navgym.envs.settings import LaneSettings
from navgym.ins import spaces
from navgym.ins.recording import InertialRecording
from navgym.ins.scenarios import InsScenario

SETTLED = 60.0  # s, when scoring begins: before, heading and biases are still being found
WARMUP = SETTLED  # s, before the first decision


@dataclass(frozen=True)
class INSDropoutSettings(LaneSettings):
    """What an INS environment is made of.

    Args:
        overrides: fields of the scenario to change, for example `{"grade": "tactical"}`.
        pool: simulate this many recordings once and draw from them; None makes a new one at each
            reset. 6 kB per second of recording.
        recordings: replay these (`navgym.ins.recording.InertialRecording`) instead of simulating.
        decision_interval: filter steps per decision; 5 are one second.
        reward: "relative", "absolute", "likelihood" or "position".
        warmup: s that the reference filter runs before the first decision.
    """

    scenario: str | InsScenario | Sequence[str | InsScenario] = "ins/outage"
    decision_interval: int = 5
    action_parameters: str | Sequence[str] = ("fill_variance",)
    reward: str = "relative"
    warmup: float = WARMUP

    FILTER = "ins_kf"
    SPACE = spaces.KF
    REWARDS = ("relative", "absolute", "likelihood", "position")
    RECORDING = InertialRecording
    SCENARIO = InsScenario
    SEEN = (*LaneSettings.SEEN, "warmup")

    def __post_init__(self) -> None:
        super().__post_init__()
        within("warmup", self.warmup, 0.0)
