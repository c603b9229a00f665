"""A lane of an environment on live data: sample by sample, and no more known than at sea.

The kernels are the environment's own, so that a policy sees here exactly what it saw in training.
Two filters run side by side on the same samples, one with chosen parameters and one with the
reference's; whoever steers can compare them, and go over to the other at any time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.compile import entry
from navgym.envs.actions import action_table
from navgym.envs.settings import LaneSettings

CONTROLLED, REFERENCE = 0, 1


def pooled(*wanted: tuple[Any, int]) -> tuple[NDArray[np.uint8], list[NDArray[Any]]]:
    """One block of memory, and arrays (count,) of each dtype in it: to keep and restore as a whole."""
    types = [(np.dtype(kind), count) for kind, count in wanted]
    ends = np.cumsum([kind.itemsize * count for kind, count in types])
    memory = np.zeros(int(ends[-1]), dtype=np.uint8)
    pieces = np.split(memory, ends[:-1])
    return memory, [piece.view(kind) for piece, (kind, _) in zip(pieces, types, strict=True)]


@dataclass(frozen=True, slots=True)
class LiveEstimate:
    """What the filter knows after a sample. The arrays belong to whoever gets it.

    Args:
        time: s, as it was given.
        state: (n,) posterior mean.
        covariance: (n, n).
        nis: normalised innovation squared; NaN where nothing was received.
        parameters: in force for this sample, in physical units.
        fallback: why these are the best fixed ones instead of the policy's, or None.
        diverged: whether the filter failed at this sample and was started again.
    """

    time: float | Decimal
    state: Array
    covariance: Array
    nis: float
    parameters: Mapping[str, Any]
    fallback: str | None
    diverged: bool


class LiveLane:
    """What the lanes of all environments share when they run on live data.

    Args:
        settings: of the environment.
        reference: parameters of the reference filter.
        names: of the observation's elements.
    """

    lanes: NDArray[Any]
    stations: NDArray[Any]
    tally: Array  # sums since it was last emptied, by the columns of `navgym.envs.base`
    time: float | Decimal | None  # s, of the last sample; None: whatever the next one says
    components: int  # of a filter step's innovation that are judged together
    begins_anew: ClassVar[bool] = False  # warm-up included, where both filters failed
    compares: ClassVar[bool] = False  # see `navgym.agents.live.fallback.Guard`
    fixes: bool = False  # whether it adds up how far position fixes are missed

    def __init__(
        self, settings: LaneSettings, reference: Mapping[str, Any], names: Sequence[str]
    ) -> None:
        self.settings = settings
        self.names = tuple(names)
        self.reference: Array = settings.SPACE.array(reference)[0]
        residual = settings.action == "residual"
        self.table = action_table(
            settings.SPACE, settings.action_parameters, self.reference, residual
        )
        self.observation = np.zeros((1, len(self.names)), dtype=np.float32)
        self._enter: Callable[..., int] | None = None

    @property
    def warmup(self) -> int:
        """Filter steps with the reference's parameters before the first decision."""
        return 0

    def choose(self, row: Array) -> None:
        """Put physical parameters (P,) in force in the controlled filter."""
        self.stations["row"][CONTROLLED] = row

    def reset(self) -> None:
        """Begin anew, with the next sample."""
        raise NotImplementedError

    def put(self, measurement: Any, lost: Any = None, time: float | Decimal | None = None) -> None:
        """Take in one sample; see `agents.SelfTuningFilter.step`."""
        raise NotImplementedError

    def ready(self) -> bool:
        """Whether the samples of a filter step are there."""
        raise NotImplementedError

    def step(self, look: bool) -> int:
        """Filter a step; with `look` write the observation.

        Returns bits of the filters that failed: 1 the controlled one, 2 the reference.
        """
        raise NotImplementedError

    def answer(self, which: int) -> tuple[Array, Array, float]:
        """State, covariance and NIS of the controlled or the reference filter, copied."""
        raise NotImplementedError

    @staticmethod
    def samples(recording: Any) -> Iterator[tuple[Array, float, dict[str, Any]]]:
        """Samples of a recording, their times, and what else a simulator knows to have arrived."""
        raise NotImplementedError

    def told(
        self, which: int, parameters: Mapping[str, Any], fallback: str | None, diverged: bool
    ) -> LiveEstimate:
        """What the controlled or the reference filter says of the step."""
        assert self.time is not None
        return LiveEstimate(self.time, *self.answer(which), parameters, fallback, diverged)

    def _call(self, kernel: Any, arguments: tuple[Any, ...]) -> int:
        """`kernel` on `arguments`, whose types never change."""
        if self._enter is None:
            self._enter = entry(kernel, arguments)
        return self._enter(*arguments)

    def _heal(self, failed: int) -> None:
        """Where one of the two filters has failed, go on from the other."""
        bad = CONTROLLED if failed & 1 else REFERENCE
        self.lanes[bad] = self.lanes[1 - bad]
        self.tally[:] = 0.0


def since(time: float | Decimal, last: float | Decimal) -> float:
    """Seconds from `last` to `time`, exact where both are exact."""
    if type(time) is type(last):
        return float(time - last)  # type: ignore[operator]
    return float(Decimal(time) - Decimal(last))


def checked_time(time: Any) -> float | Decimal:
    """A time, s; ValueError where it is not finite."""
    now = time if isinstance(time, Decimal) else float(time)
    if not math.isfinite(now):
        raise ValueError(f"time must be finite, got {time}.")
    return now


def flags(lost: Any, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """`lost` as booleans of `shape`: one for all, or one per component; ValueError else."""
    given = np.asarray(lost)
    if given.dtype == np.bool_ and given.shape == shape:
        return given
    if given.dtype != np.bool_ and not np.isin(given, (0, 1)).all():
        raise ValueError(
            f"lost must be booleans, True where nothing was received, got {lost!r}: compare "
            "first, for example `lost > 0`."
        )
    if given.shape not in ((), shape, shape[:1]):
        raise ValueError(
            f"lost must be one flag or one per component, shape {shape}, got {given.shape}."
        )
    given = given.reshape(given.shape + (1,) * (len(shape) - given.ndim))
    return np.broadcast_to(given.astype(np.bool_), shape)
