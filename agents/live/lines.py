"""A log that arrives line by line: cells in, a self-tuning filter's estimates out."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from navgym.agents.live.streaming import SelfTuningFilter, Steering
from navgym.auv.csv_log import ANNOTATIONS, STATES, default_model, lost_flags, measured_columns
from navgym.auv.settings import AUVDropoutSettings
from navgym.core.checks import Array, one_of, within
from navgym.core.tables import Table
from navgym.envs.live import LiveEstimate
from navgym.statespace.models import LinearModel

FILTER = AUVDropoutSettings.FILTER  # whose parameters policies set on such a log
SOURCE = Path("input")  # what errors call it
KNOWN = (
    "time", *STATES, "lost", *(f"lost_{n}" for n in STATES), *(f"truth_{n}" for n in STATES),
    *ANNOTATIONS,
)  # fmt: skip
LONGEST = 1000.0  # steps: a longer gap is taken for a wrong time until the next line confirms it
COLUMNS = ("time", *STATES, *(f"std_{name}" for name in STATES), "nis", "fallback")


@dataclass(frozen=True)
class Noise:
    """What the default model of a log believes; see `navgym.auv.csv_log.read_csv`.

    Args:
        position: standard deviation of a measured position, m.
        velocity: of a measured velocity, m/s.
        acceleration: of the vehicle's white acceleration, m/s².
        step: s to the first sample.
    """

    position: float = 1.0
    velocity: float = 0.1
    acceleration: float = 0.1
    step: float = 1.0

    def __post_init__(self) -> None:
        for name in ("position", "velocity", "acceleration", "step"):
            within(name, getattr(self, name), 0.0, above=True)


def estimates(
    lines: Iterable[str],
    policy: Steering,
    noise: Noise,
    notice: Callable[[str], None],
    delimiter: str = ",",
) -> Iterator[str]:
    """Lines of text with the estimate after each line of a log as `navgym.read("csv", ...)` takes it.

    The first line that has every measured position starts the filter. A later line that cannot
    be read, or whose time does not come after the last, is left out with a notice: at sea the
    next one counts. So is one after a gap of over 1000 steps, unless the next goes on from there.

    Args:
        lines: header first.
        policy: of the problem that reads such logs.
        noise: what the model believes.
        notice: told of lines left out, of fall-backs and of restarts.
        delimiter: between cells.

    Raises:
        ValueError: a header without time or measurements, or with columns of unknown meaning; a
            policy of another filter; a delimiter of more than one character.
    """
    if len(delimiter) != 1:
        raise ValueError(f"delimiter must be one character, got {delimiter!r}.")
    SelfTuningFilter(FILTER, policy, LinearModel())  # says what is wrong with the policy
    rows = ((number, line) for number, line in enumerate(lines, start=1) if line.strip())
    header = _cells(next(rows, (0, ""))[1].removeprefix("\ufeff"), delimiter)
    measured = _checked_header(header)
    clock = _Clock(LONGEST * noise.step)
    yield ",".join(COLUMNS)
    tuned: SelfTuningFilter | None = None
    reason: str | None = None
    for number, line in rows:
        try:
            time, y = _sample(header, _cells(line, delimiter), number, measured)
            clock.check(time)
            if tuned is None:
                tuned = _started(time, y, measured, policy, noise)
            found = None if tuned is None else tuned.step(y, time=time)
            clock.last = time
        except ValueError as error:
            notice(f"left out: {error}")
            continue
        if found is None:
            notice(f"time {time:g}: waiting for a first position")
            continue
        if found.fallback != reason and (found.fallback is None or reason is None):
            notice(f"time {time:g}: {_told(found.fallback)}")
        if found.diverged:
            notice(f"time {time:g}: the filter diverged and was started again")
        reason = found.fallback
        yield _written(found)


class _Clock:
    """Times of a log, in which a single wrong one must not silence all that follow.

    Args:
        longest: s; a longer gap is doubted until the next line goes on from there.
    """

    def __init__(self, longest: float) -> None:
        self.longest = longest
        self.last: float | None = None  # time of the last line that was taken
        self.doubted: float | None = None

    def check(self, time: float) -> None:
        """Raise ValueError for a time that is doubted."""
        last, doubted = self.last, self.doubted
        self.doubted = None
        if last is None or time - last <= self.longest:
            return
        if doubted is None or not 0.0 < time - doubted <= self.longest:
            self.doubted = time
            raise ValueError(
                f"time jumps from {last:g} to {time:g}: if the next line goes on from there, so will "
                "the filter."
            )


def _cells(line: str, delimiter: str) -> list[str]:
    """Stripped cells of a line; ValueError for one that is no CSV."""
    try:
        return [
            cell.strip()
            for cell in next(csv.reader([line.rstrip("\r\n")], delimiter=delimiter), [])
        ]
    except csv.Error as error:
        raise ValueError(f"{line!r} is no line of a CSV file: {error}.") from error


def _checked_header(header: Sequence[str]) -> list[str]:
    """Names of the measured columns."""
    if "time" not in header:
        raise ValueError(
            f"the first line must name the columns (time, and px, vx, py, vy or some), got "
            f"{', '.join(header) or 'nothing'}."
        )
    for name in header:
        one_of("column", name, KNOWN)
    if len(set(header)) < len(header):
        raise ValueError(f"two columns have the same name: {', '.join(header)}.")
    return measured_columns(Table(SOURCE, dict.fromkeys(header, ()), ()))


def _sample(
    header: Sequence[str], cells: Sequence[str], number: int, measured: Sequence[str]
) -> tuple[float, Array]:
    """Time and measurement (m,) of one line; ValueError, naming the line, where there is none."""
    if len(cells) != len(header):
        raise ValueError(
            f"{SOURCE}, line {number}: {len(cells)} cells, but the header names {len(header)}."
        )
    table = Table(SOURCE, {h: (cell,) for h, cell in zip(header, cells, strict=True)}, (number,))
    y = np.array([table.numbers(name, gaps=True)[0] for name in measured])
    y[lost_flags(table, measured)[0]] = np.nan
    return float(table.numbers("time")[0]), y


def _started(
    time: float,
    y: Array,
    measured: Sequence[str],
    policy: Steering,
    noise: Noise,
) -> SelfTuningFilter | None:
    """The filter, started by a line's position (and velocity); None where a position is missing."""
    known = dict(zip(measured, y.tolist(), strict=True))
    if any(math.isnan(known.get(name, 0.0)) for name in ("px", "py")):
        return None
    sigmas = np.array([noise.position, noise.velocity] * 2)
    start = default_model(np.array([time]), y[None], measured, sigmas, noise.acceleration)
    before = start.x0.copy()
    before[[0, 2]] += before[[1, 3]] * (1.0 - noise.step)  # made for a step of 1 s

    def model(step: float) -> LinearModel:
        Q = LinearModel.white_acceleration(step, noise.acceleration).Q
        return LinearModel(dt=step, H=start.H, Q=Q, R=start.R, x0=before, P0=start.P0)

    return SelfTuningFilter(FILTER, policy, model, interval=noise.step)


def _told(reason: str | None) -> str:
    if reason is None:
        return "the policy sets the parameters again"
    return f"fell back to the best fixed parameters: {reason}"


def _written(found: LiveEstimate) -> str:
    numbers = [found.time, *found.state.tolist(), *np.sqrt(found.covariance.diagonal()).tolist()]
    cells = [f"{value:.10g}" for value in numbers]
    nis = "" if math.isnan(found.nis) else f"{found.nis:.6g}"
    return ",".join([*cells, nis, "0" if found.fallback is None else "1"])
