"""Parts of a reproduction, and the page that they make: claims first, then the evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from navgym.tuning.comparison import Comparison
from navgym.tuning.papers.claims import FAILS, HOLDS, IDAM, OPEN, QIVBF, VERDICTS, Finding
from navgym.tuning.papers.expected import Check
from navgym.tuning.report.page import Page, Section, Table, Tile

MARKS = {"within": "✓", "better": "↓", "both diverge": "≈", "outside": "✗"}
KEY = "✓ within the two intervals, ↓ better than expected, ≈ both diverge, ✗ outside."
ENOUGH = 40  # recordings; a comparison over fewer is no evaluation


@dataclass(frozen=True, eq=False)
class Part:
    """One section of the report.

    Args:
        section: its words, figures and tables.
        checks: its figures beside what was expected.
        found: its comparisons, for the JSON file.
        findings: the papers' claims that it judges.
        runs: recordings that its comparisons rest on; None where it makes none.
    """

    section: Section
    checks: tuple[Check, ...]
    found: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    runs: int | None = None


def page(
    parts: list[Part], provenance: Mapping[str, Any], title: str = "QIVBF, reproduced"
) -> Page:
    """The report."""
    checks = [c for part in parts for c in part.checks]
    outside = [c for c in checks if not c.holds]
    counts = {v: sum(c.verdict == v for c in checks) for v in MARKS}
    findings = [f for part in parts for f in part.findings]
    lede = [*_warning(parts), _summary(findings)] if findings else _warning(parts)
    lede.append(
        f"{len(checks)} figures stand beside what was expected of them, from the print, from an independent "
        "prototype that was measured before this project began, or from algebra: "
        f"{counts['within']} lie within the two 95 % intervals, {counts['better']} are better, "
        f"{counts['both diverge']} diverge in both, and {counts['outside']} lie outside."
    )
    if outside:
        lede.append("Outside: " + "; ".join(_outside(c) for c in outside) + ".")
    tiles = [
        Tile(str(sum(f.verdict == v for f in findings)), f"claims: {v}", _kind(v)) for v in VERDICTS
    ]
    sections = [part.section for part in parts]
    if findings:
        sections.insert(0, _claims(parts))
    return Page(title, lede, sections, [t for t in tiles if t.value != "0"], provenance)


def results(parts: list[Part], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Everything measured, as JSON."""
    return {
        "provenance": dict(provenance),
        "parts": {
            part.section.title: {
                "claims": [_plain(f) for f in part.findings],
                "checks": [asdict(c) | {"verdict": c.verdict} for c in part.checks],
                "comparisons": dict(part.found),
            }
            for part in parts
        },
    }


def check_table(checks: Sequence[Check], caption: str = KEY) -> Table:
    """Checks as a table."""
    rows = [
        [c.what, f"{c.found:.3f} ± {c.half:.3f}", f"{c.expected:.4g}", MARKS[c.verdict]]
        for c in checks
    ]
    return Table(["figure", "here", "expected", ""], rows, caption)


def told(findings: Sequence[Finding]) -> list[str]:
    """Claims, what holds of them and why, as paragraphs."""
    return [text for finding in findings for text in finding.told()]


def as_dict(found: Mapping[str, Comparison]) -> dict[str, Any]:
    """Comparisons for the JSON file."""
    return {name: comparison.as_dict() for name, comparison in found.items()}


def _warning(parts: Sequence[Part]) -> list[str]:
    fewest = min((part.runs for part in parts if part.runs is not None), default=ENOUGH)
    if fewest >= ENOUGH:
        return []
    return [
        f"**A quick run: comparisons rest on {fewest} recordings.** It shows that everything runs; its "
        "figures and verdicts mean nothing."
    ]


def _summary(findings: Sequence[Finding]) -> str:
    said = []
    for verdict in VERDICTS:
        places = [f.claim.where for f in findings if f.verdict == verdict]
        if places:
            said.append(f"**{verdict[0].upper()}{verdict[1:]}:** {', '.join(places)}.")
    return "What the paper prints, judged by what was run here. " + " ".join(said)


def _claims(parts: Sequence[Part]) -> Section:
    places = [*QIVBF.values(), *IDAM.values()]
    found = [(f, part.section.title) for part in parts for f in part.findings]
    found.sort(key=lambda each: places.index(each[0].claim))
    rows = [[f.claim.where, f.claim.says, f"**{f.verdict}**", title] for f, title in found]
    head = ["print", "what it shows or claims", "here", "evidence under"]
    caption = "In our words. Each section below says what was found, and why."
    return Section(
        "What the paper prints, and what holds",
        [],
        [Table(head, rows, caption, text_columns=range(len(head)))],
    )


def _kind(verdict: str) -> str:
    return {HOLDS: "best", FAILS: "own", OPEN: "bound"}.get(verdict, "")


def _outside(c: Check) -> str:
    return f"{c.what} {c.found:.3f} ± {c.half:.3f} (expected {c.expected:g} ± {c.slack:.3g})"


def _plain(finding: Finding) -> dict[str, str]:
    claim = finding.claim
    return {
        "paper": claim.paper, "where": claim.where, "claim": claim.says,
        "verdict": finding.verdict, "found": finding.found,
    }  # fmt: skip
