"""What an inertial recording holds, in words."""

from __future__ import annotations

import numpy as np

from navgym.ins.plausible import axes, clocks, concerns
from navgym.ins.recording import InertialRecording


def told(recording: InertialRecording) -> list[tuple[str, str]]:
    """Lines with a name each: what is measured, what is known, what a filter would believe."""
    r, parts = recording, []
    for name, sensor in r.aiding.items():
        if len(sensor):
            usual = np.median(np.diff(sensor.time)) if len(sensor) > 1 else np.nan
            parts.append(f"{name} every {usual:.3g} s, {sensor.lost.mean():.1%} lost")
    rate = f"{1.0 / r.interval:.4g} samples/s, {r.gaps.mean():.1%} lost; {1.0 / r.step:.4g} filter steps/s"
    imu = r.model.grade
    believed = (
        f"gyros {imu.gyro_bias:g} °/h and {imu.gyro_noise:g} °/√h, accelerometers "
        f"{imu.accelerometer_bias:g} µg and {imu.accelerometer_noise:g} µg/√Hz"
    )
    truth = "none: judged by its innovations"
    if r.truth is not None:
        truth = f"reference for {np.isfinite(r.truth[:, 0]).mean():.1%} of the steps"
    known = r.meta.get("reading", ())  # a reader may have said some of it
    doubts = [*concerns(r), *axes(r), *clocks(r)]
    more = [("doubt", text) for text in doubts if text not in known]
    return [("IMU", rate), ("measured", ", ".join(parts) or "nothing else"), ("truth", truth), ("model", believed), *more]  # fmt: skip
