"""A user's own log: plain text in, plain text out."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from navgym.auv.columns import HELD
from navgym.auv.fields import ANNOTATIONS
from navgym.auv.geodesy import checked_origin, from_plane
from navgym.auv.log import STATES, Log, component_names
from navgym.auv.rows import clock_set, merged, order
from navgym.core.checks import Array, one_of, real_array, within
from navgym.core.notes import Notes, Progress
from navgym.core.tables import Table, read_table, write_table
from navgym.core.text import LARGEST
from navgym.statespace.models import LinearModel, step_of
from navgym.statespace.recording import Model, Recording

PRIOR_SIGMAS = 10.0  # x0 is made from the first fix, so it must weigh little: 1 % at ten sigma


def read_csv(
    path: str | os.PathLike[str],
    *,
    model: Model | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    missing: Sequence[str | float] = (),
    extra: str = "say",
    time_scale: float | None = None,
    sort: bool | None = None,
    held: str = "auto",
    origin: Sequence[float] | None = None,
    lever_arm: Sequence[float] | None = None,
    latency: Mapping[str, float] | None = None,
    accuracy_floor: float = 0.0,
    position_noise: float = 1.0,
    velocity_noise: float = 0.1,
    acceleration: float = 0.1,
    largest: float = LARGEST,
) -> Recording:
    """A user's own log: a text file with a header line and a row per sample, at any times.

    ======================  ====================================================================
    column                  holds
    ======================  ====================================================================
    time                    numbers in s (or ms, us, ns), ISO 8601, or a clock HH:MM:SS
    px, vx, py, vy          measurements (m, m/s; x north, y east), all or some of them
    lat, lon, height        in place of px, py: degrees (or rad by unit), m; `navgym.geographic`
                            turns estimates back
    sigma_px, sigma_vx ...  optional: the receiver's own standard deviation of each row, m, m/s;
                            sigma_position and sigma_velocity stand for both axes
    heading                 optional: degrees (or rad by unit) from north to east, for `lever_arm`
    truth_px, truth_vx ...  optional: true states, in every row; in place of missing true
                            velocities stand differences of the true positions
    lost, lost_px ...       optional: 1 or true where the sample, or a component, was lost
    regime                  optional: as in `Recording`; so are process_scale and
                            measurement_scale
    ======================  ====================================================================

    Names may be in any case, with blanks, and with a unit: "North (m)", "px [km]", "vx_m/s",
    "Time (ms)"; usual other names are known. What was found and done stands as sentences in
    `meta["reading"]`; what may be wrong is a warning too.

    A `model` that measures something else names its columns z1, z2, ... and, unless its states are
    [Px, Vx, Py, Vy], truth_x1, truth_x2, ...

    The default model is `LinearModel.white_acceleration` over the log's own steps (the step to the
    first sample is taken as long as the next one). Its x0 passes through the first received
    position and velocity (without a velocity: the first two positions), at ten sigma of their
    noise, so that this second use of a datum weighs 1 %.

    Args:
        path: the file; one that gzip packed is unpacked.
        model: what a filter is to believe, for every row; measures the columns of its H.
        columns: the file's names where they differ, for example {"px": "north (m)"}.
        units: of columns whose names tell none, or a wrong one: {"px": "ft", "time": "ms"}.
        delimiter: between cells, " " for any run of blanks; found in the file by default.
        decimal: "." or ","; found in the file by default.
        encoding: of the text, such as "latin-1"; found in the file by default.
        missing: further words or numbers that stand for a lost measurement, such as -9999.
        extra: of columns of unknown meaning: leave them out and "say" so, "raise" an error, or
            "ignore" them without a word.
        time_scale: seconds per unit of the time column, 1e-3 for ms; by default what the column's
            name says, else s, or what the numbers leave no doubt of.
        sort: True sorts rows whatever their times, False refuses any that do not come after the
            last; by default rows are sorted unless the clock was set back within the file.
        held: what is made of a receiver's repeated last values: "lost", "keep", or "auto", lost
            where they cannot be measurements of their own.
        origin: latitude and longitude, °, and height, m, of px = py = 0; the first fix by default.
        lever_arm: forward and right, m, from the vehicle's centre to the position sensor.
        latency: s by which columns, or "position" or "velocity", are late: {"velocity": 0.5}.
        accuracy_floor: least standard deviation believed of the sigma columns, m and m/s.
        position_noise: standard deviation of a measured position in the default model, m.
        velocity_noise: of a measured velocity, m/s.
        acceleration: of the vehicle's white acceleration.
        largest: bytes of text, after unpacking, that are read at most.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: naming line and column, for text, infinity or a gap where a number is needed,
            a clock that was set back, unknown units, two columns that could be meant, missing
            columns, a file that is empty or not text, a log without any received measurement.
    """
    with Progress(f"reading {Path(path).name}") as progress:
        table = read_table(path, delimiter, decimal=decimal, encoding=encoding, largest=largest)
        progress.at(0.3)
        return recording_of(
            table, progress, model=model, columns=columns, units=units, missing=missing,
            extra=extra, time_scale=time_scale, sort=sort, held=held, origin=origin,
            lever_arm=lever_arm, latency=latency, accuracy_floor=accuracy_floor,
            position_noise=position_noise, velocity_noise=velocity_noise, acceleration=acceleration,
        )  # fmt: skip


def recording_of(
    table: Table,
    progress: Progress,
    *,
    model: Model | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    missing: Sequence[str | float] = (),
    extra: str = "say",
    time_scale: float | None = None,
    sort: bool | None = None,
    held: str = "auto",
    origin: Sequence[float] | None = None,
    lever_arm: Sequence[float] | None = None,
    latency: Mapping[str, float] | None = None,
    accuracy_floor: float = 0.0,
    position_noise: float = 1.0,
    velocity_noise: float = 0.1,
    acceleration: float = 0.1,
    meta: Mapping[str, Any] | None = None,
) -> Recording:
    """A recording from columns of cells, wherever these come from; options and errors of `read_csv`.

    What the table's `said` holds comes first among the recording's sentences; `progress` is told
    how far the work is; `meta` is kept beside what was read.
    """
    positive = {
        "position_noise": position_noise, "velocity_noise": velocity_noise,
        "acceleration": acceleration, "time_scale": 1.0 if time_scale is None else time_scale,
    }  # fmt: skip
    for name, value in positive.items():
        within(name, value, 0.0, above=True)
    within("accuracy_floor", accuracy_floor, 0.0)
    one_of("extra", extra, ("say", "raise", "ignore"))
    one_of("held", held, HELD)
    _check_kinds(model, missing, columns=columns, units=units, latency=latency)
    arm, plane = _arm(lever_arm), None if origin is None else checked_origin(origin)
    notes = Notes(table.path.name)
    for sentence in table.said:
        notes.say(sentence)
    log = Log.of(table, model, columns or {}, units or {}, missing, extra, notes)
    y, plane = log.measurements(held, arm, plane)
    if np.isnan(y).all():
        raise ValueError(f"{notes.file}: every measurement is lost, nothing can be estimated.")
    progress.at(0.6)
    time, start = log.times(time_scale, y)
    rows = log.rows(time, y, accuracy_floor, plane)
    clock = clock_set(rows)
    rows = log.delayed(rows.take(order(rows, sort, notes)), latency or {})
    rows = merged(rows, notes, clock)
    progress.at(0.9)
    if model is None:
        sigmas = np.array([position_noise, velocity_noise] * 2)
        model = default_model(rows.time, rows.y, log.measured, sigmas, acceleration)
    model = log.noisy(model, rows)
    where = {"start": start, "origin": None if plane is None else list(plane)}
    where = {name: value for name, value in where.items() if value is not None}
    return Recording(
        time=rows.time,
        measurements=rows.y,
        truth=log.truth(rows),
        model=model,
        meta=log.meta() | where | dict(meta or {}),
        **rows.labels,
    )


def write_csv(recording: Recording, path: str | os.PathLike[str]) -> Path:
    """Write a recording as `read_csv` reads it, atomically; returns the path.

    Lost measurements become empty cells. Floats keep every bit. The file holds neither the model
    nor `meta`: `read_csv(path, model=recording.model)` gives the same recording but for `meta`
    (`Recording.save` keeps all).

    Raises FileNotFoundError if the folder does not exist.
    """
    measured, states = component_names(recording.model)
    columns = {"time": recording.time.tolist()}
    columns |= dict(zip(measured, recording.measurements.T.tolist(), strict=True))
    if recording.truth is not None:
        names = [f"truth_{name}" for name in states]
        columns |= dict(zip(names, recording.truth.T.tolist(), strict=True))
    for name in ANNOTATIONS:
        if getattr(recording, name) is not None:
            columns[name] = getattr(recording, name).tolist()
    columns |= _geographic_columns(recording, list(measured))
    return write_table(path, columns)


def _geographic_columns(recording: Recording, measured: Sequence[str]) -> dict[str, Any]:
    """Latitude and longitude of the measured positions, where the recording came in degrees."""
    origin = recording.meta.get("origin")
    if origin is None or not {"px", "py"} <= set(measured):
        return {}
    north, east = (recording.measurements[:, measured.index(name)] for name in ("px", "py"))
    latitude, longitude = from_plane(north, east, origin)
    return {"lat": latitude.tolist(), "lon": longitude.tolist()}


def _check_kinds(model: object, missing: object, **tables: object) -> None:
    examples = {
        "columns": "from navgym's names to the file's, such as {'px': 'north (m)'}",
        "units": "from names to units, such as {'px': 'ft'}",
        "latency": "from names to seconds, such as {'velocity': 0.5}",
    }
    for name, table in tables.items():
        if table is not None and not isinstance(table, Mapping):
            raise ValueError(f"{name} must be a dict {examples[name]}, got {table!r}.")
        for key, value in (table or {}).items():
            if name == "latency":
                within(f"latency of {key}", value, -np.inf)
            elif not isinstance(value, str):
                raise ValueError(f"{name} must be a dict {examples[name]}, got {table!r}.")
    if isinstance(missing, (str, bytes)) or not isinstance(missing, Iterable):
        raise ValueError(  # noqa: TRY004 - as every wrong option
            f"missing must be a list of words or numbers, such as [-9999], got {missing!r}."
        )
    if model is not None and not hasattr(model, "pack"):
        raise ValueError(
            f"model must be a navgym.LinearModel or a navgym.CoordinatedTurnModel, got {model!r}."
        )


def _arm(lever_arm: object) -> Array | None:
    if lever_arm is None:
        return None
    arm = real_array("lever_arm", lever_arm)  # type: ignore[arg-type]
    if arm.shape not in ((2,), (3,)):
        raise ValueError(f"lever_arm must be forward, right (and down), m, got {lever_arm!r}.")
    return arm


def default_model(
    time: Array, y: Array, measured: Sequence[str], sigmas: Array, acceleration: float
) -> LinearModel:
    """White acceleration over the log's own steps, started from its first fixes."""
    rows = [STATES.index(name) for name in measured]
    dt = np.diff(time, prepend=2 * time[0] - time[1]) if len(time) > 1 else np.ones(1)
    spread = np.full((len(y), len(STATES)), np.nan)
    spread[:, rows] = y
    elapsed = time - time[0] + dt[0]
    axes = [_first_state(elapsed, spread[:, i : i + 2], sigmas, acceleration) for i in (0, 2)]
    x0, variance = np.concatenate(axes, axis=1)
    dt = step_of(dt)
    Q = LinearModel.white_acceleration(dt, acceleration).Q
    R, P0 = np.diag(sigmas[rows] ** 2), PRIOR_SIGMAS**2 * np.diag(variance)
    return LinearModel(dt=dt, H=np.eye(4)[rows], Q=Q, R=R, x0=x0, P0=P0)


def _first_state(elapsed: Array, y: Array, sigmas: Array, acceleration: float) -> Array:
    """Position and velocity of one axis at `elapsed` = 0, and below them their variances, (2, 2).

    y (T, 2) is NaN where lost. Variances take in how far the vehicle may have strayed since.
    """
    fixes, velocities = (np.flatnonzero(~np.isnan(column)) for column in y.T)
    first = elapsed[fixes[0]] if len(fixes) else 0.0
    velocity, variance = 0.0, (sigmas[0] / elapsed[0]) ** 2
    if len(velocities):
        k = velocities[0]
        velocity, variance = y[k, 1], sigmas[1] ** 2 + (acceleration * elapsed[k]) ** 2
    elif len(fixes) > 1:
        i, j = fixes[:2]
        gap = elapsed[j] - elapsed[i]
        velocity = (y[j, 0] - y[i, 0]) / gap
        variance = 2 * (sigmas[0] / gap) ** 2 + (acceleration * elapsed[j]) ** 2
    position = y[fixes[0], 0] - velocity * first if len(fixes) else 0.0
    return np.array([[position, velocity], [sigmas[0] ** 2 + variance * first**2, variance]])
