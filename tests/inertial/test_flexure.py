"""The flexure model against matrix exponentials, the differential equation and published figures."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.linalg import expm, solve_continuous_lyapunov

from navgym.inertial.flexure import ARCMIN, CRITICAL, FlexureModel

PAPER = FlexureModel.from_correlation_time([10.0, 10.0, 30.0], np.array([6.0, 6.0, 10.0]) * ARCMIN)
KINDS = ("under", "critical", "over")


def drift(model, axis):
    """A of d(θ, θ̇)/dt = A (θ, θ̇) + (0, w)."""
    return np.array([[0.0, 1.0], [-model.stiffness[axis], -model.damping[axis]]])


@st.composite
def models(draw):
    """Each axis under-, critically or overdamped, with correlation times of 1 to 100 s."""
    damping, stiffness, sigma = [], [], []
    for _ in range(3):
        b = draw(st.floats(0.02, 2.0))
        kind = draw(st.sampled_from(KINDS))
        ratio = {"under": st.floats(0.02, 0.98), "over": st.floats(1.02, 8.0)}
        zeta = 1.0 if kind == "critical" else draw(ratio[kind])
        damping.append(2.0 * zeta * b)
        stiffness.append(b * b)
        sigma.append(draw(st.floats(1e-5, 1e-1)))
    return FlexureModel(damping, stiffness, sigma)


@given(models(), st.floats(1e-3, 20.0))
def test_the_transition_is_the_matrix_exponential(model, dt):
    wanted = np.stack([expm(drift(model, a) * dt) for a in range(3)])
    assert np.allclose(model.transition(dt), wanted, rtol=1e-7, atol=1e-10)


@given(models())
def test_the_long_run_covariance_solves_lyapunovs_equation(model):
    for a in range(3):
        q = np.diag([0.0, model.noise_density[a]])
        wanted = solve_continuous_lyapunov(drift(model, a), -q)
        assert np.allclose(model.stationary()[a], wanted, rtol=1e-9, atol=1e-12 * wanted.max())


def step(model, share):
    """A step that resolves the process: up to twice the shortest time constant."""
    return share * 2.0 / max(model.damping.max(), np.sqrt(model.stiffness.max()))


@given(models(), st.floats(1e-3, 1.0))
def test_the_process_noise_keeps_the_long_run_covariance(model, share):
    """P∞ = Φ P∞ Φᵀ + Q."""
    dt = step(model, share)
    F, P = model.transition(dt), model.stationary()
    kept = F @ P @ np.swapaxes(F, 1, 2) + model.process_noise(dt)
    scale = np.sqrt(np.einsum("aii,ajj->aij", P, P))
    assert (np.abs(kept - P) / scale).max() < 1e-9


@given(models(), st.floats(1e-3, 1.0))
def test_the_process_noise_is_van_loans(model, share):
    dt = step(model, share)
    Q = model.process_noise(dt)
    for a in range(3):
        A = drift(model, a)
        block = np.zeros((4, 4))
        block[:2, :2], block[2:, 2:] = -A, A.T
        block[1, 3] = model.noise_density[a]
        whole = expm(block * dt)
        wanted = whole[2:, 2:].T @ whole[:2, 2:]
        scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
        assert (np.abs(Q[a] - wanted) / scale).max() < 1e-5  # of expm's own cancellation


@pytest.mark.parametrize("dt", [1e-4, 1e-3])
def test_short_steps_have_the_noise_of_an_integrated_white_acceleration(dt):
    wanted = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    assert np.allclose(PAPER.process_noise(dt) / PAPER.noise_density[:, None, None] / wanted, 1.0, rtol=2e-3)  # fmt: skip


@given(models())
def test_the_autocorrelation_at_lag_zero_is_the_variance(model):
    """IDAM eq. 17 as printed gives λσ²/√(μ² + λ²)."""
    assert np.allclose(model.autocorrelation(0.0), model.sigma**2, rtol=1e-14)


@given(models(), st.floats(0.01, 10.0))
def test_the_autocorrelation_solves_the_differential_equation(model, lag):
    h = 1e-3
    before, here, after = (model.autocorrelation(lag + d) for d in (-h, 0.0, h))
    rate, bend = (after - before) / (2 * h), (after - 2 * here + before) / h**2
    residual = bend + model.damping * rate + model.stiffness * here
    size = (model.stiffness + model.damping**2) * model.sigma**2
    assert np.abs(residual / size).max() < 1e-2


@given(models(), st.floats(0.0, 50.0))
def test_the_autocorrelation_is_that_of_the_transition(model, lag):
    wanted = model.transition(lag)[:, 0, 0] * model.sigma**2
    assert np.allclose(model.autocorrelation(lag), wanted, rtol=1e-9, atol=1e-15)
    assert np.array_equal(model.autocorrelation(-lag), model.autocorrelation(lag))


@given(models(), st.floats(0.05, 2.0), st.floats(-8.0, 8.0))
def test_increments_correlate_as_the_differences_that_they_are(model, t0, lag):
    """E[(θ(t) − θ(t − t0)) (θ(t + lag) − θ(t + lag − t0))], from the covariance of four samples."""
    at = np.array([0.0, -t0, lag, lag - t0])
    joint = model.autocorrelation(at[:, None] - at)
    wanted = np.einsum("i,ija,j->a", [1, -1, 0, 0], joint, [0, 0, 1, -1])
    found = model.increment_autocorrelation(lag, t0)
    assert np.allclose(found, wanted, rtol=1e-9, atol=1e-12 * model.sigma.max() ** 2)


def test_an_overdamped_axis_creeps_for_long():
    model = FlexureModel(20.0, 0.01, 1.0)
    wanted = expm(drift(model, 0) * 200.0)
    assert np.allclose(model.transition(200.0)[0], wanted, atol=1e-9)


def test_a_long_step_forgets():
    assert np.allclose(FlexureModel(4.0, 1.0, 1.0).process_noise(400.0), np.eye(2), atol=1e-9)


def test_many_lags_give_many_rows():
    assert PAPER.autocorrelation(np.linspace(0, 9, 10)).shape == (10, 3)
    assert PAPER.increment_autocorrelation(np.linspace(0, 9, 10), 0.5).shape == (10, 3)
    assert PAPER.split_deviation([0.0, 300.0]).shape == (2, 3)


def test_a_critically_damped_axis_falls_to_one_in_e_at_its_correlation_time():
    tau = np.array([10.0, 10.0, 30.0])
    fallen = [PAPER.autocorrelation(t)[a] / PAPER.sigma[a] ** 2 for a, t in enumerate(tau)]
    assert fallen == pytest.approx([np.exp(-1.0)] * 3, rel=2e-4)
    assert (1.0 + CRITICAL) * np.exp(-CRITICAL) == pytest.approx(np.exp(-1.0), rel=2e-4)
    assert np.abs(PAPER.frequency_squared).max() < 1e-15


@pytest.mark.parametrize("ratio", [0.5, 1.5, 4.0])
def test_oscillation_is_frequency_over_damping_and_leaves_the_stiffness(ratio):
    model = FlexureModel.from_correlation_time([6.0, 6.0, 12.0], 1e-3, ratio)
    mu = model.damping / 2
    assert np.allclose(np.sqrt(model.frequency_squared) / mu, ratio)
    assert np.allclose(np.sqrt(model.stiffness), CRITICAL / np.array([6.0, 6.0, 12.0]))


def test_the_split_between_static_and_dynamic_is_bounded_as_published():
    """docs/science/idam.md#information-limit: 1.45, 1.45 and 3.96 arcmin after 300 s."""
    assert PAPER.split_deviation(300.0) / ARCMIN == pytest.approx([1.45, 1.45, 3.96], abs=0.005)
    assert np.array_equal(PAPER.split_deviation(0.0), PAPER.sigma)


