"""What a mixture is taught with: logs, spoilt copies of them, calm legs; and how well each expert did."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.agents.mixture.experts import Expert, kinds
from navgym.agents.mixture.mixture import AT_ONCE, Mixture, watched
from navgym.core.checks import Array
from navgym.metrics.measures import ROBUST
from navgym.problem import problem_of
from navgym.statespace.batch import StateSpaceBatch, stretch
from navgym.statespace.filters import mixture as kernels

Single = NDArray[np.float32]
Rng = np.random.Generator

# Spoilt copies. Without them a mixture of A-KIT's tracks is twice as bad as fixed parameters under outliers
NOISE = (0.5, 2.5)  # multiple of the position noise
OUTLIERS = (0.0, 0.1)  # share of fixes that are off
SIZES = (7.0, 40.0)  # by how much, in standard deviations of a fix
MORE_LOST = (
    0.0,
    0.4,
)  # share of what was received that is lost too, where a format draws no losses
CALM = (0.03, 1.0)  # multiple of Q in simulated calm legs
FAR = 30.0  # robust deviations at which the reference counts as lost
CUT = 3.0  # robust deviations from which a one-step error counts by its size, no more by its square


@dataclass(frozen=True, eq=False)
class Lessons:
    """What weights are learnt from, row by row: R rows, K experts.

    Args:
        features: (R, F).
        errors: (R, K, d) of each expert: of the position against the truth, or of the next fix; 0 where
            it may have no weight.
        able: (R, K) where it may have weight.
        worth: (R,) of each row: those of a recording add up to one over the reference's mean square.
        log: (R,) number of the log that a row is of.
        share: (R,) how far along its recording a row is, 0 to 1.
    """

    features: Single
    errors: Single
    able: NDArray[np.bool_]
    worth: Single
    log: NDArray[np.int64]
    share: Single

    def take(self, rows: NDArray[np.bool_]) -> Lessons:
        """Some of the rows."""
        return Lessons(**{n: a[rows] for n, a in vars(self).items()})


@dataclass(frozen=True, eq=False)
class Lesson:
    """A recording to learn from.

    Args:
        recording: as filters see it.
        clean: (T, m) its measurements before they were spoilt.
        log: number of the log that it is of.
    """

    recording: Any
    clean: Array
    log: int


def lessons_of(
    recordings: Sequence[tuple[int, Any]], truth: bool, drawn: bool, rng: Rng
) -> list[Lesson]:
    """Recordings (number of the log, recording) as they are, spoilt, and a calm leg for each second one."""
    found = [Lesson(r, r.measurements, log) for log, r in recordings]
    found += [spoilt(r, log, truth, drawn, rng) for log, r in recordings]
    for log, r in recordings[::2]:
        leg = calm(r, rng)
        found.append(Lesson(leg, leg.measurements, log))
    return found


def spoilt(recording: Any, log: int, truth: bool, drawn: bool, rng: Rng) -> Lesson:
    """A copy with another noise of the fixes, outliers among them, and, if not `drawn`, more losses.

    Where the truth is not to be seen, noise is only added.
    """
    model, y = recording.model, recording.measurements.copy()
    batch = StateSpaceBatch.of([recording])
    fixes = kinds(problem_of(recording), batch) == 0
    root = _root(model, len(y))[:, fixes]
    factor = float(np.exp(rng.uniform(*np.log(NOISE))))
    lost = recording.lost.copy()
    if not drawn:
        lost |= (rng.random(len(y)) < rng.uniform(*MORE_LOST))[:, None]
    if truth:
        true = model.observe(recording.truth)[:, fixes]
        y[:, fixes] = true + factor * (y[:, fixes] - true)
        clean = y.copy()
    else:
        clean = y.copy()
        more = np.sqrt(max(factor**2 - 1.0, 0.0))
        y[:, fixes] += more * root * rng.standard_normal(root.shape)
    hit = rng.random(len(y)) < rng.uniform(*OUTLIERS)
    way = rng.standard_normal(root.shape)
    way *= rng.uniform(*SIZES) / np.linalg.norm(way, axis=1, keepdims=True)
    y[:, fixes] += np.where(hit[:, None], way * root, 0.0)
    return Lesson(dataclasses.replace(recording, measurements=y, lost=lost), clean, log)


def calm(recording: Any, rng: Rng) -> Any:
    """A simulated leg under the recording's model, on its clock and with its losses, less pushed than it."""
    model, steps = recording.model, len(recording)
    F, Q, H = (_over(getattr(model, n), steps) for n in ("F", "Q", "H"))
    scale = float(np.exp(rng.uniform(*np.log(CALM))))
    push = np.linalg.cholesky(scale * Q + 1e-18 * np.eye(model.n))
    x = model.x0 + np.linalg.cholesky(model.P0) @ rng.standard_normal(model.n)
    truth = np.empty((steps, model.n))
    for k, (w, root) in enumerate(zip(rng.standard_normal((steps, model.n)), push, strict=True)):
        x = F[k] @ x + root @ w
        truth[k] = x
    noise = _root(model, steps) * rng.standard_normal((steps, model.m))
    y = np.einsum("kij,kj->ki", H, truth) + np.nan_to_num(noise)
    return dataclasses.replace(
        recording, measurements=y, truth=truth, regime=None, process_scale=None,
        measurement_scale=None, meta={"log": recording.meta.get("log", ""), "source": "calm leg"},
    )  # fmt: skip


