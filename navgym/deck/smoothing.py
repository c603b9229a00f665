"""Fixed-interval smoothing of the deck's banks: each step by everything that was measured, after it too.

Rauch, Tung & Striebel 1965 within each mode, modes mixed by the probabilities that the bank gave them
when it saw the step (Helmick, Blair & Hoffman 1995, without their second pass of probabilities). In the
lag-one form: first the step's own rows improve where the mode began the step, through m as well, which
has no memory; then what came later goes through θ, θ̇ and the rest. A slam's jump enters with the
probabilities of its branches, so that what came after does not pull θ̇ before it.

The kernel's memory of a step is large: the bank runs once and leaves marks, and from each of them, the
last first, once more.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navgym.core.checks import Array
from navgym.core.smoothing import smoothing_gain
from navgym.deck import alignment, bank, joint
from navgym.deck.batch import DeckBatch
from navgym.deck.hypotheses import Bank, outputs_for
from navgym.problem import Filter, Run

STRETCH = 200  # filter steps between two marks
NEGLIGIBLE = 1e-4  # modes of less probability are left out
AT = joint.AT
KEPT = np.arange(AT.LAGGED)  # what goes from step to step: all but copies of θ̇ and m
OWN = np.r_[KEPT, np.arange(AT.MEAN, AT.MEAN + 3)]  # and what a step's rows see


def smooth(
    chosen: Filter,
    batch: DeckBatch,
    table: Array,
    interval: int,
    run: Run,  # noqa: ARG001
) -> tuple[Array, Array]:
    """Smoothed states (K, 24) and covariances (K, 24, 24) of a batch of one recording.

    Args:
        chosen: a bank, or the oracle.
        batch: mechanised.
        table: (1, intervals, parameters) in the order of the filter's space.
        interval: steps per row of it.
        run: of the filter, which has not failed.
    """
    own = Bank.of(chosen, batch, table, interval)
    n, K = alignment.STATES, int(batch.lengths[0])
    states, covariances = np.empty((K, n)), np.empty((K, n, n))
    marks = _forward(own, K)
    x, P = own.lanes["x"][0, -1, KEPT], own.lanes["P"][0, -1][np.ix_(KEPT, KEPT)]
    for first, lanes in reversed(marks):
        own.lanes[...] = lanes
        last = min(first + STRETCH, K)
        steps = range(last - 1, first - 1, -1)
        for k, before in zip(steps, _remembered(own, first, last), strict=True):
            states[k], covariances[k] = x[:n], P[:n, :n]
            x, P = _step_back(x, P, before)
    return states, covariances


def _forward(own: Bank, steps: int) -> list[tuple[int, NDArray[Any]]]:
    """Run to the end; the lanes as they were at the start of each stretch."""
    marks = []
    for first in range(0, steps, STRETCH):
        marks.append((first, own.lanes.copy()))
        last = min(first + STRETCH, steps)
        own.run(first, last, outputs_for(1, last - first, len(own.kinds), everything=False))
    return marks


def _remembered(own: Bank, first: int, last: int) -> Iterator[dict[str, Array]]:
    """By name, what `_step_back` needs of each step of a stretch, the last first."""
    out = outputs_for(1, last - first, len(own.kinds), everything=False, memories=True)
    own.run(first, last, out)
    likely = out["memories"]["chance"][0] > NEGLIGIBLE
    J2 = (own.rows[0, 0, bank.SLAM_SIZE] * own.models["start"][0, 0, AT.RATE : AT.RATE + 3]) ** 2
    found = _gains(out["memories"][0][likely], J2, float(own.models["dt"][0, 0]))
    ends = np.cumsum(likely.sum(axis=1))
    for begin, end in zip(np.r_[0, ends][-2::-1], ends[::-1], strict=True):
        yield {name: array[begin:end] for name, array in found.items()}


def _gains(memory: NDArray[Any], jump: Array, dt: float) -> dict[str, Array]:
    """Of steps of modes (S,): where each began by its own rows, and the gain of what came later."""
    P = memory["P_prior"][..., OWN[:, None], OWN]
    struck = (memory["told"][:, 1:] > 0.0).any(axis=1)
    P[struck] += _jumps(memory[struck], jump, dt)
    crossed = memory["crossed"][..., OWN[:, None], KEPT]
    G = smoothing_gain(crossed, P)  # (S, kept, own)
    posterior = memory["P"][..., OWN[:, None], OWN]
    x = memory["x_from"][..., KEPT] + _times(G, memory["x"][..., OWN] - memory["x_prior"][..., OWN])
    back = G @ (posterior - P) @ G.swapaxes(-1, -2)
    kept = posterior[..., : len(KEPT), : len(KEPT)]
    later = smoothing_gain((posterior @ G.swapaxes(-1, -2))[..., : len(KEPT), :], kept)
    return {
        "chance": memory["chance"],
        "x_from": x,
        "P_from": memory["P_from"][..., KEPT[:, None], KEPT] + back,
        "gain": later,
        "x": memory["x"][..., KEPT],
        "P": kept,
    }


def _jumps(memory: NDArray[Any], variance: Array, dt: float) -> Array:
    """(S, own, own) covariance of the jumps of θ̇ as likely as the rows made them."""
    found: Array = np.zeros((*memory.shape, len(OWN), len(OWN)))
    for b, f in enumerate(bank.LEFT, start=1):
        for a in range(3):
            u = np.zeros((*memory.shape, joint.STATES))
            u[..., AT.THETA + a], u[..., AT.RATE + a], u[..., AT.MEAN + a] = f * dt, 1.0, f
            B = memory["B"]
            u[..., AT.VR : AT.VR + 3] = B[..., a] * f * dt + B[..., 3 + a]
            v = u[..., OWN] * np.sqrt(memory["told"][..., b] * variance[a])[..., None]
            found += v[..., :, None] * v[..., None, :]
    return found


def _times(G: Array, x: Array) -> Array:
    found: Array = (G @ x[..., None])[..., 0]
    return found


def _step_back(x: Array, P: Array, before: dict[str, Array]) -> tuple[Array, Array]:
    """Smoothed moments a step earlier from those at its end, modes mixed by their probabilities."""
    G, w = before["gain"], before["chance"] / before["chance"].sum()
    each = before["x_from"] + _times(G, x - before["x"])
    spread = before["P_from"] + G @ (P - before["P"]) @ G.swapaxes(-1, -2)
    mean = w @ each
    off = each - mean
    P = np.einsum("j,jab->ab", w, spread) + np.einsum("j,ja,jb->ab", w, off, off)
    return mean, 0.5 * (P + P.T)
