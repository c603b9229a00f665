"""What a problem is: all that sets one navigation task apart from another, in one frozen object.

A problem's folder makes its `Problem`; one line of `REGISTERED` names it. Everybody who handles
recordings, filters, errors, environments, studies or agents asks the object, never the name: a new
problem is a new folder and a new line.

Whatever takes long to import is given as `lazy("module:name")`, so that listing what there is loads
no kernel.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array, one_of, positive_int
from navgym.core.parameters import ParameterSpace, parameter_table

if TYPE_CHECKING:
    from pathlib import Path

    from navgym.inspection.findings import Evidence
    from navgym.metrics.measures import Measure, Quantity


def load(where: str) -> Any:
    """What "module:name" names."""
    module, _, names = where.partition(":")
    found = importlib.import_module(module)
    for name in names.split("."):
        found = getattr(found, name)
    return found


def lazy(where: str) -> Callable[..., Any]:
    """A function or class that is imported when it is first called."""

    def call(*arguments: Any, **options: Any) -> Any:
        return load(where)(*arguments, **options)

    call.__doc__ = f"See `{where}`."
    return call


# ---- filters and what they return


@dataclass(frozen=True)
class Filter:
    """A filter by name: what it is, what can be tuned, and the kernels that run it.

    Args:
        name: as given to `navgym.estimate`.
        summary: one line for listings.
        space: what can be tuned.
        family: which kernels of its problem run it.
        option: what these need to know beyond parameters (a fill, a mode set).
        needs_scales: whether it reads the true noise of a simulated recording.
        nonlinear: whether it takes any model, and not only a linear one.
        smooths: whether `navgym.smooth` can go back over what it made.
    """

    name: str
    summary: str
    space: ParameterSpace
    family: str
    option: Any = 0
    needs_scales: bool = False
    nonlinear: bool = False
    smooths: bool = False


@dataclass(frozen=True)
class Believed:
    """One noise that a model believes in.

    Args:
        deviations: standard deviations, or root densities, one per row or axis.
        scale: the parameter that multiplies their squares.
    """

    deviations: tuple[float, ...]
    scale: str


@dataclass(frozen=True, eq=False)
class Run:
    """What a filter made of a batch of N recordings of up to T filter steps.

    Args:
        states: (N, T, n) posterior means; NaN after a numerical failure and past a recording's end.
        diverged: (N,) whether the filter failed, or its innovations have run away.
        covariances: (N, T, n, n); this and what follows have T = 0 where only states were asked for.
        innovations: (N, T, m) measurement minus its prediction; NaN where lost.
        nis: (N, T) normalised innovation squared; NaN where nothing was received.
        log_likelihood: (N, T) of each innovation.
        components: (N, T) how many components were received.
        extras: what else a filter says, by name: arrays or lists with an entry per recording.
    """

    states: Array
    diverged: NDArray[np.bool_]
    covariances: Array
    innovations: Array
    nis: Array
    log_likelihood: Array
    components: NDArray[np.int64]
    extras: Mapping[str, Any] = field(default_factory=dict)


class Batch(Protocol):
    """Recordings made ready for a problem's kernels; shorter ones end in nothing.

    `recordings` may be empty where a batch was made otherwise; `truth` is None where it is unknown.
    """

    @property
    def recordings(self) -> Sequence[Any]:
        """What was stacked."""

    @property
    def lengths(self) -> NDArray[np.int64]:
        """(N,) filter steps of each."""

    @property
    def steps(self) -> int:
        """Filter steps of the longest."""

    @property
    def step(self) -> float:
        """Usual seconds per filter step."""

    @property
    def decision_interval(self) -> int:
        """Filter steps per row of a schedule of parameters, where nothing else is said."""

    @property
    def linear(self) -> bool:
        """Whether filters for linear models can run."""

    @property
    def truth(self) -> Array | None:
        """(N, T, ·) true states, NaN past a recording's end."""

    def regimes(self) -> list[NDArray[np.int64]]:
        """(T_i,) label of the true regime of each filter step; an empty list where not known."""

    def time_of(self, i: int) -> Array:
        """(T_i,) s, when recording i's filter steps end."""

    def take(self, which: Sequence[int] | NDArray[np.int64]) -> Self:
        """Some of the recordings, in the order of `which`."""

    def __len__(self) -> int:
        """Number of recordings."""


