"""Compile every kernel for the usual model sizes: `python -m navgym.warm`.

Compiled code is cached on disk, so a second run takes a second or two. Other model sizes compile
when they are first used, which takes some seconds per filter.
"""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Callable, Iterator

import navgym
from navgym.filters.catalogue import CATALOGUE
from navgym.turn_model import CoordinatedTurnModel


def _tasks() -> Iterator[tuple[str, Callable[[], object]]]:
    for scenario in ("nominal", "position-only", "component-loss", "coordinated-turn"):
        recording = navgym.simulate(f"auv/{scenario}", steps=3)
        for name, chosen in CATALOGUE.items():
            if isinstance(recording.model, CoordinatedTurnModel) and not chosen.nonlinear:
                continue
            yield f"{name} on {scenario}", functools.partial(navgym.estimate, name, recording)
    for scenario in ("auv/switch-D", "auv/position-only"):
        yield f"environment on {scenario}", functools.partial(_try_environment, scenario)


def _try_environment(scenario: str) -> None:
    import gymnasium

    env = gymnasium.make("navgym/AUVDropout-v0", scenario=scenario, overrides={"steps": 10})
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()


def _show(text: str) -> None:
    """Rewrite the terminal's current line; nothing where the output is no terminal."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\x1b[K{text}")
        sys.stderr.flush()


def main() -> None:
    """Compile what is not yet compiled, showing what takes time."""
    began = time.perf_counter()
    for what, task in _tasks():
        _show(f"compiling kernels: {what}")
        task()
    _show("")
    print(f"navgym {navgym.__version__}: kernels ready after {time.perf_counter() - began:.1f} s")


if __name__ == "__main__":
    main()
