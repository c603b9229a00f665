"""How kernels are compiled: three decorators, one cache policy.

`kernel` compiles a function that Python calls, or that several kernels call; its compiled code is
cached on disk. `part` compiles a function that only kernels call. Both take whole records,
ordinary arrays and scalars: numba passes the fixed-size arrays inside a record slowly across a
call. A helper that takes such an array is marked `inline`, is pasted into its caller, and is kept
to a few lines, since pasting costs compile time.

Numba's cache notices an edit of a kernel's own file but not of a callee in another file, so the
cache is dropped whenever the text of any file that holds kernels differs from the last import's.
"""

from __future__ import annotations

import contextlib
import hashlib
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parent


def kernel(function: Function) -> Function:
    """Compile `function` (nopython, no GIL, disk cache).

    Raises RuntimeError, naming the remedy, when no folder for the cache can be written.
    """
    try:
        compiled: Function = numba.njit(cache=True, error_model="numpy", nogil=True)(function)
    except RuntimeError as error:
        raise RuntimeError(
            f"navgym cannot cache its compiled kernels beside {_PACKAGE} or in your home folder "
            f"({error}). Set the environment variable NUMBA_CACHE_DIR to a folder that you can "
            "write to, for example NUMBA_CACHE_DIR=/tmp/navgym-cache."
        ) from error
    return compiled


def part(function: Function) -> Function:
    """Compile `function` into the kernels that call it."""
    compiled: Function = numba.njit(error_model="numpy", nogil=True, forceinline=True)(function)
    return compiled


def inline(function: Function) -> Function:
    """Paste `function` into each kernel that calls it."""
    pasted: Function = numba.njit(inline="always", error_model="numpy")(function)
    return pasted


def _drop_stale_cache() -> None:
    """Delete cached kernels if any source file has changed since they were compiled."""
    texts = [path.read_bytes() for path in sorted(_PACKAGE.rglob("*.py"))]
    stamp = hashlib.sha256(b"".join(t for t in texts if b"navgym._compile" in t)).hexdigest()
    cache = Path(numba.config.CACHE_DIR or _PACKAGE / "__pycache__")
    mark = cache / "navgym-sources.sha256"
    with contextlib.suppress(OSError):
        if mark.exists() and mark.read_text() == stamp:
            return
        root = cache if numba.config.CACHE_DIR else _PACKAGE
        for index in root.rglob("*.nbi"):
            if "navgym" in str(index):
                index.unlink(missing_ok=True)
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=cache, delete=False) as file:
            file.write(stamp)
        Path(file.name).replace(mark)


_drop_stale_cache()
