"""What a study leaves: a page for people, results for programs, parameters for filters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import tomli_w

from navgym.core.checks import Array
from navgym.tuning import declared
from navgym.tuning.cases import Cases
from navgym.tuning.comparison import Comparison
from navgym.tuning.objectives import Costed, Objective, Pooled
from navgym.tuning.report import page as report
from navgym.tuning.report import plots, study_plots, tables, words
from navgym.tuning.report.page import Figure, Page, Section, Table, Tile
from navgym.tuning.settings import StudySettings
from navgym.tuning.study.run import Outcome
from navgym.tuning.study.sensitivity import FLAT, Sweep
from navgym.tuning.study.storage import shown
from navgym.tuning.tune import Findings

TUNED_FILE, PAGE, RESULTS, SETTINGS = "tuned.toml", "report.html", "results.json", "settings.toml"


def write(found: Findings, command: str = "navgym.tuning.tune.run") -> None:
    """Write report.html, results.json, tuned.toml and settings.toml to the study's folder.

    Args:
        found: what to write.
        command: that found it, for the record.
    """
    out = found.settings.out
    basis = provenance(found, command)
    report.write_text(out / SETTINGS, declared.to_toml(declared.own(found.settings)))
    report.write_text(out / TUNED_FILE, tuned_toml(found, basis))
    report.write_json(out / RESULTS, results(found, basis))
    report.write_page(out / PAGE, page(found, basis))


def provenance(found: Findings, command: str) -> dict[str, Any]:
    """What the result rests on."""
    settings = found.settings
    where = shown(settings.storage) if settings.storage else str(settings.out / "study.log")
    return report.provenance(
        command, seeds=found.stages.split, sampler=f"{settings.sampler}, seed {settings.seed}",
        study=where,
    )  # fmt: skip


def summary(found: Findings) -> str:
    """For the terminal: the tables, the winner, what matters, where everything is."""
    parts = []
    for name, comparison in found.reports.items():
        parts += [f"{name}:", tables.ladder(comparison, (found.tuned,)).as_text(), ""]
    values = ", ".join(f"{k} {tables.value(v)}" for k, v in found.values.items())
    parts += [_gain_line(found), f"tuned: {values}", *_plain_findings(found)]
    parts.append(f"written to {found.settings.out}: {PAGE}, {RESULTS}, {TUNED_FILE}")
    return "\n".join(parts)


def so_far(settings: StudySettings, outcome: Outcome) -> str:
    """For a study that was interrupted."""
    best = outcome.best
    return (
        f"stopped after {len(outcome.trials)} of {settings.amount.trials} trials: the best so far has "
        f"{best.result:.4g} on the training recordings, with {dict(best.values)}\n"
        "finished trials are kept: the same command goes on from there"
    )


# ---- files for programs


def tuned_toml(found: Findings, basis: Mapping[str, Any]) -> str:
    """The winner as `navgym.tuned.read_tuned` takes it."""
    gains = {
        name: _gain(c, found.tuned) for name, c in found.reports.items()
    }  # fmt: skip
    whole = {
        "filter": found.settings.filter,
        "parameters": {k: _number(v) for k, v in found.values.items()},
        "provenance": {
            **basis,
            "goal": _without_none(found.goal.about),
            "gain over defaults": gains,
        },
    }
    return (
        '# Written by navgym tune: navgym.estimate(filter, recording, "tuned.toml")\n'
        + tomli_w.dumps(_without_none(whole))
    )


def _number(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _gain(found: Comparison, label: str) -> str:
    d = found.difference(label, found.reference)
    text = f"{100 * d.relative_gain:.1f} %"
    return text + (
        f" ({100 * d.gain_low:.1f} to {100 * d.gain_high:.1f})" if np.isfinite(d.gain_low) else ""
    )


def _without_none(value: Any) -> Any:
    """TOML has no null."""
    if isinstance(value, Mapping):
        return {str(k): _without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, (list, tuple)):
        return [_without_none(v) for v in value if v is not None]
    return _number(value)


def results(found: Findings, basis: Mapping[str, Any]) -> dict[str, Any]:
    """Everything measured, as JSON; times are the machine's, the rest is repeatable."""
    return {
        "provenance": dict(basis),
        "settings": declared.own(found.settings),
        "goal": found.goal.about,
        "trials": [asdict(t) | {"values": dict(t.values)} for t in found.outcome.trials],
        "chosen": {"number": found.chosen.number, "values": found.values, "result": found.chosen.result},
        "front": [t.number for t in found.outcome.front] if found.settings.cost else None,
        "reports": {name: c.as_dict() for name, c in found.reports.items()},
        "importances": dict(found.importances),
        "sweeps": {s.parameter.name: _sweep(s) for s in found.sweeps},
        "microseconds per filter step": {
            name: {k: round(v, 3) for k, v in c.microseconds.items()}
            for name, c in found.reports.items()
        },
    }  # fmt: skip


