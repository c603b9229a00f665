"""What the flexure shows of itself: increments of the relative attitude of two IMUs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from navgym._checks import Array, one_of
from navgym.dual_imu import DualIMURecording
from navgym.filters.mechanization import TAPE, coarse_alignment, write_tape

FRAMES = ("inertial", "body")


def flexure_increments(
    recording: DualIMURecording, alignment: Rotation | None = None, frame: str = "inertial"
) -> Array:
    """Increments of θ over each filter step, (K - 1, 3) rad, in the main IMU's axes.

    Args:
        recording: of both IMUs.
        alignment: attitude of the sub in the main IMU's axes at the start, Ĉ_is^im; by default the
            one that the `alignment` filter arrives at over the recording.
        frame: "inertial" differences C_s^m = C_im^m Ĉ_is^im C_s^is; "body" is the printed form
            (IDAM eq. 13-16), which leaves δΘ × θ in and locks on to the sway.

    Returns:
        Increments; NaN in steps with samples that were not received. An increment spans
        `recording.step` seconds.
    """
    tape = np.zeros(recording.steps, TAPE)
    write_tape(recording, tape)
    if alignment is None:
        alignment = final_alignment(recording)
    return increments_of(tape, alignment, frame)


def final_alignment(recording: DualIMURecording) -> Rotation:
    """Ĉ_is^im at the end of a run of `alignment` from the coarse alignment on."""
    from navgym.deck_estimation import estimate_deck

    states = estimate_deck("alignment", recording).states
    return (
        rodrigues(states[-1, :3]) if np.isfinite(states[-1]).all() else coarse_alignment(recording)
    )


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
