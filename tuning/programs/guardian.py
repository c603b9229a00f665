"""A small process that starts programs, and sees to it that none of them outlives its time.

It knows nothing of navgym, and is started as a file of its own: small, with one thread, so that
starting a program costs a millisecond or two. It reads a request per line (JSON) and answers each with
a line when the program has started (its process group) and one when it has ended. Whatever a program leaves behind, children that moved to another session included, is killed when
the program has ended; all of it is killed when the process that asks goes away, however that happens:
its end of the pipe closes then. Systems other than Linux lack two of the means (a subreaper, a signal
at the parent's death): there a child that moves to another process group is lost sight of.
"""

import contextlib
import ctypes
import errno
import json
import os
import resource
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

SET_PDEATHSIG, SET_CHILD_SUBREAPER = 1, 36  # of prctl, from linux/prctl.h
TICK = 0.1  # s between looks at what a program has written
SWEEPS = 1000  # at most, of children that have children while they are killed


def _prctl() -> Any:
    """The call of that name, or None on systems without it."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        return ctypes.CDLL(None, use_errno=True).prctl
    except (OSError, AttributeError):
        return None


PRCTL = _prctl()


def run(request: dict[str, Any]) -> dict[str, Any]:
    """Run one program to its end; returns how it ended, as a dict.

    `request` holds words, folder, environment, limit (s), largest (bytes written), out and err (files).
    """
    began = time.monotonic()
    largest = request["largest"]

    def prepare() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if PRCTL is not None:
            PRCTL(SET_PDEATHSIG, signal.SIGKILL)

    try:
        with Path(request["out"]).open("wb") as out, Path(request["err"]).open("wb") as err:
            process = subprocess.Popen(  # noqa: S603 - what the user asked for, without a shell
                request["words"], stdin=subprocess.DEVNULL, stdout=out, stderr=err,
                cwd=request["folder"], env=request["environment"], start_new_session=True,
                preexec_fn=prepare,  # noqa: PLW1509 - there is one thread
            )  # fmt: skip
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        return {"why": "start", "text": getattr(error, "strerror", None) or str(error)}
    answer({"started": process.pid})
    why = watch(process, began + request["limit"], request["watched"], largest)
    if why:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)  # children that it left in its group
    left = sweep()
    return {
        "why": why, "status": process.returncode, "left": left,
        "seconds": time.monotonic() - began,
    }  # fmt: skip


def answer(told: dict[str, Any]) -> None:
    """Write a line."""
    os.write(sys.stdout.fileno(), json.dumps(told).encode() + b"\n")


def watch(process: subprocess.Popen[bytes], until: float, folder: str, largest: int) -> str:
    """Wait for a program's end; what it is to be killed for otherwise, "" for nothing."""
    watched = [sys.stdin.fileno()]
    handle = None
    if hasattr(os, "pidfd_open"):
        try:
            handle = os.pidfd_open(process.pid)
            watched.append(handle)
        except OSError:
            handle = None
    try:
        looked = time.monotonic()
        while process.poll() is None:
            now = time.monotonic()
            if now >= until:
                return "time"
            pause = min(until - now, TICK if handle is not None else 0.005)
            ready, _, _ = select.select(watched, [], [], pause)
            if sys.stdin.fileno() in ready:
                return "gone"  # nobody asks for two things at once: the pipe is closed
            if now - looked >= TICK:
                looked = now
                if size(folder, largest) > largest:
                    return "size"
        return ""
    finally:
        if handle is not None:
            os.close(handle)


def size(folder: str, most: int) -> int:
    """Bytes of the files below a folder, as far as `most`."""
    total, waiting = 0, [folder]
    while waiting and total <= most:
        with contextlib.suppress(OSError), os.scandir(waiting.pop()) as entries:
            for entry in entries:
                with contextlib.suppress(OSError):
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append(entry.path)
                    else:
                        total += entry.stat(follow_symlinks=False).st_size
    return total


def children() -> list[int]:
    """Processes that this one is the parent of, those of dead parents included."""
    try:
        found = Path(f"/proc/self/task/{os.getpid()}/children").read_text()
        return [int(word) for word in found.split()]
    except (OSError, ValueError):
        return []


def sweep() -> int:
    """Kill whatever a program has left; returns how many there were."""
    killed = 0
    for _ in range(SWEEPS):
        found = children()
        if not found:
            break
        for child in found:
            with contextlib.suppress(OSError):
                os.killpg(child, signal.SIGKILL)  # if it leads a group
            with contextlib.suppress(OSError):
                os.kill(child, signal.SIGKILL)
        for child in found:
            with contextlib.suppress(ChildProcessError):
                killed += os.waitpid(child, 0)[0] == child
    return killed


def serve(scratch: str) -> None:
    """Answer requests until the pipe closes; then remove the scratch folder."""
    if PRCTL is not None:
        PRCTL(SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # whoever asks decides when this ends
    try:
        held = b""
        while True:
            piece = os.read(sys.stdin.fileno(), 1 << 16)
            if not piece:
                break
            held += piece
            while b"\n" in held:
                line, held = held.split(b"\n", 1)
                answer(run(json.loads(line)))
    except OSError as error:
        if error.errno != errno.EPIPE:
            raise
    finally:
        sweep()
        shutil.rmtree(scratch, ignore_errors=True)


if __name__ == "__main__":
    serve(sys.argv[1])
