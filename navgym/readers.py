"""Real logs as recordings: `navgym.read(format_name, path)`.

A format is a function from a path and keyword options to a recording. Each problem names its own;
one is imported when it is first asked for. What a reader can be told is its signature, and nothing
else lists it: `ReaderOptions` turns the words of a command line, or a mapping file, into keyword
options by that.
"""

from __future__ import annotations

import gzip
import os
import re
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

from navgym.core import storage
from navgym.core.checks import one_of
from navgym.core.typed import merged, options_of, paired, typed
from navgym.mapping import Mapped
from navgym.problem import Problem, load, problems

if TYPE_CHECKING:
    from navgym.deck.recording import DualIMURecording
    from navgym.statespace.recording import Recording

    _Name = str | os.PathLike[str]

SAVED = "npz"  # what the recordings' own `save` writes, of any problem
USUAL = "csv"  # a text file that no problem claims for another format
MAPPING = ".toml"
PEEKED = 1 << 16  # bytes of a file from which its format is guessed


def formats() -> dict[str, str]:
    """Where each format's reader is found, "module:function"."""
    named = {name: where for p in problems() for name, where in p.readers.items()}
    return named | {SAVED: "navgym.readers:read_saved"}


@overload
def read(
    format_name: Literal["akit", "csv", "log"], path: _Name, /, **options: Any
) -> Recording: ...
@overload
def read(
    format_name: Literal["deck_csv", "repoimu", "multi_imu"], path: _Name, /, **options: Any
) -> DualIMURecording: ...
@overload
def read(format_name: _Name, path: _Name, /, **options: Any) -> Any: ...
def read(
    format_name: str | os.PathLike[str], path: str | os.PathLike[str], /, **options: Any
) -> Any:
    """Read a real log.

    ==============  ===================================  =====================================
    format          holds                                options: see
    ==============  ===================================  =====================================
    "csv"           your own log of positions            `navgym.auv.csv_log.read_csv`
    "log"           positions in a bag, ULog, NMEA, ...  `navgym.auv.device_log.read_log`
    "akit"          A-KIT: an AUV, six tracks            `navgym.auv.akit.read_akit`
    "deck_csv"      your own log of two IMUs on a deck   `navgym.deck.csv_log.read_deck_csv`
    "repoimu"       RepoIMU: a pendulum's segments       `navgym.deck.public_logs.read_repoimu`
    "multi_imu"     two IMUs on a quadrotor              `navgym.deck.public_logs.read_multi_imu`
    "npz"           what a recording's `save` wrote      none
    "NAME.toml"     your own log, as this file says      see `navgym.mapping`
    ==============  ===================================  =====================================

    The first three give a `navgym.Recording`, the next three a `navgym.deck.recording.DualIMURecording`.

    Args:
        format_name: which, or the path of a mapping file.
        path: the file, or the folder of a public data set.
        options: keyword arguments of that function; they go before what a mapping file says.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: an unknown format or option, or a file that is not in this format.
    """
    name = os.fspath(format_name)
    if name.endswith(MAPPING):
        told = ReaderOptions((name,))
        name = told.format_of(path)
        options = merged(told.options(name), options)
    reader = reader_of(name)
    known = options_of(reader)
    for option in options:
        one_of(f"option of format {name!r}:", option, known)
    try:
        return reader(path, **options)
    except ValueError as error:
        if Path(path).name in str(error):
            raise
        raise ValueError(f"{Path(path).name}: {error}") from error


def reader_of(format_name: str) -> Callable[..., Any]:
    """The function that reads a format; ValueError with the nearest name for an unknown one."""
    known = formats()
    found: Callable[..., Any] = load(known[one_of("format", format_name, known)])
    return found


def read_saved(path: str | os.PathLike[str]) -> Any:
    """What the `save` of any recording wrote, model, truth and all.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a foreign or damaged file.
    """
    return _recording_type(path).load(path)


def _recording_type(path: str | os.PathLike[str]) -> Any:
    """The class whose `save` wrote a file."""
    known = {p.recording.__name__: p.recording for p in problems() if hasattr(p.recording, "load")}
    kind = storage.kind_of(path)
    if kind not in known:
        raise ValueError(f"{path} holds a {kind}, which is no recording: {', '.join(known)} are.")
    return known[kind]


# ---- which format


def guess(path: str | os.PathLike[str], hints: Collection[str] = ()) -> str:
    """The format of a log, by what it holds.

    Args:
        path: the file or folder.
        hints: names that the reader is told of, such as those of columns.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a folder that is no public data set that is known.
    """
    source = Path(path)
    if source.is_dir():
        seen = "\n".join([p.name for p in source.rglob("*")][:10_000])
    elif source.exists():
        begun = _begin(source)
        if begun[:2] == b"PK":
            return SAVED
        seen = f"{source.name}\n{begun.decode('utf-8', 'replace')}"
    else:
        raise FileNotFoundError(f"no log at {source}: give the path of a file.")
    wanted = "\n".join([seen, *hints])
    for problem in problems():
        for name, mark in problem.marks.items():
            if re.search(mark, wanted, re.IGNORECASE):
                return name
    if source.is_dir():
        raise ValueError(
            f"{source} is a folder of no format that is known: name a file, or say the format, one "
            f"of {', '.join(formats())}."
        )
    return USUAL


