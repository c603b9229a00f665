"""A-KIT: real tracks of the Snapir AUV (github.com/ansfl/A-KIT)."""

from __future__ import annotations

import math
import os
import re
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from navgym.auv.alignment import Alignment, Reference, align_reference, aligned
from navgym.auv.scenarios import Loss
from navgym.auv.simulation import draw_losses
from navgym.core.checks import Array, positive_int, within
from navgym.core.seeds import split_of
from navgym.core.tables import Table, read_table
from navgym.inertial.earth import radii_of_curvature
from navgym.statespace.models import LinearModel, step_of
from navgym.statespace.recording import Recording

KEPT = 16  # tracks that are kept for further draws of noise
STREAM = 0xA1  # first word of an A-KIT recording's seed sequence; the AUV simulator's is 0xA0


def read_akit(
    path: str | os.PathLike[str],
    *,
    track: int | None = None,
    loss: Loss | float = 0.0,
    seed: int = 0,
    position_noise: float = 1.0,
    align: bool = False,
    model: LinearModel | None = None,
) -> Recording:
    """A voyage of the Snapir AUV: real DVL velocity, position fixes made from the reference.

    The state is [Px, Vx, Py, Vy] = north, north velocity, east, east velocity (m, m/s) in the
    tangent plane at the first reference sample. A position fix is the reference plus
    N(0, position_noise²). A velocity is the DVL's body velocity turned to north-east-down by the
    recorded roll, pitch and yaw. The truth is the reference. Its first sample gives x0 and no
    measurement, since x0 and P0 hold one step before the first measurement.

    As published, the reference is late against the DVL (1.4 to 1.5 s; .5 to .6 s on tracks 5 and 6)
    and the DVL is 1.8 to 1.9 m aft of the reference point, which is most of a filter's error on
    these tracks. `align` estimates both from the track and takes them out: the reference is read
    between its samples at the DVL's instants, the DVL's velocity is moved to the reference point.

    Args:
        path: the published Data folder, or any that holds DVL_trajectoryN.csv, GT_trajectoryN.csv; or
            one of these files, whose track it is.
        track: N; 1 by default, or the file's.
        loss: a `navgym.auv.scenarios.Loss`, or the rate of independent losses.
        seed: of noise and losses; take it from `navgym.seeds`. Each has a stream of its own, so
            that another loss leaves the noise as it was.
        position_noise: standard deviation of a position fix, m; the default model knows it.
        align: whether to estimate delay and lever arm of the reference and take them out;
            `meta["alignment"]` then reports them (`navgym.auv.alignment.Alignment`).
        model: a linear model of these four states. By default all four are measured with
            R = diag(position_noise², .1², position_noise², .1²), Q = .1² G Gᵀ
            (`LinearModel.white_acceleration`), x0 is the reference's first state and P0 = I.

    Raises:
        FileNotFoundError: the folder lacks the track.
        ValueError: files that are not in the published layout, an option out of range, or a track
            that does not tell its alignment.

    Source: A-KIT, github.com/ansfl/A-KIT (N. Cohen and I. Klein, Adaptive Kalman-Informed
    Transformer, arXiv:2401.09987). It states no licence: navgym does not ship its data.
    """
    lossy = loss if isinstance(loss, Loss) else Loss(float(loss))
    split_of(seed)
    within("position_noise", position_noise, 0.0, above=True)
    if not isinstance(align, bool):
        raise ValueError(f"align must be True or False, got {align!r}.")  # noqa: TRY004
    folder, track = _told_track(Path(path), track)
    reference, body = _akit_track(folder, track)
    found = align_reference(reference, reference.time, body) if align else None
    time, truth, dvl = _of_one_instant(reference, body, found)
    if model is None:
        dt = step_of(np.diff(time))
        model = LinearModel.white_acceleration(dt, position_noise=position_noise, x0=truth[0])
    time, truth, dvl = time[1:], truth[1:], dvl[1:]
    words = np.random.SeedSequence([STREAM, track, seed])
    noise, losses = (np.random.default_rng(s) for s in words.spawn(2))
    sensed = truth.copy()
    sensed[:, [0, 2]] += position_noise * noise.standard_normal((len(time), 2))
    sensed[:, [1, 3]] = dvl
    meta = {"track": track, "seed": int(seed), "position_noise": float(position_noise)}
    told = {} if found is None else {"alignment": found.as_dict()}
    return Recording(
        time=time,
        measurements=np.einsum("...ij,...j->...i", _rows_of_four(model), sensed),
        lost=draw_losses(lossy, [lossy], np.zeros(len(time), np.int64), model.m, losses),
        truth=truth,
        model=model,
        meta={"format": "akit", "source": "github.com/ansfl/A-KIT", "loss": asdict(lossy)}
        | meta
        | told,
    )


