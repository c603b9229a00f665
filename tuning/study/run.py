"""Optuna studies over a `ParameterSpace`: seeded, resumable, parallel, and never mixed up.

Trials are asked for, evaluated and told in batches, so that a study is the same whether one process
evaluates a batch or eight do. A sampler is seeded by (seed, finished trials), so an interrupted and
continued study ends where an uninterrupted one does. A study made for another goal is refused.
Several processes may work on one study in a database; then its trials depend on who was quicker.
"""

from __future__ import annotations

import contextlib
import datetime as dt
import math
import os
import platform
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from optuna.exceptions import UpdateFinishedTrialError
from optuna.storages import BaseStorage
from optuna.trial import FrozenTrial, TrialState
from tqdm import tqdm

from navgym.core.checks import one_of, positive_int
from navgym.core.parameters import ParameterSpace
from navgym.metrics.measures import METRICS
from navgym.tuning.objectives import Evaluation, Goal, InstanceGoal
from navgym.tuning.study import racing
from navgym.tuning.study.identity import enqueue, open_study
from navgym.tuning.study.search_space import SAMPLERS, distributions, from_optuna, sampler_of
from navgym.tuning.study.storage import (
    GRACE,
    HEARTBEAT,
    Where,
    is_url,
    opened,
    put_back,
    record_life,
    settle,
    signs_of_life,
    try_again,
    unreachable,
)

STUDY = "navgym"  # the usual name: one study per journal
# attributes of trials: losses per instance, instances seen before the trial was given up, its worker,
# what went wrong on the way
LOSSES, GIVEN_UP, WORKER, FAILED = "losses", "given up after", "worker", "failed"
POLL = 0.5  # s between looks at a study whose last trials others are running


@dataclass(frozen=True)
class Trial:
    """One finished evaluation.

    Args:
        number: of the trial in its study.
        values: parameters as a user writes them.
        result: what was minimised; an estimate where the trial was given up.
        cost: µs per filter step, where that was minimised as well.
        given_up: whether it was pruned: seen to be worse than the best before all instances.
        feasible: whether it keeps every limit.
        failed: what went wrong, a line for each instance that could not be evaluated.
    """

    number: int
    values: Mapping[str, Any]
    result: float
    cost: float | None = None
    given_up: bool = False
    feasible: bool = True
    failed: tuple[str, ...] = ()


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
        """The trial with the smallest result, the first of equals; of the feasible ones if any is."""
        return min(self.trials, key=lambda t: (not t.feasible, t.given_up, t.result))

    @property
    def front(self) -> tuple[Trial, ...]:
        """Trials that no other beats in both result and cost, the cheapest first."""
        front: list[Trial] = []
        for t in sorted(self.trials, key=lambda t: (t.cost or 0.0, t.result)):
            if t.feasible and (not front or t.result < front[-1].result):
                front.append(t)
        return tuple(front)


class Interrupted(Exception):  # noqa: N818 - it is no error
    """Ctrl-C ended the study: `outcome` is what it found."""

    def __init__(self, outcome: Outcome) -> None:
        super().__init__("the study was interrupted")
        self.outcome = outcome


@dataclass(frozen=True)
class Search:
    """How a study is run.

    Args:
        trials: finished trials to end with, those of earlier runs counted in.
        seed: of the sampler and of the order of instances.
        sampler: a name of `navgym.tuning.study.search_space.SAMPLERS`.
        batch: trials asked for at once; more than one keeps as many workers busy.
        prune: whether a trial that is surely worse than the best is given up on the way: Wilcoxon's
            signed-rank test on the instances that both have seen.
        study: its name in a database.
        heartbeat: s between a database worker's signs of life.
        grace: s of silence after which its trials are tried again by others.
    """

    trials: int
    seed: int = 0
    sampler: str = "tpe"
    batch: int = 1
    prune: bool = False
    study: str = STUDY
    heartbeat: int = HEARTBEAT
    grace: int = GRACE

    def __post_init__(self) -> None:
        for name in ("trials", "batch", "heartbeat", "grace"):
            positive_int(name, getattr(self, name))
        positive_int("seed", self.seed, least=0)
        one_of("sampler", self.sampler, SAMPLERS)

    @property
    def identity(self) -> dict[str, Any]:
        """What decides the trials of a study, beside its goal."""
        return {name: getattr(self, name) for name in ("seed", "sampler", "batch", "prune")}


