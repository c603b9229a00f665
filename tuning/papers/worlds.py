"""Worlds that a filter may meet: the catalogue, its shifts, and what no scenario of it holds.

The last are made of recordings whose truth and noise are known: sensors that are worse than the model
says one at a time, noise that is correlated in time, a vehicle that sways.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navgym.auv.scenarios import CATALOGUE, SHIFTS, Loss, Regime
from navgym.auv.simulation import remembering
from navgym.core.checks import Array
from navgym.core.seeds import seeds
from navgym.simulation import simulate_many
from navgym.statespace.recording import Recording
from navgym.tuning.cases import Cases

POSITION, VELOCITY = [0, 2], [1, 3]  # columns of the measurements
PLAIN: Mapping[str, Any] = {"steps": 800, "loss": 0.0}  # nominal, as long as those that switch
BOTH = Regime("manoeuvre and outliers", process_scale=100.0, outlier_rate=0.2)
NOMINAL = Regime("nominal")

Change = Callable[[Recording, np.random.Generator], Recording]


@dataclass(frozen=True)
class World:
    """Recordings of one kind.

    Args:
        name: in tables.
        scenario: a name of the catalogue, without "auv/".
        overrides: of the scenario.
        change: what is done to each recording, with random numbers of its own; None for nothing.
    """

    name: str
    scenario: str
    overrides: Mapping[str, Any]
    change: Change | None = None

    def cases(self, split: str, count: int, steps: int | None = None, start: int = 0) -> Cases:
        """`count` recordings from the seeds of `split`; of `steps` samples, or as long as usual."""
        about = {"world": self.name, "split": split}
        chosen = dict(self.overrides) | ({} if steps is None else {"steps": steps})
        numbers = seeds(split, count, start)
        recordings: Sequence[Recording] = simulate_many(f"auv/{self.scenario}", numbers, **chosen)
        if self.change is not None:
            recordings = [
                self.change(r, np.random.default_rng([seed, 1]))
                for r, seed in zip(recordings, numbers, strict=True)
            ]
        return Cases.of(recordings, about)


def worlds() -> Iterator[World]:
    """Every world with a linear model, from the catalogue to what it lacks."""
    for name, scenario in CATALOGUE.items():
        if scenario.measured != "beacon":
            yield World(name, name, {})
    for base in ("switch-D", "switch-B"):
        for shift, overrides in SHIFTS.items():
            yield World(f"{base}, {shift}", base, overrides)
        yield World(f"{base}, Q x30", base, {"process_scale": 30.0})
        yield World(f"{base}, R /30", base, {"measurement_scale": 1.0 / 30.0})
    yield World("switch-D, R x300", "switch-D", {"measurement_scale": 300.0})
    plain, switch = ("nominal", PLAIN), ("switch-D", {"regimes": (NOMINAL, BOTH)})
    yield World("manoeuvre and outliers", *switch)
    yield World("bursts of losses", "nominal", {"steps": 800, "loss": Loss(0.5, length=20)})
    for factor in (0.2, 5.0, 20.0):
        yield World(f"velocity noise x{factor:g}", *plain, scaled(VELOCITY, factor))
        yield World(f"position noise x{factor:g}", *plain, scaled(POSITION, factor))
    for sensor, columns in (("velocity", VELOCITY), ("position", POSITION)):
        yield World(f"{sensor} noise AR(.9)", *plain, correlated(columns, 0.9))
    yield World("velocity outliers", *plain, spiked(VELOCITY))
    yield World("position outliers", *plain, spiked(POSITION))
    for amount, period in ((0.05, 60.0), (0.3, 20.0)):
        name = f"swaying {amount:g} m/s², {period:g} s"
        sway = {**PLAIN, "sway": (amount, period)}
        yield World(name, "nominal", sway)
        yield World(f"{name}, outliers", "heavy", sway)
    yield World("velocity .75 s late", *plain, late)


def scaled(columns: Sequence[int], factor: float) -> Change:
    """The noise of some columns is so many times larger."""

    def change(recording: Recording, rng: np.random.Generator) -> Recording:  # noqa: ARG001
        noise = _noise(recording)
        noise[:, columns] *= factor
        return replace(recording, measurements=recording.truth + noise)

    return change


def correlated(columns: Sequence[int], memory: float) -> Change:
    """The noise of some columns is as large as before, but each value holds `memory` of the last."""

    def change(recording: Recording, rng: np.random.Generator) -> Recording:  # noqa: ARG001
        noise = _noise(recording)
        noise[:, columns] = remembering(noise[:, columns], memory)
        return replace(recording, measurements=recording.truth + noise)

    return change


def spiked(columns: Sequence[int], rate: float = 0.1, factor: float = 10.0) -> Change:
    """A sample's noise in some columns is, at some `rate`, so many times larger."""

    def change(recording: Recording, rng: np.random.Generator) -> Recording:
        noise = _noise(recording)
        hit = rng.random(len(noise)) < rate
        for column in columns:
            noise[hit, column] *= factor
        return replace(recording, measurements=recording.truth + noise)

    return change


def late(recording: Recording, rng: np.random.Generator) -> Recording:  # noqa: ARG001
    """The velocity is that of .75 s before, between samples by their straight line."""
    time, noise, truth = recording.time, _noise(recording), np.asarray(recording.truth)
    measured = np.array(truth)
    for column in VELOCITY:
        measured[:, column] = np.interp(time - 0.75, time, truth[:, column])
    return replace(recording, measurements=measured + noise)


def _noise(recording: Recording) -> Array:
    """What the measurements are off by, (T, 4)."""
    return np.array(recording.measurements - recording.truth)
