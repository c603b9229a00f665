"""What one channel alone shows: stops, frozen stretches, impossible values, jumps, coarse digits.

Each test says "nothing" of a sound channel but for a chance that `ALARM` bounds, whatever its noise:
Gaussian, with a tenth of outliers of ten sigma, or Student-t with three degrees of freedom.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.ndimage import median_filter

from navgym.core.checks import Array
from navgym.core.repeats import FINE, is_held, quantum, repeats
from navgym.core.stops import saturated
from navgym.inspection.findings import Channel, Finding

ALARM = 1e-6  # chance, per channel, that a test says something of a sound one
FEWEST = 50  # received values below which little can be said
FAR = 80.0  # nine-tenths quantiles of the steps: Student-t noise with three degrees goes there once in 4e6
WINDOW = 11  # steps whose median is the usual slope
RETURN = 20  # steps within which an outlier is over: later, it is a jump and a jump back
ALIKE = 0.25  # share by which the way back may miss the way there
TURNS = (2.0 * math.pi, 360.0)  # jumps of an angle that nobody calls one
LEAST = {
    "rate": 1.0,
    "force": 20.0,
}  # rad/s, m/s²: what shocks and slams may do from one sample to the next
MATTERS = {
    "position": 0.01,
    "velocity": 1e-3,
}  # m, m/s: smaller steps are rounding, whatever the others
CYCLIC = "angle"  # 359 is beside 0


def of(channel: Channel) -> list[Finding]:
    """What is wrong with one channel."""
    x = channel.values[channel.received]
    if not len(x):
        return [Finding("empty", channel.name, f"all {len(channel.values)} values are missing",
                        "leave the column out, or check what the logger wrote")]  # fmt: skip
    if len(x) >= 10 and np.ptp(x) == 0.0:
        said = f"all {len(x)} values are {x[0]:g}"
        return [
            Finding("constant", channel.name, said, "check the sensor, or leave the column out")
        ]
    found = [*_stops(channel, x)] or [*_frozen(channel, x)]
    return [*found, *_steps(channel), *_resolution(channel, x)]


def resolution(x: Array) -> float:
    """The smallest step between different values, rounding of numbers left out; 0 for none."""
    steps = np.diff(np.unique(x))
    steps = steps[steps > 1e-12 * max(float(np.abs(x).max()), 1e-300)]
    return float(steps.min()) if len(steps) else 0.0


def _stops(channel: Channel, x: Array) -> Iterator[Finding]:
    if channel.kind == CYCLIC or len(x) < FEWEST:
        return
    for _, stop, count in saturated(x[:, None], (channel.name,))[1]:
        yield Finding(
            "saturation", channel.name,
            f"{count} values stand at exactly {stop:.6g} {channel.unit}, beyond which there is none",
            "mark them as lost, or use a sensor of a wider range",
        )  # fmt: skip


def _frozen(channel: Channel, x: Array) -> Iterator[Finding]:
    """A run of equal values that is longer than the channel's other repeats let expect."""
    if channel.mended & {"held"} or len(x) < FEWEST:
        return
    digit, same = channel.digit or resolution(x), np.diff(x) == 0.0
    if np.median(np.abs(np.diff(x))[~same]) < FINE * digit:
        return
    whole = x[:, None]
    if is_held(whole, repeats(whole), [digit]) and same.mean() > 0.3:
        share = f"{same.mean():.0%} of the values repeat those before them"
        yield Finding(
            "held", channel.name, share, "mark repeats as lost: they are no new measurements"
        )
        return
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    begins, lengths = bounds[::2], np.diff(bounds)[::2]
    if not len(lengths):
        return
    k = int(lengths.argmax())
    longest = int(lengths[k])
    usual = max((same.sum() - longest) / max(len(same) - longest, 1), 1.0 / len(x))
    if longest >= 4 and math.log(len(x)) + longest * math.log(usual) < math.log(ALARM):
        t = channel.time[channel.received][begins[k]]
        yield Finding(
            "frozen", channel.name,
            f"{longest + 1} values in a row are {x[begins[k]]:.6g}, from {t:.6g} s on; elsewhere "
            f"{usual:.2%} repeat the one before",
            "mark them as lost",
        )  # fmt: skip


