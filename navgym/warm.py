"""Compile every kernel for the usual model sizes: `python -m navgym.warm`.

Compiled code is cached on disk, so a second run takes a few seconds. Other model sizes compile when
they are first used, which takes some seconds per filter.
"""

from __future__ import annotations

import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

import navgym
from navgym.problem import PROBLEMS, Problem, problem_of, problems


def jobs() -> list[tuple[str, int]]:
    """Problems and numbers of their jobs, the first of every problem first: they take longest."""
    each = [(p.name, i) for p in problems() for i in range(len(p.kernels()))]
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


def main() -> None:
    """Compile what is not yet compiled, showing how far it is."""
    began = time.perf_counter()
    todo = jobs()
    with ProcessPoolExecutor(min(len(todo), os.cpu_count() or 1)) as pool:
        running = [pool.submit(compile_one, *job) for job in todo]
        for done, job in enumerate(as_completed(running), start=1):
            if sys.stderr.isatty():
                text = f"compiling kernels, {done} of {len(todo)}: {job.result()}"
                sys.stderr.write(f"\r\x1b[K{text}")
            job.result()
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")
    print(f"navgym {navgym.__version__}: kernels ready after {time.perf_counter() - began:.1f} s")


if __name__ == "__main__":
    main()
