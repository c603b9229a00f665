"""Tunable parameters, each declared once: kernels, action spaces, searches, docs and plots read it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navgym.core.checks import Array, one_of, real_array, shaped, short

SCALES = ("linear", "log", "log-complement")


@dataclass(frozen=True)
class Parameter:
    """One tunable of a filter.

    Args:
        name: what users call it.
        symbol: the letter that the equations use.
        unit: physical unit, "1" where there is none.
        low: smallest admissible value.
        high: largest admissible value.
        scale: how a search or an agent should walk the range: "linear", "log", or
            "log-complement" (logarithmic in 1 - value).
        default: value of a user who sets nothing.
        integer: whether only whole numbers are admissible.
        equation: where it appears.
        choices: names of the values 0, 1, ... of a categorical parameter.
        at_start: whether it acts at the first sample only, so that no schedule can move it.
        widest: what is admissible, where that is more than searches and agents walk by themselves.
    """

    name: str
    symbol: str
    unit: str
    low: float
    high: float
    scale: str
    default: float
    integer: bool = False
    equation: str = ""
    choices: tuple[str, ...] = ()
    at_start: bool = False
    widest: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        one_of("scale", self.scale, SCALES)
        if not self.low < self.high or not all(map(math.isfinite, self._ends)):
            raise ValueError(
                f"{self.name}: low must be below high, and both on the {self.scale} scale, got "
                f"{self.low}..{self.high}."
            )
        if not self.low <= self.default <= self.high:
            raise ValueError(
                f"{self.name}: default {self.default} outside {self.low}..{self.high}."
            )
        low, high = self.admissible
        if not low <= self.low or not self.high <= high:
            raise ValueError(
                f"{self.name}: widest must hold {self.low}..{self.high}, got {low}..{high}."
            )

    @property
    def _ends(self) -> tuple[float, float]:
        try:
            return self.warp(self.low), self.warp(self.high)
        except ValueError:  # a logarithm of something that has none
            return math.nan, math.nan

    @property
    def admissible(self) -> tuple[float, float]:
        """Ends of what may be given: `widest`, or the range."""
        return self.widest or (self.low, self.high)

    def check(self, value: Any) -> float:
        """`value` (a number, or the name of a choice) as a float that is admissible.

        Raises ValueError naming the parameter, the value and what is admissible.
        """
        if isinstance(value, str):
            if not self.choices:
                raise ValueError(f"{self.name} must be a number, got {value!r}.")
            return float(self.choices.index(one_of(self.name, value, self.choices)))
        try:
            number = float(value)
        except (TypeError, ValueError):
            raise ValueError(f"{self.name} must be a number, got {value!r}.") from None
        low, high = self.admissible
        if not low <= number <= high:
            raise ValueError(
                f"{self.name} must lie in {low:g}..{high:g}{self._unit}, got {number:g}."
            )
        if self.integer and number != round(number):
            raise ValueError(f"{self.name} must be a whole number, got {number:g}.")
        return number

    def admits(self, values: NDArray[Any]) -> bool:
        """Whether `values` (T,) are numbers that `check` lets pass, all at once."""
        if values.dtype.kind not in "fiu" or values.ndim != 1 or not len(values):
            return False
        low, high = self.admissible
        inside = bool(((low <= values) & (values <= high)).all())
        return inside and not (self.integer and (values != np.round(values)).any())

    @property
    def _unit(self) -> str:
        return "" if self.unit == "1" else f" {self.unit}"

    def show(self, value: float) -> float | int | str:
        """`value` as a user would write it: a choice's name, an int, or a float."""
        if self.choices:
            return self.choices[round(value)]
        return round(value) if self.integer else float(value)

    def warp(self, value: float) -> float:
        """`value` on the scale that the parameter is walked on (its logarithm, for instance)."""
        if self.scale == "log":
            return math.log(value)
        return -math.log(1.0 - value) if self.scale == "log-complement" else value

    def unwarp(self, value: float) -> float:
        """Inverse of `warp`."""
        if self.scale == "log":
            return math.exp(value)
        return 1.0 - math.exp(-value) if self.scale == "log-complement" else value


