"""Everything that a training depends on, declared once: file, command line and docs read it.

Each field's help is the text below it. A configuration is written as TOML beside what it made, and
the same file can be given to `navgym train` again.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import typing
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.constructors import PrimitiveConstructorSpec

from navgym.agents.evaluation.rollout import problem_in
from navgym.agents.training.logs import Logs, judging
from navgym.core.checks import one_of, positive_int, within
from navgym.core.storage import parse_json, read_toml
from navgym.problem import Preset, Problem, environments, problems
from navgym.simulation import find_scenario
from navgym.tuned import read_tuned
from navgym.tuning import declared


def _object(text: str) -> dict[str, Any]:
    """A JSON object; ValueError for anything else."""
    found = parse_json(text)
    if not isinstance(found, dict):
        raise ValueError(f"must be a JSON object, got {text!r}.")  # noqa: TRY004 - tyro wants one
    return found


# on the command line a mapping is one word of JSON, in a file it is a table
Fields = Annotated[
    Mapping[str, Any],
    PrimitiveConstructorSpec(
        nargs=1,
        metavar="JSON",
        instance_from_str=lambda words: _object(words[0]),
        is_instance=lambda value: isinstance(value, Mapping),
        str_from_instance=lambda value: [json.dumps(dict(value))],
    ),
]
Algorithm = Literal["ppo", "sac", "tqc", "recurrent_ppo"]


@dataclass(frozen=True)
class Recipe:
    """How the agent learns."""

    hidden: tuple[int, ...] = (64, 64)
    """units of each hidden layer"""
    learning_rate: float = 1e-3
    """of Adam, at the start"""
    final_learning_rate: float = 5e-5
    """at the end; it falls linearly"""
    gamma: float = 0.9
    """discount per decision"""
    gae_lambda: float = 0.9
    """bias against variance of the advantages (PPO)"""
    steps: int = 64
    """decisions per lane and update (PPO)"""
    batch: int = 2048
    """decisions per gradient step"""
    epochs: int = 10
    """passes over the decisions of an update (PPO)"""
    clip_range: float = 0.2
    """how far one update may move the probability of an action (PPO)"""
    entropy: float = 0.0
    """weight of the entropy bonus (PPO)"""
    log_std_init: float = -0.7
    """log standard deviation of exploration at the start (PPO)"""
    clip_observation: float = 8.0
    """bound on normalised observations"""
    clip_reward: float = 10.0
    """bound on normalised rewards"""
    buffer: int = 300_000
    """decisions that are remembered (SAC, TQC)"""
    gradient_steps: int = 8
    """gradient steps per decision of all lanes (SAC, TQC)"""
    learning_starts: int = 10_000
    """random decisions before the first gradient step (SAC, TQC)"""

    def __post_init__(self) -> None:
        for name in ("steps", "batch", "epochs", "buffer", "gradient_steps"):
            positive_int(f"recipe.{name}", getattr(self, name))
        positive_int("recipe.learning_starts", self.learning_starts, least=0)
        for units in self.hidden:
            positive_int("recipe.hidden", units)
        for name in (
            "learning_rate",
            "final_learning_rate",
            "clip_range",
            "clip_observation",
            "clip_reward",
        ):
            within(f"recipe.{name}", getattr(self, name), 0.0, above=True)
        for name in ("gamma", "gae_lambda"):
            within(f"recipe.{name}", getattr(self, name), 0.0, 1.0)
        within("recipe.entropy", self.entropy, 0.0)
        within("recipe.log_std_init", self.log_std_init, -10.0, 3.0)


@dataclass(frozen=True)
class Cloning:
    """How a policy imitates the table by true regime before it learns on its own."""

    rounds: int = 2
    """after the first: the student acts, the teacher corrects (DAgger)"""
    decisions: int = 100_000
    """of all rounds together"""
    epochs: int = 20
    """passes over what was collected, per round"""
    search: int = 8
    """generations of the search for the table's parameters"""

    def __post_init__(self) -> None:
        positive_int("cloning.rounds", self.rounds, least=0)
        for name in ("decisions", "epochs", "search"):
            positive_int(f"cloning.{name}", getattr(self, name))


