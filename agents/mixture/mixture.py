"""A mixture of fixed filters as a file and as a filter: npz and JSON, a compiled kernel, no torch, no pickle.

    mixture = Mixture.load("runs/mixture/mixture")
    estimate = mixture.estimate(recording)

See `navgym.statespace.filters.mixture` for what it computes, `navgym.agents.mixture.training` for how it is
made, `navgym.agents.mixture.live` for how it runs on board.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.agents.mixture.experts import BANK, Expert, kinds, meanings
from navgym.agents.policies import portable
from navgym.core.checks import Array, real_array, shaped
from navgym.core.frozen import Frozen
from navgym.core.storage import writable
from navgym.estimation import Estimate
from navgym.metrics.consistency import degrees_of_freedom
from navgym.problem import Run, problem_of
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import mixture as kernels
from navgym.statespace.filters.catalogue import CATALOGUE
from navgym.statespace.filters.modes import Structure

KIND = "navgym mixture"
ARRAYS = ("shift", "gain", "low", "high", "W", "b")
AT_ONCE = 50  # recordings that are run side by side: all modes of the bank would fill gigabytes


@dataclass(frozen=True, eq=False)
class Mixture(Frozen):
    """Experts, and a linear softmax over what is seen of the samples that weighs their states.

    Args:
        experts: the first is the reference: the tuned filter, whose innovations are looked at and which
            answers alone while there is a reason not to trust the weights.
        shift: (F,) subtracted from the features, `navgym.statespace.filters.mixture.FEATURES`.
        gain: (F,) multiplies them then.
        low: (F,) smallest feature in training.
        high: (F,) largest one.
        W: (F, K) weights of the features.
        b: (K,) biases.
        training: command, logs, seeds, what the guard found; whatever JSON can hold.

    Raises:
        ValueError: no experts, arrays that do not fit or are no numbers.
    """

    experts: tuple[Expert, ...]
    shift: Array
    gain: Array
    low: Array
    high: Array
    W: Array
    b: Array
    training: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        experts = tuple(self.experts)
        if not experts:
            raise ValueError("experts must hold at least one, the reference, got none.")
        arrays = {name: real_array(name, getattr(self, name)) for name in ARRAYS}
        count, features = len(experts), len(kernels.FEATURES)
        for name in ARRAYS:
            wide = {"W": (features, count), "b": (count,)}.get(name, (features,))
            shaped(name, arrays[name], wide, f"{features} features and {count} experts")
        self._freeze(arrays | {"experts": experts, "training": writable(self.training)})

    @classmethod
    def single(cls, expert: Expert, training: Mapping[str, Any]) -> Mixture:
        """One that is `expert` alone: what is written where a guard has said no."""
        none = np.zeros(len(kernels.FEATURES))
        flat = np.zeros((len(none), 1))
        return cls((expert,), none, none + 1.0, none - 1e9, none + 1e9, flat, np.zeros(1), training)

    @property
    def reference(self) -> Expert:
        """The tuned filter."""
        return self.experts[0]

    @property
    def refused(self) -> bool:
        """Whether it is the tuned filter alone, since its guard has said no."""
        return len(self.experts) == 1

    # ---- running -----------------------------------------------------------------------------

    def estimate(self, recording: Any, fallback: bool = True) -> Estimate:
        """Run over one recording; `extras` hold `weights` (T, K), `features` (T, F), `reasons` (T,).

        Innovations are the weighted ones of the experts' predictions. NIS is weighted alike: each
        expert's under its own covariance.

        Args:
            recording: a `navgym.Recording` with a linear model.
            fallback: whether the reference answers while there is a reason.

        Raises:
            TypeError: no such recording.
            ValueError: a model that is not linear.
        """
        batch = StateSpaceBatch.of([recording])
        return Estimate.of(self.run(batch, True, fallback), batch.time_of(0))

    def run(self, batch: StateSpaceBatch, everything: bool = False, fallback: bool = True) -> Run:
        """Run over a batch; see `estimate`."""
        parts = [
            self._run(batch.take(range(i, min(i + AT_ONCE, len(batch)))), everything, fallback)
            for i in range(0, len(batch), AT_ONCE)
        ]
        return joined(parts)

    def _run(self, batch: StateSpaceBatch, everything: bool, fallback: bool) -> Run:
        runs, seen = watched(self.experts, batch)
        weights, before, features, reasons = self.weigh(seen, fallback)
        states = blended(weights, seen.states)
        ended = np.arange(batch.steps) >= batch.lengths[:, None]
        failed: NDArray[np.bool_] = np.any(~np.isfinite(states).all(axis=-1) & ~ended, axis=1)
        covariances, extras = np.empty((len(batch), 0, 0, 0)), {}
        if everything:
            covariances = spread(weights, states, seen.states, [r.covariances for r in runs])
            extras = {"weights": weights, "features": features, "reasons": reasons}
        return Run(
            states, failed, covariances,
            blended(before, seen.innovations),
            blended(before, np.stack([r.nis for r in runs], axis=2)[..., None])[..., 0],
            mixed_likelihood(before, np.stack([r.log_likelihood for r in runs], axis=2)),
            degrees_of_freedom(batch.lost), extras,
        )  # fmt: skip

    def weigh(self, seen: Seen, fallback: bool = True) -> tuple[Array, Array, Array, NDArray[Any]]:
        """Weights (N, T, K), those in force when each row came, features (N, T, F), reasons (N, T)."""
        count, steps, experts = seen.finite.shape
        before, weights = (np.empty((count, steps, experts)) for _ in range(2))
        features = np.empty((count, steps, len(self.shift)))
        reasons = np.zeros((count, steps), dtype=np.int64)
        kept = kernels.memory(count, experts, seen.lost.shape[2])
        told: list[Any] = [*seen.arguments, *self.network, fallback, *kept]
        told += [before, features, weights, reasons]
        kernels.weigh(*told)  # type: ignore[no-untyped-call]
        return weights, before, features, reasons

    @property
    def network(self) -> tuple[Array, ...]:
        """What the kernel reads."""
        return tuple(getattr(self, name) for name in ARRAYS)

    # ---- files -------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write NAME.npz and NAME.json, each whole or not at all; returns the path of the npz.

        Raises FileNotFoundError if the folder does not exist.
        """
        header = {
            "experts": [asdict(e) for e in self.experts], "features": list(kernels.FEATURES),
            "spaces": [CATALOGUE[e.filter].space.fingerprint for e in self.experts],
            "training": self.training,
        }  # fmt: skip
        return portable.write(path, KIND, {n: getattr(self, n) for n in ARRAYS}, header)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Mixture:
        """Read what `save` wrote: NAME, with or without ".npz".

        Raises:
            FileNotFoundError: one of the two files is missing.
            ValueError: truncated or foreign files, weights that do not fit, other features or parameter
                spaces than this navgym's.
        """
        header, arrays = portable.read(path, KIND, ("experts", "features", "spaces", "training"))
        file = portable.pair(path)[0]
        missing = [name for name in ARRAYS if name not in arrays]
        if missing:
            raise ValueError(f"{file} is damaged: it lacks {missing[0]!r}. Save it again.")
        try:
            experts = tuple(Expert(e["filter"], dict(e["parameters"])) for e in header["experts"])
            _same(header, experts)
            own = {n: arrays[n] for n in ARRAYS}
            return cls(experts, **own, training=dict(header["training"]))
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{file}: {error}") from error


