"""Running a program once: parameters in a file, a log, a CSV out; no shell, and no run that never ends.

Programs are started by a *guardian* (`guardian.py`), one per thread that evaluates: a program that
hangs, forks, moves its children to another session or fills the disk is killed with all that it started,
and so it is when the process that asked is killed itself.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import secrets
import shlex
import shutil
import signal
import string
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from navgym.tuning.programs import guardian

FIELDS = ("parameters", "log", "out", "folder", "name")
SAID = 2000  # characters of what a program printed that are kept for a message
LARGEST = 256 * 2**20  # bytes that a run may write
SHELL = ("|", "||", "&&", ";", ">", ">>", "<", "2>", "2>&1", "&")


class Failed(Exception):  # noqa: N818 - a program's failure is a result, and no error of ours
    """A run that gave nothing to judge.

    Args:
        kind: in a word or two: "time-out", "exit status 1", "no output".
        text: what is known of it.
        again: whether another try may end otherwise, so that the failure is not to be kept.
    """

    def __init__(self, kind: str, text: str = "", again: bool = False) -> None:
        super().__init__(f"{kind}: {text}" if text else kind)
        self.kind, self.text, self.again = kind, text, again

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.kind, self.text, self.again)


@dataclass(frozen=True)
class Command:
    """A command line with fields to fill in.

    Args:
        words: of the command, with {parameters}, {log}, {out}, and, if wanted, {name} and {folder} (the
            log's name without its ending, and its folder) inside; files among them by absolute paths.
        limit: s that a run may take.
        largest: bytes that a run may write, to one file and in all.
        folder: where it is started; "" for an empty folder of its own.
    """

    words: tuple[str, ...]
    limit: float = 60.0
    largest: int = LARGEST
    folder: str = ""

    @classmethod
    def parsed(cls, text: str, **options: Any) -> Command:
        """From a command as it would be typed, split into words as a shell would, which it is not.

        Raises ValueError for quotes that do not close, an unknown field, a field that is needed and
        missing, words that only a shell understands, and a program that is not there.
        """
        try:
            words = shlex.split(text)
        except ValueError as error:
            raise ValueError(f"--program {text!r} cannot be split into words: {error}.") from None
        if not words:
            raise ValueError("--program must name a program, got nothing.")
        _check_fields(text, words)
        for word in words:
            if word in SHELL or word.startswith(("$(", "`")):
                raise ValueError(
                    f"--program holds {word!r}, which only a shell understands, and none is started: "
                    f"write a script, or give the whole to one yourself: sh -c {shlex.quote(text)}."
                )
        return cls((_program(words[0]), *map(_absolute, words[1:])), **options)

    @property
    def files(self) -> tuple[str, ...]:
        """Files that the command names: the program itself and scripts."""
        return tuple(w for w in self.words if Path(w).is_absolute() and Path(w).is_file())

    def filled(self, parameters: Sequence[str], log: str, out: str) -> list[str]:
        """The words of one run.

        Args:
            parameters: what {parameters} stands for: a path, or words of their own.
            log: path of the log.
            out: path that the output is expected at.
        """
        place = Path(log)
        told = {"log": log, "out": out, "folder": str(place.parent), "name": place.stem}
        made = list[str]()
        for word in self.words:
            if word == "{parameters}":
                made += parameters
            else:
                one = parameters[0] if len(parameters) == 1 else " ".join(parameters)
                made.append(_format(word, told | {"parameters": one}))
        return made


def _format(word: str, told: Mapping[str, str]) -> str:
    """`word` with the fields that are known filled in; other braces stay."""
    for name, value in told.items():
        word = word.replace(f"{{{name}}}", value)
    return word


def _check_fields(text: str, words: Sequence[str]) -> None:
    with contextlib.suppress(ValueError):  # braces that are the program's own
        for word in words:
            for _, name, _, _ in string.Formatter().parse(word):
                if name and name.isidentifier() and name not in FIELDS:
                    raise LookupError(name)
    for name in ("parameters", "out"):
        if f"{{{name}}}" not in text:
            raise ValueError(
                f"--program must hold {{{name}}}, which is replaced by the "
                f"{'file of parameters' if name == 'parameters' else 'path of the CSV to write'}, got "
                f'{text!r}: --program "./replay {{parameters}} {{log}} {{out}}".'
            )


def _program(word: str) -> str:
    """The absolute path of a program; ValueError if there is none."""
    found = shutil.which(word) if os.sep not in word else word
    path = None if found is None else Path(found).absolute()
    if path is None or not path.is_file():
        raise ValueError(f"--program: there is no program {word!r}: give its path.")
    if not os.access(path, os.X_OK):
        raise ValueError(
            f"--program: {word!r} is not executable: chmod +x {word}, or name what runs it first, such "
            f"as: python {word}."
        )
    return str(path)


def _absolute(word: str) -> str:
    """A file that is named from here, by a path that holds anywhere."""
    return str(Path(word).absolute()) if word and Path(word).exists() else word


# ---- the guardian


class _Guardian:
    """A guardian process, and the scratch folder that it removes at its end."""

    def __init__(self) -> None:
        self.scratch = Path(tempfile.mkdtemp(prefix="navgym-"))
        self.owner = os.getpid()
        words = [sys.executable, "-I", "-S", str(Path(guardian.__file__)), str(self.scratch)]
        self.process = subprocess.Popen(  # noqa: S603 - this interpreter, a file of ours
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """One run; `Failed` if the guardian is gone."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        group = 0
        try:
            self.process.stdin.write(json.dumps(request).encode() + b"\n")
            self.process.stdin.flush()
            line = self.process.stdout.readline()
            if b'"started"' in line:
                group = int(json.loads(line)["started"])
                line = self.process.stdout.readline()
        except OSError:
            line = b""
        except BaseException:  # Ctrl-C: the program that runs ends with the guardian
            self.close()
            raise
        if not line:
            self.close()
            if group:  # what the program had started stays without its guardian
                with contextlib.suppress(OSError):
                    os.killpg(group, signal.SIGKILL)
            raise Failed("lost", "the process that watches over the program was killed", again=True)
        found: dict[str, Any] = json.loads(line)
        return found

    @property
    def alive(self) -> bool:
        return self.owner == os.getpid() and self.process.poll() is None

    def close(self) -> None:
        """Let it end, with whatever it runs."""
        if self.owner != os.getpid():
            return
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(10)


_HERE = threading.local()


def _guard() -> _Guardian:
    """This thread's guardian."""
    found: _Guardian | None = getattr(_HERE, "guardian", None)
    if found is None or not found.alive:
        found = _HERE.guardian = _Guardian()
        atexit.register(found.close)
    return found


@contextlib.contextmanager
def run(command: Command, parameters: Sequence[str], text: str | None, ending: str, log: str) -> Iterator[Path]:  # fmt: skip
    """Run a program; the path of its output, for as long as the block lasts.

    Args:
        command: what to run.
        parameters: words that {parameters} stands for; empty: the path of a file that holds `text`.
        text: of that file.
        ending: of that file's name.
        log: path of the log.

    Raises `Failed` for a program that crashes, takes too long, writes too much or writes nothing.
    """
    guard = _guard()
    place = guard.scratch / secrets.token_hex(6)
    place.mkdir()
    try:
        told = list(parameters)
        if text is not None:
            (place / f"parameters{ending}").write_text(text, encoding="utf-8")
            told = [str(place / f"parameters{ending}")]
        out, err, said = place / "out.csv", place / "stderr", place / "stdout"
        answer = guard.ask(
            {
                "words": command.filled(told, log, str(out)),
                "folder": command.folder or str(place),
                "environment": {**os.environ, "TMPDIR": str(place)},
                "limit": command.limit, "largest": command.largest, "watched": str(place),
                "out": str(said), "err": str(err),
            }
        )  # fmt: skip
        _judge(command, answer, _tail(err) or _tail(said))
        if not out.is_file():
            raise Failed("no output", f"it wrote nothing to {{out}}. {_tail(err) or _tail(said)}")
        yield out
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _judge(command: Command, answer: Mapping[str, Any], said: str) -> None:
    """`Failed` unless the program ended well."""
    why, status = answer["why"], answer.get("status")
    if why == "start":
        raise Failed("cannot be started", f"{answer['text']} ({command.words[0]})")
    if why == "time":
        raise Failed("time-out", f"killed after {command.limit:g} s. {said}", again=True)
    if why == "size" or (status is not None and -status == getattr(signal, "SIGXFSZ", 0)):
        raise Failed("too much output", f"killed when it had written {command.largest:,} bytes")
    if why:
        raise Failed("lost", "the run was called off", again=True)
    if status:
        text = f"killed by {_signal(-status)}" if status < 0 else f"exit status {status}"
        raise Failed(text, said, again=status in (-signal.SIGKILL, -signal.SIGTERM))


def _signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _tail(path: Path) -> str:
    """The last of what was printed, on one line."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - SAID))
            text = file.read().decode("utf-8", "replace")
    except OSError:
        return ""
    return " ".join(text.split())[-SAID // 4 :]
