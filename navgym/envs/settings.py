"""The arguments that every environment has, and what must hold of them."""

from __future__ import annotations

import dataclasses
import inspect
import os
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from navgym.core.checks import one_of, positive_int, within
from navgym.core.parameters import ParameterSpace
from navgym.core.seeds import seeds


@dataclass(frozen=True)
class LaneSettings:
    """What an environment is made of: its arguments, whose texts its manual takes from here.

    Args:
        scenario: name (see `navgym.scenarios()`), scenario, or a list to draw from at each reset.
        overrides: fields of the scenario to change.
        split: seeds to draw recordings from: "train", "validation" or "test".
        pool: simulate this many recordings once and draw from them; None makes a new one at each
            reset.
        recordings: replay these instead of simulating.
        decision_interval: filter steps per decision.
        action_parameters: what the agent sets; the rest stays at the reference's.
        action: "absolute" or "residual".
        reference: parameters of the reference filter; by default the scenario's best fixed ones,
            or the filter's defaults for recordings of your own. With several scenarios each has
            its own, and with `recordings` a list gives each its own; residual actions start from
            those of the recording that is played.
        reward: what is paid, see above.
        reward_clip: bound on the reward.
        jitter: subtracted from the reward, after its clip, per mean |Δ| of the agent's parameters from
            one decision to the next, each on its own scale (mostly its logarithm).
        context: "hidden", or "regime": observations end with the true regime, one-hot. For analysis
            only: nobody knows it at sea, and live filters refuse a policy that reads it.
    """

    scenario: Any
    overrides: Mapping[str, Any] | None = None
    split: str = "train"
    pool: int | None = None
    recordings: Any = None
    decision_interval: int = 1
    action_parameters: str | Sequence[str] = ()
    action: str = "absolute"
    reference: Mapping[str, Any] | str | os.PathLike[str] | Sequence[Mapping[str, Any]] | None = (
        None
    )
    reward: str = ""
    reward_clip: float = 20.0
    jitter: float = 0.0
    context: str = "hidden"

    FILTER: ClassVar[str]  # whose parameters the agent sets
    SPACE: ClassVar[ParameterSpace]
    REWARDS: ClassVar[tuple[str, ...]]
    RECORDING: ClassVar[type]
    SCENARIO: ClassVar[type]
    # fields that decide what an agent sees and sets; the others are about rewards and about where
    # recordings come from
    SEEN: ClassVar[tuple[str, ...]] = (
        "decision_interval", "action_parameters", "action", "reference", "context",
    )  # fmt: skip
    BLIND: ClassVar[str] = "likelihood"  # the reward that asks for no truth

    def __post_init__(self) -> None:
        positive_int("decision_interval", self.decision_interval)
        one_of("action", self.action, ("absolute", "residual"))
        one_of("reward", self.reward, self.REWARDS)
        one_of("context", self.context, ("hidden", "regime"))
        within("jitter", self.jitter, 0.0)
        seeds(self.split, 0)
        if not self.reward_clip > 0.0:
            raise ValueError(f"reward_clip must be positive, got {self.reward_clip}.")
        if self.pool is not None:
            positive_int("pool", self.pool)
        given = self.action_parameters
        names = (given,) if isinstance(given, str) else tuple(given)
        space = self.SPACE.subset(names)
        if not names or len(set(names)) != len(names):
            raise ValueError(f"action_parameters must be one or more distinct names, got {names}.")
        if isinstance(self.recordings, self.RECORDING):
            object.__setattr__(self, "recordings", (self.recordings,))
        for p in space:
            if p.at_start:
                raise ValueError(f"{p.name} acts at the start only: set it through `reference=`.")
        object.__setattr__(self, "action_parameters", names)


# of the environment, and no setting: words that its manual adds
FACE_ARGUMENTS = {
    "recording": "the same as `recordings` for a single one.",
    "render_mode": '"rgb_array", "human" or None.',
}


def signature(kind: type[LaneSettings]) -> inspect.Signature:
    """How an environment is called: every setting by name, and what its face adds."""
    own = [
        inspect.Parameter(f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default)
        for f in dataclasses.fields(kind)
    ]
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None)
        for name in FACE_ARGUMENTS
    ]
    return inspect.Signature([*own, *added])


def argument_texts(kind: type[LaneSettings]) -> dict[str, str]:
    """What each argument is for, by name: a class's own words before those that it inherits."""
    found: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        _, _, part = (each.__dict__.get("__doc__") or "").partition("Args:\n")
        for entry in re.findall(r"^ {8}(\w+): (.*(?:\n {12}.*)*)", part, re.MULTILINE):
            found[entry[0]] = re.sub(r"\s+", " ", entry[1]).strip()
    return {f.name: found[f.name] for f in dataclasses.fields(kind)} | FACE_ARGUMENTS


def argument_manual(kind: type[LaneSettings]) -> str:
    """The arguments as a section of a docstring, indented as in a class."""
    lines = ["Args:"]
    for name, text in argument_texts(kind).items():
        lines += textwrap.wrap(
            f"{name}: {text}", 100, initial_indent=" " * 8, subsequent_indent=" " * 12,
            break_on_hyphens=False, break_long_words=False,
        )  # fmt: skip
    return "\n".join(lines)
