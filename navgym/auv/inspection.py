"""What a recording of positions and velocities, and the file that it came from, show when looked over."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.auv.device_log import Told
from navgym.auv.fields import GEOGRAPHIC, SENSORS
from navgym.auv.geodesy import to_plane
from navgym.auv.log import STATES_3D, Log, component_names
from navgym.core.checks import Array
from navgym.core.notes import Notes
from navgym.core.tables import Table, read_table
from navgym.formats.channels import KINDS, SECOND
from navgym.formats.rows import TIME, owners
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
DISAGREEING = (
    "degrees",
    "frame",
    "axes",
    "units",
    "scale",
    "sign",
    "rotation",
)  # that make noise of no noise
FINE_DEGREE = 1e-3  # °: over so little a plane is the Earth
DIGITS = 3  # of a suggested number


@dataclass(frozen=True, eq=False)
class _Raw:
    """What the file held before the reader sorted and merged its rows.

    Args:
        time: (T,) s, in order.
        columns: (T,) by quantity, m, m/s; NaN where lost.
        sigma: (T, m) the receiver's own accuracies, NaN where it tells none.
        heading: (H,) s and (H,) rad, or None.
        own: (T,) rows of each sensor, where each has rows of its own; else empty.
        names: of the velocities' columns.
        turned: whether the velocity is of a sensor in the vehicle's axes, turned by the heading.
        digits: steps of which positions that came in degrees are multiples in the file, m.
    """

    time: Array
    columns: Mapping[str, Array]
    sigma: Array
    heading: tuple[Array, Array] | None
    own: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    names: tuple[str, str] = ("vx", "vy")
    turned: bool = False
    digits: Mapping[str, float] = field(default_factory=dict)


def evidence(recording: Recording, log: Path, options: Mapping[str, Any]) -> Evidence:
    """Channels, findings and the noise of a log of positions and velocities."""
    names = list(component_names(recording.model)[0])
    known = [n for n in names if n in STATES_3D]
    raw = _raw(recording, log, options)
    channels = _channels(recording, names, raw)
    both = _motion(recording, names)
    findings = [*_of_times(recording, raw, both, channels)]
    if both is not None:
        findings += _of_motion(both, raw, recording.meta.get("columns", {}))
    if raw is not None and not any(f.kind in DISAGREEING for f in findings):
        findings += _accuracy(recording, names, raw, both)
    if any(f.kind in DISAGREEING for f in findings):  # noise of wrong velocities is none
        known, both = [n for n in known if _KIND[n] != "velocity"], None
    lines, words = _noise(recording, known, both, raw)
    track = _track(recording, names)
    return Evidence(channels, findings, lines, words, track)


def _raw(recording: Recording, log: Path, options: Mapping[str, Any]) -> _Raw | None:
    """The columns of a text log, or of a device's; None for other formats."""
    made = {"csv": _of_text, "log": _of_device}.get(str(recording.meta.get("format")))
    if made is None or not log.exists():
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # said when the log was read
        return made(recording, log, options)


def _of_text(recording: Recording, log: Path, options: Mapping[str, Any]) -> _Raw:
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
    columns = {n: held.columns.numbers(n)[index] for n in held.measured if n in held.fields}
    heading = None
    if "heading" in held.fields:
        heading = time[index], held.columns.numbers("heading")[index]
    sigma = held.columns.sigmas(held.measured, 0.0)[index]
    return _Raw(time[index], columns, sigma, heading, digits=_digits(held, recording))


def _digits(held: Log, recording: Recording) -> dict[str, float]:
    """Steps of positions in the file, m, where they came in degrees: metres show them no more."""
    origin = recording.meta.get("origin")
    if not held.round or origin is None:
        return {}
    north, east = to_plane(
        np.array([origin[0] + FINE_DEGREE]), np.array([origin[1] + FINE_DEGREE]), origin, None
    )[0, :2]
    size = np.array([north, east]) / math.radians(FINE_DEGREE)  # m in a radian
    steps = (held.columns.digit(name) for name in GEOGRAPHIC)
    return {n: s * k for n, s, k in zip(("px", "py"), steps, size.tolist(), strict=True)}


def _of_device(recording: Recording, log: Path, options: Mapping[str, Any]) -> _Raw:
    """Each sensor's own rows, which a recording merges and fills with losses of the others."""
    told = Told.of(log, options.get("kind"), options.get("topics"), options.get("model"),
                   options.get("lever_arm") is not None)  # fmt: skip
    held = Log.of(
        told.table, options.get("model"), {**told.columns, **(options.get("columns") or {})},
        {**told.units, **(options.get("units") or {})}, options.get("missing") or (), "ignore",
        Notes(told.table.path.name),
    )  # fmt: skip
    origin = recording.meta.get("origin")
    y, _ = held.measurements(options.get("held") or "auto", None, origin and tuple(origin))
    time = held.columns.times(None).seconds
    start = float(time[0])
    index = np.argsort(time, kind="stable")
    owner = owners(told.channels)[index]
    own = {
        "velocity" if "vn" in KINDS[c.kind] else "position": owner == k
        for k, c in enumerate(told.channels)
    }
    heading = None
    if told.attitude is not None:
        since = (told.attitude.time - int(told.table.cells[TIME][0])) / SECOND
        heading = start + since, told.attitude["heading"]
    columns = {n: y[index, j] for j, n in enumerate(held.measured)}
    sigma = held.columns.sigmas(held.measured, 0.0)[index]
    velocity = next((c for c in told.channels if c.kind == "velocity"), None)
    names = ("vx", "vy")
    if velocity is not None and told.turned:
        names = (f"{velocity.name}.u", f"{velocity.name}.v")
    digits = _digits(held, recording)
    return _Raw(time[index], columns, sigma, heading, own, names, told.turned, digits)


