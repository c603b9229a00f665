"""A user's own log: plain text in, plain text out."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array, one_of, within
from navgym.core.tables import Table, read_table, write_table
from navgym.statespace.models import LinearModel, step_of
from navgym.statespace.recording import Model, Recording

STATES = ("px", "vx", "py", "vy")
ANNOTATIONS = ("regime", "process_scale", "measurement_scale")  # optional fields of Recording
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
    largest: float = 2e9,
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
    del units, decimal, encoding, missing, sort, held, origin, lever_arm, latency  # next commits
    del accuracy_floor, largest
    delimiter = "," if delimiter is None else delimiter
    time_scale = 1.0 if time_scale is None else time_scale
    scales = {
        "time_scale": time_scale, "position_noise": position_noise,
        "velocity_noise": velocity_noise, "acceleration": acceleration,
    }  # fmt: skip
    for name, value in scales.items():
        within(name, value, 0.0, above=True)
    one_of("extra", extra, ("say", "raise", "ignore"))
    _check_kinds(columns, model)
    table = _renamed(read_table(path, delimiter), columns, model)
    measured, states = _component_names(model) if model else (measured_columns(table), STATES)
    if extra != "ignore":
        _refuse_strangers(table, measured, states)
    time = table.increasing("time", time_scale, "Say which it is with columns={'time': ...}.")
    y = np.stack([table.numbers(name, gaps=True) for name in measured], axis=-1)
    y[lost_flags(table, measured)] = np.nan
    if np.isnan(y).all():
        raise ValueError(f"{table.path.name}: every measurement is lost, nothing can be estimated.")
    if model is None:
        sigmas = np.array([position_noise, velocity_noise] * 2)
        model = default_model(time, y, measured, sigmas, acceleration)
    return Recording(
        time=time,
        measurements=y,
        truth=_truth(table, states, time),
        model=model,
        meta={"format": "csv", "file": table.path.name},
        **{name: table.numbers(name) for name in ANNOTATIONS if name in table},
    )


def write_csv(recording: Recording, path: str | os.PathLike[str]) -> Path:
    """Write a recording as `read_csv` reads it, atomically; returns the path.

    Lost measurements become empty cells. Floats keep every bit. The file holds neither the model
    nor `meta`: `read_csv(path, model=recording.model)` gives the same recording but for `meta`
    (`Recording.save` keeps all).

    Raises FileNotFoundError if the folder does not exist.
    """
    measured, states = _component_names(recording.model)
    columns = {"time": recording.time.tolist()}
    columns |= dict(zip(measured, recording.measurements.T.tolist(), strict=True))
    if recording.truth is not None:
        names = [f"truth_{name}" for name in states]
        columns |= dict(zip(names, recording.truth.T.tolist(), strict=True))
    for name in ANNOTATIONS:
        if getattr(recording, name) is not None:
            columns[name] = getattr(recording, name).tolist()
    return write_table(path, columns)


def _component_names(model: Model) -> tuple[Sequence[str], Sequence[str]]:
    """Names of a model's measurements and of its states."""
    usual = model.n == 4 and tuple(model.position) == (0, 2) and tuple(model.velocity) == (1, 3)
    states = STATES if usual else [f"x{i + 1}" for i in range(model.n)]
    H = np.asarray(getattr(model, "H", np.empty(0)))
    selects = H.ndim == 2 and (np.sort(H, axis=1) == [0.0] * (model.n - 1) + [1.0]).all()
    rows = H.argmax(axis=1) if selects else []
    if usual and len(set(rows)) == model.m:
        return [STATES[i] for i in rows], states
    return [f"z{i + 1}" for i in range(model.m)], states


def _meanings(measured: Sequence[str], states: Sequence[str]) -> list[str]:
    """Every column name that has a meaning beside these measurements and states."""
    flags = ["lost", *(f"lost_{name}" for name in measured)]
    return ["time", *measured, *flags, *(f"truth_{name}" for name in states), *ANNOTATIONS]


def _check_kinds(columns: object, model: object) -> None:
    if columns is not None and not isinstance(columns, Mapping):
        raise ValueError(
            "columns must be a dict from navgym's names to the file's, such as {'px': 'north (m)'}, "
            f"got {columns!r}."
        )
    if model is not None and not hasattr(model, "pack"):
        raise ValueError(
            f"model must be a navgym.LinearModel or a navgym.CoordinatedTurnModel, got {model!r}."
        )


def _renamed(table: Table, columns: Mapping[str, str] | None, model: Model | None) -> Table:
    known = _meanings(*(_component_names(model) if model else (STATES, STATES)))
    for name in columns or {}:
        one_of("name in columns:", name, known)
    return table.renamed(columns or {})


def measured_columns(table: Table) -> list[str]:
    """Those of px, vx, py, vy that a table has; ValueError where it has none."""
    measured = [name for name in STATES if name in table]
    if not measured:
        raise ValueError(
            f"{table.path.name} has no measurement column: name at least one of {', '.join(STATES)}, "
            f"or say which it is with columns={{'px': ...}}. It holds: {', '.join(table.cells)}."
        )
    return measured


def _refuse_strangers(table: Table, measured: Sequence[str], states: Sequence[str]) -> None:
    known = _meanings([*measured, *(name for name in STATES if name not in measured)], states)
    for name in table.cells:
        try:
            one_of(f"column of {table.path.name}:", name, known)
        except ValueError as error:
            raise ValueError(
                f"{error} Say what it holds with columns={{'px': {name!r}}} or the like, "
                "or leave such columns out with extra='ignore'."
            ) from None


def lost_flags(table: Table, measured: Sequence[str]) -> NDArray[np.bool_]:
    """Flags of the columns lost and lost_*, (T, m)."""
    lost = np.zeros((len(table.lines), len(measured)), dtype=np.bool_)
    for j, name in enumerate(measured):
        for column in ("lost", f"lost_{name}"):
            if column in table:
                lost[:, j] |= table.flags(column)
    return lost


def _truth(table: Table, states: Sequence[str], time: Array) -> Array | None:
    """True states, (T, n), or None if the file has none."""
    names = [f"truth_{name}" for name in states]
    present = [name for name in names if name in table]
    if not present:
        return None
    gone = [name for name in names if name not in table]
    remedy = "Truth is needed in every row: fill it in, or remove the truth columns."
    if states is STATES and gone == ["truth_vx", "truth_vy"] and len(time) > 1:
        x, y = (table.numbers(name, remedy=remedy) for name in present)
        return np.stack([x, np.gradient(x, time), y, np.gradient(y, time)], axis=-1)
    if gone:
        raise ValueError(
            f"{table.path.name} has {', '.join(present)} but not {', '.join(gone)}: truth needs "
            "every state, or at least truth_px and truth_py; add them or remove the truth columns."
        )
    return table.matrix(names, remedy)


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
