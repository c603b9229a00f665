"""What a combiner is taught with: recordings, and what bank, oracle and truth say of them.

What a combiner answers is a function of the data alone. Given the data and the true noise scales,
the truth scatters about the oracle's estimate with a covariance that no answer changes. So the
squared distance to the *oracle's* estimate has the gradient of the expected squared error, without
the scatter, which is some ten times larger than what there is to learn.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.agents.combiner.combiner import combines, modes, space
from navgym.agents.training.randomisation import drawn
from navgym.auv.conditions import AUVRanges
from navgym.core.checks import positive_int, within
from navgym.core.seeds import seeds
from navgym.core.storage import writable
from navgym.problem import problem_of
from navgym.simulation import find_scenario, simulate_many
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import combiner as kernels
from navgym.statespace.recording import Recording

Single = NDArray[np.float32]

AT_ONCE = 50  # recordings that are run side by side
LEAST = 1e-30  # of a weight, before its logarithm is taken
# few conditions at a time: with .4 hardly any recording has just another R, and there it got worse
RANGES = AUVRanges(chance=0.2, measurement_scale=(0.1, 40.0))
# worlds that do not switch, or switch otherwise; in auv/turn the oracle is no teacher
STEADY = (
    "auv/nominal", "auv/burst", "auv/tvr", "auv/heavy", "auv/student", "auv/mismatch",
    "auv/switch-A", "auv/outage", "auv/component-loss",
)  # fmt: skip


@dataclass(frozen=True)
class CombinerConfiguration:
    """A training of the combiner: recordings, network, recipe."""

    scenarios: tuple[str, ...] = ("auv/switch-D", "auv/switch-B")
    """what it is for: most recordings are drawn from these, in turn"""
    others: tuple[str, ...] = STEADY
    """what it must not get worse in: the rest is drawn from these"""
    share: float = 0.15
    """of recordings from the others"""
    ranges: AUVRanges = field(default_factory=lambda: RANGES)
    """where their conditions are drawn from"""
    designed: float = 0.15
    """share of recordings under the scenarios' own conditions"""
    recordings: int = 4000
    """for training; each training seed has its own"""
    validation: int = 100
    """per scenario as it is, and as many under conditions drawn anew"""
    steps: int = 800
    """samples per recording"""
    units: int = kernels.UNITS
    """of the recurrent network"""
    rounds: int = 260
    """of training: in each, a batch of recordings is read from end to end"""
    batch: int = 400
    """recordings per round"""
    chunk: int = 100
    """samples per update, through which gradients flow back"""
    learning_rate: float = 1e-2
    """of Adam, at the start; it falls to nothing along a cosine"""
    interval: int = 20
    """rounds between validations; each also writes a checkpoint"""
    memory: float = 4.0
    """GB that the training material may take"""
    seed: int = 0
    """of everything random"""
    threads: int = 1
    """of torch; on a busy machine one is quickest"""
    out: Path | None = None
    """folder of combiner.npz, combiner.json and checkpoints; default: runs/combiner/seed-SEED"""

    def __post_init__(self) -> None:
        for name in (
            "recordings", "units", "rounds", "batch", "chunk", "interval", "steps", "threads",
        ):  # fmt: skip
            positive_int(name, getattr(self, name))
        positive_int("validation", self.validation, least=2)
        positive_int("seed", self.seed, least=0)
        for name in ("learning_rate", "memory"):
            within(name, getattr(self, name), 0.0, above=True)
        within("designed", self.designed, 0.0, 1.0)
        within("share", self.share, 0.0, 1.0)
        if self.batch > self.recordings:
            raise ValueError(
                f"batch={self.batch} exceeds recordings={self.recordings}: lower it, or make more."
            )
        for field_name in ("scenarios", "others"):
            if not getattr(self, field_name):
                raise ValueError(f"{field_name} must name at least one scenario, got none.")
        for name in (*self.scenarios, *self.others):
            if not _fits(name, self.ranges):
                raise ValueError(
                    f"scenario {name!r} has another model than the combiner reads: choose ones "
                    "in which position and velocity are measured, of a problem with a bank."
                )
        object.__setattr__(self, "out", None if self.out is None else Path(self.out))

    @property
    def folder(self) -> Path:
        """Where everything is written."""
        return self.out or Path("runs/combiner") / f"seed-{self.seed}"

    @property
    def training_seeds(self) -> range:
        """Of the training recordings: every training has its own."""
        return seeds("train", self.recordings, start=self.seed * self.recordings)

    def simulated(
        self, names: Sequence[str], of: Sequence[int], designed: float = 0.0
    ) -> list[Recording]:
        """One recording per seed of `of`: scenarios take turns, conditions are drawn anew.

        Args:
            names: scenarios.
            of: seeds.
            designed: share of recordings, the first ones, under the scenarios' own conditions.
        """
        found = []
        for i, seed in enumerate(of):
            scenario = find_scenario(names[i % len(names)], steps=self.steps)
            if i >= designed * len(of):
                scenario = drawn(scenario, self.ranges, seed)
            found += simulate_many(scenario, [seed])
        return found

    def for_training(self) -> list[Recording]:
        """The training recordings."""
        chosen = self.training_seeds
        switching = round((1.0 - self.share) * self.recordings)
        return self.simulated(self.scenarios, chosen[:switching], self.designed) + self.simulated(
            self.others, chosen[switching:], self.designed
        )

    def comparable(self) -> dict[str, Any]:
        """What the result depends on, as JSON holds it."""
        own = dataclasses.asdict(dataclasses.replace(self, out=None))
        return writable({k: v for k, v in own.items() if k not in ("out", "memory")})


