"""What steering a filter could win: best fixed parameters against parameters by true regime."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from navgym.core.checks import one_of
from navgym.problem import Amount, problem_of
from navgym.simulation import scenarios
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Comparison, Entry, compare
from navgym.tuning.experiments import best_fixed, regime_table, steering_of
from navgym.tuning.papers import expected
from navgym.tuning.papers import expected_idam as deck_expected
from navgym.tuning.papers.expected import Check
from navgym.tuning.report import page as report
from navgym.tuning.report import plots, tables, words
from navgym.tuning.report.page import Figure, Page, Section, Table
from navgym.tuning.study.run import Search

FIXED, TABLE = "best fixed", "table by true regime"


@dataclass(frozen=True, eq=False)
class Headroom:
    """What one scenario leaves to win.

    Args:
        scenario: its name.
        values: best fixed parameters, and the table's.
        comparisons: by measure, on fresh recordings; gains are against best fixed.
        checks: against an independent prototype, where it has figures.
    """

    scenario: str
    values: Mapping[str, Mapping[str, Any]]
    comparisons: Mapping[str, Comparison]
    checks: tuple[Check, ...]


def headroom(
    scenario: str,
    seed: int,
    out: Path,
    executor: Executor | None = None,
    quick: bool = False,
    amount: Amount | None = None,
    **overrides: Any,
) -> Headroom:
    """Tune both on training seeds, choose on validation seeds, compare on test seeds.

    Args:
        scenario: a name of `navgym.scenarios()` with more than one regime.
        seed: of the samplers.
        out: folder of the studies.
        executor: where trials are evaluated.
        quick: a few short recordings and trials, only to see it run.
        amount: how much to run, if not what the problem says.
        overrides: of the scenario.

    Raises:
        ValueError: an unknown scenario, or one without regimes to follow.
        KeyboardInterrupt: Ctrl-C; finished trials are kept.
    """
    problem = problem_of(one_of("scenario", scenario, scenarios()))
    steering = steering_of(problem)
    much = amount or (steering.quick if quick else steering.amount)
    changed = {**(steering.quick_overrides if quick else {}), **overrides}
    how = Search(much.trials, seed, batch=4, prune=True)
    stem = f"{scenario.replace('/', '-')}-{much.runs}-seed{seed}"
    _, outcome, best = best_fixed(
        scenario, how, seed, much.runs, out / f"fixed-{stem}.log", steering.free, steering.first,
        steering.fixed, filter_name=steering.filter, executor=executor, **changed,
    )  # fmt: skip
    outcome.complete()
    fixed = {**steering.fixed, **best.values}
    table, chosen = regime_table(
        scenario,
        fixed,
        how,
        seed,
        much.runs,
        out / f"table-{stem}.log",
        executor=executor,
        **changed,
    )
    cases = Cases.simulated(scenario, "test", much.report_runs, **changed)
    entries = [
        *(Entry(name, name) for name in steering.beside),
        Entry(FIXED, steering.filter, fixed),
        Entry(TABLE, steering.filter, table.schedules(chosen.values, cases), True, 1),
        Entry(problem.bound, problem.bound, bound=True),
    ]
    found = {
        m: compare(entries, cases, FIXED, measure=m, progress=f"{scenario}, {m}")
        for m in steering.measures
    }
    values = {FIXED: fixed, TABLE: dict(chosen.values)}
    checks = PROTOTYPE[scenario](found) if scenario in PROTOTYPE else ()
    return Headroom(scenario, values, found, tuple(checks))


# ---- against the prototype


def _position(name: str, found: Mapping[str, Comparison]) -> Iterator[Check]:
    """Position RMSE of both contenders, IMM and oracle."""
    for label, value in zip((FIXED, TABLE, "imm", "oracle"), expected.HEADROOM[name], strict=True):
        row = found["rmse"][label]
        half_width = row.high - row.mean
        slack = max(expected.RELATIVE * value, half_width)
        yield Check(f"{name}, {label}", value, row.mean, half_width, slack, label in (FIXED, TABLE))


def _deformation(found: Mapping[str, Comparison]) -> Iterator[Check]:
    """Errors of θ, and what the table wins in θ̇."""
    named = {"MCC off": "alignment", "best fixed width": FIXED, "true-regime schedule": TABLE}
    for name, values in deck_expected.SWITCH.items():
        for measure, value in zip(("theta", "theta_ac", "theta_rate"), values, strict=True):
            row = found[measure][named[name]]
            yield Check(
                f"switch-60, {name}, {measure}", value, row.mean, row.high - row.mean,
                deck_expected.SPREAD * value, smaller_is_fine=True,
            )  # fmt: skip
    gain = found["theta_rate"].difference(TABLE, FIXED)
    yield Check(
        "switch-60: gain of the table in θ̇, %", deck_expected.SWITCH_GAIN, 100 * gain.relative_gain,
        50 * (gain.gain_high - gain.gain_low), 3.0, larger_is_fine=True,
    )  # fmt: skip


# what the prototype's figures are held against, by scenario
PROTOTYPE: Mapping[str, Callable[[Mapping[str, Comparison]], Iterator[Check]]] = {
    **{f"auv/{name}": functools.partial(_position, name) for name in expected.HEADROOM},
    "deck/switch-60": _deformation,
}


# ---- what is shown


def summary(found: Headroom) -> str:
    """For the terminal."""
    parts = [f"{found.scenario}:"]
    for comparison in found.comparisons.values():
        parts += [tables.ladder(comparison, (FIXED,)).as_text(), ""]
    for name, values in found.values.items():
        parts.append(f"{name}: " + ", ".join(f"{k} {tables.value(v)}" for k, v in values.items()))
    return "\n".join([*parts, *(_check_line(c) for c in found.checks)])


def _check_line(c: Check) -> str:
    return f"  {c.what}: {c.found:.3f} ± {c.half:.3f}, expected {c.expected:g}: {c.verdict}"


def write(found: list[Headroom], out: Path, command: str, banner: str = "", **basis: Any) -> Path:
    """Write headroom.json and headroom.html, which record the command; returns the page."""
    rests = report.provenance(command, **basis)
    made = {h.scenario: _as_dict(h) for h in found}
    report.write_json(out / "headroom.json", {"provenance": rests, "scenarios": made})
    page = Page(
        "What steering a filter could win",
        [_verdict(h) for h in found],
        [_section(h) for h in found],
        provenance=rests,
        banner=banner,
    )
    return report.write_page(out / "headroom.html", page)


def _as_dict(found: Headroom) -> dict[str, Any]:
    return {
        "values": {k: dict(v) for k, v in found.values.items()},
        "comparisons": {k: c.as_dict() for k, c in found.comparisons.items()},
        "checks": [
            {"what": c.what, "expected": c.expected, "found": c.found, "verdict": c.verdict}
            for c in found.checks
        ],
    }


def _verdict(found: Headroom) -> str:
    comparison = next(iter(found.comparisons.values()))
    d = comparison.difference(TABLE, FIXED)
    label = comparison.measure.label
    return (
        f"**{found.scenario}**: parameters by true regime against best fixed ones in {label}: "
        f"{words.amount(comparison, d)} less."
    )


def _section(found: Headroom) -> Section:
    items: list[Table | Figure] = []
    for comparison in found.comparisons.values():
        caption = "Mean over fresh recordings, with its 95 % interval. Dashed: the bound."
        items += [plots.ladder(comparison, (FIXED,), caption), tables.ladder(comparison, (FIXED,))]
    rows = [
        [k, ", ".join(f"{n} {tables.value(x)}" for n, x in v.items())]
        for k, v in found.values.items()
    ]
    items.append(Table(["", "parameters"], rows, text_columns=(0, 1)))
    if found.checks:
        checked = [
            [c.what, f"{c.found:.3f} ± {c.half:.3f}", f"{c.expected:g}", c.verdict]
            for c in found.checks
        ]
        items.append(
            Table(["figure", "here", "prototype", ""], checked, "See the documentation: Science.")
        )
    return Section(found.scenario, [], items)