# ---- what a problem says for itself

Span = tuple[float, float]  # shares of a recording between which it is scored, 0 to 1


@dataclass(frozen=True, eq=False)
class Scoring:
    """What estimates are judged by.

    Args:
        quantities: errors against the truth, by name; the first is what counts.
        measures: what a study can minimise, by name, the default first.
        errors: (batch, states, names, span) to quantities (N,) by name; infinite after a failure.
            Raises ValueError for recordings without truth.
        squared: (batch, states, name, span) to a quantity's squared errors over time, (N, T), NaN
            outside the span; what settles at the start is shown.
        scored: (batch, span) to a mask (N, T) of the innovations that are judged.
        nees: (batch, run) to normalised estimation errors squared per degree of freedom, (N, T).
        foretold: one-step errors of what is measured, by name; the first whose rows a recording has is
            what it is judged by where no truth is known. Each has a measure of its name.
        rows: (batch) to factors (N, m) of innovations by name of `foretold`, 0 for rows that do not
            belong to it; names without a row are left out.
        settling: s from a recording's start that count for no error.
        at_once: recordings whose covariances may be in memory together; None: all.
    """

    quantities: Mapping[str, Quantity]
    measures: Mapping[str, Measure]
    errors: Callable[[Any, Array, Sequence[str], Span], dict[str, Array]]
    squared: Callable[[Any, Array, str, Span], Array]
    scored: Callable[[Any, Span], NDArray[np.bool_]]
    nees: Callable[[Any, Run], Array]
    foretold: Mapping[str, Quantity] = field(default_factory=dict)
    rows: Callable[[Any], Mapping[str, Array]] = lambda _: {}
    settling: float = 0.0
    at_once: int | None = None


@dataclass(frozen=True)
class Amount:
    """How much a study runs, where nothing else is said.

    Args:
        trials: finished trials to end with.
        runs: training recordings per trial.
        select_runs: recordings that choose among the leaders.
        report_runs: recordings that the report is on.
    """

    trials: int
    runs: int
    select_runs: int
    report_runs: int


@dataclass(frozen=True)
class Steering:
    """What steering a filter could win is measured with: best fixed parameters, and a table by regime.

    Args:
        filter: whose parameters.
        free: what best fixed parameters vary.
        scheduled: what follows the true regime.
        fixed: values of the others.
        first: parameter sets to try early.
        measures: that contenders are compared by.
        beside: filters that need no tuning, shown beside.
        amount: trials, training and fresh recordings (`select_runs` is not used).
        quick: the same of a short run.
        quick_overrides: of the scenario in a short run.
        guess: (batch) to a first guess of each scheduled parameter, a value per regime.
    """

    filter: str
    free: tuple[str, ...]
    scheduled: tuple[str, ...]
    fixed: Mapping[str, Any]
    first: tuple[Mapping[str, Any], ...]
    measures: tuple[str, ...]
    beside: tuple[str, ...]
    amount: Amount
    quick: Amount
    quick_overrides: Mapping[str, Any]
    guess: Callable[[Any], Mapping[str, Sequence[float]]]


@dataclass(frozen=True)
class Study:
    """How the problem's filters are tuned.

    Args:
        filter: what is tuned where no filter is named.
        scenario: and on what, by the scenario's full name.
        amount: how much is run.
        free: what is varied on simulated recordings by default, of a filter that has the first of
            these; every parameter of other filters.
        held: what is not varied by default on recordings without truth, because no innovation shows what
            it does.
        referred: filters whose parameters a scenario's `reference` may hold.
        beside: filters at their defaults that stand beside a tuned one, as far as models allow.
        steering: how headroom is measured; None where no scenario has regimes.
        tables: parameters by true regime, per scenario's own name: regime to values by name.
    """

    filter: str
    scenario: str
    amount: Amount
    free: tuple[str, ...]
    referred: tuple[str, ...]
    beside: tuple[str, ...]
    steering: Steering | None = None
    held: tuple[str, ...] = ()
    tables: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Environment:
    """The problem as a Gymnasium environment.

    Args:
        id: of the environment.
        settings: dataclass of its arguments, a `navgym.envs.settings.LaneSettings`.
        engine: (settings, lanes, trail) to a `navgym.envs.base.LaneEngine`.
        live: (settings, reference, model, interval, rates) to a `navgym.envs.live.LiveLane`.
        steered: what a simple chooser of parameters sets.
        replayed: (arguments of the environment) to the filter whose run with a roll-out's schedule gives the
            engine's states, to the last bit.
        refuses: (scenario) to why the environment cannot play it, or None.
        score: (settings, gains) to the one number that training selects by; larger is better.
            Gains go by the names of errors in the engine's `INFO_NAMES`, such as `rmse`; by default
            the first one counts.
    """

    id: str
    settings: Any
    engine: Callable[..., Any]
    live: Callable[..., Any]
    steered: tuple[str, ...]
    replayed: Callable[[Mapping[str, Any]], Filter]
    refuses: Callable[[Any], str | None] = lambda _: None
    score: Callable[[Any, Mapping[str, float]], float] = lambda _, gains: next(iter(gains.values()))


