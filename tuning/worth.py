"""What a measure that needs no truth is worth: whether it ranks parameters as the truth does.

A random design of settings runs on recordings whose truth is known. Per measure: its rank correlation
with the truth over the better half of the settings, and its *regret*, by how much the setting that it
picks is worse in the truth than the one that the truth picks.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from tqdm import tqdm

from navgym.core.checks import Array, positive_int
from navgym.core.parameters import ParameterSpace
from navgym.metrics.measures import Judged, Measure, bounded
from navgym.problem import Problem
from navgym.tuning.cases import Cases
from navgym.tuning.experiments import real_cases, tracks_of
from navgym.tuning.objectives import find_measure, plain_quantities
from navgym.tuning.report import page as report
from navgym.tuning.report.page import Page, Section, Table

SETTINGS, FEW = 214, 60  # FEW: of a filter that costs
DRAWS = 4  # of noise and losses per track and loss rate, or recordings per scenario
BLIND = ("likelihood", "consistency")  # beside the one-step errors that a problem has


@dataclass(frozen=True)
class Worth:
    """One measure on one group of recordings.

    Args:
        group: which.
        measure: its name.
        rank: Spearman's correlation with the truth over the better half of the settings.
        regret: truth at the setting that the measure picks over that at the best one, less 1.
        same: whether both pick the same setting.
    """

    group: str
    measure: str
    rank: float
    regret: float
    same: bool


@dataclass(frozen=True, eq=False)
class Losses:
    """Losses of every setting on every recording.

    Args:
        settings: values of the filter's parameters, the defaults first.
        truth: name of the measure that sees the truth.
        losses: per measure, (S, N).
        groups: recordings by the name of their group.
    """

    settings: tuple[Mapping[str, Any], ...]
    truth: str
    losses: Mapping[str, Array]
    groups: Mapping[str, Sequence[int]]

    def worth(self) -> Iterator[Worth]:
        """Every measure on every group."""
        for group, which in self.groups.items():
            truth = self.losses[self.truth][:, list(which)].mean(axis=1)
            for name, losses in self.losses.items():
                if name != self.truth:
                    yield _worth(group, name, losses[:, list(which)].mean(axis=1), truth)


def _worth(group: str, name: str, measure: Array, truth: Array) -> Worth:
    better = truth <= np.median(truth)
    rank = float(stats.spearmanr(measure[better], truth[better]).statistic)
    picked, best = int(measure.argmin()), int(truth.argmin())
    return Worth(group, name, rank, float(truth[picked] / truth[best] - 1.0), picked == best)


def design(space: ParameterSpace, count: int, seed: int) -> tuple[dict[str, Any], ...]:
    """The defaults, and settings from a scrambled Sobol sequence over the space, each on its own scale."""
    positive_int("count", count, least=2)
    sobol = stats.qmc.Sobol(len(space), rng=np.random.default_rng(seed))
    spread = sobol.random_base2(int(np.ceil(np.log2(count))))[: count - 1]
    return ({p.name: p.show(p.default) for p in space}, *map(space.from_unit, spread))


def measured(
    filter_name: str,
    cases: Mapping[str, Cases],
    groups: Mapping[str, Sequence[int]],
    settings: Sequence[Mapping[str, Any]],
    truth: str | None = None,
    executor: Executor | None = None,
) -> Losses:
    """Losses of every setting on recordings under several conditions.

    Args:
        filter_name: whose settings.
        cases: by condition, each with the same recordings in the same order; losses are averaged over
            conditions, each over the plain filter's there (of logarithms less it).
        groups: recordings by the name of their group.
        settings: values of parameters.
        truth: measure to rank by; the problem's first by default.
        executor: where settings run.
    """
    some = next(iter(cases.values()))
    own = find_measure(some.problem, truth).name
    names = (own, *(n for n in some.problem.scoring.foretold if n in some.rows), *BLIND)
    total = {name: np.zeros((len(settings), len(some))) for name in names}
    with tqdm(total=len(cases) * len(settings), desc="every setting by every measure") as bar:
        for each in cases.values():
            judge = Judge(filter_name, each, names)
            for i, found in enumerate(_run(judge, settings, executor)):
                for name, losses in found.items():
                    total[name][i] += losses / len(cases)
                bar.update()
    return Losses(tuple(settings), own, total, groups)


class Judge:
    """Losses of a setting by several measures, from one run of the filter.

    Args:
        filter_name: whose settings.
        cases: the recordings.
        names: of measures.
    """

    def __init__(self, filter_name: str, cases: Cases, names: Sequence[str]) -> None:
        self.filter_name, self.cases = filter_name, cases
        self.measures = {name: find_measure(cases.problem, name) for name in names}
        self.plain = {name: plain_quantities(cases, m) for name, m in self.measures.items()}

    def __call__(self, values: Mapping[str, Any]) -> dict[str, Array]:
        """(N,) by measure, over the plain filter's mean; of logarithms less it."""
        wanted = {q: known for m in self.measures.values() for q, known in m.quantities.items()}
        found = self.cases.judge(self.filter_name, dict(values), tuple(wanted))
        return {name: self._loss(m, found, self.plain[name]) for name, m in self.measures.items()}

    def _loss(self, measure: Measure, found: Judged, plain: Mapping[str, Array]) -> Array:
        own = replace(found, quantities={q: found.quantities[q] for q in measure.quantities})
        losses = measure.losses(bounded(own, plain, measure.quantities), plain)
        base = float(measure.losses(plain, plain).mean())
        return losses / base if measure.relative else losses - base


