"""A filter that tunes itself on live data: samples in, estimates out, parameters by a policy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from agents.fallback import FallbackRule, Guard
from agents.rollout import AUV, DECK, MATTER
from navgym._checks import Array
from navgym.deck_estimation import attitudes
from navgym.deck_model import DeckModel
from navgym.dual_imu import DualIMURecording
from navgym.envs.deck_engine import DeckSettings
from navgym.envs.deck_live import LiveDeck
from navgym.envs.engine import Settings
from navgym.envs.live import CONTROLLED, REFERENCE, LiveAUV
from navgym.envs.live import Model as AUVModel
from navgym.filters.alignment import RATE, THETA
from navgym.recording import Recording

ENVIRONMENTS: Mapping[str, str] = MappingProxyType({"qivbf": AUV, "idam": DECK})
DIVERGED = "the filter diverged and was started again"


class Steering(Protocol):
    """What a policy must offer; `agents.Policy` does."""

    manifest: Any
    low: Array
    high: Array

    def parameters(self, observation: NDArray[np.float32]) -> Array:
        """The filter's physical parameters (P,) for an observation (n,)."""

    def check(self, environment: str, observation_names: tuple[str, ...], space: str) -> None:
        """Raise ValueError unless the policy was made for just this."""


@dataclass(frozen=True, slots=True)
class LiveEstimate:
    """What the filter knows after a sample. The arrays belong to whoever gets it.

    Args:
        time: s.
        state: (n,) posterior mean.
        covariance: (n, n).
        nis: normalised innovation squared; NaN where nothing was received.
        parameters: in force for this sample, in physical units.
        fallback: why these are the best fixed ones instead of the policy's, or None.
        diverged: whether the filter failed at this sample and was started again.
    """

    time: float
    state: Array
    covariance: Array
    nis: float
    parameters: Mapping[str, Any]
    fallback: str | None
    diverged: bool


@dataclass(frozen=True, slots=True)
class LiveDeckEstimate(LiveEstimate):
    """The same of the deck filter, whose states are l, δV, φ, ε, ∇, V_r, θ, θ̇ (IDAM eq. 73).

    Args:
        tape: (1,) what the step's samples amounted to; see `navgym.filters.mechanization.TAPE`.
    """

    tape: NDArray[Any]

    @property
    def attitude(self) -> Array:
        """(4,) attitude of the sub in the main IMU's axes, quaternion, scalar last."""
        found: Array = attitudes(self.tape, self.state[None])[0][0]
        return found

    @property
    def static(self) -> Array:
        """(3,) rotation vector of the static deformation and mounting, rad."""
        found: Array = attitudes(self.tape, self.state[None])[1][0]
        return found

    @property
    def theta(self) -> Array:
        """(3,) dynamic deformation, rad."""
        return self.state[THETA]

    @property
    def theta_rate(self) -> Array:
        """(3,) rad/s."""
        return self.state[RATE]


