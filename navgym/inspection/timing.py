"""What the times of rows show: gaps, a clock that was set forward, a rate that changes; and losses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from navgym.core.checks import Array
from navgym.inspection.findings import Finding, Losses
from navgym.inspection.motion import Motion
from navgym.inspection.series import ALARM

Span = tuple[float, float]

LONG = 10.0  # usual steps: shorter gaps are nobody's concern
SILENT = 50.0  # usual steps without a value in a row
SAME = 0.8  # share of a gap that a known one covers
CHANGED = 1.5  # factor between the usual steps of two halves
FEW = 30  # rows of a half
PACED = 0.9  # share of spacings that a pace explains
RARE = 1e-4  # chance of independent losses to seem paced
SPREAD = 0.2  # of the variance of spacings of independent rows, below which they keep a pace
EVEN = 0.05  # share by which the middle half of the steps may vary where a rate is a rate


def gaps(
    time: Array, name: str = "", motion: Motion | None = None, known: Sequence[Span] = ()
) -> Iterator[Finding]:
    """Gaps that the log's other gaps do not let expect: lengths of losses in bursts are geometric.

    Args:
        time: (T,) s, of rows, in order.
        name: of the sensor.
        motion: positions and velocities that tell a gap from a clock that was set, or None.
        known: spans that were told of before.
    """
    usual = _usual(time)
    for before, after in long_steps(time):
        if not _is_known(before, after, known):
            yield _gap(before, after, usual, name, motion)


def outage(time: Array, name: str, known: Sequence[Span] = ()) -> Iterator[Finding]:
    """One long silence of a sensor whose rows stand there without a value.

    Losses in bursts make several long ones, which the line of losses tells: only one alone counts.

    Args:
        time: (T,) s, of rows with a value, in order.
        name: of the sensor.
        known: spans that were told of before.
    """
    usual = _usual(time)
    found = long_steps(time)
    if len(found) != 1 or (np.diff(time) >= LONG * usual).sum() != 1:
        return
    ((before, after),) = found
    if after - before >= SILENT * usual and not _is_known(before, after, known):
        yield Finding(
            "gap", name,
            f"nothing received for {after - before:.6g} s after {before:.6g} s; the usual step is {usual:.4g} s",
            "a filter predicts through it",
        )  # fmt: skip


def _is_known(before: float, after: float, known: Sequence[Span]) -> bool:
    common = max((min(a, after) - max(b, before) for b, a in known), default=0.0)
    return common >= SAME * (after - before)


def _usual(time: Array) -> float:
    steps = np.diff(time)
    steps = steps[steps > 0.0]
    return float(np.median(steps)) if len(steps) else 0.0


def long_steps(time: Array) -> list[Span]:
    """From when to when the gaps of (T,) times last that the others do not let expect."""
    steps = np.diff(time)
    steps = steps[steps > 0.0]
    if len(steps) < FEW:
        return []
    usual, found = _usual(time), []
    long = np.sort(steps[steps > 1.5 * usual] / usual)
    if not len(long) or long[-1] < LONG:
        return []
    for k in range(1, min(len(long), 4) + 1):
        others = long[:-k] if k < len(long) else np.empty(0)
        mean = max(float(others.mean()) if len(others) else 1.0, 1.0)
        gap = float(long[-k])
        chance = (
            len(long) * math.exp(-(gap - 1.0) / mean) if len(others) >= 5 else math.exp(-gap / 5.0)
        )
        if gap < LONG or chance > (ALARM if len(others) >= 5 else math.exp(-LONG / 5.0)):
            break
        at = int(np.flatnonzero(np.diff(time) >= gap * usual * (1.0 - 1e-9))[0])
        found.append((float(time[at]), float(time[at + 1])))
    return found


def _gap(before: float, after: float, usual: float, name: str, motion: Motion | None) -> Finding:
    if motion is not None and motion.stood(before, after):
        return Finding(
            "clock step", name,
            f"after {before:.6g} s the time jumps by {after - before:.6g} s, and the positions move on as in one "
            f"step of {usual:.4g} s",
            "cut the log there, or take the jump off the later times",
        )  # fmt: skip
    return Finding(
        "gap", name,
        f"no row for {after - before:.6g} s after {before:.6g} s; the usual step is {usual:.4g} s",
        "a filter predicts through it; where a clock was set, cut the log there",
    )  # fmt: skip


def rate(time: Array, name: str = "") -> Iterator[Finding]:
    """A log whose rate changes for good."""
    steps = np.diff(time)
    steps = steps[steps > 0.0]
    half = len(steps) // 2
    if half < FEW:
        return
    first, second = (np.quantile(part, [0.25, 0.5, 0.75]) for part in (steps[:half], steps[half:]))
    even = all(q[2] - q[0] <= EVEN * q[1] for q in (first, second))
    if even and max(first[1] / second[1], second[1] / first[1]) > CHANGED:
        yield Finding(
            "rate", name,
            f"the usual step is {first[1]:.4g} s in the first half of the rows, {second[1]:.4g} s in the second",
            "what counts samples (decision intervals, forgetting) means other times there",
        )  # fmt: skip


def losses(sensor: str, lost: NDArray[np.bool_]) -> Losses:
    """How a sensor's measurements, (T,), got lost."""
    edges = np.diff(np.concatenate([[0], lost.astype(np.int8), [0]]))
    lengths = np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)
    after = lost[1:][lost[:-1]]
    return Losses(
        sensor, len(lost), float(lost.mean()) if len(lost) else 0.0, len(lengths),
        float(lengths.mean()) if len(lengths) else 0.0, int(lengths.max(initial=0)),
        float(after.mean()) if len(after) else 0.0, pace(~lost) or -pace(lost),
    )  # fmt: skip


def pace(rows: NDArray[np.bool_]) -> float:
    """Rows from one of `rows`, (T,), to the next where these keep a pace, else 0.

    A slow sensor in the rows of a fast one has every n-th row, less what it lost itself: its spacings
    are multiples of n. Where its interval is no whole number of rows, they hardly differ. Spacings of
    independent rows are geometric: their variance is mean · (mean - 1), and few are multiples of n.
    """
    spacings = np.diff(np.flatnonzero(rows))
    usual = int(np.bincount(spacings).argmax()) if len(spacings) else 0
    if usual < 2 and not (len(spacings) >= FEW and spacings.mean() > 1.0):
        return 0.0
    if usual >= 2:
        gone, fit = 1.0 - float(rows.mean()), int((spacings % usual == 0).sum())
        chance = (1.0 - gone) * gone ** (usual - 1) / (1.0 - gone**usual)
        if fit >= PACED * len(spacings) and binom.sf(fit - 1, len(spacings), chance) < RARE:
            return float(usual)
    mean = float(spacings.mean())
    even = len(spacings) >= FEW and spacings.var() < SPREAD * mean * (mean - 1.0)
    return mean if even else 0.0
