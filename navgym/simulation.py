"""Scenarios by name, of every problem; a scenario and a seed make a recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from navgym.core.checks import one_of
from navgym.problem import PROBLEMS, problem_of, problems


def scenarios() -> dict[str, str]:
    """Every scenario's name and one line on it."""
    return {p.full_name(s): s.summary for p in problems() for s in p.scenarios.values()}


def find_scenario(name: Any, /, **overrides: Any) -> Any:
    """The scenario called `name` ("auv/switch-D"), with some of its fields overridden.

    Raises ValueError, with the nearest name, for an unknown scenario or field.
    """
    if not isinstance(name, str):
        problem_of(name)  # says what is wrong with something else
        return name.override(**overrides)
    problem, _, own = name.partition("/")
    if problem not in PROBLEMS or own not in PROBLEMS[problem].scenarios:
        one_of("scenario", name, scenarios())  # loads every problem, for the nearest name
    return PROBLEMS[problem].scenarios[own].override(**overrides)


def simulate(scenario: Any, seed: int = 0, steps: int | None = None, **overrides: Any) -> Any:
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
    scenario: Any, seeds: Sequence[int], steps: int | None = None, **overrides: Any
) -> list[Any]:
    """One recording per seed; see `simulate`."""
    if steps is not None:
        overrides["steps"] = steps
    found = find_scenario(scenario, **overrides)
    return problem_of(found).simulate(found, seeds)
