"""What a recording of two IMUs holds, in words."""

from __future__ import annotations

import numpy as np

from navgym.deck.recording import DualIMURecording


def told(recording: DualIMURecording) -> list[tuple[str, str]]:
    """Lines with a name each: what is measured, what is known, what a filter would believe."""
    model, parts = recording.model, []
    for unit in ("main", "sub"):
        for sensor, kind in (("gyro", "angle"), ("acc", "velocity")):
            lost = np.isnan(getattr(recording, f"{unit}_{kind}")).any(axis=1).mean()
            parts.append(f"{unit} {sensor} {lost:.1%}")
    found = "none" if recording.attitude is None and recording.theta is None else "in the log"
    lever = ", ".join(f"{x:g}" for x in model.lever_arm)
    rate = f"{1.0 / recording.interval:.4g} samples/s, {1.0 / recording.step:.4g} filter steps/s"
    return [
        ("lost", ", ".join(parts)),
        ("truth", f"reference attitude: {found}"),
        ("model", f"lever arm {lever} m; {rate}"),
    ]
