"""Public recordings of two IMUs: RepoIMU's pendulum and the quadrotor of Hurwitz and Klein."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from navgym.core.checks import Array, positive_int, real_array, within
from navgym.core.tables import Table, read_rows, read_table
from navgym.deck.model import DeckModel
from navgym.deck.recording import IMPOSSIBLE, DualIMURecording, resample
from navgym.inertial.flexure import FlexureModel

AXES = ("X", "Y", "Z")
LONGEST_GAP = 0.1  # s: RepoIMU's IMUs answer every 18 ms, the quadrotor's every 8 ms
WINDOW = 0.1  # s, over which Vicon's turns are compared with the gyros': its rates are too noisy
PLANAR = 0.3  # a swing keeps to a plane where its second axis turns by less than this share
TURNS = 6  # of the alternation between mounting and gyro bias, which settles in two or three

# A swinging pendulum: period 1.48 s, amplitudes of 5 to 10 degrees, 10 s of decay; gyros of
# consumer grade, whose samples are held for 18 ms.
PENDULUM = DeckModel(
    flexure=FlexureModel([0.25] * 3, [18.0] * 3, np.radians([1.0, 1.5, 7.0])),
    lever_arm=(0.0, 0.0, 0.0),
    misalignment=0.3,
    gyro_bias=0.01,
    accelerometer_bias=0.3,
    gyro_noise=1e-3,
    accelerometer_noise=0.02,
    rate_noise=0.1,
)

# Two IMUs on one plate: what bends is less than what shakes.
QUADROTOR = DeckModel(
    flexure=FlexureModel([2.0] * 3, [1.0] * 3, [np.radians(0.05)] * 3),
    lever_arm=(0.0, 0.0, 0.0),
    misalignment=0.05,
    gyro_bias=0.02,
    accelerometer_bias=0.5,
    gyro_noise=2e-3,
    accelerometer_noise=0.05,
    rate_noise=0.05,
)


class Segment(NamedTuple):
    """One file of RepoIMU; times in s, (T,), strictly increasing."""

    time: Array
    vicon: Rotation  # (T,) the segment's attitude relative to its first
    force: Array  # (T, 3) m/s²
    rate: Array  # (T, 3) rad/s
    field: Array  # (T, 3) magnetometer, its own unit


def read_repoimu(
    path: str | os.PathLike[str],
    /,
    *,
    trial: str = "Test03_Trial1",
    main: int = 1,
    sub: int = 2,
    rate: float = 100.0,
    samples_per_step: int = 5,
    lever_arm: ArrayLike = (0.0, 0.0, 0.0),
    model: DeckModel | None = None,
) -> DualIMURecording:
    """Two segments of RepoIMU's pendulum: a relative attitude that oscillates, and its reference.

    The gyros are in rad/s, accelerometers in m/s². A file has about 163 rows per second; Vicon
    changes in each, while the cells of the gyros and of the accelerometers each repeat until that
    sensor's next sample, some 20 ms later. Only the first row of each such run is used, and both
    segments are interpolated on one grid over the time that they share; where rows are .1 s or
    more apart the samples are lost.

    The reference. Each Vicon quaternion starts at identity: it turns the segment's present axes
    into its own first ones (the conjugate fits the gyros worse in all four files seen, if by
    little: the motion is nearly in one plane). How an IMU sits in its segment is found by fitting
    its gyros, less a constant bias, to Vicon's turns; a swing in one plane leaves the rotation
    about its own axis to chance, where it matters least. The relative attitude at the first sample
    follows from gravity (the mean force in the first axes, since what swings comes to rest) and
    the axis of the swing, which the hinges have in common; where the motion isn't in one plane,
    from gravity and the magnetometers.

    Its faults. At the bottom of fast swings the quaternions turn at a constant rate that the gyros
    don't show, as if bridged where markers were lost: errors of some degrees for half a second.
    Test03_Trial1 and Test05_Trial2: the gyros, less their biases, follow the reference of the
    relative attitude to 2.5° and 2.9° RMS (of a swing of 34° and 59°), with them left in to 11° and
    12°; `meta` holds the biases, rad/s, of main and sub. The lever arms are not published.

    Args:
        path: the data set's folder, its folder Pendulum, or one of a trial's files (whose name
            then says the trial).
        trial: as in Pendulum_<trial>_Segment_<n>.csv.
        main: segment of the main IMU.
        sub: segment of the sub IMU.
        rate: samples per second of the recording.
        samples_per_step: samples in a filter step.
        lever_arm: (3,) m, from main to sub IMU in the main IMU's axes; unknown, zeros.
        model: what a filter is to believe; `PENDULUM` by default. The two above go before it.

    Raises:
        FileNotFoundError: there is no such trial or segment.
        ValueError: an option out of range, or a file that is not in the published layout.

    Source: github.com/agnieszkaszczesna/RepoIMU; A. Szczęsna et al., Reference data set for
    accuracy evaluation of orientation estimation algorithms for inertial motion capture systems,
    ICCVG 2016. navgym does not ship its data.
    """
    within("rate", rate, 0.0, above=True)
    folder, trial = _trial(Path(path), trial)
    numbers = [positive_int("main", main), positive_int("sub", sub)]
    if main == sub:
        raise ValueError(f"main and sub must be two segments, got {main} for both.")
    pair = [_segment(_repoimu_file(folder, trial, number)) for number in numbers]
    time = _shared_grid(pair, rate)
    middle = time - 0.5 / rate  # mean rates over an interval are those of its middle
    samples = [values for s in pair for values in _imu_on(s, middle)]
    attitude, biases = _relative_attitude(pair, time)
    believed = PENDULUM if model is None else model
    return DualIMURecording.from_rates(
        time,
        *samples,
        model=replace(believed, lever_arm=lever_arm, samples_per_step=samples_per_step),
        attitude=attitude.as_quat(),
        check_units=False,  # it swings through 60° and more: gravity alone does not stand out
        meta={
            "format": "repoimu", "source": "github.com/agnieszkaszczesna/RepoIMU", "trial": trial,
            "main": main, "sub": sub, "gyro_bias": [bias.tolist() for bias in biases],
        },
    )  # fmt: skip


def _trial(path: Path, trial: str) -> tuple[Path, str]:
    """Folder and trial that `path` and `trial` mean."""
    if path.suffix.lower() == ".csv":
        named = re.fullmatch(r"Pendulum_(.+)_Segment_\d+\.csv", path.name)
        if named is None:
            raise ValueError(
                f"{path.name} is not a file of RepoIMU's pendulum, which are called "
                "Pendulum_<trial>_Segment_<n>.csv."
            )
        return path.parent, named[1]
    inner = path / "Pendulum"
    return (inner if inner.is_dir() else path), trial


def _repoimu_file(folder: Path, trial: str, number: int) -> Path:
    file = folder / f"Pendulum_{trial}_Segment_{number}.csv"
    if file.exists():
        return file
    held = sorted(p.name[9:-4] for p in folder.glob("Pendulum_*_Segment_*.csv"))
    raise FileNotFoundError(
        f"{folder} holds no {file.name}; it has: {', '.join(held) or 'none'}. Clone "
        "github.com/agnieszkaszczesna/RepoIMU and name its folder Pendulum, or check trial=, "
        "main= and sub=."
    )


def _repoimu_table(path: Path) -> Table:
    """The file's cells by names such as "IMU Gyroscope X", decimal commas as points."""
    rows, lines = read_rows(path, ";")
    if len(rows) < 4:
        raise ValueError(f"{path.name} has {len(rows)} lines: two of names and two rows at least.")
    group, names = "", []
    for above, below in zip(*rows[:2], strict=False):
        group = above or group
        names.append(f"{group} {below}".strip())
    width = len(rows[2])
    for line, row in zip(lines[2:], rows[2:], strict=True):
        if len(row) != width:
            raise ValueError(f"{path.name}, line {line}: {len(row)} cells, not {width} as before.")
    columns = [tuple(c.replace(",", ".") for c in column) for column in zip(*rows[2:], strict=True)]
    return Table(path, dict(zip(names, columns, strict=False)), lines[2:])


