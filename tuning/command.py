"""Command lines and files from a dataclass: its fields are the flags, its docstring is the help."""

from __future__ import annotations

import dataclasses
import sys
import tomllib
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import tomli_w
import tyro

from navgym._checks import one_of

S = TypeVar("S")
CONFIG = "--config"


def parse(kind: type[S], doc: str | None, arguments: Sequence[str] | None = None) -> S:
    """A `kind` (a frozen dataclass with defaults) from the command line.

    `--config FILE` reads fields from a TOML file first; flags then override it.

    Args:
        kind: the dataclass.
        doc: what --help says above the flags.
        arguments: of the command; those of this process by default.

    Raises:
        ValueError: a file that is not TOML, an unknown field, values that do not fit together.
        FileNotFoundError: no such file.
        SystemExit: flags that cannot be read, or --help.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    default = kind()
    if CONFIG in given:
        at = given.index(CONFIG)
        if at + 1 == len(given):
            raise ValueError(f"{CONFIG} needs a file: {CONFIG} settings.toml.")
        default = read(kind, Path(given[at + 1]))
        del given[at : at + 2]
    return tyro.cli(
        kind, args=given, default=default, description=doc, config=(tyro.conf.FlagConversionOff,)
    )


def read(kind: type[S], path: Path) -> S:
    """A `kind` from a TOML file whose keys are its fields; the others keep their defaults."""
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not TOML: {error}.") from error
    hints = typing.get_type_hints(kind)
    known = [f.name for f in dataclasses.fields(kind)]  # type: ignore[arg-type]
    for name in found:
        one_of(f"field of {path}:", name, known)
    return kind(**{name: _shaped(value, hints[name]) for name, value in found.items()})


def _shaped(value: Any, hint: Any) -> Any:
    """What TOML holds as what a field is: tuples, and paths."""
    inner = [a for a in typing.get_args(hint) if a is not type(None)]
    if isinstance(value, list):
        return tuple(_shaped(v, inner[0] if inner else Any) for v in value)
    if isinstance(value, dict):
        return {k: _shaped(v, inner[-1]) for k, v in value.items()}
    wants_path = hint is Path or Path in inner
    return Path(value) if wants_path and isinstance(value, str) else value


def as_toml(settings: Any) -> str:
    """The fields of a dataclass that are not at their defaults, as TOML that `read` takes."""
    plain = type(settings)()
    own = {
        f.name: _plain(getattr(settings, f.name))
        for f in dataclasses.fields(settings)
        if getattr(settings, f.name) != getattr(plain, f.name)
    }
    return tomli_w.dumps({k: v for k, v in own.items() if v is not None})


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, (list, tuple)) else value
