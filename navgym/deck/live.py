"""A lane of the deck environment on live data: one sample of both IMUs at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array, real_array, within
from navgym.deck import alignment, alignment_model
from navgym.deck import kernels as K
from navgym.deck.alignment import RATE, THETA
from navgym.deck.engine import observation_names, rule_of, station_of
from navgym.deck.estimation import attitudes
from navgym.deck.filters import full_table
from navgym.deck.mechanization import TAPE, begin_lever
from navgym.deck.model import DeckModel
from navgym.deck.settings import DeckDeformationSettings
from navgym.envs.base import TALLY
from navgym.envs.live import LiveEstimate, LiveLane, checked_time, flags, pooled, since

FIRST = 3  # samples that the rate at the start is extrapolated from
SHAPE = (4, 3)  # a sample: angle and velocity increments of the main, then of the sub IMU
USUAL_INTERVAL = 0.01  # s between IMU samples
LATE = 0.02  # by how much of it an IMU's step may miss the interval, as in `DualIMURecording`


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


class LiveDeck(LiveLane):
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

    def __init__(
        self,
        settings: DeckDeformationSettings,
        reference: Mapping[str, Any],
        model: DeckModel,
        interval: float | None = None,
        rates: bool = False,
    ) -> None:
        super().__init__(settings, reference, observation_names(settings))
        if not isinstance(model, DeckModel):
            raise TypeError(f"model must be a navgym.DeckModel, got {type(model).__name__}.")
        if settings.identifies:
            raise ValueError(
                "action_parameters holds rvm_kernel_scale, and a live filter identifies nothing: "
                "use a policy that sets other parameters."
            )
        usual = USUAL_INTERVAL if interval is None else interval
        self.model, self.interval = model, within("interval", usual, 0.0, above=True)
        self._unit = self.interval if rates else 1.0
        self._warmup = settings.warmup
        per = model.samples_per_step
        self._memory, parts = pooled((alignment.LANE, 2), (K.STATION, 2), (np.float64, TALLY))
        self.lanes, self.stations, self.tally = parts
        self._model, self._tape = np.zeros(1, alignment_model.MODEL), np.zeros(1, TAPE)
        judged = np.zeros(1, alignment.RULE)
        judged["iterations"] = judged["judged"] = 1
        self._samples = np.zeros((4, K.HISTORY + per, 3))
        self._filled = np.zeros(K.HISTORY + per, dtype=np.bool_)
        self._moving = np.zeros((5, 4))
        self._disturbance = np.zeros(6)
        self._own_row = full_table(settings.SPACE, self.reference)
        self._rule, self._lever = rule_of(settings), np.array(model.lever_arm)
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
        self._started = False
        self._pending: list[tuple[Array, bool]] = []
        self._last = np.full(SHAPE, np.nan)
        self._moving[...] = 0.0
        self._moving[K.ATTITUDE_M : K.ATTITUDE_S + 1, 0] = 1.0
        self._tape[...] = np.zeros((), TAPE)
        self._tape["q_m"][:, 0] = self._tape["q_s"][:, 0] = 1.0
        self.lanes[...] = np.zeros((), alignment.LANE)
        self.stations[...] = station_of(self.reference)
        self.tally[:] = 0.0
        self.observation[...] = 0.0
        K.first_look(  # type: ignore[no-untyped-call]
            self.stations[:1], self._rule, self.table, self.observation
        )

    def _start(self) -> None:
        """With the first samples known, put the filters at their start."""
        first = np.stack([sample[0] for sample, _ in self._pending[:FIRST]])
        self._model[...] = alignment_model.pack_model(self.model, self.interval, first)
        begin_lever(  # type: ignore[no-untyped-call]
            first, self._lever, self.interval, self._moving[K.LEVER]
        )
        alignment.begin(self.lanes, self._model[None], self._own_row)
        self._samples[:, : K.HISTORY] = self._pending[0][0][:, None]
        self._started = True

    # ---- samples ---------------------------------------------------------------------------

    def put(
        self,
        measurement: Any,
        lost: Any = None,
        time: float | Decimal | None = None,
        disturbance: Array | None = None,
    ) -> None:
        """Take in one sample of both IMUs; see `agents.SelfTuningFilter.step`.

        Args:
            measurement: (4, 3), or the same in one row of 12.
            lost: flags.
            time: s.
            disturbance: (6,) errors of the transmitted quantities, if a simulator made some.
        """
        sample = _checked(measurement, self._unit)
        if lost is not None:
            sample[flags(lost, SHAPE)] = np.nan
        self.time = self._checked_time(time)
        self._disturbance[:] = 0.0 if disturbance is None else disturbance
        whole = math.isfinite(sample.sum())
        if not whole:
            self._fill(sample)
        if whole or self._started or not np.isnan(sample).any():
            self._last = sample
            self._pending.append((sample, not whole))

    def _checked_time(self, time: float | Decimal | None) -> float | Decimal:
        if time is None:
            return (0.0 if self.time is None else float(self.time)) + self.interval
        now = checked_time(time)
        if self.time is None:
            return now
        step = since(now, self.time)
        unsure = 0.0 if isinstance(now, Decimal) else 2.0 * math.ulp(now)
        if not abs(step - self.interval) <= LATE * self.interval + unsure:
            raise ValueError(
                f"time must move by the interval of {self.interval:.6g} s, got {time} after "
                f"{self.time}: pass missed samples as lost ones, and bring uneven ones to a grid; "
                "where the clock was set, call restart_clock() first."
            )
        return now

    def _fill(self, sample: Array) -> None:
        """Put in the other IMU's sample, turned by the attitude estimate, or hold the last one.

        What is made up is marked: the filter widens its covariance and leaves the step's rates out.
        A recording's gaps are filled alike, but with an attitude from the whole recording.
        """
        missing: Any = np.isnan(sample).any(axis=1)
        main_from_sub = self._attitude()
        for row in np.flatnonzero(missing):
            other = (row + 2) % 4
            if main_from_sub is None or missing[other]:
                sample[row] = self._last[row]
            else:
                turn = main_from_sub if row < 2 else main_from_sub.T
                sample[row] = turn @ sample[other]

    def _attitude(self) -> Array | None:
        """The sub's axes in the main's by the reference filter, (3, 3); None before it has run."""
        x = self.lanes["x"][1]
        if not self._started or not x.any():
            return None
        from scipy.spatial.transform import Rotation

        found: Array = Rotation.from_quat(attitudes(self._tape, x[None])[0][0]).as_matrix()
        return found

    def ready(self) -> bool:
        """Whether the samples of a filter step are there."""
        per = self.model.samples_per_step
        return len(self._pending) >= (per if self._started else max(per, FIRST))

    def step(self, look: bool) -> int:
        """Filter the step's samples; with `look` write the observation.

        Returns bits of the filters that failed: 1 the controlled one, 2 the reference. Where one
        did, it goes on from the other; where both did, everything begins anew.
        """
        if not self._started:
            self._start()
        per = self.model.samples_per_step
        for i, (sample, made_up) in enumerate(self._pending[:per], start=K.HISTORY):
            self._samples[:, i] = sample
            self._filled[i] = made_up
        del self._pending[:per]
        failed = self._call(K.live, (*self._arguments, look, self.observation))
        self._samples[:, : K.HISTORY] = self._samples[:, -K.HISTORY :].copy()
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

    @staticmethod
    def samples(recording: Any) -> Iterator[tuple[Array, float, dict[str, Any]]]:
        """Samples of a `navgym.DualIMURecording`; see `LiveLane`."""
        names = ("main_angle", "main_velocity", "sub_angle", "sub_velocity")
        whole = np.stack([getattr(recording, name) for name in names], axis=1)
        per, errors = recording.model.samples_per_step, recording.disturbance
        for k in range(recording.steps * per):
            more = {} if errors is None else {"disturbance": errors[k // per]}
            yield whole[k], float(recording.time[k]), more

    def told(
        self, which: int, parameters: Mapping[str, Any], fallback: str | None, diverged: bool
    ) -> LiveDeckEstimate:
        """What the controlled or the reference filter says of the step."""
        assert self.time is not None
        own, tape = self.answer(which), self._tape.copy()
        return LiveDeckEstimate(self.time, *own, parameters, fallback, diverged, tape)


def _checked(measurement: Any, unit: float) -> Array:
    """A sample (4, 3) in increments, its own copy; ValueError where it is none."""
    sample = real_array("measurement", measurement, finite=False) * unit
    if sample.shape not in (SHAPE, (12,)):
        raise ValueError(
            "measurement must have shape (4, 3), rows main angle, main velocity, sub angle, sub "
            f"velocity, got {sample.shape}: pass NaN where a sample was lost."
        )
    if not math.isfinite(sample.sum()) and np.isinf(sample).any():
        raise ValueError(f"measurement must be finite or NaN, got {measurement}: mark it as lost.")
    return sample.reshape(SHAPE)
