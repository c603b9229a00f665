"""Fixed-interval smoothing of the INS filters on the tape that they ran on (Rauch, Tung & Striebel 1965).

The loop is closed: a step's nominal is what the filter knew then, and its error is zero by its own account.
What the measurements of the next step, and all later ones, removed of the error there goes back through
Φ, and is taken off the nominal here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from navgym.core.checks import Array
from navgym.core.smoothing import smoothing_gain
from navgym.ins import filtering
from navgym.ins.batch import InsBatch
from navgym.ins.error_state import LANE
from navgym.ins.estimation import full_table, rule_of
from navgym.ins.layout import ALPHA, BA, BG, MOVING, PHI, STATES, TOUCHING, C, M, R, S, V
from navgym.problem import Filter, Run

STRETCH = 500  # steps whose gains are solved for at once
NOMINAL_LESS_TRUE, TRUE_LESS_NOMINAL = (R, V), (BG, BA, M, S, ALPHA, C)  # signs of the error state


@dataclass(frozen=True, eq=False)
class Way:
    """What the filter did in each of K steps.

    Args:
        P_prior: (K, 22, 22) before the step's measurements.
        removed: (K, 22) of the error by those.
        moved: (K, 9, 15) Φ of the step.
        kept: (K,) what it kept of the current.
    """

    P_prior: Array
    removed: Array
    moved: Array
    kept: Array


def smooth(
    chosen: Filter, batch: InsBatch, table: Array, interval: int, run: Run
) -> tuple[Array, Array]:
    """Smoothed states (K, 22) and covariances (K, 22, 22) of a batch of one recording.

    Args:
        chosen: any INS filter.
        batch: the recording's tape.
        table: (1, intervals, parameters) in the order of the filter's space.
        interval: steps per row of it.
        run: of the filter, which has not failed.
    """
    way, P = _again(chosen, batch, table, interval), run.covariances[0].copy()
    K = len(P)
    error = np.zeros((K, STATES))
    for first in range(max(K - 1 - STRETCH, 0), -STRETCH, -STRETCH):
        own = slice(max(first, 0), min(first + STRETCH, K - 1))
        gains = _gains(way, P[own], own)
        for k in range(own.stop - 1, own.start - 1, -1):
            G = gains[k - own.start]
            error[k] = G @ (way.removed[k + 1] + error[k + 1])
            P[k] += G @ (P[k + 1] - way.P_prior[k + 1]) @ G.T
    return _without(run.states[0], error), 0.5 * (P + P.swapaxes(1, 2))


def _again(chosen: Filter, batch: InsBatch, table: Array, interval: int) -> Way:
    """The filter's way once more, step by step."""
    rows, K = full_table(chosen.space, table), int(batch.lengths[0])
    lane = np.zeros(1, LANE)
    filtering.begin(lane, batch.models, rows[:, 0])
    lane["keeps"] = 1
    rule, report = rule_of(chosen.option, False), np.zeros((1, 1), filtering.REPORT)
    world = batch.models, batch.sensors, batch.tapes[:, :K], batch.events, rule, rows, interval
    states, none = np.zeros((1, K, STATES)), np.zeros((1, 0, STATES, STATES))
    found = Way(
        np.empty((K, STATES, STATES)), np.empty((K, STATES)), np.empty((K, MOVING, TOUCHING)),
        np.full(K, batch.models["current_memory"][0]),
    )  # fmt: skip
    for k in range(K):
        lane["length"] = k + 1
        filtering.run(lane, *world, states, report, none)  # type: ignore[no-untyped-call]
        found.P_prior[k], found.removed[k] = lane["P_prior"][0], lane["removed"][0]
        found.moved[k] = lane["Phi"][0]
    return found


def _gains(way: Way, P: Array, own: slice) -> Array:
    """(S, 22, 22) of steps `own`: by how much each moves with what comes to light a step later."""
    later = slice(own.start + 1, own.stop + 1)
    Phi: NDArray[Any] = np.repeat(np.eye(STATES)[None], len(P), axis=0)
    Phi[:, :MOVING, :TOUCHING] = way.moved[later]
    for i in range(C.start, C.stop):
        Phi[:, i, i] = way.kept[later]
    return smoothing_gain(Phi @ P, way.P_prior[later])


def _without(states: Array, error: Array) -> Array:
    """States (K, 22) less errors (K, 22) of the nominal, by the signs of `navgym.ins.error_state`."""
    found = states.copy()
    for block in NOMINAL_LESS_TRUE:
        found[:, block] -= error[:, block]
    for block in TRUE_LESS_NOMINAL:
        found[:, block] += error[:, block]
    angles = states[:, PHI][:, ::-1]
    turned = Rotation.from_rotvec(error[:, PHI]) * Rotation.from_euler("ZYX", angles)
    found[:, PHI] = turned.as_euler("ZYX")[:, ::-1]
    return found
