"""What holds for every linear filter: invariances, definiteness, and lanes that mind their own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import navgym
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters.catalogue import CATALOGUE
from tests.helpers import (
    assert_definite,
    identical,
    lane,
    problems,
    random_model,
    random_problem,
    run,
    same,
)

LINEAR = [f.name for f in CATALOGUE.values() if not f.nonlinear]
SOUND = [name for name in LINEAR if name not in ("qivbf_printed", "oracle")]
FEW = ((2, 1), (4, 4))
every = pytest.mark.parametrize("name", LINEAR)
every_sound = pytest.mark.parametrize("name", SOUND)
few_examples = settings(max_examples=8)  # of each filter

FILL = {"qivbf": {"fill": "extrapolate"}}


def estimate(name, problem):
    return navgym.estimate(name, problem.recording, FILL.get(name))


@every_sound
@few_examples
@given(problem=problems(FEW))
def test_covariances_stay_definite_and_states_finite(name, problem):
    found = estimate(name, problem)
    assert np.isfinite(found.states).all()
    assert_definite(found.covariances)


@every_sound
@few_examples
@given(problem=problems(FEW), data=st.data())
def test_the_order_of_measurements_changes_nothing(name, problem, data):
    order = np.array(data.draw(st.permutations(range(problem.model.m))))
    shuffled = problem.alter(
        lost=problem.lost[:, order],
        y=problem.y[:, order],
        H=problem.model.H[..., order, :],
        R=problem.model.R[..., order, :][..., order],
    )
    wanted, found = vars(estimate(name, problem)), vars(estimate(name, shuffled))
    same(found, wanted, 1e-8, ("states", "covariances", "nis", "log_likelihood"))
    np.testing.assert_allclose(
        found["innovations"], wanted["innovations"][:, order],
        atol=1e-8 * np.nanmax(np.abs(wanted["innovations"]), initial=1.0),
    )  # fmt: skip


@every_sound
@few_examples
@given(problem=problems(FEW), data=st.data())
def test_units_are_a_matter_of_taste(name, problem, data):
    """Other units for each state and measurement, by powers of two: not one bit changes."""
    model = problem.model
    powers = st.integers(-6, 6)
    d = 2.0 ** np.array(data.draw(st.lists(powers, min_size=model.n, max_size=model.n)))
    e = 2.0 ** np.array(data.draw(st.lists(powers, min_size=model.m, max_size=model.m)))
    other = problem.alter(
        y=problem.y * e,
        F=d[:, None] * model.F / d,
        H=e[:, None] * model.H / d,
        Q=d[:, None] * model.Q * d,
        R=e[:, None] * model.R * e,
        x0=d * model.x0,
        P0=d[:, None] * model.P0 * d,
    )
    wanted, found = estimate(name, problem), estimate(name, other)
    np.testing.assert_array_equal(found.states, wanted.states * d)
    np.testing.assert_array_equal(found.covariances, wanted.covariances * d[:, None] * d)
    np.testing.assert_array_equal(found.innovations, wanted.innovations * e)
    np.testing.assert_array_equal(found.nis, wanted.nis)


@every_sound
@few_examples
@given(problem=problems(FEW), shift=st.integers(-(2**20), 2**20))
def test_only_time_differences_count(name, problem, shift):
    moved = problem.alter(time=problem.time + shift / 64.0)
    identical(estimate(name, moved), estimate(name, problem))


@every_sound
@few_examples
@given(problem=problems(FEW))
def test_a_model_that_repeats_itself_over_time_is_a_constant_one(name, problem):
    packed = problem.model
    if packed.steps is not None:
        return
    T = len(problem.time)
    stacked = problem.alter(**{k: np.tile(getattr(packed, k), (T, 1, 1)) for k in "FHQR"})
    identical(estimate(name, stacked), estimate(name, problem))


def tracks(count):
    """Recordings of different lengths, conditions and losses."""
    scenarios = ("switch-B", "nominal", "burst", "component-loss")
    return [
        navgym.simulate(f"auv/{scenarios[i % 4]}", i, steps=40 + 17 * (i * 5 % 7))
        for i in range(count)
    ]


@every
@pytest.mark.parametrize("size", [1, 3, 7])
def test_company_and_padding_change_nothing(name, size):
    recordings = tracks(7)
    found = run(name, StateSpaceBatch.of(recordings[:size]), everything=True)
    for i, recording in enumerate(recordings[:size]):
        alone = navgym.estimate(name, recording)
        identical(lane(found, i, len(recording)), alone)


def poisoned(recording, k, value=1e300):
    """The recording with an absurd measurement, or a row of them where `k` is a slice."""
    y = recording.measurements.copy()
    y[k] = value
    return navgym.Recording(
        recording.time, y, model=recording.model, process_scale=recording.process_scale,
        measurement_scale=recording.measurement_scale,
    )  # fmt: skip


@every
def test_a_broken_lane_disturbs_no_other_and_shows_no_number(name):
    recordings = [navgym.simulate("auv/switch-B", seed, steps=60) for seed in range(3)]
    healthy = run(name, StateSpaceBatch.of(recordings), everything=True)
    recordings[1] = poisoned(recordings[1], 10)
    found = run(name, StateSpaceBatch.of(recordings), everything=True)
    for i in (0, 2):
        identical(lane(found, i), lane(healthy, i))
        assert found.diverged[i] == healthy.diverged[i]
    assert found.diverged[1]
    np.testing.assert_array_equal(found.states[1, :10], healthy.states[1, :10])
    assert np.isnan(found.states[1, 10:]).all()
    assert np.isnan(found.covariances[1, 10:]).all()


@pytest.mark.parametrize("name", [name for name in SOUND if name not in ("kf_zero", "kf_hold")])
def test_a_wide_prior_is_no_divergence(name):
    """The first innovations are 1e8 sigma of R, and as P0 explains them."""
    model = navgym.LinearModel(P0=1e8 * np.eye(4), R=1e-8 * np.eye(4), Q=1e-8 * np.eye(4))
    rng = np.random.default_rng(3)
    problem = random_problem(rng, model, rng.random((200, 4)) < 0.3)
    found = estimate(name, problem.alter(time=np.arange(200.0)))
    assert not found.diverged
    assert_definite(found.covariances)


@every
def test_all_lost_recordings_are_predicted(name):
    recording = navgym.simulate("auv/nominal", 0, steps=20, loss=1.0)
    found = navgym.estimate(name, recording)
    assert recording.lost.all()
    assert np.isnan(found.nis).all()
    assert np.isnan(found.innovations).all()
    assert np.isnan(found.log_likelihood).all()
    assert not found.diverged
    if name != "kf_zero":
        x = recording.model.x0 + np.outer(np.arange(1.0, 21.0), [1.0, 0.0, 1.0, 0.0])
        np.testing.assert_allclose(found.states, x, atol=1e-12)


@every
@pytest.mark.parametrize("loss", [0.0, 1.0])
def test_one_sample_recordings_work(name, loss):
    found = navgym.estimate(name, navgym.simulate("auv/nominal", 0, steps=1, loss=loss))
    assert found.states.shape == (1, 4)
    assert np.isfinite(found.states).all()


@every
def test_lost_values_are_never_read(name):
    """Whatever stands where `lost` is True, the answer is the same."""
    recording = navgym.simulate("auv/component-loss", 1, steps=50)
    y = np.where(recording.lost, 1e9, recording.measurements)
    other = navgym.Recording(
        recording.time, y, recording.lost, process_scale=recording.process_scale,
        measurement_scale=recording.measurement_scale, model=recording.model,
    )  # fmt: skip
    identical(navgym.estimate(name, other), navgym.estimate(name, recording))


@every
def test_without_everything_only_the_states_are_computed_and_are_the_same(name):
    batch = StateSpaceBatch.of([navgym.simulate("auv/nominal", 0, steps=50)])
    short, full = run(name, batch), run(name, batch, everything=True)
    np.testing.assert_array_equal(short.states, full.states)
    assert short.covariances.shape[1] == short.nis.shape[1] == 0


@pytest.mark.parametrize("name", ["kf", "kf_extrapolate", "vbakf", "qivbf", "imm", "bank"])
def test_a_coarse_and_a_fine_model_meet(name):
    """Two states per sample or one block of eight: independent halves are filtered independently."""
    rng = np.random.default_rng(5)
    half = random_problem(rng, random_model(rng, 2, 1), rng.random((30, 1)) < 0.3)
    twice = navgym.Recording(
        half.time, np.tile(half.y, 2), np.tile(half.lost, 2),
        model=navgym.LinearModel(
            **{k: np.kron(np.eye(2), getattr(half.model, k)) for k in ("F", "H", "Q", "R", "P0")},
            x0=np.tile(half.model.x0, 2),
        ),
    )  # fmt: skip
    found = navgym.estimate(name, twice).states
    np.testing.assert_allclose(found[:, :2], found[:, 2:], rtol=1e-9, atol=1e-12)
    if name.startswith("kf"):
        np.testing.assert_allclose(found[:, :2], estimate(name, half).states, rtol=1e-9)


@pytest.mark.parametrize("name", ["kf", "kf_extrapolate", "qivbf", "bank"])
def test_a_long_outage_is_no_divergence(name):
    recording = navgym.simulate("auv/nominal", seed=1, steps=900, loss=0.0)
    lost = recording.lost.copy()
    lost[200:800] = True
    gap = navgym.Recording(recording.time, recording.measurements, lost, model=recording.model)
    assert not navgym.estimate(name, gap).diverged


@pytest.mark.parametrize("name", ["kf", "qivbf", "bank"])
def test_padding_says_nothing(name):
    long = navgym.simulate("auv/nominal", seed=1, steps=90)
    short = navgym.simulate("auv/nominal", seed=2, steps=30)
    found = run(name, StateSpaceBatch.of([long, short]))
    np.testing.assert_array_equal(found.states[1, :30], navgym.estimate(name, short).states)
    assert np.isnan(found.states[1, 30:]).all()
