"""A walk at random: what is believed of it, what is recorded, and the simulator."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from navgym.core.checks import one_of, positive_int, real_array, shaped, span, within
from navgym.core.draws import Range, log_uniform
from navgym.core.frozen import Frozen
from navgym.core.regimes import sequence
from navgym.core.seeds import split_of

STREAM = 0xD0  # first word of a walk's seed sequence: no other simulator's


@dataclass(frozen=True)
class WalkModel:
    """What a filter believes: x_k = x_{k−1} + w, y_k = x_k + v.

    Args:
        step: s between samples.
        Q: variance of w, m².
        R: variance of v, m².
        x0: m, one step before the first sample.
        P0: its variance, m².
    """

    step: float = 1.0
    Q: float = 0.01
    R: float = 1.0
    x0: float = 0.0
    P0: float = 1.0


@dataclass(frozen=True, eq=False)
class WalkRecording(Frozen):
    """One walk.

    Args:
        time: (T,) s.
        measurements: (T,) m; NaN where lost.
        truth: (T,) m, or None.
        regime: (T,) labels of the true regime, or None.
        process_scale: (T,) true multiple of the model's Q in the step to each sample, or None.
        model: what a filter believes.
        meta: anything that JSON can hold.
    """

    time: Any
    measurements: Any
    truth: Any = None
    regime: Any = None
    process_scale: Any = None
    model: WalkModel = WalkModel()
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        arrays = {}
        for name in ("time", "measurements", "truth", "process_scale"):
            if getattr(self, name) is not None:
                arrays[name] = real_array(name, getattr(self, name), finite=name != "measurements")
                shaped(name, arrays[name], (len(self.time),), "a number per sample")
        if self.regime is not None:
            arrays["regime"] = np.array(self.regime, dtype=np.int64)
        self._freeze(arrays | {"meta": dict(self.meta)})

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True)
class WalkScenario:
    """Conditions of a walk; every field can be overridden.

    Args:
        name: without the "toy/" in front.
        summary: one line.
        steps: samples per recording.
        loss: share of lost samples.
        regimes: true multiple of Q by name; the next is drawn uniformly among the others.
        dwell: least and largest time in a regime, samples.
        process_scale: multiplies every regime's.
        model: what filters believe.
        reference: best fixed parameters.
    """

    name: str
    summary: str
    steps: int = 200
    loss: float = 0.2
    regimes: tuple[tuple[str, float], ...] = (("calm", 1.0),)
    dwell: tuple[int, int] = (20, 60)
    process_scale: float = 1.0
    model: WalkModel = WalkModel()
    reference: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        positive_int("steps", self.steps)
        within("loss", self.loss, 0.0, 1.0)
        within("process_scale", self.process_scale, 0.0, above=True)
        span("dwell", self.dwell, 1, whole=True)

    def override(self, **fields: Any) -> "WalkScenario":
        """The same scenario with some fields changed; ValueError for an unknown field."""
        for name in fields:
            one_of("scenario field", name, [f.name for f in dataclasses.fields(self)])
        return dataclasses.replace(self, **fields)


SCENARIOS: Mapping[str, WalkScenario] = MappingProxyType(
    {
        s.name: s
        for s in (
            WalkScenario("calm", "the model is exact: nothing beats the plain filter"),
            WalkScenario(
                "switch", "calm and rough follow one another",
                regimes=(("calm", 1.0), ("rough", 100.0)), reference={"process_noise_scale": 20.0},
            ),
        )
    }
)  # fmt: skip


def simulate(scenario: WalkScenario, seeds: Sequence[int]) -> list[WalkRecording]:
    """One walk per seed."""
    return [_simulate(scenario, seed) for seed in seeds]


def _simulate(scenario: WalkScenario, seed: int) -> WalkRecording:
    split_of(seed)
    model, steps = scenario.model, scenario.steps
    order, walk, noise, loss = (
        np.random.default_rng(s) for s in np.random.SeedSequence([STREAM, seed]).spawn(4)
    )
    regime = sequence(len(scenario.regimes), scenario.dwell, steps, order)
    q = scenario.process_scale * np.array([scale for _, scale in scenario.regimes])[regime]
    start = model.x0 + np.sqrt(model.P0) * walk.standard_normal()
    truth = start + np.cumsum(np.sqrt(q * model.Q) * walk.standard_normal(steps))
    y = truth + np.sqrt(model.R) * noise.standard_normal(steps)
    y[loss.random(steps) < scenario.loss] = np.nan
    names = [name for name, _ in scenario.regimes]
    meta = {"scenario": f"toy/{scenario.name}", "regimes": names, "seed": int(seed)}
    time = model.step * np.arange(1.0, steps + 1)
    return WalkRecording(time, y, truth, regime, q, model, meta)


@dataclass(frozen=True)
class WalkRanges:
    """What is drawn for a walk."""

    loss: Range = (0.0, 0.5)
    """share of lost samples, drawn uniformly"""
    process_scale: Range = (0.5, 4.0)
    """multiple of every regime's Q, drawn log-uniformly"""


def draw(scenario: WalkScenario, ranges: WalkRanges, rng: np.random.Generator) -> WalkScenario:
    """`scenario` under other conditions."""
    loss = float(rng.uniform(*ranges.loss))
    scale = scenario.process_scale * log_uniform(ranges.process_scale, rng)
    return scenario.override(loss=loss, process_scale=scale)


def read_walk(path: Any) -> WalkRecording:
    """A walk from a text file: time and measurement per line, nan where lost."""
    time, y = np.loadtxt(path, unpack=True, ndmin=2)
    return WalkRecording(time, y)
