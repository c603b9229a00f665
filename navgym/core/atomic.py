"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def replacing(path: Path, text: bool = False) -> Iterator[IO[Any]]:
    """A file to write to, binary or UTF-8 text, that takes the place of `path` at the end.

    It stands beside `path` until then. If anything raises, it is removed and `path` stays as it was.
    Where `path` is a link, the link is replaced: what it points to may be somebody else's.

    Raises:
        FileNotFoundError: the folder does not exist.
        OSError: `path` is a folder or a device; it cannot be written, or the disk is full.
    """
    if not path.parent.is_dir():
        raise FileNotFoundError(f"the folder {path.parent} does not exist: create it first.")
    if path.exists() and not path.is_file():
        raise OSError(f"{path} is no ordinary file, and cannot be replaced by one: name another.")
    draft = path.with_name(f".{secrets.token_hex(8)}.tmp")
    # open, unlike tempfile, gives the file the mode that the user's umask asks for
    how: dict[str, Any] = {"mode": "x", "encoding": "utf-8", "newline": ""}
    try:
        with draft.open(**how) if text else draft.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except BaseException as error:
        with contextlib.suppress(OSError):  # the folder may be gone
            draft.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno in _NO_ROOM:
            raise OSError(
                f"{path} cannot be written ({error.strerror}): make room. What was there is as it was."
            ) from error
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


def possible_folder(name: str, path: Path) -> Path:
    """`path`; ValueError, naming the field, where no such folder can be made. Nothing is made yet."""
    above = path.absolute()
    while not above.exists() and above != above.parent:
        above = above.parent
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        why = "cannot be written to" if above.is_dir() else "is no folder"
        raise ValueError(
            f"{name} must be a folder that can be written to, got {str(path)!r} ({above} {why}): name "
            "another."
        )
    return path
