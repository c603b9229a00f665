"""A log that arrives line by line: cells in, a self-tuning filter's estimates out."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from navgym.agents.live.clock import Clock
from navgym.agents.live.notices import Notices
from navgym.agents.live.streaming import SelfTuningFilter, Steering
from navgym.agents.mixture.live import LiveMixture
from navgym.agents.mixture.mixture import Mixture
from navgym.auv.fields import ANNOTATIONS, GEOGRAPHIC, assign
from navgym.auv.geodesy import checked_origin, from_plane, to_plane
from navgym.auv.intake import Model
from navgym.auv.log import STATES
from navgym.auv.settings import AUVDropoutSettings
from navgym.core.checks import Array, within
from navgym.core.layout import LOST
from navgym.core.tables import FLAGS, Table
from navgym.envs.live import LiveEstimate
from navgym.statespace.models import LinearModel

FILTER = AUVDropoutSettings.FILTER  # whose parameters policies set on such a log
TIME = "time"
MEASURED = (*STATES, *GEOGRAPHIC)
UNSEEN = (*(f"truth_{name}" for name in STATES), *ANNOTATIONS)  # known, and of no use to a filter
KNOWN = (TIME, *MEASURED, "lost", *(f"lost_{name}" for name in MEASURED), *UNSEEN)
SOURCE = Path("input")  # what errors call it
COLUMNS = (TIME, *STATES, *(f"std_{name}" for name in STATES), "nis", "fallback")
LONGEST_LINE = 100_000  # characters: a longer line is no row of a log
START_SIGMAS = 10.0  # the filter is started from a line that it then takes in: that weighs 1 %
SAME_TIME = Decimal("1e-6")  # s by which a second sensor's line of one time comes after the first


@dataclass(frozen=True)
class Noise:
    """What the default model of a log believes; see `navgym.auv.csv_log.read_csv`.

    Args:
        position: standard deviation of a measured position, m.
        velocity: of a measured velocity, m/s.
        acceleration: of the vehicle's white acceleration, m/s²/√Hz.
        step: s to the first sample.
    """

    position: float = 1.0
    velocity: float = 0.1
    acceleration: float = 0.1
    step: float = 1.0

    def __post_init__(self) -> None:
        for name in ("position", "velocity", "acceleration", "step"):
            within(name, getattr(self, name), 0.0, above=True)


@dataclass(frozen=True)
class Format:
    """How the lines are written.

    Args:
        delimiter: one character between cells.
        columns: the log's names where they differ, by ours: {"px": "north (m)"}.
        units: of quantities or columns, such as {"px": "km"}, where the names do not tell them.
        time_scale: seconds per unit of its time; by default the unit's, or 1.

    Raises ValueError for a longer delimiter, or a scale that is not positive.
    """

    delimiter: str = ","
    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    time_scale: float | None = None

    def __post_init__(self) -> None:
        if len(self.delimiter) != 1:
            raise ValueError(f"delimiter must be one character, got {self.delimiter!r}.")
        if self.time_scale is not None:
            within("time_scale", self.time_scale, 0.0, above=True)


def estimates(
    lines: Iterable[str],
    policy: Steering | Mixture,
    noise: Noise,
    notice: Callable[[str], None],
    form: Format = Format(),
) -> Generator[str]:
    """Lines of text with the estimate after each line of a log.

    A line that cannot be read, or whose time comes late or twice, is left out, and the next one
    counts. Where the clock was set (see `Clock`) the filter begins anew. Two lines of one time that
    hold different components are two sensors: both count. Times come out as they went in.

    Args:
        lines: header first.
        policy: of the problem that reads such logs; or a mixture of fixed filters.
        noise: what the model believes.
        notice: told of lines left out, of fall-backs and of restarts; of the same, not for ever.
        form: how the lines are written.

    Raises:
        ValueError: a header without time or measurements; a policy of another filter.
    """
    _live(policy, LinearModel(), 1.0)  # says what is wrong with the policy
    rows = ((number, line) for number, line in enumerate(lines, start=1) if line.strip())
    told = Notices(notice)
    header = _Header.of(next(rows, (0, ""))[1], form, told)
    yield ",".join([*COLUMNS, *(GEOGRAPHIC if header.round else ())])
    with told:
        yield from _Log(header, policy, noise, told).answers(rows)


class _Log:
    """A log under way.

    Args:
        header: of the lines.
        policy, noise, told: as `estimates` has them.
    """

    def __init__(
        self, header: _Header, policy: Steering | Mixture, noise: Noise, told: Notices
    ) -> None:
        self.header, self.policy, self.noise, self.told = header, policy, noise, told
        self.clock, self.plane = Clock(noise.step), _Plane()
        self.heard = np.zeros(len(header.measured), dtype=np.bool_)  # at the time of the last line
        self.late = Decimal(0)  # s that it has been put off by
        self.tuned: SelfTuningFilter | LiveMixture | None = None
        self.reason: str | None = None

    def answers(self, rows: Iterable[tuple[int, str]]) -> Iterator[str]:
        """A line for each line that is taken in, once there is a first position."""
        for number, line in rows:
            try:
                text, time, cells = self.header.sample(line)
                found = self._taken(number, time, self._flat(cells))
            except ValueError as error:
                self.told("left out", f"left out, line {number}: {error}")
                continue
            if found is None:
                self.told("waiting", f"time {text}: waiting for a first position")
                continue
            self._tell(found, text)
            yield ",".join([_written(found, text), *self._round(found)])

    def _flat(self, cells: Mapping[str, float]) -> Array:
        """The measurement (m,) in m and m/s."""
        known = dict(cells)
        if self.header.round:
            known["px"], known["py"] = self.plane.flat([cells[name] for name in GEOGRAPHIC])
        return np.array([known[name] for name in self.header.measured])

    def _round(self, found: LiveEstimate) -> list[str]:
        return self.plane.written(found.state) if self.header.round else []

    def _taken(self, number: int, time: Decimal, y: Array) -> LiveEstimate | None:
        """The estimate after a sample, None before the first; ValueError for one that is left out."""
        received, last = ~np.isnan(y), self.clock.last
        if time == last and self.tuned is not None and not (received & self.heard).any():
            self.heard |= received
            self.late += SAME_TIME
            return self.tuned.step(y, time=time + self.late)
        if not self.clock.goes_on(time):
            what = f"the clock was set from {last} to {time}: the filter begins anew"
            self.told("clock", f"line {number}: {what}")
            self.tuned = None
        if self.tuned is None:
            self.tuned = _started(y, self.header.measured, self.policy, self.noise)
        self.heard, self.late = received, Decimal(0)
        return None if self.tuned is None else self.tuned.step(y, time=time)

    def _tell(self, found: LiveEstimate, text: str) -> None:
        """Say what has changed."""
        if found.fallback is None and self.reason is not None:
            self.told("back", f"time {text}: the policy sets the parameters again")
        elif found.fallback is not None and self.reason is None:
            what = f"fell back to the best fixed parameters: {found.fallback}"
            self.told("fell back", f"time {text}: {what}")
        if found.diverged:
            self.told("restarts", f"time {text}: the filter lost the track and was started again")
        self.reason = found.fallback


@dataclass(frozen=True)
class _Header:
    """The columns of a log.

    Args:
        names: what each holds, "" for one that says nothing to a filter.
        scales: of the quantities to s, m, m/s or rad.
        form: how the lines are written.
    """

    names: tuple[str, ...]
    scales: Mapping[str, float]
    form: Format

    @classmethod
    def of(cls, line: str, form: Format, told: Notices) -> _Header:
        """From the first line; ValueError where it names no time or measurement, or one twice.

        Names are understood as `navgym.read("csv", ...)` understands them, units among them.
        """
        _refuse_long(line)
        given = _cells(line.removeprefix("\ufeff"), form.delimiter)
        if len(set(given)) < len(given):
            raise ValueError(f"two columns have the same name: {', '.join(given)}.")
        table = Table(SOURCE, dict.fromkeys(given, ()), ())
        fields = assign(table, KNOWN, form.columns, form.units)
        held = {field.column: quantity for quantity, field in fields.items()}
        if TIME not in fields or not set(MEASURED) & fields.keys():
            raise ValueError(
                "the first line must name the columns (time, and px, vx, py, vy or some, or lat and "
                f"lon), got {', '.join(given) or 'nothing'}: say which is which with --read "
                "columns.px NAME."
            )
        foreign = [name for name in given if name not in held]
        if foreign:
            told("columns", f"columns of unknown meaning, not looked at: {', '.join(foreign)}")
        scales = {quantity: field.scale(SOURCE.name) for quantity, field in fields.items()}
        if form.time_scale is not None:
            scales[TIME] = form.time_scale
        return cls(tuple(held.get(name, "") for name in given), scales, form)

    @property
    def round(self) -> bool:
        """Whether positions are in latitude and longitude."""
        return set(GEOGRAPHIC) <= set(self.names)

    @property
    def measured(self) -> tuple[str, ...]:
        """The measurements, in the order of the states."""
        there = {*self.names, *(("px", "py") if self.round else ())}
        return tuple(name for name in STATES if name in there)

    def sample(self, line: str) -> tuple[str, Decimal, dict[str, float]]:
        """Time as text and in s, and what was measured, NaN where lost; ValueError for none."""
        _refuse_long(line)
        cells = _cells(line, self.form.delimiter)
        if len(cells) != len(self.names):
            raise ValueError(f"{len(cells)} cells, but the header names {len(self.names)}.")
        found = dict(zip(self.names, cells, strict=True))
        text = found[TIME]
        if not math.isfinite(_number(text)):
            raise ValueError(f"column 'time' must be a finite number, got {text!r}.")
        scale, time = self.scales[TIME], Decimal(text)
        if scale != 1.0:
            time *= Decimal(str(scale))
        wanted = (name for name in MEASURED if name in found)
        return text, time, {name: self._measured(found, name) for name in wanted}

    def _measured(self, found: Mapping[str, str], name: str) -> float:
        """A cell as a number in m, m/s or rad, NaN where it was lost."""
        gone = False
        for column in ("lost", f"lost_{name}"):
            flag = found.get(column, "0")
            if flag.lower() not in FLAGS:
                raise ValueError(f"column {column!r} must be 0, 1, true or false, got {flag!r}.")
            gone = gone or FLAGS[flag.lower()]
        cell = found[name]
        value = math.nan if cell.lower() in LOST else _number(cell)
        if not math.isfinite(value) and cell.lower() not in LOST:
            raise ValueError(
                f"column {name!r} must be a finite number, or nothing where lost, got {cell!r}."
            )
        return math.nan if gone else value * self.scales[name]


class _Plane:
    """Metres north and east of the first position of a log in latitude and longitude, and back."""

    def __init__(self) -> None:
        self._origin: tuple[float, float, float] | None = None

    def flat(self, angles: Sequence[float]) -> Array:
        """px, py of latitude and longitude, rad; NaN where one is lost."""
        lat, lon = (math.degrees(angle) for angle in angles)
        if math.isnan(lat) or math.isnan(lon):
            return np.full(2, np.nan)
        if self._origin is None:
            self._origin = checked_origin((lat, lon))
        checked_origin((lat, lon))
        return to_plane(lat, lon, self._origin, None)[:2]

    def written(self, state: Array) -> list[str]:
        """Latitude and longitude of a state, degrees, as text."""
        assert self._origin is not None
        return [f"{float(angle):.9f}" for angle in from_plane(state[0], state[2], self._origin)]


def _refuse_long(line: str) -> None:
    if len(line) >= LONGEST_LINE:
        raise ValueError(f"it begins with {line[:20]!r} and has {LONGEST_LINE} characters or more.")


def _cells(line: str, delimiter: str) -> list[str]:
    """Stripped cells of a line; ValueError for one that is no CSV."""
    try:
        cells = next(csv.reader([line.rstrip("\r\n")], delimiter=delimiter), [])
    except csv.Error as error:
        raise ValueError(f"{line[:80]!r} is no line of a CSV file: {error}.") from error
    return [cell.strip() for cell in cells]


def _number(cell: str) -> float:
    """A cell as a float, NaN if it is none ("1_000" is one to Python, but not in a log)."""
    try:
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan


def _started(
    y: Array, measured: Sequence[str], policy: Steering | Mixture, noise: Noise
) -> SelfTuningFilter | LiveMixture | None:
    """The filter, started by a line's position (and velocity); None where a position is missing."""
    known = dict(zip(measured, y.tolist(), strict=True))
    if any(math.isnan(known.get(name, 0.0)) for name in ("px", "py")):
        return None
    axes = [_start(known.get(p), known.get(v), noise) for p, v in (("px", "vx"), ("py", "vy"))]
    x0 = np.concatenate([x for x, _ in axes])
    P0 = np.zeros((4, 4))
    P0[:2, :2], P0[2:, 2:] = axes[0][1], axes[1][1]
    rows = [STATES.index(name) for name in measured]
    H, R = np.eye(4)[rows], np.diag(np.array([noise.position, noise.velocity] * 2)[rows] ** 2)

    def model(step: float) -> LinearModel:
        Q = LinearModel.white_acceleration(step, noise.acceleration).Q
        return LinearModel(dt=step, H=H, Q=Q, R=R, x0=x0, P0=P0)

    return _live(policy, model, noise.step)


def _live(policy: Steering | Mixture, model: Model, step: float) -> SelfTuningFilter | LiveMixture:
    """What filters live data as `policy` says."""
    if isinstance(policy, Mixture):
        return LiveMixture(policy, model, interval=step)
    return SelfTuningFilter(FILTER, policy, model, interval=step)


def _start(p: float | None, v: float | None, noise: Noise) -> tuple[Array, NDArray[np.float64]]:
    """State and covariance of one axis a step before its first position (0 if it has none)."""
    moving = v is not None and not math.isnan(v)
    velocity = v if moving and v is not None else 0.0
    spread = noise.velocity if moving else noise.position / noise.step
    x = np.array([(p or 0.0) - velocity * noise.step, velocity])
    variances = [noise.position**2 + (spread * noise.step) ** 2, spread**2]
    return x, START_SIGMAS**2 * np.diag(variances)


def _written(found: LiveEstimate, text: str) -> str:
    numbers = [*found.state.tolist(), *np.sqrt(found.covariance.diagonal()).tolist()]
    nis = "" if math.isnan(found.nis) else f"{found.nis:.6g}"
    cells = (f"{value:.10g}" for value in numbers)
    return ",".join([text, *cells, nis, "0" if found.fallback is None else "1"])
