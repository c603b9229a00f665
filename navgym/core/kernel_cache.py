"""Compiled kernels on disk: whose files are loaded, and what is said where that does not work.

Numba keeps compiled code as pickles, and whoever writes a pickle runs code in the process that loads
it. So a folder is used only if nobody but its owner and root can change it, from the root of the file
system down: `NUMBA_CACHE_DIR` if that is set, else the `__pycache__` beside the source, else the user's
own cache folder. One that others can write to is passed over, with a line on standard error, and never
an error: the next folder is as good, and where there is none kernels compile anew in each process,
which gives the same numbers later.

A damaged file is removed and its kernel compiled again; a full disk costs the cache, not the run.
"""

from __future__ import annotations

import contextlib
import functools
import glob
import multiprocessing
import os
import stat
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
from numba.core import caching

QUIET = "NAVGYM_QUIET"  # environment variable: anything but empty or 0 keeps these lines away
VARIABLE = "NUMBA_CACHE_DIR"
REMEDY = f"set {VARIABLE} to a folder that only you can write to, such as ~/.cache/navgym"
COMPILING = (
    "compiling kernels for this machine, once: some 5 to 20 s per filter, later starts are quick "
    "(navgym warm compiles all now)"
)

UNKEPT = "unkept"  # kind of a line: compiled code could not be kept
_WRITABLE = stat.S_IWGRP | stat.S_IWOTH
_said: dict[str, str] = {}
_saving = threading.Lock()


def say(kind: str, text: str) -> None:
    """A line on standard error, one of a kind in a process, unless `NAVGYM_QUIET` is set.

    Workers leave it to their parent, see `troubles`.
    """
    quiet = os.environ.get(QUIET, "") not in ("", "0")
    if kind in _said:
        return
    _said[kind] = text
    if quiet or multiprocessing.parent_process() is not None:
        return
    stream: Any = sys.stderr
    own = stream is sys.__stderr__
    with contextlib.suppress(OSError, ValueError):  # a stream that is full or closed
        if stream is not None and own:
            # past its buffer, which would fail once more at exit
            os.write(stream.fileno(), f"navgym: {text}\n".encode("ascii", "backslashreplace"))
        elif stream is not None:
            stream.write(f"navgym: {text}\n")


def troubles() -> dict[str, str]:
    """By kind, what there was to say in this process but that kernels are compiled."""
    return {kind: text for kind, text in _said.items() if kind != "compiling"}


# ---- whose folder -------------------------------------------------------------------------------


@functools.lru_cache
def unsafe(folder: str) -> str:
    """Who else could change what is loaded from `folder`, or "" where nobody can.

    Every folder above it counts, along the path as given and as links resolve it. On Windows, whose
    permissions say something else, nothing is checked: a profile is its user's.
    """
    if os.name != "posix":
        return ""
    given, real = Path(folder).absolute(), Path(folder).resolve()
    places = dict.fromkeys([given, real, *given.parents, *real.parents])
    reasons = (_shared(place, inside=place not in (given, real)) for place in places)
    return next(filter(None, reasons), "")


def _shared(place: Path, inside: bool = False) -> str:
    """Who else can write to a file or folder; in a sticky folder others can't touch what is `inside`."""
    try:
        found = place.lstat()
    except OSError as error:
        return f"{place}: {error.strerror}"
    if found.st_uid not in (0, os.geteuid()):
        return f"{place} belongs to another user (number {found.st_uid})"
    sticky = inside and found.st_mode & stat.S_ISVTX
    if stat.S_ISLNK(found.st_mode) or sticky or not found.st_mode & _WRITABLE:
        return ""
    if not found.st_mode & stat.S_IWOTH and _private(found.st_gid):
        return ""
    return f"others can write to {place} (chmod go-w takes that away)"


def _private(group: int) -> bool:
    """Whether a group is the user's alone: one of their name, without other members."""
    import grp
    import pwd

    try:
        own, found = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except KeyError:
        return False
    return found.gr_name == own.pw_name and set(found.gr_mem) <= {own.pw_name}


def _make(folder: Path) -> None:
    """Make a folder and those above it such that only their owner can write to them."""
    if not folder.is_dir():
        _make(folder.parent)
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o755)