def _segment(path: Path) -> Segment:
    table = _repoimu_table(path)
    kinds = [f"IMU {kind}" for kind in ("Acceleration", "Gyroscope", "Magnetometer")]
    for name in ("Time (s)", *(f"{kind} {axis}" for kind in kinds for axis in AXES)):
        table.find(name, "The file must be as published, with two rows of names.")
    time = table.numbers("Time (s)")
    if (np.diff(time) < 0.0).any():
        k = int(np.argmax(np.diff(time) < 0.0)) + 1
        raise table.error(k, "Time (s)", f"{time[k]} comes before {time[k - 1]}: sort the rows.")
    W, X, Y, Z = (table.numbers(f"Vicon Orientation {axis}") for axis in ("W", *AXES))
    vicon = np.stack([X, Y, Z, W], axis=-1)
    size = np.linalg.norm(vicon, axis=1)
    if np.abs(size - 1.0).max() > 0.01:
        k = int(np.argmax(np.abs(size - 1.0)))
        what = f"the quaternion has length {size[k]:.4g}, not 1: repair or remove the row."
        raise table.error(k, "Vicon Orientation W", what)
    data = [np.stack([_possible(table, f"{kind} {a}") for a in AXES], axis=-1) for kind in kinds]
    time, first = np.unique(time, return_index=True)
    if len(time) < 2:
        raise ValueError(f"{path.name} must hold two different times at least.")
    return Segment(time, Rotation.from_quat(vicon[first]), *(d[first] for d in data))


