"""Simpler ways of choosing parameters, through the interface of a policy: what learning must beat.

Each takes observations and returns the filter's whole physical parameter rows; called like a policy,
it returns the actions that put them in force. Filters that need no choice at all stand in
`whole_filters`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from navgym.agents.evaluation.regime_tables import rows_by_regime
from navgym.agents.evaluation.rollout import problem_in
from navgym.core.checks import Array
from navgym.core.parameters import Parameter
from navgym.envs.rules import HandRule
from navgym.problem import Problem
from navgym.tuning.comparison import Entry


class Baseline:
    """Observation in, parameters out.

    Args:
        environment: id of the environment whose observations it reads.
        reference: parameters in force where the baseline says nothing; the filter's defaults where
            that says nothing either.
        interval: filter steps per decision; the environment's own by default.
    """

    bound: ClassVar[bool] = False  # whether it needs the truth

    def __init__(
        self,
        environment: str,
        reference: Mapping[str, Any] | None = None,
        interval: int | None = None,
    ) -> None:
        own = problem_in(environment).environment
        kind = own.settings
        usual = kind.__dataclass_fields__["decision_interval"].default
        self.environment = environment
        self.settings: Mapping[str, Any] = {
            "decision_interval": usual if interval is None else interval,
            "action_parameters": self.steered(own.steered),
            "action": "absolute",
            "reference": dict(reference or {}),
        }
        scenario = kind.__dataclass_fields__["scenario"].default
        engine = own.engine(kind(scenario, **self.settings), 1)
        self.space, self.reference = engine.space, engine.reference
        self._row: Array = engine.space.array(engine.reference)[0]
        self.places = {name: i for i, name in enumerate(engine.observation_names)}

    @property
    def width(self) -> int:
        """Number of observations that it reads."""
        return len(self.places)

    def steered(self, usual: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the parameters that it sets; those that the environment says by default."""
        return usual

    def begin(self, lanes: int) -> None:
        """Forget what was seen: `lanes` recordings start now."""

    def choose(self, observation: NDArray[Any]) -> Mapping[str, Array]:
        """Values (N,) of the steered parameters; those in force by default."""
        raise NotImplementedError

    def parameters(self, observation: NDArray[Any]) -> Array:
        """The filter's whole physical rows (N, P) for observations (N, n)."""
        rows = np.repeat(self._row[None], len(observation), axis=0)
        for name, values in self.choose(observation).items():
            p = self.space[name]
            rows[:, self.space.index(name)] = np.clip(values, p.low, p.high)
        return rows

    def __call__(self, observation: NDArray[Any]) -> Array:
        """Actions (N, k) that put `parameters(observation)` in force."""
        rows, names = self.parameters(observation), self.settings["action_parameters"]
        columns = [_action(self.space[n], rows[:, self.space.index(n)]) for n in names]
        return np.stack(columns, axis=1)

    def signal(self, observation: NDArray[Any], name: str) -> Array:
        """Element `name` of the observations (N, n), as (N,)."""
        return np.asarray(observation[:, self.places[name]], dtype=np.float64)


def _action(p: Parameter, values: Array) -> Array:
    """Where physical `values` stand in the parameter's range, -1 to 1."""
    low, high = p.warp(p.low), p.warp(p.high)
    warped = np.array([p.warp(float(v)) for v in values])
    return 2.0 * (warped - low) / (high - low) - 1.0


class Fixed(Baseline):
    """The reference all along: the defaults, or parameters that are best fixed ones somewhere."""

    def choose(self, observation: NDArray[Any]) -> Mapping[str, Array]:  # noqa: ARG002
        """Nothing to choose."""
        return {}


class Random(Baseline):
    """Parameters drawn anew at each decision, uniformly on each one's own scale."""

    def begin(self, lanes: int) -> None:  # noqa: ARG002
        """The same draws again."""
        self._rng = np.random.default_rng(0)

    def choose(self, observation: NDArray[Any]) -> Mapping[str, Array]:
        """Draws, whatever was observed."""
        found = {}
        for name in self.settings["action_parameters"]:
            p = self.space[name]
            warped = self._rng.uniform(p.warp(p.low), p.warp(p.high), len(observation))
            found[name] = np.array([p.unwarp(w) for w in warped])
        return found


class ByHand(Baseline):
    """A rule by hand.

    Args:
        environment: id of the environment whose observations the rule reads.
        rule: which.
    """

    def __init__(self, environment: str, rule: HandRule) -> None:
        self.rule = rule
        super().__init__(environment)

    def steered(self, usual: tuple[str, ...]) -> tuple[str, ...]:  # noqa: ARG002
        """What the rule sets."""
        return self.rule.steered

    def begin(self, lanes: int) -> None:
        """Every recording starts with the parameters in force."""
        self.rule.begin(lanes, self.reference)

    def choose(self, observation: NDArray[Any]) -> Mapping[str, Array]:
        """What the rule says."""
        return self.rule.choose(lambda name: self.signal(observation, name))


class TrueRegime(Baseline):
    """The table by true regime (`navgym.agents.evaluation.regime_tables`): sees the truth, so it is a bound.

    Args:
        environment: id.
        scenario: whose table.
        regimes: per recording, labels (T,) of the true regime at each filter step.
        names: of the labels.
        reference: the parameters that do not follow the regime.
        interval: filter steps per decision; at 1 the table follows at once.
        start: filter steps that the environment takes before the first decision.
    """

    bound = True

    def __init__(
        self,
        environment: str,
        scenario: str,
        regimes: Sequence[NDArray[Any]],
        names: Sequence[str],
        reference: Mapping[str, Any] | None = None,
        interval: int = 1,
        start: int = 0,
    ) -> None:
        self._values = rows_by_regime(scenario, names)
        self._regimes = [np.asarray(each, dtype=np.int64) for each in regimes]
        self._start = start
        super().__init__(environment, reference, interval)
        self.begin(len(self._regimes))

    def steered(self, usual: tuple[str, ...]) -> tuple[str, ...]:  # noqa: ARG002
        """What the table holds."""
        return tuple(self._values)

    def begin(self, lanes: int) -> None:  # noqa: ARG002
        """Every recording starts again."""
        self._now = self._start

    def choose(self, observation: NDArray[Any]) -> Mapping[str, Array]:  # noqa: ARG002
        """The table's row for the regime that holds now, whatever was observed."""
        regimes = [each[min(self._now, len(each) - 1)] for each in self._regimes]
        self._now += self.settings["decision_interval"]
        return {name: np.asarray(values)[regimes] for name, values in self._values.items()}

    def schedules(self) -> list[dict[str, Any]]:
        """The same as a schedule per recording, one number per filter step, from the first on."""
        fixed = self.settings["reference"]
        return [
            dict(fixed) | {n: np.asarray(v)[each] for n, v in self._values.items()}
            for each in self._regimes
        ]


def hand_rule(environment: str) -> ByHand | None:
    """The hand rule that an environment's problem has, if it has one."""
    make = problem_in(environment).contest.hand_rule
    return None if make is None else ByHand(environment, make())


def whole_filters(problem: Problem, real: bool = False) -> list[Entry]:
    """Filters that need no choice of parameters, the plain one first, bounds last.

    Args:
        problem: whose.
        real: whether recordings are real: they lack the truth that bounds need, and some filters
            are shown on them only.
    """
    rivals = [
        r for r in problem.contest.rivals if not (r.bound or r.overrides if real else r.real_only)
    ]
    chosen = sorted(rivals, key=lambda r: r.bound)
    return [Entry(r.label, r.filter, r.parameters, bound=r.bound) for r in chosen]
