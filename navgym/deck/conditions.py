"""Conditions at sea that training recordings are drawn under, and those that no policy has met."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from navgym.core.checks import span, within
from navgym.core.draws import Range, log_uniform, pair
from navgym.deck.scenarios import GUESS, DeckRegime, DeckScenario


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
        dataclasses.replace(
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
