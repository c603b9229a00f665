"""The deck's bank on live data: one sample of both IMUs at a time, no parameters to choose."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from navgym.core.checks import Array, one_of
from navgym.core.compile import entry
from navgym.deck import alignment_model, bank, hypotheses, joint
from navgym.deck.catalogue import CATALOGUE
from navgym.deck.intake import Intake
from navgym.deck.live import LiveDeckEstimate
from navgym.deck.mechanization import mechanize_live
from navgym.deck.model import DeckModel

BANKS = tuple(name for name, f in CATALOGUE.items() if f.option.bank)


@dataclass(frozen=True, slots=True)
class LiveBankEstimate(LiveDeckEstimate):
    """The same of a bank.

    Args:
        mode_weights: (4,) probabilities of calm, rougher sea, slam, glitch.
        lagged: (2, 3) θ̇ one and two filter steps ago by what has been measured since, rad/s.
    """

    mode_weights: Array
    lagged: Array


class LiveDeckBank(Intake):
    """`deck_bank` sample by sample: exactly what `navgym.estimate` makes of a recording without gaps.

    Where it loses the track it begins anew with the next samples.

    Args:
        model: what the filters believe.
        parameters: of the bank, by name; its defaults where they are not given.
        filter_name: "deck_bank", or "deck_bank_lever" with the lever arm's error among the states.
        interval: s between IMU samples; 0.01 by default.
        rates: whether samples hold rates (rad/s) and specific forces (m/s²); else increments.

    Raises:
        TypeError: a model of another kind.
        ValueError: an unknown filter or parameter, or a value out of range.
    """

    def __init__(
        self,
        model: DeckModel,
        parameters: Mapping[str, Any] | None = None,
        filter_name: str = "deck_bank",
        *,
        interval: float | None = None,
        rates: bool = False,
    ) -> None:
        super().__init__(model, interval, rates)
        space = CATALOGUE[one_of("filter_name", filter_name, BANKS)].space
        row = space.array(dict(parameters or {}))
        self.parameters: Mapping[str, Any] = MappingProxyType(
            {p.name: p.show(v) for p, v in zip(space, row[0].tolist(), strict=True)}
        )
        self._row = hypotheses.table_of(space, row[None])
        self._kinds = hypotheses.KINDS
        self._models = np.zeros((1, 2), alignment_model.MODEL)
        self._lanes = np.zeros((1, len(self._kinds) + 1), joint.LANE)
        self._told = hypotheses.outputs_for(1, 1, len(self._kinds), everything=True)
        shown = "states", "covariances", "mode_weights", "theta_rate_lagged"
        self._views = tuple(self._told[name][0, 0] for name in shown)
        self._nis, self._failed = self._told["report"]["nis"][0], self._lanes["diverged"][0]
        mechanise = (
            self._samples, self._filled, self._lever, self.interval, self._moving,
            self._disturbance, self._tape,
        )  # fmt: skip
        self._mechanise = partial(entry(mechanize_live, mechanise), *mechanise)
        before = self._lanes, self._models, self._kinds, self._tape[None]
        after = self._row, 1, *hypotheses.NOTHING_KNOWN, *self._told.values()
        self._before, self._after = before, after
        self._run = entry(bank.run, (*before, 0, *after))
        self.reset()

    def reset(self) -> None:
        """Begin anew with the next sample: alignment unknown, both IMUs' axes frozen there."""
        self.time, self.restarts = None, 0
        self._begin()

    def restart_clock(self) -> None:
        """The clock was set: the next sample comes a usual step after the last, whatever its time."""
        self.time = None

    def step(
        self, measurement: Any, lost: Any = None, time: float | Decimal | None = None
    ) -> LiveBankEstimate | None:
        """Take in a sample of both IMUs; returns the estimate where it ends a filter step.

        Args:
            measurement: (4, 3), the increments of `navgym.DualIMURecording`: main angle (rad), main
                velocity (m/s), sub angle, sub velocity, all of one interval. NaN counts as lost.
            lost: one flag, or one per row or element, True where nothing was received.
            time: s, increasing by `interval`; by default it does.

        Raises:
            ValueError: a wrong shape, infinity, or a time that does not move by the interval.
                Nothing has changed then.
        """
        self.put(measurement, lost, time)
        return self._filter()

    def follow(self, recording: Any) -> Iterator[LiveBankEstimate]:
        """The estimates over a recording, as a live stream of its samples would give them."""
        for sample, time, more in self.samples(recording):
            self.put(sample, None, time, **more)
            found = self._filter()
            if found is not None:
                yield found

    def _filter(self) -> LiveBankEstimate | None:
        found = None
        while self.ready():
            found = self._filter_step()
        return found

    def _begin(self) -> None:
        self._begin_samples()
        self._k = 0
        self._told["states"][...] = 0.0

    def _start(self) -> None:
        first, flexures = self._start_samples(), hypotheses.flexures_of(self.model)
        self._models[0] = alignment_model.pack_model(self.model, self.interval, first, flexures)
        lever_sd = self._row[:, 0, bank.LEVER_SD]
        hypotheses.begin(self._lanes, self._models, self._kinds, lever_sd)

    def _known(self) -> Array:
        found: Array = self._told["states"][0, 0]
        return found

    def _filter_step(self) -> LiveBankEstimate:
        if not self._started:
            self._start()
        self._gather()
        self._mechanise()
        self._run(*self._before, self._k, *self._after)
        self._shift()
        self._k += 1
        failed = bool(self._failed[-1])
        x, P, weights, lagged = (view.copy() for view in self._views)
        tape, nis = self._tape.copy(), self._nis.item()
        if failed:
            self.restarts += 1
            self._begin()
        assert self.time is not None
        return LiveBankEstimate(
            self.time, x, P, nis, self.parameters, None, failed, tape, weights, lagged
        )
