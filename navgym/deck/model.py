"""What a deck filter believes: flexure, lever arm, and the errors of both IMUs."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array, positive_int, real_array, within
from navgym.core.frozen import Frozen
from navgym.inertial.earth import MICRO_G
from navgym.inertial.flexure import ARCMIN, FlexureModel
from navgym.inertial.imu import DEGREE_PER_HOUR, DEGREE_PER_ROOT_HOUR

PAPER_FLEXURE = FlexureModel.from_correlation_time(
    [10.0, 10.0, 30.0], np.array([6.0, 6.0, 10.0]) * ARCMIN
)  # IDAM section 5


@dataclass(frozen=True, eq=False)
class DeckModel(Frozen):
    """The model of the 24-state filter (IDAM eq. 73-78, corrected); IDAM section 5 by default.

    Standard deviations are of one axis. The frames are those of the recording's IMUs.

    Args:
        flexure: the dynamic deformation that the filter starts with.
        lever_arm: (3,) m, from the main to the sub IMU, in the main IMU's axes, undeformed.
        samples_per_step: IMU samples that make up one filter step.
        misalignment: std of half the relative attitude at the start (of the Rodrigues parameters l).
            The measurement equations are linear in l for any angle, so a wide prior costs nothing
            after the first seconds, and .3 covers any mounting up to some 60°.
        gyro_bias: std of the sub IMU's gyro bias, rad/s.
        accelerometer_bias: std of the sub IMU's accelerometer bias, m/s².
        gyro_noise: angle random walk, rad/√s.
        accelerometer_noise: velocity random walk, m/s/√s.
        rate_noise: noise of a difference of mean rates over one step, rad/s, beside what the
            flexure itself adds.

    Raises:
        ValueError: naming the field.
    """

    flexure: FlexureModel = PAPER_FLEXURE
    lever_arm: Any = (10.0, 10.0, 2.0)
    samples_per_step: int = 5
    misalignment: float = 0.3
    gyro_bias: float = 0.05 * DEGREE_PER_HOUR
    accelerometer_bias: float = 200.0 * MICRO_G
    gyro_noise: float = 0.001 * DEGREE_PER_ROOT_HOUR
    accelerometer_noise: float = 10.0 * MICRO_G
    rate_noise: float = 6e-6

    def __post_init__(self) -> None:
        lever = real_array("lever_arm", self.lever_arm)
        if lever.shape != (3,):
            raise ValueError(f"lever_arm must have shape (3,), in m, got {lever.shape}.")
        if np.abs(lever).max() > 1000.0:
            raise ValueError(f"lever_arm must be in m, got {lever}: no ship is that long.")
        if not isinstance(self.flexure, FlexureModel):
            raise TypeError(f"flexure must be a navgym.FlexureModel, got {type(self.flexure)}.")
        positive_int("samples_per_step", self.samples_per_step)
        for name in _POSITIVE:
            within(name, getattr(self, name), 0.0, above=True)
        self._freeze({"lever_arm": lever})

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The model as named arrays, for files."""
        found = {
            f.name: np.asarray(getattr(self, f.name)) for f in fields(self) if f.name != "flexure"
        }
        for name in ("damping", "stiffness", "sigma"):
            found[f"flexure.{name}"] = getattr(self.flexure, name)
        return found

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> DeckModel:
        """The inverse of `arrays`; ValueError where one is missing (defaults would hide it)."""
        missing = sorted(set(cls().arrays()) - set(arrays))
        if missing:
            raise ValueError(f"the model lacks {', '.join(missing)}")
        values: dict[str, Any] = {
            k: v if v.ndim else v.item() for k, v in arrays.items() if "." not in k
        }
        flexure: dict[str, Any] = {
            k.removeprefix("flexure."): v for k, v in arrays.items() if "." in k
        }
        return cls(flexure=FlexureModel(**flexure), **values)


_POSITIVE = (
    "misalignment", "gyro_bias", "accelerometer_bias", "gyro_noise", "accelerometer_noise",
    "rate_noise",
)  # fmt: skip


def lever_matrix(lever_arm: Array) -> Array:
    """L0 of IDAM eq. 56: θ × r0 = L0 θ."""
    x, y, z = lever_arm
    return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
