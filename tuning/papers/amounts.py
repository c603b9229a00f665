"""How much of a reproduction is run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from navgym.tuning.cases import Cases


@dataclass(frozen=True)
class ReproductionAmount:
    """How much of QIVBF is run.

    Args:
        runs: fresh recordings per comparison.
        train: recordings per trial.
        trials: per study.
        draws: noise and loss seeds per real track.
        steps: samples per recording; None for each scenario's own.
    """

    runs: int
    train: int
    trials: int
    draws: int
    steps: int | None = None

    def cases(self, scenario: str, **overrides: Any) -> Cases:
        """Test recordings of a scenario in this size."""
        return Cases.simulated(f"auv/{scenario}", "test", self.runs, steps=self.steps, **overrides)


@dataclass(frozen=True)
class DeckReproductionAmount:
    """How much of IDAM is run.

    Args:
        runs: paired test recordings per comparison.
        train: training recordings for a choice.
        identifications: records per method.
        duration: s per recording; None for each scenario's own.
    """

    runs: int
    train: int
    identifications: int
    duration: float | None = None

    def cases(self, scenario: str, split: str = "test", **overrides: Any) -> Cases:
        """Recordings of a scenario in this size."""
        if self.duration is not None:
            overrides["duration"] = self.duration
        count = self.runs if split == "test" else self.train
        return Cases.simulated(f"deck/{scenario}", split, count, **overrides)


# outages of shortened missions; those of 20 minutes have theirs from the catalogue
SHORT_OUTAGES = ((90.0, 40.0), (150.0, 30.0))


@dataclass(frozen=True)
class InsReproductionAmount:
    """How much of INS/DVL is run.

    Args:
        runs: paired test missions per comparison.
        train: training seeds per real track, for a choice.
        draws: test seeds of noise and losses per real track.
        duration: s per mission; None for each scenario's own.
    """

    runs: int
    train: int
    draws: int
    duration: float | None = None

    def cases(self, scenario: str, **overrides: Any) -> Cases:
        """Test missions of a scenario in this size."""
        if self.duration is not None:
            overrides["duration"] = self.duration
            if scenario == "outage":
                overrides["outages"] = SHORT_OUTAGES
        return Cases.simulated(f"ins/{scenario}", "test", self.runs, **overrides)

    @property
    def told(self) -> int | None:
        """What a part says that it rests on: a shortened run is no evaluation, whatever their number."""
        return None if self.duration is None else self.runs