def _root(model: Any, steps: int) -> Array:
    """(T, m) standard deviations that a model believes of its rows."""
    return np.sqrt(np.diagonal(_over(model.R, steps), axis1=1, axis2=2))


def _over(matrix: Array, steps: int) -> Array:
    """A matrix of a model at every step."""
    return stretch(matrix if matrix.ndim == 3 else matrix[None], steps)


def material(experts: Sequence[Expert], lessons: Sequence[Lesson], truth: bool) -> Lessons:
    """Run the experts over every lesson, and note what they saw and how far off they were."""
    made = [
        _part(experts, lessons[i : i + AT_ONCE], truth) for i in range(0, len(lessons), AT_ONCE)
    ]
    names = Lessons.__dataclass_fields__
    return Lessons(**{n: np.concatenate([getattr(m, n) for m in made]) for n in names})


def _part(experts: Sequence[Expert], lessons: Sequence[Lesson], truth: bool) -> Lessons:
    batch = StateSpaceBatch.of([each.recording for each in lessons])
    _, seen = watched(experts, batch)
    weights, _, features, _ = blank(experts).weigh(seen, fallback=False)
    able = weights > 0.0
    if truth:
        assert batch.truth is not None
        position = list(batch.position)
        off = seen.states[..., position] - batch.truth[:, :, None][..., position]
    else:
        off = ahead(lessons, seen.innovations, seen.kind)
    known = np.isfinite(np.where(able[..., None], off, 0.0)).all(axis=(2, 3)) & able.any(axis=2)
    known &= np.arange(batch.steps) < batch.lengths[:, None]
    off = np.where(able[..., None], np.nan_to_num(off), 0.0)
    rows = np.nonzero(known)
    log = np.array([each.log for each in lessons])
    share = np.arange(batch.steps) / batch.lengths[:, None]
    single = np.float32
    return Lessons(
        features[rows].astype(single), off[rows].astype(single), able[rows],
        worth(off, able, known)[rows].astype(single), log[rows[0]], share[rows].astype(single),
    )  # fmt: skip


def blank(experts: Sequence[Expert]) -> Mixture:
    """A mixture that knows nothing: every expert that holds has the same weight."""
    F, K = len(kernels.FEATURES), len(experts)
    none = np.zeros(F)
    return Mixture(
        tuple(experts), none, none + 1.0, none - 1e9, none + 1e9, np.zeros((F, K)), np.zeros(K)
    )


def worth(off: Array, able: NDArray[np.bool_], known: NDArray[np.bool_]) -> Array:
    """(N, T) weight of each row, over the reference's mean square on its recording.

    A row where even the best expert is far off, such as an outlier that is to be foretold, counts by its
    size, not by its square.
    """
    size = np.linalg.norm(off, axis=3)
    least = np.where(able, size, np.inf).min(axis=2)
    held = np.where(known, least, np.nan)
    spread = ROBUST * np.nanmedian(held, axis=1, keepdims=True)
    robust = np.where(known, np.minimum(1.0, CUT * spread / np.maximum(least, 1e-12)), 0.0)
    square = (robust * np.minimum(size[..., 0], FAR * spread) ** 2).sum(axis=1, keepdims=True)
    return np.asarray(robust / np.maximum(square, 1e-12))


def ahead(lessons: Sequence[Lesson], innovations: Array, kind: NDArray[np.int64]) -> Array:
    """(N, T, K, d) by how much each expert misses the next fix that comes, as it was before it was spoilt.

    Of row k that is the miss at the next row with a fix; NaN after the last.
    """
    fixes = np.flatnonzero(kind == 0)
    miss = innovations[..., fixes].copy()
    for i, each in enumerate(lessons):
        added = (each.recording.measurements - each.clean)[:, fixes]
        miss[i, : len(added)] -= np.nan_to_num(added)[:, None]
    found = np.full_like(miss, np.nan)
    following = np.full(miss.shape[2:], np.nan)
    for i in range(len(miss)):
        following[...] = np.nan
        for k in range(miss.shape[1] - 1, 0, -1):
            if np.isfinite(miss[i, k]).any():
                following = miss[i, k].copy()
            found[i, k - 1] = following
    return found
