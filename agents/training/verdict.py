"""The guard: an agent is kept only if it foretells fixes better than the parameters that it starts from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.problem import Run
from navgym.tuning.cases import Cases


@dataclass(frozen=True)
class Verdict:
    """What a guard found.

    Args:
        better: whether the agent is kept.
        gain: 1 − its one-step error of the fixes / that of the tuned parameters, the mean over logs.
        worst: the smallest of these.
        truth: the same of the error against the truth; None where that is not known.
        said: in words.
    """

    better: bool
    gain: float
    worst: float
    truth: float | None
    said: str

    def __str__(self) -> str:
        return self.said

    def as_dict(self) -> dict[str, Any]:
        """As JSON holds it."""
        return {n: v for n, v in asdict(self).items() if v is not None}


def compared(cases: Cases, run: Run, base: Run) -> dict[str, float]:
    """Gains of one run over another on the same recordings: of the fixes, and, if known, in truth."""
    found = {"fixes": _gain(cases.foretold_errors(run), cases.foretold_errors(base))}
    if cases.has_truth:
        found["truth"] = _gain(cases.true_errors(run), cases.true_errors(base))
    return found


def _gain(errors: Array, base: Array) -> float:
    """1 − error / error of the reference; −1 for a run that fails where the reference does not."""
    if not np.isfinite(base).all():
        return 0.0 if not np.isfinite(errors).all() else 1.0
    return float(1.0 - errors.mean() / base.mean()) if np.isfinite(errors).all() else -1.0


def judged(agent: str, how: str, gains: Sequence[Mapping[str, float]]) -> Verdict:
    """The verdict on gains by log and rate of losses."""
    fixes = np.array([g["fixes"] for g in gains])
    seen = [g["truth"] for g in gains if "truth" in g]
    gain, worst = float(fixes.mean()), float(fixes.min())
    told = f"it foretells the fixes {100 * gain:+.2f} % better than the tuned parameters {how}"
    if seen:
        told += f" (against the truth {100 * np.mean(seen):+.1f} %)"
    better = gain > 0.0
    said = f"guard: the {agent} is kept, {told}."
    if not better:
        said = f"guard: the {agent} is NOT kept, {told}: what is written is the tuned parameters."
    return Verdict(better, gain, worst, float(np.mean(seen)) if seen else None, said)
