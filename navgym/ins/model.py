"""What an INS filter believes: its IMU, its sensors, and how well it knows where it starts."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import one_of, positive_int, real_array, shaped, within
from navgym.core.frozen import Frozen
from navgym.inertial.blocks import SENSORS
from navgym.ins.imu_grades import GRADES, ImuGrade
from navgym.ins.kinds import KINDS, NAMES

LONGEST_LEVER = 100.0  # m: no vehicle is that long


@dataclass(frozen=True, eq=False)
class AidingModel(Frozen):
    """One aiding sensor as a filter believes it.

    Args:
        kind: "dvl", "depth", "fix", "magnetometer", "heading" or "water".
        noise: standard deviation of each of its numbers; one number stands for all.
        lever_arm: (3,) m, from the IMU to the sensor, body axes (forward, starboard, down).
        latency: s between a measurement's moment and its arrival.
    """

    kind: str
    noise: Any
    lever_arm: Any = (0.0, 0.0, 0.0)
    latency: float = 0.0

    def __post_init__(self) -> None:
        rows = KINDS[NAMES.index(one_of("kind of sensor", self.kind, NAMES))].rows
        noise = real_array("noise", self.noise)
        noise = np.repeat(noise, rows) if noise.shape in ((), (1,)) else noise
        shaped(f"noise of a {self.kind}", noise, (rows,), "a standard deviation per number")
        if (noise <= 0.0).any():
            raise ValueError(f"noise of a {self.kind} must be positive, got {noise}.")
        lever = real_array("lever_arm", self.lever_arm)
        shaped("lever_arm", lever, (3,), "m, body axes")
        if np.abs(lever).max() > LONGEST_LEVER:
            raise ValueError(f"lever_arm must be in m, got {lever}: no vehicle is that long.")
        within("latency", self.latency, 0.0, 60.0)
        self._freeze({"noise": noise, "lever_arm": lever})

    @property
    def rows(self) -> int:
        """Numbers per measurement."""
        return len(self.noise)


@dataclass(frozen=True, eq=False)
class InsModel(Frozen):
    """What an INS filter believes. Standard deviations are of one axis.

    Args:
        latitude: where the filter starts, rad.
        longitude: rad.
        height: m above the ellipsoid.
        origin: latitude, longitude (rad) and height (m) that positions count from; the start by default.
        velocity: (3,) at the start, north, east, down, m/s.
        attitude: (3,) roll, pitch, heading at the start, rad.
        imu: grade of the IMU, or its name: "navigation", "tactical", "mems".
        sensors: aiding sensors by name.
        samples_per_step: IMU samples that make up one filter step.
        position_deviation: of the start, m.
        velocity_deviation: m/s.
        tilt_deviation: of roll and pitch, rad.
        heading_deviation: rad.
        magnetic_field: (3,) north, east, down, µT.
        hard_iron: std of a magnetometer's hard iron, µT; 0: the state is off.
        dvl_scale: std of the Doppler log's scale error; 0: off.
        dvl_misalignment: std of its misalignment about the vertical, rad; 0: off.
        current: std of a current's components, m/s; 0: off. A water track needs it.
        current_time: in which a current forgets itself, s.

    Raises:
        ValueError: naming the field.
    """

    latitude: float = 0.57
    longitude: float = 0.61
    height: float = 0.0
    origin: Any = None
    velocity: Any = (0.0, 0.0, 0.0)
    attitude: Any = (0.0, 0.0, 0.0)
    imu: ImuGrade | str = "mems"
    sensors: Mapping[str, AidingModel] = field(default_factory=dict)
    samples_per_step: int = 20
    position_deviation: float = 1.0
    velocity_deviation: float = 0.1
    tilt_deviation: float = 0.01
    heading_deviation: float = 0.05
    magnetic_field: Any = (29.4, 2.3, 33.5)
    hard_iron: float = 1.5
    dvl_scale: float = 0.003
    dvl_misalignment: float = 0.005
    current: float = 0.0
    current_time: float = 1800.0

    def __post_init__(self) -> None:
        grade = self.imu
        if isinstance(grade, str):
            grade = GRADES[one_of("grade of IMU", grade, GRADES)]
        if not isinstance(grade, ImuGrade):
            raise TypeError(f"imu must be an ImuGrade or its name, got {grade!r}.")
        within("latitude", self.latitude, -1.55, 1.55)
        within("longitude", self.longitude, -2.0 * np.pi, 2.0 * np.pi)
        within("height", self.height, -12e3, 12e3)
        positive_int("samples_per_step", self.samples_per_step)
        origin = (self.latitude, self.longitude, self.height)
        arrays: dict[str, Any] = {"imu": grade}
        arrays["origin"] = real_array("origin", origin if self.origin is None else self.origin)
        shaped("origin", arrays["origin"], (3,), "latitude, longitude, height")
        for name in ("velocity", "attitude", "magnetic_field"):
            arrays[name] = real_array(name, getattr(self, name))
            shaped(name, arrays[name], (3,), "three numbers")
        for name in _DEVIATIONS:
            within(name, getattr(self, name), 0.0)
        within("current_time", self.current_time, 0.0, above=True)
        sensors = dict(self.sensors)
        if len(sensors) > SENSORS:
            raise ValueError(f"sensors must be at most {SENSORS}, got {len(sensors)}.")
        for name, sensor in sensors.items():
            if not isinstance(sensor, AidingModel):
                raise TypeError(f"sensors[{name!r}] must be an AidingModel, got {sensor!r}.")
        self._freeze(arrays | {"sensors": sensors})

    @property
    def grade(self) -> ImuGrade:
        """Grade of the IMU."""
        assert isinstance(self.imu, ImuGrade)
        return self.imu

    def replace(self, **fields: Any) -> InsModel:
        """The same model with some fields changed."""
        return dataclasses.replace(self, **fields)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The model as named arrays, for files."""
        found = {n: np.asarray(getattr(self, n)) for n in _PLAIN}
        for f in dataclasses.fields(ImuGrade):
            found[f"imu.{f.name}"] = np.asarray(getattr(self.imu, f.name))
        for name, sensor in self.sensors.items():
            for key in ("kind", "noise", "lever_arm", "latency"):
                found[f"sensor.{name}.{key}"] = np.asarray(getattr(sensor, key))
        return found

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> InsModel:
        """The inverse of `arrays`; ValueError where one is missing (defaults would hide it)."""
        missing = sorted(set(cls().arrays()) - set(arrays))
        if missing:
            raise ValueError(f"the model lacks {', '.join(missing)}")
        plain: dict[str, Any] = {n: _value(arrays[n]) for n in _PLAIN}
        grade = {k.removeprefix("imu."): float(v) for k, v in arrays.items() if k[:4] == "imu."}
        parts: dict[str, dict[str, Any]] = {}
        for key, value in arrays.items():
            if key.startswith("sensor."):
                name, _, what = key.removeprefix("sensor.").rpartition(".")
                parts.setdefault(name, {})[what] = _value(value)
        sensors = {name: AidingModel(**each) for name, each in parts.items()}
        return cls(**plain, imu=ImuGrade(**grade), sensors=sensors)


def _value(array: NDArray[Any]) -> Any:
    return array if array.ndim else array.item()


_DEVIATIONS = (
    "position_deviation", "velocity_deviation", "tilt_deviation", "heading_deviation", "hard_iron",
    "dvl_scale", "dvl_misalignment", "current",
)  # fmt: skip
_PLAIN = (
    "latitude", "longitude", "height", "origin", "velocity", "attitude", "samples_per_step", "magnetic_field",
    "current_time", *_DEVIATIONS,
)  # fmt: skip
