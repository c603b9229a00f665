"""AUV recordings: tracks, noise regimes and losses.

Each recording draws from generators of its own (track, noise, loss, regime, sway), so changing one
of them, say the loss rate, leaves the others' numbers as they were: comparisons across conditions
are paired. Random numbers are drawn by numpy, recursions are compiled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navgym.auv.scenarios import AUVScenario, Loss, Regime
from navgym.core.checks import Array
from navgym.core.compile import kernel
from navgym.core.regimes import sequence
from navgym.core.seeds import split_of
from navgym.statespace.models import constant_velocity
from navgym.statespace.recording import Model, Recording
from navgym.statespace.turn_model import CoordinatedTurnModel

STREAM = 0xA0  # first word of every AUV seed sequence: other simulators take other words


def simulate(scenario: AUVScenario, seeds: Sequence[int]) -> list[Recording]:
    """One recording per seed; the same seed gives the same recording in any company."""
    model = scenario.model
    regimes = [_effective(r, scenario) for r in scenario.regimes]
    square_roots = [np.linalg.cholesky(m) for m in (model.P0, model.Q, model.R)]
    meta = {"scenario": f"auv/{scenario.name}", "regimes": [r.name for r in regimes]}
    time = scenario.dt * np.arange(1.0, scenario.steps + 1)
    base = scenario.loss
    assert isinstance(base, Loss)
    kinds = [r.loss if isinstance(r.loss, Loss) else base for r in regimes]
    recordings = []
    for seed in seeds:
        split_of(seed)
        track, noise, loss, order, sway = (
            np.random.default_rng(s) for s in np.random.SeedSequence([STREAM, seed]).spawn(5)
        )
        regime = sequence(len(regimes), scenario.dwell, scenario.steps, order)
        q = np.array([r.process_scale for r in regimes])[regime]
        r = _measurement_scales(regimes, regime, noise)
        truth = _track(scenario, model, square_roots, q, track)
        if scenario.sway is not None:
            truth = truth + swaying(time - scenario.dt, *scenario.sway, sway)
        v = noise.standard_normal((scenario.steps, model.m)) @ square_roots[2].T
        v = remembering(v, scenario.memory)
        recordings.append(
            Recording(
                time=time,
                measurements=_wrapped(model.observe(truth) + np.sqrt(r)[:, None] * v, model),
                lost=draw_losses(base, kinds, regime, model.m, loss),
                truth=truth,
                regime=regime,
                model=model,
                meta=meta | {"seed": int(seed)},
                process_scale=q,
                measurement_scale=r,
            )
        )
    return recordings


def swaying(time: Array, amplitude: float, period: float, rng: np.random.Generator) -> Array:
    """What a sinusoidal push adds to [px, vx, py, vy], (T, 4): from rest, each axis in its own phase.

    Args:
        time: (T,) s since it began.
        amplitude: of the acceleration, m/s².
        period: s.
        rng: of the phases.
    """
    w, phase = 2.0 * math.pi / period, rng.uniform(0.0, 2.0 * math.pi, 2)
    speed, t = amplitude / w, time[:, None]
    added = np.empty((len(time), 4))
    added[:, 1::2] = speed * (np.sin(w * t + phase) - np.sin(phase))
    swing = -speed / w * (np.cos(w * t + phase) - np.cos(phase))
    added[:, ::2] = swing - speed * np.sin(phase) * t
    return added


def remembering(noise: Array, memory: float) -> Array:
    """White noise (T, m) as one of which each value holds `memory` of the last: as large as before."""
    if memory == 0.0:
        return noise
    found, fresh = noise.copy(), math.sqrt(1.0 - memory**2)
    for k in range(1, len(found)):
        found[k] = memory * found[k - 1] + fresh * noise[k]
    return found


def _effective(regime: Regime, scenario: AUVScenario) -> Regime:
    """`regime` with the scenario's global factors applied."""
    manoeuvres = regime.process_scale > 1.0 and scenario.manoeuvre_scale is not None
    process = scenario.manoeuvre_scale if manoeuvres else regime.process_scale
    assert process is not None
    fixed = scenario.outlier_scale
    return Regime(
        name=regime.name,
        measurement_scale=regime.measurement_scale * scenario.measurement_scale,
        process_scale=process * scenario.process_scale,
        outlier_rate=regime.outlier_rate,
        outlier_scale=regime.outlier_scale if fixed is None else fixed,
        degrees=regime.degrees,
        loss=regime.loss,
    )


def _measurement_scales(
    regimes: Sequence[Regime], regime: NDArray[np.int64], rng: np.random.Generator
) -> Array:
    """True multiple of R at each sample: regime, outliers and heavy tails together."""
    scale = np.array([r.measurement_scale for r in regimes])[regime]
    rate = np.array([r.outlier_rate for r in regimes])[regime]
    factor = np.array([r.outlier_scale for r in regimes])[regime]
    scale = np.where(rng.random(len(regime)) < rate, scale * factor, scale)
    for i, r in enumerate(regimes):
        if r.degrees is not None:
            chi2 = rng.chisquare(r.degrees, len(regime))
            scale = np.where(regime == i, scale * r.degrees / chi2, scale)
    return scale


