"""Ctrl-C while the console command is still being loaded: one line, and no traceback.

Imported first of all by the package, and of effect only in a process that was started as `navgym`:
how a program that imports it takes Ctrl-C is that program's own matter.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from types import TracebackType

STOPPED = 130  # exit status after Ctrl-C, as shells have it


def _say(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """What nothing caught: Ctrl-C ends the process in one line, anything else is shown."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
        return
    try:
        os.write(2, b"\nstopped\n")
    finally:
        os._exit(STOPPED)


# "-m": Python is looking for the module, and imports the packages around it
if Path((getattr(sys, "argv", None) or [""])[0]).stem in ("navgym", "-m"):
    sys.excepthook = _say
