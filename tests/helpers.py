"""Random linear models and recordings, and runs of kernels outside their public ranges."""

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import navgym
from navgym.problem import PROBLEMS
from navgym.statespace.batch import StateSpaceBatch, outputs
from navgym.statespace.filters import bank
from navgym.statespace.filters.modes import Structure, pack

SIZES = ((1, 1), (2, 1), (4, 4), (5, 3))  # every (n, m) costs seconds of compilation once
STEPS = 12
NAMES = ("states", "covariances", "innovations", "nis", "log_likelihood")

run = PROBLEMS["auv"].run
run_deck = PROBLEMS["deck"].run


def lane(found, i, length=None):
    """Recording i of a `Run`, by name."""
    return {name: getattr(found, name)[i, :length] for name in NAMES}


@dataclass(frozen=True)
class Problem:
    """A model and one recording of it; `alter` keeps the data and changes parts of either."""

    model: navgym.LinearModel
    time: np.ndarray
    y: np.ndarray
    lost: np.ndarray

    @property
    def recording(self):
        return navgym.Recording(self.time, self.y, self.lost, model=self.model)

    @property
    def parts(self):
        """Model, time, measurements and losses, as every twin takes them."""
        return self.model, self.time, self.y, self.lost

    def alter(self, lost=None, time=None, y=None, **model):
        names = ("F", "H", "Q", "R", "x0", "P0", "position", "velocity")
        parts = {name: getattr(self.model, name) for name in names} | model
        return Problem(
            navgym.LinearModel(**parts),
            self.time if time is None else time,
            self.y if y is None else y,
            self.lost if lost is None else lost,
        )


def spd(rng, n, scale=1.0):
    """A random covariance whose standard deviations spread over a factor of ten or so."""
    factor = rng.standard_normal((n, n))
    D = np.diag(10.0 ** rng.uniform(-0.5, 0.5, n))
    return scale * D @ (factor @ factor.T / n + 0.1 * np.eye(n)) @ D


def random_model(rng, n, m, scales=(1.0, 1.0, 1.0), selects=False, steps=None):
    """A model with a stable or marginal F, H dense or copying states, maybe changing over time.

    Of R only the variances change: an adaptive filter's own R̂ follows those.
    """
    F = rng.standard_normal((steps or 1, n, n))
    F *= (rng.uniform(0.5, 1.0) / np.abs(np.linalg.eigvals(F)).max(-1))[:, None, None]
    H = np.eye(n)[rng.permutation(n)[:m]] if selects else rng.standard_normal((m, n))
    Q = np.stack([spd(rng, n, scales[0]) for _ in range(steps or 1)])
    D = 10.0 ** rng.uniform(-0.5, 0.5, (steps or 1, m))[:, :, None] * np.eye(m)
    R = D @ spd(rng, m, scales[1]) @ D
    if steps is None:
        F, Q, R = F[0], Q[0], R[0]
    return navgym.LinearModel(
        F=F, H=H, Q=Q, R=R, x0=rng.standard_normal(n), P0=spd(rng, n, scales[2])
    )


def random_problem(rng, model, lost):
    """Truth and measurements drawn from the model itself, at times that are multiples of 1/64 s."""
    steps = len(lost)
    packed = np.broadcast_to(model.pack(), steps)
    x = model.x0 + np.linalg.cholesky(model.P0) @ rng.standard_normal(model.n)
    y = np.empty((steps, model.m))
    for k, now in enumerate(packed):
        x = now["F"] @ x + np.linalg.cholesky(now["Q"]) @ rng.standard_normal(model.n)
        y[k] = now["H"] @ x + np.linalg.cholesky(now["R"]) @ rng.standard_normal(model.m)
    time = np.cumsum(rng.integers(32, 96, steps)) / 64.0
    return Problem(model, time, y, np.array(lost))


