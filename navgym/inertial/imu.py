"""What is wrong with an IMU, and the units that its makers say it in."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from navgym.core.checks import within
from navgym.inertial.earth import MICRO_G

DEGREE_PER_HOUR = np.pi / 180.0 / 3600.0  # rad/s
DEGREE_PER_ROOT_HOUR = np.pi / 180.0 / 60.0  # rad/√s


@dataclass(frozen=True)
class ImuErrors:
    """One-sigma errors of an IMU, drawn anew for each recording (IDAM section 5).

    Args:
        gyro_bias: °/h.
        gyro_noise: angle random walk, °/√h.
        accelerometer_bias: µg.
        accelerometer_noise: velocity random walk, µg/√Hz.
        scale_factor: ppm.
        installation: arcsec, of the gyros and of the accelerometers, each on their own.
    """

    gyro_bias: float = 0.01
    gyro_noise: float = 0.001
    accelerometer_bias: float = 50.0
    accelerometer_noise: float = 10.0
    scale_factor: float = 5.0
    installation: float = 5.0

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):
            within(f.name, getattr(self, f.name), 0.0)

    def scaled(self, factor: float) -> ImuErrors:
        """The errors of an IMU that is `factor` times as bad."""
        return ImuErrors(*(factor * getattr(self, f.name) for f in dataclasses.fields(self)))

    @property
    def si(self) -> tuple[float, ...]:
        """In SI units: rad/s, rad/√s, m/s², m/s/√s, 1, rad."""
        return (
            self.gyro_bias * DEGREE_PER_HOUR,
            self.gyro_noise * DEGREE_PER_ROOT_HOUR,
            self.accelerometer_bias * MICRO_G,
            self.accelerometer_noise * MICRO_G,
            self.scale_factor * 1e-6,
            self.installation / 3600.0 * np.pi / 180.0,
        )


NO_ERRORS = ImuErrors(*[0.0] * 6)
