"""A study of a program from beginning to end: look, tune, choose, compare on held-out logs, keep it."""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.core.storage import read_toml
from navgym.metrics.measures import Measure
from navgym.tuning.programs import look
from navgym.tuning.programs.comparison import compared
from navgym.tuning.programs.contract import Contract
from navgym.tuning.programs.intervals import Fit, fitted
from navgym.tuning.programs.objective import Part, ProgramGoal
from navgym.tuning.programs.runner import Failed
from navgym.tuning.programs.scoring import (
    BLOCKS,
    blocks_of,
    chosen,
)
from navgym.tuning.programs.settings import ProgramSettings
from navgym.tuning.programs.tools import Function, Log, Program, Runs, Tool
from navgym.tuning.stages import CHOSEN, TUNED, Stages
from navgym.tuning.study.executors import workers
from navgym.tuning.study.run import Interrupted, Outcome, Search, Trial, search
from navgym.tuning.study.sensitivity import importances, sweeps
from navgym.tuning.tune import Findings, choose, evaluated, held_by

REPORT = "held-out logs"
Spans = tuple[float, float]


@dataclass(frozen=True, eq=False)
class ProgramFindings(Findings):
    """What a study of a program found.

    Args:
        contract: parameters and columns.
        twice: whether the program says the same twice.
        lost: logs on which the defaults do not run, and why.
        fit: the maximum of the likelihood; None where another measure was minimised.
        failures: kinds of failed runs of the trials, and how many of each.
        examples: one of each kind, in words.
    """

    contract: Contract = field(default_factory=lambda: Contract(ParameterSpace(())))
    twice: look.Repeatability = field(default_factory=look.Repeatability)
    lost: Mapping[str, str] = field(default_factory=dict)
    fit: Fit | None = None
    failures: Mapping[str, int] = field(default_factory=dict)
    examples: Mapping[str, str] = field(default_factory=dict)

    @property
    def space(self) -> ParameterSpace:
        """Every parameter that the contract declares."""
        return self.contract.space

    @property
    def winner(self) -> dict[str, Any]:
        """The winner's parameters, the fixed ones included."""
        assert isinstance(self.goal, ProgramGoal)
        return dict(self.goal.fixed) | dict(self.chosen.values)

    @property
    def values(self) -> dict[str, Any]:
        """The parameters to use: the winner's, or the defaults where it does not hold."""
        if not self.held.kept_default:
            return self.winner
        return self.winner | {n: self.space.defaults[n] for n in self.chosen.values}

    @property
    def model(self) -> dict[str, Any]:
        """Nothing: a program's parameters stand for themselves."""
        return {}

    def time(self, name: str) -> tuple[Array, str]:
        """Middles of the stretches, as shares of a log."""
        del name
        return (np.arange(BLOCKS) + 0.5) / BLOCKS, "share of the log"

    @property
    def usage(self) -> str:
        """How the file of tuned parameters is used."""
        return f"navgym export tuned.toml --as {self.contract.format}"


