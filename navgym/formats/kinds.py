"""Which kind of file a log is, and the module that reads it."""

from __future__ import annotations

import contextlib
import gzip
import importlib
import os
import re
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from navgym.core.checks import one_of
from navgym.core.notes import Progress
from navgym.core.text import opened
from navgym.formats.channels import Channels, Gatherer

PEEKED = 1 << 16  # bytes from which a kind is recognised


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Args:
        mark: pattern of its name, a line end and its beginning, bytes that are no text being U+FFFD.
        module: with a function `read(path, gatherer)`.
        extra: of navgym, that installs what the module imports; "" for nothing.
        remedy: for a damaged file.
    """

    mark: str
    module: str
    extra: str
    remedy: str = "copy it again, or cut it before the damage"


_NAME = r"\A[^\n]*"  # the first line
KINDS: dict[str, Kind] = {
    "ros": Kind(
        rf"{_NAME}\n(#ROSBAG V|.MCAP0|SQLite format 3)|(^|[\n/])metadata\.yaml(\n|\Z)",
        "navgym.formats.ros", "ros",
        "mend it with `rosbag reindex`, `ros2 bag reindex` or `mcap recover`",
    ),
    "ulog": Kind(rf"{_NAME}\nULog\x01\x12", "navgym.formats.ulog", "px4"),
    "ardupilot": Kind(rf"{_NAME}\n\ufffd\ufffd\ufffd\ufffd", "navgym.formats.dataflash", "ardupilot"),
    "tlog": Kind(rf"{_NAME}\.tlog(\.gz)?\n", "navgym.formats.tlog", "ardupilot"),
    "nmea": Kind(r"\n([^\n,*$!]{0,40}[ ,;\t])?\$[A-Z]{2}[A-Z\d]{2,8},[^\n*]*\*[0-9A-F]{2}", "navgym.formats.nmea", "nmea"),
    "pd0": Kind(rf"{_NAME}\n\x7f\x7f", "navgym.formats.pd0", ""),
    "sbet": Kind(rf"{_NAME}(\.sbet|sbet[^\n]*\.out)\n", "navgym.formats.sbet", ""),
}  # fmt: skip
MARK = "|".join(f"(?:{kind.mark})" for kind in KINDS.values())


def kind_of(path: Path) -> str:
    """The kind of a file or folder, by its name and how it begins; ValueError for none of `KINDS`."""
    if path.is_dir():
        seen = "\n".join([path.name, *sorted(p.name for p in path.iterdir())])
    elif path.exists():
        seen = f"{path.name}\n{_beginning(path).decode('utf-8', 'replace')}"
    else:
        raise FileNotFoundError(f"no log at {path}: give the path of a file.")
    for name, kind in KINDS.items():
        if re.search(kind.mark, seen, re.IGNORECASE | re.DOTALL):
            return name
    raise ValueError(
        f"{path.name} is no log of a kind that is known ({', '.join(KINDS)}), or its beginning is "
        "damaged: say kind= if it is one of them."
    )


def _beginning(path: Path) -> bytes:
    try:
        with opened(path) as file:
            return file.read(PEEKED)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise ValueError(f"{path.name} is a damaged gzip file ({error}): copy it again.") from None


def read_channels(path: str | os.PathLike[str], kind: str | None = None) -> Channels:
    """The channels of a log.

    Args:
        path: the file, or the folder of a ROS 2 bag.
        kind: of the file, a key of `KINDS`; by its content by default.

    Raises:
        FileNotFoundError: there is no such file.
        ImportError: the kind needs an extra of navgym; it is named.
        ValueError: a damaged file, one of another kind, one that holds no channel.
    """
    kept = _KEPT.get()
    asked = os.fspath(path), kind
    if kept is None:
        return _read(*asked)
    if asked not in kept:
        kept[asked] = _read(*asked)
    return kept[asked]


_KEPT: ContextVar[dict[tuple[str, str | None], Channels] | None] = ContextVar("kept", default=None)


@contextlib.contextmanager
def kept_channels() -> Iterator[None]:
    """Within it, `read_channels` reads a file once, for whoever asks again."""
    token = _KEPT.set({})
    try:
        yield
    finally:
        _KEPT.reset(token)


def _read(path: str, kind: str | None) -> Channels:
    source = Path(path)
    name = kind_of(source) if kind is None else one_of("kind", kind, KINDS)
    if not source.exists():
        raise FileNotFoundError(f"no log at {source}: give the path of a file.")
    try:
        with warnings.catch_warnings(), Progress(f"reading {source.name}") as progress:
            warnings.simplefilter("ignore")  # of libraries, about damage that is refused below
            gatherer = Gatherer(source, name, progress)
            _reader(name)(source, gatherer)
            found = gatherer.done()
    except ImportError:
        raise
    # libraries fail in many ways on bytes that are no file of theirs, and all mean the same
    except Exception as error:
        what = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        raise ValueError(
            f"{source.name} cannot be read as {name} ({_short(f'{what}{error}')}): {KINDS[name].remedy}."
        ) from error
    if not found.found:
        raise ValueError(
            f"{source.name} holds nothing of use: no position, velocity, attitude or IMU. "
            f"{' '.join(found.said)}"
        )
    return found


def _reader(name: str) -> Callable[[Path, Gatherer], None]:
    kind = KINDS[name]
    try:
        found: Callable[[Path, Gatherer], None] = importlib.import_module(kind.module).read
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("navgym"):
            raise
        package = error.name.partition(".")[0]
        raise ImportError(
            f"a {name} log needs the package {package}: pip install 'navgym[{kind.extra}]'"
        ) from None
    return found


def _short(text: str) -> str:
    line = " ".join(text.split()).rstrip(". ")
    return line if len(line) <= 300 else f"{line[:300]}..."
