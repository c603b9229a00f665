"""Kalman filters under loss, against the equations, closed forms and Bayes' rule written once."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

import navgym
from navgym.simulation import simulate_many
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import kalman as family
from tests.helpers import assert_definite, identical, problems, run, run_family, same
from tests.twins.kalman import conditioned, kalman

FILLS = {
    "skip": family.SKIP,
    "extrapolate": family.EXTRAPOLATE,
    "hold": family.HOLD,
    "zero": family.ZERO,
}
NAMES = {"kf": "skip", "kf_extrapolate": "extrapolate", "kf_hold": "hold", "kf_zero": "zero"}


@pytest.mark.parametrize("fill", FILLS)
@given(problem=problems(), q=st.floats(0.1, 10), r=st.floats(0.1, 10), c=st.floats(1, 100))
def test_each_fill_agrees_with_its_twin(fill, problem, q, r, c):
    found = run_family(family, problem.recording, (q, r, c), FILLS[fill])
    same(found, kalman(problem.model, problem.time, problem.y, problem.lost, q, r, fill, c))


@pytest.mark.parametrize("name", NAMES)
def test_names_mean_their_fills(name):
    recording = navgym.simulate("auv/component-loss", 3, steps=40)
    twin = kalman(
        recording.model, recording.time, recording.measurements, recording.lost, fill=NAMES[name]
    )
    found = navgym.estimate(name, recording)
    same(vars(found), twin)


@given(problem=problems(steps=6))
def test_predict_only_is_bayes_rule_on_what_was_received(problem):
    states, covariances = conditioned(problem.model, problem.y, problem.lost)
    found = run_family(family, problem.recording, (1.0, 1.0, 1.0))
    same(found, {"states": states, "covariances": covariances}, 1e-8)


@given(problem=problems())
def test_every_fill_is_the_same_filter_when_nothing_is_lost(problem):
    recording = problem.alter(lost=np.zeros_like(problem.lost)).recording
    runs = [run_family(family, recording, (1.0, 1.0, 1.0), fill) for fill in FILLS.values()]
    for other in runs[1:]:
        identical(runs[0], other)


def test_a_component_that_is_never_received_might_as_well_not_exist():
    whole = navgym.simulate("auv/nominal", 1)
    R = np.eye(4) + 0.3
    lost = whole.lost | np.array([False, True, False, True])
    model = navgym.LinearModel(R=R)
    found = navgym.estimate(
        "kf", navgym.Recording(whole.time, whole.measurements, lost, model=model)
    )
    half = navgym.LinearModel(R=R[::2, ::2], H=np.eye(4)[::2])
    part = navgym.Recording(whole.time, whole.measurements[:, ::2], whole.lost[:, ::2], model=half)
    same(vars(found), vars(navgym.estimate("kf", part)), 1e-12, ("states", "covariances", "nis"))


def jumps(gap, times, values):
    """A scalar recording with a flat prior at every step, `gap` samples lost at its end."""
    model = navgym.LinearModel(F=[[1.0]], Q=[[1e14]], R=[[2.0]], P0=[[1e14]])
    lost = np.arange(len(times)) >= len(times) - gap
    return navgym.Recording(times, np.array(values)[:, None], lost, model=model)


@pytest.mark.parametrize(
    ("gap", "growth"), [(1, 19), (2, 109), (3, 361), (5, 1891), (10, 21781), (20, 291061)]
)
def test_extrapolation_across_a_gap_magnifies_the_variance_as_derived(gap, growth):
    """Under a flat prior the posterior variance is Σ l² R, l = (g(g+1)/2, -g(g+2), (g+1)(g+2)/2)."""
    weights = np.array([gap * (gap + 1) / 2, -gap * (gap + 2), (gap + 1) * (gap + 2) / 2])
    assert weights @ weights == growth
    y = np.arange(3.0 + gap) ** 2
    found = navgym.estimate("kf_extrapolate", jumps(gap, np.arange(3.0 + gap), y))
    assert found.covariances[-1, 0, 0] == pytest.approx(2.0 * growth, rel=1e-7)
    assert found.states[-1, 0] == pytest.approx(weights @ y[:3], rel=1e-7)


def test_extrapolation_uses_true_times_of_the_last_three_received():
    """A parabola sampled at uneven times, with losses in between, is continued exactly."""
    times = np.array([0.0, 1.0, 1.5, 4.0, 4.5, 7.0, 9.0])
    recording = jumps(2, times, 3.0 - 2.0 * times + 0.5 * times**2)
    lost = recording.lost.copy()
    lost[[0, 2]] = True
    found = navgym.estimate(
        "kf_extrapolate",
        navgym.Recording(times, recording.measurements, lost, model=recording.model),
    )
    np.testing.assert_allclose(found.states[-2:, 0], 3.0 - 2.0 * times[-2:] + 0.5 * times[-2:] ** 2)


def test_extrapolation_waits_for_three_received_samples():
    recording = jumps(3, np.arange(5.0), np.arange(5.0))
    identical(navgym.estimate("kf_extrapolate", recording), navgym.estimate("kf", recording))


def test_inflation_multiplies_the_variance_of_the_fill():
    recording = jumps(1, np.arange(4.0), np.zeros(4))
    found = navgym.estimate("kf_extrapolate", recording, {"fill_inflation": 7.0})
    assert found.covariances[-1, 0, 0] == pytest.approx(7.0 * 19.0 * 2.0, rel=1e-7)


def test_steady_state_solves_the_riccati_equation():
    recording = navgym.simulate("auv/nominal", 0, steps=400, loss=0.0)
    model = recording.model
    prior = scipy.linalg.solve_discrete_are(model.F.T, model.H.T, model.Q, model.R)
    steady = np.linalg.inv(np.linalg.inv(prior) + np.linalg.inv(model.R))
    found = navgym.estimate("kf", recording).covariances[-1]
    np.testing.assert_allclose(found, steady, atol=1e-10)
    # docs/science/qivbf.md#expected-errors
    np.testing.assert_allclose(np.diag(found), [0.189449, 0.004703] * 2, atol=1e-6)


@pytest.mark.parametrize(
    ("arrival", "low", "high"), [(0.5, 4.571, 11.956), (0.7, 1.882, 5.401), (1.0, 3.18, 3.20)]
)
def test_mean_covariance_keeps_to_the_bounds_of_sinopoli(arrival, low, high):
    """Sinopoli et al. 2004, A = -1.25, C = 1, Q = 1, R = 2.5; E[P] of the prediction."""
    model = navgym.LinearModel(F=[[-1.25]], Q=[[1.0]], R=[[2.5]])
    lost = np.random.default_rng(0).random((200, 300)) >= arrival
    time, y = np.arange(300.0), np.zeros((300, 1))
    batch = StateSpaceBatch.of([navgym.Recording(time, y, row, model=model) for row in lost])
    posterior = run("kf", batch, everything=True).covariances[:, 50:, 0, 0]
    assert low <= (1.25**2 * posterior + 1.0).mean() <= high


@pytest.mark.parametrize("name", ["kf", "kf_extrapolate"])
def test_joseph_form_keeps_p_definite_where_the_plain_form_fails(name):
    H = np.array([[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 1e-3, 0.0]])
    model = navgym.LinearModel(H=H, R=1e-8 * np.eye(2), P0=1e8 * np.eye(4))
    rng = np.random.default_rng(0)
    lost = rng.random((60, 2)) < 0.2
    recording = navgym.Recording(np.arange(60.0), rng.standard_normal((60, 2)), lost, model=model)
    found = navgym.estimate(name, recording)
    assert_definite(found.covariances)
    P = model.F @ model.P0 @ model.F.T + model.Q
    S = H @ P @ H.T + model.R
    plain = P - P @ H.T @ np.linalg.solve(S, H @ P)
    assert np.diag(plain).min() < 0.0, "the example is not hard enough to tell the forms apart"


def test_nees_and_nis_of_the_matched_filter_are_chi_square():
    recordings = simulate_many("auv/nominal", range(300), steps=60)
    batch = StateSpaceBatch.of(recordings)
    found = run("kf", batch, everything=True)
    error = found.states - batch.truth
    nees = np.einsum("nki,nkij,nkj->nk", error, np.linalg.inv(found.covariances), error)
    # a chi-square mean over N runs is n ± sqrt(2 n / N); 4.5 sigma over 60 samples
    assert np.abs(nees.mean(0) - 4.0).max() < 4.5 * np.sqrt(2 * 4 / 300)
    received = found.nis[~np.isnan(found.nis)]
    assert received.mean() == pytest.approx(4.0, abs=4.5 * np.sqrt(2 * 4 / len(received)))


def test_oracle_is_the_filter_with_the_true_scales():
    recording = navgym.simulate("auv/switch-B", 5, steps=300)
    twin = kalman(
        recording.model, recording.time, recording.measurements, recording.lost,
        recording.process_scale, recording.measurement_scale,
    )  # fmt: skip
    same(vars(navgym.estimate("oracle", recording)), twin)


def position_rmse(name, recordings):
    batch = StateSpaceBatch.of(recordings)
    error = (run(name, batch).states - batch.truth)[..., [0, 2]]
    return np.sqrt((error**2).sum(-1).mean())


def test_filling_with_zeros_diverges_and_holding_costs_twice_as_much():
    recordings = simulate_many("auv/nominal", range(40))
    plain = position_rmse("kf", recordings)
    assert plain == pytest.approx(0.738, rel=0.05)  # docs/science/qivbf.md#expected-errors
    assert position_rmse("kf_hold", recordings) == pytest.approx(1.43, rel=0.15)
    assert position_rmse("kf_zero", recordings) > 100.0
    assert run("kf_zero", StateSpaceBatch.of(recordings)).diverged.mean() > 0.5
