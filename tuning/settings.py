"""What a user asks of a study: one declaration for the command line, the file and the manual."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from navgym.core.checks import one_of, positive_int
from navgym.core.machine import cores
from navgym.core.parameters import Parameter, ParameterSpace
from navgym.metrics.measures import METRICS
from navgym.problem import Amount, Problem, problem_of, problems, problems_with
from navgym.readers import ReaderOptions
from navgym.simulation import scenarios
from navgym.statespace.filters.spaces import PROCESS
from navgym.tuning.objectives import find_measure, narrowed
from navgym.tuning.smoothed import SMOOTHER
from navgym.tuning.study.run import STUDY
from navgym.tuning.study.search_space import SAMPLERS

ALL = "all"
# how noise scales of sensors and of axes of motion end; see `navgym.statespace.noise`
NOISE, AXIS, ALL_SENSORS = "_noise_scale", "_process_scale", "measurement_noise_scale"
# of noise scales on logs, whose models are the reader's defaults as often as not
LOG_RANGE = (1e-4, 1e4)
# of real tracks, runs are draws of noise and losses per track and loss rate
ON_TRACKS = Amount(200, 10, 10, 10)
_FIRST = next(problems()).study  # what is tuned where nothing is said


def _usual(name: str) -> str:
    """How much is run by default, for each problem."""
    return ", ".join(f"{p.name} {getattr(p.study.amount, name)}" for p in problems())


def _measures() -> str:
    """Every problem's measures, the default first."""
    return "; ".join(f"{p.name}: {', '.join(p.scoring.measures)}" for p in problems())


def _told(kind: type[StudySettings]) -> type[StudySettings]:
    """Put what problems say for themselves into the manual."""
    text = (kind.__doc__ or "").replace("{measures}", _measures())
    for name in ("trials", "runs", "select_runs", "report_runs"):
        text = text.replace(f"{{{name}}}", _usual(name))
    kind.__doc__ = text
    return kind


