"""A bank on live data: one sample at a time, no parameters to choose."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from types import MappingProxyType
from typing import Any

import numpy as np

from navgym.auv.intake import LinearIntake, Model, doubtful
from navgym.core.checks import Array, one_of
from navgym.core.compile import entry
from navgym.core.health import NUMERICAL
from navgym.envs.live import LiveEstimate
from navgym.statespace.filters import bank
from navgym.statespace.filters.catalogue import CATALOGUE
from navgym.statespace.filters.lane import padded
from navgym.statespace.filters.modes import MODE_SETS, Structure, pack

BANKS = tuple(name for name, f in CATALOGUE.items() if f.family == "bank")


@dataclass(frozen=True, slots=True)
class LiveModesEstimate(LiveEstimate):
    """The same of a bank.

    Args:
        weights: (J,) probabilities of its modes, in the order of `LiveBank.modes`.
    """

    weights: Array


class LiveBank(LinearIntake):
    """`bank` sample by sample: exactly what `navgym.estimate` makes of the whole recording.

    Where it loses the track it begins anew at the prediction, as unsure as the sample contradicts it;
    a sample that breaks the numbers counts as lost.

    Args:
        model: what the filters believe: a `navgym.LinearModel` or, where samples come at uneven times,
            a function from a step in s to one, such as `navgym.LinearModel.white_acceleration`.
        parameters: of the bank, by name; its defaults where they are not given.
        filter_name: "bank", "bank_2026", "imm" or "imm_wide".
        interval: s between samples, for such a function: the step to the first one; 1 by default.

    Raises:
        TypeError: a model of another kind.
        ValueError: an unknown filter or parameter, or a value out of range.
    """

    def __init__(
        self,
        model: Model,
        parameters: Mapping[str, Any] | None = None,
        filter_name: str = "bank",
        *,
        interval: float | None = None,
    ) -> None:
        super().__init__(model, interval)
        chosen = CATALOGUE[one_of("filter_name", filter_name, BANKS)]
        row = chosen.space.array(dict(parameters or {}))
        self.parameters: Mapping[str, Any] = MappingProxyType(
            {p.name: p.show(v) for p, v in zip(chosen.space, row[0].tolist(), strict=True)}
        )
        n, m = self.model.n, self.model.m
        self._structure = Structure.among(
            self._packed, self.model.position, self.model.velocity, self.model.sensors
        )
        self.modes, self._design = pack(MODE_SETS[chosen.option], self._structure, n)
        self._lanes = np.zeros(1, bank.lane_type(n, m))
        self._kept = self._lanes.copy()
        self._model = np.zeros(1, self._packed.dtype)
        self._noise = np.zeros((1, 1, n, n))
        self._sample = np.zeros(1, np.dtype([("y", "f8", m), ("lost", "?", m), ("time", "f8")]))
        self._told = (
            np.zeros((1, 1, n)), np.zeros((1, 1, n, n)), np.zeros((1, 1, m)), np.zeros((1, 1)),
            np.zeros((1, 1)), np.zeros((1, 1, self.modes.count)),
        )  # fmt: skip
        arguments = (
            self._lanes, np.zeros(1, bank.work_type(n, m)), self._design, self._model[None],
            self._noise, np.zeros((1, 1, m)), np.zeros((1, 1, m), bool), np.zeros((1, 1)),
            padded(row[None], (1.0, 1.0, 0.97, 1.0, 0.0)), 1, *self._told,
        )  # fmt: skip
        self._arguments = arguments
        self._run = entry(bank.run, arguments)
        self.reset()

    def reset(self) -> None:
        """Go back to x0, P0, one step before the first sample."""
        self.restarts = 0
        self._axes = int(bank.axes_of(self._packed[None], self._structure)[0])
        self._begin_samples()
        self._begin()

    def restart_clock(self) -> None:
        """The clock was set: the next sample comes a usual step after the last, whatever its time."""
        self.time = None

    def step(
        self, measurement: Any, lost: Any = None, time: float | Decimal | None = None
    ) -> LiveModesEstimate:
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
        self._kept[...] = self._lanes
        failed = self._filter()
        if failed == NUMERICAL:  # the sample broke the numbers: it counts as lost
            self._lanes[...] = self._kept
            self._lost[...] = True
            self.restarts += 1
            if self._filter():
                self._begin_again()
        elif failed:
            self._begin_again()
        x, P, _, nis, _, weights = (each[0, 0].copy() for each in self._told)
        assert self.time is not None
        return LiveModesEstimate(
            self.time, x, P, float(nis), self.parameters, None, failed > 0, weights
        )

    @property
    def innovation(self) -> Array:
        """(m,) of the last sample, measurement minus its prediction; NaN where lost."""
        found: Array = self._told[2][0, 0].copy()
        return found

    def _filter(self) -> int:
        """Run the sample; returns the lane's flag."""
        _, _, _, _, _, y, missing, now, *_ = self._arguments
        y[0, 0], missing[0, 0], now[0, 0] = self._y, self._lost, self._sample["time"][0]
        self._lanes["k"], self._lanes["length"] = 0, 1
        self._run(*self._arguments)
        return int(self._lanes["diverged"][0])

    def follow(self, recording: Any) -> Iterator[LiveModesEstimate]:
        """The estimates over a recording, as a live stream of its samples would give them."""
        for sample, time, _ in self.samples(recording):
            yield self.step(sample, None, time)

    def _use(self, model: Any, packed: Any) -> None:
        """Bring model, its velocity sensors' noise and the form of the covariance up to date."""
        same = all(np.array_equal(packed[name], self._model[name][0]) for name in ("H", "R"))
        super()._use(model, packed)
        if not same:
            self._noise[...] = self._structure.noise(self._model[None])
        if self._axes == 2 and not bank.separable(self._model):
            self._axes = 1
            bank.part_axes(self._lanes, self._design)  # type: ignore[no-untyped-call]

    def _begin(self) -> None:
        axes = np.array([self._axes])
        bank.begin(self._lanes, self._model[None], self._noise, self._design, axes)

    def _begin_again(self) -> None:
        """Anew, where it was, or at x0 if it is nowhere; unsure by what the sample contradicted."""
        self.restarts += 1
        x, miss = self._told[0][0, 0].copy(), np.nan_to_num(self._told[2][0, 0])
        known = bool(np.isfinite(x).all())
        miss /= np.sqrt(np.diag(self._model["R"][0]))
        wide = doubtful(self._model[0], miss, miss)
        heard, row_time = self._lanes["heard"].copy(), self._lanes["row_time"].copy()
        self._axes = 1
        self._begin()
        n = self.model.n
        if known:
            self._lanes["after"]["mean"][0, :n] = x[:, None]
            self._lanes["x"] = self._lanes["origin"] = x
        self._lanes["after"]["cov"][0, :n, :n] = wide[:, :, None]
        self._lanes["P"] = self._lanes["origin_P"] = wide
        self._lanes["heard"], self._lanes["row_time"] = heard, row_time