class SelfTuningFilter:
    """A filter on live data whose parameters a policy sets, with best fixed ones to fall back to.

    Sample by sample it is exactly what the policy's environment runs, from the same kernels. A
    second filter runs beside with the best fixed parameters (`policy.manifest.reference`); while
    there is a reason not to trust the policy (see `FallbackRule`) the answers are that filter's.
    The policy's own filter goes on meanwhile, and when the reason has passed, it answers again.
    Where a filter diverges, it goes on from the other one; where both do, QIVBF goes on from the
    last sound state with a wider covariance, and the deck filter begins anew, warm-up included.

    Args:
        filter_name: "qivbf" or "idam".
        policy: an `agents.Policy` (or what looks like one) of that filter's environment.
        model: what the filter believes: for qivbf a `navgym.LinearModel` or, where samples come at
            uneven times, a function from a step in s to one, such as
            `navgym.LinearModel.white_acceleration`; for idam a `navgym.DeckModel`.
        interval: s; for idam between IMU samples, 0.01 by default; for a function as model the step
            to the first sample, 1 by default.
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
        model: AUVModel | DeckModel,
        *,
        interval: float | None = None,
        rates: bool = False,
        rule: FallbackRule | None = FallbackRule(),  # noqa: B008
    ) -> None:
        if filter_name not in ENVIRONMENTS:
            raise ValueError(
                f"filter {filter_name!r} has no environment to learn in, so no policy can set its "
                f"parameters: use one of {', '.join(ENVIRONMENTS)}."
            )
        manifest = policy.manifest
        if manifest.filter != filter_name:
            raise ValueError(
                f"the policy sets the parameters of {manifest.filter}, not of {filter_name}: use "
                f"SelfTuningFilter({manifest.filter!r}, ...), or a policy of {filter_name}."
            )
        known, reference = manifest.settings, dict(manifest.reference)
        self._lane: Any  # one of two kinds with the same methods
        if filter_name == "qivbf":
            chosen = Settings(**_of(Settings, known))
            usual = 1.0 if interval is None else interval
            self._lane = LiveAUV(chosen, reference, model, usual)  # type: ignore[arg-type]
            each = self._lane.model.m
        else:
            settings = DeckSettings(**_of(DeckSettings, known))
            usual = 0.01 if interval is None else interval
            self._lane = LiveDeck(settings, reference, model, usual, rates)  # type: ignore[arg-type]
            each = 3
        self._space = self._lane.settings.SPACE
        policy.check(ENVIRONMENTS[filter_name], self._lane.names, self._space.fingerprint)
        self.policy = policy
        self._interval = self._lane.settings.decision_interval
        most = each * self._interval
        self._guard = Guard(rule, self._lane.names, policy.low, policy.high, most)
        self._fixed = self._named(self._lane.reference)
        self._deck = filter_name == "idam"
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

    def step(
        self, measurement: Any, lost: Any = None, time: float | None = None
    ) -> LiveEstimate | None:
        """Take in a sample; returns the estimate after it.

        Args:
            measurement: for qivbf (m,), as the model's H says; for idam (4, 3), the increments of
                `navgym.DualIMURecording`: main angle (rad), main velocity (m/s), sub angle, sub
                velocity, all of one interval. NaN counts as lost.
            lost: one flag, or one per component (for idam per row or element), True where nothing
                was received.
            time: s, increasing; by default the step that the model is made for.

        Returns:
            The estimate; for idam None between filter steps, of `samples_per_step` samples each.

        Raises:
            ValueError: a wrong shape, infinity, time that does not increase, or a step that the
                model is not made for. Nothing has changed then.
        """
        self._lane.put(measurement, lost, time)
        return self._filter()

    def follow(self, recording: Recording | DualIMURecording) -> Iterator[LiveEstimate]:
        """The estimates over a recording, as a live stream of its samples would give them."""
        for sample, time, more in _samples(recording):
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
        state, covariance, nis = self._lane.answer(which)
        diverged = bool(failed & (1 + which))
        now = self._lane.time
        if not self._deck:
            return LiveEstimate(now, state, covariance, nis, parameters, reason, diverged)
        return LiveDeckEstimate(
            now, state, covariance, nis, parameters, reason, diverged, self._lane.tape
        )

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
        if failed == 3 and self._deck:
            self._begin()

    def _named(self, row: Array) -> Mapping[str, Any]:
        pairs = zip(self._space, row.tolist(), strict=True)
        return MappingProxyType({p.name: p.show(value) for p, value in pairs})


def _of(settings: Any, known: Mapping[str, Any]) -> dict[str, Any]:
    """What of a policy's settings decides what it sees and sets, as arguments of `settings`."""
    names = set(MATTER) & set(settings.__dataclass_fields__) - {"reference"}
    return {name: known[name] for name in names if name in known}


def _samples(
    recording: Recording | DualIMURecording,
) -> Iterator[tuple[Array, float, dict[str, Any]]]:
    """Samples of a recording, their times, and what else a simulator knows to have arrived."""
    if isinstance(recording, Recording):
        for y, time in zip(recording.measurements, recording.time.tolist(), strict=True):
            yield y, time, {}
        return
    names = ("main_angle", "main_velocity", "sub_angle", "sub_velocity")
    whole = np.stack([getattr(recording, name) for name in names], axis=1)
    per, errors = recording.model.samples_per_step, recording.disturbance
    for k in range(recording.steps * per):
        more = {} if errors is None else {"disturbance": errors[k // per]}
        yield whole[k], float(recording.time[k]), more
