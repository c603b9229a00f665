"""Conditions at sea that training recordings are drawn under, and those that no policy has met."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navgym.core.checks import Array, span, within
from navgym.core.draws import Range, log_uniform, pair
from navgym.deck.scenarios import GUESS, DeckRegime, DeckScenario, Triple

_SPANS = (
    "glitch_rate", "glitch_size", "slam_rate", "flexure", "mounting", "lever_error", "dwell",
)  # fmt: skip


@dataclass(frozen=True)
class DeckRanges:
    """What is drawn for a deck recording. Each factor on its own is left as it is, or drawn."""

    chance: float = 0.5
    """probability, factor by factor and recording by recording, that it is drawn at all"""
    glitch_rate: Range = (0.03, 0.4)
    """probability of a wrong value in glitch regimes, drawn log-uniformly"""
    glitch_size: Range = (0.3, 3.0)
    """multiple of the glitches' standard deviations, drawn log-uniformly"""
    gyro_only: float = 0.5
    """probability, where drawn, that the transmitted velocities have no glitches"""
    slam_rate: Range = (0.08, 3.0)
    """jumps per second in slam regimes, drawn log-uniformly"""
    both: float = 0.5
    """probability, where drawn, that slam regimes have the glitches of glitch regimes too"""
    flexure: Range = (0.5, 2.0)
    """multiples of the flexure's correlation time and size, axis by axis, drawn log-uniformly"""
    mounting: Range = (10.0, 1800.0)
    """arcmin: static deformation about each axis, either way, drawn log-uniformly"""
    lever_error: Range = (0.01, 0.1)
    """m, drawn log-uniformly"""
    dwell: Range = (12.0, 150.0)
    """s: the shortest and the longest time in a regime, both drawn log-uniformly"""

    def __post_init__(self) -> None:
        for name in ("chance", "gyro_only", "both"):
            within(name, getattr(self, name), 0.0, 1.0)
        for name in _SPANS:
            span(name, getattr(self, name), 0.0, above=True)
        within("glitch_rate", self.glitch_rate[1], 0.0, 1.0)


def draw(scenario: DeckScenario, ranges: DeckRanges, rng: np.random.Generator) -> DeckScenario:
    """`scenario` under other conditions."""
    size = log_uniform(ranges.glitch_size, rng)
    quiet = bool(rng.random() < ranges.gyro_only)
    glitch_rate, slam_rate = (log_uniform(r, rng) for r in (ranges.glitch_rate, ranges.slam_rate))
    lever_error, dwell = log_uniform(ranges.lever_error, rng), pair(ranges.dwell, rng)
    chosen = rng.random(6) < ranges.chance
    regimes = []
    for regime in scenario.regimes:
        changes: dict[str, Any] = {}
        if regime.glitch_rate > 0.0:
            changes |= _glitches(regime, size, quiet, glitch_rate, chosen)
        if regime.slam_rate > 0.0 and chosen[3]:
            changes["slam_rate"] = slam_rate
        regimes.append(replace(regime, **changes))
    found: dict[str, Any] = {}
    if chosen[4]:
        found["lever_error"] = lever_error
    if chosen[5]:
        found["dwell"] = dwell
    return _elsewhere(scenario.override(regimes=tuple(regimes), **found), scenario, ranges, rng)


def _elsewhere(
    drawn: DeckScenario, scenario: DeckScenario, ranges: DeckRanges, rng: np.random.Generator
) -> DeckScenario:
    """`drawn` with events at once, another flexure than is believed, and IMUs turned."""
    both = bool(rng.random() < ranges.both)
    pace, size = (_triple(ranges.flexure, rng) for _ in range(2))
    static = _triple(ranges.mounting, rng) * np.where(rng.random(3) < 0.5, -1.0, 1.0)
    chosen = rng.random(4) < ranges.chance
    regimes = drawn.regimes
    if chosen[0] and both:
        regimes = _at_once(regimes)
    if chosen[1]:
        regimes = tuple(replace(r, tau=_times(r.tau, pace)) for r in regimes)
    if chosen[2]:
        regimes = tuple(replace(r, sigma=_times(r.sigma, size)) for r in regimes)
    believed = scenario.believed
    if believed is None and chosen[1:3].any():
        believed = scenario.regimes[0]
    turned = _times(static, np.ones(3)) if chosen[3] else drawn.static
    return drawn.override(regimes=regimes, believed=believed, static=turned)


def _triple(ends: Range, rng: np.random.Generator) -> Array:
    """Three log-uniform numbers."""
    return np.array([log_uniform(ends, rng) for _ in range(3)])


def _times(values: Any, factors: Array) -> Triple:
    x, y, z = (np.asarray(values) * factors).tolist()
    return x, y, z


def _at_once(regimes: tuple[DeckRegime, ...]) -> tuple[DeckRegime, ...]:
    """The regimes, those with slams now with the glitches of the first that has some."""
    names = ("glitch_rate", "glitch_velocity", "glitch_rate_size")
    first = next((r for r in regimes if r.glitch_rate > 0.0), None)
    glitches = {} if first is None else {name: getattr(first, name) for name in names}
    return tuple(replace(r, **glitches) if r.slam_rate > 0.0 else r for r in regimes)


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


def shifts(scenario: DeckScenario) -> dict[str, dict[str, Any]]:
    """Conditions that no policy is trained on, as overrides of `scenario`, by name."""
    return {
        "15 s segments": {"dwell": (15.0, 15.0)},
        "mild sea": mild(scenario),
        "flexure guessed": {"believed": GUESS},
    }


def mild(scenario: DeckScenario) -> dict[str, Any]:
    """Half the sway, half the slams' and the glitches' size, and θ half as large in every regime.

    The filter goes on believing what it believed.
    """
    regimes = tuple(
        replace(
            r,
            sigma=(r.sigma[0] / 2.0, r.sigma[1] / 2.0, r.sigma[2] / 2.0),
            slam_size=r.slam_size / 2.0,
            glitch_velocity=r.glitch_velocity / 2.0,
            glitch_rate_size=r.glitch_rate_size / 2.0,
        )
        for r in scenario.regimes
    )
    believed = scenario.regimes[0] if scenario.believed is None else scenario.believed
    sway = tuple(a / 2.0 for a in scenario.sway)
    return {"regimes": regimes, "sway": sway, "believed": believed}
