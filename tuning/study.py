"""Optuna studies over a `ParameterSpace`: seeded, resumable, and never mixed up.

A study lives in a journal file. The same call continues it to the number of finished trials asked
for; the sampler is seeded by (seed, finished trials), so an interrupted and continued study ends
where an uninterrupted one does. A journal made for another goal is refused.
"""

from __future__ import annotations

import contextlib
import json
import math
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.storages import BaseStorage, InMemoryStorage, JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState
from tqdm import tqdm

from navgym._checks import positive_int
from navgym.parameters import Parameter, ParameterSpace
from tuning.objective import Goal

STUDY = "navgym"  # one study per journal
GOAL = "navgym goal"  # the study's attribute that says what it is for
STARTUP_TRIALS = 15  # random trials before the model takes over, the enqueued ones included


@dataclass(frozen=True)
class Trial:
    """One finished evaluation: its number, its parameters as a user writes them, what came out."""

    number: int
    values: Mapping[str, Any]
    result: float


@dataclass(frozen=True)
class Outcome:
    """What a study found.

    Args:
        trials: all finished ones, in order.
        interrupted: whether Ctrl-C ended it before the number asked for.
    """

    trials: tuple[Trial, ...]
    interrupted: bool = False

    def complete(self) -> Outcome:
        """The outcome itself; KeyboardInterrupt if Ctrl-C ended the study."""
        if self.interrupted:
            raise KeyboardInterrupt
        return self

    @property
    def best(self) -> Trial:
        """The trial with the smallest result, the first of equals."""
        return min(self.trials, key=lambda t: t.result)


def search(
    goal: Goal,
    trials: int,
    seed: int = 0,
    journal: Path | None = None,
    first: Sequence[Mapping[str, Any]] = (),
    label: str = "tuning",
    progress: bool = True,
) -> Outcome:
    """Minimise `goal` until the study holds `trials` finished trials.

    Args:
        goal: see `tuning.objective.Goal`.
        trials: finished trials to end with, those of earlier runs counted in.
        seed: of the sampler; the same seed gives the same trials, interrupted or not.
        journal: file that keeps the study; None keeps it in memory.
        first: parameter sets to try right after the defaults, such as an earlier best.
        label: what the progress bar calls it.
        progress: whether to show one.

    Raises:
        ValueError: fewer than one trial, a journal of another goal, or a damaged one.
        KeyboardInterrupt: Ctrl-C before the first trial finished, or a second Ctrl-C; the first
            one ends the search after the trial at hand, with what was found.
    """
    positive_int("trials", trials)
    space = goal.space
    study = _open(goal, seed, journal)
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(trial.number, state=TrialState.FAIL)  # left by a run that was killed
    for values in ({}, *first):
        _enqueue(study, space, space.defaults | dict(values))
    count = _finished(study)
    with (
        _deferred_interrupt() as stop,
        tqdm(total=trials, initial=min(count, trials), desc=label, disable=not progress) as bar,
    ):
        while count < trials and not stop.is_set():
            _evaluate(study, goal, seed, count, stop)
            count = _finished(study)
            bar.n = count
            if count:
                bar.set_postfix_str(f"best {study.best_value:.4g}", refresh=False)
            bar.update(0)
    if count == 0:
        raise KeyboardInterrupt
    return Outcome(tuple(_trials(study, space)), stop.is_set())


def _evaluate(
    study: optuna.Study, goal: Goal, seed: int, count: int, stop: threading.Event
) -> None:
    """Run one more trial; one that ends in an error or an interrupt is marked as failed."""
    study.sampler = _sampler(seed, count)
    trial = study.ask(distributions(goal.space))
    try:
        study.tell(trial, goal(from_optuna(goal.space, trial.params)))
    except BaseException as error:
        with contextlib.suppress(Exception):  # the error that matters is on its way
            study.tell(trial, state=TrialState.FAIL, skip_if_finished=True)
        if not isinstance(error, KeyboardInterrupt):
            raise
        stop.set()


@contextlib.contextmanager
def _deferred_interrupt() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C sets, so that no write is torn; the second one interrupts."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop  # signals reach the main thread only
        return

    def handle(*_: object) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()
        tqdm.write("stopping after this trial (Ctrl-C again: at once)", file=sys.stderr)

    before = signal.signal(signal.SIGINT, handle)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)


def _sampler(seed: int, count: int) -> optuna.samplers.BaseSampler:
    """A fresh sampler per trial: its draws depend on the history alone, not on who resumed it."""
    words = np.random.SeedSequence([seed, count]).generate_state(1)
    return optuna.samplers.TPESampler(
        seed=int(words[0]), multivariate=True, n_startup_trials=STARTUP_TRIALS
    )


# ---- between a ParameterSpace and Optuna


def distributions(space: ParameterSpace) -> dict[str, BaseDistribution]:
    """Optuna's search space. A log-complement parameter is searched as "1 - name", on a log scale."""
    return dict(_distribution(p) for p in space)


