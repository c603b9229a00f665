"""What a user asks of a study: one declaration for the command line, the file and the manual."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from navgym._checks import one_of, positive_int
from navgym.estimation import parameter_space
from navgym.filters.catalogue import CATALOGUE, DECK_CATALOGUE
from navgym.parameters import Parameter
from navgym.simulation import scenarios
from tuning.experiments import STEERED
from tuning.measures import METRICS, find_measure
from tuning.objective import narrowed
from tuning.search_space import SAMPLERS
from tuning.study import STUDY

ALL = "all"


@dataclass(frozen=True)
class Amount:
    """How much is run: per half, since a deck's recording takes a hundred times an AUV's."""

    trials: int
    runs: int
    select_runs: int
    report_runs: int


AMOUNTS = {"auv": Amount(200, 40, 100, 300), "deck": Amount(60, 16, 16, 60)}
# of real tracks, runs are draws of noise and losses per track and loss rate
TRACKS = Amount(200, 10, 10, 10)


@dataclass(frozen=True)
class Settings:
    """A study of one filter's parameters.

    Args:
        filter: what to tune: a name of navgym.filters().
        scenario: simulated conditions to tune on; several are weighed by the plain filter's error.
        overrides: fields of the scenarios to change, such as: loss 0.3
        log: tune on these real logs instead. Without --report-log the first half of each is tuned on,
            the next fifth chooses among the leaders, and the report is on the rest.
        report_log: logs to report on.
        format: of the logs: csv, or deck_csv.
        akit: folder of the A-KIT tracks: tune on 1 to 3 without their truth, report on 4 to 6.
        free: parameters to vary; all for every one. By default, of a variational filter on simulated
            conditions, the four that matter there; otherwise every one.
        fix: parameters held at a value of their own, such as: vb_iterations 3
        range: narrower ranges, such as: process_noise_scale 1 100
        measure: loss of a run: rmse, likelihood or consistency; on decks also composite, theta_rate,
            theta_ac, theta, attitude. By default rmse or composite; likelihood where no truth is known.
        metric: of the runs' losses: mean, median or "quantile 95 %".
        cost: minimise the time per filter step as well, and show the front.
        trials: finished trials to end with (default: 200, on decks 60).
        runs: training recordings per trial (default: 40, on decks 16); with --akit draws of noise and
            losses per track and loss rate (10).
        select_runs: recordings of the validation seeds that choose among the leaders (100, 16).
        report_runs: recordings of the test seeds that the report is on (300, 60).
        steps: samples per AUV recording, if not the scenario's own.
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

    filter: str = "qivbf"
    scenario: tuple[str, ...] = ("auv/switch-D",)
    overrides: dict[str, float] = field(default_factory=dict)
    log: tuple[Path, ...] = ()
    report_log: tuple[Path, ...] = ()
    format: str = "csv"
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
        one_of("filter", self.filter, {**CATALOGUE, **DECK_CATALOGUE})
        one_of("metric", self.metric, METRICS)
        one_of("sampler", self.sampler, SAMPLERS)
        for name in ("trials", "runs", "select_runs", "report_runs", "steps", "workers"):
            if getattr(self, name) is not None:
                positive_int(name, getattr(self, name))
        positive_int("batch", self.batch)
        self._check_source()
        if self.measure is not None:
            find_measure(self.half, self.measure)
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
        both = {name.partition("/")[0] for name in self.scenario}
        if self.simulated and both != {self.half}:
            raise ValueError(
                f"filter {self.filter!r} and scenario {', '.join(self.scenario)} are of different "
                f"halves: choose a scenario of {self.half}/…, or another filter."
            )

    @property
    def simulated(self) -> bool:
        """Whether recordings are simulated."""
        return not self.log and self.akit is None

    @property
    def half(self) -> str:
        """Whether an AUV or a deck is filtered."""
        if self.filter in CATALOGUE and self.filter in DECK_CATALOGUE:
            return self.scenario[0].partition("/")[0]
        return "deck" if self.filter in DECK_CATALOGUE else "auv"

    @property
    def amount(self) -> Amount:
        """How much is run, defaults filled in."""
        given = {n: getattr(self, n) for n in ("trials", "runs", "select_runs", "report_runs")}
        usual = AMOUNTS[self.half] if self.akit is None else TRACKS
        return dataclasses.replace(usual, **{n: v for n, v in given.items() if v is not None})

    @property
    def processes(self) -> int:
        """Worker processes."""
        return self.workers or max(1, len(os.sched_getaffinity(0)))

    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters, with the ranges asked for.

        Raises ValueError for an unknown name, an empty range, nothing to vary.
        """
        whole = parameter_space(self.filter, deck=self.half == "deck")
        names = self.free
        if not names and self.simulated and "vb_iterations" in whole.names:
            names = tuple(n for n in STEERED if n in whole.names)
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
        whole = parameter_space(self.filter, deck=self.half == "deck")
        return {name: whole[name].show(whole[name].check(_read(v))) for name, v in self.fix.items()}


def _read(text: Any) -> Any:
    try:
        return float(text)
    except (TypeError, ValueError):
        return text
