"""Every filter of state-space models by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from navgym.problem import Filter
from navgym.statespace.filters import spaces

_ALL = (
    Filter("kf", "Kalman filter, predicts only where a measurement is lost", spaces.KALMAN, "kalman", 0, smooths=True),
    Filter("kf_zero", "Kalman filter that takes a lost measurement for a zero: the straw man", spaces.KALMAN, "kalman", 3),
    Filter("kf_hold", "Kalman filter that repeats the last received value", spaces.KALMAN, "kalman", 2),
    Filter("kf_extrapolate", "Kalman filter with quadratic fill at its true variance", spaces.KALMAN_FILL, "kalman", 1),
    Filter("oracle", "Kalman filter that knows the true Q and R of each sample", spaces.NONE, "kalman", 0, needs_scales=True, smooths=True),
    Filter("vbakf", "variational-Bayes filter, predicts only where a measurement is lost", spaces.VBAKF, "qivbf"),
    Filter("qivbf", "variational-Bayes filter with quadratic fill: QIVBF, corrected", spaces.QIVBF, "qivbf"),
    Filter("qivbf_printed", "QIVBF as printed, with the least additions that let it run: diverges", spaces.PRINTED, "qivbf_printed"),
    Filter("imm", "interacting multiple models: 6 Kalman filters over R and Q scales", spaces.IMM, "bank", "imm"),
    Filter("imm_wide", "interacting multiple models: 13 Kalman filters, R scales .1 to 300", spaces.IMM, "bank", "imm_wide"),
    Filter("bank", "68 modes of noise, motion and outliers, weighed by what they foretell: needs no tuning", spaces.BANK, "bank", "bank"),
    Filter("bank_2026", "the bank as it was first: 24 modes, one R scale for all sensors by regime", spaces.BANK, "bank", "bank_2026"),
    Filter("ekf", "extended Kalman filter, with exact Jacobians", spaces.KALMAN, "nonlinear", 0, nonlinear=True),
    Filter("ukf", "unscented Kalman filter with spread a", spaces.SIGMA, "nonlinear", 1, nonlinear=True),
    Filter("ckf", "cubature Kalman filter: the unscented one at a = 1", spaces.KALMAN, "nonlinear", 1, nonlinear=True),
    Filter("cukf", "unscented and cubature stages in turn: CUKF, corrected", spaces.SIGMA, "nonlinear", 2, nonlinear=True),
)  # fmt: skip


CATALOGUE: Mapping[str, Filter] = MappingProxyType({f.name: f for f in _ALL})