def _sweep(s: Sweep) -> dict[str, Any]:
    return {
        "values": [s.parameter.show(v) for v in s.values],
        "change": s.change.tolist(), "low": s.low.tolist(), "high": s.high.tolist(),
        "dead": s.dead, "flat": s.flat, "at the edge of its range": s.at_edge,
    }  # fmt: skip


# ---- the page


def page(found: Findings, basis: Mapping[str, Any]) -> Page:
    """The report."""
    settings = found.settings
    where = ", ".join(found.stages.train)
    return Page(
        f"Parameters of {settings.filter} for {where}",
        [*(_verdict(found, name) for name in found.reports), f"{_how(found)}"],
        [*_comparisons(found), _parameters(found), _study(found), _what_matters(found)],
        _tiles(found),
        basis,
    )  # fmt: skip


def _verdict(found: Findings, name: str) -> str:
    comparison = found.reports[name]
    text = f"**{name}**: {words.versus(comparison, found.tuned, found.default)}"
    beside = words.best(comparison)
    if beside.label != found.tuned and not beside.diverges:
        text += f" The smallest error there is that of **`{beside.label}`**. " + words.versus(
            comparison, beside.label, found.tuned
        )
    return text


def _how(found: Findings) -> str:
    return (
        f"{len(found.outcome.trials)} trials ({sum(t.given_up for t in found.outcome.trials)} given up "
        f"on the way) minimised the {found.goal.metric} of the runs' {_axis(found)}; {found.stages.split}. "
        "No recording, seed or stretch of a log serves two of these."
    )


def _axis(found: Findings) -> str:
    goal = found.goal.goal if isinstance(found.goal, Costed) else found.goal
    if isinstance(goal, Pooled):
        return f"{goal.members[0].measure.label} over the plain filter's"
    assert isinstance(goal, Objective)
    return goal.measure.axis


def _tiles(found: Findings) -> list[Tile]:
    made = []
    for name, c in found.reports.items():
        made.append(Tile(_gain(c, found.tuned).split(" (")[0], f"less than default, {name}", "own"))
    first = next(iter(found.reports.values()))
    unit = first.measure.unit
    for label, kind in ((found.tuned, "own"), (found.default, "")):
        made.append(
            Tile(f"{first[label].mean:.3f} {unit}".strip(), f"{label}, {first.measure.label}", kind)
        )
    return made


def _comparisons(found: Findings) -> list[Section]:
    return [_comparison(found, name, c) for name, c in found.reports.items()]


def _comparison(found: Findings, name: str, c: Comparison) -> Section:
    runs = len(next(iter(c.errors.values())))
    bars = plots.ladder(
        c, (found.tuned,), f"Mean over {runs} fresh recordings, with its 95 % interval. Pale and cut: diverges."
    )  # fmt: skip
    note = (
        "Gains are paired (same recordings), intervals from BCa bootstrap, p from sign flips. Times are "
        "this machine's."
    )
    items: list[Table | Figure] = [bars, tables.ladder(c, (found.tuned,), note)]
    items.append(_over_time(found, c, found.stages.report[name]))
    return Section(f"On fresh data: {name}", [], items)


def _over_time(found: Findings, c: Comparison, cases: Cases) -> Figure:
    quantity = c.measure.parts[0]
    time = np.asarray(cases.batch.time_of(int(np.argmax(cases.batch.lengths))))
    traces: dict[str, Array] = {
        label: c.squared[label][:, : len(time)] for label in (found.default, found.tuned)
    }
    axis = f"{quantity.label}, {quantity.unit}" if quantity.unit else quantity.label
    colors = {found.default: plots.PLAIN, found.tuned: plots.OWN}
    caption = f"{quantity.label} over time, over all fresh recordings, with 95 % bands over runs."
    return study_plots.over_time(time, traces, colors, axis, caption, quantity.needs_truth)