def _run(
    judge: Judge, settings: Sequence[Mapping[str, Any]], executor: Executor | None
) -> Iterator[dict[str, Array]]:
    if executor is None:
        yield from map(judge, settings)
        return
    futures = [executor.submit(judge, dict(values)) for values in settings]
    yield from (f.result() for f in futures)


def on_tracks(
    problem: Problem,
    folder: Path | None,
    filter_name: str,
    count: int = SETTINGS,
    draws: int = DRAWS,
    seed: int = 0,
    executor: Executor | None = None,
) -> Losses:
    """Every measure on the problem's real tracks: each by itself, and the halves.

    Args:
        problem: whose tracks.
        folder: of the data; None: the simulated stand-in.
        filter_name: whose settings.
        count: how many settings.
        draws: of noise and losses per track and loss rate.
        seed: of the design.
        executor: where settings run.
    """
    known = tracks_of(problem)
    cases = {f"{r:.0%} lost": real_cases(problem, folder, r, draws, "train") for r in known.rates}
    place = {track: range(i * draws, (i + 1) * draws) for i, track in enumerate(known.numbers)}
    sets: dict[str, tuple[int, ...]] = {f"track {track}": (track,) for track in known.numbers}
    sets |= {f"tracks {fold[0]}-{fold[-1]}": fold for fold in (*known.folds, known.numbers)}
    groups = {name: [i for track in fold for i in place[track]] for name, fold in sets.items()}
    settings = design(problem.find(filter_name).space, count, seed)
    return measured(filter_name, cases, groups, settings, executor=executor)


def on_scenarios(
    scenarios: Sequence[str],
    filter_name: str,
    truth: str | None = None,
    count: int = FEW,
    runs: int = DRAWS,
    seed: int = 0,
    executor: Executor | None = None,
    free: Sequence[str] = (),
    **overrides: Any,
) -> Losses:
    """Every measure on simulated scenarios of one problem; a group each, and all of them.

    Args:
        scenarios: names of `navgym.scenarios()`.
        filter_name: whose settings.
        truth: measure to rank by; the problem's first by default.
        count: how many settings.
        runs: recordings per scenario.
        seed: of the design.
        executor: where settings run.
        free: parameters that the design varies; every one by default.
        overrides: of the scenarios.
    """
    made = [Cases.simulated(name, "train", runs, **overrides) for name in scenarios]
    space = made[0].problem.find(filter_name).space
    settings = design(space.subset(free) if free else space, count, seed)
    parts = [
        measured(filter_name, {name: c}, {name: range(runs)}, settings, truth, executor)
        for name, c in zip(scenarios, made, strict=True)
    ]
    losses = {
        name: np.concatenate([p.losses[name] for p in parts], axis=1) for name in parts[0].losses
    }
    groups: dict[str, Sequence[int]] = {
        name: range(i * runs, (i + 1) * runs) for i, name in enumerate(scenarios)
    }
    return Losses(
        settings, parts[0].truth, losses, groups | {"all of them": range(runs * len(scenarios))}
    )


# ---- what is shown


def table(found: Losses, caption: str = "") -> Table:
    """A row per group, and per measure its rank correlation and its regret."""
    told = {(w.group, w.measure): w for w in found.worth()}
    names = [n for n in found.losses if n != found.truth]
    head = ["", *(h for n in names for h in (f"{n}: rank", "regret"))]
    rows = [
        [group, *(cell for n in names for cell in _cells(told[group, n]))] for group in found.groups
    ]
    return Table(head, rows, caption)


def _cells(w: Worth) -> tuple[str, str]:
    return f"{w.rank:z.2f}", f"{100 * w.regret:,.1f} %" if np.isfinite(w.regret) else "–"


def verdicts(found: Losses) -> list[str]:
    """Per measure, its range over groups in words."""
    told = list(found.worth())
    lines = []
    for name in found.losses:
        own = [w for w in told if w.measure == name]
        if own:
            ranks, regrets = [w.rank for w in own], [100 * w.regret for w in own]
            lines.append(
                f"**{name}**: rank correlation with {found.truth} {min(ranks):z.2f} to {max(ranks):z.2f}, regret "
                f"{min(regrets):.1f} to {max(regrets):,.1f} %, the same pick as the truth in "
                f"{sum(w.same for w in own)} of {len(own)} groups."
            )
    return lines


CAPTION = (
    "Rank: Spearman's correlation with the truth over the better half of the settings. Regret: by how much "
    "the setting that the measure picks is worse in the truth than the best of them."
)


def summary(found: Losses) -> str:
    """For the terminal."""
    lines = [line.replace("**", "") for line in verdicts(found)]
    return "\n".join([table(found).as_text(), "", *lines])


def write(
    found: Losses, title: str, out: Path, command: str, banner: str = "", **basis: Any
) -> Path:
    """Write worth.json and worth.html; returns the page."""
    rests = report.provenance(command, **basis)
    rows = [
        {
            "group": w.group, "measure": w.measure, "rank": w.rank,
            "regret": w.regret if np.isfinite(w.regret) else None, "same pick": w.same,
        }
        for w in found.worth()
    ]  # fmt: skip
    report.write_json(
        out / "worth.json", {"provenance": rests, "settings": len(found.settings), "rows": rows}
    )
    lede = [f"{len(found.settings)} settings, the truth is {found.truth}.", *verdicts(found)]
    sections = [Section("Measures", [], [table(found, CAPTION)])]
    page = Page(title, lede, sections, provenance=rests, banner=banner)
    return report.write_page(out / "worth.html", page)
