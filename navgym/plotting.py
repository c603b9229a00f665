"""An estimate drawn: track, errors, innovations, NIS and parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from navgym.core.checks import Array
from navgym.statespace.models import LinearModel

if TYPE_CHECKING:
    from navgym.estimation import Estimate

ELLIPSES = 25  # along a track
BAND = 0.95  # of NIS
COLORS = ("#4a83c4", "#d9822b", "#2a9268", "#8d6bb8", "#2f9aa8", "#b0892e", "#c05f93", "#8b93a0")
TRUTH, FAINT = "#2a9268", "#8b93a0"
MOST = 6  # rows of innovations that are drawn


def plot(estimate: Estimate, path: Path | None) -> Any:
    """See `Estimate.plot`."""
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise ImportError(
            "drawing needs the package matplotlib: pip install 'navgym[render]'"
        ) from error
    panels = [p for p in (_track, _errors, _innovations, _nis, _parameters) if _has(p, estimate)]
    figure = Figure(figsize=(9.0, 2.6 * len(panels) + 1.2), layout="constrained")
    grid = figure.subplots(
        len(panels), squeeze=False, height_ratios=[1.6 if p is _track else 1.0 for p in panels]
    )
    for axes, panel in zip(grid[:, 0], panels, strict=True):
        panel(axes, estimate)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
    figure.suptitle(
        f"{type(estimate).__name__}: {estimate.health}", fontsize=10, x=0.01, ha="left", wrap=True
    )
    if path is not None:
        figure.savefig(path, dpi=120)
    return figure


def _has(panel: Callable[..., None], estimate: Estimate) -> bool:
    if panel is _track:
        return bool(np.any(estimate.pose[0]))
    if panel is _errors:
        return _error(estimate) is not None
    return panel is not _parameters or bool(_scheduled(estimate))


def _place(estimate: Estimate) -> list[int]:
    """States of position: north and east."""
    if hasattr(estimate, "origin"):
        return [0, 1]
    return list(getattr(getattr(estimate.recording, "model", None), "position", (0, 2)))[:2]


def _true(estimate: Estimate) -> Array | None:
    truth = getattr(estimate.recording, "truth", None)
    same = truth is not None and truth.shape == estimate.states.shape
    return truth if same else None


def _track(axes: Any, estimate: Estimate) -> None:
    """The track, ellipses of two standard deviations, and the truth."""
    from matplotlib.patches import Ellipse

    at = _place(estimate)
    north, east = estimate.states[:, at].T
    truth = _true(estimate)
    if truth is not None:
        axes.plot(truth[:, at[1]], truth[:, at[0]], color=TRUTH, lw=1.0, label="truth")
    axes.plot(east, north, color=COLORS[0], lw=1.2, label="estimate, 2σ")
    for k in np.unique(np.linspace(0, len(north) - 1, ELLIPSES).astype(int)):
        P = estimate.covariances[k][np.ix_(at[::-1], at[::-1])]
        if np.isfinite(P).all() and np.isfinite(north[k]):
            values, vectors = np.linalg.eigh(P)
            size = 4.0 * np.sqrt(np.maximum(values, 0.0))
            angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
            axes.add_patch(
                Ellipse(
                    (east[k], north[k]),
                    size[1],
                    size[0],
                    angle=angle,
                    fill=False,
                    ec=COLORS[1],
                    lw=0.8,
                )
            )
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.set_aspect("equal", "datalim")
    axes.legend(frameon=False, fontsize=8)


def _error(estimate: Estimate) -> tuple[Array, Array | None, str] | None:
    """Errors (T, k), their believed deviations or None, and what they are."""
    turned = getattr(estimate, "attitude_error", None)
    if turned is not None:
        return turned, None, "attitude error, arcmin"
    truth = _true(estimate)
    if truth is None:
        return None
    at = _place(estimate)
    deviations = np.sqrt(np.stack([estimate.covariances[:, i, i] for i in at], axis=-1))
    return (estimate.states - truth)[:, at], deviations, "position error, m"


def _errors(axes: Any, estimate: Estimate) -> None:
    """Errors, and bands of two standard deviations."""
    found = _error(estimate)
    assert found is not None
    errors, deviations, what = found
    for k, error in enumerate(errors.T):
        axes.plot(
            estimate.time,
            error,
            color=COLORS[k],
            lw=0.9,
            label=("north", "east")[k] if deviations is not None else "xyz"[k],
        )
        if deviations is not None:
            for side in (-2.0, 2.0):
                axes.plot(estimate.time, side * deviations[:, k], color=COLORS[k], lw=0.7, ls="--")
    axes.set_ylabel(f"{what}{', ±2σ dashed' * (deviations is not None)}")
    axes.legend(frameon=False, fontsize=8, ncols=3)


def _innovation_deviation(estimate: Estimate) -> Array | None:
    """(T, m) of each innovation: the filter's own, else by the recording's linear model, scaled to the filter's NIS.

    What a filter made of the model's Q and R, by its parameters or as it went, stands nowhere but in its NIS.
    """
    if "innovation_variance" in estimate.extras:
        known: Array = np.sqrt(estimate.extras["innovation_variance"])
        return known
    model = getattr(estimate.recording, "model", None)
    if not isinstance(model, LinearModel):
        return None
    P = np.concatenate(
        [np.broadcast_to(model.P0, estimate.covariances[:1].shape), estimate.covariances[:-1]]
    )
    S = (
        model.H
        @ (model.F @ P @ np.swapaxes(model.F, -1, -2) + model.Q)
        @ np.swapaxes(model.H, -1, -2)
        + model.R
    )
    found: Array = np.sqrt(np.diagonal(S, axis1=-2, axis2=-1))
    return found * _scale(estimate, S)[:, None]


def _scale(estimate: Estimate, S: Array) -> Array:
    """(T,) root of what covariances S (T, m, m) of innovations have to be multiplied by for the filter's NIS."""
    lost = ~np.isfinite(estimate.innovations)
    v = np.where(lost, 0.0, estimate.innovations)
    alone = np.where(lost[:, :, None] | lost[:, None, :], np.eye(v.shape[1]), S)
    nis = np.einsum("ti,ti->t", v, np.linalg.solve(alone, v[:, :, None])[..., 0])
    known = (nis > 0.0) & (estimate.nis > 0.0)
    return np.sqrt(np.where(known, nis, 1.0) / np.where(known, estimate.nis, 1.0))


