"""What a recording of positions and velocities, and the file that it came from, show when looked over."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from navgym.auv.fields import SENSORS
from navgym.auv.log import STATES_3D, Log, component_names
from navgym.core.checks import Array
from navgym.core.notes import Notes
from navgym.core.tables import Table, read_table
from navgym.inspection import motion as moving
from navgym.inspection import noise, timing
from navgym.inspection.findings import Channel, Evidence, Finding
from navgym.inspection.motion import Motion
from navgym.inspection.series import FEWEST
from navgym.statespace.recording import Recording

MISLED = (
    4.0,
    100.0,
)  # times: scatter over the receiver's own accuracy, and the accuracy over the scatter
DIGITS = 3  # of a suggested number


@dataclass(frozen=True, eq=False)
class _Raw:
    """What the file held before the reader mended it.

    Args:
        time: (T,) s, in order.
        columns: (T,) by quantity, m, m/s, rad.
        sigma: (T, m) the receiver's own accuracies, NaN where it tells none.
    """

    time: Array
    columns: Mapping[str, Array]
    sigma: Array


def evidence(recording: Recording, log: Path, options: Mapping[str, Any]) -> Evidence:
    """Channels, findings and the noise of a log of positions and velocities."""
    names = list(component_names(recording.model)[0])
    known = [n for n in names if n in STATES_3D]
    raw = _raw(recording, log, options)
    channels = _channels(recording, names, raw)
    both = _motion(recording, names)
    findings = [*timing.gaps(recording.time, "", both), *timing.rate(recording.time)]
    heading = None if raw is None else raw.columns.get("heading")
    if both is not None:
        findings += _of_motion(both, heading, raw)
    if raw is not None:
        findings += _accuracy(recording, names, raw, both)
    lines, words = _noise(recording, known, both)
    track = _track(recording, names)
    return Evidence(channels, findings, lines, words, track)


def _raw(recording: Recording, log: Path, options: Mapping[str, Any]) -> _Raw | None:
    """The columns of a text log; None for other formats."""
    if recording.meta.get("format") != "csv" or not log.is_file():
        return None
    told = {n: options.get(n) for n in ("delimiter", "decimal", "encoding")}
    table: Table = read_table(
        log, told["delimiter"], decimal=told["decimal"], encoding=told["encoding"]
    )
    held = Log.of(
        table, options.get("model"), options.get("columns") or {}, options.get("units") or {},
        options.get("missing") or (), "ignore", Notes(table.path.name),
    )  # fmt: skip
    y = np.full((len(table), len(held.measured)), np.nan)
    time, _ = held.times(options.get("time_scale") or _time_scale(held, recording), y)
    index = np.argsort(time, kind="stable")
    wanted = [n for n in (*held.measured, "heading") if n in held.fields]
    columns = {n: held.columns.numbers(n)[index] for n in wanted}
    return _Raw(time[index], columns, held.columns.sigmas(held.measured, 0.0)[index])


def _time_scale(held: Log, recording: Recording) -> float | None:
    """What the reader made of times whose unit nobody told: the two spans' ratio, if that is a unit."""
    field = held.fields.get("time")
    if field is None or field.unit is not None:
        return None
    found = held.columns.times(None)
    span, own = np.ptp(found.seconds), np.ptp(recording.time)
    near = [u for u in (1e-3, 1e-6, 1e-9) if span > 0.0 and 0.5 < own / (span * u) < 2.0]
    return near[0] if near and found.kind == "number" and not found.guessed else None


_KIND = {n: sensor for sensor, names in SENSORS.items() for n in names}
_UNIT = {"position": "m", "velocity": "m/s"}


def _channels(recording: Recording, names: list[str], raw: _Raw | None) -> list[Channel]:
    """Series before the reader mended them, where the file tells; else what is in the recording."""
    mended = frozenset(
        kind for kind, words in (("held", "taken for held"), ("held", "repeat the values"))
        if any(words in str(s) for s in recording.meta.get("reading", ()))
    )  # fmt: skip
    found = []
    for j, name in enumerate(names):
        kind = _KIND.get(name, "other")
        own = raw.columns.get(name) if raw is not None else None
        # after the reader has dropped repeats and sentinels, the file's own column would say them again
        time, values = (raw.time, own) if own is not None and raw is not None and not mended else (
            recording.time, recording.measurements[:, j]
        )  # fmt: skip
        values = np.where(_sentinels(values), np.nan, values)
        found.append(
            Channel(
                name,
                kind if kind != "other" else name,
                kind,
                _UNIT.get(kind, ""),
                time,
                values,
                mended,
            )
        )
    if raw is not None and "heading" in raw.columns:
        found.append(
            Channel("heading", "heading", "angle", "rad", raw.time, raw.columns["heading"])
        )
    return found


