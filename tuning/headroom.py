"""What steering a filter could win: best fixed parameters against parameters by true regime."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from navgym._checks import one_of
from navgym.simulation import scenarios
from tuning import deck_expected, expected, plots, report, tables
from tuning.comparison import Comparison, Entry, compare
from tuning.expected import Check
from tuning.experiments import STEERED, best_fixed, regime_table, simulated
from tuning.measures import MEASURES
from tuning.report import Figure, Page, Section, Table
from tuning.study import Search

FIXED, TABLE = "best fixed", "table by true regime"


@dataclass(frozen=True)
class Plan:
    """What is tuned on a half.

    Args:
        filter: whose parameters.
        free: what best fixed parameters vary.
        scheduled: what follows the true regime.
        fixed: values of the others.
        first: parameter sets to try early.
        measures: that contenders are compared by; the study minimises the half's own.
        beside: filters that need no tuning, shown beside.
    """

    filter: str
    free: tuple[str, ...]
    scheduled: tuple[str, ...]
    fixed: Mapping[str, Any]
    first: tuple[Mapping[str, Any], ...]
    measures: tuple[str, ...]
    beside: tuple[str, ...]


PLANS = {
    "auv": Plan(
        "qivbf", STEERED, ("forgetting", "process_noise_scale"),
        # the prototype's priors, so that best fixed means the same four parameters
        {"initial_count": 5.0, "initial_scale": 1.0},
        tuple(
            {"vb_iterations": 5, "prior_count": tau, "forgetting": 0.9, "process_noise_scale": 30.0}
            for tau in (10.0, 2.0)
        ),
        ("rmse",), ("kf", "imm", "imm_wide", "bank", "bank_bursts"),
    ),
    "deck": Plan(
        "alignment_mcc", ("kernel_width",), ("kernel_width",), {}, (),
        ("theta_rate", "theta_ac", "theta"), ("alignment",),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Size:
    """How much is run: trials of each study, training recordings, fresh recordings."""

    trials: int
    train: int
    test: int
    steps: int | None = None


# a deck's recording takes a hundred times an AUV's
FULL = {"auv": Size(200, 40, 300), "deck": Size(60, 16, 60)}
QUICK = {"auv": Size(8, 8, 20, 200), "deck": Size(4, 2, 2)}


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
    scenario: str, size: Size, seed: int, out: Path, executor: Executor | None = None
) -> Headroom:
    """Tune both on training seeds, choose on validation seeds, compare on test seeds.

    Args:
        scenario: a name of `navgym.scenarios()` with more than one regime.
        size: how much to run.
        seed: of the samplers.
        out: folder of the studies.
        executor: where trials are evaluated.

    Raises:
        ValueError: an unknown scenario, or one without regimes to follow.
        KeyboardInterrupt: Ctrl-C; finished trials are kept.
    """
    half, _, short = one_of("scenario", scenario, scenarios()).partition("/")
    plan = PLANS[half]
    how = Search(size.trials, seed, batch=4, prune=True)
    stem = f"{half}-{short}-{size.train}-seed{seed}"
    _, outcome, best = best_fixed(
        scenario, how, seed, size.train, out / f"fixed-{stem}.log", plan.free, plan.first, plan.fixed,
        size.steps, filter_name=plan.filter, executor=executor,
    )  # fmt: skip
    outcome.complete()
    fixed = {**plan.fixed, **best.values}
    table, chosen = regime_table(
        scenario, fixed, how, seed, size.train, out / f"table-{stem}.log", size.steps,
        filter_name=plan.filter, scheduled=plan.scheduled, executor=executor,
    )  # fmt: skip
    cases = simulated(scenario, "test", size.test, size.steps)
    entries = [
        *(Entry(name, name) for name in plan.beside),
        Entry(FIXED, plan.filter, fixed),
        Entry(TABLE, plan.filter, table.schedules(chosen.values, cases), True, 1),
        Entry("oracle", "oracle", bound=True),
    ]
    found = {
        m: compare(entries, cases, FIXED, cases.plain, measure=m, progress=f"{scenario}, {m}")
        for m in plan.measures
    }
    values = {FIXED: fixed, TABLE: dict(chosen.values)}
    return Headroom(scenario, values, found, tuple(_checks(half, short, found)))


# ---- against the prototype


def _checks(half: str, short: str, found: Mapping[str, Comparison]) -> Iterator[Check]:
    if half == "auv" and short in expected.HEADROOM:
        for label, value in zip(
            (FIXED, TABLE, "imm", "oracle"), expected.HEADROOM[short], strict=True
        ):
            row = found["rmse"][label]
            half_width = row.high - row.mean
            slack = max(expected.RELATIVE * value, half_width)
            yield Check(
                f"{short}, {label}", value, row.mean, half_width, slack, label in (FIXED, TABLE)
            )
    if half == "deck" and short == "switch-60":
        named = {"MCC off": "alignment", "best fixed width": FIXED, "true-regime schedule": TABLE}
        for name, values in deck_expected.SWITCH.items():
            for measure, value in zip(("theta", "theta_ac", "theta_rate"), values, strict=True):
                row = found[measure][named[name]]
                yield Check(
                    f"{short}, {name}, {measure}", value, row.mean, row.high - row.mean,
                    deck_expected.SPREAD * value, smaller_is_fine=True,
                )  # fmt: skip
        gain = found["theta_rate"].difference(TABLE, FIXED)
        yield Check(
            f"{short}: gain of the table in θ̇, %", deck_expected.SWITCH_GAIN, 100 * gain.relative_gain,
            50 * (gain.gain_high - gain.gain_low), 3.0, larger_is_fine=True,
        )  # fmt: skip


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


def write(found: list[Headroom], out: Path, **basis: Any) -> Path:
    """Write headroom.json and headroom.html; returns the page."""
    rests = report.provenance("headroom.py", **basis)
    made = {h.scenario: _as_dict(h) for h in found}
    report.write_json(out / "headroom.json", {"provenance": rests, "scenarios": made})
    page = Page(
        "What steering a filter could win",
        [_verdict(h) for h in found],
        [_section(h) for h in found],
        provenance=rests,
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
    measure, comparison = next(iter(found.comparisons.items()))
    d = comparison.difference(TABLE, FIXED)
    label = MEASURES[found.scenario.partition("/")[0]][measure].label
    return (
        f"**{found.scenario}**: parameters by true regime are {100 * d.relative_gain:.1f} % below best "
        f"fixed ones in {label} (95 % interval {100 * d.gain_low:.1f} to {100 * d.gain_high:.1f} %)."
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
        items.append(Table(["figure", "here", "prototype", ""], checked, "Against SCIENCE A4, B3."))
    return Section(found.scenario, [], items)