def _same(header: Mapping[str, Any], experts: Sequence[Expert]) -> None:
    """ValueError unless features and parameter spaces are those of this navgym."""
    found = [CATALOGUE[e.filter].space.fingerprint for e in experts]
    if list(header["spaces"]) != found or list(header["features"]) != list(kernels.FEATURES):
        raise ValueError(
            "the mixture was made for other features or parameter spaces than this navgym's: train it "
            "again, or install the navgym that made it."
        )


# ---- what experts say


@dataclass(frozen=True, eq=False)
class Seen:
    """What experts made of a batch, as the kernel reads it.

    Args:
        states: (N, T, K, n).
        innovations: (N, T, K, m).
        nis: (N, T) of the reference.
        lost: (N, T, m).
        root: (N, 1 or T, m) √R.
        kind: (m,) 0 where a row is of a position fix.
        told: (N, T, 4) what the bank's weights say; zeros without a bank.
        finite: (N, T, K) where an expert's state is one.
    """

    states: Array
    innovations: Array
    nis: Array
    lost: NDArray[np.bool_]
    root: Array
    kind: NDArray[np.int64]
    told: Array
    finite: NDArray[np.bool_]

    @property
    def arguments(self) -> tuple[Any, ...]:
        """The kernel's first arguments."""
        return (
            self.innovations, self.nis, self.lost, self.root, self.kind, self.told, self.finite,
        )  # fmt: skip


