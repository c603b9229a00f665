"""Mapping files: what the columns of a log hold, once, in TOML, for every command."""

from __future__ import annotations

import collections.abc
import os
import re
import tomllib
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, TypeAlias

from navgym.core.checks import one_of, short

COLUMN = "column"  # the table of the file's columns
QUANTITY = "quantity"

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
            told = tomllib.loads(source.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise FileNotFoundError(f"no mapping file at {source}: check the path.") from None
        except (ValueError, RecursionError) as error:  # TOMLDecodeError, UnicodeDecodeError
            raise ValueError(f"{source} is not TOML: {error}.") from None
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
        keys = {_singular(name): name for name, hint in hints.items() if _by_quantity(name, hint)}
        found: dict[str, Any] = {}
        for name, value in self.rest.items():
            one_of(f"key of {self.path}:", name, ("format", COLUMN, *hints))
            found[name] = convert(hints[name], value, f"{self.path}: {name}")
        for column, table in self.columns.items():
            place = f"{self.path}: [{COLUMN}.{column!r}]"
            quantity = table[QUANTITY]
            _set(found, "columns", quantity, column)
            for key, value in table.items():
                if key == QUANTITY:
                    continue
                option = keys[one_of(f"key in {place}:", key, (QUANTITY, *keys))]
                made = convert(hints[option], {quantity: value}, f"{place} {key}")
                _set(found, option, quantity, made[quantity])
        return found


def _set(found: dict[str, Any], option: str, quantity: str, value: Any) -> None:
    found[option] = {**found.get(option, {}), quantity: value}


def _by_quantity(name: str, hint: Any) -> bool:
    """Whether an option is a table by quantity, so that each column can say its own."""
    kinds = (hint, *typing.get_args(hint))
    tables = (dict, collections.abc.Mapping)
    return name != "columns" and any(typing.get_origin(kind) in tables for kind in kinds)


def _singular(name: str) -> str:
    """What one column calls its share of an option: units, latencies: unit, latency."""
    return re.sub("ies$", "y", name) if name.endswith("ies") else name.removesuffix("s")


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
