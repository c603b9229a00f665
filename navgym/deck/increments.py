"""What the flexure shows of itself: increments of the relative attitude of two IMUs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from navgym.core.checks import Array, one_of

FRAMES = ("inertial", "body")


def rodrigues(l: Array) -> Rotation:  # noqa: E741
    """Rotations C_is^im = (I − l×)⁻¹ (I + l×) of Rodrigues parameters (..., 3) (IDAM eq. 67)."""
    size = np.linalg.norm(l, axis=-1, keepdims=True)
    ratio = np.where(size > 1e-8, 2.0 * np.arctan(size) / np.where(size > 0.0, size, 1.0), 2.0)
    return Rotation.from_rotvec(ratio * l)


def increments_of(tape: NDArray[Any], alignment: Rotation, frame: str) -> Array:
    """`flexure_increments` of a tape (K,)."""
    one_of("frame", frame, FRAMES)
    main, sub = (Rotation.from_quat(np.array(tape[n]), scalar_first=True) for n in ("q_m", "q_s"))
    relative = main.inv() * alignment * sub
    if frame == "inertial":
        found = (relative[1:] * relative[:-1].inv()).as_rotvec()
    else:
        # δΘ_s − δΘ_m − δΘ_m × Φ̂, the sub's increment left in its own axes (IDAM eq. 13)
        turn_m, turn_s = ((c[:-1].inv() * c[1:]).as_rotvec() for c in (main, sub))
        found = turn_s - turn_m + np.cross(turn_m, -alignment.as_rotvec())
    found[(tape["gap"][1:] > 0) | (tape["gap"][:-1] > 0)] = np.nan
    increments: Array = found
    return increments
