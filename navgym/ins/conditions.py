"""Conditions that training missions are drawn under, and those that no policy has met."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from navgym.core.checks import span, within
from navgym.core.draws import Range, log_uniform, pair
from navgym.ins.scenarios import InsScenario


@dataclass(frozen=True)
class InsRanges:
    """What is drawn for an INS mission. Each factor on its own is left as it is, or drawn."""

    chance: float = 0.5
    """probability, factor by factor and recording by recording, that it is drawn at all"""
    outage: Range = (30.0, 240.0)
    """s, length of each outage, drawn log-uniformly"""
    dwell: Range = (10.0, 240.0)
    """s: the shortest and the longest time in a regime, both drawn log-uniformly"""
    turn_rate: Range = (3.0, 15.0)
    """degrees per second, drawn log-uniformly"""
    leg: Range = (100.0, 600.0)
    """m: the shortest and the longest leg, both drawn log-uniformly"""
    wander: Range = (0.3, 2.0)
    """multiple of the deviations of surge and sway, drawn log-uniformly"""

    def __post_init__(self) -> None:
        within("chance", self.chance, 0.0, 1.0)
        for name in ("outage", "dwell", "turn_rate", "leg", "wander"):
            span(name, getattr(self, name), 0.0, above=True)


def draw(scenario: InsScenario, ranges: InsRanges, rng: np.random.Generator) -> InsScenario:
    """`scenario` under other conditions."""
    from dataclasses import replace

    p, factor = scenario.process, log_uniform(ranges.wander, rng)
    draws: dict[str, Any] = {
        "outages": tuple((begin, log_uniform(ranges.outage, rng)) for begin, _ in scenario.outages),
        "dwell": pair(ranges.dwell, rng),
        "turn_rate": log_uniform(ranges.turn_rate, rng),
        "legs": pair(ranges.leg, rng),
        "speed_process": replace(
            p, surge_deviation=factor * p.surge_deviation, sway_deviation=factor * p.sway_deviation
        ),
    }
    found = {name: value for name, value in draws.items() if rng.random() < ranges.chance}
    return scenario.override(**found)


def shifts(scenario: InsScenario) -> dict[str, dict[str, Any]]:
    """Conditions that no policy is trained on, as overrides of `scenario`, by name."""
    return {
        "tactical": {"grade": "tactical"},
        "steady": {"speed_process": "steady"},
        "turns 12°/s": {"turn_rate": 12.0},
        "short legs": {"legs": (scenario.legs[0] / 3.0, scenario.legs[1] / 3.0)},
    }
