"""Mapping files: what the columns of a log hold, once, in TOML, for every command.

    format = "csv"             # or deck_csv, ...; left out: what the log looks like
    position_noise = 1.5       # any option of the format's reader, tables as tables
    latency.velocity = 0.5

    [column."east (ft)"]       # a column of the log
    quantity = "py"            # what it holds, by the reader's name
    unit = "ft"
    noise = 3.0                # standard deviation, m or m/s; the same for both axes of a sensor
    accuracy = "h_acc"         # or: the column with the receiver's own, row by row
    latency = 0.2              # s
    lever_arm = [0.4, 0.0]     # m
    frame = "ned"              # x north and y east; "enu": x east and y north
    sensor = "position"        # whose noise and accuracy these are; usually plain by the quantity

Each key is an option of the reader, a column's being its share of one; which there are depends on
the reader, and errors list them.
"""

from __future__ import annotations

import collections.abc
import json
import os
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, TypeAlias

from navgym.core.checks import one_of, short
from navgym.core.storage import read_toml

COLUMN = "column"  # the table of the file's columns
QUANTITY = "quantity"
ACCURACY = "accuracy"  # the column of a quantity's standard deviations
# quantities of the sensors whose noise a reader can be told
SENSORS = {
    "position": ("px", "py", "pz", "lat", "lon", "height", "depth"),
    "velocity": ("vx", "vy", "vz"),
}
FRAMES = ("ned", "enu")  # x north and y east, as readers have it; or x east and y north
TURNED = {"px": "py", "py": "px", "vx": "vy", "vy": "vx"}

Convert: TypeAlias = Callable[[Any, Any, str], Any]


@dataclass(frozen=True, eq=False)
class Mapped:
    """A mapping file.

    Args:
        path: where it was read.
        format: of the logs, None where it does not say.
        columns: what it says of each column of a log.
        rest: the reader's options.
    """

    path: Path
    format: str | None
    columns: Mapping[str, Mapping[str, Any]]
    rest: Mapping[str, Any]

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: no TOML, or a column without its quantity; the message names file and key.
        """
        source = Path(path)
        try:
            told = read_toml(source)
        except FileNotFoundError:
            raise FileNotFoundError(f"no mapping file at {source}: check the path.") from None
        name, columns = told.pop("format", None), told.pop(COLUMN, {})
        if name is not None and not isinstance(name, str):
            raise ValueError(f"{source}: format must be text, got {short(name)}.")
        return cls(source, name, _checked(source, columns), told)

    @property
    def quantities(self) -> list[str]:
        """What the columns hold."""
        return [str(table[QUANTITY]) for table in self.columns.values()]

    def options(self, hints: Mapping[str, Any], convert: Convert) -> dict[str, Any]:
        """The file as keyword options of a reader.

        Args:
            hints: types of the options that may be told, by name.
            convert: (hint, value, name) to the value as the reader wants it.

        Raises ValueError naming file, key, value and what there is.
        """
        found: dict[str, Any] = {}
        for name, value in self.rest.items():
            one_of(f"key of {self.path}:", name, ("format", COLUMN, *hints))
            found[name] = convert(hints[name], value, f"{self.path}: {name}")
        for column, table in self.columns.items():
            place = f"{self.path}: [{COLUMN}.{column!r}]"
            _add(found, _ColumnOf(place, column, table).options(hints, convert), place)
        return found


@dataclass(frozen=True, eq=False)
class _ColumnOf:
    """What is said of one column of a log."""

    place: str
    name: str
    told: Mapping[str, Any]

    @property
    def quantity(self) -> str:
        """What it holds, in the reader's own frame."""
        quantity: str = self.told[QUANTITY]
        frame = self.told.get("frame", FRAMES[0])
        if one_of(f"frame in {self.place}:", frame, FRAMES) == FRAMES[0]:
            return quantity
        return TURNED.get(quantity, quantity)

    @property
    def sensor(self) -> str | None:
        """Which sensor measures it."""
        usual = next((s for s, names in SENSORS.items() if self.quantity in names), None)
        said = self.told.get("sensor", usual)
        return None if said is None else one_of(f"sensor in {self.place}:", said, SENSORS)

    def options(self, hints: Mapping[str, Any], convert: Convert) -> dict[str, Any]:
        """Its share of the reader's options."""
        keys = self._keys(hints)
        found: dict[str, Any] = {"columns": {self.quantity: self.name}}
        for key, value in self.told.items():
            one_of(f"key in {self.place}:", key, (QUANTITY, "frame", "sensor", ACCURACY, *keys))
            name = f"{self.place} {key}"
            if key == ACCURACY:
                column = convert(str, value, name)
                whose = self.quantity if self.quantity in TURNED else self.sensor
                found["columns"][f"sigma_{whose}"] = column
            elif key in keys:
                option = keys[key]
                one = {self.quantity: value} if _by_quantity(hints[option]) else value
                found[option] = convert(hints[option], one, name)
        return found

    def _keys(self, hints: Mapping[str, Any]) -> dict[str, str]:
        """Options of the reader by what one column calls its share of them."""
        tables = [name for name, hint in hints.items() if _by_quantity(hint)]
        named = {_singular(n): n for n in tables if n not in ("columns", "model")}
        named |= {"noise": f"{self.sensor}_noise", "lever_arm": "lever_arm"}
        return {key: option for key, option in named.items() if option in hints}


