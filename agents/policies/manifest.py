"""What a trained policy is for: written beside its weights, read before they are used."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from navgym.core.parameters import ParameterSpace
from navgym.core.storage import writable
from navgym.envs.base import LaneEngine
from navgym.envs.settings import LaneSettings
from navgym.estimation import parameter_space
from navgym.problem import environments, problem_of

ANOTHER = "reference_since"  # of a manifest's training: where a reference comes from that took its own's place


@dataclass(frozen=True)
class Manifest:
    """What a policy reads and sets, and where it comes from. JSON can hold all of it.

    Args:
        environment: id of the environment, with its version.
        settings: arguments of that environment, as `gymnasium.make` takes them.
        filter: the filter whose parameters are set.
        observation_names: what each element of an observation is.
        space: `ParameterSpace.fingerprint` of the filter's whole space.
        reference: best fixed parameters, physical: what residual actions start from, and what a
            filter falls back to.
        training: command, configuration, seeds, versions, scores on validation seeds.

    Raises:
        ValueError: for what JSON cannot hold, an unknown filter, or parameters that it lacks.
    """

    environment: str
    settings: Mapping[str, Any]
    filter: str
    observation_names: tuple[str, ...]
    space: str
    reference: Mapping[str, Any]
    training: Mapping[str, Any]

    def __post_init__(self) -> None:
        object.__setattr__(self, "observation_names", tuple(self.observation_names))
        for name in ("settings", "reference", "training"):
            object.__setattr__(self, name, writable(getattr(self, name)))
        for name in ("scenario", "action_parameters"):
            if name not in self.settings:
                raise ValueError(f"settings lack {name!r}: the file is damaged, save it again.")
        if self.space != self.whole_space.fingerprint:
            raise ValueError(
                f"the policy was made for parameter space {self.space} of {self.filter}, and this "
                f"navgym has {self.whole_space.fingerprint}: names, ranges or scales have changed. "
                "Train it again, or install the navgym that made it."
            )
        self.whole_space.array(self.reference)
        self.whole_space.subset(self.action_parameters)

    @classmethod
    def of(cls, environment: str, engine: LaneEngine, training: Mapping[str, Any]) -> Manifest:
        """The manifest of a policy for `engine`, which `environment` (an id) runs.

        Scenarios are written by name: of one that the catalogue lacks, only the name survives.
        """
        given = {
            f.name: getattr(engine.settings, f.name)
            for f in dataclasses.fields(engine.settings)
            if f.name not in ("scenario", "split", "pool", "recordings", "reference")
        }
        given["overrides"] = None if given["overrides"] is None else dict(given["overrides"])
        return cls(
            environment=environment,
            settings=given | {"scenario": _names(engine.settings), "reference": engine.reference},
            filter=engine.settings.FILTER,
            observation_names=engine.observation_names,
            space=engine.space.fingerprint,
            reference=engine.reference,
            training=training,
        )

    @property
    def action_parameters(self) -> tuple[str, ...]:
        """Names of the parameters that the policy sets."""
        return tuple(self.settings["action_parameters"])

    @property
    def whole_space(self) -> ParameterSpace:
        """The filter's whole space, in this navgym."""
        known = self.environment in environments()  # one of another version may not be
        return parameter_space(self.filter, problem_of(self.environment) if known else None)

    def check(self, environment: str, observation_names: Sequence[str], space: str) -> None:
        """Raise ValueError, naming both sides, unless the policy was made for just this.

        Args:
            environment: id with version.
            observation_names: of the environment, as it is set up.
            space: fingerprint of its filter's whole parameter space.
        """
        if environment != self.environment:
            raise ValueError(
                f"the policy was trained in {self.environment}, not in {environment}: use a policy "
                "of that environment and version, or train one."
            )
        if space != self.space:
            raise ValueError(
                f"the policy sets parameters of space {self.space}, and {environment} has space "
                f"{space}: names, ranges or scales differ. Train it again."
            )
        if tuple(observation_names) != self.observation_names:
            raise ValueError(
                f"the policy reads {len(self.observation_names)} observations, and the environment "
                f"gives {len(observation_names)}; they differ in "
                f"{_difference(self.observation_names, observation_names)}: make the environment "
                "with the policy's own settings (`policy.manifest.settings`)."
            )


def _names(settings: LaneSettings) -> list[str]:
    """Scenarios of an environment by name."""
    given = settings.scenario
    several: list[Any] = [given] if isinstance(given, (str, settings.SCENARIO)) else list(given)
    return [s if isinstance(s, str) else problem_of(s).full_name(s) for s in several]


def _difference(own: Sequence[str], other: Sequence[str]) -> str:
    changed = [
        line for line in difflib.ndiff(list(own), list(other)) if line.startswith(("+ ", "- "))
    ]
    return ", ".join(line[2:] for line in changed[:4]) + (" ..." if len(changed) > 4 else "")
