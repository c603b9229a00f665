"""What a run says: columns of numbers by time, from a CSV or from a function, checked."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from navgym.core.checks import Array, one_of
from navgym.tuning.programs.runner import Failed

# what a column is by how its name begins, where the contract does not say; the first that fits
BEGINNINGS = {
    "time": ("time", "timestamp", "t"),
    "log_likelihood": ("log_likelihood", "loglik", "ll"),
    "nis": ("nis",),
    "variance": ("variance", "innovation_variance", "s"),
    "innovation": ("innovation", "nu"),
    "reference": ("reference", "ref", "truth"),
    "estimate": ("estimate", "est"),
}
_ALONE = {
    "t",
    "s",
    "nu",
    "ll",
    "nis",
    "est",
    "ref",
}  # too short to begin a longer name, but for _1, _x


@dataclass(frozen=True)
class Columns:
    """Which columns of a run's output mean what; empty: told by their names.

    Args:
        time: name of the column of times, s.
        innovation: names, a column per measured component.
        variance: names, the innovations' variances.
        nis: name of normalised innovations squared.
        components: how many components a NIS or log-likelihood is of.
        log_likelihood: name, of each row's innovation.
        estimate: names, to be compared with a reference.
        reference: names, likewise; in the same file, or in `reference_file`.
        reference_file: its path, with {name} and {folder} of the log; a CSV with time, s.
        unit: of innovations or estimates.
    """

    time: str = ""
    innovation: tuple[str, ...] = ()
    variance: tuple[str, ...] = ()
    nis: str = ""
    components: int = 1
    log_likelihood: str = ""
    estimate: tuple[str, ...] = ()
    reference: tuple[str, ...] = ()
    reference_file: str = ""
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Output:
    """A run's columns.

    Args:
        time: (n,) s.
        innovation: (n, m) or None; NaN where nothing was received.
        variance: (n, m) or None.
        nis: (n,) or None.
        log_likelihood: (n,) or None.
        components: that NIS and log-likelihood are of.
        error: (n, k) estimate less reference, or None.
    """

    time: Array
    innovation: Array | None = None
    variance: Array | None = None
    nis: Array | None = None
    log_likelihood: Array | None = None
    components: int = 1
    error: Array | None = None

    @property
    def kinds(self) -> tuple[str, ...]:
        """What there is, with the number of its columns, to tell logs of different kinds apart."""
        named = ("innovation", "variance", "nis", "log_likelihood", "error")
        found = {n: getattr(self, n) for n in named}
        return tuple(
            n if each.ndim == 1 else f"{n} x {each.shape[1]}"
            for n, each in found.items()
            if each is not None
        )


@dataclass(frozen=True, eq=False)
class Table:
    """Columns by name."""

    columns: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path, what: str = "{out}") -> Table:
        """A CSV with a line of names; `Failed` for anything else."""
        try:
            text = path.read_bytes().decode("utf-8")
        except UnicodeDecodeError as error:
            raise Failed("garbage", f"{what} is no text (byte {error.start})") from None
        head, _, body = text.lstrip("\ufeff").partition("\n")
        names = [name.strip().strip('"') for name in re.split("[,;\t]", head.strip().lstrip("# "))]
        if not body.strip():
            raise Failed(
                "no output" if not head.strip() else "no rows", f"{what} holds {head[:60]!r}"
            )
        if all(_is_number(name) for name in names):
            raise Failed("garbage", f"{what} begins with numbers: its first line must name columns")
        if len(set(names)) < len(names):
            raise Failed("garbage", f"{what} names a column twice: {head[:80]!r}")
        return cls(dict(zip(names, _numbers(body, len(names), what).T, strict=True)))

    def find(self, kind: str, named: str | tuple[str, ...]) -> list[Array]:
        """Columns of a kind: those that are named, or those whose names begin so."""
        if named:
            wanted = (named,) if isinstance(named, str) else named
            try:
                return [self.columns[one_of("column", name, self.columns)] for name in wanted]
            except ValueError as error:
                raise Failed("no such column", str(error)) from None
        return [each for name, each in self.columns.items() if _kind(name) == kind]


def _kind(name: str) -> str:
    plain = name.strip().lower()
    for kind, words in BEGINNINGS.items():
        for word in words:
            end = r"(_[a-z0-9]{1,2})?$" if word in _ALONE else r"([_\W\d]|$)"
            if re.match(f"{word}{end}", plain):
                return kind
    return ""


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _numbers(body: str, width: int, what: str) -> Array:
    """Rows of numbers, empty cells being NaN."""
    plain = body.translate({ord(";"): ",", ord("\t"): ","})
    try:
        return _loaded(plain, width)
    except ValueError:
        pass
    filled = re.sub(r"(?m)(^|,)[ \r]*(?=,|$)", r"\1nan", plain.strip("\n"))
    try:
        return _loaded(filled, width)
    except ValueError:
        raise Failed("garbage", _where(filled, width, what)) from None


def _loaded(text: str, width: int) -> Array:
    table = np.loadtxt(io.StringIO(text), delimiter=",", ndmin=2, comments="#")
    if table.shape[1] != width:
        raise ValueError
    return table


def _where(text: str, width: int, what: str) -> str:
    """Which line of a CSV is wrong."""
    for number, line in enumerate(text.splitlines(), start=2):
        cells = line.split(",")
        if len(cells) != width:
            return f"line {number} of {what} has {len(cells)} cells where {width} are named"
        bad = [cell for cell in cells if not _is_number(cell)]
        if bad:
            return f"line {number} of {what} holds {bad[0][:40]!r} where a number is needed"
    return f"{what} holds no table of numbers"


# ---- columns to an output


def of_table(table: Table, columns: Columns, log: str) -> Output:
    """The output that a table holds; `Failed` if it holds nothing to judge by.

    Args:
        table: columns by name.
        columns: what they mean.
        log: path of the log, for the reference beside it.
    """
    times = table.find("time", columns.time)
    if not times:
        raise Failed("no such column", f"no column of times among {', '.join(table.columns)}")
    time = times[0]
    found = {
        kind: table.find(kind, getattr(columns, kind)) for kind in BEGINNINGS if kind != "time"
    }
    error = _error(found["estimate"], found["reference"], time, columns, log)
    return checked(
        Output(
            time, _stacked(found["innovation"]), _stacked(found["variance"]),
            found["nis"][0] if found["nis"] else None,
            found["log_likelihood"][0] if found["log_likelihood"] else None,
            columns.components, error,
        )
    )  # fmt: skip


def _stacked(columns: list[Array]) -> Array | None:
    return np.column_stack(columns) if columns else None


def _error(
    estimate: list[Array], reference: list[Array], time: Array, columns: Columns, log: str
) -> Array | None:
    """Estimate less reference, which is in the same file or beside the log."""
    if not estimate:
        return None
    if columns.reference_file:
        reference = _beside(columns, log, time)
    if len(reference) != len(estimate):
        raise Failed(
            "no such column",
            f"{len(estimate)} columns of estimates and {len(reference)} of references: name them in "
            "[output], as estimate and reference",
        )
    return np.column_stack([a - b for a, b in zip(estimate, reference, strict=True)])


def _beside(columns: Columns, log: str, time: Array) -> list[Array]:
    """The reference of a log, at the output's times; NaN outside of it."""
    place = Path(log)
    path = Path(columns.reference_file.format(name=place.stem, folder=place.parent))
    if not path.is_file():
        raise Failed("no reference", f"there is no {path}")
    table = Table.read(path, path.name)
    times = table.find("time", "time" if "time" in table.columns else columns.time)
    if not times or not (np.diff(times[0]) > 0.0).all():
        raise Failed("no reference", f"{path.name} has no column of rising times")
    shared = tuple(n for n in columns.estimate if n in table.columns)
    found = table.find("reference", columns.reference or shared)
    return [np.interp(time, times[0], each, left=np.nan, right=np.nan) for each in found]


