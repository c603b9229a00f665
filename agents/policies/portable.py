"""The portable format of learned things: NAME.npz with arrays, NAME.json with what they are for.

Each is written whole or not at all, the arrays first, and a hash of both ties them together: what is
interrupted between the two, mixed up or edited is noticed, and must be saved again. The hash is no
signature: who means to deceive can compute it. Neither file is unpickled.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.atomic import replacing
from navgym.core.storage import Arrays, parse_json, read_npz, settings_text

FORMAT = 2


def pair(path: str | os.PathLike[str]) -> tuple[Path, Path]:
    """The npz and the JSON of `path`, which may end in ".npz", ".json" or neither."""
    given = Path(path)
    stem = given.with_suffix("") if given.suffix in (".npz", ".json") else given
    return stem.with_name(f"{stem.name}.npz"), stem.with_name(f"{stem.name}.json")


def write(
    path: str | os.PathLike[str],
    kind: str,
    arrays: Mapping[str, NDArray[Any]],
    header: Mapping[str, Any],
) -> Path:
    """Write `arrays` as NAME.npz and `header` as NAME.json; returns the path of the npz.

    Args:
        path: NAME, with or without a suffix.
        kind: what it is, such as "navgym policy"; `read` asks for the same.
        arrays: numbers only.
        header: what JSON can hold.

    Raises:
        FileNotFoundError: the folder does not exist.
        ValueError: for what JSON cannot hold.
    """
    target, beside = pair(path)
    first = {"kind": kind, "format": FORMAT, "sha256": ""}
    whole = json.loads(json.dumps(first | dict(header), allow_nan=False))
    whole["sha256"] = seal(whole, arrays)
    text = json.dumps(whole, indent=1, ensure_ascii=False)
    with replacing(target) as file:
        np.savez_compressed(file, allow_pickle=False, **dict(arrays))
    with replacing(beside, text=True) as file:
        file.write(text + "\n")
    return target


def read(
    path: str | os.PathLike[str], kind: str, wanted: Sequence[str] = ()
) -> tuple[dict[str, Any], Arrays]:
    """Header and arrays of what `write` wrote as `kind`; the header holds every name of `wanted`.

    Raises:
        FileNotFoundError: one of the two files is missing.
        ValueError: a truncated, foreign or newer file, or two that do not belong together.
    """
    target, beside = pair(path)
    for file in (target, beside):
        if not file.is_file():
            raise FileNotFoundError(
                f"{file} is missing: a {kind} is {target.name} and {beside.name}; name the path of "
                "one, and copy both together."
            )
    header = _header(beside, kind, wanted)
    arrays = read_npz(target, f"is no {kind}, or is truncated", "Save it again.")
    found = seal(header, arrays)
    if found != header["sha256"]:
        raise ValueError(
            f"{target} does not belong to {beside}, or one of them was edited: their content has hash "
            f"{found[:12]}, and the JSON says {str(header['sha256'])[:12]}. Copy both files together, "
            "unedited."
        )
    return header, arrays


def seal(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> str:
    """SHA-256 of what a pair of files says: the arrays, and the header but for its own hash.

    How the JSON is laid out does not matter, what it says does.
    """
    facts = {name: value for name, value in header.items() if name != "sha256"}
    text = json.dumps(facts, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(f"{digest(arrays)}{text}".encode()).hexdigest()


def digest(arrays: Mapping[str, NDArray[Any]]) -> str:
    """SHA-256 of names, types, shapes and contents."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        found.update(array.tobytes())
    return found.hexdigest()


def _header(path: Path, kind: str, wanted: Sequence[str]) -> dict[str, Any]:
    try:
        header = dict(parse_json(settings_text(path)))
        found, version = header["kind"], header["format"]
    except (ValueError, TypeError, KeyError) as error:
        raise ValueError(
            f"{path} does not describe a {kind}, or is truncated ({error}): save it again."
        ) from error
    if found != kind:
        raise ValueError(f"{path} describes a {found}, not a {kind}: name another file.")
    if version != FORMAT:
        raise ValueError(
            f"{path} has format {version}, and this navgym reads {FORMAT}: install the navgym that "
            "wrote it, or make it anew."
        )
    missing = [name for name in ("sha256", *wanted) if name not in header]
    if missing:
        raise ValueError(f"{path} is damaged: it lacks {missing[0]!r}. Save it again.")
    return header
