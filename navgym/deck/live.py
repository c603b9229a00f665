"""A lane of the deck environment on live data: one sample of both IMUs at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.deck import alignment, alignment_model
from navgym.deck import kernels as K
from navgym.deck.alignment import RATE, THETA
from navgym.deck.engine import observation_names, rule_of, station_of
from navgym.deck.estimation import attitudes
from navgym.deck.filters import full_table
from navgym.deck.intake import Intake
from navgym.deck.model import DeckModel
from navgym.deck.settings import DeckDeformationSettings
from navgym.envs.columns import TALLY
from navgym.envs.live import LiveEstimate, LiveLane, pooled


@dataclass(frozen=True, slots=True)
class LiveDeckEstimate(LiveEstimate):
    """The same of the deck filter, whose states are l, δV, φ, ε, ∇, V_r, θ, θ̇ (IDAM eq. 73).

    Args:
        tape: (1,) what the step's samples amounted to; see `navgym.deck.mechanization.TAPE`.
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


class LiveDeck(Intake, LiveLane):
    """The 24-state filter twice, behind one strapdown mechanisation.

    Args:
        settings: of the environment.
        reference: parameters of the reference filter; residual actions start from them.
        model: what the filters believe.
        interval: s between IMU samples; 0.01 by default.
        rates: whether samples hold rates (rad/s) and specific forces (m/s²); else increments.

    Raises:
        TypeError: a model of another kind.
        ValueError: an agent that sets how the flexure is identified, which live lanes don't.
    """

    components = 3
    begins_anew = True
    compares = (
        True  # in seas that nobody trained for a policy is often right, and can be seen to be
    )

    def __init__(
        self,
        settings: DeckDeformationSettings,
        reference: Mapping[str, Any],
        model: DeckModel,
        interval: float | None = None,
        rates: bool = False,
    ) -> None:
        LiveLane.__init__(self, settings, reference, observation_names(settings))
        Intake.__init__(self, model, interval, rates)
        if settings.identifies:
            raise ValueError(
                "action_parameters holds rvm_kernel_scale, and a live filter identifies nothing: "
                "use a policy that sets other parameters."
            )
        self._warmup = settings.warmup
        self._memory, parts = pooled((alignment.LANE, 2), (K.STATION, 2), (np.float64, TALLY))
        self.lanes, self.stations, self.tally = parts
        self._model = np.zeros(1, alignment_model.MODEL)
        judged = np.zeros(1, alignment.RULE)
        judged["iterations"] = judged["judged"] = 1
        judged["own_channels"] = settings.own_channels
        self._own_row = full_table(settings.SPACE, self.reference)
        self._rule = rule_of(settings)
        self._arguments = (
            self.lanes, self.stations, self._model, self._tape, judged, self._rule,
            self.table, self._samples, self._filled, self._lever, self._moving,
            self._disturbance, self.tally,
        )  # fmt: skip
        self._views = [tuple(self.lanes[n][i : i + 1] for n in ("x", "P", "nis")) for i in (0, 1)]
        self.reset()

    @property
    def warmup(self) -> int:
        """Filter steps with the reference's parameters before the first decision."""
        return round(self._warmup / (self.interval * self.model.samples_per_step))

    def reset(self) -> None:
        """Begin anew with the next sample: alignment unknown, both IMUs' axes frozen there."""
        self.time = None
        self._begin()

    def _begin(self) -> None:
        self._begin_samples()
        self.lanes[...] = np.zeros((), alignment.LANE)
        self.stations[...] = station_of(self.reference)
        self.tally[:] = 0.0
        self.observation[...] = 0.0
        K.first_look(  # type: ignore[no-untyped-call]
            self.stations[:1], self._rule, self.table, self.observation
        )

    def _start(self) -> None:
        """With the first samples known, put the filters at their start."""
        first = self._start_samples()
        self._model[...] = alignment_model.pack_model(self.model, self.interval, first)
        alignment.begin(self.lanes, self._model[None], self._own_row)

    def _known(self) -> Array:
        """The reference filter's state."""
        found: Array = self.lanes["x"][1]
        return found

    def step(self, look: bool) -> int:
        """Filter the step's samples; with `look` write the observation.

        Returns bits of the filters that failed: 1 the controlled one, 2 the reference. Where one
        did, it goes on from the other; where both did, everything begins anew.
        """
        if not self._started:
            self._start()
        self._gather()
        failed = self._call(K.live, (*self._arguments, look, self.observation))
        self._shift()
        if failed == 3:
            self._begin()
            alignment.begin(self.lanes, self._model[None], self._own_row)
        elif failed:
            self._heal(failed)
        return failed

    def answer(self, which: int) -> tuple[Array, Array, float]:
        """State, covariance and NIS of the controlled or the reference filter, copied."""
        x, P, nis = self._views[which]
        return x[0].copy(), P[0].copy(), nis.item()

    def told(
        self, which: int, parameters: Mapping[str, Any], fallback: str | None, diverged: bool
    ) -> LiveDeckEstimate:
        """What the controlled or the reference filter says of the step."""
        assert self.time is not None
        own, tape = self.answer(which), self._tape.copy()
        return LiveDeckEstimate(self.time, *own, parameters, fallback, diverged, tape)