def run(
    settings: ProgramSettings,
    call: Callable[..., Any] | None = None,
    recordings: Mapping[str, Sequence[Any]] | None = None,
    contract: Contract | None = None,
) -> ProgramFindings:
    """The whole of it.

    Args:
        settings: what is asked for.
        call: a function to tune in place of settings.program.
        recordings: what it runs on in place of the logs: "log", "select_log", "report_log".
        contract: in place of settings.parameters.

    Raises:
        Interrupted: Ctrl-C during the study; its finished trials are kept.
        ValueError: settings that do not fit together, a program that gives nothing to judge.
        OSError: files or storage that cannot be read or written.
    """
    contract = contract or _contract(settings)
    free = ParameterSpace(settings.varied(contract))
    tool = _tool(settings, call, contract)
    fixed, runs = settings.fixed(contract), Runs(settings.out / "runs")
    logs, spans, split = shared_out(settings, recordings)
    defaults = contract.space.defaults | fixed
    first = _first(settings, contract, free)
    with workers(settings.processes, settings.scheduler) as executor:
        mapped = functools.partial(_mapped, executor)
        every = {log.digest: log for each in logs for log in each}
        rulers, lost = look.rulers(
            tool,
            runs,
            list(every.values()),
            defaults,
            functools.partial(mapped, "looking at the defaults"),
        )
        kinds = next(iter(rulers.values())).kinds
        measure = chosen(settings.measure, kinds, contract.columns.unit)
        priors = _priors(settings, contract, free, measure)
        stages = []
        for name, each, span in zip(
            ("tune on", "choose on", "report on"), logs, spans, strict=True
        ):
            parts = judged(tool, runs, each, rulers, defaults, measure, span, lost)
            if not parts:
                raise ValueError(
                    f"no log is left to {name}: {'; '.join(f'{k}: {v}' for k, v in lost.items())}"
                )
            stages.append(parts)
        for log_name, why in lost.items():
            tqdm.write(f"left out, since the defaults fail there: {log_name}: {why}")
        goal = ProgramGoal(tool, free, fixed, stages[0], measure, settings.metric, runs, priors)
        twice = look.repeatability(
            tool, runs, [p.log for p in stages[0]], rulers, defaults, measure.name, settings.repeats,
            functools.partial(mapped, "running the defaults again"),
        )  # fmt: skip
        outcome = _study(settings, goal, executor, first)
        fit = None
        if measure.name == "likelihood" and settings.metric == "mean":
            fit = fitted(goal, outcome.best.values, functools.partial(mapped, "refining"))
            outcome = _with(outcome, goal, fit)
        fresh = goal.on(stages[1])
        winner = choose(outcome, fresh, executor)
        run_all = functools.partial(evaluated, executor, "sweeping")
        swept = sweeps(fresh.on(stages[1], {}), winner.values, run_all, relative=measure.relative)
        report = compared(
            settings.filter,
            goal.on(stages[2], {}),
            contract,
            winner,
            first,
            functools.partial(mapped, "reporting"),
        )
    failures, examples = _failures(outcome)
    own, usual = (f"{settings.filter}, {which}" for which in ("tuned", "default"))
    pair = tuple(
        math.inf if report[label].diverges else report[label].mean for label in (own, usual)
    )
    made = [{"logs": parts} for parts in stages]
    return ProgramFindings(
        settings, goal, outcome, winner,
        Stages(made[0], made[1], made[2], split),  # type: ignore[arg-type]
        {REPORT: report}, swept, importances(outcome, free), held_by({REPORT: (pair[0], pair[1])}, measure),
        None, contract, twice, lost, fit, failures, examples,
    )  # fmt: skip


def _contract(settings: ProgramSettings) -> Contract:
    if settings.parameters is None:
        raise ValueError(
            "--parameters must name a TOML file that declares them: see navgym tune --program --help."
        )
    return Contract.load(settings.parameters)


def _tool(settings: ProgramSettings, call: Callable[..., Any] | None, contract: Contract) -> Tool:
    if call is not None:
        return Function(call, contract.columns)
    if not settings.program:
        raise ValueError(
            '--program must be a command: --program "./replay {parameters} {log} {out}".'
        )
    return Program.of(settings.command(), contract, settings.also)


def _mapped(
    executor: Executor | None,
    label: str,
    function: Callable[..., Any],
    calls: Sequence[tuple[Any, ...]],
) -> list[Any]:
    """`function` of every call, with a progress bar where it takes its time."""
    if executor is None:
        return [function(*call) for call in tqdm(calls, desc=label, delay=2.0)]
    futures = [executor.submit(function, *call) for call in calls]
    return [f.result() for f in tqdm(futures, desc=label, delay=2.0)]


# ---- logs


