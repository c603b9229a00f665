"""References drawn anew for each training recording, so that a policy improves on whatever it is given.

A policy whose actions are residuals is used around parameters that somebody tuned for his own sea. It
learns that by meeting many: mostly those of a table that suit the recording best in hindsight, which is
what tuning comes to and leaves little to win, else any that are not hopeless there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from navgym.agents.evaluation.rollout import problem_in
from navgym.agents.training.configuration import Configuration
from navgym.core.checks import Array
from navgym.core.parameters import ParameterSpace
from navgym.problem import Problem
from navgym.tuning.cases import Cases

STREAM = 0xC1  # first word of the seed sequence: no simulator's
DRAWN = 8  # of the table's settings, beside those of the catalogue
LOOKED = 8  # settings that are tried on each recording
TUNED = 0.8  # share of recordings whose reference is the best of the table
HOPELESS = 2.0  # errors of the best of the table
CHUNK = 200  # recordings that are run at once

Reference = Mapping[str, Any]


def starts_of(config: Configuration, recordings: Sequence[Any]) -> Any:
    """What actions start from: the configuration's reference, or with `references` one per recording."""
    if not config.references:
        return config.reference
    problem = problem_in(config.environment)
    table = settings_table(problem, config.reference, config.action_parameters, config.seed)
    return drawn(problem, recordings, table, config.seed)


def settings_table(
    problem: Problem, own: Reference, steered: Sequence[str], seed: int
) -> list[Reference]:
    """Settings of the environment's filter: `own` first, its defaults, the catalogue's, and drawn ones."""
    space: ParameterSpace = problem.environment.settings.SPACE
    known = [own, space.defaults]
    known += [dict(s.reference) for s in problem.scenarios.values() if s.reference]
    rng = np.random.default_rng(np.random.SeedSequence([STREAM, seed]))
    chosen = space.subset(steered)
    for _ in range(DRAWN):
        places = [rng.uniform(low, high) for low, high, *_ in chosen.table()]
        values = [min(max(p.unwarp(u), p.low), p.high) for p, u in zip(chosen, places, strict=True)]
        choices = {p.name: str(rng.choice(p.choices)) for p in space if p.choices}
        known.append(
            {**own, **choices, **{p.name: p.show(v) for p, v in zip(chosen, values, strict=True)}}
        )
    return known


def drawn(problem: Problem, recordings: Sequence[Any], settings: Sequence[Reference], seed: int) -> list[Reference]:  # fmt: skip
    """A reference for each recording: of LOOKED settings of a table, the first one always among them."""
    rng = np.random.default_rng(np.random.SeedSequence([STREAM, seed, 1]))
    which = rng.integers(len(settings), size=(LOOKED, len(recordings)))
    which[0] = 0
    errors = np.stack([_errors(problem, recordings, [settings[i] for i in row]) for row in which])
    found = []
    for column, tried in zip(errors.T, which.T, strict=True):
        best = int(np.argmin(column))
        fair = np.flatnonzero(column <= HOPELESS * column[best])
        chosen = best if rng.random() < TUNED or not len(fair) else int(rng.choice(fair))
        found.append(settings[tried[chosen]])
    return found


def _errors(problem: Problem, recordings: Sequence[Any], settings: Sequence[Reference]) -> Array:
    """(recordings,) errors against the truth, each with its setting; infinite where the filter failed."""
    name = problem.environment.settings.FILTER
    found = np.empty(len(recordings))
    for first in range(0, len(recordings), CHUNK):
        part = slice(first, first + CHUNK)
        cases = Cases.of(recordings[part])
        run = problem.run(name, cases.batch, [dict(each) for each in settings[part]])
        found[part] = np.where(run.diverged > 0, np.inf, cases.true_errors(run))
    return np.where(np.isfinite(found), found, np.inf)
