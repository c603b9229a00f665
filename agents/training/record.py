"""What a training remembers of itself."""

from __future__ import annotations

import importlib.util
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any

from numpy.typing import NDArray

import navgym
from navgym.agents.policies.policy import Policy

LIBRARIES = ("numpy", "numba", "torch", "stable-baselines3", "sb3-contrib")
NAME = "best"  # of the best policy among a checkpoint's arrays


@dataclass(frozen=True)
class Mark:
    """What a validation on the way found.

    Args:
        decisions: taken in training so far.
        seconds: of training so far, interruptions left out.
        scores: as JSON holds them: score, gains, half, diverged.
    """

    decisions: int
    seconds: float
    scores: Mapping[str, Any]

    @property
    def score(self) -> float:
        """What the best policy is chosen by."""
        return float(self.scores["score"])

    def as_dict(self) -> dict[str, Any]:
        """As JSON holds it."""
        return {"decisions": self.decisions, "seconds": self.seconds, "scores": dict(self.scores)}


@dataclass(frozen=True)
class Best:
    """The best policy so far.

    Args:
        mark: its validation.
        policy: None where the learner remembers, so that its policy is no `Policy`.
        arrays: then networks (torch's bytes), mean and variance of observations.
    """

    mark: Mark
    policy: Policy | None
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def pack(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Arrays and facts for a checkpoint; see `unpack`."""
        header: dict[str, Any] | None = None
        arrays = dict(self.arrays)
        if self.policy is not None:
            header, arrays = self.policy.parts()
        facts = {"mark": self.mark.as_dict(), "header": header}
        return {f"{NAME}.{name}": array for name, array in arrays.items()}, facts

    @classmethod
    def unpack(cls, arrays: Mapping[str, NDArray[Any]], facts: Mapping[str, Any]) -> Best:
        """Inverse of `pack`."""
        own = {k.removeprefix(f"{NAME}."): v for k, v in arrays.items() if k.startswith(f"{NAME}.")}
        mark, header = Mark(**facts["mark"]), facts["header"]
        if header is None:
            return cls(mark, None, own)
        return cls(mark, Policy.of_parts(header, own))


@dataclass(frozen=True)
class History:
    """All validations, the best policy, and what cloning found."""

    marks: tuple[Mark, ...] = ()
    best: Best | None = None
    cloned: Mapping[str, Any] | None = None


def versions() -> dict[str, str]:
    """Of what a result depends on."""
    found = {"navgym": navgym.__version__, "python": platform.python_version()}
    for name in LIBRARIES:
        if importlib.util.find_spec(name.replace("-", "_")) is not None:
            found[name] = metadata.version(name)
    return found
