"""Every INS filter by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from navgym.ins import spaces
from navgym.problem import Filter


@dataclass(frozen=True)
class Ins:
    """What sets the members of the family apart.

    Args:
        rule: what a measurement is worth: "trust", "student", "correntropy", "variational", "bank", "oracle".
    """

    rule: str


_ALL = (
    Filter("ins_kf", "INS error-state Kalman filter, closed loop; cukf and ekf would be the same here", spaces.KF, "ins", Ins("trust"), smooths=True),
    Filter("ins_student", "the same, each sensor's noise a Student-t", spaces.STUDENT, "ins", Ins("student"), smooths=True),
    Filter("ins_mcc", "the same, robust by the correntropy criterion", spaces.MCC, "ins", Ins("correntropy"), smooths=True),
    Filter("ins_vb", "the same, each sensor's R estimated: the QIVBF of the 18-state model", spaces.VB, "ins", Ins("variational"), smooths=True),
    Filter("ins_bank", "the same, 16 hypotheses on each sensor's R in measurement space", spaces.BANK, "ins", Ins("bank"), smooths=True),
    Filter("oracle", "told the true noise of every measurement and of the IMU", spaces.ORACLE, "ins", Ins("oracle"), needs_scales=True, smooths=True),
)  # fmt: skip

CATALOGUE: Mapping[str, Filter] = MappingProxyType({f.name: f for f in _ALL})