@dataclass(frozen=True)
class Preset:
    """A training by name: what it is for, and fields of the configuration that differ from usual."""

    summary: str
    fields: Mapping[str, Any]


@dataclass(frozen=True)
class Training:
    """How agents of the problem are trained.

    Args:
        ranges: dataclass of what conditions are drawn from.
        draw: (scenario, ranges, generator) to the scenario under other conditions.
        presets: trainings by name.
    """

    ranges: Any
    draw: Callable[[Any, Any, np.random.Generator], Any]
    presets: Mapping[str, Preset]


@dataclass(frozen=True)
class Rival:
    """A filter that needs no choice of parameters, beside policies in every ladder.

    Args:
        label: what tables call it.
        filter: its name.
        parameters: its own; None for the defaults.
        about: what it is, for reports.
        bound: whether it needs the truth.
        adapts: whether it adapts without having learnt anything.
        real_only: whether it is shown on real recordings only.
        overrides: fields of the scenario to change, for one that has another sensor on board: the same
            seeds, simulated recordings only.
    """

    label: str
    filter: str
    parameters: Mapping[str, Any] | None = None
    about: str = ""
    bound: bool = False
    adapts: bool = False
    real_only: bool = False
    overrides: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Seer:
    """A rule that knows the truth: a bound on what rules and policies can win, in every ladder.

    Args:
        label: what tables call it.
        schedule: (recording) to parameters of the contest's default filter, a number per filter step.
        about: what it is, for reports.
    """

    label: str
    schedule: Callable[[Any], Mapping[str, Any]]
    about: str = ""


@dataclass(frozen=True, eq=False)
class Contest:
    """What policies of the problem are held against, and where.

    Args:
        quantities: errors, the first is what counts.
        everywhere: those that are computed in conditions that are nobody's own too.
        rivals: the plain filter, which scores 0, first.
        hand_rule: () to a `navgym.envs.rules.HandRule`, which steers by the environment's
            observations; None: there is none.
        rule: what that does, for reports.
        default: the filter that runs at its defaults and at best fixed parameters.
        highlight: label of the rival that is drawn over time beside policies, or "".
        top: label of what scores 1.
        yardstick: label that divergence is judged by.
        own: recordings per condition that a policy was trained for.
        other: per other condition.
        quick_own: of a short run.
        quick_other: of a short run.
        chunk: recordings at a time.
        judged: recordings that consistency is judged on.
        others: scenarios that no policy may have been trained on, by full name.
        shifts: (scenario) to conditions that no policy was trained for, overrides by name.
        quick_shifts: those of a short run.
        quick: overrides of the scenario in a short run.
        shift_first_only: whether one own condition's shifts tell enough of the others'.
        streams_own: whether policies run sample by sample, with their fallback, in own conditions.
        seers: rules that know the truth.
    """

    quantities: tuple[str, ...]
    everywhere: tuple[str, ...]
    rivals: tuple[Rival, ...]
    hand_rule: Callable[[], Any] | None
    rule: str
    default: str
    highlight: str
    top: str
    yardstick: str
    own: int
    other: int
    quick_own: int
    quick_other: int
    chunk: int
    judged: int
    others: tuple[str, ...]
    shifts: Callable[[Any], Mapping[str, Mapping[str, Any]]]
    quick_shifts: tuple[str, ...]
    quick: Mapping[str, Any] = field(default_factory=dict)
    shift_first_only: bool = False
    streams_own: bool = True
    seers: tuple[Seer, ...] = ()

    @property
    def plain(self) -> str:
        """Label of the filter that scores 0."""
        return self.rivals[0].label


