"""Recordings stacked for the kernels, and the arrays that kernels write to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.statespace.recording import Recording


@dataclass(frozen=True, eq=False)
class StateSpaceBatch:
    """Recordings of one model size, stacked for the kernels; shorter ones end in lost samples.

    Args:
        y: (N, T, m) measurements; NaN where lost.
        lost: (N, T, m).
        time: (N, T) s.
        models: (N, 1 or T) packed models.
        scales: (N, T, 2) true multiples of Q and R, or None.
        truth: (N, T, n) true states, NaN past a recording's end, or None.
        lengths: (N,) samples of each.
        position: the states that are a position.
        velocity: the states that are a velocity; none where recordings differ.
        sensors: of each measurement component, (m,), see `LinearModel`; none where recordings differ.
        axes: of each state, (n,), likewise.
        recordings: what was stacked.
    """

    y: Array
    lost: NDArray[np.bool_]
    time: Array
    models: NDArray[Any]
    scales: Array | None
    truth: Array | None
    lengths: NDArray[np.int64]
    position: tuple[int, ...]
    velocity: tuple[int, ...]
    sensors: tuple[str, ...]
    axes: tuple[str, ...]
    recordings: tuple[Recording, ...] = ()

    decision_interval: ClassVar[int] = 5  # samples per row of a schedule, as in the environment

    @classmethod
    def of(cls, recordings: Sequence[Recording]) -> StateSpaceBatch:
        """Stack `recordings`; ValueError if there is none or if their models do not fit together."""
        if not recordings:
            raise ValueError("recordings must hold at least one Recording, got none.")
        for r in recordings:
            if not isinstance(r, Recording):
                raise TypeError(f"a recording must be a navgym.Recording, got {type(r)}.")
        sizes = {(type(r.model).__name__, r.model.n, r.model.m) for r in recordings}
        if len(sizes) > 1:
            raise ValueError(
                f"recordings must share one model size, got {sorted(sizes)}: split them."
            )
        positions, velocities, sensors, axes = (
            {tuple(getattr(r.model, name)) for r in recordings}
            for name in ("position", "velocity", "sensors", "axes")
        )
        if len(positions) > 1:
            raise ValueError(f"recordings must agree on their position states, got {positions}.")
        lengths = np.array([len(r) for r in recordings])
        longest = int(lengths.max())
        packed = [r.model.pack() for r in recordings]
        varies = any(len(p) > 1 for p in packed)
        models = np.stack([stretch(p, longest) if varies else p for p in packed])
        scaled = all(
            r.process_scale is not None and r.measurement_scale is not None for r in recordings
        )
        scales = None
        if scaled:
            pairs = [np.stack([r.process_scale, r.measurement_scale], -1) for r in recordings]
            scales = np.stack([stretch(p, longest) for p in pairs])
        known = all(r.truth is not None for r in recordings)
        return cls(
            y=np.stack([_pad(r.measurements, longest, np.nan) for r in recordings]),
            lost=np.stack([_pad(r.lost, longest, True) for r in recordings]),
            time=np.stack([_later(r.time, longest) for r in recordings]),
            models=models,
            scales=scales,
            truth=np.stack([_pad(r.truth, longest, np.nan) for r in recordings]) if known else None,
            lengths=lengths,
            position=positions.pop(),
            velocity=velocities.pop() if len(velocities) == 1 else (),
            sensors=sensors.pop() if len(sensors) == 1 else (),
            axes=axes.pop() if len(axes) == 1 else (),
            recordings=tuple(recordings),
        )

    def __len__(self) -> int:
        return len(self.y)

    def take(self, which: Sequence[int] | NDArray[np.int64]) -> StateSpaceBatch:
        """Some of the recordings, in the order of `which`."""
        index = np.asarray(which, dtype=np.int64)
        held: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        chosen: dict[str, Any] = {k: a[index] for k, a in held.items() if isinstance(a, np.ndarray)}
        kept = tuple(self.recordings[i] for i in index) if self.recordings else ()
        return StateSpaceBatch(**(held | chosen | {"recordings": kept}))

    @property
    def steps(self) -> int:
        """Samples of the longest."""
        return int(self.y.shape[1])

    @property
    def step(self) -> float:
        """Usual seconds between samples, of the first recording."""
        inside = self.time_of(0)
        return float(np.median(np.diff(inside))) if len(inside) > 1 else 1.0

    @property
    def linear(self) -> bool:
        """Whether models are linear."""
        return "H" in (self.models.dtype.names or ())

    def regimes(self) -> list[NDArray[np.int64]]:
        """(T_i,) label of the true regime of each sample; an empty list where not known."""
        if any(r.regime is None for r in self.recordings):
            return []
        return [r.regime for r in self.recordings]

    def time_of(self, i: int) -> Array:
        """(T_i,) s, the times of recording i."""
        return self.time[i, : self.lengths[i]]

    def without_scales(self) -> StateSpaceBatch:
        """The same batch for a filter that must not know the true noise."""
        return replace(self, scales=None)


def _pad(array: NDArray[Any], length: int, value: Any) -> NDArray[Any]:
    if len(array) == length:
        return array
    tail = np.full((length - len(array), *array.shape[1:]), value, dtype=array.dtype)
    return np.concatenate([array, tail])


def stretch(array: NDArray[Any], length: int) -> NDArray[Any]:
    """`array` repeated along its last row to `length` rows."""
    return array[np.minimum(np.arange(length), len(array) - 1)]


def _later(time: Array, length: int) -> Array:
    return np.concatenate([time, time[-1] + np.arange(1.0, length - len(time) + 1)])


def outputs(batch: StateSpaceBatch, n: int, m: int, everything: bool) -> dict[str, Array]:
    """Output arrays for the kernels, NaN past a recording's end; those not asked for are empty."""
    count, steps = batch.y.shape[:2]
    rest = steps if everything else 0
    return {
        "states": np.full((count, steps, n), np.nan),
        "covariances": np.full((count, rest, n, n), np.nan),
        "innovations": np.full((count, rest, m), np.nan),
        "nis": np.full((count, rest), np.nan),
        "log_likelihood": np.full((count, rest), np.nan),
    }
