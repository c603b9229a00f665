"""How kernels are compiled: three decorators, one cache policy.

`kernel` compiles a function that Python calls, or that several kernels call; its compiled code is
cached on disk. `part` compiles a function that only kernels call. Both take whole records,
ordinary arrays and scalars: numba passes the fixed-size arrays inside a record slowly across a
call. A helper that takes such an array is marked `inline`, is pasted into its caller, and is kept
to a few lines, since pasting costs compile time.

Numba's cache notices an edit of a kernel's own file but not of a callee in another file. So the
name under which a kernel is cached carries a hash of every kernel file that it can reach.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parent


@functools.lru_cache
def _fingerprint(file: str) -> str:
    """Hash of the texts of `file` and of all kernel files that it imports, directly or not."""
    found: dict[Path, bytes] = {}
    open_ends = [Path(file)]
    while open_ends:
        path = open_ends.pop()
        if path in found or not path.is_file():
            continue
        found[path] = path.read_bytes()
        for module in re.findall(r"^from (navgym[\w.]*) import", found[path].decode(), re.M):
            stem = _PACKAGE.parent / module.replace(".", "/")
            candidates = (stem.with_suffix(".py"), *_named(found[path].decode(), module, stem))
            open_ends += [c for c in candidates if c.is_file() and _holds_kernels(c)]
    texts = b"".join(text for _, text in sorted(found.items()))
    return hashlib.sha256(texts).hexdigest()[:12]


def _named(text: str, module: str, folder: Path) -> list[Path]:
    """Modules that `from module import a, b` names, where module is a package."""
    names = re.findall(rf"^from {re.escape(module)} import ([\w, ]+)$", text, re.M)
    return [folder / f"{name.strip()}.py" for line in names for name in line.split(",")]


def _holds_kernels(path: Path) -> bool:
    return b"from navgym._compile import" in path.read_bytes()


def kernel(function: Function) -> Function:
    """Compile `function` (nopython, no GIL, disk cache).

    Raises RuntimeError, naming the remedy, when no folder for the cache can be written.
    """
    function.__qualname__ += f"-{_fingerprint(inspect.getfile(function))}"
    try:
        compiled: Any = numba.njit(cache=True, error_model="numpy", nogil=True)(function)
    except RuntimeError as error:
        raise RuntimeError(
            f"navgym cannot cache its compiled kernels beside {_PACKAGE} or in your home folder "
            f"({error}). Set the environment variable NUMBA_CACHE_DIR to a folder that you can "
            "write to, for example NUMBA_CACHE_DIR=/tmp/navgym-cache."
        ) from error
    return cast(Function, compiled)


def entry(compiled: Any, arguments: Sequence[Any]) -> Callable[..., Any]:
    """The machine code of kernel `compiled` for arguments of exactly these types.

    Looking up the types of record arrays costs more than a small kernel itself (6 of 9 µs for an
    environment step); the entry skips it. It does not check its arguments: whoever calls it must
    pass arrays of the same dtypes, dimensions and memory layout as `arguments`.
    """
    machine_code: Callable[..., Any] = compiled.compile(
        tuple(numba.typeof(a) for a in arguments)  # type: ignore[no-untyped-call]
    )
    return machine_code


def part(function: Function) -> Function:
    """Compile `function` into the kernels that call it."""
    compiled: Any = numba.njit(error_model="numpy", nogil=True, forceinline=True)(function)
    return cast(Function, compiled)


def inline(function: Function) -> Function:
    """Paste `function` into each kernel that calls it."""
    pasted: Any = numba.njit(inline="always", error_model="numpy")(function)
    return cast(Function, pasted)
