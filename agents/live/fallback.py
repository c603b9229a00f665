"""When not to trust a policy: the rule by which a self-tuning filter falls back, and comes back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array, positive_int, within
from navgym.envs.columns import (
    FREEDOM,
    HEARD,
    MISS,
    NIS_SUM,
    REFERENCE_MISS,
    REFERENCE_SCORE,
    SCORE,
    TALLY,
)
from navgym.metrics.consistency import nis_band

TRAILS = "the best fixed parameters have missed the position fixes by less for a while"
UNPROVEN = "the policy has not yet foretold the position fixes better than the parameters it was put around"


@dataclass(frozen=True)
class FallbackRule:
    """Three reasons to leave a policy for the best fixed parameters, and what it takes to return.

    *Range*: an element of the observation lies further outside what validation saw than `margin`
    allows; where a live lane `compares`, only while the filter with the best fixed parameters, which
    runs beside on the same samples, has foretold the last `window` decisions better. *NIS*: the mean NIS over the last `window` decisions lies outside the chi-square band
    that holds `confidence` of such means, and over the same samples the filter with the best fixed
    parameters has foretold the measurements better by `advantage`. Without
    the second half a filter whose best parameters leave it inconsistent (outliers, a wrong
    model) would never be trusted. What is foretold is scored by a heavy-tailed density, since
    under a Gaussian one a policy that is right to leave outliers out looks worse for each of them.
    Which channels are judged is the live lane's to say: of the deck's, the rates, since velocity
    noise is set wider than it is on purpose. *Fixes*, where positions are measured: over some time the
    filter with the best fixed parameters has missed them by less. The cost of a miss e is ln(1 + e²/R)
    per component, of the same scale for both filters; of the difference an exponential mean of `memory`
    decisions is kept, as a sum. A policy that was put around parameters which it was not
    trained with is in force only after `proof`.

    Args:
        margin: share of each element's range in training, or of 1 where the range is narrower,
            by which an observation may lie outside.
        window: decisions over which NIS and scores are judged.
        confidence: of the NIS band.
        advantage: mean log-density per sample by which the best fixed parameters must be better.
        patience: successive decisions with a reason after which the filter falls back.
        recovery: successive decisions without one after which the policy is back.
        memory: decisions over which misses of fixes are compared.
        behind: sum of those by which the policy falls back.
        ahead: sum of those by which it is back.
        proof: the same for a policy around other parameters, the first time included.
    """

    margin: float = 0.2
    window: int = 6
    confidence: float = 0.99
    advantage: float = 0.4
    patience: int = 1
    recovery: int = 10
    memory: int = 50
    behind: float = 1.0
    ahead: float = 1.0
    proof: float = 3.0

    def __post_init__(self) -> None:
        within("margin", self.margin, 0.0)
        within("confidence", self.confidence, 0.0, 1.0)
        within("advantage", self.advantage, 0.0)
        within("behind", self.behind, 0.0)
        for name in ("ahead", "proof"):
            within(name, getattr(self, name), -self.behind)
        for name in ("window", "patience", "recovery", "memory"):
            positive_int(name, getattr(self, name))


class Guard:
    """Judges a policy at each decision.

    Args:
        rule: by what; None: by nothing, so that only `trip` takes it out of force.
        names: of the observation's elements.
        low: (n,) smallest observation in training.
        high: (n,) largest one.
        most: degrees of freedom that one decision can have at most.
        compares: whether an observation out of range is no reason while the policy's filter has
            foretold the measurements at least as well as the reference's.
        trusted: whether the policy is in force from the start.

    Attributes:
        reason: why the policy is not in force, or None.
        falls: how often it has been taken out of force.
        proven: whether it has been in force.
    """

    def __init__(
        self,
        rule: FallbackRule | None,
        names: Sequence[str],
        low: Array,
        high: Array,
        most: int,
        compares: bool = False,
        trusted: bool = True,
    ) -> None:
        self._judging, self._names = rule is not None, tuple(names)
        self._trusted = trusted or not self._judging
        self.rule = rule = rule or FallbackRule()
        self._trained, self._compares = (low, high), compares
        allowed = rule.margin * np.maximum(high - low, 1.0)
        self._low, self._high = low - allowed, high + allowed
        dof = np.arange(rule.window * most + 1)
        self._band = np.nan_to_num(np.stack(nis_band(dof, rule.confidence), axis=-1)).tolist()
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.reason: str | None = None if self._trusted else UNPROVEN
        self.falls = 0
        self._alarm: str | None = None
        self._trails, self._lead = not self._trusted, 0.0
        self.proven = self._trusted
        self._found = self._clear = 0
        self._past = np.zeros((self.rule.window, TALLY))
        self._count = 0

    def judge(self, observation: NDArray[np.float32], tally: Array) -> None:
        """Take in what was seen before a decision, and what was added up since the last one."""
        self._past[self._count % self.rule.window] = tally
        self._count += 1
        found = None
        if self._judging:
            found = self._out_of_range(observation) or self._inconsistent()
            self._compare(tally)
        self._found = self._found + 1 if found else 0
        self._clear = 0 if found else self._clear + 1
        if found and (self._alarm is not None or self._found >= self.rule.patience):
            self._alarm = found
        elif self._clear >= self.rule.recovery:
            self._alarm = None
        self._tell()

    def trip(self, reason: str) -> None:
        """Take the policy out of force at once."""
        self._clear = self._count = 0
        self._alarm = reason
        self._tell()

    def _compare(self, tally: Array) -> None:
        """Follow who misses the fixes by less."""
        rule = self.rule
        self._lead *= 1.0 - 1.0 / rule.memory
        gained = float(tally[REFERENCE_MISS] - tally[MISS])
        self._lead += gained if math.isfinite(gained) else 0.0  # a filter that failed has no miss
        enough = rule.ahead if self._trusted else rule.proof
        self._trails = self._lead <= enough if self._trails else self._lead < -rule.behind

    def _tell(self) -> None:
        trailing = TRAILS if self.proven else UNPROVEN
        reason = self._alarm or (trailing if self._trails else None)
        self.proven = self.proven or reason is None
        self.falls += self.reason is None and reason is not None
        self.reason = reason

    def _out_of_range(self, observation: NDArray[np.float32]) -> str | None:
        outside = (observation < self._low) | (observation > self._high)
        if not np.count_nonzero(outside) or (self._compares and self._keeps_up()):
            return None
        i = int(np.argmax(outside))
        low, high = (float(bound[i]) for bound in self._trained)
        return (
            f"observation {self._names[i]} is {observation[i]:.3g}, and validation saw "
            f"{low:.3g} to {high:.3g}"
        )

    def _keeps_up(self) -> bool:
        """Whether the policy has foretold a full window at least as well as the reference."""
        total = np.add.reduce(self._past)
        return self._count >= self.rule.window and bool(total[SCORE] >= total[REFERENCE_SCORE])

    def _inconsistent(self) -> str | None:
        if self._count < self.rule.window:
            return None
        total = np.add.reduce(self._past).tolist()
        dof = round(total[FREEDOM])
        nis, (low, high) = total[NIS_SUM], self._band[dof]
        behind = total[REFERENCE_SCORE] - total[SCORE]
        if low <= nis <= high or not behind > self.rule.advantage * total[HEARD]:
            return None
        return (
            f"NIS is {nis / dof:.3g} per component, outside {low / dof:.3g} to {high / dof:.3g}, "
            f"and the best fixed parameters have foretold the measurements better"
        )
