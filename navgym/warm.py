"""Compile the kernels for the usual model sizes: `navgym warm`.

Compiled code is cached on disk, so a second run takes a few seconds. Other model sizes compile when
they are first used, which takes some seconds per filter.
"""

from __future__ import annotations

import argparse
import multiprocessing
import signal
import sys
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, as_completed
from typing import Any

import navgym
from navgym.core import kernel_cache
from navgym.core.checks import one_of
from navgym.core.machine import cores
from navgym.problem import PROBLEMS, Problem, problem_of

ABOUT = """Compile kernels now, instead of at first use.

    navgym warm           those of every problem, a minute or two on two cores
    navgym warm auv       those of one problem: {problems}

Only for the usual sizes of models: others compile when they are first used, some seconds per filter.
Compiled code is cached on disk, so a second run takes a few seconds. NUMBA_CACHE_DIR says where: a
folder that only you can write to, such as ~/.cache/navgym.
"""


def jobs(names: Iterable[str]) -> list[tuple[str, int]]:
    """Problems and numbers of their groups of jobs, the first of every problem first: they take longest."""
    each = [(name, i) for name in names for i in range(len(PROBLEMS[name].kernels()))]
    return sorted(each, key=lambda job: job[1])


def compile_group(problem: str, number: int) -> tuple[list[str], dict[str, str]]:
    """Do a group of jobs; returns what they were, and what kept compiled code from being kept."""
    group = PROBLEMS[problem].kernels()[number]
    for _, run in group:
        run()
    return [what for what, _ in group], kernel_cache.troubles()


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
    try:
        kept = _all(todo)
    except BrokenExecutor as error:
        raise OSError(
            "a process that compiled was killed or ran out of memory: give the same command again."
        ) from error
    finally:
        if sys.stderr.isatty():
            sys.stderr.write("\r\x1b[K")
    spent = time.perf_counter() - began
    state = "ready" if kept else "compiled, but could not be kept,"
    print(f"navgym {navgym.__version__}: kernels of {', '.join(names)} {state} after {spent:.1f} s")
    return 0


def _all(todo: Sequence[tuple[str, int]]) -> bool:
    """Do the jobs in processes, showing how far they are; returns whether compiled code was kept."""
    kept = True
    with ProcessPoolExecutor(min(len(todo), cores()), initializer=_leave_interrupts) as pool:
        running = [pool.submit(compile_group, *job) for job in todo]
        try:
            for done, job in enumerate(as_completed(running), start=1):
                group, troubles = job.result()
                if sys.stderr.isatty():
                    text = f"compiling kernels, {done} of {len(todo)}: {', '.join(group)}"
                    sys.stderr.write(f"\r\x1b[K{text}")
                    sys.stderr.flush()
                kept = kept and kernel_cache.UNKEPT not in troubles
                for kind, text in troubles.items():
                    kernel_cache.say(kind, text)
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise
    return kept


def _leave_interrupts() -> None:
    """Ctrl-C is the parent's: a worker would only show where it was."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


if __name__ == "__main__":
    from navgym.command import main as command

    sys.exit(command(["warm", *sys.argv[1:]]))
