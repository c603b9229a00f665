"""Run the toy's filters over a batch, and judge them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

import navgym
from navgym.estimation import Estimate
from navgym.metrics.errors import run_rmse, squared_error
from navgym.problem import Filter, Run
from navgym.warm import play, stream
from tests.toy import kernels as K
from tests.toy.world import WalkRecording


@dataclass(frozen=True, eq=False)
class WalkBatch:
    """Walks stacked for the kernels; shorter ones end in lost samples.

    Args:
        recordings: what was stacked.
        lengths: (N,) samples of each.
        y: (N, T) measurements.
    """

    recordings: tuple[WalkRecording, ...]
    lengths: Any
    y: Any

    decision_interval: ClassVar[int] = 5
    linear: ClassVar[bool] = True

    @classmethod
    def of(cls, recordings: Sequence[WalkRecording]) -> "WalkBatch":
        """Stack `recordings`; ValueError if there is none."""
        if not recordings:
            raise ValueError("recordings must hold at least one WalkRecording, got none.")
        lengths = np.array([len(r) for r in recordings])
        return cls(tuple(recordings), lengths, padded([r.measurements for r in recordings]))

    def __len__(self) -> int:
        return len(self.recordings)

    @property
    def steps(self) -> int:
        return self.y.shape[1]

    @property
    def step(self) -> float:
        return self.recordings[0].model.step

    @property
    def truth(self) -> Any:
        if any(r.truth is None for r in self.recordings):
            return None
        return padded([r.truth for r in self.recordings])[..., None]

    def regimes(self) -> list[Any]:
        known = all(r.regime is not None for r in self.recordings)
        return [r.regime for r in self.recordings] if known else []

    def time_of(self, i: int) -> Any:
        return self.recordings[i].time

    def take(self, which: Any) -> "WalkBatch":
        return WalkBatch.of([self.recordings[i] for i in which])


def padded(rows: Sequence[Any]) -> Any:
    """Rows as (N, T), NaN past the end of each."""
    found = np.full((len(rows), max(map(len, rows))), np.nan)
    for row, given in zip(found, rows, strict=True):
        row[: len(given)] = given
    return found


def packed(recordings: Sequence[Any]) -> Any:
    """What is believed of each, (N,)."""
    names = K.MODEL.names
    rows = [tuple(getattr(r.model, name) for name in names) for r in recordings]
    return np.array(rows, dtype=K.MODEL)


def run(chosen: Filter, batch: WalkBatch, table: Any, interval: int, everything: bool) -> Run:
    """Run one filter; see `Problem.run`."""
    count, steps = batch.y.shape
    scales = np.ones((count, 1))
    if chosen.needs_scales:
        if any(r.process_scale is None for r in batch.recordings):
            raise ValueError(
                f"filter {chosen.name!r} needs the true noise, which only simulated recordings "
                "carry: use walk_kf."
            )
        scales = padded([r.process_scale for r in batch.recordings])
    rest = steps if everything else 0
    lanes, models = np.zeros(count, K.LANE), packed(batch.recordings)
    shapes = ((steps, 1), (rest, 1, 1), (rest, 1), (rest,), (rest,))
    outputs = [np.full((count, *shape), np.nan) for shape in shapes]
    K.begin(lanes, models)
    K.run(lanes, models, batch.y, batch.lengths, scales, table, interval, *outputs)
    states, covariances, innovations, nis, log_likelihood = outputs
    return Run(
        states=states, diverged=lanes["diverged"] > 0, covariances=covariances,
        innovations=innovations, nis=nis, log_likelihood=log_likelihood,
        components=np.isfinite(batch.y[:, :rest]).astype(np.int64),
    )  # fmt: skip


def estimate(chosen: Filter, batch: WalkBatch, found: Run) -> Estimate:
    """What users get."""
    return Estimate.of(found, batch.time_of(0))


# ---- judging


def scored(batch: WalkBatch, span: tuple[float, float]) -> Any:
    """Which samples (N, T) are judged."""
    first, last = (np.round(share * batch.lengths)[:, None] for share in span)
    k = np.arange(batch.steps)
    return (k >= first) & (k < last)


def squared(batch: WalkBatch, states: Any, name: str, span: tuple[float, float]) -> Any:
    """Squared errors (N, T), m²."""
    if batch.truth is None:
        raise ValueError("errors need recordings with truth to score against: set truth=.")
    return np.where(scored(batch, span), squared_error(states, batch.truth, (0,)), np.nan)


def errors(
    batch: WalkBatch, states: Any, names: Any, span: tuple[float, float] = (0.0, 1.0)
) -> Any:
    """RMSE (N,), m."""
    return {name: run_rmse(squared(batch, states, name, span)) for name in names}


def nees(batch: WalkBatch, found: Run) -> Any:
    """Normalised errors squared, (N, T)."""
    return ((found.states - batch.truth) ** 2)[..., 0] / found.covariances[..., 0, 0]


# ---- compiling


def warm() -> list[list[tuple[str, Callable[[], Any]]]]:
    """What touches every kernel once."""
    walk = partial(navgym.simulate, "toy/calm", steps=5)
    return [
        [
            ("toy environment", partial(play, "toy/calm")),
            ("live toy filter", partial(stream, "toy/calm")),
            ("toy filter", lambda: navgym.estimate("walk_kf", walk())),
        ]
    ]
