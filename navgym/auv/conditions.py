"""Conditions of the sea that training recordings are drawn under, and those that no policy has met."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from navgym.auv.scenarios import AUVScenario, Loss
from navgym.core.checks import span, within
from navgym.core.draws import Range, log_uniform, pair


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


def draw(scenario: AUVScenario, ranges: AUVRanges, rng: np.random.Generator) -> AUVScenario:
    """`scenario` under other conditions."""
    loss = float(rng.uniform(*ranges.loss))
    draws: dict[str, Any] = {
        "loss": Loss(loss, length=None),
        "measurement_scale": scenario.measurement_scale
        * log_uniform(ranges.measurement_scale, rng),
        "process_scale": scenario.process_scale * log_uniform(ranges.process_scale, rng),
        "outlier_scale": log_uniform(ranges.outlier_scale, rng),
        "manoeuvre_scale": log_uniform(ranges.manoeuvre_scale, rng),
        "dwell": tuple(round(d) for d in pair(ranges.dwell, rng)),
    }
    found = {name: value for name, value in draws.items() if rng.random() < ranges.chance}
    return scenario.override(**found)
