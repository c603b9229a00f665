"""Simpler ways of choosing parameters, through the interface of a policy: what learning must beat.

Each takes observations and returns the filter's whole physical parameter rows; called like a policy,
it returns the actions that put them in force. Filters that need no choice at all stand in
`whole_filters`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from agents.regime_tables import TABLES, rows_by_regime
from agents.rollout import AUV, DECK, ENGINES
from navgym._checks import Array, one_of
from navgym.parameters import Parameter
from tuning.comparison import Entry

# what a baseline steers where nothing else is said
STEERED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {AUV: ("process_noise_scale", "forgetting"), DECK: ("kernel_width",)}
)


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
        make, kind = ENGINES[one_of("environment", environment, ENGINES)]
        usual = kind.__dataclass_fields__["decision_interval"].default
        self.environment = environment
        self.settings: Mapping[str, Any] = {
            "decision_interval": usual if interval is None else interval,
            "action_parameters": self.steered(environment),
            "action": "absolute",
            "reference": dict(reference or {}),
        }
        engine = make(kind(kind.__dataclass_fields__["scenario"].default, **self.settings), 1)
        self.space = engine.space
        self._row: Array = engine.space.array(engine.reference)[0]
        self.places = {name: i for i, name in enumerate(engine.observation_names)}

    @property
    def width(self) -> int:
        """Number of observations that it reads."""
        return len(self.places)

    def steered(self, environment: str) -> tuple[str, ...]:
        """Names of the parameters that it sets."""
        return STEERED[environment]

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


class CovarianceMatching(Baseline):
    """Match Q to the innovations (Mehra 1972): the AUV's hand rule.

    A nominal Kalman filter beside the controlled one has innovations of covariance C = H P⁻ Hᵀ + R.
    The third difference of the measurements shows R alone. Where C exceeds R, the motion is not the
    model's, so Q grows with their ratio: q = 10 max(1, Ĉ/R̂), both as means over some five samples.
    R is left to the variational filter. The factor 10 was chosen on training recordings: with the
    model's own Q the variational filter blames R for a manoeuvre and shuts its gain.
    """

    FLOOR = 10.0

    def __init__(self, environment: str = AUV) -> None:
        super().__init__(environment)

    def steered(self, environment: str) -> tuple[str, ...]:  # noqa: ARG002
        """Q only."""
        return ("process_noise_scale",)

    def choose(self, observation: NDArray[Any]) -> Mapping[str, Array]:
        """q from the innovations' power over the noise's."""
        innovations = self.signal(observation, "frozen.power_position.0.8")
        noise = self.signal(observation, "curvature.0.8")
        ratio = np.exp(2.0 * (innovations - noise))  # both are half logarithms
        return {"process_noise_scale": self.FLOOR * np.maximum(ratio, 1.0)}


class ResidualSign(Baseline):
    """Read the sign of what follows a large gyro residual: the deck's hand rule (SCIENCE B3).

    If the next residual points the other way, a glitch got into the estimate: the kernel narrows to
    `NARROW` at once. If it points the same way, a slam was rejected: the kernel widens by half, once per
    decision. Without alarms the width drifts back to `QUIET`. Constants were chosen on training recordings.
    """

    NARROW, WIDE, QUIET = 3.5, 20.0, 15.0
    NEGATIVE, POSITIVE = -0.05, 0.12  # mean ratio of successive residuals that counts
    ALARMS = 0.01  # share of large residuals from which on anything is done
    BACK = 0.1  # share of the way back, per decision

    def __init__(self, environment: str = DECK) -> None:
        super().__init__(environment)

    def begin(self, lanes: int) -> None:
        """Every recording starts with the width in force."""
        self._log_width = np.full(lanes, np.log(self._row[self.space.index("kernel_width")]))

    def choose(self, observation: NDArray[Any]) -> Mapping[str, Array]:
        """The width of each recording's kernel."""
        sign = self.signal(observation, "rate.persistence")
        loud = self.signal(observation, "rate.alarm") > self.ALARMS
        width = self._log_width
        quiet = width + self.BACK * (np.log(self.QUIET) - width)
        width = np.where(loud, width + np.where(sign > self.POSITIVE, np.log(1.5), 0.0), quiet)
        width = np.where(loud & (sign < self.NEGATIVE), np.log(self.NARROW), width)
        self._log_width = np.clip(width, np.log(self.NARROW), np.log(self.WIDE))
        return {"kernel_width": np.exp(self._log_width)}


class TrueRegime(Baseline):
    """The table by true regime (`agents.regime_tables`): sees the truth, so it is a bound.

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

    def steered(self, environment: str) -> tuple[str, ...]:  # noqa: ARG002
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


def has_table(scenario: str) -> bool:
    """Whether there is a table by true regime for `scenario`."""
    return scenario in TABLES


def hand_rule(environment: str) -> Baseline:
    """The environment's hand rule."""
    return CovarianceMatching() if environment == AUV else ResidualSign()


PLAIN: Mapping[str, str] = MappingProxyType({AUV: "kf", DECK: "MCC off"})
IMM_OFF = "imm, models off ×3"


def whole_filters(environment: str, truth: bool = True) -> list[Entry]:
    """Filters that need no choice of parameters, the plain one first.

    Args:
        environment: id.
        truth: whether recordings know their true noise, which the oracle needs.
    """
    if one_of("environment", environment, ENGINES) == DECK:
        found = [Entry(PLAIN[DECK], "alignment"), Entry("oracle", "oracle", bound=True)]
    else:
        found = [
            Entry(PLAIN[AUV], "kf"),
            Entry(IMM_OFF, "imm", {"measurement_noise_scale": 1.0 / 3.0}),
            Entry("imm", "imm"),
            Entry("imm_wide", "imm_wide"),
            Entry("bank", "bank"),
            Entry("bank_bursts", "bank_bursts"),
            Entry("oracle", "oracle", bound=True),
        ]
    return [e for e in found if truth or not e.bound]
