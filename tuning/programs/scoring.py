"""What a run is worth: sums of each quantity over stretches of the log, and losses made of them.

A log is cut into `BLOCKS` stretches of equal time, and of a run nothing is kept but a sum and a count
per stretch and quantity. So one run serves every part of a log that is tuned on, chosen on or reported,
its intervals too, and a study's runs fit on the disk. Where the stretches begin, how many rows are heard
in each and where an innovation is cut is the *ruler* of a log; the run at the defaults makes it.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from navgym.core.checks import Array, one_of
from navgym.metrics.measures import CLIP, NIS, NLL, Measure, Quantity, spreads
from navgym.tuning.programs.output import Output
from navgym.tuning.programs.runner import Failed

BLOCKS = 240
LEAST_ROWS = 0.9  # of the rows that the defaults give, that a run must give to count
LOG_2_PI = math.log(2.0 * math.pi)

Span = tuple[int, int]


def measures(unit: str = "") -> dict[str, Measure]:
    """What can be minimised, by name; those with a likelihood first.

    Args:
        unit: of innovations and errors.
    """
    one_step = Quantity("one_step", "one-step error", unit, needs_truth=False)
    error = Quantity("rmse", "RMSE against the reference", unit)
    made = (
        Measure("likelihood", "negative log-likelihood of an innovation component", (NLL,)),
        Measure("one_step", "root of the mean squared innovation, each cut at two robust deviations", (one_step,)),
        Measure("rmse", "root of the mean squared error against a reference", (error,)),
        Measure("consistency", "|ln| of the mean NIS per component", (NIS,)),
    )  # fmt: skip
    return {m.name: m for m in made}


# what each measure's sums are called in a run
SUMS = {"likelihood": "nll", "one_step": "one_step", "rmse": "rmse", "consistency": "nis"}


def chosen(name: str | None, kinds: Sequence[str], unit: str = "") -> Measure:
    """The measure called `name`, or the first that outputs of these kinds allow.

    Raises ValueError for a measure that they do not.
    """
    able = possible(kinds)
    if name is None:
        return measures(unit)[able[0]]
    one_of("measure", name, measures())
    if name not in able:
        raise ValueError(
            f"measure {name!r} needs columns that the program does not write ({', '.join(kinds)}): "
            f"use {' or '.join(map(repr, able))}."
        )
    return measures(unit)[name]


def possible(kinds: Sequence[str]) -> list[str]:
    """Names of the measures that an output allows."""
    has = {kind.partition(" ")[0] for kind in kinds}
    whole = {"innovation", "variance"} <= has
    rules = {
        "likelihood": whole or "log_likelihood" in has,
        "rmse": "error" in has,
        "one_step": "innovation" in has,
        "consistency": whole or "nis" in has,
    }
    return [name for name, able in rules.items() if able]


@dataclass(frozen=True)
class Ruler:
    """How runs on one log are cut and held against each other.

    Args:
        begin: s, of the first stretch.
        end: s, of the last one.
        rows: that the defaults give in each stretch, by quantity.
        cuts: beyond which an innovation counts as so much, per component.
        weights: of squared innovations, per component.
        kinds: what the output holds.
    """

    begin: float
    end: float
    rows: Mapping[str, tuple[int, ...]]
    cuts: tuple[float, ...]
    weights: tuple[float, ...]
    kinds: tuple[str, ...]

    @classmethod
    def of(cls, output: Output) -> Ruler:
        """From the output of the run at the defaults; `Failed` if it spans no time."""
        begin, end = float(output.time[0]), float(output.time[-1])
        if not begin < end:
            raise Failed("no rows", f"its times are all {begin:g} s")
        cuts: tuple[float, ...] = ()
        weights: tuple[float, ...] = ()
        if output.innovation is not None:
            known = np.where(np.isfinite(output.innovation), output.innovation, np.nan)
            spread = spreads(known[None])[0]
            cuts = tuple(CLIP * spread)
            several = len(spread) > 1  # of which each counts alike, whatever its unit
            weights = tuple(1.0 / spread**2 / len(spread) if several else np.ones(1))
        plain = cls(begin, end, {}, cuts, weights, output.kinds)
        counts = {n: tuple(c.astype(int).tolist()) for n, (_, c) in plain.sums(output).items()}
        return cls(begin, end, counts, cuts, weights, output.kinds)

    @classmethod
    def of_dict(cls, told: Mapping[str, Any]) -> Ruler:
        """From what JSON gives back of `as_dict`."""
        rows = {n: tuple(map(int, r)) for n, r in told["rows"].items()}
        cuts, weights = tuple(map(float, told["cuts"])), tuple(map(float, told["weights"]))
        return cls(
            float(told["begin"]), float(told["end"]), rows, cuts, weights, tuple(told["kinds"])
        )

    def as_dict(self) -> dict[str, Any]:
        """As JSON can hold it."""
        return {
            "begin": self.begin, "end": self.end, "rows": {n: list(r) for n, r in self.rows.items()},
            "cuts": list(self.cuts), "weights": list(self.weights), "kinds": list(self.kinds),
        }  # fmt: skip

    @functools.cached_property
    def digest(self) -> str:
        """Fingerprint."""
        text = json.dumps(self.as_dict(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def sums(self, output: Output) -> dict[str, tuple[Array, Array]]:
        """Sum and count (BLOCKS,) of each quantity per stretch; rows outside the log's time are left."""
        place = (output.time - self.begin) / (self.end - self.begin)
        inside = (place >= 0.0) & (place <= 1.0)
        where = np.minimum((np.where(inside, place, 0.0) * BLOCKS).astype(np.int64), BLOCKS - 1)
        made: dict[str, tuple[Array, Array]] = {}
        for name, (each, count) in _rows(output, self).items():
            heard = inside & (count > 0)
            with np.errstate(invalid="ignore"):
                total, rows = (
                    np.asarray(np.bincount(where[heard], a[heard], BLOCKS), dtype=np.float64) for a in (each, count)
                )  # fmt: skip
            made[name] = total, rows
        return made

    def components(self, quantity: str, span: Span) -> int:
        """What the defaults give of a quantity between two stretches."""
        return sum(self.rows[quantity][span[0] : span[1]])


