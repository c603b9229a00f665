"""What a user asks of a study: one declaration for the command line, the file and the manual."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from navgym.core.checks import one_of, positive_int
from navgym.core.machine import cores
from navgym.core.parameters import Parameter
from navgym.metrics.measures import METRICS
from navgym.problem import Amount, Problem, problem_of, problems, problems_with
from navgym.readers import ReaderOptions
from navgym.simulation import scenarios
from navgym.tuning.objectives import find_measure, narrowed
from navgym.tuning.study.run import STUDY
from navgym.tuning.study.search_space import SAMPLERS

ALL = "all"
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
        akit: folder of the A-KIT tracks: tune on 1 to 3 without their truth, report on 4 to 6.
        free: parameters to vary; all for every one. By default, of a variational filter on simulated
            conditions, the four that matter there; otherwise every one.
        fix: parameters held at a value of their own, such as: vb_iterations 3
        range: narrower ranges, such as: process_noise_scale 1 100
        measure: loss of a run ({measures}). By default the first; likelihood where no truth is known.
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
        for path in (*self.log, *self.report_log):
            self.reading.options(self.reading.format_of(path))
            if self.reading.problem(path) is not self.problem:
                raise ValueError(f"{self.log[0]} and {path} are logs of different problems.")
        self._check_problem()

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

    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters, with the ranges asked for.

        Raises ValueError for an unknown name, an empty range, nothing to vary.
        """
        whole, usual = self.problem.find(self.filter).space, self.problem.study.free
        names = self.free
        if not names and self.simulated and usual and usual[0] in whole.names:
            names = tuple(n for n in usual if n in whole.names)
        if not names or names == (ALL,):
            names = whole.names
        names = tuple(n for n in names if n not in self.fix or n in self.free)
        for name in self.range:
            one_of("free parameter", name, names)
        chosen = whole.subset(names)
        return tuple(
            narrowed(p, *self.range[p.name]) if p.name in self.range else p for p in chosen
        )

    def fixed(self) -> dict[str, Any]:
        """Parameters held at a value of their own."""
        whole = self.problem.find(self.filter).space
        return {name: whole[name].show(whole[name].check(_read(v))) for name, v in self.fix.items()}


def _read(text: Any) -> Any:
    try:
        return float(text)
    except (TypeError, ValueError):
        return text
