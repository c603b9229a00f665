"""How kernels are compiled: six decorators, one cache policy.

`kernel` compiles a function that Python calls; its compiled code is cached on disk; so does
`packed`. `part` compiles a function that only kernels call, `inner` one that they take in, `sums`
one that adds up many numbers (see `parts`). They take whole
records, ordinary arrays and scalars: numba passes the fixed-size arrays inside a record slowly across a
call. A helper that takes such an array is marked `inline`, is pasted into its caller, and is kept
to a few lines, since pasting costs compile time.

With NUMBA_DISABLE_JIT=1 nothing is compiled, for a debugger or a measurement of coverage: kernels
then run as the Python functions that they are, on records made to behave as compiled code sees them.

Numba's cache notices an edit of a kernel's own file but not of a callee in another file. So the
name under which a kernel is cached carries a hash of every kernel file that it can reach.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import inspect
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar, cast

import numba
import numpy as np

from navgym.core.kernel_cache import cache_of
from navgym.core.parts import Kernel, Part

Function = TypeVar("Function", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parents[1]
# what a kernel file holds, and a file whose constants kernels freeze
_MARKS = (b"from navgym.core.compile import", b"frozen into kernels")
_PLAIN: int = numba.config.DISABLE_JIT  # type: ignore[attr-defined]


@functools.lru_cache
def _fingerprint(file: str, package: Path = _PACKAGE) -> str:
    """Hash of the texts of `file` and of all kernel files that it imports, directly or not.

    This file is one of them: its decorators shape the code.
    """
    found: dict[Path, bytes] = {}
    open_ends = [Path(file)]
    while open_ends:
        path = open_ends.pop()
        if path not in found and path.is_file():
            found[path] = _content(path)
            open_ends += _kernel_files(path, package)
    texts = b"".join(text for _, text in sorted(found.items()))
    return hashlib.sha256(texts).hexdigest()[:12]


@functools.lru_cache
def _kernel_files(path: Path, package: Path) -> tuple[Path, ...]:
    """The kernel files that `path` imports, and those of constants frozen into kernels.

    They are looked for in `package` and in the package that `path` itself belongs to: a problem of
    one's own may have several files.
    """
    roots = {top.name: top for top in (_top(path), package)}
    modules = (m.split(".") for m in _imported(_content(path).decode()))
    files = [
        roots[names[0]].joinpath(*names[1:-1], f"{names[-1]}.py")
        for names in modules
        if names[0] in roots and len(names) > 1
    ]
    return tuple(f for f in files if f.is_file() and any(m in _content(f) for m in _MARKS))


def _top(path: Path) -> Path:
    """The outermost package that a file lies in; its folder where it lies in none."""
    folder = path.parent
    while (folder.parent / "__init__.py").is_file():
        folder = folder.parent
    return folder


@functools.lru_cache
def _content(path: Path) -> bytes:
    return path.read_bytes()


def _imported(text: str) -> set[str]:
    """Names of the modules that a file imports at its top, and names that may be modules in them.

    Only what stands above the first definition is parsed: the rest of a file takes 50 times as
    long, and holds no imports (ruff E402).
    """
    first = re.search(r"^(?:def \w+\(|class \w+[:(]|@\w)", text, re.MULTILINE)
    found: set[str] = set()
    for node in ast.walk(ast.parse(text[: first.start()] if first else text)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def kernel(function: Function) -> Function:
    """Compile `function` (nopython, no GIL), its compiled code kept on disk where that is safe."""
    if _PLAIN:
        return _interpreted(function)
    return _cached(function)


def packed(function: Function) -> Function:
    """A `kernel` in whose straight lines neighbouring numbers share vector instructions.

    That makes the deck's bank a third faster, its 24-state filter a twentieth, and the filters of
    four states a tenth slower: measure. Every digit is the same.
    """
    if _PLAIN:
        return _interpreted(function)
    return _cached(function, packed=True)


def _cached(function: Function, packed: bool = False) -> Function:
    function.__qualname__ += f"-{_fingerprint(inspect.getfile(function))}"
    compiled: Any = Kernel(function, packed=packed)
    compiled._cache = cache_of(function)
    return cast(Function, compiled)


def entry(compiled: Any, arguments: Sequence[Any]) -> Callable[..., Any]:
    """The machine code of kernel `compiled` for arguments of exactly these types.

    Looking up the types of record arrays costs more than a small kernel itself (6 of 9 µs for an
    environment step); the entry skips it. It does not check its arguments: whoever calls it must
    pass arrays of the same dtypes, dimensions and memory layout as `arguments`.
    """
    if _PLAIN:
        return cast(Callable[..., Any], compiled)
    machine_code: Callable[..., Any] = compiled.compile(
        tuple(numba.typeof(a) for a in arguments)  # type: ignore[no-untyped-call]
    )
    return machine_code


def part(function: Function) -> Function:
    """Compile `function` into the kernels that call it."""
    if _PLAIN:
        return _lenient(function)
    return cast(Function, Part(function))


def inner(function: Function) -> Function:
    """A `part` of a filter's innermost loops, which LLVM is made to take into each of its callers.

    Where a part is large LLVM leaves a call, which costs `qivbf` a tenth; but a part that is taken
    into many callers is optimised as many times. So this is for the few that a measurement names.
    """
    if _PLAIN:
        return _lenient(function)
    return cast(Function, Part(function, targetoptions={"forceinline": True}))


def sums(function: Function) -> Function:
    """A `part` whose sums may be taken in another order, in several parts at once.

    In Python's order a sum waits for each of its terms, which makes long sums four times slower. Any
    order is the same on every run of a machine, but may differ in the last digit on another one.
    """
    if _PLAIN:
        return _lenient(function)
    return cast(Function, Part(function, targetoptions={"fastmath": {"reassoc"}}))


def inline(function: Function) -> Function:
    """Paste `function` into each kernel that calls it."""
    if _PLAIN:
        return _lenient(function)
    pasted: Any = numba.njit(inline="always", error_model="numpy")(function)
    return cast(Function, pasted)


# Only with NUMBA_DISABLE_JIT=1: kernels as plain Python.


class _Record:
    """A numpy record whose fields are attributes, read and written in place."""

    __slots__ = ("_record",)

    def __init__(self, record: Any) -> None:
        object.__setattr__(self, "_record", record)

    def __getattr__(self, name: str) -> Any:
        if name not in self._record.dtype.names:
            raise AttributeError(f"no field {name!r}: there are {self._record.dtype.names}")
        return _seen(self._record[name])

    def __setattr__(self, name: str, value: Any) -> None:
        self._record[name] = value

    def __dir__(self) -> tuple[str, ...]:
        return cast(tuple[str, ...], self._record.dtype.names)

    def __repr__(self) -> str:
        return "\n".join(f"{name} = {self._record[name]!r}" for name in self.__dir__())


class _Records(np.ndarray[Any, Any]):
    """An array of records whose elements are `_Record`s."""

    def __getitem__(self, index: Any) -> Any:
        return _seen(super().__getitem__(index))

    def __setitem__(self, index: Any, value: Any) -> None:
        super().__setitem__(index, value._record if isinstance(value, _Record) else value)


def _seen(value: Any) -> Any:
    """`value` as compiled code sees it: fields are attributes, and 1.0 / 0.0 is infinite."""
    if isinstance(value, np.void):
        return _Record(value)
    if isinstance(value, np.ndarray) and value.dtype.names:
        return value.view(_Records)
    return np.float64(value) if type(value) is float else value


def _interpreted(function: Function) -> Function:
    """`function` itself, on arguments as compiled code sees them, and with its silence."""

    @functools.wraps(function)
    def run(*arguments: Any, **named: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*map(_seen, arguments), **{n: _seen(a) for n, a in named.items()})

    return cast(Function, _lenient(run))


def _lenient(function: Function) -> Function:
    """`function`, in whose module `math` answers NaN or infinity where Python's would raise."""
    names = inspect.unwrap(function).__globals__
    if names.get("math") is math:
        names["math"] = _kernel_math()
    return function


@functools.cache
def _kernel_math() -> SimpleNamespace:
    """`math`, but numpy's answer where Python's raises; floats are numpy's, as those of `_seen`."""

    def answering(function: Callable[..., Any]) -> Callable[..., Any]:
        def answer(*arguments: Any) -> Any:
            try:
                return _seen(function(*arguments))
            except (ValueError, OverflowError):
                return getattr(np, function.__name__)(*arguments)

        return answer

    own = vars(math).items()
    return SimpleNamespace(**{name: answering(f) if callable(f) else f for name, f in own})
