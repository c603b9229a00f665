"""What a study leaves: a page for people, results for programs, parameters for filters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import tomli_w

from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.tuning import declared
from navgym.tuning.comparison import LEAST, Comparison
from navgym.tuning.objectives import Costed, Pooled
from navgym.tuning.report import page as report
from navgym.tuning.report import plots, study_plots, tables, words
from navgym.tuning.report.page import Figure, Page, Section, Table, Tile
from navgym.tuning.study.run import Outcome
from navgym.tuning.study.sensitivity import FLAT, Sweep
from navgym.tuning.study.storage import shown
from navgym.tuning.tune import Asked, Findings

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
        parts += [_how_sure(comparison), ""]
    values = ", ".join(f"{k} {tables.value(v)}" for k, v in found.values.items())
    kept = "kept, the defaults" if found.held.kept_default else "tuned"
    parts += [
        _gain_line(found),
        *_about_winner(found),
        f"{kept}: {values}",
        *_plain_findings(found),
    ]
    parts.append(f"written to {found.settings.out}: {PAGE}, {RESULTS}, {TUNED_FILE}")
    return "\n".join(parts)


def so_far(settings: Asked, outcome: Outcome) -> str:
    """For a study that was interrupted."""
    best = outcome.best
    return (
        f"stopped after {len(outcome.trials)} of {settings.amount.trials} trials: the best so far has "
        f"{best.result:z.4g} on the training recordings, with {dict(best.values)}\n"
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
        "model": found.model,
        "provenance": {
            **basis,
            "goal": _without_none(found.goal.about),
            "gain over defaults": gains,
            "held": found.held.said or "chosen on validation seeds",
        },
    }
    return f"# Written by navgym tune: {found.usage}\n" + tomli_w.dumps(_without_none(whole))


def _number(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _gain(found: Comparison, label: str) -> str:
    d = found.difference(label, found.reference)
    if found[label].diverges or not np.isfinite(d.relative_gain):
        return tables.NOTHING
    return words.amount(found, d)


def _without_none(value: Any) -> Any:
    """TOML has no null."""
    if isinstance(value, Mapping):
        return {str(k): _without_none(v) for k, v in value.items() if v is not None}
    if isinstance(value, (list, tuple)):
        return [_without_none(v) for v in value if v is not None]
    return _number(value)


def results(found: Findings, basis: Mapping[str, Any]) -> dict[str, Any]:
    """Everything measured, as JSON; times are the machine's, the rest is repeatable."""
    whole = {
        "provenance": dict(basis),
        "settings": declared.own(found.settings),
        "goal": found.goal.about,
        "trials": [asdict(t) | {"values": dict(t.values)} for t in found.outcome.trials],
        "chosen": {"number": found.chosen.number, "values": found.winner, "result": found.chosen.result},
        "held": found.held.said, "defaults kept": found.held.kept_default, "values": found.values,
        "all noise scales times": found.calibrated,
        "front": [t.number for t in found.outcome.front] if found.settings.cost else None,
        "reports": {name: c.as_dict() for name, c in found.reports.items()},
        "importances": dict(found.importances),
        "sweeps": {s.parameter.name: _sweep(s) for s in found.sweeps},
        "microseconds per filter step": {
            name: {k: round(v, 3) for k, v in c.microseconds.items()}
            for name, c in found.reports.items()
        },
    }  # fmt: skip
    without: dict[str, Any] = _without_nan(whole)
    return without