def _sentinels(values: Array) -> Any:
    from navgym.auv.rows import sentinel

    mark = sentinel(values)
    return np.zeros(len(values), np.bool_) if mark is None else values == mark


def _columns_of(recording: Recording, names: list[str], wanted: tuple[str, ...]) -> Array | None:
    if not set(wanted) <= set(names):
        return None
    return np.stack([recording.measurements[:, names.index(n)] for n in wanted], axis=-1)


def _motion(recording: Recording, names: list[str]) -> Motion | None:
    p, v = (_columns_of(recording, names, w) for w in (("px", "py"), ("vx", "vy")))
    return None if p is None or v is None else Motion.of(recording.time, p, v)


def _of_motion(both: Motion, heading: Array | None, raw: _Raw | None) -> Iterator[Finding]:
    time = psi = None
    if heading is not None and raw is not None:
        there = np.isfinite(heading) & (np.diff(raw.time, prepend=-np.inf) > 0.0)
        if there.sum() >= FEWEST:
            time, psi = raw.time[there], heading[there]
    found = moving.disagreements(both, psi, time)
    yield from found
    if psi is not None and time is not None and not found:
        yield from moving.heading_of(both, psi, time)


def _accuracy(
    recording: Recording, names: list[str], raw: _Raw, both: Motion | None
) -> Iterator[Finding]:
    """Accuracies that the receiver's own values belie."""
    for j, name in enumerate(names):
        told = (
            raw.sigma[:, j][np.isfinite(raw.sigma[:, j])] if j < raw.sigma.shape[1] else np.empty(0)
        )
        seen = _scatter(recording, j, name, both)
        if len(told) < FEWEST or not seen:
            continue
        usual = float(np.median(told))
        if seen > MISLED[0] * usual or usual > MISLED[1] * seen:
            yield Finding(
                "accuracy", name,
                f"the receiver tells {usual:.3g} {_UNIT.get(_KIND.get(name, ''), '')} (median), and its values scatter by "
                f"{seen:.3g}",
                f"check the unit of the accuracies, or pass accuracy_floor={seen:.2g}",
                ("accuracy_floor", f"{seen:.2g}") if seen > usual else (),
            )  # fmt: skip


def _scatter(recording: Recording, j: int, name: str, both: Motion | None) -> float | None:
    """Deviation of a component's noise, by its differences."""
    if _KIND.get(name) == "position" and both is not None:
        return noise.of_fixes(both)
    there = ~recording.lost[:, j]
    x = recording.measurements[there, j]
    if len(x) < FEWEST:
        return None
    if _KIND.get(name) == "position":
        return noise.of_bends(x)
    found = noise.white_and_walk(recording.time[there], x)
    return None if found is None else found[0]


def _noise(
    recording: Recording, known: list[str], both: Motion | None
) -> tuple[list[tuple[str, str]], tuple[str, ...]]:
    """What differences suggest, as lines, and as options of the reader."""
    names = list(component_names(recording.model)[0])
    found: dict[str, list[float]] = {}
    for name in known:
        j = names.index(name)
        there = ~recording.lost[:, j]
        if _KIND[name] == "velocity":
            each = noise.white_and_walk(recording.time[there], recording.measurements[there, j])
            if each is not None:
                found.setdefault("velocity_noise", []).append(each[0])
                found.setdefault("acceleration", []).append(each[1])
        else:
            scatter = _scatter(recording, j, name, both)
            if scatter:
                found.setdefault("position_noise", []).append(scatter)
    # the largest of the axes: a filter that believes too little noise is worse than one that believes too much
    best = {n: max(v) for n, v in found.items() if max(v) > 0.0 and math.isfinite(max(v))}
    units = {"position_noise": "m", "velocity_noise": "m/s", "acceleration": "m/s²/√Hz"}
    lines = [
        (n, f"{best[n]:.{DIGITS}g} {unit}, by differences")
        for n, unit in units.items()
        if n in best
    ]
    told = recording.meta.get("format") == "csv"
    words = [w for n in units if n in best for w in (n, f"{best[n]:.{DIGITS}g}")] if told else []
    return lines, tuple(words)


def _track(recording: Recording, names: list[str]) -> tuple[Array, Array] | None:
    p = _columns_of(recording, names, ("px", "py"))
    return None if p is None else (p[:, 0], p[:, 1])
