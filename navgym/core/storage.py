"""Arrays and JSON in one npz file, and files of settings: read without pickle, and within bounds.

What a file may hold when it is unpacked is bounded by its size, and how deep its tables nest by what
Python stands: a file that was made to harm ends in a ValueError that names it.
"""

from __future__ import annotations

import json
import os
import tomllib
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.atomic import replacing

FORMAT = 1

Arrays = dict[str, NDArray[Any]]

# what numpy, zipfile and zlib raise about a file that is no npz, or no longer one
_UNREADABLE = (
    ValueError, TypeError, EOFError, OSError, KeyError, zipfile.BadZipFile, zlib.error,
    RuntimeError, MemoryError,
)  # fmt: skip

# bytes: noise does not compress, so that no recording of any length unpacks to more than this
ROOM, PER_BYTE = 2**30, 100
SETTINGS = 2**24  # bytes of the largest file of settings; real ones have some thousand


def save(
    path: str | os.PathLike[str], kind: str, arrays: Mapping[str, Any], meta: Mapping[str, Any]
) -> Path:
    """Write `arrays` and `meta` as npz; returns the path."""
    header = np.array(json.dumps({"navgym": FORMAT, "kind": kind, "meta": dict(meta)}))
    target = Path(path)
    with replacing(target) as file:
        np.savez_compressed(file, **dict(arrays), header=header)
    return target


def load(path: str | os.PathLike[str], kind: str) -> tuple[Arrays, dict[str, Any]]:
    """Arrays and meta of what `save` wrote as `kind` (the name of the class that did).

    Raises ValueError, with the remedy, for a truncated, foreign or newer file, or another kind.
    """
    arrays = _read(path, kind)
    header = _header(path, kind, arrays.pop("header"))
    found = header.get("kind", "Recording")
    if found != kind:
        raise ValueError(f"{path} holds a {found}, not a {kind}: read it with {found}.load.")
    return arrays, dict(header["meta"])


def kind_of(path: str | os.PathLike[str]) -> str:
    """Name of the class whose `save` wrote a file; raises as `load`."""
    arrays = _read(path, "Recording", ("header", "time"))
    return str(_header(path, "Recording", arrays["header"]).get("kind", "Recording"))


def writable(meta: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of `meta` as JSON gives it back; ValueError for what JSON cannot hold."""
    try:
        copied: dict[str, Any] = json.loads(json.dumps(dict(meta)))
    except (TypeError, ValueError) as error:
        raise ValueError(f"meta must hold only what JSON can write: {error}.") from None
    return copied


def read_npz(
    path: str | os.PathLike[str], what: str, remedy: str, only: Sequence[str] | None = None
) -> Arrays:
    """The arrays of an npz file, or those named `only`, never unpickled.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: no npz, a truncated or encrypted one, or one that needs pickle or unpacks to far
            more than it is: "PATH WHAT (why). REMEDY".
    """
    try:
        _bounded(path)
        with np.load(path, allow_pickle=False) as file:
            found = {name: file[name] for name in file.files if only is None or name in only}
        raw = [name for name, array in found.items() if not isinstance(array, np.ndarray)]
        if raw:
            raise ValueError(f"{raw[0]} is no array")
    except _UNREADABLE as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise ValueError(f"{path} {what} ({error}). {remedy}") from error
    return found


def _bounded(path: str | os.PathLike[str]) -> None:
    """ValueError for an archive that is locked, or holds more than its size lets expect."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
    if any(member.flag_bits & 1 for member in members):
        raise ValueError("it is encrypted")
    size = sum(member.file_size for member in members)
    if size > ROOM + PER_BYTE * Path(path).stat().st_size:
        raise ValueError(f"it unpacks to {size / 1e9:.3g} GB, far more than any such file")


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """A TOML file as plain data; OSError, or ValueError naming the file."""
    text = settings_text(path)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path} is not TOML: {error}") from error
    except RecursionError as error:
        raise ValueError(f"{path} is not TOML that can be read: it nests too deep.") from error


def parse_json(text: str) -> Any:
    """JSON as plain data; ValueError where it is none, or nests deeper than Python stands."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it nests too deep") from error


def settings_text(path: str | os.PathLike[str], most: int = SETTINGS) -> str:
    """A text file of at most so many bytes; OSError, or ValueError naming the file."""
    with Path(path).open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ValueError(f"{path} has more than {most / 1e6:.0f} MB: name a file of settings.")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no text in UTF-8 ({error}).") from error


def _read(path: str | os.PathLike[str], kind: str, only: Sequence[str] | None = None) -> Arrays:
    arrays = read_npz(
        path,
        "is not a navgym recording or is truncated",
        f"Use a file that {kind}.save wrote, or navgym.read for other formats.",
        only,
    )
    if "header" not in arrays or "time" not in arrays:
        raise ValueError(
            f"{path} is an npz file but not a navgym recording: it holds {sorted(arrays)[:8] or 'neither header nor time'}. "
            f"Use a file that {kind}.save wrote."
        )
    return arrays


def _header(path: str | os.PathLike[str], kind: str, text: NDArray[Any]) -> dict[str, Any]:
    try:
        header = parse_json(str(text))
        found = header["navgym"]
    except (TypeError, ValueError, KeyError) as error:
        raise ValueError(
            f"{path} has a header that is not navgym's ({text!s:.40}). "
            f"Use a file that {kind}.save wrote."
        ) from error
    if found != FORMAT:
        raise ValueError(
            f"{path} has format {found}, and this navgym reads {FORMAT}: install the navgym that "
            "wrote it, or save it again from there."
        )
    if not isinstance(header.get("meta"), dict):
        raise ValueError(f"{path} is damaged: its header lacks 'meta'. Save the recording again.")  # noqa: TRY004 - a file's fault
    return dict(header)
