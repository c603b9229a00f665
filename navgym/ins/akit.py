"""A-KIT's tracks of the Snapir AUV with their inertial data, for an INS filter (github.com/ansfl/A-KIT)."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path as File
from typing import Any

import numpy as np

from navgym.core.checks import Array, one_of, positive_int, within
from navgym.core.seeds import split_of
from navgym.core.tables import Table, read_table
from navgym.ins.alignment import Clocks, Path, align
from navgym.ins.imu_grades import GRADES, ImuGrade
from navgym.ins.layout import STATES
from navgym.ins.model import AidingModel, InsModel
from navgym.ins.recording import Aiding, InertialRecording
from navgym.ins.simulation import add_imu_errors, local

STREAM = 0xE1  # first word of an A-KIT INS recording's seed sequence
# what is believed of the vehicle's IMU, whose data are quantised to 1e-4 rad/s and m/s²
SNAPIR = ImuGrade(0.5, 0.02, 300.0, 30.0, 0.1, 30.0)
START: dict[str, Any] = {  # standard deviations of the start, which is taken from the reference
    "position_deviation": 0.1, "velocity_deviation": 0.05, "tilt_deviation": math.radians(0.2),
    "heading_deviation": math.radians(0.5),
}  # fmt: skip
DVL_NOISE = (0.02, 0.02, 0.01)  # m/s, about what is left of its body velocities on these tracks


def read_akit_ins(
    path: str | os.PathLike[str],
    *,
    track: int = 1,
    seed: int = 0,
    align_clocks: bool = True,
    imu_errors: str | None = None,
    outages: Sequence[tuple[float, float]] = (),
    position_noise: float | None = None,
    loss: float = 0.0,
    depth_noise: float = 0.05,
) -> InertialRecording:
    """A voyage of the Snapir AUV: recorded IMU (100 Hz) and Doppler log (1 Hz), depth from the reference.

    The y axes of the published accelerometers and gyros are turned over: against the reference they have
    the wrong sign. The published times of log and reference are 400 samples laid evenly over 400 s: a second
    of theirs is 399/400 s of the IMU's, which alone moves one against the other by a second over a track.
    Their clocks also differ by a constant, and the reference point is not where the IMU is. `align_clocks` finds all of it in the data and takes it out, and `meta["alignment"]` says what they are.
    The truth is the reference at the IMU's place and time; the filter starts from it.

    Args:
        path: the published Data folder, or any that holds IMU_, DVL_ and GT_trajectoryN.csv.
        track: N.
        seed: of what is simulated; take it from `navgym.seeds`.
        align_clocks: False leaves the clocks as published and the IMU at the reference point.
        imu_errors: grade of the errors that are added to the recorded IMU: "mems", "tactical" or
            "navigation"; the model then believes that grade.
        outages: (begin, length), s from the start, in which the Doppler log is lost.
        position_noise: m, of a position fix per second made from the reference; None: none.
        loss: share of Doppler velocities and of fixes that are lost at random, each on its own.
        depth_noise: m, of a depth per second made from the reference.

    Raises:
        FileNotFoundError: the folder lacks a file of the track.
        ValueError: files that are not in the published layout, or an option out of range.

    Source: A-KIT, github.com/ansfl/A-KIT (N. Cohen and I. Klein, arXiv:2401.09987). The inertial data are
    of the data set's first upload. It states no licence: navgym does not ship its data.
    """
    split_of(seed)
    positive_int("track", track)
    within("loss", loss, 0.0, 1.0)
    within("depth_noise", depth_noise, 0.0, above=True)
    imu, dvl, reference = (_table(File(path), kind, track) for kind in ("IMU", "DVL", "GT"))
    clock, time = imu.increasing("Time [s]"), dvl.increasing("Time [s]")
    rate = imu.matrix(("GYRO X [rad/s]", "GYRO Y [rad/s]", "GYRO Z [rad/s]")) * [1.0, -1.0, 1.0]
    force = imu.matrix(("ACC X [m/s^2]", "ACC Y [m/s^2]", "ACC Z [m/s^2]")) * [1.0, -1.0, 1.0]
    body = dvl.matrix(("DVL X [m/s]", "DVL Y [m/s]", "DVL Z [m/s]"))
    known, origin = _path(reference)
    found = align(known, clock, rate, time, body) if align_clocks else Clocks(1.0, 0.0, 0.0, np.zeros(3), math.nan, np.full(3, math.nan))  # fmt: skip
    delay, arm = found.imu_delay, found.lever_arm
    known, time = known.stretched(found.clock_rate), found.clock_rate * time
    # the first IMU sample for which there is a reference
    first = int(np.searchsorted(clock, max(known.time[0] - delay, clock[0]) + 1e-9))
    clock, rate, force = clock[first:], rate[first:], force[first:]
    h = float(np.median(np.diff(clock)))
    begin = clock[0] - h
    start = known.states(np.array([max(begin + delay, known.time[0])]), arm)[0]
    words = np.random.SeedSequence([STREAM, track, seed]).spawn(4)
    rngs = [np.random.default_rng(w) for w in words]
    grade = SNAPIR
    angle, velocity = rate * h, force * h
    if imu_errors is not None:
        grade = GRADES[one_of("grade of IMU", imu_errors, GRADES)]
        add_imu_errors(angle, velocity, grade, h, np.ones(len(clock)), rngs[0])
    time = time + found.dvl_delay - delay  # on the IMU's clock
    lost = rngs[1].random(len(time)) < loss
    for after, length in outages:
        lost |= (time >= begin + after) & (time < begin + after + length)
    sensors = {"dvl": AidingModel("dvl", DVL_NOISE), "depth": AidingModel("depth", depth_noise)}
    at = known.time - delay
    exact = known.states(known.time, arm)
    noise = depth_noise * rngs[2].standard_normal(len(at))
    aiding = {
        "dvl": Aiding(time, body, lost),
        "depth": Aiding(at, exact[:, 2] + noise),
    }
    if position_noise is not None:
        within("position_noise", position_noise, 0.0, above=True)
        sensors["fix"] = AidingModel("fix", position_noise)
        fixes = exact[:, :3] + position_noise * rngs[3].standard_normal((len(at), 3))
        aiding["fix"] = Aiding(at, fixes, rngs[3].random(len(at)) < loss)
    metres = local(np.array([[origin[0] + 1e-6, origin[1] + 1e-6, origin[2]]]), origin)[0] / 1e-6
    model = InsModel(
        latitude=float(origin[0] + start[0] / metres[0]),
        longitude=float(origin[1] + start[1] / metres[1]),
        height=float(origin[2] - start[2]),
        origin=origin,
        velocity=start[3:6],
        attitude=start[6:],
        imu=grade,
        sensors=sensors,
        dvl_scale=0.005,
        dvl_misalignment=math.radians(0.5),
        **START,
    )
    count = len(clock) // model.samples_per_step
    ends = clock[model.samples_per_step - 1 :: model.samples_per_step][:count]
    truth = np.full((count, STATES), np.nan)
    truth[:, :9] = known.states(ends + delay, arm)
    meta: dict[str, Any] = {"format": "akit_ins", "source": "github.com/ansfl/A-KIT", "track": track, "seed": int(seed)}  # fmt: skip
    told = {"alignment": found.as_dict()} if align_clocks else {}
    return InertialRecording(
        clock, angle, velocity, aiding=aiding, model=model, truth=truth, meta=meta | told | {"turned": "y axes of the IMU"}
    )  # fmt: skip


def _table(folder: File, kind: str, track: int) -> Table:
    """The track's file, in the folder itself or in TrajectoryN as published."""
    name = f"{kind}_trajectory{track}.csv"
    for file in (folder / name, folder / f"Trajectory{track}" / name):
        if file.exists():
            return read_table(file)
    held = sorted(p.name for p in folder.glob(f"**/{kind}_trajectory*.csv"))
    raise FileNotFoundError(
        f"{folder} holds no {name}; it holds {', '.join(held) or 'none of that kind'}. Inertial data are in "
        "the first upload of github.com/ansfl/A-KIT only."
    )


def _path(table: Table) -> tuple[Path, Array]:
    """The reference in NED of its first sample, and that sample's latitude, longitude, height."""
    places = table.matrix(("Latitude [rad]", "Longitude [rad]", "Altitude [m]"))
    origin = places[0]
    velocity = table.matrix(("V North [m/s]", "V East [m/s]", "V Down [m/s]"))
    angles = table.matrix(("Roll [rad]", "Pitch [rad]", "Yaw [rad]"))
    return Path(table.increasing("Time [s]"), local(places, origin), velocity, angles), origin