def _wrapped(measurements: Array, model: Model) -> Array:
    """`measurements` (T, m) with the model's angles brought into [−π, π)."""
    angles = list(model.angles)
    measurements[:, angles] = (measurements[:, angles] + math.pi) % (2.0 * math.pi) - math.pi
    return measurements


def _track(
    scenario: AUVScenario,
    model: Model,
    square_roots: list[Array],
    q: Array,
    rng: np.random.Generator,
) -> Array:
    """True states: the model's own motion under q·Q, bent by turns if the scenario has them."""
    x0 = model.x0 + square_roots[0] @ rng.standard_normal(model.n)
    w = rng.standard_normal((scenario.steps, model.n)) @ square_roots[1].T
    w *= np.sqrt(q)[:, None]
    if isinstance(model, CoordinatedTurnModel):
        omega = np.cumsum(np.append(x0[4], w[:, 4]))
        F, x0, w = constant_velocity(scenario.dt), x0[:4], np.ascontiguousarray(w[:, :4])
        before, after = omega[:-1], omega[1:, None]
    else:
        F, before = np.ascontiguousarray(model.F), _turn_rates(scenario, rng)
        after = np.empty((scenario.steps, 0))
    truth = np.empty((scenario.steps, F.shape[0]))
    move(x0, F, w, before, scenario.dt, truth)
    return np.concatenate([truth, after], axis=1)


def _turn_rates(scenario: AUVScenario, rng: np.random.Generator) -> Array:
    """Turn rate in rad/s over each step: turns to either side between straight legs."""
    turns, steps = scenario.turns, scenario.steps
    omega = np.zeros(steps if turns is not None else 0)
    k, turning = 0, False
    while turns is not None and k < steps:
        least, largest = (max(1, round(d / scenario.dt)) for d in turns.dwell)
        stay = int(rng.integers(least, largest + 1))
        if turning:
            omega[k : k + stay] = math.radians(rng.uniform(*turns.rate)) * rng.choice((-1.0, 1.0))
        k, turning = k + stay, not turning
    return omega


@kernel
def move(x0, F, w, omega, dt, truth):
    """x_k = F x_{k-1} + w_k; with turn rates, F of the coordinated turn over `dt`."""
    n = len(x0)
    for k in range(truth.shape[0]):
        for i in range(n):
            s = w[k, i]
            for j in range(n):
                s += F[i, j] * (x0[j] if k == 0 else truth[k - 1, j])
            truth[k, i] = s
        if len(omega) > 0 and omega[k] != 0.0:
            a = omega[k] * dt
            sine, cosine = math.sin(a), math.cos(a)
            vx = x0[1] if k == 0 else truth[k - 1, 1]
            vy = x0[3] if k == 0 else truth[k - 1, 3]
            along, across = sine / omega[k], (1.0 - cosine) / omega[k]
            truth[k, 0] += (along - dt) * vx - across * vy
            truth[k, 1] += (cosine - 1.0) * vx - sine * vy
            truth[k, 2] += across * vx + (along - dt) * vy
            truth[k, 3] += sine * vx + (cosine - 1.0) * vy


def draw_losses(
    base: Loss,
    kinds: Sequence[Loss],
    regime: NDArray[np.int64],
    m: int,
    rng: np.random.Generator,
) -> NDArray[np.bool_]:
    """Which components of which samples are lost, (T, m): also for real logs.

    Args:
        base: its planned outages hold whatever the regime.
        kinds: the random losses of each regime.
        regime: (T,) which of them holds at each sample.
        m: number of measurement components.
        rng: where the random numbers come from, T or T·m of them.
    """
    steps = len(regime)
    which = np.array([kinds.index(kind) for kind in kinds])[regime]  # bursts outlast like regimes
    table = np.array([(*kind.transition, kind.rate, kind.per_component) for kind in kinds])
    columns = m if any(kind.per_component for kind in kinds) else 1
    lost = np.zeros((steps, columns), dtype=np.bool_)
    lose(table, which, rng.random((steps, columns)), lost)
    lost = np.repeat(lost, m // columns, axis=1) if columns == 1 else lost
    gap = steps / max(base.outages, 1)
    for i in range(base.outages):
        first = round((i + 0.5) * gap - base.outage_length / 2)
        lost[max(first, 0) : first + base.outage_length] = True
    return lost


@kernel
def lose(table, which, u, lost):
    """Gilbert-Elliott losses: rows of `table` are P(lost | received), P(lost | lost), P(lost), apart.

    Where a regime does not lose its components apart, they all follow the first one's draw.
    """
    for k in range(lost.shape[0]):
        g = which[k]
        for j in range(lost.shape[1]):
            if k == 0 or which[k - 1] != g:
                p = table[g, 2]
            else:
                p = table[g, 1] if lost[k - 1, j] else table[g, 0]
            lost[k, j] = u[k, j if table[g, 3] else 0] < p
