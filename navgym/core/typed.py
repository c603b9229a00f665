"""Values from words and files: a type hint says what a text may mean.

What a function may be told is in its signature alone; command lines and files are read by that.
"""

from __future__ import annotations

import collections.abc
import dataclasses
import inspect
import math
import os
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from numpy.typing import ArrayLike

from navgym.core.checks import one_of, short

NONE = ("none", "")  # texts that stand for None where it is allowed
TRUTH = {"true": True, "yes": True, "false": False, "no": False}
_ARRAY = frozenset(typing.get_args(ArrayLike))


class MisfitError(ValueError):
    """A value that is not of the type that is wanted."""


def options_of(function: Callable[..., Any]) -> dict[str, Any]:
    """Type hint of each keyword option of `function` (of all parameters but the first), by name."""
    names = list(inspect.signature(function).parameters)[1:]
    hints = typing.get_type_hints(function)
    return {name: hints.get(name, Any) for name in names}


def paired(words: Sequence[str]) -> dict[str, Any]:
    """Pairs of a dotted name and a value, `a 1 b.c 2`, as {"a": "1", "b": {"c": "2"}}.

    Raises ValueError for a name without a value, a name that comes twice, and one that is a value and
    a table at once.
    """
    if len(words) % 2:
        raise ValueError(
            f"options come in pairs of a name and a value, but {words[-1]!r} stands alone: give its "
            "value, and quote values that hold blanks."
        )
    found: dict[str, Any] = {}
    for name, value in zip(words[::2], words[1::2], strict=True):
        first, dot, rest = name.partition(".")
        if not first or (dot and not rest):
            raise ValueError(f"{name!r} names no option: write NAME VALUE or NAME.KEY VALUE.")
        held = found.setdefault(first, {}) if dot else found
        key = rest if dot else first
        if not isinstance(held, dict) or key in held:
            raise ValueError(f"option {name!r} is given twice: leave one of them out.")
        held[key] = value
    return found


