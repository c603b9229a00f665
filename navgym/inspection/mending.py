"""Options that mend what was found, put among those that the reader was told already."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from navgym.inspection.findings import Finding

SUMMED = "latency", "time_offsets"  # s: what is found comes on top of what was told
TURNED = "turn"  # axes by axis, a sign before each
NAMED = re.compile(rf"\b({TURNED}|time_offsets)=\{{([^}}]*)\}}")  # in a reader's sentence
PAIR = re.compile(r"[\"'](\w+)[\"']: [\"']?([-+\w.]+)[\"']?")


def named(sentence: str) -> tuple[str, ...]:
    """Options that a sentence of a reader names, as words: `turn={"gyro_z": "-gyro_z"}`."""
    return tuple(
        word
        for option, inner in NAMED.findall(sentence)
        for name, value in PAIR.findall(inner)
        for word in (f"{option}.{name}", value)
    )


def pairs(words: Sequence[str]) -> list[tuple[str, str]]:
    """Words of a reader as names and values, without the mapping file before them."""
    own = words[len(words) % 2 :]
    return list(zip(own[::2], own[1::2], strict=True))


def told(options: Mapping[str, Any], name: str) -> Any:
    """What the reader was told of a dotted name, by words or by a mapping file; None for nothing."""
    found: Any = options
    for part in name.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


def in_all(finding: Finding, options: Mapping[str, Any]) -> Finding:
    """The finding with options that hold what the reader was told before as well."""
    found, said = [], finding.said
    for name, value in pairs(finding.options):
        before, total = told(options, name), value
        if before is not None:
            total = _together(name, value, before)
            if total != value:
                said += f"; with the {before} that the reader was told: {name} {total}"
        found += [name, total]
    return replace(finding, said=said, options=tuple(found))


def _together(name: str, value: str, before: Any) -> str:
    first = name.partition(".")[0]
    if first in SUMMED:
        return f"{float(before) + float(value):.6g}"
    if first == TURNED and value.startswith("-"):
        return str(before).lstrip("+-") if str(before).startswith("-") else f"-{before}"
    return value


def mended(
    words: Sequence[str], findings: Sequence[Finding], options: Mapping[str, Any],
    known: Collection[str],
) -> list[str]:  # fmt: skip
    """Words for the reader with those that mend findings.

    Args:
        words: that it was told.
        findings: whose options, through `in_all`, mend.
        options: what those words and a mapping file say.
        known: options that the reader has.
    """
    own, gained = dict(pairs(words)), list(words[: len(words) % 2])
    for finding in findings:
        for name, value in pairs(finding.options):
            first = name.partition(".")[0]
            fresh = told(options, name) is None or first in (*SUMMED, TURNED)
            if first in known and fresh and not _nothing(first, value):
                own[name] = value
    return gained + [word for pair in own.items() for word in pair]


def _nothing(first: str, value: str) -> bool:
    return first in SUMMED and math.isclose(float(value), 0.0, abs_tol=1e-9)
