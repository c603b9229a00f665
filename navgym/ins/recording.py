"""A recording of one IMU and any set of aiding sensors, each with its own times."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navgym.core import storage as _storage
from navgym.core.checks import Array, real_array, shaped
from navgym.core.frozen import Frozen
from navgym.core.stops import saturated
from navgym.inertial.earth import GRAVITY
from navgym.ins.layout import STATES
from navgym.ins.model import AidingModel, InsModel

IMPOSSIBLE = 1e9  # what no sensor measures, but a damaged file holds
UNEVEN = 0.02  # by how much of it an IMU's step may miss the usual one
CHANNELS = {
    "angle": ("gyro_x", "gyro_y", "gyro_z"),
    "velocity": ("acc_x", "acc_y", "acc_z"),
}
TRUTH = STATES  # columns of the truth: those of the filters' states


@dataclass(frozen=True, eq=False)
class Aiding(Frozen):
    """What one aiding sensor measured.

    Args:
        time: (M,) s, when each measurement was valid, on the IMU's clock.
        values: (M, rows), or (M,) for one row; NaN where nothing was received.
        lost: (M,) True where a measurement should have come and did not; what is NaN is lost too.
    """

    time: Any
    values: Any
    lost: Any = None

    def __post_init__(self) -> None:
        time = real_array("time of a sensor", self.time)
        values = real_array("values of a sensor", self.values, finite=False)
        values = values[:, None] if values.ndim == 1 else values
        if time.ndim != 1 or values.ndim != 2 or len(values) != len(time):
            raise ValueError(
                f"values must have a row for each of the {time.shape} times of a sensor, got "
                f"{values.shape}."
            )
        if (np.diff(time) <= 0.0).any():
            k = int(np.argmax(np.diff(time) <= 0.0))
            raise ValueError(
                f"time of a sensor must increase strictly, but {time[k]} is followed by "
                f"{time[k + 1]}: sort its rows and drop duplicates."
            )
        lost = np.zeros(len(time), np.bool_) if self.lost is None else np.array(self.lost)
        if lost.dtype != np.bool_:
            raise ValueError(
                f"lost must hold booleans, got {lost.dtype}: compare first, for example `lost > 0`."
            )
        shaped("lost", lost, (len(time),), "a flag per time")
        if (np.isinf(values) | (np.abs(values) > IMPOSSIBLE)).any():
            k = int(np.argwhere(np.isinf(values) | (np.abs(values) > IMPOSSIBLE))[0, 0])
            raise ValueError(
                f"values must hold what a sensor can measure, got {values[k]} at {time[k]} s: mark "
                "it as NaN."
            )
        lost = lost | np.isnan(values).any(axis=1)
        values[lost] = np.nan
        self._freeze({"time": time, "values": values, "lost": lost})

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, eq=False)
class InertialRecording(Frozen):
    """Increments of one IMU, and what its vehicle's other sensors measured.

    Row k of the increments holds what was integrated from `time[k] - interval` to `time[k]`, in body axes
    (forward, starboard, down). NaN marks a sample that was not received. Arrays are copied and
    read-only.

    Args:
        time: (T,) s, even steps.
        angle: (T, 3) rad, angle increments.
        velocity: (T, 3) m/s, velocity increments (specific force: −g T down at rest).
        aiding: an `Aiding` per sensor of the model, by the same names; sensors without one are silent.
        model: what a filter is to believe.
        truth: (K, 22) the filters' states at the end of each filter step, or None; NaN where not known.
        regime: (K,) labels of the true regime, for analysis only, or None.
        noise_scales: true variance of each measurement over the model's, (M,) by sensor, or None.
        imu_scale: (K,) the same of the IMU's white noise, or None.
        meta: anything that JSON can hold: where the recording comes from, regime names.
        check_units: whether to refuse data whose units or axes cannot be, and to take samples at the stop of
            a sensor's range for missing, with a warning (`navgym.core.stops`).

    K is the number of filter steps, T // model.samples_per_step.

    Raises:
        ValueError: naming the field, the value and the remedy.
    """

    time: Any
    angle: Any
    velocity: Any
    aiding: Mapping[str, Aiding] = field(default_factory=dict)
    model: InsModel = field(default_factory=InsModel)
    truth: Any = None
    regime: Any = None
    noise_scales: Any = None
    imu_scale: Any = None
    meta: Mapping[str, Any] = field(default_factory=dict)
    check_units: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.model, InsModel):
            raise TypeError(f"model must be an InsModel, got {type(self.model).__name__}.")
        time = _even_time(self.time)
        T, per = len(time), self.model.samples_per_step
        if per > T:
            raise ValueError(
                f"time has {T} samples, a filter step needs {per}: record longer or lower "
                "samples_per_step of the model."
            )
        arrays: dict[str, Any] = {"time": time}
        for name in ("angle", "velocity"):
            arrays[name] = _samples(name, getattr(self, name), T)
        arrays["aiding"] = _checked_aiding(self.aiding, self.model)
        K = T // per
        if self.truth is not None:
            arrays["truth"] = real_array("truth", self.truth, finite=False)
            shaped("truth", arrays["truth"], (K, TRUTH), "the filters' states at each filter step")
        if self.imu_scale is not None:
            arrays["imu_scale"] = real_array("imu_scale", self.imu_scale)
            shaped("imu_scale", arrays["imu_scale"], (K,), "a number per filter step")
        if self.regime is not None:
            labels = real_array("regime", self.regime)
            shaped("regime", labels, (K,), "a label per filter step")
            if (labels != np.rint(labels)).any() or np.abs(labels).max() > 2**31:
                raise ValueError(f"regime must hold whole numbers, got {labels}.")
            arrays["regime"] = labels.astype(np.int64)
        if self.noise_scales is not None:
            arrays["noise_scales"] = _checked_scales(self.noise_scales, arrays["aiding"])
        if self.check_units:
            _check_units(time, arrays)
            _leave_out_stops(arrays, float(np.median(np.diff(time))))
        self._freeze(arrays | {"meta": _storage.writable(self.meta)})

    @classmethod
    def from_rates(
        cls, time: ArrayLike, rate: ArrayLike, force: ArrayLike, **fields: Any
    ) -> InertialRecording:
        """A recording from rates (T, 3), rad/s, and specific forces (T, 3), m/s², each held over its interval.

        Args:
            time: (T,) s.
            rate: of the gyros.
            force: of the accelerometers; (0, 0, −9.8) at rest.
            fields: further fields of the class.
        """
        even = _even_time(time)
        h = (even[-1] - even[0]) / (len(even) - 1)
        given = [_samples(n, v, len(even)) * h for n, v in (("rate", rate), ("force", force))]
        return cls(even, *given, **fields)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def interval(self) -> float:
        """Seconds between IMU samples, to nine digits, which whoever filters live can tell as well."""
        return nine_digits(float((self.time[-1] - self.time[0]) / (len(self.time) - 1)))

    @property
    def step(self) -> float:
        """Seconds per filter step."""
        return self.interval * self.model.samples_per_step

    @property
    def steps(self) -> int:
        """Number of filter steps, K."""
        return len(self.time) // self.model.samples_per_step

    @property
    def step_time(self) -> Array:
        """(K,) s, end of each filter step."""
        per = self.model.samples_per_step
        ends: Array = self.time[per - 1 :: per][: self.steps]
        return ends

    @property
    def gaps(self) -> NDArray[np.bool_]:
        """(T,) bool: IMU samples of which some part was not received."""
        lost: NDArray[np.bool_] = np.isnan(self.angle).any(axis=1) | np.isnan(self.velocity).any(1)
        return lost

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the recording as npz, atomically and without pickle; returns the path."""
        arrays = {n: getattr(self, n) for n in _ARRAYS if getattr(self, n) is not None}
        for name, sensor in self.aiding.items():
            arrays |= {f"aiding.{name}.{what}": getattr(sensor, what) for what in _AIDING}
        for name, scale in (self.noise_scales or {}).items():
            arrays[f"noise_scale.{name}"] = scale
        arrays |= {f"model.{name}": value for name, value in self.model.arrays().items()}
        return _storage.save(path, type(self).__name__, arrays, self.meta)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> InertialRecording:
        """Read what `save` wrote. ValueError for a truncated, foreign or newer file."""
        arrays, meta = _storage.load(path, cls.__name__)
        fields: dict[str, Any] = {name: arrays[name] for name in _ARRAYS if name in arrays}
        try:
            model = InsModel.from_arrays(_below("model.", arrays))
            parts: dict[str, dict[str, Any]] = {}
            for key, value in _below("aiding.", arrays).items():
                name, _, what = key.rpartition(".")
                parts.setdefault(name, {})[what] = value
            aiding = {name: Aiding(**each) for name, each in parts.items()}
            scales = _below("noise_scale.", arrays) or None
            return cls(
                **fields,
                aiding=aiding,
                model=model,
                noise_scales=scales,
                meta=meta,
                check_units=False,
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is damaged: {error}. Save the recording again.") from error


def nine_digits(value: float) -> float:
    """`value` without what differences of times add to it."""
    return float(f"{value:.9g}")


_ARRAYS = ("time", "angle", "velocity", "truth", "regime", "imu_scale")
_AIDING = ("time", "values", "lost")


def _below(prefix: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
    return {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}


def _even_time(value: ArrayLike) -> Array:
    time = real_array("time", value)
    if time.ndim != 1 or len(time) < 2:
        raise ValueError(f"time must have shape (T,) with T of at least 2, got {time.shape}.")
    steps = np.diff(time)
    if (steps <= 0.0).any():
        k = int(np.argmax(steps <= 0.0))
        raise ValueError(
            f"time must increase strictly, but time[{k}] = {time[k]} is followed by {time[k + 1]}: "
            "sort the samples and drop duplicates."
        )
    usual = float(np.median(steps))
    if np.abs(steps - usual).max() > UNEVEN * usual:
        k = int(np.argmax(np.abs(steps - usual)))
        raise ValueError(
            f"time must have even steps, but {steps[k]:.6g} s follow time[{k}] = {time[k]} where "
            f"{usual:.6g} s are usual: bring the IMU to an even grid and mark gaps as NaN."
        )
    return time


def _samples(name: str, value: ArrayLike, count: int) -> Array:
    array = real_array(name, value, finite=False)
    shaped(name, array, (count, 3), "a row per IMU sample")
    bad = np.isinf(array) | (np.abs(array) > IMPOSSIBLE)
    if bad.any():
        k, axis = (int(i) for i in np.argwhere(bad)[0])
        raise ValueError(
            f"{name} must hold what an IMU can measure, got {array[k, axis]:g} at sample {k}: mark "
            "it as NaN."
        )
    if np.isnan(array).any(axis=1).all():
        raise ValueError(f"{name} holds no whole sample: nothing can be estimated.")
    return array


def _checked_aiding(given: Mapping[str, Any], model: InsModel) -> dict[str, Aiding]:
    unknown = sorted(set(given) - set(model.sensors))
    if unknown:
        raise ValueError(
            f"aiding holds {', '.join(unknown)}, which the model does not know: give it an "
            f"AidingModel in sensors= of the model; it has {', '.join(model.sensors) or 'none'}."
        )
    found = {}
    for name, sensor in given.items():
        if not isinstance(sensor, Aiding):
            raise TypeError(f"aiding[{name!r}] must be an Aiding, got {type(sensor).__name__}.")
        rows = model.sensors[name].rows
        if sensor.values.shape[1] != rows:
            raise ValueError(
                f"aiding[{name!r}] must have {rows} numbers per measurement "
                f"(a {model.sensors[name].kind}), got {sensor.values.shape[1]}."
            )
        found[name] = sensor
    return found


def _checked_scales(given: Mapping[str, Any], aiding: Mapping[str, Aiding]) -> dict[str, Array]:
    found = {}
    for name, sensor in aiding.items():
        scale = real_array(f"noise_scales[{name!r}]", given[name])
        shaped(f"noise_scales[{name!r}]", scale, (len(sensor),), "a number per measurement")
        scale.flags.writeable = False
        found[name] = scale
    return found


def _check_units(time: Array, arrays: Mapping[str, Any]) -> None:
    """ValueError where the mean specific force cannot be gravity, or rates cannot be a vehicle's."""
    h = float(np.median(np.diff(time)))
    force = np.nanmean(arrays["velocity"], axis=0) / h
    size = float(np.linalg.norm(force))
    if not 0.8 * GRAVITY < size < 1.2 * GRAVITY:
        raise ValueError(
            f"velocity must be increments of specific force, m/s, whose mean over an interval of {h:g} "
            f"s is about {GRAVITY:.2f} m/s², got {size:.3g}: check the units, and pass forces to "
            "InertialRecording.from_rates."
        )
    if force[2] > -0.5 * GRAVITY:
        raise ValueError(
            f"velocity must be in body axes forward, starboard, down, where a level vehicle feels "
            f"(0, 0, -{GRAVITY:.1f}) m/s², got a mean of ({force[0]:.2f}, {force[1]:.2f}, "
            f"{force[2]:.2f}): turn the axes, for example negate y and z of an IMU with z up."
        )
    rate = float(np.nanmedian(np.abs(arrays["angle"]))) / h
    if rate > 10.0:
        raise ValueError(
            f"angle must be increments in rad, got a median rate of {rate:.3g} rad/s: check whether "
            "it holds degrees or rates, and pass rates to InertialRecording.from_rates."
        )


def _leave_out_stops(arrays: dict[str, Any], h: float) -> None:
    """Samples at which a channel stands at the stop of its range become missing ones; UserWarning."""
    for field_, names in CHANNELS.items():
        at_stop, found = saturated(arrays[field_], names)
        if not found:
            continue
        for name, stop, count in found:
            warnings.warn(
                f"{field_}: {name} says exactly {stop / h:.6g}, the end of its range, {count} times: it is saturated. "
                "These samples count as missing; use a sensor of wider range or better mounting against shocks, or "
                "keep them with check_units=False.",
                stacklevel=5,
            )
        arrays[field_] = np.where(at_stop[:, None], np.nan, arrays[field_])


__all__ = ["Aiding", "AidingModel", "InertialRecording"]