def _without_nan(value: Any) -> Any:
    """JSON has no NaN and no infinity."""
    if isinstance(value, Mapping):
        return {k: _without_nan(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nan(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


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
        [
            *_about_winner(found, "**"), *(_verdict(found, name) for name in found.reports),
            _how(found),
        ],
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
    if not isinstance(goal, Pooled):
        return found.measure.axis
    return (
        f"{found.measure.label} {'over' if found.measure.relative else 'less'} the plain filter's"
    )


def _tiles(found: Findings) -> list[Tile]:
    made = []
    for name, c in found.reports.items():
        text = _gain(c, found.tuned).split(", ")[0]
        if text != tables.NOTHING:
            made.append(Tile(text, f"gain over the defaults, {name}", "own"))
    first = next(iter(found.reports.values()))
    unit = first.measure.unit
    for label, kind in ((found.tuned, "own"), (found.default, "")):
        row = first[label]
        text = "diverges" if row.diverges else f"{row.mean:z.3f} {unit}".strip()
        made.append(Tile(text, f"{label}, {first.measure.label}", kind))
    return made


def _about_winner(found: Findings, strong: str = "") -> list[str]:
    """Whether the winner holds, what NIS chose, and whether it stands at the end of a range."""
    said = [found.stages.caveat] if found.stages.caveat else []
    if found.held.said:
        said.append(f"{strong}{found.held.said}{strong}")
    if found.calibrated is not None:
        said.append(
            f"All noise scales of the winner were multiplied by {found.calibrated:.3g}, so that NIS is 1 "
            "on the recordings that chose it: that moves its covariances, not its estimates."
        )
    off = [
        t.mean for t in (c.nis.get(found.tuned) for c in found.reports.values()) if t is not None
    ]
    if off and found.held.said and not all(0.5 < mean < 2.0 for mean in off):
        said.append(
            f"Do not believe the winner's covariances: NIS is {', '.join(f'{m:.2g}' for m in off)} where 1 "
            "is right. --measure likelihood tunes noise levels, at the price of position."
        )
    edges = [s.parameter.name for s in found.sweeps if s.at_edge]
    if edges:
        verb, whose = ("stands", "its") if len(edges) == 1 else ("stand", "their")
        names = words.listed(edges) if strong else " and ".join(edges)
        at = f"{names} {verb} at the end of {whose} range"
        said.append(f"{strong}{at}{strong}: a wider one (--range) may do better.")
    if any(
        c.measure.parts[0].name == "nll" or "nll" in c.quantities for c in found.reports.values()
    ):
        said.append(CAVEAT)
    return said


CAVEAT = (
    "A likelihood is no position error: it says how well a filter knows its own noise, and parameters "
    "that are more likely have been found to be worse in position as often as better."
)


def _how_sure(c: Comparison) -> str:
    """What intervals are over, or why there are none; and the bands."""
    if c.intervals == "recordings":
        text = "Intervals over recordings, 95 %."
    elif c.intervals:
        text = (
            f"{words.without_interval(c)} over recordings; those here are along the log, from blocks of it, "
            "and speak of this log only."
        )
    else:
        text = f"{words.without_interval(c)}."
    return f"{text[0].upper()}{text[1:]} NIS and NEES per degree of freedom: 1 is right, ↑ and ↓ are outside the 95 % band."  # fmt: skip


def _comparisons(found: Findings) -> list[Section]:
    return [_comparison(found, name, c) for name, c in found.reports.items()]


def _comparison(found: Findings, name: str, c: Comparison) -> Section:
    what = (
        f"Mean over {c.runs} fresh recordings"
        if c.runs > 1
        else "One recording, the part never tuned on"
    )
    ends = {
        "recordings": ", with its 95 % interval",
        "blocks": ", with 95 % intervals along the log",
    }
    lost = " Pale and cut: diverges." if any(r.diverges for r in c.rows) else ""
    bars = plots.ladder(c, (found.tuned,), f"{what}{ends.get(c.intervals, '')}.{lost}")
    note = f"Gains are paired (same recordings). {_how_sure(c)} Times are this machine's."
    items: list[Table | Figure] = [bars, tables.ladder(c, (found.tuned,), note)]
    items.append(_over_time(found, c, name))
    return Section(f"On fresh data: {name}", [], items)


def _over_time(found: Findings, c: Comparison, name: str) -> Figure:
    quantity = c.measure.parts[0]
    time, place = found.time(name)
    traces: dict[str, Array] = {
        label: c.squared[label][:, : len(time)] for label in (found.default, found.tuned)
    }
    axis = quantity.axis
    colors = {found.default: plots.PLAIN, found.tuned: plots.OWN}
    over = f", over {c.runs} fresh recordings, with 95 % bands over them" if c.runs > 1 else ""
    caption = f"{quantity.label[0].upper()}{quantity.label[1:]} over time{over}."
    squared = quantity.name not in ("nll", "nis")
    return study_plots.over_time(time, traces, colors, axis, caption, squared, place=place)


def _parameters(found: Findings) -> Section:
    searched = {p.name: p for p in found.goal.space}
    space = ParameterSpace(tuple(searched.get(p.name, p) for p in found.space))
    sets: dict[str, Mapping[str, Any]] = {
        "default": found.space.defaults, "tuned": found.space.defaults | found.winner,
    }  # fmt: skip
    for c in found.reports.values():
        for row in c.rows:
            if row.filter == found.settings.filter and row.label not in (
                found.default,
                found.tuned,
            ):
                sets[row.label.partition(", ")[2] or row.label] = row.parameters
    which = "default" if found.held.kept_default else "tuned"
    text = [f"`{TUNED_FILE}` holds the {which} ones: `{found.usage}`."]
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
    relative, unit = found.measure.relative, found.measure.unit
    shown = "%" if relative else unit or "absolute"
    cut = f"{study_plots.SHOWN:.0%}" if relative else f"{study_plots.SHOWN:g} {unit}".strip()
    sure = ", with 95 % intervals of the paired change" if len(found.goal) >= LEAST else ""
    caption = (
        "Blue: the metric with one parameter moved and the others at the winner's (orange line), on the "
        f"recordings that chose it{sure}, cut at {cut}; "
        "grey: all trials on the training recordings, against the best of them; green: where it is flat."
    )
    items.append(study_plots.slices(found.sweeps, found.outcome, caption, shown))
    names = list(found.importances)[:2]
    if len(names) == 2:
        caption = "The two leading parameters, from the trials; circled: the winner."
        items.append(
            study_plots.contour(
                found.outcome, found.goal.space, (names[0], names[1]), found.chosen, caption, relative, shown
            )
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
                f"{_change(s, s.span)}."
            )
        elif s.flat is not None:
            low, high = s.flat
            lines.append(
                f"{strong}{p.name}{strong} is flat from {low:.3g} to {high:.3g}{unit}: within {_change(s, FLAT)}."
            )
    return lines


def _change(s: Sweep, size: float) -> str:
    return f"{100 * size:.2g} %" if s.relative else f"{size:.2g} nats per component"


def _gain_line(found: Findings) -> str:
    gains = [f"{name}: {_gain(c, found.tuned)}" for name, c in found.reports.items()]
    return f"gain of tuned over default: {'; '.join(gains)}"