@st.composite
def problems(draw, sizes=SIZES, steps=STEPS, varying=True):
    """Any loss pattern on a random model of one of the sizes."""
    n, m = draw(st.sampled_from(sizes))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scales = [10.0 ** draw(st.integers(-3, 3)) for _ in range(3)]
    varies = steps if varying and draw(st.booleans()) else None
    model = random_model(rng, n, m, scales, selects=draw(st.booleans()), steps=varies)
    return random_problem(rng, model, draw(hnp.arrays(np.bool_, (steps, m))))


def run_family(family, recording, parameters, option=0, interval=5):
    """Run a filter family past its parameter checks; the result's `lanes` are the final ones.

    Args:
        parameters: one value or schedule per column of the kernel's table.
    """
    batch = StateSpaceBatch.of([recording])
    n, m = recording.model.n, recording.model.m
    table = np.atleast_2d(np.stack(np.broadcast_arrays(*parameters), -1).astype(float))[None]
    lanes = np.zeros(1, family.lane_type(n, m))
    family.begin(lanes, batch.models, table)
    found = outputs(batch, n, m, True)
    family.run(
        lanes, batch.models, batch.y, batch.lost, batch.time, np.ones((1, 1, 2)), table, interval,
        option, *found.values(),
    )  # fmt: skip
    return {name: array[0] for name, array in found.items()} | {"lane": lanes[0]}


def run_bank(recording, chosen, axes, parameters=(1.0, 1.0, 0.995, 0.985, 0.2)):
    """Run any set of modes on the path of so many axes."""
    batch = StateSpaceBatch.of([recording])
    n, m = recording.model.n, recording.model.m
    structure = Structure.of(batch)
    modes, design = pack(chosen, structure, n)
    noises = structure.noise(batch.models)
    lanes = np.zeros(1, bank.lane_type(n, m))
    bank.begin(lanes, batch.models, noises, design, np.array([axes]))
    found = outputs(batch, n, m, True)
    found["weights"] = np.empty((1, len(recording), modes.count))
    bank.run(
        lanes, np.zeros(1, bank.work_type(n, m)), design, batch.models, noises, batch.y, batch.lost,
        batch.time, np.array(parameters, dtype=float)[None, None], 5, *found.values(),
    )  # fmt: skip
    return {name: array[0] for name, array in found.items()} | {"lane": lanes[0]}


def same(found, wanted, tolerance=1e-9, names=None):
    """Assert that arrays agree relative to the largest entry of each sample's array."""
    for name in names or [name for name in wanted if name in NAMES]:
        a, b = np.asarray(found[name]), np.asarray(wanted[name])
        assert a.shape == b.shape, name
        np.testing.assert_array_equal(np.isnan(a), np.isnan(b), err_msg=name)
        rows = np.abs(np.nan_to_num(b)).reshape(len(b), -1).max(1, initial=0.0)
        error = np.abs(np.nan_to_num(a - b)).reshape(len(b), -1).max(1, initial=0.0)
        worst = (error / np.maximum(rows, 1e-3 * rows.max(initial=1e-300))).max(initial=0.0)
        assert worst <= tolerance, f"{name}: relative difference {worst:.1e}"


def identical(a, b):
    """Assert that two dicts of arrays (or estimates) agree to the last bit, NaN included."""
    for name in NAMES:
        pick = [e[name] if isinstance(e, dict) else getattr(e, name) for e in (a, b)]
        np.testing.assert_array_equal(*pick, err_msg=name)


def assert_definite(covariances):
    """Assert that matrices (..., n, n) are symmetric to the last bit and positive definite.

    Definiteness is that of the correlation matrix: eigenvalues of a badly scaled one drown.
    """
    np.testing.assert_array_equal(covariances, np.swapaxes(covariances, -1, -2))
    deviations = np.sqrt(np.diagonal(covariances, axis1=-2, axis2=-1))
    correlation = covariances / (deviations[..., :, None] * deviations[..., None, :])
    assert np.linalg.eigvalsh(correlation).min() > 0.0
