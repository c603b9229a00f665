"""A hundred thousand random models and losses: no bank says NaN, or what is no covariance, unflagged."""

import numpy as np
import pytest

import navgym
from navgym.statespace.batch import StateSpaceBatch
from tests.helpers import run

STEPS = 12
KINDS = ("any", "moving", "hardly known", "stiff")


def models(rng, count, kind):
    """Parts (count, ...) of models of 4 states and 4 measurements, whose variances span up to ten orders of magnitude."""

    def covariances(spread):
        root = rng.standard_normal((count, 4, 4))
        scale = 10.0 ** rng.uniform(-spread, spread, (count, 4, 1))
        M = scale * (root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(4)) * np.swapaxes(scale, 1, 2)
        return (M + np.swapaxes(M, 1, 2)) / 2.0

    spread = 2.5 if kind == "stiff" else 1.0
    F, H = rng.standard_normal((count, 4, 4)), rng.standard_normal((count, 4, 4))
    F *= (rng.uniform(0.3, 1.02, count) / np.abs(np.linalg.eigvals(F)).max(1))[:, None, None]
    parts = {name: covariances(spread) for name in ("Q", "R", "P0")}
    if kind == "moving":
        F, H = np.tile(np.eye(4), (count, 1, 1)), np.tile(np.eye(4), (count, 1, 1))
        F[:, 0, 1] = F[:, 2, 3] = 10.0 ** rng.uniform(-2, 3, count)
        H *= 10.0 ** rng.uniform(-2, 2, (count, 4, 1))
        parts["R"] = parts["R"] * np.eye(4)
    if kind == "hardly known":
        parts["P0"] = parts["P0"] * 10.0 ** rng.uniform(0, 12, (count, 1, 1))
    return parts | {"F": F, "H": H}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["bank", "bank_2026"])
def test_nothing_that_is_no_number_goes_unflagged(name, kind):
    rng = np.random.default_rng([KINDS.index(kind), len(name)])
    flagged = 0
    for _ in range(13):
        parts = models(rng, 1000, kind)
        recordings = []
        for i in range(1000):
            own = {"position": (0, 2), "velocity": (1, 3)} if kind == "moving" else {}
            model = navgym.LinearModel(**{k: v[i] for k, v in parts.items()}, **own)
            size = 10.0 ** rng.uniform(-3, 6)
            lost = rng.random((STEPS, 4)) < rng.choice([0.0, 0.3, 0.8])
            time = np.cumsum(rng.uniform(0.01, 100.0, STEPS))
            y = size * rng.standard_normal((STEPS, 4))
            recordings.append(navgym.Recording(time, y, lost, model=model))
        found = run(name, StateSpaceBatch.of(recordings), everything=True)
        bad = ~np.isfinite(found.states).all((1, 2)) | ~np.isfinite(found.covariances).all(
            (1, 2, 3)
        )
        variances = np.diagonal(found.covariances, axis1=2, axis2=3)
        bad |= ~(variances >= 0.0).all((1, 2)) | ~np.isfinite(found.log_likelihood[:, 0:1]).all(
            1
        ) & ~np.array([r.lost[0].all() for r in recordings])
        assert not (bad & ~found.diverged).any()
        flagged += int(found.diverged.sum())
    assert flagged < 13_000 / 5