def shared_out(
    settings: ProgramSettings, recordings: Mapping[str, Sequence[Any]] | None = None
) -> tuple[list[list[Log]], list[Spans], str]:
    """Logs to tune on, to choose on and to report on; the shares of each that count; and that in words."""
    given = recordings or {
        "log": settings.log,
        "select_log": settings.select_log,
        "report_log": settings.report_log,
    }
    own, select, report = (
        [Log.of(each, i + 1) for i, each in enumerate(given.get(name, ()))]
        for name in ("log", "select_log", "report_log")
    )
    if not own:
        raise ValueError("--log must name at least one log to tune on, got none.")
    twice = Counter(log.digest for log in (*own, *select, *report))
    for log in (*own, *select, *report):
        if twice[log.digest] > 1:
            raise ValueError(
                f"{log.name} holds what another of the logs holds: a copy cannot judge."
            )
    whole = (0.0, 1.0)
    if select and report:
        return (
            [own, select, report],
            [whole] * 3,
            "tuned on some logs, chosen on others, reported on a third set",
        )
    if not select and not report and len(own) >= 3:
        last = max(len(own) - max(len(own) // 3, 1), 2)
        first = max(last - max(len(own) // 5, 1), 1)
        names = [
            ", ".join(log.name for log in part)
            for part in (own[:first], own[first:last], own[last:])
        ]
        return (
            [own[:first], own[first:last], own[last:]], [whole] * 3,
            f"tuned on {names[0]}; chosen among the leaders on {names[1]}; reported on {names[2]}",
        )  # fmt: skip
    carried = "A filter carries its state across such a cut: other logs (--select-log, --report-log) judge better"
    if report:
        return (
            [own, own, report], [(0.0, CHOSEN), (CHOSEN, 1.0), whole],
            f"tuned on the first {CHOSEN:.0%} of each log, chosen among the leaders on the rest, reported on "
            f"other logs. {carried}",
        )  # fmt: skip
    if select:
        return (
            [own, select, own], [(0.0, CHOSEN), whole, (CHOSEN, 1.0)],
            f"tuned on the first {CHOSEN:.0%} of each log, chosen among the leaders on other logs, reported on "
            f"the rest. {carried}",
        )  # fmt: skip
    return (
        [own, own, own], [(0.0, TUNED), (TUNED, CHOSEN), (CHOSEN, 1.0)],
        f"each log is cut in time: tuned on the first {TUNED:.0%}, chosen among the leaders up to {CHOSEN:.0%}, "
        f"reported on the rest. {carried}",
    )  # fmt: skip


def judged(
    tool: Tool, runs: Runs, logs: Sequence[Log], rulers: Mapping[str, Any], defaults: Mapping[str, Any],
    measure: Measure, share: Spans, lost: dict[str, str],
) -> tuple[Part, ...]:  # fmt: skip
    """Parts of the logs on which the defaults can be judged; the others go to `lost`."""
    made, span = [], blocks_of(share)
    for log in logs:
        if log.digest not in rulers:
            continue
        ruler = rulers[log.digest]
        try:
            plain = runs.of(tool, log, defaults, ruler).loss(measure.name, ruler, span)
            if not math.isfinite(plain):
                raise Failed("not finite", f"the {measure.label} of the defaults")
        except Failed as error:
            lost[log.name] = f"between {share[0]:.0%} and {share[1]:.0%} of it: {error}"
            continue
        made.append(Part(log, ruler, span, plain))
    return tuple(made)


# ---- the study


def _priors(
    settings: ProgramSettings, contract: Contract, free: ParameterSpace, measure: Measure
) -> dict[str, float]:
    if not settings.prior:
        return {}
    found = {n: p for n, p in contract.priors.items() if n in free.names}
    if measure.name != "likelihood" or settings.metric != "mean":
        raise ValueError(
            "--prior needs a likelihood, and its mean: a prior has no weight against another measure."
        )
    if not found:
        raise ValueError(
            "--prior: no free parameter declares one: write prior = 2.0 into its table."
        )
    return found


def _first(
    settings: ProgramSettings, contract: Contract, free: ParameterSpace
) -> list[dict[str, Any]]:
    """The earlier result to try right after the defaults, moved inside the ranges."""
    if settings.start is None:
        return []
    told = read_toml(settings.start).get("parameters")
    if not isinstance(told, Mapping):
        raise ValueError(f"{settings.start} holds no table [parameters]: start from another file.")  # noqa: TRY004 - a file's fault
    moved = {}
    for name, each in told.items():
        p = contract.space[name]
        if name in free.names:
            own = free[name]
            number = own.check(each) if isinstance(each, str) else float(each)
            moved[name] = own.show(min(max(number, own.low), own.high))
        else:
            p.check(each)
    return [moved]


def _study(
    settings: ProgramSettings,
    goal: ProgramGoal,
    executor: Executor | None,
    first: Sequence[Mapping[str, Any]],
) -> Outcome:
    how = Search(
        settings.trials, settings.seed, settings.sampler, settings.batch,
        settings.prune and settings.metric != "quantile 95 %", settings.study,
    )  # fmt: skip
    where: Path | str = settings.storage or settings.out / "study.log"
    where = where if "://" in str(where) else Path(where)
    outcome = search(goal, how, journal=where, first=first, executor=executor)
    if outcome.interrupted:
        raise Interrupted(outcome)
    return outcome


def _with(outcome: Outcome, goal: ProgramGoal, fit: Fit | None) -> Outcome:
    """The trials and the refined maximum, as one more."""
    if fit is None:
        return outcome
    number = max(t.number for t in outcome.trials) + 1
    result = goal(fit.values)
    if not result < outcome.best.result:
        return outcome
    return replace(outcome, trials=(*outcome.trials, Trial(number, fit.values, result)))


def _failures(outcome: Outcome) -> tuple[dict[str, int], dict[str, str]]:
    """Kinds of failed runs with their number, and an example of each."""
    counted: Counter[str] = Counter()
    examples: dict[str, str] = {}
    for trial in outcome.trials:
        for line in trial.failed:
            kind = line.split(": ", 2)[1] if ": " in line else line
            counted[kind] += 1
            shown = ", ".join(
                f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}"
                for k, v in trial.values.items()
            )
            examples.setdefault(kind, f"trial {trial.number} ({shown}), {line}")
    return dict(counted), examples