def _distribution(p: Parameter) -> tuple[str, BaseDistribution]:
    if p.choices:
        return p.name, CategoricalDistribution(p.choices)
    if p.integer:
        return p.name, IntDistribution(round(p.low), round(p.high), log=p.scale == "log")
    if p.scale == "log-complement":
        return f"1 - {p.name}", FloatDistribution(1.0 - p.high, 1.0 - p.low, log=True)
    return p.name, FloatDistribution(p.low, p.high, log=p.scale == "log")


def to_optuna(space: ParameterSpace, values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters as Optuna names them."""
    named = {}
    for p in space:
        value = p.show(p.check(values[p.name]))
        complement = p.scale == "log-complement"
        named[_distribution(p)[0]] = 1.0 - float(value) if complement else value
    return named


def from_optuna(space: ParameterSpace, params: Mapping[str, Any]) -> dict[str, Any]:
    """Inverse of `to_optuna`."""
    values = {}
    for p in space:
        found = params[_distribution(p)[0]]
        if p.scale == "log-complement":
            found = min(max(1.0 - found, p.low), p.high)
        values[p.name] = p.show(p.check(found))
    return values


# ---- the journal


def _open(goal: Goal, seed: int, journal: Path | None) -> optuna.Study:
    """The study of `goal`, new or continued."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    storage: BaseStorage = InMemoryStorage() if journal is None else _storage(journal)
    purpose = _purpose(goal, seed)
    known = {summary.study_name for summary in optuna.get_all_study_summaries(storage=storage)}
    if known - {STUDY}:
        raise ValueError(
            f"{journal} holds the study {sorted(known)[0]!r}, which navgym did not make: "
            "name another file."
        )
    study = optuna.create_study(storage=storage, study_name=STUDY, load_if_exists=True)
    found = study.user_attrs.get(GOAL)
    if found is None:
        study.set_user_attr(GOAL, purpose)
    elif found != purpose:
        raise ValueError(
            f"{journal} belongs to another search.\n  it holds: {_line(found, purpose)}\n"
            f"  asked for: {_line(purpose, found)}\nName another folder, or move the file away."
        )
    return study


def _purpose(goal: Goal, seed: int) -> dict[str, Any]:
    """What makes two searches the same, as JSON gives it back."""
    space = [
        f"{p.name} {'|'.join(p.choices) if p.choices else f'{p.low:g}..{p.high:g} {p.scale}'}"
        for p in goal.space
    ]
    text = json.dumps({"space": space, "goal": dict(goal.about), "seed": seed})
    purpose: dict[str, Any] = json.loads(text)
    return purpose


def _line(one: Any, other: Any) -> str:
    """The parts of `one` that `other` does not share, on one line."""
    if isinstance(one, dict) and isinstance(other, dict):
        own = {k: v for k, v in one.items() if other.get(k) != v}
        return "; ".join(f"{k}: {_line(v, other.get(k))}" for k, v in own.items()) or "less"
    return ", ".join(map(str, one)) if isinstance(one, list) else str(one)


def _storage(journal: Path) -> JournalStorage:
    """The journal file as Optuna's storage, its damaged last line cut off.

    Raises ValueError, naming the line, for a file that is damaged elsewhere or no journal.
    """
    journal.parent.mkdir(parents=True, exist_ok=True)
    if journal.exists():
        _check(journal)
    try:
        # absolute: Optuna's lock is a link that is resolved from its own folder
        return JournalStorage(JournalFileBackend(str(journal.resolve())))
    except (ValueError, KeyError, TypeError, AssertionError, AttributeError) as error:
        raise ValueError(
            f"{journal} is no Optuna journal ({type(error).__name__}: {error}): name another file."
        ) from error


def _check(journal: Path) -> None:
    """Drop a last line that a kill or a full disk cut short; ValueError for other damage."""
    content = journal.read_bytes()
    whole = content.rfind(b"\n") + 1
    for number, line in enumerate(content[:whole].splitlines(), start=1):
        try:
            entry = json.loads(line)
        except ValueError:
            entry = None
        if not isinstance(entry, dict) or "op_code" not in entry:
            raise ValueError(
                f"{journal} is damaged at line {number}: {line[:60]!r} is no journal entry. "
                "Move the file away to start anew, or cut it off before that line to keep the rest."
            )
    if whole < len(content):
        with journal.open("rb+") as file:
            file.truncate(whole)


def _enqueue(study: optuna.Study, space: ParameterSpace, values: Mapping[str, Any]) -> None:
    """Put `values` next in line, unless they wait there or were evaluated."""
    wanted = to_optuna(space, values)
    for trial in study.get_trials(deepcopy=False, states=(TrialState.WAITING, TrialState.COMPLETE)):
        if _same(trial.system_attrs.get("fixed_params", trial.params), wanted):
            return
    study.enqueue_trial(wanted)


def _same(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    return one.keys() == other.keys() and all(
        math.isclose(one[k], other[k], rel_tol=1e-9) if isinstance(other[k], float) else one[k] == other[k]
        for k in other
    )  # fmt: skip


def _finished(study: optuna.Study) -> int:
    return len(study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)))


def _trials(study: optuna.Study, space: ParameterSpace) -> list[Trial]:
    found: list[FrozenTrial] = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return [
        Trial(t.number, from_optuna(space, t.params), t.value) for t in found if t.value is not None
    ]
