"""Fixed-interval smoothing of Kalman filters (Rauch, Tung & Striebel 1965)."""

from __future__ import annotations

import numpy as np

from navgym.core.checks import Array
from navgym.problem import Filter, Run
from navgym.statespace.batch import StateSpaceBatch, stretch


def smooth(
    chosen: Filter, batch: StateSpaceBatch, table: Array, interval: int, run: Run
) -> tuple[Array, Array]:
    """Smoothed states (T, n) and covariances (T, n, n) of a batch of one recording.

    Args:
        chosen: `kf`, or `oracle`.
        batch: with linear models.
        table: (1, intervals, parameters) in the order of the filter's space.
        interval: samples per row of it.
        run: of the filter.
    """
    T = batch.steps
    x, P = run.states[0].copy(), run.covariances[0].copy()
    models = stretch(batch.models[0], T)
    F, Q = models["F"][1:], models["Q"][1:] * _process_scale(chosen, batch, table, interval)
    prior_x, prior_P = (F @ x[:-1, :, None])[..., 0], F @ P[:-1] @ F.swapaxes(1, 2) + Q
    gains = np.linalg.solve(prior_P, F @ P[:-1]).swapaxes(1, 2)
    for k in range(T - 2, -1, -1):
        G = gains[k]
        x[k] += G @ (x[k + 1] - prior_x[k])
        P[k] += G @ (P[k + 1] - prior_P[k]) @ G.T
    return x, P


def _process_scale(chosen: Filter, batch: StateSpaceBatch, table: Array, interval: int) -> Array:
    """(T - 1, 1, 1) multiples of Q from one sample to the next, as the filter took them."""
    k = np.arange(1, batch.steps)
    if chosen.needs_scales:
        assert batch.scales is not None
        found = stretch(batch.scales[0], batch.steps)[1:, 0]
    else:
        column = chosen.space.index("process_noise_scale")
        found = table[0, np.minimum(k // interval, table.shape[1] - 1), column]
    return np.asarray(found)[:, None, None]
