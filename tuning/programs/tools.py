"""What is tuned: a program, or a function, over logs; and the runs of either, each made once."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import json
import os
import pickle
import secrets
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from navgym.tuning.export import formats
from navgym.tuning.programs import runner
from navgym.tuning.programs.contract import Contract
from navgym.tuning.programs.output import Columns, Output, Table, of_anything, of_table
from navgym.tuning.programs.runner import Command, Failed
from navgym.tuning.programs.scoring import Ruler, Run

BIG = 2**20  # bytes that are hashed at once


@dataclass(frozen=True, eq=False)
class Log:
    """Something to run on.

    Args:
        name: for messages and reports.
        what: the path of a file or folder; of a function's, anything that it takes.
        digest: of its content.
    """

    name: str
    what: Any
    digest: str

    @classmethod
    def of(cls, what: Any, number: int) -> Log:
        """A path, or a recording, as the `number`-th log; FileNotFoundError for a path that is none."""
        if isinstance(what, (str, os.PathLike)):
            path = Path(what)
            if not path.exists():
                raise FileNotFoundError(f"no log at {path}: give the path of a file.")
            return cls(path.name, str(path.absolute()), digest_of(path))
        try:
            content = pickle.dumps(what)  # looked at, and never read back
        except Exception as error:
            raise ValueError(f"recording {number} cannot be sent to a worker ({error}).") from error
        name = getattr(what, "name", None)
        shown = name if isinstance(name, str) else f"recording {number}"
        return cls(shown, what, hashlib.sha256(content).hexdigest()[:16])


def digest_of(path: Path) -> str:
    """Fingerprint of a file's content; of a folder's files' names and contents."""
    made = hashlib.sha256()
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    for file in files:
        if path.is_dir():
            made.update(str(file.relative_to(path)).encode())
        with file.open("rb") as content:
            while piece := content.read(BIG):
                made.update(piece)
    return made.hexdigest()[:16]


class Tool(Protocol):
    """What is tuned."""

    @property
    def identity(self) -> Mapping[str, Any]:
        """What decides its outputs, beside parameters and log, as JSON can hold it."""

    def output(self, log: Log, values: Mapping[str, Any]) -> Output:
        """One run; raises `Failed`."""


@dataclass(frozen=True, eq=False)
class Program:
    """Somebody's program.

    Args:
        command: how it is started.
        contract: what it is told, and what it says.
        digests: fingerprints of its files, by path.
    """

    command: Command
    contract: Contract
    digests: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, command: Command, contract: Contract, also: tuple[Path, ...] = ()) -> Program:
        """A program with the fingerprints of the files that it is made of.

        Args:
            command: how it is started; files that it names are looked at.
            contract: what it is told, and what it says.
            also: further files that it reads.
        """
        paths = [Path(p) for p in command.files] + [p.absolute() for p in also]
        return cls(command, contract, {str(p): digest_of(p) for p in paths})

    @functools.cached_property
    def identity(self) -> Mapping[str, Any]:
        """Command, files and formats; where it lies and how long it may take do not count."""
        base = hashlib.sha256(self.contract.base.encode()).hexdigest()[:16]
        words = [
            f"{Path(w).name} {self.digests[w]}" if w in self.digests else w
            for w in self.command.words
        ]
        rest = {Path(p).name: d for p, d in self.digests.items() if p not in self.command.words}
        return {
            "program": " ".join(words), "files": rest, "format": self.contract.format,
            "base": base if self.contract.base else "", "columns": _plain(self.contract.columns),
            "targets": dict(self.contract.targets),
        }  # fmt: skip

    def output(self, log: Log, values: Mapping[str, Any]) -> Output:
        """Write the parameters, run, read the CSV."""
        form, named = formats.FORMATS[self.contract.format], self.contract.named(values)
        told, text = [], None
        if form.name == "words":
            told = formats.words(named)
        else:
            text = form.write(named, (), self.contract.base or None)
        with runner.run(self.command, told, text, form.ending, str(log.what)) as out:
            return of_table(Table.read(out), self.contract.columns, str(log.what))


