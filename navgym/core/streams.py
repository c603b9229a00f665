"""Standard streams of a command: closed, full, or of an encoding that lacks a sign.

None of these may cost a run its results. What goes to standard error is dropped where it cannot be
written; that standard output could not be is found out in time to say so.
"""

from __future__ import annotations

import io
import os
import sys
from typing import Any


class _Tolerant(io.FileIO):
    """A file that remembers the first error of writing to it.

    Args:
        number: its descriptor, which stays open.
        drops: whether what cannot be written is dropped without a word.
    """

    def __init__(self, number: int, drops: bool) -> None:
        super().__init__(number, "wb", closefd=False)
        self.drops = drops
        self.error: OSError | None = None

    def write(self, content: Any) -> int:
        """Write, or drop."""
        try:
            return super().write(content)
        except OSError as error:
            self.error = self.error or error
            if not self.drops:
                raise
        return len(content)


def prepare() -> None:
    """Make the process's standard streams such that a command can rely on them.

    Closed ones lead nowhere, so that no file that is opened later takes their number; signs that the
    encoding lacks are written as escapes; standard error never raises.
    """
    for number in range(3):
        if not _is_open(number):
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: PTH123, SIM115
        elif name != "stdin" and stream is getattr(sys, f"__{name}__"):
            raw = _Tolerant(stream.fileno(), drops=name == "stderr")
            found = io.TextIOWrapper(
                io.BufferedWriter(raw), stream.encoding, "backslashreplace",
                line_buffering=name == "stderr" or stream.line_buffering,
            )  # fmt: skip
            setattr(sys, name, found)


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True


def lost() -> OSError | None:
    """Why what was printed could not be written, or None; what is printed later then leads nowhere.

    Each reason is given once.
    """
    error = None
    try:
        sys.stdout.flush()
    except OSError as found:
        error = found
    raw = getattr(getattr(sys.stdout, "buffer", None), "raw", None)
    error = error or getattr(raw, "error", None)
    if error is not None:
        if isinstance(raw, _Tolerant):
            raw.error = None  # it is told of once
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
    return error


def say(line: str) -> None:
    """Print a line of progress at once, also where output goes to a file or a pipe."""
    print(line, flush=True)