def _innovations(axes: Any, estimate: Estimate) -> None:
    """Innovations over their standard deviations, where these are known."""
    deviation = _innovation_deviation(estimate)
    rows = [
        j
        for j in range(estimate.innovations.shape[1])
        if np.isfinite(estimate.innovations[:, j]).any()
    ][:MOST]
    for k, j in enumerate(rows):
        values = (
            estimate.innovations[:, j]
            if deviation is None
            else estimate.innovations[:, j] / deviation[:, j]
        )
        axes.plot(
            estimate.time, values, ".", ms=2.0, color=COLORS[k % len(COLORS)], label=f"row {j + 1}"
        )
    if deviation is None:
        axes.set_ylabel("innovations")
    else:
        for side in (-2.0, 2.0):
            axes.axhline(side, color=FAINT, lw=1.0, ls="--")
        axes.set_ylabel("innovations over σ, ±2 dashed")
    axes.legend(frameon=False, fontsize=8, ncols=MOST)


def _nis(axes: Any, estimate: Estimate) -> None:
    """NIS per degree of freedom, and where its law has it."""
    heard = np.isfinite(estimate.innovations).sum(axis=1).astype(float)
    there = np.isfinite(estimate.nis) & (heard > 0)
    axes.semilogy(
        estimate.time[there], estimate.nis[there] / heard[there], ".", ms=2.0, color=COLORS[0]
    )
    for share in (0.5 - BAND / 2.0, 0.5 + BAND / 2.0):
        edge = stats.chi2.ppf(share, heard[there]) / heard[there]
        axes.plot(
            estimate.time[there], edge, ".", ms=1.0, color=FAINT
        )  # degrees of freedom change from step to step
    axes.set_ylabel(f"NIS per number, {BAND:.0%} band")
    axes.set_xlabel("time, s")


def _scheduled(estimate: Estimate) -> dict[str, Array]:
    """What changes on the way: parameters of a schedule, and weights of a bank's modes."""
    given = estimate.parameters
    found = {}
    if isinstance(given, Mapping):
        found = {
            n: np.atleast_1d(v)
            for n, v in given.items()
            if np.ndim(v) == 1 and len(np.atleast_1d(v)) > 1
        }
    elif isinstance(given, np.ndarray) and given.ndim == 2 and len(given) > 1:
        found = {f"parameter {j + 1}": column for j, column in enumerate(given.T)}
    return found


def _parameters(axes: Any, estimate: Estimate) -> None:
    """Parameters of a schedule over time."""
    for k, (name, values) in enumerate(_scheduled(estimate).items()):
        at = np.linspace(0, len(estimate.time), len(values), endpoint=False).astype(int)
        axes.step(
            estimate.time[at], values, where="post", color=COLORS[k % len(COLORS)], label=name
        )
    axes.set_ylabel("parameters")
    axes.set_xlabel("time, s")
    axes.legend(frameon=False, fontsize=8)
