"""Rules that know the truth of an INS recording: bounds on what can stand in for a lost Doppler log.

What the last velocity is worth depends on how far the vehicle's own has gone from it since, which nobody on
board knows. Settings are those that are best on 24 training missions of ins/outage and ins/burst.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from navgym.core.checks import Array
from navgym.ins import spaces
from navgym.ins.layout import PHI, V
from navgym.ins.recording import InertialRecording

NEAR = 0.1  # m/s: the gate holds up to here
HELD = 0.03  # m²/s², what the gate holds with
# a held velocity errs for minutes the same way, and is taken once per second
CORRELATED = 100.0
BELIEVED: dict[str, Any] = {
    "imu_noise_scale": 1.0, "fill_growth": spaces.FILL_GROWTH.low,
}  # fmt: skip


def change(recording: InertialRecording) -> Array:
    """(K,) m/s, how far the true horizontal body velocity is from where it was when the log last spoke.

    NaN before it has, and where the truth is not known. Raises ValueError for a recording without truth.
    """
    truth, steps = recording.truth, recording.steps
    if truth is None:
        raise ValueError("an oracle needs recordings with truth: set truth=.")
    known = np.isfinite(truth[:, : PHI.stop]).all(axis=1)
    body = np.full((steps, 3), np.nan)
    turned = Rotation.from_euler("ZYX", truth[known, PHI][:, ::-1])
    body[known] = turned.inv().apply(truth[known, V])
    log = recording.aiding["dvl"]
    heard = np.searchsorted(recording.step_time, log.time[~log.lost] - 1e-6)
    heard = heard[heard < steps]
    last = np.full(steps, -1)
    last[heard] = heard
    last = np.maximum.accumulate(last)
    found: Array = np.linalg.norm((body - body[last])[:, :2], axis=1)
    return np.where(last < 0, np.nan, found)


def gate(recording: InertialRecording) -> dict[str, Any]:
    """Hold only while the true body velocity is within `NEAR` of the last measured one."""
    near = change(recording) < NEAR
    return {**BELIEVED, "fill": np.where(near, 1, 0), "fill_variance": HELD}


def variance(recording: InertialRecording) -> dict[str, Any]:
    """Hold with a variance of `CORRELATED` times the square that each axis has gone; nothing where unknown."""
    p = spaces.FILL_VARIANCE
    each = 0.5 * CORRELATED * np.nan_to_num(change(recording), nan=np.inf) ** 2
    return {**BELIEVED, "fill": 1, "fill_variance": np.clip(each, p.low, p.high)}