def search(
    goal: Goal,
    trials: int | Search,
    seed: int = 0,
    journal: Where = None,
    first: Sequence[Mapping[str, Any]] = (),
    label: str = "tuning",
    progress: bool = True,
    executor: Executor | None = None,
) -> Outcome:
    """Minimise `goal` until the study holds the finished trials asked for.

    Args:
        goal: see `navgym.tuning.objectives.Goal`; an `InstanceGoal` can be evaluated in parts.
        trials: how many, or how to search.
        seed: of the sampler, if `trials` is a number; the same seed gives the same trials,
            interrupted or not, serial or parallel.
        journal: file or database URL that keeps the study; None keeps it in memory.
        first: parameter sets to try right after the defaults, such as an earlier best.
        label: what the progress bar calls it.
        progress: whether to show one.
        executor: where trials are evaluated; here, one after the other, by default. `goal` must
            then be one that can be pickled.

    Raises:
        ValueError: fewer than one trial, a study of another goal, or a damaged one.
        OSError: storage that cannot be reached or written; what was finished is kept.
        KeyboardInterrupt: Ctrl-C before the first trial finished, or a second Ctrl-C; the first
            one ends the search after the trials at hand, with what was found.
    """
    how = trials if isinstance(trials, Search) else Search(trials, seed)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    with (
        _named_errors(journal),
        opened(journal, how.heartbeat, how.grace) as storage,
        _deferred_interrupt() as stop,
    ):
        run = _Run(
            goal,
            how,
            open_study(goal, how.identity, how.study, journal, storage),
            storage,
            executor,
            is_url(journal),
        )
        run.enqueue(first)
        with tqdm(total=how.trials, desc=label, disable=not progress) as bar:
            run.show(bar)
            while not stop.is_set() and run.once(stop):
                run.show(bar)
            run.show(bar)
        found = run.finished()
    if not found:
        raise KeyboardInterrupt
    return Outcome(tuple(found), stop.is_set())


@contextlib.contextmanager
def _named_errors(where: Where) -> Iterator[None]:
    """A database's own errors as OSError with a remedy."""
    from sqlalchemy.exc import SQLAlchemyError

    try:
        yield
    except SQLAlchemyError as error:
        raise unreachable(where, error) from error
    except optuna.exceptions.StorageInternalError as error:
        raise unreachable(where, error.__cause__ or error) from error


