"""The agent's own hyper-parameters as something that Optuna can tune."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from navgym.agents.training.configuration import Configuration, Recipe, comparable
from navgym.agents.training.run import train
from navgym.core.checks import positive_int
from navgym.core.parameters import Parameter, ParameterSpace
from navgym.tuning.study.run import Outcome, search

_RANGES = (
    Parameter("learning_rate", "α", "1", 1e-4, 5e-3, "log", 1e-3),
    Parameter("gamma", "γ", "1", 0.5, 0.995, "log-complement", 0.9),
    Parameter("gae_lambda", "λ", "1", 0.5, 0.995, "log-complement", 0.9),
    Parameter("clip_range", "ε", "1", 0.05, 0.5, "log", 0.2),
    Parameter("epochs", "K", "1", 2, 20, "linear", 10, integer=True),
    Parameter("log_std_init", "log σ", "1", -2.0, 0.5, "linear", -0.7),
    Parameter("units", "h", "1", 16, 256, "log", 64, integer=True),
)


@dataclass(frozen=True)
class ShortTraining:
    """Score that a recipe reaches in a short training, on validation recordings.

    Args:
        config: everything but the recipe.
        decisions: of each training.

    The space's defaults are the configuration's own recipe, so that a study begins there. One
    training seed is used throughout: what a study finds is worth a look with others.
    """

    config: Configuration
    decisions: int

    def __post_init__(self) -> None:
        positive_int("decisions", self.decisions)
        if self.config.algorithm != "ppo":
            raise ValueError(
                f"the search knows the recipe of ppo, got algorithm={self.config.algorithm!r}."
            )

    @property
    def space(self) -> ParameterSpace:
        """The free parameters, which start at the configuration's own."""
        own = vars(self.config.recipe) | {"units": (self.config.recipe.hidden or (64,))[0]}
        clipped = [replace(p, default=min(max(own[p.name], p.low), p.high)) for p in _RANGES]
        return ParameterSpace(tuple(clipped))

    @property
    def about(self) -> dict[str, Any]:
        """Everything but the recipe."""
        return {
            "training": comparable(self.config),
            "decisions": self.decisions,
            "metric": "1 less the best score on validation recordings",
        }

    def recipe(self, values: Mapping[str, Any]) -> Recipe:
        """The configuration's recipe with `values` of the free parameters."""
        chosen = dict(values)
        units = int(chosen.pop("units"))
        own = self.config.recipe
        hidden = tuple(units for _ in own.hidden)
        final = own.final_learning_rate * chosen["learning_rate"] / own.learning_rate
        return replace(own, hidden=hidden, final_learning_rate=final, **chosen)

    def __call__(self, values: Mapping[str, Any]) -> float:
        """1 less the score of a training with `values`."""
        with tempfile.TemporaryDirectory() as folder:
            config = replace(
                self.config, recipe=self.recipe(values), decisions=self.decisions,
                interval=self.decisions, out=Path(folder),
            )  # fmt: skip
            return 1.0 - train(config, report=lambda _: None).best.score


def tune(config: Configuration, trials: int, share: float = 0.2) -> tuple[Outcome, Configuration]:
    """Search the recipe with `trials` trainings of a share of the configuration's decisions.

    Returns what was found, and the configuration with the best recipe. The study is kept in the
    configuration's folder: the same call goes on with it.
    """
    goal = ShortTraining(config, max(1, round(share * config.decisions)))
    config.folder.mkdir(parents=True, exist_ok=True)
    found = search(goal, trials, config.seed, config.folder / "recipe.log", label="recipe")
    return found, replace(config, recipe=goal.recipe(found.best.values))