def _add(found: dict[str, Any], more: Mapping[str, Any], place: str) -> None:
    """Put the options of one column to those of the others, with which they must agree."""
    for option, value in more.items():
        held = found.get(option, {} if isinstance(value, Mapping) else value)
        one, two = (v if isinstance(v, Mapping) else {"": v} for v in (held, value))
        for key in one.keys() & two.keys():
            if one[key] != two[key]:
                raise ValueError(
                    f"{place} wants {f'{option}.{key}'.strip('.')} = {two[key]!r}, and something "
                    f"above it {one[key]!r}: only one can be."
                )
        found[option] = {**held, **value} if isinstance(value, Mapping) else value


def _by_quantity(hint: Any) -> bool:
    """Whether an option is a table, so that each column can say its own."""
    tables = (dict, collections.abc.Mapping)
    return any(typing.get_origin(kind) in tables for kind in (hint, *typing.get_args(hint)))


def _singular(name: str) -> str:
    """units: unit."""
    return name.removesuffix("s")


def written(
    format_name: str,
    columns: Mapping[str, str],
    others: Sequence[str],
    options: Mapping[str, Any],
) -> str:
    """The text of a mapping file to go on from.

    Args:
        format_name: of the log.
        columns: its columns by quantity, as its reader found them.
        others: columns whose meaning is to be said; they stand as comments.
        options: what the reader was told beside.
    """
    lines = [f"format = {_toml(format_name)}"]
    for name, value in options.items():
        text = None if name == "columns" else _toml(value)
        lines += [] if text is None else [f"{name} = {text}"]
    for quantity, name in columns.items():
        lines += ["", f"[{COLUMN}.{_toml(name)}]", f"{QUANTITY} = {_toml(quantity)}"]
    for name in others:
        lines += ["", f"# [{COLUMN}.{_toml(name)}]", f'# {QUANTITY} = ""']
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str | None:
    """A value as TOML, None if TOML has no such thing."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (tuple, list)):
        parts = [_toml(each) for each in value]
        return None if None in parts else f"[{', '.join(map(str, parts))}]"
    if isinstance(value, Mapping):
        parts = [_toml(each) for each in value.values()]
        pairs = ", ".join(f"{_toml(str(k))} = {p}" for k, p in zip(value, parts, strict=True))
        return None if None in parts else f"{{{pairs}}}"
    return None


def _checked(source: Path, columns: object) -> Mapping[str, Mapping[str, Any]]:
    """The table of columns, each with its quantity."""
    if not isinstance(columns, Mapping):
        raise ValueError(f'{source}: {COLUMN} must be tables, such as [column."north (m)"].')  # noqa: TRY004 - a file's fault
    held: dict[str, str] = {}
    for name, table in columns.items():
        place = f"{source}: [{COLUMN}.{name!r}]"
        if not isinstance(table, Mapping) or not isinstance(table.get(QUANTITY), str):
            raise ValueError(f'{place} must say what it holds, such as quantity = "px".')  # noqa: TRY004
        if table[QUANTITY] in held:
            raise ValueError(
                f"{place} and {held[table[QUANTITY]]!r} both hold {table[QUANTITY]!r}: leave one out."
            )
        held[table[QUANTITY]] = name
    return columns
