"""Goals whose values are known in closed form, and processes that search them."""

import argparse
import multiprocessing
import os
import resource
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import navgym
from navgym.tuning.objectives import Evaluation
from navgym.tuning.study import run as study
from navgym.tuning.study.executors import workers
from navgym.tuning.study.run import Search, search

# a whole number, three scales, a choice: every kind of parameter
SPACE = navgym.parameter_space("qivbf").subset(
    ("vb_iterations", "prior_count", "forgetting", "process_noise_scale", "fill")
)
GRACE = 2  # s of silence after which these workers are taken for dead


@dataclass(frozen=True)
class Bowl:
    """Squared distance, in units of the ranges, from a point: one number."""

    centre: float = 0.3

    space = SPACE

    @property
    def about(self):
        return {"goal": "bowl", "centre": self.centre}

    def __call__(self, values):
        return float(((SPACE.to_unit(values) - self.centre) ** 2).sum())


@dataclass(frozen=True)
class Bowls:
    """A bowl per instance, centres drawn around .3: losses that can be looked at in parts."""

    count: int = 40
    pause: float = 0.0  # s per evaluation
    marks: str = ""  # file that each evaluation adds its process to

    space, metric = SPACE, "mean"

    @property
    def about(self):
        return {"goal": "bowls", "count": self.count}

    def __len__(self):
        return self.count

    def evaluate(self, values, which=None):
        if self.marks:
            with Path(self.marks).open("a") as file:
                file.write(f"{os.getpid()}\n")
        time.sleep(self.pause)
        centres = np.random.default_rng(0).normal(0.3, 0.05, (self.count, len(SPACE)))
        losses = ((SPACE.to_unit(values) - centres) ** 2).sum(axis=1)
        return Evaluation(losses if which is None else losses[which])

    def __call__(self, values):
        return float(self.evaluate(values).losses.mean())


class Doing:
    """A goal that does something at its `at`-th evaluation, before it."""

    def __init__(self, goal, at, act):
        self.space, self.about = goal.space, goal.about
        self.goal, self.left, self.act = goal, at, act

    def __call__(self, values):
        self.left -= 1
        if self.left == 0:
            self.act()
        return self.goal(values)


class Fatal:
    """A goal that kills the process it is evaluated in, the first time or every time."""

    def __init__(self, goal, once=None):
        self.space, self.about, self.metric = goal.space, goal.about, goal.metric
        self.goal, self.once = goal, once  # once: file that says that it has killed

    def __len__(self):
        return len(self.goal)

    def evaluate(self, values, which=None):
        if self.once is None or not Path(self.once).exists():
            if self.once is not None:
                Path(self.once).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return self.goal.evaluate(values, which)

    def __call__(self, values):
        return float(self.evaluate(values).losses.mean())


def results(outcome):
    """What must be the same in studies that are the same."""
    return [(dict(t.values), t.result, t.given_up) for t in outcome.trials]


class Worker:
    """A process that searches, in a group of its own (for Ctrl-C); see `main` for its options.

    It is forked from a server that has imported this module: importing takes seconds.
    """

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.tuning.goals"])

    def __init__(self, said, where, *options):
        self.said = said  # file for what it says
        arguments = [str(where), *map(str, options)]
        self.process = self.context.Process(target=_worker, args=(str(said), arguments))
        self.process.start()
        self.pid = self.process.pid

    def wait(self):
        """Its exit status, and what it has said on standard error."""
        self.process.join()
        return self.process.exitcode, self.said.read_text()


def _worker(said, arguments):
    os.setsid()
    sys.stderr = Path(said).open("w", buffering=1)  # noqa: SIM115 - until the process ends
    try:
        sys.exit(main(arguments))
    except KeyboardInterrupt:
        sys.exit(130)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


def died(signal_number):
    return lambda: os.kill(os.getpid(), signal_number)


def main(arguments):
    """Like `navgym tune`, it ends with status 2 after an error and 130 after Ctrl-C."""
    parser = argparse.ArgumentParser()
    parser.add_argument("where")
    parser.add_argument("--trials", type=int, default=12)
    parser.add_argument("--study", default=study.STUDY)
    parser.add_argument("--die", choices=("working", "asking", "stopped"))
    parser.add_argument("--at", type=int, default=5)
    parser.add_argument("--room", type=int, help="bytes that a file may have")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--batch", type=int, default=1)
    parser.add_argument("--prune", action="store_true")
    parser.add_argument("--pause", type=float, default=0.0)
    parser.add_argument("--marks", default="")
    options = parser.parse_args(arguments)
    goal = Bowl()
    if options.marks:
        goal = Bowls(pause=options.pause, marks=options.marks)
    if options.die == "working":
        goal = Doing(goal, options.at, died(signal.SIGKILL))
    if options.die == "stopped":
        goal = Doing(goal, options.at, died(signal.SIGSTOP))
    if options.die == "asking":
        study.record_life = lambda *_: died(signal.SIGKILL)()
    if options.room is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (options.room, options.room))
    how = Search(
        options.trials, batch=options.batch, prune=options.prune, study=options.study,
        heartbeat=1, grace=GRACE,
    )  # fmt: skip
    where = options.where if "://" in options.where else Path(options.where)
    with workers(options.workers) as executor:
        found = search(goal, how, journal=where, progress=False, executor=executor)
    return 130 if found.interrupted else 0