def merged(usual: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """`usual` with what is `given` in its place, tables key by key."""
    found = dict(usual)
    for name, value in given.items():
        both = isinstance(value, Mapping) and isinstance(found.get(name), Mapping)
        found[name] = merged(found[name], value) if both else value
    return found


def typed(hint: Any, value: Any, name: str) -> Any:
    r"""`value`, a text or what TOML holds, as `hint` wants it.

    Texts: numbers as usual; true, false; none; sequences and arrays with commas, `10,10,2`; \t is a
    tab. Tables are mappings or dataclasses.

    Raises ValueError naming `name`, what is wanted and what came.
    """
    try:
        return _fitted(hint, value, name)
    except MisfitError as error:
        if str(error):
            raise ValueError(str(error)) from None
        raise ValueError(f"{name} must be {described(hint)}, got {short(value)}.") from None


def described(hint: Any) -> str:
    """What a hint wants, in words."""
    kinds = [kind for kind in _kinds(hint) if kind is not type(None)]
    return " or ".join(dict.fromkeys(map(_described, kinds)))


def _kinds(hint: Any) -> tuple[Any, ...]:
    """The alternatives of a hint, those of an array being one, text the last."""
    if typing.get_origin(hint) not in (typing.Union, types.UnionType):
        return (hint,)
    kinds = typing.get_args(hint)
    if set(kinds) >= _ARRAY:
        kinds = (*(k for k in kinds if k not in _ARRAY), ArrayLike)
    return tuple(sorted(kinds, key=lambda kind: kind is str))


def _described(kind: Any) -> str:
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind == ArrayLike:
        return "numbers with commas between"
    if origin is Literal:
        return f"one of {', '.join(map(str, inner))}"
    if origin in _LISTS:
        return "values with commas between"
    if origin in _TABLES or dataclasses.is_dataclass(kind):
        return "a table (NAME.KEY VALUE)"
    if _is_path(kind):
        return "a path"
    usual = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
    return usual.get(kind, "what no text can say")


_LISTS = (tuple, list, collections.abc.Sequence, collections.abc.Iterable)
_TABLES = (dict, collections.abc.Mapping)


def _fitted(hint: Any, value: Any, name: str) -> Any:
    kinds = _kinds(hint)
    if len(kinds) > 1:
        return _first(kinds, value, name)
    (kind,) = kinds
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any:
        return _guessed(value)
    if kind == ArrayLike:
        return _numbers(value, name)
    if origin is Literal:
        return one_of(name, value, inner)
    if origin in _LISTS:
        return _sequence(origin, inner, value, name)
    if origin in _TABLES:
        table = _held(value, Mapping)
        return {key: _fitted(inner[1], each, f"{name}.{key}") for key, each in table.items()}
    if dataclasses.is_dataclass(kind):
        return _made(kind, _held(value, Mapping), name)
    if _is_path(kind):
        return Path(_held(value, (str, os.PathLike)))
    return _scalar(kind, value)


def _first(kinds: Sequence[Any], value: Any, name: str) -> Any:
    """`value` as the first of `kinds` that takes it; what that one says if it is the only one meant."""
    faults = []
    for kind in kinds:
        try:
            return _fitted(kind, value, name)
        except MisfitError as error:
            faults += [error] * bool(str(error))
    raise faults[0] if len(faults) == 1 else MisfitError


def _held(value: Any, wanted: Any) -> Any:
    if not isinstance(value, wanted):
        raise MisfitError
    return value


def _scalar(kind: Any, value: Any) -> Any:
    """`value` as None, flag, number or text."""
    if kind is type(None):
        if isinstance(value, str) and value.lower() in NONE:
            return None
    elif kind is bool:
        found = TRUTH.get(value.lower()) if isinstance(value, str) else value
        return _held(found, bool)
    elif kind is int:
        return _whole(value)
    elif kind is float:
        return _number(value)
    elif kind is str:
        return "\t" if value == "\\t" else _held(value, str)
    raise MisfitError


def _number(value: Any) -> float:
    try:
        if isinstance(value, bool) or (isinstance(value, str) and "_" in value):
            raise MisfitError
        number = float(value)
    except (TypeError, ValueError):
        raise MisfitError from None
    if math.isinf(number):
        raise MisfitError
    return number


def _whole(value: Any) -> int:
    number = _number(value)
    if number != round(number) if math.isfinite(number) else True:
        raise MisfitError
    return round(number)


def _items(value: Any) -> Sequence[Any]:
    if isinstance(value, str):
        return [item.strip() for item in value.strip("()[] ").split(",") if item.strip()]
    found: Sequence[Any] = _held(value, (list, tuple))
    return found


def _sequence(origin: Any, inner: Sequence[Any], value: Any, name: str) -> Any:
    items = _items(value)
    kinds = list(inner)
    if origin is not tuple or ... in inner or not inner:
        kinds = [inner[0] if inner else Any] * len(items)
    if len(kinds) != len(items):
        raise MisfitError(
            f"{name} must be {len(kinds)} values with commas between, got {short(value)}."
        )
    made = [_fitted(kind, each, name) for kind, each in zip(kinds, items, strict=True)]
    return made if origin is list else tuple(made)


def _numbers(value: Any, name: str) -> Any:
    """A number, or tuples of numbers."""
    if isinstance(value, (int, float)):
        return _number(value)
    items = [
        _numbers(v, name) if isinstance(v, (list, tuple)) else _number(v) for v in _items(value)
    ]
    if not items:
        raise MisfitError
    return items[0] if isinstance(value, str) and "," not in value else tuple(items)


def _made(kind: Any, table: Mapping[str, Any], name: str) -> Any:
    """`table` as the dataclass `kind`, dots in its keys being fields of fields."""
    fields = {f.name: f for f in dataclasses.fields(kind) if f.init}
    hints = typing.get_type_hints(kind)
    nested: dict[str, Any] = {}
    for key, each in table.items():
        first, dot, rest = key.partition(".")
        try:
            one_of(f"field of {name}:", first, fields)
        except ValueError as error:
            raise MisfitError(str(error)) from None
        nested[first] = merged(nested.get(first, {}), {rest: each}) if dot else each
    gone = [
        n for n, f in fields.items()
        if n not in nested and f.default is f.default_factory is dataclasses.MISSING
    ]  # fmt: skip
    if gone:
        raise MisfitError(f"{name} needs {', '.join(f'{name}.{each}' for each in gone)} as well.")
    return kind(**{n: typed(hints[n], each, f"{name}.{n}") for n, each in nested.items()})


def _guessed(value: Any) -> Any:
    """What a text means where every type is allowed: number, numbers, flag, text."""
    if not isinstance(value, str):
        return value
    for kind in (bool, float, ArrayLike, str):
        try:
            return _fitted(kind, value, "")
        except MisfitError:
            continue
    return value


def _is_path(kind: Any) -> bool:
    return kind is Path or (typing.get_origin(kind) or kind) is os.PathLike
