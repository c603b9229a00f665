"""A ship's own log of two IMUs, in the layout of the paper's table 1: plain text in and out."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from navgym.core.checks import Array, one_of, real_array, shaped, within
from navgym.core.tables import Table, read_table, write_table
from navgym.core.typed import typed
from navgym.deck.model import DeckModel
from navgym.deck.public_logs import fitted
from navgym.deck.recording import DualIMURecording, resample, turning
from navgym.inertial.imu import DEGREE_PER_HOUR

GYRO_UNITS: Mapping[str, float] = {
    "deg/h": DEGREE_PER_HOUR,
    "deg/s": float(np.pi / 180.0),
    "rad/s": 1.0,
}
UNITS = ("main", "sub", "ref1", "ref2")
QUATERNION = ("qx", "qy", "qz", "qw")
FIX = {"latitude": 90.0, "longitude": 180.0}  # largest magnitudes, °
STEP = 0.05  # s: filter steps shorter than this gain nothing
RARE = 0.05  # share of values that may be sentinels
MOST = {"gyro": 100.0, "acc": 1000.0}  # rad/s, m/s²: more is a sentinel, or another unit
LONGEST_GRID = 100  # times the rows: a log that even steps would make longer has a wrong time in it
WINDOW = 1.0  # s: rates and forces of both references are compared as means over this long
REWEIGHTINGS = 4  # of rates against forces; their residuals settle in two or three


def _names(unit: str, sensor: str) -> list[str]:
    return [f"{unit}_{sensor}_{axis}" for axis in "xyz"]


IMU_COLUMNS = tuple(n for unit in UNITS for sensor in ("gyro", "acc") for n in _names(unit, sensor))
COLUMNS = ("time", *IMU_COLUMNS, *QUATERNION, *FIX)


def read_deck_csv(
    path: str | os.PathLike[str],
    *,
    gyro_unit: str = "deg/h",
    lever_arm: ArrayLike | None = None,
    samples_per_step: int | None = None,
    model: Mapping[str, Any] | DeckModel | None = None,
    deviation1: Sequence[float] = (0.0, 0.0, 0.0),
    deviation2: Sequence[float] = (0.0, 0.0, 0.0),
    reference: bool = True,
    regular: bool = False,
    longest_gap: float | None = None,
    gyro_limit: float | None = None,
    force_limit: float | None = None,
    columns: Mapping[str, str] | None = None,
    delimiter: str = ",",
    time_scale: float = 1.0,
    extra: str = "raise",
    check_units: bool = True,
) -> DualIMURecording:
    """A ship's log: a text file with a header line and a row per sample of both IMUs.

    ====================  ======================================================================
    column                holds
    ====================  ======================================================================
    time                  even steps; times `time_scale` it is in seconds
    main_gyro_x, _y, _z   mean rate since the row before, main IMU, own axes, in `gyro_unit`
    main_acc_x, _y, _z    its mean specific force, m/s²
    sub_gyro_x ...        the sub IMU's; empty or nan in any of these twelve: not received
    ref1_gyro_x ...       optional: a better unit beside the main IMU (PHINS-1), all six columns
    ref2_gyro_x ...       optional: one beside the sub IMU (PHINS-2)
    qw, qx, qy, qz        optional: reference attitude of the sub in the main IMU's axes; it goes
                          before one from ref1 and ref2
    latitude, longitude   optional, °, empty in rows without a fix: the filter needs neither;
                          `meta` keeps the means
    ====================  ======================================================================

    The reference attitude from ref1 and ref2 is C_2^1(t) = C_1ᵀ(t) C_2^1(0) C_2(t), where each
    C_i is the product of unit i's turns since the start: flexure between the units is in it, drift
    of good gyros is not worth a minute of arc in five minutes. C_2^1(0) is where rates and specific
    forces of both, in inertial axes, agree best over the log; the lever arm's share is taken off
    the forces. Simulated, 10° of sway: errors of it below 1′ about the horizontal axes and 2′ about
    the vertical after 60 s, .2′ and 1′ after 300 s (some 3′ and 1.5′ where the lever arm is
    unknown). Such an error is a constant: judge it before believing the attitude's mean.

    Args:
        path: the file.
        gyro_unit: of all gyro columns, "deg/h" (the paper's), "deg/s" or "rad/s".
        lever_arm: (3,) m, from main to sub IMU in the main IMU's axes. It is needed, here or in the
            model: with a wrong one the errors are metres per second, and nobody would see it.
        samples_per_step: samples in a filter step; by default the model's, or as many as make
            `STEP` s.
        model: what a filter is to believe: a `DeckModel`, or its fields as a dict. What is not told
            is as in IDAM section 5, a ship of its flexure and IMUs of its quality; `meta` says so.
        deviation1: degrees, pitch, roll and heading of the main IMU in the axes of ref1 (the
            paper's table 2): C_main^ref1 = R_z(heading) R_y(pitch) R_x(roll).
        deviation2: the same of the sub IMU in the axes of ref2.
        reference: False leaves out what the file says of the reference attitude.
        regular: whether to sort rows, drop those of equal time, and interpolate on even steps of
            the usual length; samples within a gap become NaN. Else uneven times are an error.
        longest_gap: s between rows from which `regular` sees a gap; three usual steps by default.
        gyro_limit: rates of this size or more, in `gyro_unit`, are saturated: not received.
        force_limit: the same for specific forces, m/s².
        columns: the file's names where they differ, for example {"main_gyro_x": "gx1 (deg/h)"}.
        delimiter: between cells.
        time_scale: seconds per unit of the time column, 1e-3 for ms.
        extra: "raise" an error for columns of unknown meaning, or "ignore" them.
        check_units: whether to refuse data whose units cannot be.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: no lever arm; naming line and column, for text, infinity, gaps and duplicates in time, a gap
            in a reference; unknown or missing columns; units that cannot be.
    """
    scale = GYRO_UNITS[one_of("gyro_unit", gyro_unit, GYRO_UNITS)]
    one_of("extra", extra, ("raise", "ignore"))
    within("time_scale", time_scale, 0.0, above=True)
    _check_model(model)
    table = _renamed(read_table(path, delimiter), columns)
    _check_columns(table, extra)
    lever, told = _lever(table.path, model, lever_arm), _told(model, samples_per_step)
    time = _times(table, time_scale, regular)
    limited = {"gyro": gyro_limit is not None, "acc": force_limit is not None}
    most = {s: np.inf if limited[s] or not check_units else m for s, m in MOST.items()}
    log = _Log(table, time, _grid(table, time) if regular else time, scale, longest_gap, most)
    believed = replace(_believed(model, told, log.grid), lever_arm=lever)
    notes = _notes(model, told, believed, gyro_unit)
    sides = (_installed("deviation1", deviation1), _installed("deviation2", deviation2))
    return DualIMURecording.from_rates(
        log.grid,
        *(*log.imu("main", True), *log.imu("sub", True)),
        gyro_limit=None if gyro_limit is None else gyro_limit * scale,
        force_limit=force_limit,
        model=believed,
        attitude=log.reference(believed.lever_arm, sides) if reference else None,
        check_units=check_units,
        meta={"format": "deck_csv", "file": table.path.name, "reading": notes} | _fix(table),
    )


class _Log(NamedTuple):
    """A table, the times of its rows, and the times at which its values are wanted, s."""

    table: Table
    time: Array
    grid: Array  # `time` itself where that is even
    scale: float  # rad/s in a unit of the gyro columns
    longest_gap: float | None
    most: Mapping[str, float]  # rad/s of "gyro", m/s² of "acc" that can be; more is refused

    def imu(self, unit: str, gaps: bool) -> tuple[Array, Array]:
        """Rates in rad/s and specific forces of one unit, (G, 3) each."""
        names = [*_names(unit, "gyro"), *_names(unit, "acc")]
        data = np.stack([self._possible(name, gaps) for name in names], axis=-1)
        if self.grid is not self.time:
            data = resample(self.time, data, self.grid, self.longest_gap)
        return data[:, :3] * self.scale, data[:, 3:]

    def _possible(self, name: str, gaps: bool) -> Array:
        """A column, unless it holds what nothing on a ship can measure."""
        values = self.table.numbers(name, gaps)
        sensor = "gyro" if "_gyro_" in name else "acc"
        size = np.abs(values) * (self.scale if sensor == "gyro" else 1.0)
        most = self.most[sensor]
        # where many are as large, it is the unit, which the recording checks
        if (size > most).any() and np.mean(size > most / 10.0) < RARE:
            k = int(np.nanargmax(size))
            unit, limit = ("rad/s", "gyro") if sensor == "gyro" else ("m/s²", "force")
            what = (
                f"{values[k]:g} is {size[k]:.3g} {unit}, which no ship's IMU measures: leave such "
                f"cells empty, or pass {limit}_limit= or check_units=False."
            )
            raise self.table.error(k, name, what)
        return values

    def reference(self, lever_arm: Array, sides: Sequence[Rotation]) -> Array | None:
        """Reference attitude of the sub in the main IMU's axes, (G, 4), if the file has one."""
        if "qw" in self.table:
            return _given(self.table, self.time, self.grid)
        if "ref1_gyro_x" not in self.table or "ref2_gyro_x" not in self.table:
            return None
        one, two = self.imu("ref1", False), self.imu("ref2", False)
        _refuse_gaps([*one, *two], self.grid)
        found: Array = relative_attitude(self.grid, *one, *two, lever_arm, *sides).as_quat()
        return found


def write_deck_csv(
    recording: DualIMURecording, path: str | os.PathLike[str], gyro_unit: str = "deg/h"
) -> Path:
    """Write a recording as `read_deck_csv` reads it, atomically; returns the path.

    Samples not received become empty cells. The file holds rates, specific forces and the
    reference attitude, but neither the model, nor the simulator's truth, nor `meta`:
    `read_deck_csv(path, model=recording.model)` gives the same recording to rounding, less those
    (`DualIMURecording.save` keeps all).

    Raises:
        FileNotFoundError: the folder does not exist.
        ValueError: an unknown unit.
    """
    scale = GYRO_UNITS[one_of("gyro_unit", gyro_unit, GYRO_UNITS)]
    found = {"time": recording.time.tolist()}
    for unit in ("main", "sub"):
        for sensor, kind, size in (("gyro", "angle", scale), ("acc", "velocity", 1.0)):
            means = getattr(recording, f"{unit}_{kind}") / (recording.interval * size)
            found |= dict(zip(_names(unit, sensor), means.T.tolist(), strict=True))
    if recording.reference is not None:
        found |= dict(zip(QUATERNION, recording.reference.T.tolist(), strict=True))
    return write_table(path, found)


def relative_attitude(
    time: Array,
    rate1: Array,
    force1: Array,
    rate2: Array,
    force2: Array,
    lever_arm: ArrayLike,
    side1: Rotation | None = None,
    side2: Rotation | None = None,
) -> Rotation:
    """Attitude of the sub in the main IMU's axes from two better units, one beside each, (T,).

    See `read_deck_csv`.

    Args:
        time: (T,) s, even steps.
        rate1: (T, 3) rad/s of the unit beside the main IMU, mean over each interval.
        force1: (T, 3) m/s², likewise.
        rate2: (T, 3), of the unit beside the sub IMU.
        force2: (T, 3).
        lever_arm: (3,) m, from the first unit to the second, in the first one's axes.
        side1: attitude of the main IMU in the first unit's axes; the same by default.
        side2: attitude of the sub IMU in the second unit's axes.
    """  # fmt: skip
    h = (time[-1] - time[0]) / (len(time) - 1)
    turned = [turning(rate * h) for rate in (rate1, rate2)]
    first = _start(h, turned, (rate1, rate2), (force1, force2), real_array("lever_arm", lever_arm))
    between = turned[0].inv() * first * turned[1]
    here, there = (Rotation.identity() if s is None else s for s in (side1, side2))
    moved: Rotation = here.inv() * between * there
    return moved


def _start(
    h: float,
    turned: Sequence[Rotation],
    rates: Sequence[Array],
    forces: Sequence[Array],
    lever_arm: Array,
) -> Rotation:
    """Attitude of unit 2 in unit 1 before the first sample: Wahba's problem in inertial axes.

    Means over `WINDOW` of both kinds of vectors weigh by the variance of what disagreement they
    leave (flexure rates, lever-arm errors), which is found in turns.
    """  # fmt: skip
    count = min(max(1, round(WINDOW / h)), len(rates[0]))
    spun = [_means(a.apply(w), count) for a, w in zip(turned, rates, strict=True)]
    # velocity of unit 2 relative to 1 is ω × r in unit 1: its gain is what forces differ by
    swing = turned[0].apply(np.cross(rates[0], lever_arm))
    pushed = [_means(a.apply(f), count) for a, f in zip(turned, forces, strict=True)]
    pushed[0] = pushed[0] + _means(np.gradient(swing, h, axis=0), count)
    kinds, first = (spun, pushed), Rotation.identity()
    weights = [1.0 / max(float(np.square(one).sum()), 1e-300) for one, _ in kinds]
    for _ in range(REWEIGHTINGS):
        roots = np.sqrt(weights)
        there, here = (
            np.concatenate([r * kind[i] for r, kind in zip(roots, kinds, strict=True)])
            for i in (0, 1)
        )
        first = fitted(there, here)
        left = [np.square(one - first.apply(two)).mean() for one, two in kinds]
        floors = [1e-12 * np.square(one).mean() + 1e-300 for one, _ in kinds]
        weights = [1.0 / (a + b) for a, b in zip(left, floors, strict=True)]
    return first


def _means(values: Array, count: int) -> Array:
    """Means over successive `count` rows of `values` (T, 3), the last rows left out if fewer."""
    whole = len(values) // count * count
    means: Array = values[:whole].reshape(-1, count, 3).mean(axis=1)
    return means


def _check_model(model: object) -> None:
    if model is not None and not isinstance(model, (DeckModel, Mapping)):
        raise ValueError(
            f"model must be a navgym.DeckModel or a dict of its fields, got {model!r}."
        )


def _lever(path: Path, model: Mapping[str, Any] | DeckModel | None, told: object) -> Array:
    """The lever arm, (3,) m; ValueError where nobody told it."""
    if told is None and isinstance(model, DeckModel):
        return np.array(model.lever_arm)
    found: Any = model.get("lever_arm") if told is None and isinstance(model, Mapping) else told
    if found is None:
        raise ValueError(
            f"{path.name}: where the sub IMU stands is not known: pass lever_arm=(x, y, z), "
            "m, from the main to the sub IMU in the main IMU's axes."
        )
    lever = real_array("lever_arm", found)
    shaped("lever_arm", lever, (3,), "m, along x, y and z of the main IMU")
    return lever


def _told(model: Mapping[str, Any] | DeckModel | None, samples: int | None) -> dict[str, Any]:
    """Fields of the model that were told one by one."""
    given = dict(model) if isinstance(model, Mapping) else {}
    return given | ({} if samples is None else {"samples_per_step": samples})


def _believed(
    model: Mapping[str, Any] | DeckModel | None, told: Mapping[str, Any], time: Array
) -> DeckModel:
    """The model with all that was told, but for the lever arm."""
    if isinstance(model, DeckModel):
        return replace(model, **told)
    samples = max(1, round(STEP * (len(time) - 1) / (time[-1] - time[0]))) if len(time) > 1 else 1
    found: DeckModel = typed(DeckModel, {"samples_per_step": samples, **told}, "model")
    return found


def _notes(
    model: object, told: Mapping[str, Any], believed: DeckModel, gyro_unit: str
) -> list[str]:
    """What was taken for granted, as sentences."""
    notes = [f"gyros in {gyro_unit}, accelerometers in m/s²"]
    if isinstance(model, DeckModel):
        return notes
    usual = [
        f.name for f in fields(DeckModel) if f.name not in (*told, "lever_arm", "samples_per_step")
    ]
    if "samples_per_step" not in told:
        notes.append(f"{believed.samples_per_step} samples make a filter step of about {STEP:g} s")
    if usual:
        notes.append(
            f"taken from IDAM section 5, which may not be your ship's or IMUs': {', '.join(usual)}; "
            "model= says otherwise"
        )
    return notes


def _installed(name: str, deviation: Sequence[float]) -> Rotation:
    angles = real_array(name, deviation)
    shaped(name, angles, (3,), "pitch, roll and heading in degrees")
    pitch, roll, heading = angles
    return Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True)


def _renamed(table: Table, columns: object) -> Table:
    if columns is not None and not isinstance(columns, Mapping):
        raise ValueError(
            "columns must be a dict from navgym's names to the file's, such as "
            f"{{'main_gyro_x': 'gx1'}}, got {columns!r}."
        )
    for name in columns or {}:
        one_of("name in columns:", name, COLUMNS)
    return table.renamed(columns or {})


def _check_columns(table: Table, extra: str) -> None:
    """ValueError for columns of unknown meaning, missing ones, and groups that are not whole."""
    if extra == "raise":
        for name in table.cells:
            try:
                one_of(f"column of {table.path.name}:", name, COLUMNS)
            except ValueError as error:
                raise ValueError(
                    f"{error} Say what it holds with columns={{'main_gyro_x': {name!r}}} or the "
                    "like, or leave such columns out with extra='ignore'."
                ) from None
    groups = [[n for n in IMU_COLUMNS if n.startswith(unit)] for unit in UNITS]
    for needed, group in zip(
        (True, True, False, False, False), [*groups, [*QUATERNION]], strict=True
    ):
        gone = [name for name in group if name not in table]
        if gone and (needed or len(gone) < len(group)):
            raise ValueError(
                f"{table.path.name} lacks {', '.join(gone)}: name the columns so, or say which "
                f"they are with columns={{{gone[0]!r}: ...}}."
            )


def _times(table: Table, scale: float, regular: bool) -> Array:
    """The time column in seconds; uneven ones raise unless `regular`."""
    remedy = "Say which it is with columns={'time': ...}."
    if regular:
        table.find("time", remedy)
        return scale * table.numbers("time")
    try:
        time = table.increasing("time", scale, remedy)
    except ValueError as error:
        hint = " Or pass regular=True, which does." if "does not come after" in str(error) else ""
        raise ValueError(f"{error}{hint}") from None
    steps = np.diff(time)
    usual = float(np.median(steps)) if len(steps) else 0.0
    uneven = np.abs(steps - usual) > 0.02 * usual  # as DualIMURecording has it
    if uneven.any():
        k = int(np.argmax(uneven)) + 1
        what = (
            f"{steps[k - 1]:.6g} s after the row before, where {usual:.6g} s are usual: pass "
            "regular=True to interpolate and mark gaps as not received."
        )
        raise table.error(k, "time", what)
    return time


def _grid(table: Table, time: Array) -> Array:
    """Even times of the usual step over all of `time`, which need not be sorted."""
    unique = np.unique(time)
    if len(unique) < 2:
        raise ValueError(f"the log holds one time only, {unique[0]}: it needs two at least.")
    steps = np.diff(unique)
    count = (unique[-1] - unique[0]) / float(np.median(steps))
    if not count <= LONGEST_GRID * len(time):  # NaN too
        k = int(np.argmax(steps))
        at = int(np.flatnonzero(time == unique[k + 1])[0])
        what = (
            f"{steps[k]:.6g} s lie between this time and the one before, where "
            f"{np.median(steps):.6g} s are usual: repair it, or cut the log there."
        )
        raise table.error(at, "time", what)
    return np.linspace(unique[0], unique[-1], round(count) + 1)


def _given(table: Table, time: Array, grid: Array) -> Array:
    """Columns qx, qy, qz, qw on the grid."""
    remedy = "The reference is needed in every row: fill it in, or pass reference=False."
    quaternions = table.matrix(QUATERNION, remedy)
    size = np.linalg.norm(quaternions, axis=1)
    if np.abs(size - 1.0).max() > 1e-2:
        k = int(np.argmax(np.abs(size - 1.0)))
        what = (
            f"the quaternion has length {size[k]:.4g}, not 1. Repair it, or pass reference=False."
        )
        raise table.error(k, "qw", what)
    unique, first = np.unique(time, return_index=True)
    if np.array_equal(unique, grid):
        same: Array = quaternions[first]
        return same
    turned: Array = Slerp(unique, Rotation.from_quat(quaternions[first]))(grid).as_quat()
    return turned


def _refuse_gaps(units: Sequence[Array], grid: Array) -> None:
    lost = np.isnan(np.concatenate(units, axis=1)).any(axis=1)
    if lost.any():
        k = int(np.argmax(lost))
        raise ValueError(
            f"the log has a gap at {grid[k]:.6g} s, over which ref1 and ref2 cannot carry an "
            "attitude: cut the log there, raise longest_gap=, or pass reference=False."
        )


def _fix(table: Table) -> dict[str, float]:
    """Mean latitude and longitude, °, of the rows that have a fix."""
    found = {}
    for name, limit in FIX.items():
        if name in table:
            values = table.numbers(name, gaps=True)
            wrong = np.abs(values) > limit
            if wrong.any():
                k = int(np.argmax(wrong))
                raise table.error(k, name, f"must be in degrees, ±{limit:g}, got {values[k]:g}.")
            if not np.isnan(values).all():
                found[name] = float(np.nanmean(values))
    return found
