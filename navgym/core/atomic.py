"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any


@contextmanager
def replacing(path: Path, text: bool = False) -> Iterator[IO[Any]]:
    """A file to write to, binary or UTF-8 text, that takes the place of `path` at the end.

    It stands beside `path` until then. If anything raises, it is removed and `path` stays as it was.

    Raises:
        FileNotFoundError: the folder does not exist.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(f"the folder {path.parent} does not exist: create it first.")
    draft = path.with_name(f".{secrets.token_hex(8)}.tmp")
    # open, unlike tempfile, gives the file the mode that the user's umask asks for
    how: dict[str, Any] = {"mode": "x", "encoding": "utf-8", "newline": ""}
    try:
        with draft.open(**how) if text else draft.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def writable_folder(name: str, path: Path) -> Path:
    """Make a folder if need be; ValueError, naming the field, where no file can be written to it."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        draft = path / f".{secrets.token_hex(8)}.tmp"
        draft.touch()
        draft.unlink()
    except OSError as error:
        raise ValueError(
            f"{name} must be a folder that can be written to, got {str(path)!r} ({error.strerror}): "
            "name another."
        ) from error
    return path
