"""The contract with somebody's program: a TOML file that declares parameters and columns.

format = "toml"                     # how {parameters} is written: see navgym export --help

[parameters.accel_noise]
unit = "m/s²"
range = [0.01, 100.0]
scale = "log"                       # log, linear or log-complement; by default log from 0 upwards
default = 1.0
group = "process"                   # --free process
target = "EKF2_ACC_NOISE"           # what the program calls it
prior = 2.0                         # --prior: a factor (log) or an amount (linear), one deviation

[output]
innovation = ["nu_x", "nu_y"]
variance = ["s_x", "s_y"]
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from navgym.core.checks import one_of
from navgym.core.parameters import Parameter, ParameterSpace
from navgym.core.storage import read_toml
from navgym.tuning import declared
from navgym.tuning.export.formats import FORMATS
from navgym.tuning.programs.output import Columns

PARAMETER = (
    "unit", "range", "scale", "default", "group", "target", "prior", "integer", "choices", "symbol",
    "about",
)  # fmt: skip


@dataclass(frozen=True)
class Contract:
    """What a program can be told, and what it says.

    Args:
        space: its parameters.
        format: how the file of parameters is written.
        base: text of a file of the program's, in the same format, in which they are set; "" for none.
        columns: what columns of the output mean.
        groups: name of each parameter's group, of those that have one.
        targets: what the program calls a parameter, of those that it calls otherwise.
        priors: one standard deviation of what is believed of a parameter, on its own scale.
    """

    space: ParameterSpace
    format: str = "toml"
    base: str = ""
    columns: Columns = field(default_factory=Columns)
    groups: Mapping[str, str] = field(default_factory=dict)
    targets: Mapping[str, str] = field(default_factory=dict)
    priors: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        FORMATS[one_of("format", self.format, FORMATS)].check(self.named(self.space.defaults))

    @classmethod
    def load(cls, path: Path) -> Contract:
        """From a file.

        Raises:
            FileNotFoundError: there is none.
            ValueError: what cannot be, with the file's name and the remedy.
        """
        told = read_toml(path)
        try:
            return cls.of_dict(told, path.parent)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error

    @classmethod
    def of_dict(cls, told: Mapping[str, Any], beside: Path = Path()) -> Contract:
        """From what a file holds.

        Args:
            told: its content.
            beside: folder that a `base` is looked for in.
        """
        for name in told:
            one_of("entry", name, ("format", "base", "parameters", "output"))
        tables = told.get("parameters")
        if not isinstance(tables, Mapping) or not tables:
            raise ValueError(
                "it declares no parameters: write [parameters.NAME] with range and default."
            )
        space = ParameterSpace(tuple(parameter(name, each) for name, each in tables.items()))
        columns = declared.from_dict(Columns, _listed(told.get("output", {})))
        own = {key: {n: t[key] for n, t in tables.items() if key in t} for key in ("group", "target", "prior")}  # fmt: skip
        base = beside / told["base"] if "base" in told else None
        if base is not None and not base.is_file():
            raise ValueError(f"base: there is no file {base}.")
        return cls(
            space, str(told.get("format", "toml")), "" if base is None else base.read_text("utf-8"),
            columns, {n: str(g) for n, g in own["group"].items()},
            {n: str(t) for n, t in own["target"].items()},
            {n: _deviation(space[n], p) for n, p in own["prior"].items()},
        )  # fmt: skip

    def named(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Values by what the program calls them."""
        return {self.targets.get(name, name): value for name, value in values.items()}

    def members(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Parameters by name, groups replaced by theirs; ValueError for neither."""
        found: list[str] = []
        known = {**dict.fromkeys(self.space.names), **dict.fromkeys(self.groups.values())}
        for name in names:
            one_of("parameter or group", name, known)
            own = [n for n in self.space.names if self.groups.get(n) == name]
            found += [name] if name in self.space.names else own
        return tuple(dict.fromkeys(found))


def _listed(output: Any) -> dict[str, Any]:
    """The table [output], single names of what may be several as lists."""
    if not isinstance(output, Mapping):
        raise ValueError("[output] must be a table of columns.")  # noqa: TRY004 - a file's fault
    several = {f.name for f in dataclasses.fields(Columns) if isinstance(f.default, tuple)}
    return {n: [v] if n in several and isinstance(v, str) else v for n, v in output.items()}


def parameter(name: str, told: Any) -> Parameter:
    """One parameter from its table; ValueError naming the field, the value and the remedy."""
    if not isinstance(told, Mapping):
        raise ValueError(f"parameters.{name} must be a table with range and default, got {told!r}.")  # noqa: TRY004 - a file's fault
    for key in told:
        one_of(f"field of parameters.{name}:", key, PARAMETER)
    choices = told.get("choices", ())
    symbol, unit = str(told.get("symbol", name)), str(told.get("unit", "1"))
    if choices:
        return _choice(name, choices, told.get("default", choices[0]), symbol)
    low, high = _range(name, told.get("range"))
    default: Any = told.get("default")
    if not _is_number(default):
        raise ValueError(f"parameters.{name}.default must be a number, got {default!r}.")
    if not low <= default <= high:
        raise ValueError(
            f"parameters.{name}.default must lie in its range {low:g}..{high:g}, got {default:g}: widen "
            "the range or move the default."
        )
    scale = told.get("scale", "log" if low > 0.0 else "linear")
    whole = bool(told.get("integer", False))
    return Parameter(name, symbol, unit, low, high, str(scale), float(default), whole)


def _choice(name: str, choices: Any, default: Any, symbol: str) -> Parameter:
    names = tuple(map(str, choices)) if isinstance(choices, list) else ()
    if len(names) < 2:
        raise ValueError(f"parameters.{name}.choices must name two or more, got {choices!r}.")
    start = float(names.index(one_of(f"parameters.{name}.default", str(default), names)))
    return Parameter(name, symbol, "1", 0.0, len(names) - 1.0, "linear", start, True, choices=names)


def _range(name: str, given: Any) -> tuple[float, float]:
    if not isinstance(given, list) or len(given) != 2 or not all(map(_is_number, given)):
        raise ValueError(
            f"parameters.{name}.range must be [low, high], two numbers, got {given!r}."
        )
    low, high = map(float, given)
    if not low < high:
        raise ValueError(f"parameters.{name}.range must have low < high, got {given!r}: swap them.")
    return low, high


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _deviation(p: Parameter, given: Any) -> float:
    """A prior's deviation on the parameter's own scale: the logarithm of a factor, or an amount."""
    factor = p.scale != "linear"
    least = 1.0 if factor else 0.0
    if p.choices or not _is_number(given) or not given > least:
        what = "a factor above 1" if factor else "an amount above 0"
        raise ValueError(
            f"parameters.{p.name}.prior must be {what}, one standard deviation, got {given!r}."
        )
    return math.log(given) if factor else float(given)