def _told_track(path: Path, track: int | None) -> tuple[Path, int]:
    """The folder and the track that are meant; ValueError for a file that is not of that track."""
    named = re.fullmatch(r"(?:GT|DVL|IMU)_trajectory(\d+)\.csv", path.name)
    if named is None or path.is_dir():
        return path, positive_int("track", 1 if track is None else track)
    own = int(named[1])
    if track not in (None, own):
        raise ValueError(f"{path.name} is of track {own}, got track={track}: leave track out.")
    return path.parent, own


def _akit_track(folder: Path, track: int) -> tuple[Reference, Array]:
    """The reference, and the DVL's body velocity (T, 3) at the same times of its own clock."""
    files = [_akit_file(folder, kind, track) for kind in ("GT", "DVL")]
    return _read_track(*files, *((f.stat().st_mtime_ns, f.stat().st_size) for f in files))


@lru_cache(maxsize=KEPT)
def _read_track(truth: Path, sensor: Path, *_stamps: tuple[int, int]) -> tuple[Reference, Array]:
    """The same of two files, which are read once for all draws of noise; changed ones are read again."""
    reference, dvl = read_table(truth), read_table(sensor)
    time = reference.increasing("Time [s]")
    if len(time) < 2 or not np.array_equal(time, dvl.increasing("Time [s]")):
        raise ValueError(
            f"{reference.path.name} and {dvl.path.name} must hold the same times, at least two: "
            f"they have {len(time)} and {len(dvl.lines)} rows. Use the files as published."
        )
    position = np.stack(_tangent_plane(reference), axis=-1)
    velocity = reference.matrix(("V North [m/s]", "V East [m/s]", "V Down [m/s]"))
    angles = reference.matrix(("Yaw [rad]", "Pitch [rad]", "Roll [rad]"))
    body = dvl.matrix(("DVL X [m/s]", "DVL Y [m/s]", "DVL Z [m/s]"))
    return Reference(time, position, velocity, Rotation.from_euler("ZYX", angles)), body


def _of_one_instant(
    reference: Reference, body: Array, alignment: Alignment | None
) -> tuple[Array, Array, Array]:
    """Time (K,), reference states (K, 4), and DVL velocity north and east (K, 2)."""
    if alignment is not None:
        return aligned(reference, reference.time, body, alignment)
    p, v = reference.position, reference.velocity
    states = np.stack([p[:, 0], v[:, 0], p[:, 1], v[:, 1]], axis=-1)
    return reference.time, states, reference.attitude.apply(body)[:, :2]


def _akit_file(folder: Path, kind: str, track: int) -> Path:
    """The track's file, in the folder itself or in TrajectoryN as published."""
    name = f"{kind}_trajectory{track}.csv"
    for file in (folder / name, folder / f"Trajectory{track}" / name):
        if file.exists():
            return file
    held = sorted(p.name for p in folder.glob("**/GT_trajectory*.csv"))
    raise FileNotFoundError(
        f"{folder} holds no {name}; its tracks: {', '.join(held) or 'none'}. Clone "
        "github.com/ansfl/A-KIT and name its Data folder, or check track=."
    )


def _tangent_plane(reference: Table) -> tuple[Array, Array]:
    """Metres north and east of the first sample, by the WGS-84 radii of curvature there.

    Flat to a decimetre over the kilometre that a track spans.
    """
    latitude, longitude = reference.numbers("Latitude [rad]"), reference.numbers("Longitude [rad]")
    height = reference.numbers("Altitude [m]")[0]
    meridian, normal = radii_of_curvature(latitude[0])
    north = (latitude - latitude[0]) * (meridian + height)
    east = (longitude - longitude[0]) * (normal + height) * math.cos(latitude[0])
    return north, east


def _rows_of_four(model: LinearModel) -> Array:
    if getattr(model, "n", None) != 4 or not hasattr(model, "H"):
        raise ValueError(
            "model must be a navgym.LinearModel of the states [Px, Vx, Py, Vy], "
            f"got {type(model).__name__} of {getattr(model, 'n', '?')} states."
        )
    return np.asarray(model.H)
