"""What positions, velocities and a heading say of each other.

Displacements between fixes are held against the integral of the velocities. A sound log is explained best
as it is; where another arrangement of axes, another scale, a turn or a delay explains the displacements far
better, that is found. Everything is least squares on windows that do not overlap.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.inspection.findings import Finding

PLACES, SPEEDS = ("px", "py"), ("vx", "vy")  # what the reader's options call the channels
WINDOWS = 24  # into which a log is cut
FEWEST = 8  # windows
GAP = 5.0  # usual steps: what velocities say over a longer gap is left out
BETTER = 4.0  # times the sum of squares: with 16 numbers, chance passes it less than once in 1e4
EXPLAINED = 0.3  # share of the displacements that a good arrangement leaves at most
ALIKE = 1.5  # ratio of sums of squares that tells nothing
SIGMAS = 7.0  # of windows whose worth differs: fewer say too much
SCALED, TURNED = 0.05, math.radians(3.0)  # what of scale and turn is worth a word
LONGEST_DELAY, TRIED = 10.0, (0.1, 0.2, 0.5, 1.0, 2.0)  # s; beside multiples of the step
EARNED, WORTH = (
    5.5,
    1.3,
)  # deviations by which a delay must fit better (of some 90 tried), and ratio of squares
FACTORS = {
    "kn": 1852.0 / 3600.0, "km/h": 1.0 / 3.6, "cm/s": 0.01, "mm/s": 0.001, "ft/s": 0.3048,
}  # fmt: skip
LENGTHS = {"km": 1e3, "ft": 0.3048, "cm": 0.01, "mm": 0.001}
HEADING = math.radians(25.0)  # a crab angle may be as much
ALIGNED = 0.9  # mean resultant length of a heading that goes with the track


@dataclass(frozen=True, eq=False)
class Motion:
    """Fixes and velocities of one vehicle, axes north and east.

    Args:
        fix_time: (P,) s, in order.
        fixes: (P, 2) m.
        time: (V,) s, strictly in order.
        velocity: (V, 2) m/s.
        names: of the four channels: two positions, two velocities.
        geographic: whether positions came in degrees, so that no unit of length can be wrong.
    """

    fix_time: Array
    fixes: Array
    time: Array
    velocity: Array
    names: tuple[str, str, str, str] = ("px", "py", "vx", "vy")
    geographic: bool = False

    @classmethod
    def of(cls, time: Array, fixes: Array, velocity: Array, **more: object) -> Motion | None:
        """From rows (T,), what was received of them; None where there is too little."""
        p, v = (np.isfinite(each).all(axis=1) for each in (fixes, velocity))
        v &= np.diff(time, prepend=-np.inf) > 0.0
        p &= np.diff(time, prepend=-np.inf) > 0.0
        if p.sum() < 2 * FEWEST or v.sum() < 2 * FEWEST:
            return None
        return cls(time[p], fixes[p], time[v], velocity[v], **more)  # type: ignore[arg-type]

    def integral(self, at: Array, velocity: Array | None = None) -> Array:
        """(K, 2) m, of the velocities from their first time on."""
        v = self.velocity if velocity is None else velocity
        steps = np.diff(self.time)[:, None] * 0.5 * (v[1:] + v[:-1])
        total = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        return np.stack([np.interp(at, self.time, axis) for axis in total.T], axis=-1)

    def windows(self, count: int, margin: float = 0.0) -> NDArray[np.intp]:
        """(N + 1,) indices of fixes that bound windows which the velocities cover."""
        low, high = self.time[0] + margin, self.time[-1] - margin
        inside = np.flatnonzero((self.fix_time >= low) & (self.fix_time <= high))
        return inside[:: max(len(inside) // count, 1)]

    def moved(self, at: NDArray[np.intp], velocity: Array | None = None) -> tuple[Array, Array]:
        """(N, 2) displacements between fixes, and what velocities make of them; none over gaps of these."""
        told = np.diff(self.integral(self.fix_time[at], velocity), axis=0)
        whole = self.whole(at)
        return np.diff(self.fixes[at], axis=0)[whole], told[whole]

    def whole(self, at: NDArray[np.intp]) -> NDArray[np.bool_]:
        """(N,) windows in which no velocity is missing for long."""
        steps = np.diff(self.time)
        bad = np.concatenate([[0], np.cumsum(steps > GAP * np.median(steps))])
        counts = bad[np.clip(np.searchsorted(self.time, self.fix_time[at]), 0, len(bad) - 1)]
        found: NDArray[np.bool_] = np.diff(counts) == 0
        return found

    def stood(self, before: float, after: float) -> bool:
        """Whether over a jump of the time the positions moved as in one usual step."""
        i, j = np.searchsorted(self.fix_time, [before, after], side="right") - [1, 1]
        if i < 5 or j + 5 > len(self.fix_time) or i == j:
            return False
        near = np.abs(self.time - before) <= np.abs(self.time - after)
        v = np.median(np.concatenate([self.velocity[near & (self.time <= before)][-5:],
                                      self.velocity[~near & (self.time >= after)][:5]]), axis=0)  # fmt: skip
        inner = [k for k in range(max(i - 50, 1), min(j + 50, len(self.fix_time))) if k != j]
        steps = np.linalg.norm(self.fixes[inner] - self.fixes[[k - 1 for k in inner]], axis=1)
        scatter = float(np.quantile(steps, 0.9))
        moved = self.fixes[j] - self.fixes[i]
        usual = float(np.median(np.diff(self.fix_time)))
        size = float(np.linalg.norm(v)) * (self.fix_time[j] - self.fix_time[i])
        return bool(size > 10.0 * scatter and np.linalg.norm(moved - v * usual) < scatter)


# ---- what does not fit


def disagreements(
    motion: Motion,
    heading: Array | None = None,
    heading_time: Array | None = None,
    turned: bool = False,
) -> list[Finding]:
    """What is wrong between positions and velocities: the first of frame, axes, units, scale and turn; and delay.

    Args:
        motion: of a log.
        heading: (H,) rad, north to east, or None.
        heading_time: (H,) s.
        turned: whether the velocities are a sensor's in the vehicle's axes, turned by the heading.
    """
    at = motion.windows(WINDOWS)
    if len(at) < FEWEST + 1 or motion.whole(at).sum() < FEWEST:
        return []
    if heading is not None and heading_time is not None:
        c, s = (np.interp(motion.time, heading_time, f(heading)) for f in (np.cos, np.sin))
        body = [*(_mounted if turned else _body)(motion, at, c, s)]
        if body:
            return body
    found = [*_arrangement(motion, at)]
    if not found:
        found = [*_scale(motion, at), *_turn(motion, at)]
    return found or [*_delay(motion)]


def _left(moved: Array, told: Array) -> tuple[float, float]:
    """The best positive factor of `told`, and the sum of squares that it leaves."""
    power = float((told * told).sum())
    factor = max(float((moved * told).sum()) / power, 0.0) if power > 0.0 else 0.0
    return factor, float(((moved - factor * told) ** 2).sum())


def _turned(v: Array, c: Array, s: Array) -> Array:
    """(V, 2) turned by angles of cosine c and sine s, (V,)."""
    x, y = v.T
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def _body(motion: Motion, at: NDArray[np.intp], c: Array, s: Array) -> list[Finding]:
    turned = _turned(motion.velocity, c, s)
    moved, told = motion.moved(at)
    own, other = _left(moved, told)[1], _left(moved, motion.moved(at, turned)[1])[1]
    if not (own > BETTER * other and other < EXPLAINED * (moved**2).sum()):
        return []
    names = " and ".join(motion.names[2:])
    return [Finding(
        "frame", names, f"turned by the heading, they explain the displacements {own / other:.3g} times better: "
        "they are forward and right, not north and east",
        "turn them by the heading before the log is read",
    )]  # fmt: skip


_SIGNS = [np.diag([a, b]) for a in (1.0, -1.0) for b in (1.0, -1.0)]
_ARRANGED = [*_SIGNS, *(np.array([[0.0, 1.0], [1.0, 0.0]]) @ s for s in _SIGNS)]


_MOUNTED = [
    *(np.diag(d) for d in ((1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0))),
    *_ARRANGED[4:],
]


def _mounted(motion: Motion, at: NDArray[np.intp], c: Array, s: Array) -> Iterator[Finding]:
    """Whether forward and starboard are other axes of the sensor than those that were turned."""
    body = _turned(motion.velocity, c, -s)
    moved, _ = motion.moved(at)
    left = [_left(moved, motion.moved(at, _turned(body @ S.T, c, s))[1])[1] for S in _MOUNTED]
    # along an axis on which nothing moves either sign will do: the first
    best = int(np.argmax(np.asarray(left) <= ALIKE * min(left)))
    if not (left[0] > BETTER * left[best] and left[best] < EXPLAINED * (moved**2).sum()):
        return
    signs = "+-"
    forward, starboard = (
        f"{signs[int(row.sum() < 0.0)]}{motion.names[2 + int(np.abs(row).argmax())]}" for row in _MOUNTED[best]
    )  # fmt: skip
    yield Finding(
        "axes", " and ".join(motion.names[2:]),
        f"forward is {forward} and starboard {starboard}: so they explain the displacements "
        f"{left[0] / left[best]:.3g} times better",
        "check the sensor's mounting and what its frame is called, or the attitude that turned it",
    )  # fmt: skip


def _arrangement(motion: Motion, at: NDArray[np.intp]) -> Iterator[Finding]:
    moved, told = motion.moved(at)
    left = [_left(moved, told @ S.T)[1] for S in _ARRANGED]
    best = int(np.argmin(left))
    if not (left[0] > BETTER * left[best] and left[best] < EXPLAINED * (moved**2).sum()):
        return
    S, (north, east) = _ARRANGED[best], motion.names[2:]
    better = f"explains the displacements {left[0] / left[best]:.3g} times better"
    if S[0, 1] == 0.0:
        wrong = [name for name, sign in zip((north, east), np.diag(S), strict=True) if sign < 0.0]
        what = " and ".join(wrong)
        remedy = f"turn the sign of {what}"
        if motion.geographic:
            of = {north: "latitude", east: "longitude"}
            better += f", and so do{'es' * (len(wrong) == 1)} the sign of {' and '.join(of[n] for n in wrong)}"
            remedy += ", or of these degrees: a look at a map tells which is wrong"
        yield Finding("sign", what, f"the other way round, {what} {better}", remedy)
        return
    signs = "" if (S >= 0.0).all() else ", one or both with the other sign,"
    if motion.geographic:
        yield Finding(
            "axes", f"{north} and {east}", f"exchanged{signs} {better}, or latitude and longitude are",
            f"exchange {north} and {east}, or the degrees: a look at a map tells which is wrong",
        )  # fmt: skip
        return
    plain = not signs and (north, east) == SPEEDS  # no column of the file if they were turned
    options = tuple(w for a, b in zip(SPEEDS, SPEEDS[::-1], strict=True) for w in (f"columns.{a}", b)) if plain else ()  # fmt: skip
    yield Finding("axes", f"{north} and {east}", f"exchanged{signs} {better}",
                  f"exchange {north} and {east}", options)  # fmt: skip


def _scale(motion: Motion, at: NDArray[np.intp]) -> Iterator[Finding]:
    """How much farther positions move than velocities say, between the bounds of two regressions.

    Noise of the velocities makes the factor of displacements on them too small, noise of the positions that of
    the reverse regression too large; the true one lies between.
    """
    moved, told = motion.moved(at)
    both, power, whole = (float(x.sum()) for x in (moved * told, told**2, moved**2))
    if both <= 0.0:
        return
    low, high = both / power, whole / both
    factor = math.sqrt(low * high)
    # windows are of unlike worth: each counts with what it misses by itself
    misses = (
        ((moved - low * told) * told).sum(axis=1) / power,
        ((moved - high * told) * moved).sum(axis=1) / both,
    )
    deviation = max(float(np.linalg.norm(each)) for each in misses)
    margin = max(SCALED * factor, SIGMAS * deviation)
    if low - margin < 1.0 < high + margin:
        return
    names = " and ".join(motion.names[2:])
    said = (
        f"positions move {factor:.4g} times as far as the velocities say ({low:.4g} to {high:.4g})"
    )
    radian = math.radians(1.0)
    if motion.geographic and low - margin < radian < high + margin:
        yield Finding("degrees", "lat and lon", f"{said}: they are in radians and were read as degrees",
                      "say that they are in radians", ("units.lat", "rad", "units.lon", "rad"))  # fmt: skip
        return
    near = {u: f for u, f in FACTORS.items() if low - margin < f < high + margin}
    lengths = {} if motion.geographic else LENGTHS
    far = {u: 1.0 / f for u, f in lengths.items() if low - margin < 1.0 / f < high + margin}
    for units, (x, y), (a, b) in (
        (near, motion.names[2:], SPEEDS),
        (far, motion.names[:2], PLACES),
    ):
        if units:
            unit = min(units, key=lambda u: abs(math.log(factor / units[u])))
            yield Finding("units", f"{x} and {y}", f"{said}: as if they were in {unit}",
                          f"say that they are in {unit}", (f"units.{a}", unit, f"units.{b}", unit))  # fmt: skip
            return
    yield Finding("scale", names, said, "calibrate the scale of the velocities")


def _turn(motion: Motion, at: NDArray[np.intp]) -> Iterator[Finding]:
    moved, told = motion.moved(at)
    cross = float((told[:, 0] * moved[:, 1] - told[:, 1] * moved[:, 0]).sum())
    along = float((told * moved).sum())
    angle = math.atan2(cross, along)
    c, s = math.cos(angle), math.sin(angle)
    turned = told @ np.array([[c, -s], [s, c]]).T
    factor, left = _left(moved, turned)
    power = max(factor, 1e-300) ** 2 * float((told**2).sum())
    deviation = math.sqrt(left / (2 * len(moved)) / power) if power > 0.0 else math.inf
    explained = left < EXPLAINED * float((moved**2).sum())  # a vehicle at rest turns at random
    if explained and abs(angle) > max(TURNED, SIGMAS * deviation):
        yield Finding(
            "rotation", " and ".join(motion.names[2:]),
            f"positions move {math.degrees(angle):+.3g}° ± {math.degrees(deviation):.2g}° (towards east) from where "
            "the velocities point",
            "turn the velocities by that: the mounting of the sensor, or the declination",
        )  # fmt: skip


def _delay(motion: Motion) -> Iterator[Finding]:
    """By how much moved velocities explain the displacements better than as they are stamped."""
    step = float(np.median(np.diff(motion.time)))
    grid = np.unique(
        np.concatenate([step * np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0]), TRIED])
    )
    grid = grid[(grid <= LONGEST_DELAY) & (grid >= 0.5 * step)]
    best = (0.0, 0.0, 0.0)  # ratio, delay, deviations
    for per in (2, 4, 8, 16, 32):
        at = motion.windows(max(len(motion.fix_time) // per, 1), float(grid.max(initial=0.0)))
        if len(at) > WINDOWS:
            tried = (_gain(motion, at, late) for late in (*grid, *-grid))
            best = max(
                best, *((r, late, sigmas) for sigmas, late, r in tried if sigmas > EARNED), best
            )
    ratio, late, sigmas = best
    if ratio > WORTH:
        who, what = ("velocity", "velocities") if late > 0.0 else ("position", "positions")
        yield Finding(
            "delay", who,
            f"the {what} fit {ratio:.3g} times better if they were measured about {abs(late):.3g} s before their "
            f"stamps ({sigmas:.2g} deviations)",
            "tell the reader of it", (f"latency.{who}", f"{abs(late):.3g}"),
        )  # fmt: skip


def _gain(motion: Motion, at: NDArray[np.intp], late: float) -> tuple[float, float, float]:
    """Deviations of chance by which windows fit better with velocities `late` s late; the delay; ratio of squares."""
    t, moved = motion.fix_time[at], np.diff(motion.fixes[at], axis=0)
    own, other = (
        np.linalg.norm(moved - np.diff(motion.integral(t + shift), axis=0), axis=1) ** 2
        for shift in (0.0, late)
    )
    cap = 9.0 * float(np.median(own))  # outliers are no delay
    own, other = np.minimum(own, cap), np.minimum(other, cap)
    better = own - other
    spread = float(better.std()) / math.sqrt(len(better))
    return (
        float(better.mean()) / spread if spread > 0.0 else 0.0,
        late,
        float(own.mean() / max(other.mean(), 1e-300)),
    )


# ---- heading


def heading_of(motion: Motion, heading: Array, time: Array) -> Iterator[Finding]:
    """Whether a heading goes with the course over ground.

    Args:
        motion: of the log.
        heading: (H,) rad, north to east.
        time: (H,) s.
    """
    at = motion.windows(4 * WINDOWS)
    if len(at) < FEWEST + 1:
        return
    moved, told = motion.moved(at)
    whole = motion.whole(at)
    agree = (moved * told).sum(axis=1) > 0.5 * np.linalg.norm(moved, axis=1) * np.linalg.norm(
        told, axis=1
    )
    middle = 0.5 * (motion.fix_time[at][1:] + motion.fix_time[at][:-1])[whole]
    if agree.sum() < FEWEST:
        return
    course = np.arctan2(told[:, 1], told[:, 0])[agree]
    weight = np.linalg.norm(told, axis=1)[agree]

    def fit(angles: Array) -> complex:
        z = np.interp(middle, time, np.cos(angles)) + 1j * np.interp(middle, time, np.sin(angles))
        z = z[agree] / np.maximum(np.abs(z[agree]), 1e-12)
        return complex((weight * z * np.exp(-1j * course)).sum() / weight.sum())

    own, mirrored, radians = fit(heading), fit(-heading), fit(np.degrees(heading))
    off = math.atan2(own.imag, own.real)
    if abs(radians) > ALIGNED and abs(own) < ALIGNED and np.ptp(heading) < math.radians(7.0):
        yield Finding("heading", "heading", "read as radians it goes with the track, as degrees it does not",
                      "say that it is in radians", ("units.heading", "rad"))  # fmt: skip
    elif abs(mirrored) > ALIGNED and abs(own) < abs(mirrored) - 0.2:
        yield Finding("heading", "heading", "it falls where the course turns to the right: it counts counterclockwise",
                      "turn its sign")  # fmt: skip
    elif abs(own) > ALIGNED and abs(off) > HEADING:
        yield Finding("heading", "heading", f"it is {math.degrees(off):+.3g}° from the course on average, the vehicle "
                      "would go sideways", "take the difference off, or check from where it counts")  # fmt: skip
