"""The real tracks that INS filters are reported on: A-KIT with inertial data, or a simulated stand-in."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from navgym.ins.akit import read_akit_ins
from navgym.ins.recording import InertialRecording
from navgym.ins.scenarios import CALM, CATALOGUE, InsRegime
from navgym.ins.simulation import simulate

STAND_IN_SECONDS = 390.0
EARLIEST, LEFT = 100.0, 20.0  # s: before an outage, for biases; and after it
STREAM = 0x10  # first word of the seed sequences that outages are drawn from


def recording(folder: Path | None, track: int, rate: float, seed: int) -> InertialRecording:
    """A track under independent losses of its log and of fixes of 1 m, one per second.

    Args:
        folder: of the A-KIT data; None makes the simulated stand-in.
        track: its number.
        rate: share of lost measurements.
        seed: of noise and losses.
    """
    if folder is None:
        return stand_in(track, rate, seed)
    return read_akit_ins(folder, track=track, loss=rate, seed=seed, position_noise=1.0)


def outage(
    folder: Path | None, track: int, seed: int, *, length: float, imu_errors: str | None = None
) -> InertialRecording:
    """A track whose log is silent once, beginning anywhere, without position fixes.

    Args:
        folder: of the A-KIT data; None makes the simulated stand-in.
        track: its number.
        seed: of when it begins, and of the errors.
        length: s.
        imu_errors: grade of errors that are added to the recorded IMU; None: as recorded.
    """
    rng = np.random.default_rng(np.random.SeedSequence([STREAM, track, seed]))
    begin = float(rng.uniform(EARLIEST, STAND_IN_SECONDS - LEFT - length))
    silent = ((begin, length),)
    if folder is None:
        scenario = CATALOGUE["nominal"].override(
            duration=STAND_IN_SECONDS, outages=silent, fix_period=0.0, magnetometer_period=0.0,
            grade=imu_errors or "tactical", heading_deviation=0.5,
        )  # fmt: skip
        return simulate(scenario, [1000 * track + seed])[0]
    return read_akit_ins(folder, track=track, seed=seed, imu_errors=imu_errors, outages=silent)


def stand_in(track: int, rate: float, seed: int) -> InertialRecording:
    """A simulated mission for machines without real tracks; every track and seed has one of its own."""
    lossy = InsRegime(CALM.name, dvl_loss=rate, fix_loss=rate)
    scenario = CATALOGUE["nominal"].override(
        duration=STAND_IN_SECONDS, regimes=(lossy,), fix_period=1.0, fix_noise=(1.0, 1.0, 1.0), magnetometer_period=0.0,
        grade="tactical", heading_deviation=0.5,
    )  # fmt: skip
    return simulate(scenario, [1000 * track + seed])[0]
