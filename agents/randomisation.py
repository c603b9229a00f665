"""Conditions drawn anew for each training recording, so that a policy meets more than one sea."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from navgym._checks import span, within
from navgym.scenarios import AUVScenario, DeckRegime, DeckScenario
from navgym.scenarios.auv import Loss

STREAM = 0xC0  # first word of the seed sequences: no simulator's

Range = tuple[float, float]


@dataclass(frozen=True)
class AUVRanges:
    """What is drawn for an AUV recording. Each factor on its own is left as it is, or drawn."""

    chance: float = 0.5
    """probability, factor by factor and recording by recording, that it is drawn at all"""
    loss: Range = (0.0, 0.8)
    """rate of independent losses, drawn uniformly"""
    measurement_scale: Range = (0.2, 20.0)
    """multiple of every regime's R, drawn log-uniformly"""
    process_scale: Range = (0.4, 6.0)
    """multiple of every regime's Q, drawn log-uniformly"""
    outlier_scale: Range = (30.0, 400.0)
    """multiple of R in an outlier, drawn log-uniformly"""
    manoeuvre_scale: Range = (40.0, 600.0)
    """multiple of Q in a manoeuvre, drawn log-uniformly"""
    dwell: Range = (15.0, 350.0)
    """samples: the shortest and the longest time in a regime, both drawn log-uniformly"""

    def __post_init__(self) -> None:
        within("chance", self.chance, 0.0, 1.0)
        span("loss", self.loss, 0.0)
        within("loss", self.loss[1], 0.0, 1.0)
        for name in ("measurement_scale", "process_scale", "outlier_scale", "manoeuvre_scale"):
            span(name, getattr(self, name), 0.0, above=True)
        span("dwell", self.dwell, 1.0)


@dataclass(frozen=True)
class DeckRanges:
    """What is drawn for a deck recording. Each factor on its own is left as it is, or drawn."""

    chance: float = 0.5
    """probability, factor by factor and recording by recording, that it is drawn at all"""
    glitch_rate: Range = (0.03, 0.2)
    """probability of a wrong value in glitch regimes, drawn log-uniformly"""
    glitch_size: Range = (0.3, 3.0)
    """multiple of the glitches' standard deviations, drawn log-uniformly"""
    gyro_only: float = 0.5
    """probability, where drawn, that the transmitted velocities have no glitches"""
    slam_rate: Range = (0.08, 0.5)
    """jumps per second in slam regimes, drawn log-uniformly"""
    lever_error: Range = (0.01, 0.1)
    """m, drawn log-uniformly"""
    dwell: Range = (12.0, 150.0)
    """s: the shortest and the longest time in a regime, both drawn log-uniformly"""

    def __post_init__(self) -> None:
        for name in ("chance", "gyro_only"):
            within(name, getattr(self, name), 0.0, 1.0)
        for name in ("glitch_rate", "glitch_size", "slam_rate", "lever_error", "dwell"):
            span(name, getattr(self, name), 0.0, above=True)
        within("glitch_rate", self.glitch_rate[1], 0.0, 1.0)


Ranges = AUVRanges | DeckRanges


def drawn(scenario: Any, ranges: Ranges, seed: int) -> Any:
    """`scenario` under conditions that depend on `seed` alone.

    Raises TypeError for ranges of the other kind of scenario.
    """
    rng = np.random.default_rng(np.random.SeedSequence([STREAM, seed]))
    if isinstance(scenario, AUVScenario) and isinstance(ranges, AUVRanges):
        return _auv(scenario, ranges, rng)
    if isinstance(scenario, DeckScenario) and isinstance(ranges, DeckRanges):
        return _deck(scenario, ranges, rng)
    raise TypeError(
        f"{type(ranges).__name__} are no conditions of {scenario.name}: of another kind."
    )


def _auv(scenario: AUVScenario, ranges: AUVRanges, rng: np.random.Generator) -> AUVScenario:
    loss = float(rng.uniform(*ranges.loss))
    draws: dict[str, Any] = {
        "loss": Loss(loss, length=None),
        "measurement_scale": scenario.measurement_scale
        * _log_uniform(ranges.measurement_scale, rng),
        "process_scale": scenario.process_scale * _log_uniform(ranges.process_scale, rng),
        "outlier_scale": _log_uniform(ranges.outlier_scale, rng),
        "manoeuvre_scale": _log_uniform(ranges.manoeuvre_scale, rng),
        "dwell": tuple(round(d) for d in _pair(ranges.dwell, rng)),
    }
    found = {name: value for name, value in draws.items() if rng.random() < ranges.chance}
    return scenario.override(**found)


def _deck(scenario: DeckScenario, ranges: DeckRanges, rng: np.random.Generator) -> DeckScenario:
    size = _log_uniform(ranges.glitch_size, rng)
    quiet = bool(rng.random() < ranges.gyro_only)
    glitch_rate, slam_rate = (_log_uniform(r, rng) for r in (ranges.glitch_rate, ranges.slam_rate))
    lever_error, dwell = _log_uniform(ranges.lever_error, rng), _pair(ranges.dwell, rng)
    chosen = rng.random(6) < ranges.chance
    regimes = []
    for regime in scenario.regimes:
        changes: dict[str, Any] = {}
        if regime.glitch_rate > 0.0:
            changes |= _glitches(regime, size, quiet, glitch_rate, chosen)
        if regime.slam_rate > 0.0 and chosen[3]:
            changes["slam_rate"] = slam_rate
        regimes.append(dataclasses.replace(regime, **changes))
    found: dict[str, Any] = {"regimes": tuple(regimes)}
    if chosen[4]:
        found["lever_error"] = lever_error
    if chosen[5]:
        found["dwell"] = dwell
    return scenario.override(**found)


def _glitches(
    regime: DeckRegime, size: float, quiet: bool, rate: float, chosen: Any
) -> dict[str, float]:
    changes: dict[str, float] = {}
    if chosen[0]:
        changes["glitch_rate"] = rate
    if chosen[1]:
        changes["glitch_velocity"] = regime.glitch_velocity * size
        changes["glitch_rate_size"] = regime.glitch_rate_size * size
    if chosen[2] and quiet:
        changes["glitch_velocity"] = 0.0
    return changes


def _log_uniform(ends: Range, rng: np.random.Generator) -> float:
    return math.exp(rng.uniform(math.log(ends[0]), math.log(ends[1])))


def _pair(ends: Range, rng: np.random.Generator) -> tuple[float, float]:
    """Two log-uniform numbers in order."""
    first, second = _log_uniform(ends, rng), _log_uniform(ends, rng)
    return min(first, second), max(first, second)