@dataclass(frozen=True)
class Configuration:
    """A training: where the agent acts, how it learns, what is kept."""

    environment: str = "navgym/AUVDropout-v0"
    """id of the environment"""
    scenarios: tuple[str, ...] = ("auv/switch-D",)
    """one scenario, or a mixture to draw training recordings from"""
    overrides: Fields = field(default_factory=dict)
    """fields of the scenarios to change, as JSON: '{"loss": 0.3}'"""
    action_parameters: tuple[str, ...] = ("process_noise_scale", "forgetting", "prior_count")
    """what the agent sets, as residuals around the first scenario's best fixed parameters"""
    decision_interval: int = 5
    """filter steps per decision"""
    reward: str = "difference"
    """the environment's reward"""
    arguments: Fields = field(default_factory=dict)
    """further arguments of the environment, as JSON: '{"reward_clip": 10.0}'"""
    randomise: bool = False
    """draw the conditions of each recording anew: a policy for any sea instead of a specialist"""
    untouched: float = 0.0
    """with randomise, the share of recordings that are left as their scenario is"""
    references: bool = False
    """start from other parameters in each recording: a policy to put around any, such as one's own tuned ones"""
    ranges: Fields = field(default_factory=dict)
    """what conditions are drawn from, where not from the problem's usual ranges, as JSON"""
    algorithm: Algorithm = "ppo"
    """tqc and recurrent_ppo need sb3-contrib"""
    decisions: int = 450_000
    """to train for"""
    lanes: int = 128
    """filters that run side by side"""
    recipe: Recipe = field(default_factory=Recipe)
    """how the agent learns"""
    clone: bool = False
    """begin by imitating the table by true regime"""
    cloning: Cloning = field(default_factory=Cloning)
    """how"""
    pool: int = 600
    """training recordings, made once; each seed has its own"""
    validation: int = 200
    """validation recordings per scenario"""
    interval: int = 100_000
    """decisions between validations; each also writes a checkpoint"""
    memory: float = 4.0
    """GB that recordings may take"""
    seed: int = 0
    """of everything random"""
    threads: int = 1
    """of torch; on a busy machine one is quickest"""
    observations: tuple[str, ...] = ()
    """the only elements of the observation that the agent reads; all by default"""
    reach: float = 1.0
    """share of the parameters' ranges, around the reference, that the agent may use"""
    log: tuple[Path, ...] = ()
    """train on these real logs instead of on scenarios"""
    validation_log: tuple[Path, ...] = ()
    """logs that choose and judge the policy; without them the last 30 % of each log in time"""
    read: tuple[str, ...] = ()
    """what the logs' reader is told: pairs of an option and its value, before them a mapping file or none"""
    format: str | None = None
    """of the logs; by default what they look like"""
    start: Path | None = None
    """a tuned.toml to start from; by default the filter is tuned on the same logs with the same information"""
    trials: int = 150
    """of that tuning"""
    truth: bool = True
    """whether to learn from the truth where all logs have it; else from the likelihood, which teaches little"""
    draws: int = 5
    """of noise and losses per validation log and rate of losses, where the format draws them"""
    out: Path | None = None
    """folder for everything that is written; default: runs/train/SCENARIO-ALGORITHM-SEED"""

    def __post_init__(self) -> None:
        one_of("environment", self.environment, environments())
        one_of("algorithm", self.algorithm, typing.get_args(Algorithm))
        if not self.scenarios:
            raise ValueError("scenarios must name at least one scenario, got none.")
        for name in self.scenarios:
            find_scenario(name, **dict(self.overrides))
        for name in (
            "decision_interval", "decisions", "lanes", "pool", "interval", "threads", "trials", "draws",
        ):  # fmt: skip
            positive_int(name, getattr(self, name))
        positive_int("validation", self.validation, least=2)
        within("untouched", self.untouched, 0.0, 1.0)
        positive_int("seed", self.seed, least=0)
        within("memory", self.memory, 0.0, above=True)
        taken = {
            "scenario",
            "overrides",
            "action_parameters",
            "action",
            "decision_interval",
            "reward",
        }
        for name in sorted(
            {*self.arguments} & (taken | {"split", "pool", "recordings", "reference"})
        ):
            raise ValueError(f"arguments must not hold {name!r}: it has a field of its own.")
        known = {
            f.name for f in dataclasses.fields(problem_in(self.environment).environment.settings)
        }
        for name in self.arguments:
            one_of(f"argument of {self.environment}:", name, known)
        decisions = self.lanes * self.recipe.steps
        if "ppo" in self.algorithm and not 1 < self.recipe.batch <= decisions:
            raise ValueError(
                f"recipe.batch must be from 2 to lanes x recipe.steps = {decisions}, got "
                f"{self.recipe.batch}: an update has no more decisions."
            )
        self._check_logs()
        object.__setattr__(self, "ranges", declared.own(self.conditions))
        object.__setattr__(self, "out", None if self.out is None else Path(self.out))

    def _check_logs(self) -> None:
        """ValueError for what makes no sense with logs, without them, or with part of the observation."""
        within("reach", self.reach, 0.0, 1.0, above=True)
        narrow = bool(self.observations) or self.reach != 1.0
        if narrow and (self.clone or "recurrent" in self.algorithm):
            raise ValueError(
                "observations and reach are for ppo, sac and tqc without cloning: leave them out, or clone."
            )
        if not self.log:
            for name in ("validation_log", "read", "format", "start"):
                if getattr(self, name):
                    raise ValueError(f"{name} is for trainings on logs: name them with --log.")
        elif "recurrent" in self.algorithm:
            raise ValueError(
                "recurrent_ppo is for simulated recordings: use ppo, sac or tqc with --log."
            )
        elif self.randomise or self.references or self.clone or self.overrides:
            raise ValueError(
                "randomise, references, clone and overrides are for simulated recordings: leave them out "
                "with --log."
            )

    @property
    def filter(self) -> str:
        """Whose parameters are set."""
        found: str = problem_in(self.environment).environment.settings.FILTER
        return found

    @property
    def logs(self) -> Logs:
        """The logs that it trains on.

        Raises ValueError for none, and for logs of another problem than the environment's.
        """
        found = Logs(self.log, self.read, self.format)
        own = problem_in(self.environment)
        if found.problem.name != own.name:
            raise ValueError(
                f"{self.log[0].name} is a log of the {found.problem.title}, and {self.environment} plays "
                f"the {own.title}: name logs of that, or another preset."
            )
        return found

    @property
    def judges(self) -> Logs | None:
        """The logs that choose and judge, where they are others; see `judging`."""
        return judging(self.logs, self.validation_log)

    @property
    def folder(self) -> Path:
        """Where everything is written."""
        if self.out is not None:
            return self.out
        if self.log:
            return Path("runs/train") / f"logs-{self.algorithm}-{self.seed}"
        first = self.scenarios[0].replace("/", "-") + ("-randomised" if self.randomise else "")
        return Path("runs/train") / f"{first}-{self.algorithm}-{self.seed}"

    @property
    def conditions(self) -> Any:
        """What conditions are drawn from: the problem's ranges, with this configuration's own.

        Raises ValueError, naming the field, for an unknown one or a value that cannot be.
        """
        kind = problem_in(self.environment).training.ranges
        try:
            return declared.from_dict(kind, self.ranges)
        except ValueError as error:
            raise ValueError(f"ranges: {error}") from error

    @property
    def reference(self) -> dict[str, Any]:
        """Best fixed parameters of the first scenario, or those tuned on the logs: what actions start from."""
        if self.log:
            assert self.start is not None
            return dict(read_tuned(self.start).parameters)
        return dict(find_scenario(self.scenarios[0], **dict(self.overrides)).reference)

    def environment_arguments(self) -> dict[str, Any]:
        """Arguments of the environment, but for where recordings come from and the reference."""
        return {
            "scenario": self.scenarios,
            "overrides": dict(self.overrides) or None,
            "action_parameters": self.action_parameters,
            "action": "residual",
            "decision_interval": self.decision_interval,
            "reward": self.reward,
            **self.arguments,
        }

    # ---- as a file -----------------------------------------------------------------------

    def as_dict(self) -> dict[str, Any]:
        """Plain data, as TOML and JSON can hold it; what is unset is left out."""
        return declared.as_dict(self)

    def to_toml(self) -> str:
        """The configuration as TOML."""
        return declared.to_toml(self.as_dict())

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Configuration:
        """Inverse of `as_dict`; missing fields take their defaults.

        Raises ValueError, naming the field, for an unknown one or a value of another type.
        """
        return declared.from_dict(cls, current(values))

    @classmethod
    def from_toml(cls, path: Path) -> Configuration:
        """Read a file; ValueError naming it for what cannot be read or is wrong."""
        values = read_toml(path)
        try:
            return cls.from_dict(values)
        except ValueError as error:
            raise ValueError(f"{path} {error}") from error


