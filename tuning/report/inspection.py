"""The page of `navgym inspect`: what was found, and every channel drawn over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.inspection.findings import Channel, Finding, Inspection
from navgym.inspection.noise import allan
from navgym.tuning.report import page as report
from navgym.tuning.report.page import Figure, Page, Section, Table, Tile
from navgym.tuning.report.plots import BAD, FAINT, MORE, OWN, PLAIN, drawing

POINTS = 3000  # of a line: more is no wider than a pixel
PANEL = 1.15  # inches of height per channel
MOST = 9  # channels in one figure
COLORS = (PLAIN, OWN, MORE[1], MORE[0], MORE[2], MORE[3])


def write(path: Path, found: Inspection) -> Path:
    """Write an inspection as one page that needs nothing else; returns the path."""
    return report.write_page(path, page(found))


def page(found: Inspection) -> Page:
    """The page of an inspection."""
    count = len(found.findings)
    tiles = [Tile(str(count), "findings" if count != 1 else "finding", "own" if count else "best")]
    lossy = [each for each in found.losses if each.runs]
    tiles += [Tile(f"{each.share:.0%}", f"of {each.sensor} lost", "") for each in lossy[:3]]
    sections = [
        Section("Findings", _said(found), [_findings(found.findings)] if count else []),
        Section("What is in it", [], [Table(("", ""), [(n, t) for n, t in found.told], text_columns=(0, 1))] if found.told else []),
        Section("Channels", [], [_channels(found.channels), *_series(found)] if found.channels else []),
        Section("Losses", [], [_losses(found)] if found.losses else []),
        Section("Noise that the log suggests", [], [*_noise(found)]),
    ]  # fmt: skip
    kept = [s for s in sections if s.text or s.items]
    lede = [
        f"{found.problem or 'A log'}, format {found.format}.",
        f"Next: `{found.next}`" if found.next else "No command helps before the file is mended.",
    ]
    basis = report.provenance(found.command or f"navgym inspect {found.log}")
    return Page(f"Inspection of {Path(found.log).name}", lede, kept, tiles, basis)


def _said(found: Inspection) -> list[str]:
    return (
        []
        if found.findings
        else ["Nothing was found: no test says anything that is unlikely for a sound log."]
    )


def _findings(findings: Sequence[Finding]) -> Table:
    rows = [
        (f.kind, f"{f.channel}: {f.said.rstrip('.')}. {_sentence(f.remedy)}".lstrip(": ").strip())
        for f in findings
    ]
    kinds = ["diverged" if f.severity == "error" else "own" for f in findings]
    return Table(("finding", "what was found, and what to do"), rows, "", kinds, (0, 1))


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.5g}"


def _channels(channels: Sequence[Channel]) -> Table:
    summaries = [c.as_dict() for c in channels]
    rows = [
        (s["name"], s["unit"], str(s["rows"]), str(s["received"]), *(_number(s[n]) for n in ("least", "median", "largest")))
        for s in summaries
    ]  # fmt: skip
    head = ("channel", "unit", "rows", "received", "least", "median", "largest")
    return Table(head, rows, "", (), (0, 1))


def _losses(found: Inspection) -> Table:
    head = ("sensor", "lost", "how", "runs", "mean run", "longest")
    rows = [
        (each.sensor, f"{each.share:.1%}", each.manner, str(each.runs), f"{each.mean:.3g}", str(each.longest))
        for each in found.losses
    ]  # fmt: skip
    return Table(head, rows, "Runs and lengths are in rows.", (), (0, 2))


def _noise(found: Inspection) -> Iterator[Any]:
    if found.noise:
        yield Table(("", ""), list(found.noise), text_columns=(0, 1))
    inertial = [c for c in found.channels if c.kind in ("rate", "force")]
    if inertial:
        yield _allan(inertial)


# ---- drawings


def _thin(time: Array, values: Array) -> tuple[Array, Array]:
    """Least and largest value of each of `POINTS` / 2 pieces: spikes stay in sight."""
    size = -(-len(values) // (POINTS // 2))
    if size < 2:
        return time, values
    whole = len(values) // size * size
    parts, t = values[:whole].reshape(-1, size), time[:whole].reshape(-1, size)[:, 0]
    known = np.isfinite(parts).any(axis=1)
    low = np.full(len(parts), np.nan)
    high = low.copy()
    low[known], high[known] = np.nanmin(parts[known], axis=1), np.nanmax(parts[known], axis=1)
    return np.repeat(t, 2), np.stack([low, high], axis=-1).ravel()


def _series(found: Inspection) -> Iterator[Figure]:
    for first in range(0, len(found.channels), MOST):
        yield _panels(found.channels[first : first + MOST], found.findings)
    if found.track is not None and np.isfinite(found.track[0]).sum() > 1:
        yield _track(*found.track)


def _panels(channels: Sequence[Channel], findings: Sequence[Finding]) -> Figure:
    caption = "Values as the log holds them, against time. Red: what a finding is about."
    wrong = {name.strip() for f in findings for name in f.channel.replace(" and ", ",").split(",")}
    with drawing(
        caption, PANEL * len(channels) + 0.6, nrows=len(channels), sharex=True, squeeze=False
    ) as (axes, made):
        for ax, channel in zip(axes[:, 0], channels, strict=True):
            t, x = _thin(channel.time, channel.values)
            color = BAD if channel.name in wrong or channel.sensor in wrong else PLAIN
            isolated = np.isnan(x).mean() > 0.1
            ax.plot(t, x, "." if isolated else "-", color=color, lw=0.8, ms=2.0)
            ax.set_title(f"{channel.name}, {channel.unit}".rstrip(", "), fontsize=9)
            ax.locator_params(axis="y", nbins=3)
            ax.grid(axis="y")
        axes[-1, 0].set_xlabel("time, s")
    return made[0]


def _track(north: Array, east: Array) -> Figure:
    with drawing("Position fixes.", 4.6) as (ax, made):
        ax.plot(east, north, ".", color=PLAIN, ms=2.5)
        ax.set_xlabel("east, m")
        ax.set_ylabel("north, m")
        ax.set_aspect("equal", "datalim")
        ax.locator_params(nbins=6)
        ax.grid()
    return made[0]


def _allan(channels: Sequence[Channel]) -> Figure:
    kinds = list(dict.fromkeys(c.kind for c in channels))
    caption = (
        "Overlapping Allan deviation of the longest stretch without a gap. White noise falls with the square root of the "
        "time (dashed); what rises is motion, or a drifting bias."
    )  # fmt: skip
    with drawing(caption, 3.4 * len(kinds), nrows=len(kinds), squeeze=False) as (axes, made):
        for ax, kind in zip(axes[:, 0], kinds, strict=True):
            group = [c for c in channels if c.kind == kind]
            for k, c in enumerate(group):
                tau, deviation = allan(c.values, float(np.median(np.diff(c.time))))
                good = deviation > 0.0
                if good.any():
                    ax.loglog(
                        tau[good],
                        deviation[good],
                        color=COLORS[k % len(COLORS)],
                        lw=1.2,
                        label=c.name,
                    )
                    ax.loglog(
                        tau[good],
                        deviation[good][0] * (tau[good] / tau[good][0]) ** -0.5,
                        color=FAINT,
                        lw=0.7,
                        ls="--",
                    )
            ax.set_ylabel(f"{kind}, {group[0].unit}")
            ax.legend(
                loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=6, fontsize=9, borderaxespad=0.2
            )
            ax.grid()
        axes[-1, 0].set_xlabel("time of averaging, s")
    return made[0]
