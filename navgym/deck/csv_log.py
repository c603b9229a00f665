"""A ship's own log of two IMUs, in the layout of the paper's table 1: plain text in and out."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from navgym.core.checks import Array, one_of, real_array, shaped, within
from navgym.core.notes import Notes
from navgym.core.tables import Table, read_table, write_table
from navgym.core.text import LARGEST
from navgym.core.typed import typed
from navgym.deck.log_columns import GYRO_UNITS, MOST, QUATERNION, Columns, names_of
from navgym.deck.model import DeckModel
from navgym.deck.recording import DualIMURecording, resample
from navgym.deck.relative import relative_attitude

STEP = 0.05  # s: filter steps shorter than this gain nothing
LONGEST_GRID = 100  # times the rows: a log that even steps would make longer has a wrong time in it


def read_deck_csv(
    path: str | os.PathLike[str],
    *,
    gyro_unit: str = "deg/h",
    units: Mapping[str, str] | None = None,
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
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    missing: Sequence[str | float] = (),
    time_scale: float | None = None,
    extra: str = "say",
    check_units: bool = True,
    largest: float = LARGEST,
) -> DualIMURecording:
    """A ship's log: a text file with a header line and a row per sample of both IMUs.

    ====================  ======================================================================
    column                holds
    ====================  ======================================================================
    time                  even steps; numbers in s (or ms, us, ns), ISO 8601, or a clock HH:MM:SS
    main_gyro_x, _y, _z   mean rate since the row before, main IMU, own axes, in `gyro_unit`
    main_acc_x, _y, _z    its mean specific force, m/s² (or g, by unit)
    sub_gyro_x ...        the sub IMU's; empty or nan in any of these twelve: not received
    ref1_gyro_x ...       optional: a better unit beside the main IMU (PHINS-1), all six columns
    ref2_gyro_x ...       optional: one beside the sub IMU (PHINS-2)
    qw, qx, qy, qz        optional: reference attitude of the sub in the main IMU's axes; it goes
                          before one from ref1 and ref2
    latitude, longitude   optional, °, empty in rows without a fix: the filter needs neither;
                          `meta` keeps the means
    ====================  ======================================================================

    Names may be in any case, with blanks, and with a unit: "Main Gyro X (deg/s)", "sub_accel_z [g]".
    What was found and done stands as sentences in `meta["reading"]`.

    The reference attitude from ref1 and ref2 is C_2^1(t) = C_1ᵀ(t) C_2^1(0) C_2(t), where each
    C_i is the product of unit i's turns since the start: flexure between the units is in it, drift
    of good gyros is not worth a minute of arc in five minutes. C_2^1(0) is where rates and specific
    forces of both, in inertial axes, agree best over the log; the lever arm's share is taken off
    the forces. Simulated, 10° of sway: errors of it below 1′ about the horizontal axes and 2′ about
    the vertical after 60 s, .2′ and 1′ after 300 s (some 3′ and 1.5′ where the lever arm is
    unknown). Such an error is a constant: judge it before believing the attitude's mean.

    Args:
        path: the file.
        gyro_unit: of gyro columns whose names tell none, "deg/h" (the paper's), "deg/s" or "rad/s".
        units: of single columns whose names tell none, or a wrong one: {"main_acc_x": "g"}.
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
        delimiter: between cells, " " for any run of blanks; found in the file by default.
        decimal: "." or ","; found in the file by default.
        encoding: of the text, such as "latin-1"; found in the file by default.
        missing: further words or numbers that stand for a lost sample, such as -9999.
        time_scale: seconds per unit of the time column, 1e-3 for ms; by default what its name says,
            else s, or what the numbers leave no doubt of.
        extra: of columns of unknown meaning: leave them out and "say" so, "raise" an error, or
            "ignore" them without a word.
        check_units: whether to refuse data whose units cannot be.
        largest: bytes of text, after unpacking, that are read at most.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: no lever arm; naming line and column, for text, infinity, gaps and duplicates in
            time, a gap in a reference; unknown or missing columns; units that cannot be.
    """
    table = read_table(path, delimiter, decimal=decimal, encoding=encoding, largest=largest)
    return recording_of(
        table, gyro_unit=gyro_unit, units=units, lever_arm=lever_arm,
        samples_per_step=samples_per_step, model=model, deviation1=deviation1,
        deviation2=deviation2, reference=reference, regular=regular, longest_gap=longest_gap,
        gyro_limit=gyro_limit, force_limit=force_limit, columns=columns, missing=missing,
        time_scale=time_scale, extra=extra, check_units=check_units,
    )  # fmt: skip


def recording_of(
    table: Table,
    *,
    gyro_unit: str = "deg/h",
    units: Mapping[str, str] | None = None,
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
    missing: Sequence[str | float] = (),
    time_scale: float | None = None,
    extra: str = "say",
    check_units: bool = True,
    meta: Mapping[str, Any] | None = None,
) -> DualIMURecording:
    """A recording from columns of cells, wherever these come from; options and errors of `read_deck_csv`."""
    one_of("gyro_unit", gyro_unit, GYRO_UNITS)
    one_of("extra", extra, ("say", "raise", "ignore"))
    within("time_scale", 1.0 if time_scale is None else time_scale, 0.0, above=True)
    _check_kinds(model, missing, columns=columns, units=units)
    notes = Notes(table.path.name)
    for sentence in table.said:
        notes.say(sentence)
    found = Columns.of(table, columns or {}, units or {}, gyro_unit, missing, extra, notes)
    lever, told = _lever(table.path, model, lever_arm), _told(model, samples_per_step)
    times = found.times(time_scale)
    limited = {"gyro": gyro_limit is not None, "acc": force_limit is not None}
    most = {s: np.inf if limited[s] or not check_units else m for s, m in MOST.items()}
    log = _Log.of(replace(found, most=most), times.seconds, regular, longest_gap)
    believed = replace(_believed(model, told, log.grid), lever_arm=lever)
    sides = (_installed("deviation1", deviation1), _installed("deviation2", deviation2))
    _say(notes, model, told, believed, found)
    kept: dict[str, Any] = {
        "format": "deck_csv",
        "file": table.path.name,
        "reading": notes.sentences,
    }
    kept["columns"] = {quantity: column.name for quantity, column in found.found.items()}
    return DualIMURecording.from_rates(
        log.grid,
        *(*log.imu("main", True), *log.imu("sub", True)),
        gyro_limit=None if gyro_limit is None else gyro_limit * GYRO_UNITS[gyro_unit],
        force_limit=force_limit,
        model=believed,
        attitude=log.reference(believed.lever_arm, sides) if reference else None,
        check_units=check_units,
        meta=kept
        | found.fix()
        | ({} if times.start is None else {"start": times.start})
        | dict(meta or {}),
    )


class _Log(NamedTuple):
    """The columns of a log, the times of its rows, and those at which its values are wanted, s."""

    columns: Columns
    time: Array
    grid: Array  # `time` itself where that is even
    longest_gap: float | None

    @classmethod
    def of(cls, columns: Columns, time: Array, regular: bool, longest_gap: float | None) -> _Log:
        """On even steps; ValueError where times are uneven, unless `regular`."""
        if not regular:
            _check_even(columns, time)
            return cls(columns, time, time, longest_gap)
        grid = _grid(columns, time)
        late, twice = int((np.diff(time) < 0.0).sum()), len(time) - len(np.unique(time))
        if late:
            columns.notes.say(f"rows sorted by time ({late} came late)")
        if twice:
            columns.notes.say(f"{twice} rows left out, of times that stand there before")
        columns.notes.say(f"interpolated on {len(grid)} even steps of {grid[1] - grid[0]:.6g} s")
        return cls(columns, time, grid, longest_gap)

    def imu(self, unit: str, gaps: bool) -> tuple[Array, Array]:
        """Rates in rad/s and specific forces of one unit, (G, 3) each."""
        names = [*names_of(unit, "gyro"), *names_of(unit, "acc")]
        data = np.stack([self.columns.measured(name, gaps) for name in names], axis=-1)
        if self.grid is not self.time:
            data = resample(self.time, data, self.grid, self.longest_gap)
        return data[:, :3], data[:, 3:]

    def reference(self, lever_arm: Array, sides: Sequence[Rotation]) -> Array | None:
        """Reference attitude of the sub in the main IMU's axes, (G, 4), if the file has one."""
        if "qw" in self.columns:
            return _given(self.columns, self.time, self.grid)
        if "ref1_gyro_x" not in self.columns or "ref2_gyro_x" not in self.columns:
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
            found |= dict(zip(names_of(unit, sensor), means.T.tolist(), strict=True))
    if recording.reference is not None:
        found |= dict(zip(QUATERNION, recording.reference.T.tolist(), strict=True))
    return write_table(path, found)


def _check_kinds(model: object, missing: object, **tables: object) -> None:
    if model is not None and not isinstance(model, (DeckModel, Mapping)):
        raise ValueError(
            f"model must be a navgym.DeckModel or a dict of its fields, got {model!r}."
        )
    if isinstance(missing, (str, bytes)) or not isinstance(missing, Iterable):
        raise ValueError(  # noqa: TRY004 - as every wrong option
            f"missing must be a list of words or numbers, such as [-9999], got {missing!r}."
        )
    examples = {"columns": "{'main_gyro_x': 'gx1'}", "units": "{'main_gyro_x': 'deg/s'}"}
    for name, value in tables.items():
        if value is not None and not isinstance(value, Mapping):
            raise ValueError(f"{name} must be a dict such as {examples[name]}, got {value!r}.")


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


def _say(
    notes: Notes, model: object, told: Mapping[str, Any], believed: DeckModel, found: Columns
) -> None:
    """Say what was taken for granted."""
    if all(found.found[name].unit is None for name in names_of("main", "gyro")):
        notes.say(f"gyros in {found.gyro_unit}: their names tell no unit")
    if isinstance(model, DeckModel):
        return
    if "samples_per_step" not in told:
        notes.say(f"{believed.samples_per_step} samples make a filter step of about {STEP:g} s")
    usual = [
        f.name for f in fields(DeckModel) if f.name not in (*told, "lever_arm", "samples_per_step")
    ]
    if usual:
        notes.say(
            f"taken from IDAM section 5, which may not be your ship's or IMUs': {', '.join(usual)}; "
            "model= says otherwise"
        )


def _installed(name: str, deviation: Sequence[float]) -> Rotation:
    angles = real_array(name, deviation)
    shaped(name, angles, (3,), "pitch, roll and heading in degrees")
    pitch, roll, heading = angles
    return Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True)


