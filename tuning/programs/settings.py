"""What a user asks of a study of a program: one declaration for the command line, the file and the manual."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from navgym.core.checks import one_of, positive_int, within
from navgym.core.machine import cores
from navgym.core.parameters import Parameter
from navgym.metrics.measures import METRICS
from navgym.problem import Amount
from navgym.tuning.objectives import narrowed
from navgym.tuning.programs.contract import Contract
from navgym.tuning.programs.runner import Command
from navgym.tuning.programs.scoring import measures
from navgym.tuning.study.run import STUDY
from navgym.tuning.study.search_space import SAMPLERS

MEGABYTE = 2**20


@dataclass(frozen=True)
class ProgramSettings:
    """A study of a program's parameters.

    Args:
        program: the command that replays a log, such as "./replay {parameters} {log} {out}". It is split
            into words, and no shell is started; {name} and {folder} are the log's.
        parameters: a TOML file that declares the parameters, and the columns of the output where their
            names do not say it.
        log: logs to tune on. Without others, three or more are shared out; one or two are cut in time.
        select_log: logs that choose among the leaders.
        report_log: logs to report on.
        free: parameters, or groups of them, to vary; all by default.
        fix: parameters held at a value of their own, such as: gate 3
        range: other ranges, such as: accel_noise 0.1 10
        measure: likelihood, one_step, rmse or consistency; by default the first that the output allows.
        metric: of the logs' losses: mean, median or "quantile 95 %".
        prior: add the priors that the file declares (maximum a posteriori), to a likelihood.
        time_limit: s that a run may take.
        largest: megabytes that a run may write.
        folder: where the program is started (default: an empty folder of its own, so that runs do not
            meet).
        also: files that the program reads, beside those that the command names: when one has changed, no
            kept run counts.
        repeats: how often the defaults are run, to see whether the program says the same twice.
        trials: finished trials to end with.
        seed: of the sampler.
        sampler: tpe, cma-es, gp, nsga-ii or random.
        prune: give up trials that are surely worse than the best, after part of the logs.
        batch: trials asked for at once. It decides which trials are made; the number of workers does not.
        workers: processes that evaluate trials (default: one per core).
        scheduler: address of a dask scheduler whose workers evaluate trials instead.
        storage: where the study is kept: a file, or a database URL that many machines share
            (default: OUT/study.log).
        study: its name in a database.
        start: a tuned.toml whose parameters are tried right after the defaults, and reported beside.
        name: what reports call the program (default: its file's name).
        out: folder for report.html, results.json, tuned.toml, the study and the runs.
    """

    program: str = ""
    parameters: Path | None = None
    log: tuple[Path, ...] = ()
    select_log: tuple[Path, ...] = ()
    report_log: tuple[Path, ...] = ()
    free: tuple[str, ...] = ()
    fix: dict[str, str] = field(default_factory=dict)
    range: dict[str, tuple[float, float]] = field(default_factory=dict)
    measure: str | None = None
    metric: str = "mean"
    prior: bool = False
    time_limit: float = 60.0
    largest: float = 256.0
    folder: Path | None = None
    also: tuple[Path, ...] = ()
    repeats: int = 3
    trials: int = 100
    seed: int = 0
    sampler: str = "tpe"
    prune: bool = True
    batch: int = 4
    workers: int | None = None
    scheduler: str | None = None
    storage: str | None = None
    study: str = STUDY
    start: Path | None = None
    name: str = ""
    out: Path = Path("runs/program")

    def __post_init__(self) -> None:
        one_of("metric", self.metric, METRICS)
        one_of("sampler", self.sampler, SAMPLERS)
        if self.measure is not None:
            one_of("measure", self.measure, measures())
        for each in ("trials", "batch", "repeats"):
            positive_int(each, getattr(self, each))
        if self.workers is not None:
            positive_int("workers", self.workers)
        within("time_limit", self.time_limit, 0.0, above=True)
        within("largest", self.largest, 0.0, above=True)
        stages = {"log": self.log, "select_log": self.select_log, "report_log": self.report_log}
        seen: dict[Path, str] = {}
        for stage, paths in stages.items():
            for path in paths:
                if not path.exists():
                    raise FileNotFoundError(f"no log at {path}: give the path of a file.")
                other = seen.setdefault(path.resolve(), stage)
                if other != stage or paths.count(path) > 1:
                    raise ValueError(
                        f"{path} serves two ends, {other} and {stage}: no log that is tuned on or chosen on "
                        "can judge. Name each once."
                    )
        for path in self.also:
            if not path.is_file():
                raise FileNotFoundError(f"--also: no file at {path}.")
        if self.folder is not None and not self.folder.is_dir():
            raise ValueError(f"--folder: there is no folder {self.folder}.")

    # ---- what reports read

    @property
    def filter(self) -> str:
        """What reports call the program."""
        if self.name:
            return self.name
        words = [w for w in self.program.split() if "{" not in w]
        named = [w for w in words if Path(w).suffix] or words
        return Path(named[0]).stem if named else "function"

    @property
    def cost(self) -> bool:
        """Whether time is minimised beside: never here."""
        return False

    @property
    def amount(self) -> Amount:
        """How much is run."""
        return Amount(self.trials, len(self.log), len(self.select_log), len(self.report_log))

    @property
    def processes(self) -> int:
        """Worker processes."""
        return self.workers or cores()

    def command(self) -> Command:
        """The command, checked; ValueError for one that cannot be."""
        limit, largest = float(self.time_limit), round(self.largest * MEGABYTE)
        folder = "" if self.folder is None else str(self.folder.absolute())
        return Command.parsed(self.program, limit=limit, largest=largest, folder=folder)

    def varied(self, contract: Contract) -> tuple[Parameter, ...]:
        """The free parameters, with the ranges asked for.

        Raises ValueError for an unknown name, an empty range, one that is fixed as well, nothing to vary.
        """
        names = contract.members(self.free) if self.free else contract.space.names
        held = contract.members(tuple(self.fix))
        for each in self.free:
            if each in held:
                raise ValueError(f"{each!r} is free and fixed at once: name it in one of the two.")
        names = tuple(n for n in names if n not in held)
        if not names:
            raise ValueError("every parameter is fixed: leave one free.")
        for each in self.range:
            one_of("free parameter", each, names)
        space = contract.space.subset(names)
        return tuple(narrowed(p, *self.range[p.name]) if p.name in self.range else p for p in space)

    def fixed(self, contract: Contract) -> dict[str, Any]:
        """Values of the parameters that are not varied."""
        free = {p.name for p in self.varied(contract)}
        held = {n: v for n, v in contract.space.defaults.items() if n not in free}
        for name, text in self.fix.items():
            p = contract.space[name]
            held[name] = p.show(p.check(_number(text)))
        return held


def _number(text: Any) -> Any:
    try:
        return float(text)
    except (TypeError, ValueError):
        return text
