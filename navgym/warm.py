"""Compile the kernels for the usual model sizes: `navgym warm`.

Compiled code is cached on disk, so a second run takes a few seconds. Other model sizes compile when
they are first used, which takes some seconds per filter.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

import navgym
from navgym.core.checks import one_of
from navgym.core.machine import cores
from navgym.problem import PROBLEMS, Problem, problem_of

ABOUT = """Compile kernels now, instead of at first use.

    navgym warm           those of every problem, two minutes or so on two cores
    navgym warm auv       those of one problem: {problems}

Only for the usual sizes of models: others compile when they are first used, some seconds per filter.
Compiled code is cached on disk, so a second run takes a few seconds.
"""


def jobs(names: Iterable[str]) -> list[tuple[str, int]]:
    """Problems and numbers of their jobs, the first of every problem first: they take longest."""
    each = [(name, i) for name in names for i in range(len(PROBLEMS[name].kernels()))]
    return sorted(each, key=lambda job: job[1])


def compile_one(problem: str, number: int) -> str:
    """Run one job; returns what it was."""
    what, run = PROBLEMS[problem].kernels()[number]
    run()
    return what


def play(scenario: str, **overrides: Any) -> None:
    """One step of the problem's environment."""
    import gymnasium

    problem = problem_of(scenario)
    env = gymnasium.make(
        problem.environment.id, scenario=scenario, overrides=dict(problem.brief) | overrides
    )
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()


def stream(scenario: str, **overrides: Any) -> None:
    """A filter step of a recording, sample by sample."""
    problem = problem_of(scenario)
    recording = brief(problem, scenario, **overrides)
    kind = problem.environment
    step = float(recording.time[1] - recording.time[0])
    lane = kind.live(kind.settings(), {}, recording.model, step)
    for sample, moment, more in lane.samples(recording):
        lane.put(sample, None, moment, **more)
        if lane.ready():
            lane.step(look=True)
            return


def brief(problem: Problem, scenario: str, **overrides: Any) -> Any:
    """A recording as short as can be."""
    return navgym.simulate(scenario, **(dict(problem.brief) | overrides))


def parse(words: Sequence[str]) -> tuple[str, ...]:
    """Names of the problems to compile for. By argparse: a plain navgym has no tyro."""
    parser = argparse.ArgumentParser(
        prog="navgym warm", description=ABOUT.format(problems=" or ".join(PROBLEMS)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("problem", nargs="*", help="of those above (default: every one)")
    named = parser.parse_args(list(words)).problem
    return tuple(dict.fromkeys(one_of("problem", name, PROBLEMS) for name in named)) or tuple(
        PROBLEMS
    )


def main(words: Sequence[str] = ()) -> int:
    """Compile what is not yet compiled, showing how far it is; returns the exit status."""
    began = time.perf_counter()
    names = parse(words)
    todo = jobs(names)
    with ProcessPoolExecutor(min(len(todo), cores())) as pool:
        running = [pool.submit(compile_one, *job) for job in todo]
        for done, job in enumerate(as_completed(running), start=1):
            if sys.stderr.isatty():
                text = f"compiling kernels, {done} of {len(todo)}: {job.result()}"
                sys.stderr.write(f"\r\x1b[K{text}")
            job.result()
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")
    spent = time.perf_counter() - began
    print(f"navgym {navgym.__version__}: kernels of {', '.join(names)} ready after {spent:.1f} s")
    return 0


if __name__ == "__main__":
    from navgym.command import main as command

    sys.exit(command(["warm", *sys.argv[1:]]))
