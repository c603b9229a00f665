"""The named catalogue of scenarios, and the split of seeds into train, validation and test."""

from navgym.scenarios.auv import CATALOGUE, SHIFTS, AUVScenario, Loss, Regime, Turns
from navgym.scenarios.seeds import SPLITS, seeds, split_of

__all__ = [
    "CATALOGUE", "SHIFTS", "SPLITS", "AUVScenario", "Loss", "Regime", "Turns", "seeds", "split_of",
]  # fmt: skip