def _plain(columns: Columns) -> dict[str, Any]:
    return {n: list(v) if isinstance(v, tuple) else v for n, v in vars(columns).items() if v}


@dataclass(frozen=True, eq=False)
class Function:
    """Somebody's function.

    Args:
        call: (recording, parameters) to an estimate; see `navgym.tuning.programs.output.of_anything`.
        columns: what its columns mean.
    """

    call: Callable[[Any, Mapping[str, Any]], Any]
    columns: Columns = field(default_factory=Columns)

    @functools.cached_property
    def identity(self) -> Mapping[str, Any]:
        """The function's name, and the file that it stands in."""
        name = f"{getattr(self.call, '__module__', '')}.{getattr(self.call, '__qualname__', repr(type(self.call)))}"
        digest = ""
        with contextlib.suppress(TypeError, OSError):
            digest = digest_of(Path(inspect.getsourcefile(self.call) or ""))
        return {"function": f"{name} {digest}".strip(), "columns": _plain(self.columns)}

    def output(self, log: Log, values: Mapping[str, Any]) -> Output:
        """Call it; what it raises is a run that failed."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = self.call(log.what, dict(values))
        except Exception as error:
            raise Failed(type(error).__name__, " ".join(str(error).split())[:500]) from error
        place = (
            log.what if isinstance(log.what, (str, Path)) else log.name
        )  # an array's text is long
        return of_anything(found, self.columns, str(place))


# ---- runs, each made once


@dataclass(frozen=True)
class Runs:
    """Runs that were made, in a folder: a file each, named after all that decides it.

    Args:
        folder: None for none that are kept.
    """

    folder: Path | None = None

    def of(
        self, tool: Tool, log: Log, values: Mapping[str, Any], ruler: Ruler, again: int = 0
    ) -> Run:
        """The run of a tool on a log, kept or made now; raises `Failed`.

        Args:
            tool: what to run.
            log: on what.
            values: of all its parameters.
            ruler: the log's.
            again: number of the repetition, to see whether runs differ.
        """
        key = self._key(tool, log, values, f"{ruler.digest} {again}")
        kept: Run | None = self._load(key, Run.of_dict)
        if kept is not None:
            return kept
        began = time.perf_counter()
        output = tool.output(log, values)
        found = Run.of(output, ruler, time.perf_counter() - began)
        self._keep(key, found.as_dict())
        return found

    def ruler(self, tool: Tool, log: Log, values: Mapping[str, Any]) -> Ruler:
        """The ruler of a log, from the run at `values`; raises `Failed`."""
        key = self._key(tool, log, values, "ruler")
        kept: Ruler | None = self._load(key, Ruler.of_dict)
        if kept is not None:
            return kept
        began = time.perf_counter()
        output = tool.output(log, values)
        seconds = time.perf_counter() - began
        found = Ruler.of(output)
        self._keep(key, found.as_dict())
        self._keep(
            self._key(tool, log, values, f"{found.digest} 0"),
            Run.of(output, found, seconds).as_dict(),
        )
        return found

    def _key(self, tool: Tool, log: Log, values: Mapping[str, Any], what: str) -> str:
        text = json.dumps([dict(tool.identity), log.digest, dict(values), what], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def _path(self, key: str) -> Path:
        assert self.folder is not None
        return self.folder / key[:2] / f"{key[2:34]}.json"

    def _load(self, key: str, read: Callable[[Any], Any]) -> Any:
        """What is kept; None where there is nothing, or nothing whole."""
        if self.folder is None:
            return None
        try:
            return read(json.loads(self._path(key).read_bytes()))
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return None

    def _keep(self, key: str, told: Mapping[str, Any]) -> None:
        """Write a file whole or not at all. A power cut may cost it, which costs a run: no waiting for
        the disk.
        """
        if self.folder is None:
            return
        path = self._path(key)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            draft = path.with_name(f".{secrets.token_hex(8)}.tmp")
            draft.write_text(json.dumps(told, separators=(",", ":")))
            draft.replace(path)
        except OSError as error:
            raise OSError(
                f"{path.parent} cannot be written ({error.strerror}): make room, and give the same command "
                "again. Finished runs are safe."
            ) from error
