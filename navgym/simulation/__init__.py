"""Simulators: a scenario and a seed make a recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from navgym._checks import one_of
from navgym.recording import Recording
from navgym.scenarios import CATALOGUE, AUVScenario


def scenarios() -> dict[str, str]:
    """Every scenario's name and one line on it."""
    return {f"auv/{s.name}": s.summary for s in CATALOGUE.values()}


def find_scenario(name: str | AUVScenario, /, **overrides: Any) -> AUVScenario:
    """The scenario called `name` ("auv/switch-D"), with some of its fields overridden.

    Raises ValueError, with the nearest name, for an unknown scenario or field.
    """
    if isinstance(name, AUVScenario):
        return name.override(**overrides)
    known = one_of("scenario", name, scenarios())
    return CATALOGUE[known.removeprefix("auv/")].override(**overrides)


def simulate(
    scenario: str | AUVScenario, seed: int = 0, steps: int | None = None, **overrides: Any
) -> Recording:
    """Simulate one recording.

    Args:
        scenario: a name of `navgym.scenarios()`, or a scenario.
        seed: which recording; take it from `navgym.seeds(split, count)`, so that recordings to
            tune on and to report on never meet. Small numbers belong to the training split.
        steps: number of samples; the scenario's own by default.
        overrides: any field of the scenario, for example `loss=0.5` or `measurement_scale=3.0`.

    Raises:
        ValueError: unknown scenario or field, a seed that no split owns.
    """
    return simulate_many(scenario, [seed], steps, **overrides)[0]


def simulate_many(
    scenario: str | AUVScenario, seeds: Sequence[int], steps: int | None = None, **overrides: Any
) -> list[Recording]:
    """One recording per seed; see `simulate`."""
    from navgym.simulation.auv import simulate as simulate_auv

    if steps is not None:
        overrides["steps"] = steps
    return simulate_auv(find_scenario(scenario, **overrides), seeds)
