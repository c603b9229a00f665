"""A recording: what was measured, what was lost, and (where it is known) what was true."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from navgym.core import storage as _storage
from navgym.core.checks import Array, one_of, real_array, shaped
from navgym.core.frozen import Frozen
from navgym.statespace.models import LinearModel, step_of
from navgym.statespace.turn_model import CoordinatedTurnModel

Model: TypeAlias = LinearModel | CoordinatedTurnModel
JITTER = 0.1  # share of a step by which a stamp may miss the one that a model was made for
# by the word that a model's arrays hold
KINDS: Mapping[str, type[Model]] = {"linear": LinearModel, "coordinated-turn": CoordinatedTurnModel}


@dataclass(frozen=True, eq=False)
class Recording(Frozen):
    """Measurements of one voyage, with the model that a filter is to believe.

    Args:
        time: (T,) s, strictly increasing.
        measurements: (T, m); NaN counts as lost, and so does what numpy masks or pandas calls NA.
        lost: (T, m) or (T,) bool, True where nothing was received; None: only where NaN.
        truth: (T, n) true states, or None.
        regime: (T,) whole-number labels of the true regime, for analysis only, or None.
        model: the filter's model; the constant-velocity model of QIVBF table 2 by default.
        meta: anything that JSON can hold: where the recording comes from, regime names.
        process_scale: (T,) true multiple of the model's Q in the step to each sample, or None.
        measurement_scale: (T,) true multiple of the model's R at each sample, or None.

    Raises:
        ValueError: naming the field, the value and the remedy.

    Arrays are copied and read-only. Lost measurements are stored as NaN.
    """

    time: Any
    measurements: Any
    lost: Any = None
    truth: Any = None
    regime: Any = None
    model: Any = None
    meta: Mapping[str, Any] = field(default_factory=dict)
    process_scale: Any = None
    measurement_scale: Any = None

    def __post_init__(self) -> None:
        time = _checked_time(self.time)
        steps = len(time)
        y = real_array("measurements", self.measurements, finite=False)
        if y.ndim != 2 or y.shape[0] != steps:
            raise ValueError(
                f"measurements must have shape ({steps}, m), a row per time, got {y.shape}."
            )
        lost = _checked_lost(self.lost, y)
        if np.isinf(y[~lost]).any():
            k = int(np.argwhere(np.isinf(y) & ~lost)[0, 0])
            raise ValueError(
                f"measurements must be finite or NaN, got inf at sample {k}: mark it in `lost`."
            )
        y[lost] = np.nan
        model = self.model if self.model is not None else _default_model(time, y.shape[1])
        _check_model(model, y.shape, steps)
        _check_accuracy(model, lost)
        _check_steps(model, time)
        arrays: dict[str, Any] = {"time": time, "measurements": y, "lost": lost}
        if self.truth is not None:
            arrays["truth"] = real_array("truth", self.truth)
            shaped("truth", arrays["truth"], (steps, model.n), "a state per sample")
        if self.regime is not None:
            labels = real_array("regime", self.regime)
            shaped("regime", labels, (steps,), "a label per sample")
            odd = (labels != np.rint(labels)) | (np.abs(labels) > 2.0**53)
            if odd.any():
                raise ValueError(f"regime must hold whole-number labels, got {labels[odd][0]}.")
            arrays["regime"] = labels.astype(np.int64)
        for name in ("process_scale", "measurement_scale"):
            if getattr(self, name) is not None:
                arrays[name] = real_array(name, getattr(self, name))
                shaped(name, arrays[name], (steps,), "a factor per sample")
                if (arrays[name] <= 0.0).any():
                    raise ValueError(
                        f"{name} must be positive, got {arrays[name].min()}: it multiplies a "
                        "covariance."
                    )
        self._freeze(arrays | {"model": model, "meta": _storage.writable(self.meta)})

    def __len__(self) -> int:
        return len(self.time)

    @property
    def loss_rate(self) -> float:
        """Share of measurement components that were lost."""
        return float(self.lost.mean())

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the recording as npz, atomically and without pickle; returns the path.

        Raises FileNotFoundError if the folder does not exist.
        """
        arrays = {name: getattr(self, name) for name in _ARRAYS if getattr(self, name) is not None}
        arrays |= {f"model.{name}": value for name, value in self.model.arrays().items()}
        return _storage.save(path, "Recording", arrays, self.meta)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Recording:
        """Read what `save` wrote. ValueError for a truncated, foreign or newer file."""
        arrays, meta = _storage.load(path, "Recording")
        model = {k.removeprefix("model."): v for k, v in arrays.items() if k.startswith("model.")}
        fields = {name: arrays[name] for name in _ARRAYS if name in arrays}
        try:
            return cls(**fields, model=model_from_arrays(model), meta=meta)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is damaged: {error}. Save the recording again.") from error