class _Guarded:
    """What a locator of numba's becomes: it offers no folder that others can write to."""

    def ensure_cache_path(self) -> None:
        """OSError, which sends numba to the next locator, for a folder that will not do."""
        folder: str = self.get_cache_path()  # type: ignore[attr-defined]
        try:
            _make(Path(folder))
            reason = unsafe(folder)
            if reason:
                raise PermissionError(reason)
            super().ensure_cache_path()  # type: ignore[misc]
        except OSError as error:
            given: str = numba.config.CACHE_DIR  # type: ignore[attr-defined]
            if given and Path(folder).is_relative_to(given):
                _passed_over.append(_why(error))
            raise


def _why(error: BaseException) -> str:
    """An error in a few words."""
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}"
    return f"{type(error).__name__}: {error}"


_passed_over: list[str] = []  # why NUMBA_CACHE_DIR could not be used


class _Files(caching.CompileResultCacheImpl):
    """Numba's files of one kernel, in a folder that is its user's."""

    _locator_classes: Any = [  # noqa: RUF012 - as numba has it
        type(kind.__name__, (_Guarded, kind), {}) for kind in caching.CacheImpl._locator_classes
    ]


# ---- one kernel's files -------------------------------------------------------------------------


class KernelCache(caching.FunctionCache):
    """What is compiled of one kernel, on disk; it never ends a run.

    Args:
        function: the kernel.

    Raises RuntimeError if no folder can be used.
    """

    _impl_class = _Files

    def __init__(self, function: Any) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        reason = unsafe(self.cache_path)  # NUMBA_CACHE_LOCATOR_CLASSES may have found it
        if reason:
            raise RuntimeError(reason)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The kernel compiled for some types, or None if that must be done."""
        _say_passed_over()
        try:
            self._check()
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception as error:  # a damaged pickle may raise anything
            where = self.cache_path
            say("damaged", f"compiled code in {where} is not used but made anew ({_why(error)})")
            self._forget()
            return None
        if found is None:
            say("compiling", COMPILING)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, or say why that is not possible."""
        try:
            with _saving, _owner_only():
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except Exception as error:  # a damaged pickle may raise anything
            self._forget()  # the index may name a file that was not written
            say(
                UNKEPT,
                f"compiled code cannot be kept in {self.cache_path} ({_why(error)}): going on "
                f"without, it compiles again next time. Make room, or {REMEDY}",
            )

    def _paths(self) -> Iterator[Path]:
        """The index of the kernel's files, and these."""
        folder, base = Path(self.cache_path), self._impl.filename_base
        yield from folder.glob(f"{glob.escape(base)}.nbi")
        yield from folder.glob(f"{glob.escape(base)}.*.nbc")

    def _check(self) -> None:
        """PermissionError for a file that others wrote or can write, such as when the folder was theirs."""
        if os.name == "posix":
            for path in self._paths():
                if reason := _shared(path):
                    raise PermissionError(reason)

    def _forget(self) -> None:
        """Remove the kernel's files, or leave them alone from now on."""
        try:
            for path in self._paths():
                path.unlink(missing_ok=True)
        except OSError:
            self.disable()  # type: ignore[no-untyped-call]


class NoCache(caching.NullCache):
    """Of a kernel that has no folder for its compiled code.

    Args:
        reason: why.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason

    def load_overload(self, sig: Any, target_context: Any) -> None:  # noqa: ARG002 - numba's names
        """Nothing, which is said."""
        _say_passed_over()
        say(
            UNKEPT,
            f"compiled kernels cannot be kept ({self.reason}): they compile anew in each process, "
            f"some 5 to 20 s per filter. Better {REMEDY}",
        )


def cache_of(function: Any) -> KernelCache | NoCache:
    """Where a kernel's compiled code is kept."""
    try:
        return KernelCache(function)
    except RuntimeError:
        return NoCache("neither the package's folder nor your home can be used")
    except OSError as error:
        return NoCache(_why(error))


@contextlib.contextmanager
def _owner_only() -> Iterator[None]:
    """Files that are made in the block can be written by their owner alone, whatever the umask."""
    before = os.umask(0o022)
    os.umask(before | 0o022)
    try:
        yield
    finally:
        os.umask(before)


def _say_passed_over() -> None:
    if _passed_over:
        say("passed over", f"{VARIABLE} is not used ({_passed_over[0]}): {REMEDY}")