@given(models())
def test_the_noise_density_makes_the_long_run_deviation(model):
    """σ² = q ∫ s(t)² dt over all times, with s the answer of θ to an impulse of w."""
    axis = int(np.argmax(model.damping))
    slow = np.abs(np.linalg.eigvals(drift(model, axis)).real).min()
    power, _ = quad(lambda t: model.transition(t)[axis, 0, 1] ** 2, 0.0, 20.0 / slow, limit=500)
    assert model.noise_density[axis] * power == pytest.approx(model.sigma[axis] ** 2, rel=1e-3)


def test_numbers_stand_for_three_axes():
    model = FlexureModel(0.5, 0.1, 1e-3)
    assert model.damping.tolist() == [0.5] * 3
    assert model.rate_sigma == pytest.approx([np.sqrt(0.1) * 1e-3] * 3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.5, 0.1, 0.0), "sigma must be positive on every axis"),
        ((0.5, -0.1, 1e-3), "stiffness must be positive on every axis"),
        (([0.5, 0.0, 1.0], 0.1, 1e-3), "damping must be positive on every axis"),
        (([0.5, 0.5], 0.1, 1e-3), r"damping must be a number or one per axis, got \(2,\)"),
        ((0.5, np.nan, 1e-3), "stiffness must be finite"),
        (("soft", 0.1, 1e-3), "damping must be an array of numbers"),
    ],
)
def test_wrong_parameters_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        FlexureModel(*arguments)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_copies_keep_the_numbers_and_stay_read_only(copied):
    model = copied(PAPER)
    assert np.array_equal(model.stiffness, PAPER.stiffness)
    for array in (model.damping, model.stiffness, model.sigma):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_the_paper_is_the_default_of_a_deck_model():
    from navgym.deck.model import DeckModel

    model = DeckModel()
    np.testing.assert_array_equal(model.flexure.stiffness, PAPER.stiffness)
    np.testing.assert_array_equal(model.flexure.damping, PAPER.damping)
    np.testing.assert_allclose(model.flexure.sigma, np.radians(np.array([6.0, 6.0, 10.0]) / 60.0))
    np.testing.assert_array_equal(model.lever_arm, [10.0, 10.0, 2.0])
    assert model.gyro_bias == pytest.approx(np.radians(0.05) / 3600.0)
    assert model.gyro_noise == pytest.approx(np.radians(0.001) / 60.0)
    assert model.accelerometer_bias == pytest.approx(200e-6 * 9.80665)
    assert model.accelerometer_noise == pytest.approx(10e-6 * 9.80665)