def _begin(source: Path) -> bytes:
    """The first bytes of a file, unpacked if it is gzipped."""
    with source.open("rb") as file:
        begun = file.read(PEEKED)
    if begun[:2] != b"\x1f\x8b":
        return begun
    try:
        with gzip.open(source) as packed:
            return packed.read(PEEKED)
    except (OSError, EOFError, zlib.error) as error:
        raise ValueError(
            f"{source.name} is a damaged gzip file ({error}): copy it again."
        ) from None


# ---- options as words


@dataclass(frozen=True)
class ReaderOptions:
    """How logs are read, as a command line says it; hashable, and the same in every command.

    Args:
        words: a mapping file (NAME.toml) or none, then pairs of an option, dots being keys of a
            table, and its value: ("position_noise", "5", "columns.px", "north (m)"). The options are
            the reader's keyword arguments, and their annotations say what a word means
            (`navgym.core.typed`). `model` also takes a saved recording, NAME.npz, whose model it is.
        format: of the logs; by default the mapping file's, or what each log looks like.

    Raises:
        FileNotFoundError: there is no such mapping file.
        ValueError: a name without its value, a file that is no TOML, an unknown format. Options are
            looked at when it is known which reader they are for.
    """

    words: tuple[str, ...] = ()
    format: str | None = None

    def __post_init__(self) -> None:
        self._mapped()
        self._given()
        if self.format is not None:
            one_of("format", self.format, formats())

    @classmethod
    def parsed(cls, words: Sequence[str], format_name: str | None = None) -> ReaderOptions:
        """From the words of a command line."""
        return cls(tuple(words), format_name)

    def _mapped(self) -> Mapped | None:
        if self.words and self.words[0].endswith(MAPPING):
            return Mapped.load(self.words[0])
        return None

    def _given(self) -> dict[str, Any]:
        return paired(self.words[1:] if self._mapped() else self.words)

    def format_of(self, path: str | os.PathLike[str]) -> str:
        """The format of a log: as told, or guessed."""
        mapped = self._mapped()
        said = self.format or (None if mapped is None else mapped.format)
        if said is not None:
            return one_of("format", said, formats())
        columns = self._given().get("columns")
        names = [*columns] if isinstance(columns, Mapping) else []
        return guess(path, names if mapped is None else [*names, *mapped.quantities])

    def options(self, format_name: str, among: Collection[str] | None = None) -> dict[str, Any]:
        """Keyword options of the reader of `format_name`, each of the type that it wants.

        Args:
            format_name: whose.
            among: the only ones that make sense where they are used; all by default.

        Raises ValueError for an unknown option, with what there is, and for a value of another type.
        """
        hints = options_of(reader_of(format_name))
        known = [name for name in hints if among is None or name in among]
        kind = f"option of format {format_name!r}:"
        mapped, given = self._mapped(), self._given()
        for name in given:
            if not known:
                raise ValueError(f"format {format_name!r} takes no options, got {name!r}.")
            one_of(kind, name, known)
        told = {name: hints[name] for name in known}
        said = {} if mapped is None else mapped.options(told, _value)
        return merged(said, {n: _value(hints[n], value, n) for n, value in given.items()})

    def read(self, path: str | os.PathLike[str]) -> Any:
        """The recording of a log.

        Raises as `read`; where a reader names an option, it is said how to give it.
        """
        name = self.format_of(path)
        options = self.options(name)
        try:
            return read(name, path, **options)
        except ValueError as error:
            raise ValueError(f"{error}{_spelt(str(error), reader_of(name))}") from error

    def problem(self, path: str | os.PathLike[str]) -> Problem:
        """The problem that a log is of."""
        name = self.format_of(path)
        if name == SAVED:
            kind = _recording_type(path)
            return next(p for p in problems() if p.recording is kind)
        return next(p for p in problems() if name in p.readers)


def words_after(flag: str, words: Sequence[str]) -> tuple[list[str], list[str]]:
    """The words after each `flag` up to the next that begins with two dashes, and all others.

    argparse would take a value such as -10,10,2 for an option.
    """
    told: list[str] = []
    rest: list[str] = []
    inside = False
    for word in words:
        if word.startswith("--"):
            inside = word == flag
            rest += [] if inside else [word]
        else:
            (told if inside else rest).append(word)
    return told, rest


def _value(hint: Any, value: Any, name: str) -> Any:
    """One option's value."""
    if name.endswith("model") and isinstance(value, str):
        if not value.endswith(f".{SAVED}"):
            raise ValueError(
                f"{name} must be a recording that was saved as NAME.npz, whose model is taken, or "
                f"fields of a model, model.NAME VALUE; got {value!r}."
            )
        return read_saved(value).model
    return typed(hint, value, name)


def _spelt(text: str, reader: Callable[..., Any]) -> str:
    """How options that a reader's error names are given as words."""
    known = options_of(reader)
    named = [name for name in dict.fromkeys(re.findall(r"\b(\w+)=", text)) if name in known]
    how = {"columns": "columns.NAME COLUMN", "topics": "topics.ROLE NAME"}
    words = [how.get(name, f"{name} VALUE") for name in named]
    return f" On a command line: --read {' '.join(words)}." if words else ""