def _possible(table: Table, column: str) -> Array:
    """A column of measurements; ValueError for what no sensor measures in any unit."""
    values = table.numbers(column)
    if (np.abs(values) > IMPOSSIBLE).any():
        k = int(np.argmax(np.abs(values)))
        what = f"no sensor measures {values[k]:g}: repair or remove the row."
        raise table.error(k, column, what)
    return values


def _shared_grid(pair: Sequence[Segment], rate: float) -> Array:
    """Even times whose intervals lie within both segments."""
    start, end = max(s.time[0] for s in pair), min(s.time[-1] for s in pair)
    count = int(np.floor((end - start) * rate + 1e-9))
    if count < 2:
        raise ValueError(
            f"the segments share only {max(end - start, 0.0):.3g} s: choose segments of one trial, "
            "or raise rate=."
        )
    grid: Array = start + np.arange(1, count + 1) / rate
    return grid


def _imu_on(segment: Segment, grid: Array) -> tuple[Array, Array]:
    """Rates and specific forces at `grid`, (G, 3) each."""
    missed = np.isnan(resample(segment.time, segment.time[:, None], grid, LONGEST_GAP)[:, 0])
    forever = float(np.ptp(segment.time)) + 1.0  # at rest a sample may repeat the one before
    found = []
    for values in (segment.rate, segment.force):  # each sensor has a clock of its own
        fresh = np.append(True, (np.diff(values, axis=0) != 0.0).any(axis=1))
        fresh[-1] = True
        found.append(resample(segment.time[fresh], values[fresh], grid, forever))
        found[-1][missed] = np.nan
    return found[0], found[1]


def _relative_attitude(pair: Sequence[Segment], time: Array) -> tuple[Rotation, list[Array]]:
    """Attitude of the sub in the main IMU's axes at `time`, by Vicon; biases of both gyros."""
    turned, biases = [], []
    for segment in pair:
        mount, bias = mounting(segment.time, segment.vicon, segment.rate)
        turned.append(mount.inv() * segment.vicon * mount)
        biases.append(bias)
    main, sub = (Slerp(s.time, a)(time) for s, a in zip(pair, turned, strict=True))
    return main.inv() * _first_attitude(pair, turned) * sub, biases


def mounting(time: Array, reference: Rotation, rate: Array) -> tuple[Rotation, Array]:
    """How gyros sit in a body of known attitude, and their bias.

    Fits, over windows of `WINDOW` s, the turns of `reference` to the integrals of `rate` less a
    constant; the two are estimated in turn.

    Args:
        time: (T,) s, strictly increasing.
        reference: (T,) body to any fixed axes.
        rate: (T, 3) rad/s.

    Returns:
        The rotation from the gyros' axes to the body's, and the bias (3,) in rad/s.
    """
    angle = _integral(time, rate)
    reach = min(max(1, round(WINDOW / float(np.median(np.diff(time))))), len(time) - 1)
    turns = (reference[:-reach].inv() * reference[reach:]).as_rotvec()
    sensed, span = angle[reach:] - angle[:-reach], (time[reach:] - time[:-reach])[:, None]
    bias, mount = np.zeros(3), Rotation.identity()
    for _ in range(TURNS):
        mount = fitted(turns, sensed - bias * span)
        bias = ((sensed - mount.apply(turns, inverse=True)) / span).mean(axis=0)
    return mount, bias


def fitted(there: Array, here: Array) -> Rotation:
    """The rotation that takes vectors `here` (N, 3) closest to `there` (Wahba's problem)."""
    left, _, right = np.linalg.svd(there.T @ here)
    flip = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    return Rotation.from_matrix(left @ flip @ right)