def watched(experts: Sequence[Expert], batch: StateSpaceBatch) -> tuple[list[Run], Seen]:
    """Run every expert over a batch."""
    problem = problem_of(batch.recordings[0])
    kind = kinds(problem, batch)
    finite: NDArray[np.bool_]
    runs = [problem.run(e.filter, batch, dict(e.parameters), everything=True) for e in experts]
    told = np.zeros((len(batch), batch.steps, kernels.TOLD))
    for expert, run in zip(experts, runs, strict=True):
        if expert.filter == BANK:
            told = np.nan_to_num(run.extras["weights"]) @ meanings(Structure.of(batch))
    states = np.stack([r.states for r in runs], axis=2)
    root = np.sqrt(np.diagonal(batch.models["R"], axis1=2, axis2=3))
    finite = np.all(np.isfinite(states), axis=-1)
    seen = Seen(
        states, np.stack([r.innovations for r in runs], axis=2), runs[0].nis, batch.lost,
        np.ascontiguousarray(root), kind, told, finite,
    )  # fmt: skip
    return runs, seen


def blended(weights: Array, each: Array) -> Array:
    """Σ w_j x_j (N, T, n) of (N, T, K) and (N, T, K, n); what has no weight may be no number."""
    held = np.where(weights[..., None] > 0.0, each, 0.0)
    found: Array = (weights[..., None] * held).sum(axis=-2)
    return found


def spread(
    weights: Array, states: Array, each: Array, covariances: Sequence[Array]
) -> NDArray[np.float64]:
    """Covariance (N, T, n, n) of the mixture."""
    found = np.zeros((*states.shape, states.shape[-1]))
    for j, covariance in enumerate(covariances):
        held = weights[..., j, None] > 0.0
        off = np.where(held, each[..., j, :] - states, 0.0)
        own = np.where(held[..., None], covariance, 0.0) + off[..., :, None] * off[..., None, :]
        found += weights[..., j, None, None] * own
    return found


def mixed_likelihood(before: Array, each: Array) -> Array:
    """ln Σ w_j p_j (N, T) of the experts' log-likelihoods (N, T, K); NaN where nothing was received."""
    known = (before > 0.0) & np.isfinite(each)
    top = np.where(known, each, -np.inf).max(axis=-1)
    base = np.where(np.isfinite(top), top, 0.0)
    total = (
        before * np.where(known, np.exp(np.where(known, each, 0.0) - base[..., None]), 0.0)
    ).sum(-1)
    with np.errstate(divide="ignore"):
        return np.where(np.isfinite(top), base + np.log(total), np.nan)


def joined(parts: Sequence[Run]) -> Run:
    """Runs of parts of a batch as one."""
    if len(parts) == 1:
        return parts[0]
    names = [n for n in Run.__dataclass_fields__ if n != "extras"]
    arrays = {n: np.concatenate([getattr(p, n) for p in parts]) for n in names}
    extras = {n: np.concatenate([p.extras[n] for p in parts]) for n in parts[0].extras}
    return Run(**arrays, extras=extras)
