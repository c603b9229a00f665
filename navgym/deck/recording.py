"""A recording of two IMUs on one deck: the main one, the sub one, and what is known beside them."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from navgym.core import storage as _storage
from navgym.core.checks import Array, real_array, shaped, within
from navgym.core.frozen import Frozen
from navgym.deck.model import DeckModel
from navgym.inertial.earth import GRAVITY

IMPOSSIBLE = 1e9  # rad/s or m/s², as rates or increments: no IMU's, but a damaged file's
WHOLE = 2.0**53  # whole numbers up to here are exact
_IMU = ("main_angle", "main_velocity", "sub_angle", "sub_velocity")
_STEPS = {
    "disturbance": 6,
    "disturbance_variance": 6,
    "impulse_variance": 3,
    "impulse_left": 1,
    "true_flexure": 9,
}
_ARRAYS = (*_IMU, "theta", "theta_rate", "static", "attitude", "regime", *_STEPS)


@dataclass(frozen=True, eq=False)
class DualIMURecording(Frozen):
    """Increments of two IMUs, sampled together at an even rate.

    Row k holds what was integrated from `time[k] - interval` to `time[k]`. NaN marks a sample that
    was not received. Arrays are copied and read-only.

    Args:
        time: (T,) s, even steps.
        main_angle: (T, 3) rad, angle increments of the main IMU, in its own axes.
        main_velocity: (T, 3) m/s, velocity increments (specific force).
        sub_angle: (T, 3) rad, of the sub IMU, in its own axes.
        sub_velocity: (T, 3) m/s.
        model: what a filter is to believe; `DeckModel()`, the setting of IDAM section 5, by default.
        theta: (T, 3) true dynamic deformation in the main IMU's axes, rad, or None.
        theta_rate: (T, 3) its derivative, rad/s, or None.
        static: (3,) true static deformation (and mounting), a rotation vector, rad, or None.
        attitude: (T, 4) reference attitude of the sub in the main IMU's axes (unit quaternions,
            scalar last), or None; by default it follows from theta and static, where both are
            known: C_s^m = Exp(θ) Exp(Φ).
        regime: (T,) labels of the true regime, for analysis only, or None.
        disturbance: (K, 6) errors of the transmitted matching quantities (velocity, m/s; rate,
            rad/s) at each filter step, that do not enter the mechanisation; None for none.
        disturbance_variance: (K, 6) true variance of these at each step, or None.
        impulse_variance: (K, 3) true variance of jumps of θ̇ within each step, rad²/s², or None.
        impulse_left: (K, 1) share of each step that was still to come when θ̇ jumped, or None: its end.
        true_flexure: (K, 9) true (2μ, b², σ), three axes each, at each step, or None.
        meta: anything that JSON can hold: where the recording comes from, regime names.
        check_units: whether to refuse data whose units cannot be.

    K is the number of filter steps, T // model.samples_per_step.

    Raises:
        ValueError: naming the field, the value and the remedy.
    """

    time: Any
    main_angle: Any
    main_velocity: Any
    sub_angle: Any
    sub_velocity: Any
    model: DeckModel = field(default_factory=DeckModel)
    theta: Any = None
    theta_rate: Any = None
    static: Any = None
    attitude: Any = None
    regime: Any = None
    disturbance: Any = None
    disturbance_variance: Any = None
    impulse_variance: Any = None
    impulse_left: Any = None
    true_flexure: Any = None
    meta: Mapping[str, Any] = field(default_factory=dict)
    check_units: bool = True

    def __post_init__(self) -> None:
        if not isinstance(self.model, DeckModel):
            raise TypeError(f"model must be a navgym.DeckModel, got {type(self.model)}.")
        time = _even_time(self.time)
        T = len(time)
        if max(2 * self.model.samples_per_step, 3) > T:
            raise ValueError(
                f"time has {T} samples, two filter steps need {max(2 * self.model.samples_per_step, 3)}: "
                "record longer or lower samples_per_step of the model."
            )
        arrays: dict[str, Any] = {"time": time}
        for name in _IMU:
            arrays[name] = _samples(name, getattr(self, name), T)
        for name in ("theta", "theta_rate"):
            if getattr(self, name) is not None:
                arrays[name] = real_array(name, getattr(self, name))
                shaped(name, arrays[name], (T, 3), "a row per IMU sample")
        if self.static is not None:
            arrays["static"] = real_array("static", self.static)
            shaped("static", arrays["static"], (3,), "a rotation vector in rad")
        if self.attitude is not None:
            arrays["attitude"] = _quaternions(self.attitude, T)
        if self.regime is not None:
            labels = real_array("regime", self.regime)
            shaped("regime", labels, (T,), "a label per IMU sample")
            odd = (labels != np.rint(labels)) | (np.abs(labels) > WHOLE)
            if odd.any():
                k = int(np.argmax(odd))
                raise ValueError(f"regime must hold whole numbers, got {labels[k]} at sample {k}.")
            arrays["regime"] = labels.astype(np.int64)
        for name, width in _STEPS.items():
            if getattr(self, name) is not None:
                arrays[name] = real_array(name, getattr(self, name))
                shape = (T // self.model.samples_per_step, width)
                shaped(name, arrays[name], shape, "a row per filter step")
        if self.check_units:
            _check_units(time, arrays)
        self._freeze(arrays | {"meta": _storage.writable(self.meta)})

    @classmethod
    def from_rates(
        cls,
        time: ArrayLike,
        main_rate: ArrayLike,
        main_force: ArrayLike,
        sub_rate: ArrayLike,
        sub_force: ArrayLike,
        *,
        gyro_limit: float | None = None,
        force_limit: float | None = None,
        **fields: Any,
    ) -> DualIMURecording:
        """A recording from rates (rad/s) and specific forces (m/s²), each held over its interval.

        Args:
            time: (T,) s.
            main_rate: (T, 3) of the main IMU's gyros.
            main_force: (T, 3) of its accelerometers.
            sub_rate: (T, 3) of the sub IMU's gyros.
            sub_force: (T, 3) of its accelerometers.
            gyro_limit: rates of this size or more are saturated: taken as not received, rad/s.
            force_limit: the same for specific forces, m/s².
            fields: further fields of the class.

        Warns (UserWarning) where an extreme value repeats as only a saturated sensor's does.
        """
        even = _even_time(time)
        h = (even[-1] - even[0]) / (len(even) - 1)
        given = {
            "main_rate": main_rate,
            "main_force": main_force,
            "sub_rate": sub_rate,
            "sub_force": sub_force,
        }
        data = {name: _samples(name, value, len(even)) for name, value in given.items()}
        for name, value in data.items():
            limit = gyro_limit if name.endswith("rate") else force_limit
            _desaturate(name, value, limit)
        return cls(even, *(value * h for value in data.values()), **fields)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def interval(self) -> float:
        """Seconds between IMU samples."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1))

    @property
    def step(self) -> float:
        """Seconds between filter steps."""
        return self.interval * self.model.samples_per_step

    @property
    def steps(self) -> int:
        """Number of filter steps, K."""
        return len(self.time) // self.model.samples_per_step

    @property
    def step_time(self) -> Array:
        """(K,) s, end of each filter step."""
        value: Array = self.at_steps(self.time)
        return value

    def at_steps(self, samples: Array) -> Any:
        """`samples` (T, ...) at the end of each filter step, (K, ...)."""
        s = self.model.samples_per_step
        return samples[s - 1 :: s][: self.steps]

    @property
    def reference(self) -> Array | None:
        """(T, 4) reference attitude of sub in main, quaternions (scalar last), or None."""
        return self._reference(lambda samples: samples)

    @property
    def step_reference(self) -> Array | None:
        """(K, 4) the same at the end of each filter step only, which is quicker."""
        return self._reference(self.at_steps)

    def _reference(self, pick: Callable[[Array], Array]) -> Array | None:
        """The reference at the samples that `pick` takes."""
        if self.attitude is not None:
            return pick(self.attitude)
        if self.theta is None or self.static is None:
            return None
        bent = Rotation.from_rotvec(np.array(pick(self.theta)))  # scipy takes writable arrays only
        moved: Array = (bent * Rotation.from_rotvec(np.array(self.static))).as_quat()
        return moved

    @property
    def gaps(self) -> NDArray[np.bool_]:
        """(T,) bool: samples of which some part was not received."""
        lost: NDArray[np.bool_] = np.isnan(
            np.concatenate([getattr(self, n) for n in _IMU], axis=1)
        ).any(axis=1)
        return lost

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the recording as npz, atomically and without pickle; returns the path."""
        arrays = {n: getattr(self, n) for n in ("time", *_ARRAYS) if getattr(self, n) is not None}
        arrays |= {f"model.{name}": value for name, value in self.model.arrays().items()}
        return _storage.save(path, type(self).__name__, arrays, self.meta)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> DualIMURecording:
        """Read what `save` wrote. ValueError for a truncated, foreign or newer file."""
        arrays, meta = _storage.load(path, cls.__name__)
        model = {k.removeprefix("model."): v for k, v in arrays.items() if k.startswith("model.")}
        fields = {name: arrays[name] for name in ("time", *_ARRAYS) if name in arrays}
        try:
            return cls(**fields, model=DeckModel.from_arrays(model), meta=meta, check_units=False)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is damaged: {error}. Save the recording again.") from error


def _even_time(value: ArrayLike) -> Array:
    time = real_array("time", value)
    if time.ndim != 1 or len(time) < 2:
        raise ValueError(f"time must have shape (T,) with T of at least 2, got {time.shape}.")
    steps = np.diff(time)
    if (steps <= 0.0).any():
        k = int(np.argmax(steps <= 0.0))
        raise ValueError(
            f"time must increase strictly, but time[{k}] = {time[k]} is followed by {time[k + 1]}: "
            "sort the samples and drop duplicates (navgym.deck.recording.resample does both)."
        )
    usual = float(np.median(steps))
    if np.abs(steps - usual).max() > 0.02 * usual:
        k = int(np.argmax(np.abs(steps - usual)))
        raise ValueError(
            f"time must have even steps, but {steps[k]:.6g} s follow time[{k}] = {time[k]} where "
            f"{usual:.6g} s are usual: use navgym.deck.recording.resample, which marks gaps as lost."
        )
    return time


def resample(
    time: ArrayLike, values: ArrayLike, grid: ArrayLike, longest_gap: float | None = None
) -> Array:
    """Rates or specific forces (T, c) at uneven times on an even `grid` (G,), linearly.

    Rows of equal time are reduced to the first of them. Where two successive samples lie further
    apart than `longest_gap` s (three usual steps by default), what lies strictly between them
    becomes NaN, as does what lies beside a NaN and what lies outside the times.

    Returns:
        (G, c) values.

    Raises:
        ValueError: shapes that do not fit, fewer than two different times.
    """
    t = real_array("time", time)
    v = real_array("values", values, finite=False)
    if t.ndim != 1 or v.ndim != 2 or len(v) != len(t):
        raise ValueError(
            f"values must have shape (T, c), a row for each of the T times, got {v.shape} beside "
            f"time of shape {t.shape}."
        )
    order = np.argsort(t, kind="stable")
    t, first = np.unique(t[order], return_index=True)
    v, at = v[order][first], real_array("grid", grid)
    if len(t) < 2:
        raise ValueError(f"time must hold at least two different times, got {t}.")
    usual = float(np.median(np.diff(t)))
    gap = 3.0 * usual if longest_gap is None else longest_gap
    within("longest_gap", gap, 0.0, above=True)
    after = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    close = 1e-6 * usual  # rounding of times: what was sampled then lies in no gap
    met = np.minimum(np.abs(at - t[after]), np.abs(at - t[after - 1])) <= close
    wide = (t[after] - t[after - 1] > gap) | (at < t[0]) | (at > t[-1])
    found = np.stack([np.interp(at, t, column) for column in v.T], axis=-1)
    found[wide & ~met] = np.nan
    return found


def _samples(name: str, value: ArrayLike, count: int) -> Array:
    array = real_array(name, value, finite=False)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have shape (T, 3), a row per sample, got {array.shape}.")
    if len(array) != count:
        raise ValueError(
            f"{name} has {len(array)} rows and time has {count}: both IMUs must be sampled together. "
            "Bring them to one grid with navgym.deck.recording.resample."
        )
    if np.isinf(array).any():
        k = int(np.argwhere(np.isinf(array))[0, 0])
        raise ValueError(f"{name} must be finite or NaN, got inf at sample {k}: mark it as NaN.")
    if (np.abs(array) > IMPOSSIBLE).any():
        k, axis = (int(i) for i in np.argwhere(np.abs(array) > IMPOSSIBLE)[0])
        raise ValueError(
            f"{name} must hold what an IMU can measure, got {array[k, axis]:g} at sample {k}: mark "
            "it as NaN."
        )
    if np.isnan(array).all():
        raise ValueError(f"{name} holds nothing but NaN: nothing can be estimated.")
    return array


def _quaternions(value: ArrayLike, count: int) -> Array:
    q = real_array("attitude", value)
    shaped("attitude", q, (count, 4), "a quaternion per IMU sample, scalar last")
    length = np.linalg.norm(q, axis=1)
    if np.abs(length - 1.0).max() > 1e-2:
        k = int(np.argmax(np.abs(length - 1.0)))
        raise ValueError(f"attitude must hold unit quaternions, got length {length[k]:.4g} at {k}.")
    normalised: Array = q / length[:, None]
    return normalised


def _desaturate(name: str, value: Array, limit: float | None) -> None:
    """Turn saturated samples into NaN, or warn of what looks like them."""
    if limit is not None:
        value[np.abs(value) >= within(f"limit of {name}", limit, 0.0, above=True)] = np.nan
        return
    moved = (np.diff(value, axis=0) != 0.0).any(axis=1)  # else the whole sample is a held one
    for axis in range(3):
        column = value[:, axis]
        if len(np.unique(np.abs(column[~np.isnan(column)]))) < 8:
            continue  # lost, constant, or a few quantisation steps at rest
        top = np.nanmax(np.abs(column))
        flat = np.abs(column) == top
        runs = flat[2:] & flat[1:-1] & flat[:-2] & moved[1:] & moved[:-1]
        if runs.any():
            warnings.warn(
                f"{name} looks saturated: axis {axis} stays at its extreme, {top:.6g}, for three or "
                f"more samples around sample {int(np.argmax(runs))}. Pass the sensor's limit (gyro_limit=, "
                "force_limit=) to treat such samples as lost.",
                stacklevel=3,
            )


def _check_units(time: Array, arrays: Mapping[str, Array]) -> None:
    """ValueError where specific forces or rates cannot be in m/s² and rad/s."""
    h = (time[-1] - time[0]) / (len(time) - 1)
    for imu in ("main", "sub"):
        size = np.linalg.norm(arrays[f"{imu}_velocity"], axis=1) / h
        if np.isnan(size).all():
            continue
        force = np.nan_to_num(arrays[f"{imu}_velocity"]) / h
        rate = np.nan_to_num(arrays[f"{imu}_angle"]) / h
        mean = float(np.nanmedian(size))  # of the received samples: zeros would halve it
        if not 0.3 * GRAVITY < mean < 3.0 * GRAVITY:
            in_g = 0.3 < mean < 3.0
            hint = "they look like g: multiply by 9.80665" if in_g else "check units and order"
            raise ValueError(
                f"{imu}_velocity: the usual specific force is {mean:.3g} m/s², where gravity alone "
                f"gives 9.8; {hint} (or pass check_units=False)."
            )
        _check_rate_units(imu, rate, force, h)


def _check_rate_units(imu: str, rate: Array, force: Array, h: float) -> None:
    """Rates in wrong units turn gravity about in inertial space; right ones leave it in place.

    Too large ones scatter it; too small ones leave the sway in it, which right ones take out.
    """
    here = steadiness(rate, force, h)
    for factor, remedy in _UNITS:
        there = steadiness(rate * factor, force, h)
        scattered = factor < 1.0 and here < 0.8 and there > max(0.95, here + 0.2)
        swaying = factor > 1.0 and 1.0 - here > max(1e-4, 3.0 * (1.0 - there))
        if scattered or swaying:
            raise ValueError(
                f"{imu}_angle: turning the specific forces by these rates leaves {here:.4%} of "
                f"gravity standing, and {there:.4%} if they are {remedy} (or pass "
                "check_units=False)."
            )


_DEGREE = float(np.pi / 180.0)
_UNITS = (  # the mildest remedy that works is the right one: no rates at all do nearly as well
    (_DEGREE, "in °/s: convert them with numpy.radians"),
    (1.0 / 3600.0, "in °/h but taken for °/s: divide them by 3600"),
    (_DEGREE / 3600.0, "in °/h: convert them with numpy.radians(...) / 3600"),
    (1.0 / _DEGREE, "in rad/s but taken for °/s: multiply them by 180/π"),
    (3600.0, "in °/s but taken for °/h: multiply them by 3600"),
    (3600.0 / _DEGREE, "in rad/s but taken for °/h: multiply them by 3600 · 180/π"),
)


def steadiness(rate: Array, force: Array, interval: float, seconds: float = 20.0) -> float:
    """Length of the mean specific force in inertial space over the mean length, 0 to 1.

    Args:
        rate: (T, 3) rad/s.
        force: (T, 3) m/s².
        interval: s between samples.
        seconds: how much of the recording to use.
    """
    count = min(len(rate), max(int(seconds / interval), 10))
    turned = turning(rate[:count] * interval).apply(force[:count])
    used = np.linalg.norm(force[:count], axis=1).sum()
    return float(np.linalg.norm(turned.sum(axis=0)) / max(used, 1e-300))


def turning(angle: Array) -> Rotation:
    """Attitude after each of the angle increments (T, 3) rad, in the axes before the first, (T,).

    Products of all leading increments at once, by doubling: log2 T passes over the series.
    """
    found = Rotation.from_rotvec(angle).as_quat()
    reach = 1
    while reach < len(found):
        before, after = (Rotation.from_quat(q) for q in (found[:-reach], found[reach:]))
        found[reach:] = (before * after).as_quat()
        reach *= 2
    return Rotation.from_quat(found)
