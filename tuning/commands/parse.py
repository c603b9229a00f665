"""Command lines from a dataclass: its fields are the flags, its docstrings are the help."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import tyro

from navgym.core.atomic import possible_folder
from navgym.tuning import declared

S = TypeVar("S")
CONFIG = "--config"


def parse(
    kind: type[S], name: str, about: str | None, words: Sequence[str], default: S | None = None
) -> S:
    """A `kind` (a frozen dataclass) from the words after a command.

    Args:
        kind: the dataclass.
        name: of the command, with what may stand before the flags.
        about: what --help says above the flags.
        words: of the command line.
        default: what flags change; the dataclass's own defaults if not given.

    Raises:
        ValueError: values that do not fit together; a folder `out` that cannot be.
        SystemExit: flags that cannot be read, or --help.
    """
    start: dict[str, Any] = {} if default is None else {"default": default}
    found: S = tyro.cli(kind, prog=f"navgym {name}", description=about, args=list(words), **start)
    out = getattr(found, "out", None)
    if isinstance(out, Path):  # not after the work
        possible_folder("--out", out)
    return found


def configured(kind: type[S], words: Sequence[str]) -> tuple[S, list[str]]:
    """Defaults from the file that `--config FILE` names, if it does, and the other words.

    Args:
        kind: a dataclass with defaults.
        words: of the command line.

    Raises:
        ValueError: a file that is not TOML, an unknown field, a value of another type.
        FileNotFoundError: no such file.
    """
    rest = list(words)
    if CONFIG not in rest:
        return kind(), rest
    at = rest.index(CONFIG)
    if at + 1 == len(rest):
        raise ValueError(f"{CONFIG} needs a file: {CONFIG} settings.toml.")
    path = Path(rest[at + 1])
    del rest[at : at + 2]
    return declared.from_toml(kind, path), rest
