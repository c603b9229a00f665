"""A filter that tunes itself on live data: samples in, estimates out, parameters by a policy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from decimal import Decimal
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from navgym.agents.live.fallback import FallbackRule, Guard
from navgym.agents.policies.manifest import ANOTHER
from navgym.core.checks import Array
from navgym.envs.live import CONTROLLED, REFERENCE, LiveEstimate, LiveLane
from navgym.problem import Problem, problems

DIVERGED = "the filter lost the track and was started again"


class Steering(Protocol):
    """What a policy must offer; `agents.Policy` does."""

    manifest: Any
    low: Array
    high: Array

    def parameters(self, observation: NDArray[np.float32]) -> Array:
        """The filter's physical parameters (P,) for an observation (n,)."""

    def check(self, environment: str, observation_names: tuple[str, ...], space: str) -> None:
        """Raise ValueError unless the policy was made for just this."""


class SelfTuningFilter:
    """A filter on live data whose parameters a policy sets, with best fixed ones to fall back to.

    Sample by sample it is exactly what the policy's environment runs, from the same kernels. A
    second filter runs beside with the best fixed parameters (`policy.manifest.reference`); while
    there is a reason not to trust the policy (see `FallbackRule`) the answers are that filter's.
    The policy's own filter goes on meanwhile, and when the reason has passed, it answers again.
    Where a filter diverges or loses the track, it goes on from the other one; where both do, it
    starts again as its live lane says: from the state before the samples that agree on another track,
    widened as far as they contradict it (`navgym.auv.live`), or anew with a warm-up.

    Args:
        filter_name: of an environment: "qivbf" or "idam".
        policy: an `agents.Policy` (or what looks like one) of that filter's environment.
        model: what the filter believes: for qivbf a `navgym.LinearModel` or, where samples come at
            uneven times, a function from a step in s to one, such as
            `navgym.LinearModel.white_acceleration`; for idam a `navgym.DeckModel`.
        interval: s between samples (of IMUs, for idam), where it is not the live lane's usual one;
            for a function as model the step to the first sample.
        rates: for idam, whether samples hold rates (rad/s) and specific forces (m/s²) instead of
            increments.
        rule: when to fall back; None: never, but where the filter diverges.

    Raises:
        ValueError: an unknown filter, a policy of another filter, environment or parameter space.
        TypeError: a model of another kind.
    """

    def __init__(
        self,
        filter_name: str,
        policy: Steering,
        model: Any,
        *,
        interval: float | None = None,
        rates: bool = False,
        rule: FallbackRule | None = FallbackRule(),  # noqa: B008
    ) -> None:
        manifest = policy.manifest
        own = _problem(filter_name, manifest.environment).environment
        if manifest.filter != filter_name:
            raise ValueError(
                f"the policy sets the parameters of {manifest.filter}, not of {filter_name}: use "
                f"SelfTuningFilter({manifest.filter!r}, ...), or a policy of {filter_name}."
            )
        known, reference = manifest.settings, dict(manifest.reference)
        if known.get("context", "hidden") != "hidden":
            raise ValueError(
                "the policy reads the true regime, which nobody knows at sea: it is for analysis only. "
                'Train one with context="hidden".'
            )
        # what decides what the policy sees and sets; the reference is given whole
        seen = [name for name in own.settings.SEEN if name in known and name != "reference"]
        chosen = own.settings(**{name: known[name] for name in seen})
        self._lane: LiveLane = own.live(chosen, reference, model, interval, rates)
        self._space = self._lane.settings.SPACE
        policy.check(own.id, self._lane.names, self._space.fingerprint)
        self.policy = policy
        self._interval = self._lane.settings.decision_interval
        most = self._lane.components * self._interval
        self._guard = Guard(
            rule,
            self._lane.names,
            policy.low,
            policy.high,
            most,
            self._lane.compares,
            trusted=ANOTHER not in manifest.training or not self._lane.fixes,
        )
        self._fixed = self._named(self._lane.reference)
        self.reset()

    def reset(self) -> None:
        """Begin anew, one step before the first sample; counts are zero again."""
        self._lane.reset()
        self._guard.reset()
        self._begin()
        self.decisions = self.restarts = self.fallback_decisions = 0

    def _begin(self) -> None:
        """Warm up before the first decision."""
        self._k = -self._lane.warmup
        self._chosen = self._fixed

    @property
    def fallbacks(self) -> int:
        """How often the policy has been taken out of force."""
        return self._guard.falls

    @property
    def fallback(self) -> str | None:
        """Why the policy is not in force, or None."""
        return self._guard.reason

    @property
    def time(self) -> float | Decimal | None:
        """Time of the last sample, s; None before the first."""
        return self._lane.time

    def restart_clock(self) -> None:
        """The clock was set: the next sample comes a usual step after the last, whatever its time.

        What is known of the state stays. Where a clock jumps because nothing was measured for long,
        `reset` is better: it begins anew at the model's x0, P0.
        """
        self._lane.time = None

    def step(
        self, measurement: Any, lost: Any = None, time: float | Decimal | None = None
    ) -> LiveEstimate | None:
        """Take in a sample; returns the estimate after it.

        Args:
            measurement: for qivbf (m,), as the model's H says; for idam (4, 3), the increments of
                `navgym.DualIMURecording`: main angle (rad), main velocity (m/s), sub angle, sub
                velocity, all of one interval. NaN counts as lost.
            lost: one flag, or one per component (for idam per row or element), True where nothing
                was received.
            time: s, increasing; by default the step that the model is made for. Steps between
                large times, such as seconds since 1970, are exact where they are given as
                `decimal.Decimal`.

        Returns:
            The estimate; for idam None between filter steps, of `samples_per_step` samples each.

        Raises:
            ValueError: a wrong shape, infinity, time that does not increase, or a step that the
                model is not made for. Nothing has changed then: a single late sample is left out by
                going on with the next; where the clock was set, call `restart_clock` first.
        """
        self._lane.put(measurement, lost, time)
        return self._filter()

    def follow(self, recording: Any) -> Iterator[LiveEstimate]:
        """The estimates over a recording, as a live stream of its samples would give them."""
        for sample, time, more in self._lane.samples(recording):
            self._lane.put(sample, None, time, **more)
            found = self._filter()
            if found is not None:
                yield found

    def _filter(self) -> LiveEstimate | None:
        found = None
        while self._lane.ready():
            found = self._filter_step()
        return found

    def _filter_step(self) -> LiveEstimate:
        if self._k >= 0 and self._k % self._interval == 0:
            self._decide()
        self._k += 1
        failed = self._lane.step(self._k >= 0 and self._k % self._interval == 0)
        reason, parameters = self._guard.reason, self._chosen
        if failed:
            self._after(failed)
        which = CONTROLLED if reason is None else REFERENCE
        return self._lane.told(which, parameters, reason, bool(failed & (1 + which)))

    def _decide(self) -> None:
        """Judge the policy, and let it choose parameters for the decision that begins."""
        lane, guard = self._lane, self._guard
        observation = lane.observation[0]
        if self._k == 0:  # what the warm-up adds up judges no decision
            lane.tally[:] = 0.0
        guard.judge(observation, lane.tally)
        lane.tally[:] = 0.0
        row = self.policy.parameters(observation)
        lane.choose(row)
        self.decisions += 1
        self.fallback_decisions += guard.reason is not None
        self._chosen = self._named(row) if guard.reason is None else self._fixed

    def _after(self, failed: int) -> None:
        """A filter has failed and was started again."""
        self.restarts += 1
        if failed & 1:
            self._guard.trip(DIVERGED)
            self._chosen = self._fixed
        if failed == 3 and self._lane.begins_anew:
            self._begin()

    def _named(self, row: Array) -> Mapping[str, Any]:
        pairs = zip(self._space, row.tolist(), strict=True)
        return MappingProxyType({p.name: p.show(value) for p, value in pairs})


def _problem(filter_name: str, environment: str) -> Problem:
    """The problem whose environment learns to set that filter's parameters: the policy's, if it does.

    Raises ValueError where no environment sets them.
    """
    learning = {p.environment.id: p for p in problems()}
    able = [p for p in learning.values() if filter_name == p.environment.settings.FILTER]
    if not able:
        names = ", ".join(p.environment.settings.FILTER for p in learning.values())
        raise ValueError(
            f"filter {filter_name!r} has no environment to learn in, so no policy can set its "
            f"parameters: use one of {names}."
        )
    own = learning.get(environment)
    return own if own is not None and own in able else able[0]
