"""The golden outputs as a book: a CSV file per room, one line per array, sorted by its key.

A line holds a hash of the array's bits and a summary of its numbers. Bits are compared on the
platform that wrote the file, which is named in its first line; a compiler, a BLAS or a processor
of another kind rounds otherwise, and there only the summary is compared, to `TOLERANCE` or to what
`TOLERANCES` says.
"""

from __future__ import annotations

import csv
import hashlib
import importlib.metadata
import math
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import llvmlite.binding  # type: ignore[import-untyped]
import numba
import numpy as np

FOLDER = Path(__file__).parent
COLUMNS = ("key", "bits", "shape", "missing", "rms", "mean", "mixture")
PACKAGES = (
    "numpy", "scipy", "numba", "llvmlite", "gymnasium", "optuna", "cmaes", "scikit-learn", "mealpy",
    "torch", "stable-baselines3",
)  # fmt: skip

TOLERANCE = 1e-9  # relative to the rms: rounding is 1e-16, and filters amplify it a thousand times
# What amplifies rounding more: tolerance and reason, by the first pattern that fits. Measured as the
# change between this platform and an emulated one without AVX and FMA (kernels, libm, BLAS, numpy
# and torch). At least a hundred times that is granted: another processor may do worse.
TOLERANCES: Mapping[str, tuple[float, str]] = {
    "training/*": (1e-3, "dozens of gradient steps in single precision; measured 6e-7"),
    "learned/combiner/*": (TOLERANCE, "in double precision"),
    "learned/*": (1e-4, "the policy is in single precision, so are its actions; measured 4e-7"),
    "environment/*/observations": (1e-6, "single precision: a last bit is 6e-8"),
    "environment/*/sb3/rewards": (1e-6, "single precision: a last bit is 6e-8"),
    "method/svr/*": (1e-4, "support vectors up to libsvm's own tolerance; measured 5e-7"),
    "method/metrics/*": (TOLERANCE, "sums and medians"),
    "method/bounds/*": (TOLERANCE, "linear algebra of four states"),
    "method/*": (1e-5, "searches end where rounding lets them; measured 9e-8"),
    "filter/identifying/*": (1e-5, "filters on what these searches found; measured 3e-8"),
}


@dataclass(frozen=True)
class Line:
    """One array: its bits, and a summary that another platform can be held to.

    Args:
        bits: start of the SHA-256 of dtype, shape and bytes.
        shape: kind of number and shape, such as "f8:80x4".
        missing: count of NaN and infinities; the others are what the numbers are of.
        rms: root mean square.
        mean: of all.
        mixture: Σ wᵢ xᵢ / √count, x in units of its column's rms, w fixed and pseudo-random: an
            error anywhere shows, also in a small state beside large ones.
    """

    bits: str
    shape: str
    missing: int
    rms: float
    mean: float
    mixture: float

    @classmethod
    def of(cls, value: Any) -> Line:
        """Summary of an array, a number, or a list of them."""
        array = np.ascontiguousarray(value)
        kind = f"{array.dtype.kind}{array.dtype.itemsize}:" + "x".join(map(str, array.shape))
        bits = hashlib.sha256(kind.encode() + array.tobytes()).hexdigest()[:12]
        x = array.astype(np.float64)
        finite = np.isfinite(x)
        x = np.where(finite, x, 0.0)
        count = max(int(finite.sum()), 1)
        rms = math.sqrt(float((x**2).sum()) / count)
        mean = float(x.sum()) / count
        return cls(bits, kind, int((~finite).sum()), rms, mean, _mixture(x, finite, rms))

    @classmethod
    def read(cls, row: Mapping[str, str]) -> Line:
        """The line that `cells` wrote."""
        numbers = (float(row[name]) for name in COLUMNS[4:])
        return cls(row["bits"], row["shape"], int(row["missing"]), *numbers)

    def cells(self) -> list[str]:
        """As text: eleven digits are what a tolerance of 1e-9 needs."""
        numbers = (self.rms, self.mean, self.mixture)
        return [self.bits, self.shape, str(self.missing), *(f"{v:.11g}" for v in numbers)]

    def near(self, other: Line, tolerance: float) -> bool:
        """Whether the summaries agree."""
        scale = max(self.rms, other.rms)
        return (
            (self.shape, self.missing) == (other.shape, other.missing)
            and abs(self.rms - other.rms) <= tolerance * scale
            and abs(self.mean - other.mean) <= tolerance * scale
            and abs(self.mixture - other.mixture) <= tolerance * max(1.0, abs(self.mixture))
        )


