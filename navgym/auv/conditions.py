"""Conditions of the sea that training recordings are drawn under, and those that no policy has met."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from navgym.auv.scenarios import AUVScenario, Loss, Regime
from navgym.core.checks import span, within
from navgym.core.draws import Range, log_uniform

QUICK: Range = (8.0, 25.0)  # samples: faster than an agent that decides every five can follow


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
    """samples: the shortest time in a regime, drawn log-uniformly; the longest is up to three times that"""
    quick: float = 0.0
    """probability that regimes follow one another within QUICK samples instead"""
    sway: Range = (0.02, 0.5)
    """m/s²: a sine that no model knows of, drawn log-uniformly"""
    sway_period: Range = (12.0, 120.0)
    """s: of that sine, drawn log-uniformly"""
    memory: Range = (0.2, 0.95)
    """correlation of noise from sample to sample, drawn uniformly"""
    regimes: tuple[int, int] = (1, 4)
    """how many regimes of any kind take the place of the scenario's"""

    def __post_init__(self) -> None:
        within("chance", self.chance, 0.0, 1.0)
        within("quick", self.quick, 0.0, 1.0)
        span("loss", self.loss, 0.0)
        within("loss", self.loss[1], 0.0, 1.0)
        for name in ("measurement_scale", "process_scale", "outlier_scale", "manoeuvre_scale"):
            span(name, getattr(self, name), 0.0, above=True)
        span("dwell", self.dwell, 1.0)
        for name in ("sway", "sway_period"):
            span(name, getattr(self, name), 0.0, above=True)
        span("memory", self.memory, 0.0)
        within("memory", self.memory[1], 0.0, 0.999)
        span("regimes", self.regimes, 1, whole=True)


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
        "dwell": _dwell(ranges.dwell, rng),
        "sway": (log_uniform(ranges.sway, rng), log_uniform(ranges.sway_period, rng)),
        "memory": float(rng.uniform(*ranges.memory)),
        "regimes": drawn_regimes(ranges, rng),
    }
    found = {name: value for name, value in draws.items() if rng.random() < ranges.chance}
    if rng.random() < ranges.quick:
        found["dwell"] = _dwell(QUICK, rng)
    return scenario.override(**found)


def _dwell(ends: Range, rng: np.random.Generator) -> tuple[int, int]:
    """The shortest and the longest time in a regime, samples."""
    least = log_uniform(ends, rng)
    return round(least), round(min(least * rng.uniform(1.0, 3.0), max(ends[1], least)))


def drawn_regimes(ranges: AUVRanges, rng: np.random.Generator) -> tuple[Regime, ...]:
    """Regimes of any kind: noise of sensors and of motion, outliers, each present or not."""
    count = int(rng.integers(ranges.regimes[0], ranges.regimes[1] + 1))
    found = []
    for i in range(count):
        moves, outliers = rng.random(2) < 0.5
        found.append(
            Regime(
                f"drawn {i + 1}",
                measurement_scale=log_uniform(ranges.measurement_scale, rng),
                process_scale=log_uniform(ranges.manoeuvre_scale, rng) if moves else 1.0,
                outlier_rate=float(rng.uniform(0.02, 0.3)) if outliers else 0.0,
            )
        )
    return tuple(found)
