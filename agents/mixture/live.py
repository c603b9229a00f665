"""A mixture on live data: sample by sample, what `Mixture.estimate` makes of the whole recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from types import MappingProxyType
from typing import Any

import numpy as np

from navgym.agents.mixture.experts import BANK, Expert, meanings
from navgym.agents.mixture.mixture import Mixture, blended, spread
from navgym.auv.intake import LinearIntake, Model
from navgym.auv.live_bank import LiveBank
from navgym.core.checks import Array
from navgym.core.compile import entry
from navgym.core.health import NUMERICAL
from navgym.envs.live import LiveEstimate
from navgym.statespace.filters import kalman, qivbf
from navgym.statespace.filters import mixture as kernels
from navgym.statespace.filters.catalogue import CATALOGUE
from navgym.statespace.filters.lane import padded
from navgym.statespace.filters.modes import Structure
from navgym.statespace.models import LinearModel
from navgym.statespace.noise import scaled

REASONS = {
    kernels.UNSEEN: "something was seen that lies outside what training saw",
    kernels.BEHIND_REFERENCE: "the tuned filter has foretold the fixes better",
}


@dataclass(frozen=True, slots=True)
class LiveMixtureEstimate(LiveEstimate):
    """The same of a mixture.

    Args:
        weights: (K,) of the experts, the tuned filter first.
    """

    weights: Array


class LiveMixture(LinearIntake):
    """A mixture's experts side by side on one stream of samples.

    While no expert loses the track, it answers as `Mixture.estimate` does, up to rounding. One that does
    begins anew at the answer, and has no weight until it foretells as well as the others again; the bank
    begins anew by itself, see `navgym.LiveBank`.

    Args:
        mixture: see `Mixture`.
        model: what the filters believe: a `navgym.LinearModel` or, where samples come at uneven times, a
            function from a step in s to one, such as `navgym.LinearModel.white_acceleration`.
        interval: s between samples, for such a function: the step to the first one; 1 by default.
        fallback: whether the tuned filter answers while there is a reason.

    Raises:
        TypeError: a model of another kind.
        ValueError: an interval that is not positive.
    """

    def __init__(
        self,
        mixture: Mixture,
        model: Model,
        *,
        interval: float | None = None,
        fallback: bool = True,
    ) -> None:
        super().__init__(model, interval)
        self.mixture, self._fallback = mixture, fallback
        self.parameters: Mapping[str, Any] = MappingProxyType(dict(mixture.reference.parameters))
        own = self.model
        self._experts = [_live(e, model, interval) for e in mixture.experts]
        structure = Structure.among(own.pack(), own.position, own.velocity, own.sensors)
        self._meanings = meanings(structure)
        self._bank = next((i for i, e in enumerate(mixture.experts) if e.filter == BANK), None)
        seen = (own.H.reshape(-1, own.m, own.n) != 0.0).any(axis=0)
        fixes = seen[:, list(own.position)].any(axis=1)
        self._kind = np.asarray(~fixes if fixes.any() else fixes, dtype=np.int64)
        n, m, K, F = own.n, own.m, len(mixture.experts), len(kernels.FEATURES)
        self._sample = np.zeros(1, np.dtype([("y", "f8", m), ("lost", "?", m), ("time", "f8")]))
        self._model = np.zeros(1, self._packed.dtype)
        self._states, self._covariances = np.zeros((1, 1, K, n)), np.zeros((K, 1, 1, n, n))
        self._innovations, self._nis = np.zeros((1, 1, K, m)), np.zeros((1, 1, K))
        self._told = np.zeros((1, 1, kernels.TOLD))
        self._out = (np.zeros((1, 1, K)), np.zeros((1, 1, F)), np.zeros((1, 1, K)), np.zeros((1, 1), np.int64))  # fmt: skip
        self.reset()

    def reset(self) -> None:
        """Go back to x0, P0, one step before the first sample."""
        self.restarts = 0
        self._begin_samples()
        for each in self._experts:
            each.reset()
        self._kept = kernels.memory(1, len(self._experts), len(self._y))
        self._weigh = entry(kernels.weigh, self._arguments())

    def restart_clock(self) -> None:
        """The clock was set: the next sample comes a usual step after the last, whatever its time."""
        self.time = None
        for each in self._experts:
            each.time = None

    def step(
        self, measurement: Any, lost: Any = None, time: float | Decimal | None = None
    ) -> LiveMixtureEstimate:
        """Take in a sample.

        Args:
            measurement: (m,), a number per row of the model's H; NaN counts as lost.
            lost: one flag, or one per component, True where nothing was received.
            time: s, increasing; by default a usual step after the last.

        Raises:
            ValueError: a wrong shape, infinity, or a time that does not increase or is not one that the
                model is made for. Nothing has changed then.
        """
        self.put(measurement, lost, time)
        self._waiting = False
        self.k += 1
        failed = [each.take(measurement, lost, time) for each in self._experts]
        for j, each in enumerate(self._experts):
            self._states[0, 0, j], self._covariances[j, 0, 0] = each.state, each.covariance
            self._innovations[0, 0, j], self._nis[0, 0, j] = each.innovation, each.nis
        if self._bank is not None:
            weights = np.nan_to_num(self._experts[self._bank].weights)
            self._told[0, 0] = weights @ self._meanings
        self._weigh(*self._arguments())
        return self._answer(any(failed))

    def follow(self, recording: Any) -> Iterator[LiveMixtureEstimate]:
        """The estimates over a recording, as a live stream of its samples would give them."""
        for sample, time, _ in self.samples(recording):
            yield self.step(sample, None, time)

    def _arguments(self) -> tuple[Any, ...]:
        root = np.sqrt(np.diagonal(self._model["R"], axis1=1, axis2=2))[None]
        finite = np.isfinite(self._states).all(axis=-1)
        return (
            self._innovations, np.ascontiguousarray(self._nis[..., 0]), self._lost[None, None],
            np.ascontiguousarray(root), self._kind, self._told, finite, *self.mixture.network,
            self._fallback, *self._kept, *self._out,
        )  # fmt: skip

    def _answer(self, failed: bool) -> LiveMixtureEstimate:
        before, _, weights, reasons = self._out
        state = blended(weights, self._states)
        covariance = spread(weights, state, self._states, list(self._covariances))[0, 0]
        nis = blended(before, self._nis[..., None])[0, 0, 0]
        for each in self._experts:
            if each.lost:
                each.begin_at(state[0, 0], covariance)
                self.restarts += 1
        assert self.time is not None
        return LiveMixtureEstimate(
            self.time, state[0, 0], covariance, float(nis), self.parameters,
            REASONS.get(int(reasons[0, 0])), failed, weights[0, 0].copy(),
        )  # fmt: skip


class LiveExpert(LinearIntake):
    """A Kalman or a variational filter sample by sample, with fixed parameters.

    Args:
        expert: which.
        model: see `LiveMixture`.
        interval: likewise.
    """

    weights: Array = np.zeros(0)

    def __init__(self, expert: Expert, model: Model, interval: float | None) -> None:
        super().__init__(_scaled(model, expert), interval)
        chosen = CATALOGUE[expert.filter]
        self._family = {"kalman": kalman, "qivbf": qivbf}[chosen.family]
        table = chosen.space.array(expert.own)[None]
        usual = (1.0, 1.0, 1.0) if chosen.family == "kalman" else (*table[0, 0, :6], 0.0, 1.0)
        self._table = padded(table, usual)
        n, m = self.model.n, self.model.m
        self._lanes = np.zeros(1, self._family.lane_type(n, m))
        self._model = np.zeros(1, self._packed.dtype)
        self._sample = np.zeros(1, np.dtype([("y", "f8", m), ("lost", "?", m), ("time", "f8")]))
        self._found = (
            np.zeros((1, 1, n)), np.zeros((1, 1, n, n)), np.zeros((1, 1, m)), np.zeros((1, 1)),
            np.zeros((1, 1)),
        )  # fmt: skip
        option = chosen.option if chosen.family == "kalman" else 0
        self._told = (
            self._lanes, self._model[None], np.zeros((1, 1, m)), np.zeros((1, 1, m), bool),
            np.zeros((1, 1)), np.ones((1, 1, 2)), self._table, 1, option, *self._found,
        )  # fmt: skip
        self._run = entry(self._family.run, self._told)
        self.reset()

    def reset(self) -> None:
        """Go back to x0, P0."""
        self._begin_samples()
        self._family.begin(self._lanes, self._model[None], self._table)

    @property
    def lost(self) -> bool:
        """Whether the filter has failed, or has for a while foretold worse than who repeats the last fix."""
        return bool(self._lanes["diverged"][0])

    def take(self, measurement: Any, lost: Any, time: Any) -> bool:
        """Filter a sample; returns whether the numbers failed."""
        self.put(measurement, lost, time)
        self._waiting = False
        self.k += 1
        _, _, y, missing, now, *_ = self._told
        y[0, 0], missing[0, 0], now[0, 0] = self._y, self._lost, self._sample["time"][0]
        self._lanes["k"], self._lanes["length"] = 0, 1
        self._run(*self._told)
        return bool(self._lanes["diverged"][0] == NUMERICAL)

    def begin_at(self, state: Array, covariance: Array) -> None:
        """Go on from another filter's state, as new."""
        if np.isfinite(state).all():
            self._family.begin(self._lanes, self._model[None], self._table)
            self._lanes["x"], self._lanes["P"] = state, covariance

    @property
    def state(self) -> Array:
        """(n,)."""
        found: Array = self._found[0][0, 0]
        return found

    @property
    def covariance(self) -> Array:
        """(n, n)."""
        found: Array = self._found[1][0, 0]
        return found

    @property
    def innovation(self) -> Array:
        """(m,)."""
        found: Array = self._found[2][0, 0]
        return found

    @property
    def nis(self) -> float:
        """Normalised innovation squared."""
        return float(self._found[3][0, 0])