def _mixture(x: Any, finite: Any, rms: float) -> float:
    """See `Line`. Columns below a millionth of the whole count as that: they may be rounding."""
    if rms == 0.0:
        return 0.0
    table = x.reshape(len(x), -1) if x.ndim else x.reshape(1, 1)
    there = np.maximum(finite.reshape(table.shape).sum(axis=0), 1)
    scale = np.maximum(np.sqrt((table**2).sum(axis=0) / there), 1e-6 * rms)
    # Knuth's multiplicative hash: whole numbers, the same everywhere
    weights = (np.arange(1, table.size + 1) * 2654435761 % 2**32) / 2.0**31 - 1.0
    return float(((table / scale).ravel() * weights).sum()) / math.sqrt(table.size)


def here() -> str:
    """What decides about rounding: processor, mathematical library and versions."""
    binding: Any = llvmlite.binding
    processor = numba.config.CPU_NAME or binding.get_host_cpu_name()  # type: ignore[attr-defined]
    features = hashlib.sha256(binding.get_host_cpu_features().flatten().encode()).hexdigest()[:6]
    found = [f"{platform.system()} {platform.machine()} {processor} {features}"]
    found += [" ".join(platform.libc_ver()), f"python {platform.python_version()}"]
    found += [f"{name} {importlib.metadata.version(name)}" for name in PACKAGES]
    return "; ".join(found)


def path_of(room: str) -> Path:
    """The room's file."""
    return FOLDER / f"{room}.csv"


def read(room: str) -> tuple[str, dict[str, Line]]:
    """The platform that wrote a room's file, and its lines by key; nothing where there is no file."""
    path = path_of(room)
    if not path.exists():
        return "", {}
    first, *rest = path.read_text(encoding="utf-8").splitlines()
    return first.removeprefix("# "), {row["key"]: Line.read(row) for row in csv.DictReader(rest)}


def write(room: str, lines: Mapping[str, Line]) -> None:
    """Replace a room's file."""
    rows = [",".join([key, *lines[key].cells()]) for key in sorted(lines)]
    text = "\n".join([f"# {here()}", ",".join(COLUMNS), *rows])
    path_of(room).write_text(text + "\n", encoding="utf-8", newline="\n")


def lines_of(entries: Iterable[tuple[str, Any]], only: str = "") -> dict[str, Line]:
    """Lines of a room's entries whose keys begin with `only`; ValueError for a key used twice."""
    found: dict[str, Line] = {}
    for key, value in entries:
        if key in found or not set(key).isdisjoint(", \n"):
            raise ValueError(f"key {key!r} is used twice, or holds a comma or a space.")
        if key.startswith(only):
            found[key] = Line.of(value)
    return found


def tolerance_of(key: str) -> float:
    """What a summary may differ by on another platform."""
    for pattern, (tolerance, _) in TOLERANCES.items():
        if fnmatch(key, pattern):
            return tolerance
    return TOLERANCE


def changes(
    old: Mapping[str, Line], new: Mapping[str, Line], same_platform: bool
) -> dict[str, tuple[Line | None, Line | None]]:
    """Lines that differ, by key: the old one and the new one, None where there is none."""
    found: dict[str, tuple[Line | None, Line | None]] = {}
    for key in sorted({*old, *new}):
        before, after = old.get(key), new.get(key)
        if before is None or after is None:
            changed = True
        elif same_platform:
            changed = before.bits != after.bits
        else:
            changed = not before.near(after, tolerance_of(key))
        if changed:
            found[key] = (before, after)
    return found


def shown(key: str, before: Line | None, after: Line | None) -> str:
    """A change as a maintainer reads it."""
    lines = [f"{key}: {'new' if before is None else 'missing' if after is None else 'changed'}"]
    for sign, line in (("-", before), ("+", after)):
        if line is not None:
            pairs = zip(COLUMNS[1:], line.cells(), strict=True)
            lines.append(f"  {sign} " + "  ".join(f"{name} {cell}" for name, cell in pairs))
    return "\n".join(lines)
