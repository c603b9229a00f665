"""Command lines from a dataclass: its fields are the flags, its docstring is the help."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import tyro
from navgym.tuning import declared

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
        default = declared.from_toml(kind, Path(given[at + 1]))
        del given[at : at + 2]
    return tyro.cli(
        kind, args=given, default=default, description=doc, config=(tyro.conf.FlagConversionOff,)
    )