def _rows(output: Output, ruler: Ruler) -> dict[str, tuple[Array, Array]]:
    """Per quantity what each row adds (n,), and of how many components; infinite is infinite."""
    made: dict[str, tuple[Array, Array]] = {}
    one, two = output.innovation, output.variance
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        if one is not None:
            known = ~np.isnan(one)
            size = np.where(known, np.minimum(np.abs(one), np.array(ruler.cuts)), 0.0)
            lost = np.where(np.isinf(one).any(axis=1), np.inf, 0.0)
            each = (size**2 * np.array(ruler.weights)).sum(axis=1) + lost
            made["one_step"] = each, known.any(axis=1).astype(float)
        if one is not None and two is not None:
            known = ~np.isnan(one) & ~np.isnan(two)
            square = np.where(known, one**2 / two, 0.0)
            made["nis"] = square.sum(axis=1), known.sum(axis=1).astype(float)
            logs = np.where(known, 0.5 * (np.log(two) + LOG_2_PI), 0.0)
            made["nll"] = (0.5 * square + logs).sum(axis=1), known.sum(axis=1).astype(float)
        for name, given, sign in (("nis", output.nis, 1.0), ("nll", output.log_likelihood, -1.0)):
            if given is not None:
                known = ~np.isnan(given)
                made[name] = np.where(known, sign * given, 0.0), output.components * known
        if output.error is not None:
            known = np.asarray(~np.isnan(output.error).any(axis=1))
            square = (output.error**2).sum(axis=1)
            made["rmse"] = np.where(known, square, 0.0), known.astype(float)
    return made


@dataclass(frozen=True, eq=False)
class Run:
    """What is kept of a run.

    Args:
        sums: (BLOCKS,) by quantity.
        counts: (BLOCKS,) likewise.
        rows: of the output.
        seconds: that it took.
    """

    sums: Mapping[str, Array]
    counts: Mapping[str, Array]
    rows: int
    seconds: float

    @classmethod
    def of(cls, output: Output, ruler: Ruler, seconds: float) -> Run:
        """Cut an output by a log's ruler; `Failed` where it is of another kind than the defaults'."""
        if output.kinds != ruler.kinds:
            raise Failed(
                "other columns", f"{', '.join(output.kinds)} in place of {', '.join(ruler.kinds)}"
            )
        found = ruler.sums(output)
        return cls(
            {n: s for n, (s, _) in found.items()}, {n: c for n, (_, c) in found.items()},
            len(output.time), seconds,
        )  # fmt: skip

    @classmethod
    def of_dict(cls, told: Mapping[str, Any]) -> Run:
        """From what JSON gives back of `as_dict`."""
        sums, counts = (
            {n: np.array(v, dtype=np.float64) for n, v in told[key].items()} for key in ("sums", "counts")
        )  # fmt: skip
        if any(each.shape != (BLOCKS,) for each in (*sums.values(), *counts.values())):
            raise ValueError("stretches of another number")
        return cls(sums, counts, int(told["rows"]), float(told["seconds"]))

    def as_dict(self) -> dict[str, Any]:
        """As JSON can hold it."""
        return {
            "sums": {n: s.tolist() for n, s in self.sums.items()},
            "counts": {n: c.astype(int).tolist() for n, c in self.counts.items()},
            "rows": self.rows, "seconds": self.seconds,
        }  # fmt: skip

    def loss(self, measure: str, ruler: Ruler, span: Span) -> float:
        """A measure between two stretches; `Failed` where too few rows are there to judge by."""
        name = SUMS[measure]
        count, wanted = self.counts[name][span[0] : span[1]].sum(), ruler.components(name, span)
        if count < max(LEAST_ROWS * wanted, 1.0):
            raise Failed(
                "too few rows", f"{int(count)} values of {name} where the defaults give {wanted}"
            )
        return float(value(measure, float(self.sums[name][span[0] : span[1]].sum()), float(count)))


def value(measure: str, total: Any, count: Any) -> Any:
    """A measure from a sum and a count, numbers or arrays."""
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.asarray(total) / np.asarray(count)
        if measure in ("one_step", "rmse"):
            mean = np.sqrt(mean)
        elif measure == "consistency":
            mean = np.abs(np.log(mean))
    return float(mean) if np.ndim(mean) == 0 else mean


def traces(run: Run, measure: str, span: Span) -> Array:
    """What each stretch's rows add to a measure in the mean, (BLOCKS,); NaN outside of `span`."""
    name = SUMS[measure]
    where = np.arange(BLOCKS)
    heard = (run.counts[name] > 0) & (where >= span[0]) & (where < span[1])
    return np.where(heard, run.sums[name] / np.maximum(run.counts[name], 1.0), np.nan)


def blocks_of(share: tuple[float, float]) -> Span:
    """The stretches between two shares of a log."""
    return round(share[0] * BLOCKS), round(share[1] * BLOCKS)
