"""Trainings that take a second."""

from navgym.agents.training.configuration import Configuration, Recipe

RECIPE = Recipe(steps=16, batch=32, epochs=2, learning_starts=200, gradient_steps=2, buffer=700)
TINY = {
    "overrides": {"steps": 100}, "pool": 6, "validation": 5, "lanes": 8, "decisions": 1500,
    "interval": 400, "recipe": RECIPE, "seed": 3,
}  # fmt: skip


def tiny(folder, **changes):
    """A configuration that trains into `folder` in about a second."""
    return Configuration(**TINY | {"out": folder} | changes)


def quiet(_line):
    """Takes progress and says nothing."""