def _first_attitude(pair: Sequence[Segment], turned: Sequence[Rotation]) -> Rotation:
    """Attitude of the sub in the main IMU's axes where `turned`, attitudes of both, are identity."""
    gravity, field, axis, planar = [], [], [], True
    for segment, attitude in zip(pair, turned, strict=True):
        # what swings comes to rest: over the recording all acceleration but gravity averages out
        gravity.append(_unit(attitude.apply(segment.force).sum(axis=0)))
        field.append(_unit(attitude.apply(segment.field).sum(axis=0)))
        _, size, axes = np.linalg.svd(attitude.apply(segment.rate), full_matrices=False)
        axis.append(axes[0])
        planar = planar and size[1] < PLANAR * size[0]
    second = field
    if planar:  # hinges are parallel; an axis has two ends, and the field says which is which
        ends = np.sign([a @ np.cross(g, f) for a, g, f in zip(axis, gravity, field, strict=True)])
        second = [end * a for end, a in zip(ends, axis, strict=True)]
    main, sub = (np.stack(two) for two in zip(gravity, second, strict=True))
    return fitted(main, sub)


def _unit(vector: Array) -> Array:
    unit: Array = vector / max(float(np.linalg.norm(vector)), 1e-300)
    return unit


def read_multi_imu(
    folder: str | os.PathLike[str],
    /,
    *,
    path: int = 1,
    main: int = 1,
    sub: int = 2,
    delay: float | None = None,
    samples_per_step: int = 6,
    lever_arm: ArrayLike = (0.0, 0.0, 0.0),
    model: DeckModel | None = None,
) -> DualIMURecording:
    """Two IMUs fixed to one quadrotor: the null test, whose relative attitude never changes.

    120 samples per second; the files' °/s become rad/s. There is no reference of the relative
    attitude. The gyros agree best where the axes are 2.0° apart, constantly; a filter should find
    that angle, and no flexure. The Euler angles in the files say otherwise (37° apart in heading
    at the start of path 1): each IMU's own heading wanders, and they are not read.

    The clocks: in path 1 the second IMU's samples are 7 ms late, which at 1.3 rad/s looks like
    half a degree of flexure. By default the delay is measured (`clock_delay`) and taken out by
    interpolation. `meta` holds the delay and the misalignment (rotation vector, °) that the gyros
    show. Between the gyros lies a constant bias of 1.1 °/s about x.

    Args:
        folder: the data set's folder, or one of the path's files (which then says the path).
        path: as in path_<path>_IMU_<n>.csv.
        main: number of the main IMU.
        sub: number of the sub IMU.
        delay: by how many seconds the sub's samples are late; None measures it, 0 leaves them.
        samples_per_step: samples in a filter step.
        lever_arm: (3,) m, from main to sub IMU in the main IMU's axes; unknown, zeros.
        model: what a filter is to believe; `QUADROTOR` by default. The two above go before it.

    Raises:
        FileNotFoundError: there is no such path or IMU.
        ValueError: an option out of range, or files that are not in the published layout.

    Source: D. Hurwitz and I. Klein, Quadrotor dead reckoning with multiple inertial sensors, 2023
    (CC BY 4.0). The RTK reference of position and attitude beside it, path_<path>_GT.csv, is of
    the quadrotor and not of the IMUs, and not read.
    """
    where, path = _flight(Path(folder), path)
    numbers = [positive_int("main", main), positive_int("sub", sub)]
    if main == sub:
        raise ValueError(f"main and sub must be two IMUs, got {main} for both.")
    first, second = (_quadrotor_imu(_multi_imu_file(where, path, n)) for n in numbers)
    late = clock_delay(*first[:2], *second[:2]) if delay is None else delay
    time, *data = _on_one_clock(first, second, late)
    apart = misalignment(data[0], data[2])
    believed = QUADROTOR if model is None else model
    return DualIMURecording.from_rates(
        time,
        *data,
        model=replace(believed, lever_arm=lever_arm, samples_per_step=samples_per_step),
        check_units=False,  # it flies: gravity alone does not stand out
        meta={
            "format": "multi_imu", "source": "Hurwitz and Klein 2023", "path": path, "main": main,
            "sub": sub, "delay": late, "misalignment": apart.as_rotvec(degrees=True).tolist(),
        },
    )  # fmt: skip


def _flight(folder: Path, path: object) -> tuple[Path, int]:
    """Folder and path that the two mean."""
    named = re.fullmatch(r"path_(\d+)_(?:IMU_\d+|GT)\.csv", folder.name)
    if named is not None:
        return folder.parent, int(named[1])
    return folder, positive_int("path", path)