@_told
@dataclass(frozen=True)
class StudySettings:
    """A study of one filter's parameters.

    Args:
        filter: what to tune: a name of navgym.filters().
        scenario: simulated conditions to tune on; several are weighed by the plain filter's error.
        overrides: fields of the scenarios to change, such as: loss 0.3
        log: tune on these real logs instead. Without --report-log the first half of each is tuned on,
            the next fifth chooses among the leaders, and the report is on the rest.
        report_log: logs to report on.
        read: what the logs' reader is told: pairs of an option and its value, such as:
            position_noise 5 columns.px "north (m)"; before them, if you like, a mapping file, NAME.toml.
        format: of the logs: csv, deck_csv, npz or another that navgym.read knows (default: what they
            look like).
        truth: smoother: judge parameters on --log against what the plain filter at its defaults smooths of
            it, as if that were the truth; or a tuned.toml of the plain filter, whose parameters smooth.
            It is circular: it favours the smoother's own filter and parameters, and an error that both
            share shows in nothing. Without it the measure is what the filter foretells.
        akit: folder of the A-KIT tracks: tune on 1 to 3 without their truth, report on 4 to 6.
        free: parameters to vary; all for every one. By default, of a variational filter on simulated
            conditions, the four that matter there; on other simulated ones every one of the filter's own;
            on logs and tracks also noise scales of further sensors and axes, where there are several.
        fix: parameters held at a value of their own, such as: vb_iterations 3
        range: other ranges, such as: process_noise_scale 1 100. Noise scales may go beyond their usual
            range; on logs they do so by themselves, 1e-4 to 1e4.
        measure: loss of a run ({measures}). By default the first; where no truth is known the one-step
            error of what is measured: fixes, velocities or rates.
        metric: of the runs' losses: mean, median or "quantile 95 %".
        cost: minimise the time per filter step as well, and show the front.
        trials: finished trials to end with (default: {trials}).
        runs: training recordings per trial (default: {runs}); with --akit draws of noise and
            losses per track and loss rate (10).
        select_runs: recordings of the validation seeds that choose among the leaders ({select_runs}).
        report_runs: recordings of the test seeds that the report is on ({report_runs}).
        steps: samples per recording, if not the scenario's own, where it counts in samples.
        seed: of the sampler.
        sampler: tpe, cma-es, gp, nsga-ii or random.
        prune: give up trials that are surely worse than the best, after part of the recordings.
        batch: trials asked for at once. It decides which trials are made; the number of workers does not.
        workers: processes that evaluate trials (default: one per core).
        scheduler: address of a dask scheduler whose workers evaluate trials instead.
        storage: where the study is kept: a file, or a database URL that many machines share
            (default: OUT/study.log).
        study: its name in a database.
        start: a tuned.toml whose parameters are tried right after the defaults.
        out: folder for report.html, results.json, tuned.toml and the study.
    """

    filter: str = _FIRST.filter
    scenario: tuple[str, ...] = (_FIRST.scenario,)
    overrides: dict[str, float] = field(default_factory=dict)
    log: tuple[Path, ...] = ()
    report_log: tuple[Path, ...] = ()
    read: tuple[str, ...] = ()
    format: str | None = None
    truth: str | None = None
    akit: Path | None = None
    free: tuple[str, ...] = ()
    fix: dict[str, str] = field(default_factory=dict)
    range: dict[str, tuple[float, float]] = field(default_factory=dict)
    measure: str | None = None
    metric: str = "mean"
    cost: bool = False
    trials: int | None = None
    runs: int | None = None
    select_runs: int | None = None
    report_runs: int | None = None
    steps: int | None = None
    seed: int = 0
    sampler: str = "tpe"
    prune: bool = True
    batch: int = 4
    workers: int | None = None
    scheduler: str | None = None
    storage: str | None = None
    study: str = STUDY
    start: Path | None = None
    out: Path = Path("runs/tune")

    def __post_init__(self) -> None:
        problems_with(self.filter)  # is there such a filter?
        one_of("metric", self.metric, METRICS)
        one_of("sampler", self.sampler, SAMPLERS)
        for name in ("trials", "runs", "select_runs", "report_runs", "steps", "workers"):
            if getattr(self, name) is not None:
                positive_int(name, getattr(self, name))
        positive_int("batch", self.batch)
        self._check_source()
        if self.measure is not None:
            find_measure(self.problem, self.measure)
        free, fixed = self.parameters(), self.fixed()
        if not free:
            raise ValueError(f"filter {self.filter!r} has nothing to tune: choose another.")
        for p in free:
            if p.name in fixed:
                raise ValueError(
                    f"{p.name!r} is free and fixed at once: name it in one of the two."
                )

    def _check_source(self) -> None:
        for name in self.scenario:
            one_of("scenario", name, scenarios())
        if not self.scenario and not self.log and self.akit is None:
            raise ValueError("scenario must name at least one scenario, got none.")
        if self.log and self.akit is not None:
            raise ValueError("give --log or --akit, not both.")
        if self.report_log and not self.log:
            raise ValueError("--report-log needs --log, the logs to tune on.")
        for path in (*self.log, *self.report_log):
            if not path.exists():
                raise FileNotFoundError(f"no log at {path}: give the path of a file.")
        if self.read and not self.log:
            raise ValueError("--read is for the reader of --log: name the logs too.")
        if self.truth is not None:
            self._check_truth(self.truth)
        for path in (*self.log, *self.report_log):
            self.reading.options(self.reading.format_of(path))
            if self.reading.problem(path) is not self.problem:
                raise ValueError(f"{self.log[0]} and {path} are logs of different problems.")
        self._check_problem()

    def _check_truth(self, truth: str) -> None:
        """ValueError unless logs can be judged by that."""
        if not self.log:
            raise ValueError("--truth is for --log: name the logs too.")
        if truth != SMOOTHER and not Path(truth).is_file():
            raise ValueError(
                f"truth must be {SMOOTHER!r} or a tuned.toml of the plain filter, got {truth!r}."
            )

    def _check_problem(self) -> None:
        """ValueError unless the filter and what it is tuned on are of one problem."""
        asked = {problem_of(name).name for name in self.scenario} if self.simulated else set()
        if self.filter in self.problem.filters and len(asked) < 2:
            return
        able = " or ".join(f"{p.name}/…" for p in problems_with(self.filter))
        what = f"scenario {', '.join(self.scenario)}"
        if not self.simulated:
            what = f"the tracks in {self.akit}"
            if self.log:
                what = f"logs of format {self.reading.format_of(self.log[0])!r}"
        raise ValueError(
            f"filter {self.filter!r} and {what} are of different problems: choose recordings of "
            f"{able}, or another filter."
        )

    @property
    def simulated(self) -> bool:
        """Whether recordings are simulated."""
        return not self.log and self.akit is None

    @property
    def reading(self) -> ReaderOptions:
        """How logs are read."""
        return ReaderOptions.parsed(self.read, self.format)

    @property
    def problem(self) -> Problem:
        """Whose filter is tuned: that of the tracks, of the logs, or of the scenario."""
        if self.akit is not None:
            return next(p for p in problems() if p.tracks is not None and p.tracks.name == "akit")
        if self.log:
            return self.reading.problem(self.log[0])
        return problem_of(self.scenario[0])

    @property
    def amount(self) -> Amount:
        """How much is run, defaults filled in."""
        given = {n: getattr(self, n) for n in ("trials", "runs", "select_runs", "report_runs")}
        usual = self.problem.study.amount if self.akit is None else ON_TRACKS
        return dataclasses.replace(usual, **{n: v for n, v in given.items() if v is not None})

    @property
    def processes(self) -> int:
        """Worker processes."""
        return self.workers or cores()

    def parameters(self, space: ParameterSpace | None = None) -> tuple[Parameter, ...]:
        """The free parameters, with the ranges asked for.

        Args:
            space: what can be tuned on the recordings at hand; what every recording has by default.

        Raises ValueError for an unknown name, an empty range, nothing to vary.
        """
        whole, usual = self._whole(space), self.problem.study.free
        names = self.free
        if not names and self.simulated:
            own = self.problem.find(self.filter).space.names
            names = tuple(n for n in usual if n in own) if usual and usual[0] in own else own
        if not names:
            spare = {*_spare(whole), *(self.problem.study.held if self.measure is None else ())}
            if self.measure is None:  # a one-step error cannot see it: NIS sets it afterwards
                spare.add(ALL_SENSORS)
            names = tuple(n for n in whole.names if n not in spare or n in self.range)
        if names == (ALL,):
            names = whole.names
        names = tuple(n for n in names if n not in self.fix or n in self.free)
        for name in self.range:
            one_of("free parameter", name, names)
        return tuple(map(self._ranged, whole.subset(names)))

    def _ranged(self, p: Parameter) -> Parameter:
        """A free parameter with the range that it is searched in."""
        if p.name in self.range:
            return narrowed(p, *self.range[p.name])
        if self.log and p.widest is not None:
            least, most = p.admissible
            low, high = min(p.low, LOG_RANGE[0]), max(p.high, LOG_RANGE[1])
            return narrowed(p, max(low, least), min(high, most))
        return p

    def _whole(self, space: ParameterSpace | None) -> ParameterSpace:
        """What can be tuned; without recordings a sensor's scale is taken at its word."""
        if space is not None:
            return space
        own = self.problem.find(self.filter).space
        named = dict.fromkeys(
            n for n in (*self.free, *self.fix, *self.range) if n.endswith((NOISE, AXIS))
        )
        sensors = [replace(PROCESS, name=n, at_start=True) for n in named if n not in own.names]
        return ParameterSpace((*own, *sensors))

    def beyond(self, space: ParameterSpace | None = None) -> list[str]:
        """Ranges that were asked for and are wider than usual, in words."""
        usual = self._whole(space)
        return [
            f"{p.name} is searched from {p.low:g} to {p.high:g}, beyond its usual "
            f"{usual[p.name].low:g} to {usual[p.name].high:g}"
            for p in self.parameters(space)
            if p.name in self.range and (p.low < usual[p.name].low or p.high > usual[p.name].high)
        ]

    def fixed(self, space: ParameterSpace | None = None) -> dict[str, Any]:
        """Parameters held at a value of their own."""
        whole = self._whole(space)
        return {name: whole[name].show(whole[name].check(_read(v))) for name, v in self.fix.items()}


def _spare(space: ParameterSpace) -> list[str]:
    """Scales that say nothing of their own: those of the first sensor and of the first axis, where
    another parameter scales all of R or Q. A search that has both wanders between them.
    """
    spare = []
    for end, whole in ((NOISE, (ALL_SENSORS, "initial_scale")), (AXIS, (PROCESS.name,))):
        own = [n for n in space.names if n.endswith(end) and n not in (ALL_SENSORS, PROCESS.name)]
        spare += own[:1] if any(n in space.names for n in whole) else []
    return spare


def _read(text: Any) -> Any:
    try:
        return float(text)
    except (TypeError, ValueError):
        return text
