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
import navgym.identification
from navgym.batch import Batch
from navgym.filters import bank, combiner
from navgym.filters.catalogue import CATALOGUE
from navgym.turn_model import CoordinatedTurnModel

ENVIRONMENT = "environment"
DECK_ENVIRONMENT, IDENTIFICATION = "deck environment", "identification"
LIVE, DECK_LIVE = "live filter", "live deck filter"
# what takes longest to compile comes first, so that no process is left with it at the end
SLOW = (
    ENVIRONMENT, DECK_ENVIRONMENT, LIVE, DECK_LIVE, "cukf", "alignment", "bank", "qivbf",
    IDENTIFICATION,
)  # fmt: skip
SCENARIOS = ("nominal", "position-only", "component-loss", "coordinated-turn")


def jobs() -> list[tuple[str, str]]:
    """Pairs (what, scenario) that together touch every kernel."""
    found = [
        (ENVIRONMENT, "switch-D"), (ENVIRONMENT, "position-only"), (DECK_ENVIRONMENT, "paper"),
        (LIVE, "switch-D"), (LIVE, "position-only"), (DECK_LIVE, "paper"), ("alignment", "paper"),
        (IDENTIFICATION, "paper"),
    ]  # fmt: skip
    seen = set()
    for scenario in SCENARIOS:
        model = navgym.simulate(f"auv/{scenario}", steps=3).model
        turning = isinstance(model, CoordinatedTurnModel)
        for name, chosen in CATALOGUE.items():
            # one filter stands for its family; the linear ones need no turning model
            key = (chosen.family, scenario)
            if key not in seen and chosen.nonlinear >= turning:
                seen.add(key)
                found.append((name, scenario))
    return sorted(found, key=lambda job: SLOW.index(job[0]) if job[0] in SLOW else len(SLOW))


def compile_one(what: str, scenario: str) -> str:
    """Run one job on three samples; returns what it was."""
    if what == ENVIRONMENT:
        play("navgym/AUVDropout-v0", scenario=f"auv/{scenario}", overrides={"steps": 10})
    elif what == DECK_ENVIRONMENT:
        brief = {"duration": 4.0}
        play("navgym/DeckDeformation-v0", scenario=f"deck/{scenario}", overrides=brief)
    elif what == LIVE:
        stream(navgym.simulate(f"auv/{scenario}", steps=3))
    elif what == DECK_LIVE:
        stream_deck(navgym.simulate(f"deck/{scenario}", duration=4.0))
    elif what == IDENTIFICATION:
        navgym.identification.RVM().fit([0.0, 1.0, 2.0], [0.0, 1.0, 0.0])
    elif what == "alignment":
        navgym.estimate(what, navgym.simulate(f"deck/{scenario}", duration=4.0))
    else:
        recording = navgym.simulate(f"auv/{scenario}", steps=3)
        navgym.estimate(what, recording)
        if CATALOGUE[what].family == "bank":
            combine(recording)
    return f"{what} on {scenario}"


def play(name: str, **arguments: Any) -> None:
    """One step of an environment."""
    import gymnasium

    env = gymnasium.make(name, **arguments)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()


def stream(recording: navgym.Recording) -> None:
    """Samples of a recording, one by one."""
    from navgym.envs.engine import Settings
    from navgym.envs.live import LiveAUV

    lane = LiveAUV(Settings(), {}, recording.model)
    for y in recording.measurements:
        lane.put(y)
        lane.step(look=True)


def stream_deck(recording: navgym.DualIMURecording) -> None:
    """A filter step of a recording of two IMUs."""
    from navgym.envs.deck_engine import DeckSettings
    from navgym.envs.deck_live import LiveDeck

    lane = LiveDeck(DeckSettings(), {}, recording.model, recording.interval)
    r, k = recording, 0
    while not lane.ready():
        lane.put([r.main_angle[k], r.main_velocity[k], r.sub_angle[k], r.sub_velocity[k]])
        k += 1
    lane.step(look=True)


def combine(recording: Any) -> None:
    """One run of a combiner on the bank, if it can read one of that size."""
    batch, modes = Batch.of([recording]), bank.MODE_SETS["bank"]
    if combiner.fits(batch):
        table = navgym.parameter_space("bank").array()[None]
        combiner.estimate(combiner.idle(modes), modes, batch, table, everything=True)


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