def _fits(name: str, ranges: Any) -> bool:
    """Whether a combiner can read recordings of a scenario, drawn from such ranges."""
    scenario = find_scenario(name)
    problem = problem_of(scenario)
    if not combines(problem) or not isinstance(ranges, problem.training.ranges):
        return False
    short = simulate_many(scenario.override(**problem.brief), [0])
    return kernels.fits(problem.stack(short))


@dataclass(frozen=True, eq=False)
class Lessons:
    """What a network is taught with: N recordings of T samples, J modes.

    Args:
        inputs: (N, T, D) of the network, raw.
        log_weights: (N, T, J) of the bank.
        offsets: (N, T, J, 2) position of each mode's mean minus the oracle's, m.
        scatter: (N, T, 2) position of the oracle minus the truth, m.
        scale: (N,) mean square position error of the bank, m².
    """

    inputs: Single
    log_weights: Single
    offsets: Single
    scatter: Single
    scale: Single

    @property
    def gigabytes(self) -> float:
        """Of memory."""
        return sum(float(a.nbytes) for a in vars(self).values()) / 1e9


def material(recordings: Sequence[Recording]) -> Lessons:
    """Run the bank over simulated recordings of equal length, and note what a network may learn."""
    parts = [_part(recordings[i : i + AT_ONCE]) for i in range(0, len(recordings), AT_ONCE)]
    joined = {
        f.name: np.concatenate([getattr(part, f.name) for part in parts])
        for f in dataclasses.fields(Lessons)
    }
    return Lessons(**joined)


def _part(recordings: Sequence[Recording]) -> Lessons:
    batch = StateSpaceBatch.of(recordings)
    assert batch.truth is not None
    table = space().array()[None]
    found = kernels.estimate(kernels.idle(modes()), modes(), batch, table, False, watch=True)
    position = list(recordings[0].model.position)
    truth = batch.truth[..., position]
    problem = problem_of(recordings[0])
    oracle = problem.run(problem.bound, batch).states[..., position]
    error = ((found["states"][..., position] - truth) ** 2).sum(-1)
    single = np.float32
    return Lessons(
        inputs=found["inputs"].astype(single),
        log_weights=np.log(np.maximum(found["bank_weights"], LEAST)).astype(single),
        offsets=(found["means"][..., position] - oracle[:, :, None]).astype(single),
        scatter=(oracle - truth).astype(single),
        scale=error.mean(axis=1).astype(single),
    )


def checked_memory(config: CombinerConfiguration) -> None:
    """ValueError where the training material would take more memory than allowed."""
    first = material(config.simulated(config.scenarios, config.training_seeds[:1]))
    needed = config.recordings * first.gigabytes
    if needed > config.memory:
        fitting = int(config.recordings * config.memory / needed)
        raise ValueError(
            f"recordings={config.recordings} take {needed:.1f} GB, more than memory="
            f"{config.memory:g}: set recordings={fitting}, or memory={math.ceil(needed)} if you "
            "have it."
        )