def of_anything(found: Any, columns: Columns, log: str = "") -> Output:
    """What a function returned as an output: an `Output`; a mapping or a frame of columns; an object
    with attributes `time` and `innovation` and `variance`, `nis`, `log_likelihood`, or `error`.

    Raises `Failed` for anything else.
    """
    if isinstance(found, Output):
        return checked(found)
    if hasattr(found, "to_dict") and hasattr(found, "columns"):  # a pandas frame, or its like
        found = {str(name): np.asarray(found[name]) for name in found.columns}
    if isinstance(found, Mapping):
        flat: dict[str, Array] = {}
        for name, each in found.items():
            values = _real(name, each)
            if values.ndim == 2:
                flat |= {f"{name}_{i}": values[:, i] for i in range(values.shape[1])}
            else:
                flat[str(name)] = values
        return of_table(Table(flat), columns, log)
    if hasattr(found, "time"):
        wanted = ("innovation", "variance", "nis", "log_likelihood", "error")
        told = {n: getattr(found, n, None) for n in wanted}
        held = {n: _real(n, each) for n, each in told.items() if each is not None}
        for name in ("innovation", "variance", "error"):
            if name in held and held[name].ndim == 1:
                held[name] = held[name][:, None]
        return checked(Output(_real("time", found.time), components=columns.components, **held))
    raise Failed(
        "garbage", f"the function returned a {type(found).__name__}: return columns by name"
    )


def _real(name: Any, value: Any) -> Array:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise Failed("garbage", f"{name} holds no numbers ({error})") from None


def checked(output: Output) -> Output:
    """`output`; `Failed` where times, shapes or variances cannot be."""
    rows = len(output.time) if output.time.ndim == 1 else 0
    if rows == 0:
        raise Failed("no rows")
    if not np.isfinite(output.time).all() or (np.diff(output.time) < 0.0).any():
        raise Failed("garbage", "times must be finite and must not go back")
    for name in ("innovation", "variance", "nis", "log_likelihood", "error"):
        each = getattr(output, name)
        if each is not None and len(each) != rows:
            raise Failed("garbage", f"{name} has {len(each)} rows where time has {rows}")
    one, two = output.innovation, output.variance
    if one is not None and two is not None and one.shape != two.shape:
        raise Failed("garbage", f"innovation is {one.shape} and its variance {two.shape}")
    if two is not None and (two <= 0.0).any():
        raise Failed("not positive", "a variance of the innovation is not positive")
    if not output.kinds or output.kinds == (f"variance x {0 if two is None else two.shape[1]}",):
        raise Failed(
            "no such column", "neither innovation, NIS, log-likelihood nor an error is there"
        )
    return output
