"""Every filter of the deck by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from navgym.deck import spaces
from navgym.problem import Filter


@dataclass(frozen=True)
class Deck:
    """What sets the members of the deck's family of filters apart.

    Args:
        method: how the flexure is identified on line (see `navgym.identification`); None: never.
        truth: whether the true flexure and the true noises are known.
        bank: whether several hypotheses run side by side.
        joint: whether one runs with the bank's model of the mean rate.
        printed: whether weights, Q, covariance and increments are the paper's own.
        shrunk: whether what is identified is shrunk toward what was believed.
        own: whether innovations are those of the sub IMU's own channels, once l is known.
    """

    method: str | None = None
    truth: bool = False
    bank: bool = False
    joint: bool = False
    printed: bool = False
    shrunk: bool = True
    own: bool = False


_ALL = (
    Filter("alignment", "24-state deck filter, the flexure as believed: an extended Kalman filter", spaces.ALIGNMENT, "deck", Deck()),
    Filter("alignment_mcc", "the same, robust by the correntropy criterion", spaces.ALIGNMENT_MCC, "deck", Deck()),
    Filter("alignment_own", "alignment_mcc by the sub IMU's own channels, for IMUs turned by many degrees", spaces.ALIGNMENT_MCC, "deck", Deck(own=True)),
    Filter("deck_bank", "calm, rougher sea, slam and glitch by four filters and their probabilities: no width to choose", spaces.DECK_BANK, "deck", Deck(bank=True), smooths=True),
    Filter("deck_bank_lever", "deck_bank with the lever arm's error among the states, so that velocities may be trusted", spaces.DECK_BANK_LEVER, "deck", Deck(bank=True), smooths=True),
    Filter("idam", "flexure identified on line by an RVM, correntropy, model prediction on request: IDAM, corrected", spaces.IDAM, "deck", Deck("rvm")),
    Filter("idam_printed", "IDAM as printed: body-frame increments, weights judged by R", spaces.IDAM_PRINTED, "deck", Deck("rvm", printed=True)),
    Filter("svram", "flexure identified by support vector regression", spaces.IDENTIFIED, "deck", Deck("svr")),
    Filter("woam", "flexure identified by whale optimisation", spaces.IDENTIFIED, "deck", Deck("whale")),
    Filter("oracle", "knows the true flexure and the true noises of each step", spaces.ALIGNMENT, "deck", Deck(truth=True), needs_scales=True, smooths=True),
)  # fmt: skip

CATALOGUE: Mapping[str, Filter] = MappingProxyType({f.name: f for f in _ALL})