def _check_even(columns: Columns, time: Array) -> None:
    """ValueError, naming the line, where times do not increase by even steps."""
    steps = np.diff(time)
    if (steps <= 0.0).any():
        k = int(np.argmax(steps <= 0.0)) + 1
        cells = columns.table.find(columns.found["time"].name)
        what = f"{cells[k]} does not come after {cells[k - 1]}: sort the rows, drop duplicates."
        raise columns.error(k, "time", f"{what} Or pass regular=True, which does.")
    usual = float(np.median(steps)) if len(steps) else 0.0
    uneven = np.abs(steps - usual) > 0.02 * usual  # as DualIMURecording has it
    if uneven.any():
        k = int(np.argmax(uneven)) + 1
        what = (
            f"{steps[k - 1]:.6g} s after the row before, where {usual:.6g} s are usual: pass "
            "regular=True to interpolate and mark gaps as not received."
        )
        raise columns.error(k, "time", what)


def _grid(columns: Columns, time: Array) -> Array:
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
        raise columns.error(at, "time", what)
    return np.linspace(unique[0], unique[-1], round(count) + 1)


def _given(columns: Columns, time: Array, grid: Array) -> Array:
    """Columns qx, qy, qz, qw on the grid."""
    remedy = "The reference is needed in every row: fill it in, or pass reference=False."
    parts = [columns.numbers(name, gaps=False, remedy=remedy) for name in QUATERNION]
    quaternions = np.stack(parts, axis=-1)
    size = np.linalg.norm(quaternions, axis=1)
    if np.abs(size - 1.0).max() > 1e-2:
        k = int(np.argmax(np.abs(size - 1.0)))
        what = (
            f"the quaternion has length {size[k]:.4g}, not 1. Repair it, or pass reference=False."
        )
        raise columns.error(k, "qw", what)
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