class LiveBankExpert:
    """The bank as an expert: `navgym.LiveBank`, asked alike."""

    def __init__(self, expert: Expert, model: Model, interval: float | None) -> None:
        self._bank = LiveBank(_scaled(model, expert), expert.own, expert.filter, interval=interval)
        self.reset()

    def reset(self) -> None:
        """Go back to x0, P0."""
        self._bank.reset()
        n, m = self._bank.model.n, self._bank.model.m
        self.state, self.covariance = np.zeros(n), np.zeros((n, n))
        self.innovation, self.nis = np.zeros(m), np.nan
        self.weights, self.lost = np.zeros(self._bank.modes.count), False

    @property
    def time(self) -> Any:
        """Of the last sample."""
        return self._bank.time

    @time.setter
    def time(self, value: Any) -> None:
        self._bank.time = value

    def take(self, measurement: Any, lost: Any, time: Any) -> bool:
        """Filter a sample; returns whether the bank began anew."""
        found = self._bank.step(measurement, lost, time)
        self.state, self.covariance, self.nis = found.state, found.covariance, found.nis
        self.weights, self.innovation = found.weights, self._bank.innovation
        return found.diverged

    def begin_at(self, state: Array, covariance: Array) -> None:
        """The bank begins anew by itself."""


def _live(expert: Expert, model: Model, interval: float | None) -> Any:
    """An expert that takes samples one by one."""
    kind = LiveBankExpert if CATALOGUE[expert.filter].family == "bank" else LiveExpert
    return kind(expert, model, interval)


def _scaled(model: Model, expert: Expert) -> Model:
    """The model, or the function that makes one, with the expert's scales of its noise."""
    scales = expert.scales
    if not scales:
        return model
    if isinstance(model, LinearModel):
        return scaled(model, scales)
    made: Callable[[float], LinearModel] = model
    return lambda step: scaled(made(step), scales)
