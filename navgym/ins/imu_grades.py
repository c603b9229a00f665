"""IMUs by grade, by data sheet or by Allan numbers: what is believed of one, and what is simulated."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from navgym.core.checks import within
from navgym.inertial.earth import MICRO_G
from navgym.inertial.imu import DEGREE_PER_HOUR, DEGREE_PER_ROOT_HOUR

HOUR = 3600.0
# of flicker noise, the lowest Allan deviation is √(2 ln2/π) times its coefficient B (IEEE Std 952)
LOWEST_OF_FLICKER = 0.664


@dataclass(frozen=True)
class ImuGrade:
    """How good an IMU is, as data sheets say it; one sigma.

    Args:
        gyro_bias: turn-on bias of a gyro, °/h.
        gyro_noise: angle random walk, °/√h.
        accelerometer_bias: turn-on bias of an accelerometer, µg.
        accelerometer_noise: velocity random walk, µg/√Hz.
        gyro_drift: by how much a gyro's bias wanders in an hour, °/h.
        accelerometer_drift: by how much an accelerometer's bias wanders in an hour, µg.
    """

    gyro_bias: float
    gyro_noise: float
    accelerometer_bias: float
    accelerometer_noise: float
    gyro_drift: float = 0.0
    accelerometer_drift: float = 0.0

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):
            noise = f.name.endswith("_noise")
            within(f.name, getattr(self, f.name), 0.0, above=noise)

    @classmethod
    def from_allan(
        cls,
        gyro_noise: float,
        gyro_lowest: float,
        accelerometer_noise: float,
        accelerometer_lowest: float,
        gyro_bias: float | None = None,
        accelerometer_bias: float | None = None,
    ) -> ImuGrade:
        """The grade of an IMU whose Allan deviations are known.

        The bias instability is modelled as a random walk that reaches the flicker coefficient, lowest
        deviation / .664, within an hour.

        Args:
            gyro_noise: Allan deviation at 1 s on the slope −½, as °/√h.
            gyro_lowest: lowest Allan deviation of a gyro, °/h.
            accelerometer_noise: the same of an accelerometer at 1 s, µg/√Hz.
            accelerometer_lowest: µg.
            gyro_bias: turn-on bias, °/h; ten times the lowest deviation by default.
            accelerometer_bias: µg; likewise.
        """
        return cls(
            10.0 * gyro_lowest if gyro_bias is None else gyro_bias,
            gyro_noise,
            10.0 * accelerometer_lowest if accelerometer_bias is None else accelerometer_bias,
            accelerometer_noise,
            gyro_lowest / LOWEST_OF_FLICKER,
            accelerometer_lowest / LOWEST_OF_FLICKER,
        )

    @property
    def si(self) -> tuple[float, ...]:
        """rad/s, rad/√s, m/s², m/s/√s, rad/s/√s, m/s²/√s."""
        return (
            self.gyro_bias * DEGREE_PER_HOUR,
            self.gyro_noise * DEGREE_PER_ROOT_HOUR,
            self.accelerometer_bias * MICRO_G,
            self.accelerometer_noise * MICRO_G,
            self.gyro_drift * DEGREE_PER_HOUR / math.sqrt(HOUR),
            self.accelerometer_drift * MICRO_G / math.sqrt(HOUR),
        )


GRADES: Mapping[str, ImuGrade] = MappingProxyType(
    {
        "navigation": ImuGrade(0.01, 0.002, 50.0, 10.0, 0.001, 5.0),
        "tactical": ImuGrade(1.0, 0.1, 500.0, 50.0, 0.1, 50.0),
        "mems": ImuGrade(50.0, 0.3, 3000.0, 100.0, 5.0, 300.0),
    }
)
