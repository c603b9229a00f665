"""Every filter by name: what it is, what can be tuned, and the kernel that runs it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from navgym.filters import spaces
from navgym.parameters import ParameterSpace


@dataclass(frozen=True)
class Filter:
    """One entry of the catalogue.

    Args:
        name: as given to `navgym.estimate`.
        summary: one line for listings.
        space: what can be tuned.
        family: name of the module in `navgym.filters` that holds its kernels.
        option: what the family's kernels need to know beyond parameters (a fill, a mode set).
        needs_scales: whether it reads the true noise scales of a simulated recording.
        nonlinear: whether it takes any model, and not only a LinearModel.
    """

    name: str
    summary: str
    space: ParameterSpace
    family: str
    option: Any = 0
    needs_scales: bool = False
    nonlinear: bool = False


_ALL = (
    Filter("kf", "Kalman filter, predicts only where a measurement is lost", spaces.KALMAN, "kalman", 0),
    Filter("kf_zero", "Kalman filter that takes a lost measurement for a zero: the straw man", spaces.KALMAN, "kalman", 3),
    Filter("kf_hold", "Kalman filter that repeats the last received value", spaces.KALMAN, "kalman", 2),
    Filter("kf_extrapolate", "Kalman filter with quadratic fill at its true variance", spaces.KALMAN_FILL, "kalman", 1),
    Filter("oracle", "Kalman filter that knows the true Q and R of each sample", spaces.NONE, "kalman", 0, needs_scales=True),
    Filter("vbakf", "variational-Bayes filter, predicts only where a measurement is lost", spaces.VBAKF, "qivbf"),
    Filter("qivbf", "variational-Bayes filter with quadratic fill: QIVBF, corrected", spaces.QIVBF, "qivbf"),
    Filter("qivbf_printed", "QIVBF as printed, with the least additions that let it run: diverges", spaces.PRINTED, "qivbf_printed"),
    Filter("imm", "interacting multiple models: 6 Kalman filters over R and Q scales", spaces.IMM, "bank", "imm"),
    Filter("imm_wide", "interacting multiple models: 13 Kalman filters, R scales .1 to 300", spaces.IMM, "bank", "imm_wide"),
    Filter("bank", "24 modes, R scale by regime, outliers within the step: the best estimate here", spaces.BANK, "bank", "bank"),
    Filter("bank_bursts", "bank with a regime more, that loses samples in bursts: a loss is evidence", spaces.BANK, "bank", "bank_bursts"),
    Filter("ekf", "extended Kalman filter, with exact Jacobians", spaces.KALMAN, "nonlinear", 0, nonlinear=True),
    Filter("ukf", "unscented Kalman filter with spread a", spaces.SIGMA, "nonlinear", 1, nonlinear=True),
    Filter("ckf", "cubature Kalman filter: the unscented one at a = 1", spaces.KALMAN, "nonlinear", 1, nonlinear=True),
    Filter("cukf", "unscented and cubature stages in turn: CUKF, corrected", spaces.SIGMA, "nonlinear", 2, nonlinear=True),
)  # fmt: skip


@dataclass(frozen=True)
class Deck:
    """What sets the members of the deck's family of filters apart.

    Args:
        method: how the flexure is identified on line (see `navgym.identification`); None: never.
        truth: whether the true flexure and the true noises are known.
        printed: whether weights, Q, covariance and increments are the paper's own.
        shrunk: whether what is identified is shrunk toward what was believed.
    """

    method: str | None = None
    truth: bool = False
    printed: bool = False
    shrunk: bool = True


_DECK = (
    Filter("alignment", "24-state deck filter, the flexure as believed: an extended Kalman filter", spaces.ALIGNMENT, "deck", Deck()),
    Filter("alignment_mcc", "the same, robust by the correntropy criterion", spaces.ALIGNMENT_MCC, "deck", Deck()),
    Filter("idam", "flexure identified on line by an RVM, correntropy, model prediction on request: IDAM, corrected", spaces.IDAM, "deck", Deck("rvm")),
    Filter("idam_printed", "IDAM as printed: body-frame increments, weights judged by R", spaces.IDAM_PRINTED, "deck", Deck("rvm", printed=True)),
    Filter("svram", "flexure identified by support vector regression", spaces.IDENTIFIED, "deck", Deck("svr")),
    Filter("woam", "flexure identified by whale optimisation", spaces.IDENTIFIED, "deck", Deck("whale")),
    Filter("oracle", "knows the true flexure and the true noises of each step", spaces.ALIGNMENT, "deck", Deck(truth=True), needs_scales=True),
)  # fmt: skip

# by name, for recordings of two IMUs; both halves have an oracle
DECK_CATALOGUE: Mapping[str, Filter] = MappingProxyType({f.name: f for f in _DECK})

CATALOGUE: Mapping[str, Filter] = MappingProxyType({f.name: f for f in _ALL})
