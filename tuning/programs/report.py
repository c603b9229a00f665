"""What a study of a program leaves: the page and files of any study, and what is a program's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from navgym.tuning import declared
from navgym.tuning.programs.study import ProgramFindings
from navgym.tuning.report import page as report
from navgym.tuning.report import study as usual
from navgym.tuning.report import tables
from navgym.tuning.report.page import Page, Section, Table
from navgym.tuning.report.study import PAGE, RESULTS, SETTINGS, TUNED_FILE


def write(found: ProgramFindings, command: str = "navgym.tuning.programs.tune") -> None:
    """Write report.html, results.json, tuned.toml and settings.toml to the study's folder.

    Args:
        found: what to write.
        command: that found it, for the record.
    """
    out, basis = found.settings.out, usual.provenance(found, command)
    report.write_text(out / SETTINGS, declared.to_toml(declared.own(found.settings)))
    report.write_text(out / TUNED_FILE, tuned_toml(found, basis))
    report.write_json(out / RESULTS, usual.results(found, basis) | _own(found))
    report.write_page(out / PAGE, page(found, basis))


def tuned_toml(found: ProgramFindings, basis: Mapping[str, Any]) -> str:
    """The winner, what the program calls its parameters, and their units: for `navgym export`."""
    told = {
        "targets": dict(found.contract.targets),
        "units": {p.name: p.unit for p in found.space if p.unit != "1"},
        "intervals": {n: list(i) for n, i in (found.fit.intervals if found.fit else {}).items()},
        "format": {"name": found.contract.format},
    }
    return usual.tuned_toml(found, basis) + declared.to_toml({k: v for k, v in told.items() if v})


def _own(found: ProgramFindings) -> dict[str, Any]:
    """What is a program's own, as JSON can hold it."""
    fit = found.fit
    return {
        "failed runs": dict(found.failures),
        "logs left out": dict(found.lost),
        "repeats": {"runs": found.twice.runs, "deviation": found.twice.deviation},
        "intervals": {} if fit is None else {n: list(i) for n, i in fit.intervals.items()},
        "ignored": ignored(found),
    }


def ignored(found: ProgramFindings) -> list[str]:
    """Parameters whose whole range changes no digit of the result."""
    return [s.parameter.name for s in found.sweeps if s.span == 0.0]


def said(found: ProgramFindings, strong: str = "") -> list[str]:
    """Repeats, failed runs, ignored parameters, lost logs and intervals, in sentences."""
    lines = [found.twice.said]
    lines += [
        f"{strong}The program ignores {name}{strong}: no digit of the result changes over its whole range. "
        "Is it called so there?"
        for name in ignored(found)
    ]
    total = sum(found.failures.values())
    if total:
        kinds = ", ".join(f"{n} x {kind}" for kind, n in found.failures.items())
        lines.append(
            f"{strong}{total} runs of the trials failed{strong} ({kinds}), and counted as ten times worse than the defaults."
        )
    lines += [
        f"{strong}Left out{strong}: {name}, where the defaults fail: {why}"
        for name, why in found.lost.items()
    ]
    if found.fit is not None:
        for name, (low, high) in found.fit.intervals.items():
            value = found.fit.values[name]
            lines.append(
                f"{name}: {value:.4g}, 95 % interval {low:.4g} to {high:.4g}{_unit(found, name)}"
            )
        lines += [
            f"{name}: the logs that were tuned on do not tell it." for name in found.fit.untold
        ]
    return lines


def _unit(found: ProgramFindings, name: str) -> str:
    unit = found.space[name].unit
    return "" if unit == "1" else f" {unit}"


def summary(found: ProgramFindings) -> str:
    """For the terminal."""
    text = usual.summary(found)
    at = text.rindex("written to ")
    take = f"take it home: navgym export {found.settings.out / TUNED_FILE} --as {found.contract.format} --present FILE"
    return "\n".join(
        [text[:at].rstrip("\n"), *said(found), f"split: {found.stages.split}", text[at:], take]
    )


def page(found: ProgramFindings, basis: Mapping[str, Any]) -> Page:
    """The report."""
    made = usual.page(found, basis)
    return replace(made, sections=[*made.sections, _program(found)])


def _program(found: ProgramFindings) -> Section:
    items: list[Table] = []
    if found.failures:
        rows = [[kind, str(n), found.examples[kind][:300]] for kind, n in found.failures.items()]
        items.append(
            Table(
                ["failed runs", "how many", "the first"],
                rows,
                "A run that fails is no result; it is counted.",
                text_columns=(0, 2),
            )
        )
    if found.fit is not None and found.fit.intervals:
        rows = [
            [
                name,
                tables.value(found.fit.values[name]),
                f"{low:.4g} … {high:.4g}",
                found.space[name].unit,
            ]
            for name, (low, high) in found.fit.intervals.items()
        ]
        caption = (
            "The maximum of the likelihood of the logs that were tuned on, and 95 % intervals from its curvature and "
            "from how stretches of the logs differ (a sandwich). They hold as far as stretches are independent."
        )
        items.append(
            Table(
                ["parameter", "maximum", "95 % interval", "unit"],
                rows,
                caption,
                text_columns=(0, 2, 3),
            )
        )
    return Section("The program", said(found, "**"), items)
