"""Simulators: a scenario and a seed make a recording."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, overload

from navgym._checks import one_of
from navgym.dual_imu import DualIMURecording
from navgym.recording import Recording
from navgym.scenarios import CATALOGUE, DECK_CATALOGUE, AUVScenario, DeckScenario

Scenario = AUVScenario | DeckScenario


@dataclass(frozen=True)
class World:
    """A kind of scenario: its catalogue, its class, and the module that simulates it."""

    catalogue: Mapping[str, Any]
    scenario: type
    module: str


# by the prefix of their scenarios' names
WORLDS: Mapping[str, World] = MappingProxyType(
    {
        "auv": World(CATALOGUE, AUVScenario, "navgym.simulation.auv"),
        "deck": World(DECK_CATALOGUE, DeckScenario, "navgym.simulation.deck"),
    }
)


def scenarios() -> dict[str, str]:
    """Every scenario's name and one line on it."""
    return {
        f"{prefix}/{s.name}": s.summary
        for prefix, world in WORLDS.items()
        for s in world.catalogue.values()
    }


def find_scenario(name: str | Scenario, /, **overrides: Any) -> Any:
    """The scenario called `name` ("auv/switch-D"), with some of its fields overridden.

    Raises ValueError, with the nearest name, for an unknown scenario or field.
    """
    if not isinstance(name, str):
        return name.override(**overrides)
    prefix, _, own = one_of("scenario", name, scenarios()).partition("/")
    return WORLDS[prefix].catalogue[own].override(**overrides)


@overload
def simulate(
    scenario: AUVScenario, seed: int = ..., steps: int | None = ..., **overrides: Any
) -> Recording: ...
@overload
def simulate(
    scenario: DeckScenario, seed: int = ..., steps: int | None = ..., **overrides: Any
) -> DualIMURecording: ...
@overload
def simulate(scenario: str, seed: int = ..., steps: int | None = ..., **overrides: Any) -> Any: ...


def simulate(
    scenario: str | Scenario, seed: int = 0, steps: int | None = None, **overrides: Any
) -> Any:
    """Simulate one recording: a `Recording`, or a `DualIMURecording` for "deck/..." scenarios.

    Args:
        scenario: a name of `navgym.scenarios()`, or a scenario.
        seed: which recording; take it from `navgym.seeds(split, count)`, so that recordings to
            tune on and to report on never meet. Small numbers belong to the training split.
        steps: number of samples (AUV scenarios); the scenario's own by default.
        overrides: any field of the scenario, for example `loss=0.5` or `duration=120.0`.

    Raises:
        ValueError: unknown scenario or field, a seed that no split owns.
    """
    return simulate_many(scenario, [seed], steps, **overrides)[0]


def simulate_many(
    scenario: str | Scenario, seeds: Sequence[int], steps: int | None = None, **overrides: Any
) -> list[Any]:
    """One recording per seed; see `simulate`."""
    if steps is not None:
        overrides["steps"] = steps
    found = find_scenario(scenario, **overrides)
    world = next(w for w in WORLDS.values() if isinstance(found, w.scenario))
    simulated: list[Any] = importlib.import_module(world.module).simulate(found, seeds)
    return simulated