def _parameters(found: Findings) -> Section:
    space = found.settings.problem.find(found.settings.filter).space
    sets: dict[str, Mapping[str, Any]] = {
        "default": space.defaults, "tuned": space.defaults | found.values,
    }  # fmt: skip
    for c in found.reports.values():
        for row in c.rows:
            if row.filter == found.settings.filter and row.label not in (
                found.default,
                found.tuned,
            ):
                sets[row.label.partition(", ")[2] or row.label] = row.parameters
    text = [
        f'`{TUNED_FILE}` holds the tuned ones: `navgym.estimate("{found.settings.filter}", recording, "{TUNED_FILE}")`.'
    ]
    edges = [s.parameter.name for s in found.sweeps if s.at_edge]
    if edges:
        text.append(
            f"**At the end of its range**: {words.listed(edges)}. A wider range may do better."
        )
    return Section("The parameters", text, [tables.parameters(space, sets, "")])


def _study(found: Findings) -> Section:
    goal = found.goal
    default = goal(goal.space.defaults)
    caption = (
        f"{len(found.outcome.trials)} trials on {len(goal)} training recordings each; the defaults were "
        "tried first. Trials that were given up stand where they would have come to."
    )
    items: list[Table | Figure] = [plots.history(found.outcome, default, caption, _axis(found))]
    if found.settings.cost:
        items.append(
            study_plots.front(found.outcome, found.chosen, _axis(found), "Error against time per filter step.")
        )  # fmt: skip
        rows = [[str(t.number), f"{t.result:.4g}", f"{t.cost:.2f}", _inline(t.values)] for t in found.outcome.front]  # fmt: skip
        items.append(Table(["trial", _axis(found), "µs/step", "parameters"], rows, "The front.", text_columns=(0, 3)))  # fmt: skip
    return Section("The study", [], items)


def _inline(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{k} {tables.value(v)}" for k, v in values.items())


def _what_matters(found: Findings) -> Section:
    dead = [s.parameter.name for s in found.sweeps if s.dead]
    items: list[Table | Figure] = []
    if found.importances:
        caption = (
            "How far each parameter sets the best tenth of the trials apart (PED-ANOVA). A small "
            "share can also mean that the study hardly left the right value."
        )
        items.append(study_plots.importance(found.importances, dead, caption))
    caption = (
        "Blue: the metric with one parameter moved and the others at the winner's (orange line), on the "
        f"recordings that chose it, with 95 % intervals of the paired change, cut at {study_plots.SHOWN:.0%}; "
        "grey: all trials on the training recordings, against the best of them; green: where it is flat."
    )
    items.append(study_plots.slices(found.sweeps, found.outcome, caption))
    names = list(found.importances)[:2]
    if len(names) == 2:
        caption = "The two leading parameters, from the trials; circled: the winner."
        items.append(
            study_plots.contour(found.outcome, found.goal.space, (names[0], names[1]), found.chosen, caption)
        )  # fmt: skip
    return Section("What matters, and what does not", _plain_findings(found, "**"), items)


def _plain_findings(found: Findings, strong: str = "") -> list[str]:
    """Dead and flat parameters in words; from data, never from what one knows."""
    lines = []
    for s in found.sweeps:
        p, unit = s.parameter, "" if s.parameter.unit == "1" else f" {s.parameter.unit}"
        if s.dead:
            lines.append(
                f"{strong}{p.name} is a dead knob here{strong}: over its whole range the result moves by "
                f"{100 * s.span:.2f} %."
            )
        elif s.flat is not None:
            low, high = s.flat
            lines.append(
                f"{strong}{p.name}{strong} is flat from {low:.3g} to {high:.3g}{unit}: within {100 * FLAT:.0f} %."
            )
    return lines


def _gain_line(found: Findings) -> str:
    gains = [f"{name}: {_gain(c, found.tuned)}" for name, c in found.reports.items()]
    return f"gain of tuned over default, 95 % interval: {'; '.join(gains)}"