# ---- steps that cannot be


def out_of_line(time: Array, x: Array) -> tuple[Array, float]:
    """Steps of a series less their usual slope (T - 1,), NaN over gaps, and what nine tenths stay below."""
    dt, dx = np.diff(time), np.diff(x)
    usual = float(np.median(dt[dt > 0.0])) if (dt > 0.0).any() else 0.0
    good = (dt > 0.0) & (dt <= 3.0 * usual)
    slope = np.where(good, dx / np.where(dt > 0.0, dt, 1.0), 0.0)
    left = np.where(good, dx - median_filter(slope, WINDOW, mode="nearest") * dt, np.nan)
    there = np.abs(left[good])
    scale = float(np.quantile(there, 0.9)) if len(there) else 0.0
    return left, max(scale, resolution(x))


def _steps(channel: Channel) -> Iterator[Finding]:
    """Values far from both neighbours, and jumps that stay."""
    there = channel.received
    if there.sum() < FEWEST or channel.kind == CYCLIC:
        return
    t, x = channel.time[there], channel.values[there]
    left, scale = out_of_line(t, x)
    scale = max(scale, channel.digit)
    big = (
        np.flatnonzero(np.abs(np.nan_to_num(left)) > FAR * scale)
        if scale > 0.0
        else np.empty(0, int)
    )
    spikes, jumps = _paired(
        [int(k) for k in big if _possible(channel.kind, abs(float(left[k])))], left
    )
    if channel.kind in LEAST:  # a slam is no reset
        jumps = []
    if spikes:
        worst = max(spikes, key=lambda k: abs(left[k]))
        yield Finding(
            "outliers", channel.name,
            f"{len(spikes)} values far from their neighbours, the worst by {abs(left[worst]):.4g} "
            f"{channel.unit} at {t[worst + 1]:.6g} s; nine tenths of the steps are below {scale:.3g}",
            "mark them as lost, or run a filter that expects them (bank)",
        )  # fmt: skip
    for k in jumps[:3]:
        yield Finding(
            "jump", channel.name,
            f"jumps by {left[k]:+.4g} {channel.unit} at {t[k + 1]:.6g} s and stays there; nine tenths of the "
            f"steps are below {scale:.3g}",
            "cut the log there, or find out what was reset",
        )  # fmt: skip


def _possible(kind: str, size: float) -> bool:
    """Whether a step of that size is worth a word: no shock of an IMU, no turn of an angle in a channel of unknown kind."""
    turned = kind == "other" and any(abs(size / turn - 1.0) < ALIKE for turn in TURNS)
    return size > {**LEAST, **MATTERS}.get(kind, 0.0) and not turned


def _paired(big: Sequence[int], left: Array) -> tuple[list[int], list[int]]:
    """Steps that are soon undone, and those that are not."""
    spikes: list[int] = []
    jumps: list[int] = []
    rest = list(big)
    while rest:
        k = rest.pop(0)
        back = [
            j for j in rest if j - k <= RETURN and abs(left[j] + left[k]) <= ALIKE * abs(left[k])
        ]
        if back:
            rest.remove(back[0])
            spikes.append(k)
        elif k < 2 or k > len(left) - 3 or (rest and rest[0] - k <= RETURN):
            spikes.append(k)  # at an end, or among others: no level to compare
        else:
            jumps.append(k)
    return spikes, jumps


def _resolution(channel: Channel, x: Array) -> Iterator[Finding]:
    """Digits so coarse that they, not the sensor, make the noise."""
    if len(x) < FEWEST or channel.kind == CYCLIC or channel.mended & {"held"}:
        return
    digit = channel.digit or quantum(x)
    if digit > 0.0 and np.quantile(np.abs(np.diff(x, 2)), 0.9) < 2.5 * digit:
        yield Finding(
            "resolution", channel.name,
            f"values are multiples of {digit:.4g} {channel.unit}, and hardly change by more than one",
            f"believe a deviation of at least {digit / math.sqrt(12.0):.3g}, or log more digits",
        )  # fmt: skip