@dataclass(frozen=True)
class ParameterSpace:
    """The parameters of one filter, in the order of its kernel's parameter array."""

    parameters: tuple[Parameter, ...]

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def __len__(self) -> int:
        return len(self.parameters)

    def __getitem__(self, name: str) -> Parameter:
        return self.parameters[self.index(name)]

    @property
    def names(self) -> tuple[str, ...]:
        """Names, in order."""
        return tuple(p.name for p in self.parameters)

    def index(self, name: str) -> int:
        """Column of parameter `name`; ValueError with the nearest name if there is none."""
        return self.names.index(one_of("parameter", name, self.names))

    def subset(self, names: Iterable[str]) -> ParameterSpace:
        """The space of some of the parameters, in the order of `names`."""
        return ParameterSpace(tuple(self[name] for name in names))

    @property
    def defaults(self) -> dict[str, Any]:
        """Default value of each parameter, as a user would write it."""
        return {p.name: p.show(p.default) for p in self.parameters}

    def array(self, values: Mapping[str, Any] | ArrayLike | None = None) -> Array:
        """`values` as the kernel's array, shape (intervals, parameters); missing ones by default.

        Args:
            values: a dict of numbers (or of arrays with one number per decision interval), an
                array (parameters,) or (intervals, parameters) in the space's order, or None.

        Raises:
            ValueError: for unknown names, wrong shapes, values outside their ranges, or a schedule
                of a parameter that acts at the start only.
        """
        if values is None:
            values = {}
        if not isinstance(values, Mapping):
            values = dict(zip(self.names, self._rows(values).T, strict=True))
        for name in values:
            self.index(name)
        columns = [self._column(p, values.get(p.name, p.default)) for p in self.parameters]
        lengths = {len(c) for c in columns} - {1}
        if len(lengths) > 1:
            raise ValueError(f"schedules of different lengths: {sorted(lengths)}.")
        intervals = lengths.pop() if lengths else 1
        table = np.empty((intervals, len(self)))
        for i, column in enumerate(columns):
            table[:, i] = column
        return table

    def _rows(self, values: ArrayLike) -> Array:
        """An array of parameters as (intervals, parameters)."""
        wanted = (
            "Expected: a dict, a list with one dict per recording, or an array (intervals, "
            f"{len(self)}) with {len(self)} columns ({', '.join(self.names)})."
        )
        try:
            table = np.atleast_2d(real_array("parameters", values))
        except ValueError as error:
            raise ValueError(f"{error} {wanted}") from None
        if table.ndim != 2 or table.shape[1] != len(self) or len(table) == 0:
            shape = np.shape(values)
            raise ValueError(f"parameters has the wrong shape, got shape {shape}. {wanted}")
        return table

    @staticmethod
    def _column(parameter: Parameter, value: Any) -> Array:
        if isinstance(value, str) or not np.iterable(value):
            return np.array([parameter.check(value)])
        if isinstance(value, np.ndarray) and parameter.admits(value):
            column = value.astype(np.float64)
        else:  # one by one, so that an error can name the value
            items = list(value)
            if not items or any(np.iterable(v) and not isinstance(v, str) for v in items):
                raise ValueError(f"{parameter.name} must be a number or a list, got {value!r}.")
            column = np.array([parameter.check(v) for v in items])
        if parameter.at_start and (column != column[0]).any():
            raise ValueError(
                f"{parameter.name} acts at the start only, so that it cannot change on the way, got "
                f"{short(value)}: give one number."
            )
        return column

    def table(self) -> Array:
        """Rows (warped low, warped high, scale code, integer) for kernels that map actions."""
        rows = [
            (p.warp(p.low), p.warp(p.high), float(SCALES.index(p.scale)), float(p.integer))
            for p in self.parameters
        ]
        return np.array(rows, dtype=np.float64).reshape(-1, 4)

    def to_unit(self, values: Mapping[str, Any] | None = None) -> Array:
        """Each parameter's place in its warped range, 0 to 1, shape (parameters,)."""
        row = self.array(values)[0]
        pairs = zip(self.parameters, row, strict=True)
        return np.array(
            [(p.warp(v) - p.warp(p.low)) / (p.warp(p.high) - p.warp(p.low)) for p, v in pairs]
        )

    def from_unit(self, unit: ArrayLike) -> dict[str, Any]:
        """Values at `unit` (parameters,), each in 0 to 1: the inverse of `to_unit`."""
        found = {}
        places = real_array("unit", unit)
        shaped("unit", places, (len(self),), "a place per parameter")
        for p, u in zip(self.parameters, places, strict=True):
            value = p.unwarp(p.warp(p.low) + (p.warp(p.high) - p.warp(p.low)) * float(u))
            value = min(max(value, p.low), p.high)
            found[p.name] = p.show(round(value) if p.integer else value)
        return found

    def markdown(self) -> str:
        """A table of the parameters, for manuals."""
        lines = [
            "| parameter | symbol | range | scale | default | where |",
            "|---|---|---|---|---|---|",
        ]
        for p in self.parameters:
            span = ", ".join(p.choices) if p.choices else f"{p.low:g} to {p.high:g}"
            cells = (f"`{p.name}`", p.symbol, span, p.scale, p.show(p.default), p.equation)
            lines.append(f"| {' | '.join(str(cell) for cell in cells)} |")
        return "\n".join(lines)

    @property
    def fingerprint(self) -> str:
        """Short hash of names, ranges and scales: two spaces with the same one are exchangeable."""
        text = repr([(p.name, p.low, p.high, p.scale, p.integer, p.choices) for p in self])
        return hashlib.sha256(text.encode()).hexdigest()[:12]


def parameter_table(
    space: ParameterSpace, parameters: Any, count: int, steps: int, decision_interval: int
) -> Array:
    """Parameters for `count` recordings of `steps` samples, (count or 1, intervals, parameters).

    `parameters` is anything that `ParameterSpace.array` takes, for all of them, or a list with one dict per
    recording. Raises ValueError for what does not fit.
    """
    per_lane = isinstance(parameters, (list, tuple)) and any(
        isinstance(p, Mapping) for p in parameters
    )
    if per_lane and not all(isinstance(p, Mapping) for p in parameters):
        raise ValueError(f"parameters must hold dicts or numbers, not both, got {parameters!r}.")
    if per_lane and len(parameters) not in (1, count):
        raise ValueError(
            f"parameters must hold one dict per recording, got {len(parameters)} for "
            f"{count} recordings."
        )
    rows = [space.array(p) for p in parameters] if per_lane else [space.array(parameters)]
    most = -(-steps // decision_interval)
    for row in rows:
        if len(row) > most:
            raise ValueError(
                f"a schedule for {steps} samples at decision_interval={decision_interval} has at "
                f"most {most} rows, got {len(row)}."
            )
    longest = max(len(row) for row in rows)
    return np.stack([row[np.minimum(np.arange(longest), len(row) - 1)] for row in rows])
