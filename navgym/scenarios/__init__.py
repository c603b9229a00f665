"""The named catalogue of scenarios, and the split of seeds into train, validation and test.

Called, it lists the catalogue.
"""

import sys

from navgym._callable import CallableModule
from navgym.inertial.imu import ImuErrors
from navgym.scenarios.auv import CATALOGUE, SHIFTS, AUVScenario, Loss, Regime, Turns
from navgym.scenarios.deck import DECK_CATALOGUE, DeckRegime, DeckScenario
from navgym.scenarios.seeds import SPLITS, seeds, split_of

__all__ = [
    "CATALOGUE", "DECK_CATALOGUE", "SHIFTS", "SPLITS", "AUVScenario", "DeckRegime", "DeckScenario",
    "ImuErrors", "Loss", "Regime", "Turns", "seeds", "split_of",
]  # fmt: skip


def listing() -> dict[str, str]:
    """Every scenario's name and one line on it: what `navgym.scenarios()` returns."""
    from navgym.simulation import scenarios

    return scenarios()


sys.modules[__name__].__class__ = CallableModule