def _multi_imu_file(folder: Path, path: int, number: int) -> Path:
    name = f"path_{path}_IMU_{number}.csv"
    found = sorted(folder.rglob(name))
    if len(found) > 1:
        raise ValueError(
            f"{folder} holds {name} {len(found)} times: name one of the folders in it."
        )
    if not found:
        held = sorted(p.name for p in folder.rglob("path_*_IMU_*.csv"))
        raise FileNotFoundError(
            f"{folder} holds no {name}; it has: {', '.join(held) or 'none'}. Name the folder of the "
            "published data, or check path=, main= and sub=."
        )
    return found[0]


def _quadrotor_imu(file: Path) -> tuple[Array, Array, Array]:
    """Times (T,), rates (T, 3) in rad/s and specific forces (T, 3)."""
    table = read_table(file)
    rate, force = (table.matrix([f"{k}_{axis}" for axis in AXES]) for k in ("Gyr", "Acc"))
    return table.increasing("time"), np.radians(rate), force


def _on_one_clock(
    main: tuple[Array, Array, Array], sub: tuple[Array, Array, Array], delay: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Times of the main IMU that both share, rates and forces of both; the sub is `delay` s late."""
    time, rate, force = main
    within("delay", delay, -np.inf)
    kept = (time >= sub[0][0] - delay) & (time <= sub[0][-1] - delay)
    if kept.sum() < 2:
        raise ValueError(f"the IMUs share no time at a delay of {delay} s: check delay=.")
    others = [resample(sub[0], values, time[kept] + delay, LONGEST_GAP) for values in sub[1:]]
    return time[kept], rate[kept], force[kept], others[0], others[1]


def misalignment(main_rate: Array, sub_rate: Array) -> Rotation:
    """Attitude of one gyro in the axes of another on the same rigid body, from their rates (T, 3).

    Each less its mean, which takes their biases out; rows with NaN are left out.
    """
    whole = ~(np.isnan(main_rate) | np.isnan(sub_rate)).any(axis=1)
    main, sub = main_rate[whole], sub_rate[whole]
    return fitted(main - main.mean(axis=0), sub - sub.mean(axis=0))


def clock_delay(
    time: ArrayLike,
    rate: ArrayLike,
    other_time: ArrayLike,
    other_rate: ArrayLike,
    longest: float = 0.1,
) -> float:
    """By how many seconds the second of two gyros on one rigid body is late.

    Turns over `WINDOW` s are compared, which shaking hardly reaches, each less its mean (a bias).
    At each lag, in steps of a tenth of a sample, the second are rotated to fit the first; the lag
    where they fit best is the delay.

    Args:
        time: (T,) s, strictly increasing.
        rate: (T, 3) rad/s, of the first gyro.
        other_time: (S,) s, strictly increasing.
        other_rate: (S, 3) rad/s, of the second.
        longest: s, the largest lag of either sign that is tried.

    Raises:
        ValueError: the two do not share twice `longest` and a few windows.
    """  # fmt: skip
    t, late = real_array("time", time), real_array("other_time", other_time)
    first, second = (
        _integral(t, real_array("rate", rate)),
        _integral(late, real_array("other_rate", other_rate)),
    )
    begin, end = max(t[0], late[0]) + longest, min(t[-1], late[-1]) - longest - WINDOW
    at = np.arange(begin, end, WINDOW / 4.0)
    if len(at) < 8:
        raise ValueError(
            f"the IMUs share too little time ({t[0]:g} to {t[-1]:g} s and {late[0]:g} to "
            f"{late[-1]:g} s) to compare their clocks: pass delay=."
        )
    wanted = _turns(t, first, at)
    step = 0.1 * float(np.median(np.diff(t)))
    lags = step * np.arange(-round(longest / step), round(longest / step) + 1)
    misfit = []
    for lag in lags:
        found = _turns(late, second, at + lag)
        misfit.append(np.square(wanted - fitted(wanted, found).apply(found)).sum())
    return float(lags[int(np.argmin(misfit))])


def _integral(time: Array, rate: Array) -> Array:
    """Integral of `rate` (T, c) from the first of the times on, by the trapezoidal rule, (T, c)."""
    parts = (rate[1:] + rate[:-1]) / 2.0 * np.diff(time)[:, None]
    return np.concatenate([np.zeros((1, rate.shape[1])), np.cumsum(parts, axis=0)])


def _turns(time: Array, angle: Array, at: Array) -> Array:
    """Gains of `angle` (T, 3) within `WINDOW` s from each of the times `at` (N,), less their mean."""
    gains = [np.interp(at + WINDOW, time, a) - np.interp(at, time, a) for a in angle.T]
    return np.stack([gain - gain.mean() for gain in gains], axis=-1)
