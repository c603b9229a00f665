"""Dataclasses of settings as plain data and TOML, and back: a field's type says what it may hold."""

from __future__ import annotations

import collections.abc
import dataclasses
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar

import tomli_w

from navgym.core.checks import one_of
from navgym.core.storage import read_toml

S = TypeVar("S")


def as_dict(settings: Any) -> dict[str, Any]:
    """Plain data, as TOML and JSON can hold it; what is unset is left out."""
    found: dict[str, Any] = plain(dataclasses.asdict(settings))
    return found


def own(settings: Any) -> dict[str, Any]:
    """The fields that are not at their defaults, as plain data."""
    usual, found = as_dict(type(settings)()), as_dict(settings)
    return {name: value for name, value in found.items() if usual.get(name) != value}


def to_toml(values: Mapping[str, Any]) -> str:
    """Plain data as TOML."""
    return tomli_w.dumps(values)


def plain(value: Any) -> Any:
    """Lists for tuples, text for paths, nothing for None."""
    if isinstance(value, Mapping):
        return {str(name): plain(each) for name, each in value.items() if each is not None}
    if isinstance(value, (tuple, list)):
        return [plain(each) for each in value]
    return str(value) if isinstance(value, Path) else value


def from_dict(kind: type[S], values: Mapping[str, Any]) -> S:
    """A `kind` from plain data; missing fields take their defaults.

    Raises ValueError, naming the field, for an unknown one or a value of another type.
    """
    made: S = _made(kind, values, "")
    return made


def from_toml(kind: type[S], path: Path) -> S:
    """Read a file; ValueError naming it for what cannot be read or is wrong."""
    values = read_toml(path)
    try:
        return from_dict(kind, values)
    except ValueError as error:
        raise ValueError(f"{path} {error}") from error


def _made(kind: Any, values: Mapping[str, Any], where: str) -> Any:
    """`values` as the dataclass `kind`, whose fields' types decide."""
    hints = typing.get_type_hints(kind)
    known = [f.name for f in dataclasses.fields(kind)]
    for name in values:
        one_of(f"field of {where.rstrip('.')}:" if where else "field", name, known)
    return kind(
        **{name: _value(hints[name], each, f"{where}{name}") for name, each in values.items()}
    )


def _value(hint: Any, value: Any, name: str) -> Any:
    """`value` as type `hint`; ValueError naming the field if it is of another."""
    if isinstance(hint, types.UnionType):
        hint = next(each for each in typing.get_args(hint) if each is not type(None))
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if dataclasses.is_dataclass(hint):
        return _made(hint, _held(value, Mapping, "a table of its fields", name), f"{name}.")
    if origin is tuple:
        items = _held(value, (list, tuple), "a list", name)
        kinds = inner if len(inner) == len(items) and ... not in inner else (inner[0],) * len(items)
        return tuple(_value(k, each, name) for k, each in zip(kinds, items, strict=True))
    if origin in (dict, collections.abc.Mapping):
        table = _held(value, Mapping, "a table", name)
        return {k: _value(inner[1], each, f"{name}.{k}") for k, each in table.items()}
    if origin is Literal:
        return one_of(name, value, inner)
    return _scalar(hint, value, name)


def _scalar(hint: Any, value: Any, name: str) -> Any:
    """`value` as a number, text, flag or path."""
    if hint is Any:
        return value
    if hint is str and isinstance(value, (int, float)):
        return str(value)
    wanted = {float: (int, float), Path: (str, Path)}.get(hint, hint)
    if isinstance(value, bool) and hint is not bool:
        wanted = ()
    _held(value, wanted, f"of type {getattr(hint, '__name__', hint)}", name)
    return hint(value) if hint in (float, Path) else value


def _held(value: Any, wanted: Any, what: str, name: str) -> Any:
    if not isinstance(value, wanted):
        raise ValueError(f"{name} must be {what}, got {value!r}.")  # noqa: TRY004 - a file's fault
    return value
