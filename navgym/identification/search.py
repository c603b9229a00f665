"""Searches by a population, for a least cost within a box: a whole generation costs one call.

Both draw as mealpy 3.0.2 does, so that a seed finds what it finds there, to the bit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from navgym.core.checks import Array

Cost = Callable[[Array], Array]  # of places (P, D), one each: (P,)
SOCIAL, INERTIA = 2.05, 0.4  # of a particle: the pull of the best one, and of its own velocity


def whale(
    cost: Cost, low: Array, high: Array, *, seed: int, population: int, epochs: int
) -> tuple[Array, float]:
    """The whale optimiser (Mirjalili & Lewis 2016): a best place (D,) and its cost.

    A whale moves around the best of all, around a place drawn at random, or on a spiral; it stays
    where it is unless the new place is better.

    Args:
        cost: what is to be small.
        low: (D,) least values.
        high: (D,) largest values.
        seed: of all draws.
        population: number of whales.
        epochs: number of generations.
    """
    moves, places = np.random.default_rng(seed), np.random.default_rng(seed)
    herd = _Herd(cost, places.uniform(low, high, (population, len(low))))
    for epoch in range(1, epochs + 1):
        reach = 2.0 - 2.0 * epoch / epochs
        r, turn, coin = moves.random((population, 3)).T[:, :, None]
        A, turn, circles = 2.0 * reach * r - reach, 2.0 * turn - 1.0, coin < 0.5
        prey = np.tile(herd.best, (population, 1))
        lost = (circles & (np.abs(A) >= 1.0))[:, 0]
        prey[lost] = places.uniform(low, high, (np.count_nonzero(lost), len(low)))
        around = prey - A * np.abs(2.0 * r * prey - herd.place)
        radius = np.abs(herd.best - herd.place)
        spiral = herd.best + np.exp(turn) * np.cos(2.0 * np.pi * turn) * radius
        herd.move(np.clip(np.where(circles, around, spiral), low, high))
    return herd.best, herd.least


def swarm(
    cost: Cost, low: Array, high: Array, *, seed: int, population: int, epochs: int
) -> tuple[Array, float]:
    """Particle swarm optimisation (Kennedy & Eberhart 1995): a best place (D,) and its cost.

    A particle stays where it is unless the new place is better. So it always rests at the best
    place of its own, whose pull is nought; a coordinate that leaves the box is drawn anew.

    Args:
        cost: what is to be small.
        low: (D,) least values.
        high: (D,) largest values.
        seed: of all draws.
        population: number of particles.
        epochs: number of generations.
    """
    moves, places = np.random.default_rng(seed), np.random.default_rng(seed)
    herd = _Herd(cost, places.uniform(low, high, (population, len(low))))
    fastest = 0.5 * (high - low)
    velocity = moves.uniform(-fastest, fastest, herd.place.shape)
    for _ in range(epochs):
        # the first of three draws would be of a particle's own best
        _, social, anew = moves.random((population, 3, len(low))).transpose(1, 0, 2)
        velocity = INERTIA * velocity + SOCIAL * social * (herd.best - herd.place)
        trial = herd.place + velocity
        herd.move(np.where((low <= trial) & (trial <= high), trial, low + (high - low) * anew))
    return herd.best, herd.least


class _Herd:
    """Places (P, D) that only ever get better, and the best of all so far."""

    def __init__(self, cost: Cost, place: Array) -> None:
        self.cost, self.place, self.costs = cost, place, cost(place)
        self.best, self.least = place[0].copy(), np.inf
        self._keep_best()

    def move(self, trial: Array) -> None:
        """Each to its trial place, where that is better."""
        costs = self.cost(trial)
        better = costs < self.costs
        self.place[better], self.costs[better] = trial[better], costs[better]
        self._keep_best()

    def _keep_best(self) -> None:
        first = int(np.argsort(self.costs)[0])  # not argmin: among equals, that which mealpy takes
        if self.costs[first] < self.least:
            self.best, self.least = self.place[first].copy(), float(self.costs[first])
