"""What a recording of two IMUs on one deck shows when looked over."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from navgym.core.checks import Array
from navgym.deck.recording import DualIMURecording
from navgym.inertial.earth import GRAVITY, MICRO_G
from navgym.inertial.imu import DEGREE_PER_ROOT_HOUR
from navgym.inspection import noise
from navgym.inspection.findings import Channel, Evidence, Finding

OFF = 0.03  # share of gravity by which the usual specific force may miss it
LONGEST = 1.0  # s, either way, of a delay between the IMUs
SAME, GAIN = 0.5, 0.02  # least correlation of the rates of turn; by how much a delay must raise it
SCALED = 1.1  # factor between the IMUs' rates of turn
BLOCK = 0.05  # s, over which rates are means


def evidence(recording: DualIMURecording, log: Path, options: Mapping[str, Any]) -> Evidence:  # noqa: ARG001
    """Channels, findings and the noise of a log of two IMUs."""
    channels = [c for unit in ("main", "sub") for c in _channels(recording, unit)]
    findings = [*_gravity(recording), *_alike(recording)]
    return Evidence(channels, findings, list(_noise(recording)))


def _channels(r: DualIMURecording, unit: str) -> Iterator[Channel]:
    for field, name, kind, of in (
        ("angle", "gyro", "rate", "rad/s"),
        ("velocity", "acc", "force", "m/s²"),
    ):
        for axis, x in zip("xyz", (getattr(r, f"{unit}_{field}") / r.interval).T, strict=True):
            yield Channel(f"{unit}_{name}_{axis}", f"{unit}_{name}", kind, of, r.time, x)


def _gravity(r: DualIMURecording) -> Iterator[Finding]:
    for unit in ("main", "sub"):
        size = float(
            np.nanmedian(np.linalg.norm(getattr(r, f"{unit}_velocity") / r.interval, axis=1))
        )
        if abs(size / GRAVITY - 1.0) > OFF:
            yield Finding(
                "gravity", f"{unit}_acc",
                f"the usual specific force is {size:.4g} m/s², {size / GRAVITY - 1.0:+.1%} from gravity",
                "check the scale of the accelerometers, and whether gravity was taken off",
            )  # fmt: skip


def _turning(r: DualIMURecording, unit: str) -> Array:
    """Size of the rate of turn over blocks, rad/s, which no mounting angle changes; NaN at gaps."""
    per = max(round(BLOCK / r.interval), 1)
    angle = getattr(r, f"{unit}_angle")
    whole = len(angle) // per * per
    turned: Array = np.linalg.norm(angle[:whole].reshape(-1, per, 3).sum(axis=1), axis=1) / (
        per * r.interval
    )
    return turned


def _alike(r: DualIMURecording) -> Iterator[Finding]:
    """Both IMUs turn with the hull: as fast as each other, and at the same time."""
    main, sub = _turning(r, "main"), _turning(r, "sub")
    step = max(round(BLOCK / r.interval), 1) * r.interval
    most = min(round(LONGEST / step), len(main) // 4)
    if len(main) < 100:
        return
    shares = {k: _correlation(main, sub, k) for k in range(-most, most + 1)}
    best = max(shares, key=lambda k: shares[k])
    if shares[best] < SAME:
        return  # hardly moving: nothing to compare
    if best and shares[best] > shares[0] + GAIN:
        who, other = ("sub", "main") if best > 0 else ("main", "sub")
        yield Finding(
            "delay", f"{who}_gyro",
            f"the IMUs turn alike (correlation {shares[best]:.3f} instead of {shares[0]:.3f}) if {who} is taken "
            f"{abs(best) * step:.3g} s later than {other} at the same stamp",
            f"take {abs(best) * step:.3g} s off the times of {who}, and bring both to one grid",
        )  # fmt: skip
        return
    ratio = float(np.sqrt(np.nanmean(sub**2) / np.nanmean(main**2)))
    if max(ratio, 1.0 / ratio) > SCALED:
        yield Finding(
            "unlike", "sub_gyro", f"the sub IMU turns {ratio:.4g} times as fast as the main one on the same hull",
            "check the units and scales of both IMUs' gyros",
        )  # fmt: skip


def _correlation(a: Array, b: Array, shift: int) -> float:
    """Of `a` and `b` moved back by `shift` blocks."""
    x, y = (a[: len(a) - shift], b[shift:]) if shift >= 0 else (a[-shift:], b[:shift])
    there = np.isfinite(x + y)
    if there.sum() < 50 or x[there].std() == 0.0 or y[there].std() == 0.0:
        return 0.0
    return float(np.corrcoef(x[there], y[there])[0, 1])


def _noise(r: DualIMURecording) -> Iterator[tuple[str, str]]:
    for unit in ("main", "sub"):
        for field, name, size, of in (
            ("angle", "gyros", DEGREE_PER_ROOT_HOUR, "°/√h"),
            ("velocity", "accelerometers", MICRO_G, "µg/√Hz"),
        ):
            pairs = [
                noise.densities(x, r.interval)
                for x in (getattr(r, f"{unit}_{field}") / r.interval).T
            ]
            yield (f"{unit} {name}", f"at most {max(p[0] for p in pairs) / size:.3g} {of} white")