def _time_scale(held: Log, recording: Recording) -> float | None:
    """What the reader made of times whose unit nobody told: the two spans' ratio, if that is a unit."""
    field = held.fields.get("time")
    if field is None or field.unit is not None:
        return None
    found = held.columns.times(None)
    span, own = np.ptp(found.seconds), np.ptp(recording.time)
    near = [u for u in (1e-3, 1e-6, 1e-9) if span > 0.0 and 0.5 < own / (span * u) < 2.0]
    return near[0] if near and found.kind == "number" and not found.guessed else None


def _of_times(
    recording: Recording, raw: _Raw | None, both: Motion | None, channels: list[Channel]
) -> Iterator[Finding]:
    """Gaps and rates: of all rows, and of each sensor, of its own rows and of those with a value."""
    yield from timing.gaps(recording.time, "", both)
    known = timing.long_steps(recording.time)
    if raw is None or not raw.own:
        yield from timing.rate(recording.time)
    else:
        for sensor, mine in raw.own.items():
            yield from timing.gaps(raw.time[mine], sensor, both, known)
            yield from timing.rate(raw.time[mine], sensor)
        known += [s for mine in raw.own.values() for s in timing.long_steps(raw.time[mine])]
    for sensor in dict.fromkeys(c.sensor for c in channels):
        group = [c for c in channels if c.sensor == sensor]
        there = np.all([c.received for c in group], axis=0)
        yield from timing.outage(group[0].time[there], sensor, known)


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
        time, values = _series(recording, j, name, kind, raw, bool(mended))
        values = np.where(_sentinels(values), np.nan, values)
        sensor = kind if kind != "other" else name
        digit = 0.0 if raw is None else raw.digits.get(name, 0.0)
        unit = _UNIT.get(kind, "")
        found.append(Channel(name, sensor, kind, unit, time, values, mended, digit))
    if raw is not None and raw.heading is not None:
        time, heading = raw.heading
        found.append(Channel("heading", "heading", "angle", "rad", time, heading))
    return found


def _series(
    recording: Recording, j: int, name: str, kind: str, raw: _Raw | None, mended: bool
) -> tuple[Array, Array]:
    """Times and values of a component: its sensor's own rows, else the file's, else the recording's."""
    if raw is not None and name in raw.columns and kind in raw.own:
        return raw.time[raw.own[kind]], raw.columns[name][raw.own[kind]]
    # after the reader has dropped repeats and sentinels, the file's own column would say them again
    if raw is not None and name in raw.columns and not raw.own and not mended:
        return raw.time, raw.columns[name]
    return recording.time, recording.measurements[:, j]


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


def _of_motion(both: Motion, raw: _Raw | None, columns: Mapping[str, str]) -> Iterator[Finding]:
    time = psi = None
    if raw is not None:
        both = replace(both, names=(*both.names[:2], *raw.names), geographic="lat" in columns)
    if raw is not None and raw.heading is not None:
        stamps, heading = raw.heading
        there = np.isfinite(heading) & (np.diff(stamps, prepend=-np.inf) > 0.0)
        if there.sum() >= FEWEST:
            time, psi = stamps[there], heading[there]
    turned = raw is not None and raw.turned
    found = [_spelt(f, columns) for f in moving.disagreements(both, psi, time, turned)]
    yield from found
    if psi is not None and time is not None and not found:
        for f in moving.heading_of(both, psi, time):
            yield replace(f, options=()) if raw is not None and raw.own else f  # in rad, by format


def _spelt(finding: Finding, columns: Mapping[str, str]) -> Finding:
    """The finding with options that name the file's columns in place of our quantities."""
    pairs = zip(finding.options[::2], finding.options[1::2], strict=True)
    told = [w for n, v in pairs for w in (n, columns.get(v, v) if n.startswith("columns.") else v)]
    return replace(finding, options=tuple(told))


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
        # a device's accuracy is in m, and rightly holds errors that last longer than samples
        timid = not raw.own and usual > MISLED[1] * seen
        if seen > MISLED[0] * usual or timid:
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
    recording: Recording, known: list[str], both: Motion | None, raw: _Raw | None
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
            digit = 0.0 if raw is None else raw.digits.get(name, 0.0)
            if scatter:  # no value is better than its digits
                scatter = max(scatter, digit / math.sqrt(12.0))
                found.setdefault("position_noise", []).append(scatter)
    # the largest of the axes: a filter that believes too little noise is worse than one that believes too much
    best = {n: max(v) for n, v in found.items() if max(v) > 0.0 and math.isfinite(max(v))}
    units = {"position_noise": "m", "velocity_noise": "m/s", "acceleration": "m/s²/√Hz"}
    lines = [
        (n, f"{best[n]:.{DIGITS}g} {unit}, by differences")
        for n, unit in units.items()
        if n in best
    ]
    # what the receiver tells row by row goes before an option
    own = set() if raw is None else {
        f"{_KIND.get(n, '')}_noise" for j, n in enumerate(names) if np.isfinite(raw.sigma[:, j]).any()
    }  # fmt: skip
    told = [n for n in units if n in best and n not in own] if raw is not None else []
    words = [w for n in told for w in (n, f"{best[n]:.{DIGITS}g}")]
    return lines, tuple(words)


def _track(recording: Recording, names: list[str]) -> tuple[Array, Array] | None:
    p = _columns_of(recording, names, ("px", "py"))
    return None if p is None else (p[:, 0], p[:, 1])