@dataclass(frozen=True, eq=False)
class Tracks:
    """Real recordings that the problem is reported on, and how they are kept apart.

    Args:
        name: of the data set.
        about: who made it and where it is, for reports.
        folds: numbers of the tracks: tuned on one fold, reported on the other.
        rates: shares of lost samples.
        recording: (folder, track, rate, seed) to a recording; folder None: a simulated stand-in.
        title: what reports call the data set.
        variants: further conditions that policies are held against there, by name: (folder, track, seed)
            to a recording.
    """

    name: str
    about: str
    folds: tuple[tuple[int, ...], tuple[int, ...]]
    rates: tuple[float, ...]
    recording: Callable[..., Any]
    title: str = ""
    variants: Mapping[str, Callable[..., Any]] = field(default_factory=dict)

    @property
    def numbers(self) -> tuple[int, ...]:
        """Every track."""
        return self.folds[0] + self.folds[1]


@dataclass(frozen=True, eq=False)
class Problem:
    """One kind of navigation task.

    Args:
        name: prefix of its scenarios' names.
        title: what reports call it.
        recording: type of its recordings.
        scenario: type of its scenarios, each with `name`, `summary`, `reference` (best fixed
            parameters) and `override(**fields)`.
        scenarios: by their own names.
        simulate: (scenario, seeds) to recordings.
        brief: overrides that make a scenario as short as can be: for compiling, and for checks.
        readers: "module:function" by format.
        marks: by format, a regular expression that a file's first lines, or the names in a folder,
            hold where they are in it.
        told: (recording) to lines of a name and a text, what it holds beside times; None: nothing.
        evidence: (recording, path of its log, options that its reader was told) to a
            `navgym.inspection.findings.Evidence`, for `navgym inspect`; None: nothing beyond what any log shows.
        noise: (filter, batch) to the scales of the batch's models that stand beside the filter's own
            parameters.
        believing: (batch, values of those, (N or 1, ·)) to the batch whose models have them.
        noises: (batch) to what its models believe of noise, by name: what noise scales refer to.
        filters: by name.
        stack: recordings to a `Batch`.
        runner: (filter, batch, table of parameters, interval, everything) to a `Run`; raises
            ValueError for a batch that the filter cannot use.
        estimate: (filter, batch of one, run) to the estimate that users get.
        smoother: (filter, batch of one, table of parameters, interval, run) to smoothed states (T, n) and
            covariances (T, n, n), of filters that can be smoothed; the run is the filter's own.
        kernels: () to what touches every kernel once: groups of pairs of a name and a function. Those
            of a group share what they compile, so that one process does them.
        plain: the filter that needs no tuning; several where models differ, the first that can.
        bound: the filter that knows the truth.
        scoring: what estimates are judged by.
        study: how filters are tuned.
        environment: the problem as an environment.
        training: how agents are trained.
        contest: what they are held against.
        tracks: real recordings to report on; None: there are none.
    """

    name: str
    title: str
    recording: type
    scenario: type
    scenarios: Mapping[str, Any]
    simulate: Callable[[Any, Sequence[int]], list[Any]]
    brief: Mapping[str, Any]
    readers: Mapping[str, str]
    filters: Mapping[str, Filter]
    stack: Callable[[Sequence[Any]], Any]
    runner: Callable[[Filter, Any, Array, int, bool], Run]
    estimate: Callable[[Filter, Any, Run], Any]
    kernels: Callable[[], Sequence[Sequence[tuple[str, Callable[[], Any]]]]]
    plain: tuple[str, ...]
    bound: str
    scoring: Scoring
    study: Study
    environment: Environment
    training: Training
    contest: Contest
    tracks: Tracks | None = None
    smoother: Callable[[Filter, Any, Array, int, Run], tuple[Array, Array]] | None = None
    marks: Mapping[str, str] = field(default_factory=dict)
    told: Callable[[Any], list[tuple[str, str]]] | None = None
    evidence: Callable[[Any, Path, Mapping[str, Any]], Evidence] | None = None
    noise: Callable[[Filter, Any], ParameterSpace] = lambda _, __: ParameterSpace(())
    believing: Callable[[Any, Array], Any] = lambda batch, _: batch
    noises: Callable[[Any], Mapping[str, Believed]] = lambda _: {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Travels by where it is found: a process that has not met it imports it."""
        return _found, (self.name, REGISTERED[self.name].problem)

    def find(self, filter_name: str | Filter) -> Filter:
        """The filter of that name; a filter of one's own is taken as it is.

        Raises ValueError with the nearest name, or naming the problem that has such a filter.
        """
        if isinstance(filter_name, Filter):
            return filter_name
        if filter_name not in self.filters:
            for other in problems():
                if filter_name in other.filters:
                    raise ValueError(
                        f"filter {filter_name!r} is for a {other.recording.__name__} "
                        f"({other.title}), and this is a {self.recording.__name__} "
                        f"({self.title}): use one of {', '.join(self.filters)}."
                    )
        return self.filters[one_of("filter", filter_name, self.filters)]

    def plain_filter(self, batch: Any) -> str:
        """Name of the filter that needs no tuning, for the models of `batch`."""
        able = (n for n in self.plain if batch.linear or self.filters[n].nonlinear)
        return next(able)

    def run(
        self,
        filter_name: str | Filter,
        batch: Any,
        parameters: Any = None,
        decision_interval: int | None = None,
        everything: bool = False,
    ) -> Run:
        """Run one filter over a batch.

        Args:
            filter_name: a name of `filters`, or a filter of one's own.
            batch: stacked recordings.
            parameters: as in `navgym.estimate` for all of them, but no path; or a list with one dict
                per recording.
            decision_interval: filter steps per row of a schedule; the batch's own by default.
            everything: False computes `states`, `diverged` and extras only.
        """
        chosen = self.find(filter_name)
        interval, batch, table = self._table(chosen, batch, parameters, decision_interval)
        return self.runner(chosen, batch, table, interval, everything)

    def smooth(
        self,
        filter_name: str | Filter,
        batch: Any,
        parameters: Any = None,
        decision_interval: int | None = None,
    ) -> Run:
        """A filter's run over a batch of one recording, its states and covariances smoothed.

        Raises ValueError for a filter that cannot be smoothed.
        """
        chosen = self.find(filter_name)
        if not chosen.smooths or self.smoother is None:
            able = ", ".join(f.name for f in self.filters.values() if f.smooths) or "none"
            raise ValueError(
                f"filter {chosen.name!r} cannot be smoothed; of this problem's filters can: {able}."
            )
        interval, batch, table = self._table(chosen, batch, parameters, decision_interval)
        run = self.runner(chosen, batch, table, interval, True)
        if not np.isfinite(run.states).all():
            return run
        states, covariances = self.smoother(chosen, batch, table, interval, run)
        return replace(run, states=states[None], covariances=covariances[None])

    def _table(
        self, chosen: Filter, batch: Any, parameters: Any, decision_interval: int | None
    ) -> tuple[int, Any, Array]:
        """Interval, batch and table of the filter's own parameters, where models take the others."""
        interval = batch.decision_interval if decision_interval is None else decision_interval
        positive_int("decision_interval", interval)
        # an array has the filter's own columns; a dict may name the models' noise as well
        named = isinstance(parameters, Mapping) or (
            isinstance(parameters, (list, tuple))
            and any(isinstance(p, Mapping) for p in parameters)
        )
        space = self.space(chosen, batch) if named else chosen.space
        table = parameter_table(space, parameters, len(batch), batch.steps, interval)
        own = len(chosen.space)
        if len(space) > own:
            batch = self.believing(batch, table[:, 0, own:])
            table = np.ascontiguousarray(table[:, :, :own])
        return interval, batch, table

    def space(self, filter_name: str | Filter, batch: Any) -> ParameterSpace:
        """What can be tuned in a filter on a batch: its own parameters, then its models' noise."""
        chosen = self.find(filter_name)
        return ParameterSpace((*chosen.space, *self.noise(chosen, batch)))

    def full_name(self, scenario: Any) -> str:
        """A scenario's name with the problem's before it."""
        return f"{self.name}/{scenario.name}"


# ---- which problems there are


@dataclass(frozen=True)
class Registered:
    """Where a problem is found.

    Args:
        problem: "module:name" of its `Problem`.
        environment: id of its environment.
        single: "module:class" of the environment; its batch face is the class VectorEnv in place
            of Env.
    """

    problem: str
    environment: str
    single: str

    @property
    def vector(self) -> str:
        """Where the batch face is found."""
        return f"{self.single.removesuffix('Env')}VectorEnv"


# a problem is a folder and a line here
REGISTERED: dict[str, Registered] = {
    "auv": Registered("navgym.auv.problem:PROBLEM", "navgym/AUVDropout-v0", "navgym.auv.environment:AUVDropoutEnv"),
    "deck": Registered("navgym.deck.problem:PROBLEM", "navgym/DeckDeformation-v0", "navgym.deck.environment:DeckDeformationEnv"),
    "ins": Registered("navgym.ins.problem:PROBLEM", "navgym/INSDropout-v0", "navgym.ins.environment:INSDropoutEnv"),
}  # fmt: skip


PLUGGED = "navgym.plugins:plugged"  # what adds other packages' filters and readers


def _found(name: str, where: str) -> Problem:
    """A problem, with what other packages bring for it."""
    found: Problem = load(REGISTERED[name].problem if name in REGISTERED else where)
    plugged: Problem = load(PLUGGED)(found)
    return plugged


class _Problems(Mapping[str, Problem]):
    """Problems by name, each loaded when it is first asked for."""

    def __getitem__(self, name: str) -> Problem:
        return _found(name, REGISTERED[name].problem)

    def __iter__(self) -> Iterator[str]:
        return iter(REGISTERED)

    def __len__(self) -> int:
        return len(REGISTERED)


PROBLEMS: Mapping[str, Problem] = _Problems()


def problems() -> Iterator[Problem]:
    """Every problem."""
    return (PROBLEMS[name] for name in PROBLEMS)


def environments() -> dict[str, Registered]:
    """Where each environment is found, by id."""
    return {r.environment: r for r in REGISTERED.values()}


def register(name: str, where: Registered) -> None:
    """Add a problem of one's own, and its environment; doing it twice changes nothing.

    Raises ValueError if another problem has the name.
    """
    if REGISTERED.get(name, where) != where:
        raise ValueError(f"there is a problem {name!r} already, {REGISTERED[name].problem}.")
    REGISTERED[name] = where
    register_environments()


def adopt(registered: Mapping[str, Registered]) -> None:
    """Register what another process has: a worker then finds by name all that its parent does."""
    for name, where in registered.items():
        register(name, where)


def register_environments() -> None:
    """Register every problem's environment with Gymnasium; doing it twice changes nothing."""
    import gymnasium

    for name, where in environments().items():
        if name not in gymnasium.registry:
            gymnasium.register(id=name, entry_point=where.single, vector_entry_point=where.vector)


def problem_of(what: Any) -> Problem:
    """The problem that something belongs to.

    Args:
        what: a problem's name; the name of a scenario ("auv/switch-D"), of an environment or of a
            filter that only one problem has; a recording or a scenario.

    Raises:
        ValueError: an unknown name, or that of a filter of several problems.
        TypeError: something that belongs to no problem.
    """
    if isinstance(what, str):
        return _by_name(what)
    for problem in problems():
        if isinstance(what, (problem.recording, problem.scenario)):
            return problem
    kinds = ", ".join(p.recording.__name__ for p in problems())
    raise TypeError(f"a recording must be one of {kinds}, got {type(what).__name__}.")


def _by_name(name: str) -> Problem:
    prefix = name.partition("/")[0]
    if prefix in PROBLEMS:
        return PROBLEMS[prefix]
    for key, where in REGISTERED.items():
        if where.environment == name:
            return PROBLEMS[key]
    known = [*PROBLEMS, *environments(), *(n for p in problems() for n in p.filters)]
    one_of("problem, scenario, environment or filter", name, dict.fromkeys(known))
    having = problems_with(name)
    if len(having) > 1:
        names = " or ".join(repr(p.name) for p in having)
        raise ValueError(f"{name!r} is a filter of several problems: say which, {names}.")
    return having[0]


def problems_with(filter_name: str) -> tuple[Problem, ...]:
    """The problems that have a filter of that name; ValueError with the nearest name for none."""
    known = [n for p in problems() for n in p.filters]
    one_of("filter", filter_name, dict.fromkeys(known))
    return tuple(p for p in problems() if filter_name in p.filters)