_ARRAYS = (
    "time", "measurements", "lost", "truth", "regime", "process_scale", "measurement_scale",
)  # fmt: skip


def _checked_time(value: Any) -> Array:
    time = real_array("time", value)
    if time.ndim != 1 or len(time) == 0:
        raise ValueError(f"time must have shape (T,) with T of at least 1, got {time.shape}.")
    steps = np.diff(time)
    if (steps <= 0.0).any():
        k = int(np.argmax(steps <= 0.0))
        raise ValueError(
            f"time must increase strictly, but time[{k}] = {time[k]} is followed by {time[k + 1]}: "
            "sort the samples and drop duplicates."
        )
    return time


def _checked_lost(value: Any, y: Array) -> NDArray[np.bool_]:
    if value is None:
        return np.isnan(y)
    if np.ma.is_masked(value):
        raise ValueError("lost is masked itself: fill it in, for example with .filled(True).")
    lost = np.array(value)
    if lost.dtype != np.bool_ and not np.isin(lost, (0, 1)).all():
        raise ValueError(
            f"lost must be booleans, True where nothing was received, got {lost.ravel()[0]!r} "
            f"({lost.dtype}): compare first, for example `lost > 0`."
        )
    lost = lost.astype(np.bool_)
    if lost.shape == y.shape[:1]:
        lost = np.repeat(lost[:, None], y.shape[1], axis=1)
    shaped("lost", lost, y.shape, "a flag per measurement component")
    return lost | np.isnan(y)


def _default_model(time: Array, m: int) -> Model:
    if m != 4:
        raise ValueError(
            f"the default model measures [Px, Vx, Py, Vy], but measurements have {m} columns: "
            "pass `model=`."
        )
    dt = np.diff(time, prepend=2 * time[0] - time[1]) if len(time) > 1 else np.ones(1)
    return LinearModel(dt=step_of(dt))


def _check_model(model: Model, shape: tuple[int, ...], steps: int) -> None:
    if not hasattr(model, "pack"):
        raise TypeError(
            f"model must be a navgym.LinearModel or a navgym.CoordinatedTurnModel, got {type(model)}."
        )
    if model.m != shape[1]:
        raise ValueError(f"measurements have {shape[1]} columns, but the model measures {model.m}.")
    if model.steps not in (None, steps):
        raise ValueError(
            f"the model changes over {model.steps} samples, the recording has {steps}."
        )


def _check_accuracy(model: Model, lost: NDArray[np.bool_]) -> None:
    """ValueError where something was received whose variance the model does not know."""
    bad = np.argwhere(getattr(model, "deaf", np.zeros(1, np.bool_)) & ~lost)
    if len(bad):
        k, j = (int(i) for i in bad[0])
        raise ValueError(
            f"R must hold the variance of everything that was received, but R[{k}, {j}, {j}] is NaN "
            f"or 0 and measurements[{k}, {j}] was received: set it, or mark the component as lost."
        )


def _check_steps(model: Model, time: Array) -> None:
    """ValueError where a model that is made for certain steps stands on other ones."""
    if model.dt is None or len(time) < 2:
        return
    made = np.broadcast_to(model.dt, time.shape)[1:]
    off = np.abs(np.diff(time) - made) > JITTER * made
    if off.any():
        k = int(np.argmax(off)) + 1
        raise ValueError(
            f"the model is made for steps of dt = {made[k - 1]:.6g} s, but time[{k}] comes "
            f"{time[k] - time[k - 1]:.6g} s after time[{k - 1}]: make it for the recording's own "
            "steps, LinearModel(dt=numpy.diff(time, prepend=2 * time[0] - time[1])) or "
            "LinearModel.white_acceleration likewise."
        )


def model_from_arrays(arrays: dict[str, NDArray[Any]]) -> Model:
    """The model that `arrays()` described; ValueError for a kind that this navgym lacks."""
    kind = one_of("model kind", str(arrays["kind"]), KINDS)
    return KINDS[kind](**{name: value for name, value in arrays.items() if name != "kind"})