@dataclass(eq=False)
class _Run:
    """One process's work on a study."""

    goal: Goal
    how: Search
    study: optuna.Study
    storage: BaseStorage
    executor: Executor | None
    shared: bool  # whether others may work on the study at the same time
    leader: racing.Leader | None = None  # whom the batch at hand is held against
    looked: float = -math.inf  # when others' signs of life were last looked at

    def enqueue(self, first: Sequence[Mapping[str, Any]]) -> None:
        """Put the defaults and `first` in line, and what a process that died left behind."""
        if not self.shared:
            for trial in self._of(TrialState.RUNNING):
                self._again(trial)
        space = self.goal.space
        for values in ({}, *first):
            enqueue(self.study, space, space.defaults | dict(values))

    def once(self, stop: threading.Event) -> bool:
        """One batch, or one look at those whom others run; False when nothing is left to do."""
        if self.shared:
            self._reclaim()
        asked = self._ask()
        if not asked:
            if len(self._of(TrialState.COMPLETE)) >= self.how.trials:
                return False
            time.sleep(POLL)
            return True
        with signs_of_life(self.storage, [t._trial_id for t in asked], self.how.heartbeat):
            try:
                self._work(asked)
            except KeyboardInterrupt:
                self._fail(asked)
                if stop.is_set():
                    raise
                stop.set()
            except BaseException:
                self._fail(asked)
                raise
        return True

    def _work(self, asked: Sequence[optuna.Trial]) -> None:
        """Evaluate a batch and tell the study, in order."""
        for trial, (found, seen) in zip(asked, self._evaluate(asked), strict=True):
            self._tell(trial, found, seen)
        settle(self.storage)

    # ---- asking

    def _ask(self) -> list[optuna.Trial]:
        """The next trials of this process: fewer than a batch near the end, none if all are taken."""
        begun = self._of(TrialState.COMPLETE, TrialState.RUNNING)
        taken, done = len(begun), sum(t.state == TrialState.COMPLETE for t in begun)
        # alone, a batch that was interrupted is completed before the next one begins
        size = self.how.batch if self.shared else self.how.batch - done % self.how.batch
        asked = []
        for i in range(max(0, min(size, self.how.trials - taken))):
            trial = self._next(done + i)
            if not self.shared or self._claim(trial):
                asked.append(trial)
        return asked

    def _next(self, place: int) -> optuna.Trial:
        """The trial at the head of the line, or a new one; `place`: trials before it."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Heartbeat of storage")  # we see to it ourselves
            trial = self.study.ask()
        # processes that ask at the same moment must not draw the same: their numbers differ
        count = trial.number if self.shared else place
        space = distributions(self.goal.space)
        self.study.sampler = sampler_of(self.how.sampler, self.how.seed, count, space)
        for name, distribution in space.items():
            trial._suggest(name, distribution)
        return trial

    def _claim(self, trial: optuna.Trial) -> bool:
        """Let others know who works on a trial; False if it is not needed, or taken from us."""
        try:
            record_life(self.storage, trial._trial_id)  # or no one would notice our death
            trial.set_user_attr(WORKER, f"{platform.node()}:{os.getpid()}")
        except UpdateFinishedTrialError:
            return False
        if self._surplus(trial.number):
            self.study.tell(trial, state=TrialState.FAIL, skip_if_finished=True)
            return False
        return True

    def _surplus(self, number: int) -> bool:
        """Whether others took the last places while this trial was asked for."""
        taken = self._of(TrialState.COMPLETE, TrialState.RUNNING)
        return sum(t.number < number for t in taken) >= self.how.trials

    # ---- evaluating

    def _evaluate(self, asked: Sequence[optuna.Trial]) -> list[tuple[Any, Any]]:
        """(evaluation or number, instances seen) of each trial, in their order."""
        sets = [from_optuna(self.goal.space, t.params) for t in asked]
        goal = self.goal
        if not isinstance(goal, InstanceGoal):
            return [(found, None) for found in self._map([(goal, v, None) for v in sets])]
        self.leader = self._find_leader() if self.how.prune else None
        done = len(self._of(TrialState.COMPLETE))
        orders = [
            racing.order(len(goal), self.how.seed, done + i, self.leader is not None)
            for i in range(len(sets))
        ]
        return racing.race(goal, sets, orders, self.leader, self._map)

    def _map(self, calls: Sequence[tuple[Any, ...]]) -> list[Any]:
        """`racing.evaluate` of every call, where evaluations are made."""
        if self.executor is None:
            return [racing.evaluate(*call) for call in calls]
        futures = [self.executor.submit(racing.evaluate, *call) for call in calls]
        try:
            return [f.result() for f in futures]
        finally:
            for f in futures:
                f.cancel()

    def _find_leader(self) -> racing.Leader | None:
        """The best trial that has seen every instance, of those before the batch at hand."""
        finished = self._of(TrialState.COMPLETE)
        if not self.shared:  # a batch that was cut in two has one leader all the same
            finished = finished[: len(finished) // self.how.batch * self.how.batch]
        best, found = math.inf, None
        for t in finished:
            if GIVEN_UP in t.user_attrs or LOSSES not in t.user_attrs or not _feasible(t):
                continue
            if t.values[0] < best:
                best, found = t.values[0], t
        return None if found is None else racing.Leader(best, np.array(found.user_attrs[LOSSES]))

    # ---- telling

    def _tell(self, trial: optuna.Trial, found: Any, seen: Any) -> None:
        with contextlib.suppress(UpdateFinishedTrialError):
            # another process may have taken us for dead and tried this trial again: its word counts
            if isinstance(found, Evaluation):
                for name, value in found.constraints.items():
                    trial.set_constraint(name, value)
                if found.failed:
                    trial.set_user_attr(FAILED, list(found.failed))
                value = self._statistic(trial, found, seen)
                costed = getattr(self.goal, "costed", False)
                found = (value, found.microseconds) if costed else value
            self.study.tell(trial, found, skip_if_finished=True)

    def _statistic(self, trial: optuna.Trial, found: Evaluation, seen: Any) -> float:
        """The goal's metric; for a trial that was given up, what it would have come to."""
        metric = METRICS[self.goal.metric]  # type: ignore[attr-defined]
        if len(seen) < len(self.goal):  # type: ignore[arg-type]
            trial.set_user_attr(GIVEN_UP, len(seen))
            assert self.leader is not None
            change = float(metric(found.losses)) - float(metric(self.leader.losses[seen]))
            return self.leader.value + max(change, 0.0)
        losses = np.empty(len(seen))
        losses[seen] = found.losses
        trial.set_user_attr(LOSSES, losses.tolist())
        return float(metric(losses))

    def _fail(self, asked: Sequence[optuna.Trial]) -> None:
        """Put unfinished trials back in line, as far as the storage still answers."""
        with contextlib.suppress(Exception):  # the error that matters is on its way
            open_ = {t.number: t for t in self._of(TrialState.RUNNING)}
            for trial in asked:
                if trial.number in open_:
                    self._again(open_[trial.number])

    # ---- workers that died

    def _again(self, trial: FrozenTrial) -> None:
        """Put a trial that was begun back in line."""
        if self.shared:
            try_again(self.study, trial)
        else:
            put_back(self.study, trial, list(distributions(self.goal.space)))

    def _reclaim(self) -> None:
        """Put back in line what silent workers hold, if it is time to look again."""
        if time.monotonic() - self.looked < self.how.heartbeat:
            return
        self.looked = time.monotonic()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            optuna.storages.fail_stale_trials(self.study)
        late = dt.datetime.now() - dt.timedelta(seconds=self.how.grace)
        for t in self._of(TrialState.RUNNING):
            # killed between asking and its first sign of life, which Optuna never takes for dead
            if WORKER not in t.user_attrs and t.datetime_start and t.datetime_start < late:
                self._again(t)

    # ---- reading

    def _of(self, *states: TrialState) -> list[FrozenTrial]:
        return self.study.get_trials(deepcopy=False, states=states)

    def finished(self) -> list[Trial]:
        """The finished trials as a user reads them."""
        return [_readable(self.goal.space, t) for t in self._of(TrialState.COMPLETE)]

    def show(self, bar: Any) -> None:
        """Move the progress bar to where the study stands."""
        if bar.disable:
            return
        found = self._of(TrialState.COMPLETE)
        bar.n = len(found)
        values = [t.values[0] for t in found if GIVEN_UP not in t.user_attrs and _feasible(t)]
        if values:
            bar.set_postfix_str(f"best {min(values):.4g}", refresh=False)
        bar.update(0)


def _readable(space: ParameterSpace, t: FrozenTrial) -> Trial:
    values = from_optuna(space, t.params)
    cost = t.values[1] if len(t.values) > 1 else None
    failed = tuple(t.user_attrs.get(FAILED, ()))
    return Trial(
        t.number, values, t.values[0], cost, GIVEN_UP in t.user_attrs, _feasible(t), failed
    )


def _feasible(trial: FrozenTrial) -> bool:
    return all(v <= 0.0 for v in trial.constraints.values())


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
