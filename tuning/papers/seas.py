"""One bank for any sea: the bank beside every filter that needs no tuning, in every world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from navgym.auv.problem import PROBLEM, TRACKS
from navgym.core.checks import Array
from navgym.metrics import paired_difference
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Comparison, Entry, compare
from navgym.tuning.experiments import real_cases
from navgym.tuning.papers.amounts import ReproductionAmount
from navgym.tuning.papers.expected import Check
from navgym.tuning.papers.part import Part, as_dict
from navgym.tuning.papers.worlds import worlds
from navgym.tuning.report import tables
from navgym.tuning.report.page import Section, Table

OTHERS = ("kf", "imm", "imm_wide", "bank_2026")
BANK, OLD = "bank", "bank_2026"
MOST, MOST_LOST = 1.02, 1.03  # of the best of the others; at 70 % loss
LEADING = ("switch-D", "switch-B")  # looked at more closely
PER_WORLD = 3  # of the runs of a scenario, one in three for each of so many worlds
# mean errors over the best of others', and metres, of the prototype: docs/science/qivbf.md
KNOWN: Mapping[str, float] = {
    "switch-D": 0.798, "manoeuvre and outliers": 0.951, "switch-D, Q x30": 1.24,
    "switch-D, R /30": 0.20, "velocity noise x5": 0.63, "position noise x5": 2.07,
}  # fmt: skip
CLOSE = 0.05  # of a known figure


@dataclass(frozen=True)
class Ratio:
    """The bank's error over that of the best of the others, with the 95 % interval of pairs."""

    best: str
    value: float
    low: float
    high: float

    @classmethod
    def of(cls, found: Comparison) -> Ratio:
        """Of one world; "best" is the one with the smallest mean there."""
        best = min(OTHERS, key=lambda name: found[name].mean)
        d = paired_difference(found.errors[BANK], found.errors[best])
        return cls(best, 1.0 - d.relative_gain, 1.0 - d.gain_high, 1.0 - d.gain_low)


def seas(size: ReproductionAmount, folder: Path | None) -> Part:
    """Every world, and the real tracks where there are any."""
    found: dict[str, Comparison] = {}
    for world in worlds():
        runs = size.runs if world.name in LEADING else max(size.runs // PER_WORLD, 2)
        found[world.name] = _compared(world.cases("test", runs, size.steps), world.name)
    ratios = {name: Ratio.of(one) for name, one in found.items()}
    checks = [_check(name, ratios[name]) for name in found]
    checks += [
        _known(name, value, found[name]) for name, value in KNOWN.items() if size.steps is None
    ]
    items = [_table(found, ratios)]
    if folder is not None:
        tracks, table = _tracks(size, folder)
        found |= tracks
        items.append(table)
    section = Section("One bank for any sea", _text(ratios, found), items)
    return Part(section, tuple(checks), as_dict(found), runs=max(size.runs // PER_WORLD, 2))


def _compared(cases: Cases, progress: str) -> Comparison:
    entries = [*(Entry(name, name) for name in (*OTHERS, BANK)), *_bound(cases)]
    return compare(entries, cases, BANK, progress=progress)


def _bound(cases: Cases) -> list[Entry]:
    """The filter that is told the true noise, where it is a bound."""
    return [] if cases.batch.scales is None else [Entry(PROBLEM.bound, PROBLEM.bound, bound=True)]


def _check(name: str, ratio: Ratio) -> Check:
    most = MOST_LOST if name.endswith("loss .7") else MOST
    what = f"{name}: bank over the best of the others"
    half = (ratio.high - ratio.low) / 2.0
    return Check(what, most, ratio.value, half, 0.0, smaller_is_fine=True)


def _known(name: str, value: float, found: Comparison) -> Check:
    row = found[BANK]
    half = row.high - row.mean
    return Check(f"{name}: bank, m", value, row.mean, half, CLOSE * value, smaller_is_fine=True)


def _table(found: Mapping[str, Comparison], ratios: Mapping[str, Ratio]) -> Table:
    rows = []
    for name, one in found.items():
        ratio = ratios[name]
        nees = one.nees[BANK]
        truth = f"{one[PROBLEM.bound].mean:.3f}" if PROBLEM.bound in one else "–"
        means = [f"{one[label].mean:.3f}" for label in (*OTHERS, BANK)]
        told = f"{ratio.value:.3f} ({ratio.low:.3f} to {ratio.high:.3f}) of {ratio.best}"
        rows.append([name, *means, truth, told, "–" if nees is None else f"{nees.mean:.2f}"])
    head = ["world", *OTHERS, BANK, "true noise", "bank over the best", "its NEES"]
    caption = (
        "Position RMSE in m on fresh recordings; the bank's over that of the best of kf, imm, imm_wide "
        "and bank_2026, with the 95 % interval of pairs; its NEES per state, 1 where its covariance is "
        "right. A filter that is told the true noise of each sample is no bound where that noise is "
        "not white, or where the vehicle moves otherwise than any noise."
    )
    return Table(head, rows, caption)


def _tracks(size: ReproductionAmount, folder: Path) -> tuple[dict[str, Comparison], Table]:
    """Real tracks by loss rate; intervals over tracks, of which there are few."""
    found, rows = {}, []
    for rate in TRACKS.rates:
        cases = real_cases(PROBLEM, folder, rate, size.draws, "test")
        name = f"tracks, {tables.percent(rate)} lost"
        one = found[name] = _compared(cases, name)
        by_track = np.array([r.meta["track"] for r in cases.recordings])
        own, old = (_per_track(one.errors[x], by_track) for x in (BANK, OLD))
        gain = paired_difference(own, old)
        told = f"{100 * gain.relative_gain:+.1f} % ({100 * gain.gain_low:+.1f} to {100 * gain.gain_high:+.1f})"
        rows.append([name, *(f"{one[label].mean:.3f}" for label in (*OTHERS, BANK)), told])
    caption = "Position RMSE in m; the interval is over tracks."
    return found, Table(["A-KIT", *OTHERS, BANK, f"gain over {OLD}"], rows, caption)


def _per_track(errors: Array, by_track: Array) -> Array:
    return np.array([errors[by_track == track].mean() for track in np.unique(by_track)])


def _text(ratios: Mapping[str, Ratio], found: Mapping[str, Comparison]) -> list[str]:
    over = [name for name, ratio in ratios.items() if ratio.value > MOST]
    worst = max(ratios, key=lambda name: ratios[name].value)
    loud = [
        name for name in ratios if (nees := found[name].nees[BANK]) is not None and nees.mean > 2.0
    ]
    cost = found[LEADING[0]].microseconds
    return [
        f"In {len(ratios) - len(over)} of {len(ratios)} worlds the bank, which nobody tuned for any of "
        f"them, errs at most {100 * (MOST - 1):.0f} % more than the best of four filters that need no "
        f"tuning either, whichever that is there; the worst is “{worst}”, {ratios[worst].value:.3f}"
        + (f"; beyond it are {', '.join(over)}." if over else "."),
        "Its covariance is too small by more than a factor of two under "
        + (f"{', '.join(loud)}: there it errs without a word." if loud else "none of them."),
        f"A step of it takes {cost[BANK]:.1f} µs here, where one of {OLD} takes {cost[OLD]:.1f} and one "
        f"of `kf` {cost['kf']:.1f}.",
    ]