def current(values: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a configuration as they are called today, from those of any earlier time.

    Once there was a table of ranges for each problem, `NAME_ranges`, all of them written whole
    whatever the environment; trainings of that time can still be read and gone on with.
    """
    named = environments().get(str(values.get("environment", Configuration.environment)))
    earlier = {f"{problem.name}_ranges": problem for problem in problems()}
    found = {name: value for name, value in values.items() if name not in earlier}
    for name in values.keys() & earlier.keys():
        problem = earlier[name]
        if named is not None and problem.environment.id == named.environment:
            made = declared.from_dict(problem.training.ranges, values[name])
            found["ranges"] = declared.own(made)
    return found


def presets() -> dict[str, tuple[str, Configuration]]:
    """Trainings by name, of every problem: what each is for, and its configuration."""
    return {
        name: (preset.summary, _preset(problem, preset))
        for problem in problems()
        for name, preset in problem.training.presets.items()
    }


def _preset(problem: Problem, preset: Preset) -> Configuration:
    fields = {
        "environment": problem.environment.id, "scenarios": (problem.study.scenario,),
        **preset.fields,
    }  # fmt: skip
    return declared.from_dict(Configuration, fields)


# ---- as documentation ----------------------------------------------------------------------


def markdown(kind: Any = None) -> str:
    """A table of every field of a policy's training, or of another `kind`, with defaults and help."""
    lines = ["| field | default | meaning |", "|---|---|---|"]
    rows = _every_row() if kind is None else _rows(kind)
    lines += [f"| `{name}` | `{default}` | {text} |" for name, default, text in rows]
    return "\n".join(lines)


def _every_row() -> Iterator[tuple[str, Any, str]]:
    """The configuration's rows, and under `ranges` those of each problem."""
    for row in _rows(Configuration):
        yield row
        if row[0] == "ranges":
            for problem in problems():
                for name, value, text in _rows(problem.training.ranges, "ranges."):
                    yield name, value, f"{problem.title}: {text}"


def _rows(kind: Any, prefix: str = "") -> Iterator[tuple[str, Any, str]]:
    texts, usual = _helps(kind), kind()
    for f in dataclasses.fields(kind):
        value = getattr(usual, f.name)
        if dataclasses.is_dataclass(value):
            yield from _rows(type(value), f"{prefix}{f.name}.")
        else:
            yield f"{prefix}{f.name}", declared.plain(value), texts.get(f.name, "")


def _helps(kind: Any) -> dict[str, str]:
    """The text below each field of a dataclass."""
    body = ast.parse(inspect.getsource(kind)).body[0]
    assert isinstance(body, ast.ClassDef)
    found = {}
    for this, following in zip(body.body, body.body[1:], strict=False):
        if (
            isinstance(this, ast.AnnAssign)
            and isinstance(this.target, ast.Name)
            and isinstance(following, ast.Expr)
            and isinstance(following.value, ast.Constant)
        ):
            found[this.target.id] = str(following.value.value)
    return found


def comparable(config: Configuration) -> dict[str, Any]:
    """The configuration without what does not change the result, and without folders' names."""
    found = dataclasses.replace(config, out=None, memory=1.0).as_dict()
    unused = ("observations", "reach", "untouched", "references", *_OF_LOGS)
    plain = declared.as_dict(Configuration())
    if not config.log:  # as it was before there were any
        return {n: v for n, v in found.items() if n not in unused or v != plain.get(n)}
    names = {n: [p.name for p in getattr(config, n)] for n in ("log", "validation_log")}
    start = {} if config.start is None else {"start": read_tuned(config.start).parameters}
    return found | names | start


_OF_LOGS = ("log", "validation_log", "read", "format", "start", "trials", "truth", "draws")
