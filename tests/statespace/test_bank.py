"""Banks of Kalman filters against the textbook's IMM, and where they must equal one filter."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import navgym
from navgym.simulation import simulate_many
from navgym.statespace.batch import Batch
from navgym.statespace.filters import kalman
from navgym.statespace.filters.bank import BANK, IMM, IMM_WIDE, MODE_SETS, ModeSet, separable
from tests.helpers import (
    problems,
    random_model,
    random_problem,
    run,
    run_bank,
    run_family,
    same,
    spd,
)
from tests.twins import bank as twin

FULL, SHARED = 1, 2
SCALES = (0.3, 3.0, 40.0)
GRID = ModeSet(SCALES, ((1.0, 1.0, 50.0),) * 3, (False, True, False), (4.0, 2.0, 1.0), 0.2)
BURSTS = dataclasses.replace(GRID, losses=(None, None, (0.1, 0.8)))
ALONE = ModeSet((1.0,), ((1.0,),))
ALIKE = ModeSet((1.0,) * 6, ((1.0,),) * 6)


@st.composite
def leaks(draw):
    """Parameters (q, r, scale stay, regime stay, outlier rate)."""
    return (
        draw(st.floats(0.2, 5.0)),
        draw(st.floats(0.2, 5.0)),
        draw(st.floats(0.8, 0.999)),
        draw(st.floats(0.8, 0.999)),
        draw(st.sampled_from([0.0, 0.05, 0.3])),
    )


@st.composite
def twins(draw, steps=12):
    """A problem whose two axes have one model and lose the same components: (n, m) = (4, 4)."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    small = random_model(rng, 2, 2, [10.0 ** draw(st.integers(-2, 2)) for _ in range(3)])
    lost = np.tile(rng.random((steps, 2)) < draw(st.sampled_from([0.0, 0.3, 0.7])), (1, 2))
    whole = {name: np.kron(np.eye(2), getattr(small, name)) for name in ("F", "H", "Q", "R", "P0")}
    model = navgym.LinearModel(**whole, x0=rng.standard_normal(4))
    return random_problem(rng, model, lost)


def agree(found, wanted):
    same(found, wanted, 1e-9)
    np.testing.assert_allclose(found["weights"], wanted["weights"], rtol=1e-8, atol=1e-14)


@pytest.mark.parametrize("modes", [GRID, BURSTS])
@given(problem=problems(sizes=((2, 1), (8, 3))), chosen=leaks())
def test_whole_state_agrees_with_the_textbook(modes, problem, chosen):
    found = run_bank(problem.recording, modes, FULL, chosen)
    agree(found, twin.bank(*problem.parts, modes, *chosen))


@pytest.mark.parametrize("modes", [GRID, BURSTS])
@given(problem=twins(), chosen=leaks())
def test_shared_covariance_agrees_with_its_twin(modes, problem, chosen):
    found = run_bank(problem.recording, modes, SHARED, chosen)
    agree(found, twin.bank(*problem.parts, modes, *chosen, axes=2))


@given(problem=twins(), chosen=leaks())
def test_losses_tell_nothing_where_all_regimes_lose_alike(problem, chosen):
    """Nor does it matter that rows are steps then, as long as something is received in each."""
    alike = [dataclasses.replace(GRID, losses=(law,) * 3) for law in (None, (0.2, 0.6))]
    same(*(run_bank(problem.recording, modes, SHARED, chosen) for modes in alike))
    lost = problem.lost.copy()
    lost[lost.all(1), ::2] = False
    heard = problem.alter(lost=lost).recording
    same(*(run_bank(heard, modes, SHARED, chosen) for modes in (GRID, alike[1])))


def test_a_burst_of_losses_is_told_from_independent_ones():
    """The same number of losses, in two bursts or spread evenly."""
    bursts = np.zeros(200, bool)
    bursts[[*range(60, 80), *range(140, 160)]] = True
    spread = np.zeros(200, bool)
    spread[::5] = True
    weight = {}
    for name, lost in (("bursts", bursts), ("spread", spread)):
        y = navgym.simulate("auv/nominal", 3, steps=200, loss=0.0).measurements
        recording = navgym.Recording(np.arange(200.0), y, lost, model=navgym.LinearModel())
        found = navgym.estimate("bank_bursts", recording)
        weight[name] = found.extras["weights"].sum(1)[:, 3]
    assert weight["bursts"][150] > 0.9
    assert weight["spread"].max() < 0.3


def test_losses_as_evidence_help_where_a_regime_loses_in_bursts_and_cost_nothing_elsewhere():
    def mean_error(name, scenario):
        batch = Batch.of(simulate_many(scenario, range(9000, 9150)))
        errors = ((run(name, batch).states - batch.truth)[..., [0, 2]] ** 2).sum(-1)
        return np.sqrt(errors.mean(1)).mean()

    for scenario, most in (("auv/switch-B", 0.995), ("auv/switch-D", 1.002)):
        assert mean_error("bank_bursts", scenario) < most * mean_error("bank", scenario)


@pytest.mark.parametrize("name", MODE_SETS)
@pytest.mark.parametrize(
    ("scenario", "axes"), [("auv/component-loss", FULL), ("auv/switch-B", SHARED)]
)
def test_names_mean_their_modes_and_take_the_path_that_applies(name, scenario, axes):
    recording = navgym.simulate(scenario, 4, steps=40)
    chosen = (2.0, 3.0, 0.98, 0.95, 0.1) if name.startswith("bank") else (2.0, 3.0, 0.98, 1.0, 0.0)
    wanted = twin.bank(
        recording.model, recording.time, recording.measurements, recording.lost, MODE_SETS[name],
        *chosen, axes=axes,
    )  # fmt: skip
    space = navgym.parameter_space(name)
    found = navgym.estimate(name, recording, dict(zip(space.names, chosen, strict=False)))
    same(vars(found), wanted)
    np.testing.assert_allclose(found.extras["weights"], wanted["weights"], rtol=1e-8, atol=1e-14)


@pytest.mark.parametrize("axes", [FULL, SHARED])
@given(problem=twins())
def test_one_mode_is_the_kalman_filter(axes, problem):
    found = run_bank(problem.recording, ALONE, axes)
    wanted = run_family(kalman, problem.recording, (1.0, 1.0, 1.0))
    same(found, {name: wanted[name] for name in wanted if name != "lane"}, 1e-10)
    np.testing.assert_array_equal(found["weights"], 1.0)


@given(problem=twins())
def test_one_mode_keeps_its_weight_whatever_leaks_to_neighbours(problem):
    near = ModeSet((1.0,), ((1.0,),), near=0.5)
    found = run_bank(problem.recording, near, SHARED, (1.0, 1.0, 0.8, 1.0, 0.0))
    np.testing.assert_allclose(found["weights"], 1.0, rtol=1e-12)


@given(problem=twins(), stay=st.floats(0.8, 0.999))
def test_equal_modes_are_the_kalman_filter_and_keep_equal_weights(problem, stay):
    found = run_bank(problem.recording, ALIKE, SHARED, (1.0, 1.0, stay, 1.0, 0.0))
    wanted = run_family(kalman, problem.recording, (1.0, 1.0, 1.0))
    same(found, wanted, 1e-10)
    np.testing.assert_allclose(found["weights"], 1 / 6, rtol=1e-9)


def test_shared_covariance_costs_less_than_two_in_a_thousand():
    """Within .2 % of the 4 x 4 covariance, in RMSE: docs/science/qivbf.md#bank-and-combiner."""
    recordings = simulate_many("auv/switch-B", range(10))
    batch = Batch.of(recordings)
    shared = run("bank", batch).states
    whole = np.stack([run_bank(r, BANK, FULL)["states"] for r in recordings])
    rmse = [np.sqrt(((s - batch.truth)[..., [0, 2]] ** 2).sum(-1).mean()) for s in (shared, whole)]
    assert rmse[0] == pytest.approx(rmse[1], rel=0.002)


@given(problem=problems(sizes=((2, 1), (8, 3))), chosen=leaks())
def test_weights_are_probabilities(problem, chosen):
    weights = run_bank(problem.recording, GRID, FULL, chosen)["weights"]
    assert weights.min() >= 0.0
    np.testing.assert_allclose(weights.sum((1, 2)), 1.0, rtol=1e-12)


@given(problem=problems(sizes=((2, 1), (8, 3)), varying=False), chosen=leaks())
def test_mixing_and_losing_keep_the_moments_of_the_mixture(problem, chosen):
    """Since the last measurement x = F x and P = F P Fᵀ + E[q] Q, whatever the modes exchange."""
    lost = problem.lost.copy()
    lost[5], lost[6:] = False, True
    found = run_bank(problem.alter(lost=lost).recording, GRID, FULL, chosen)
    model, process = problem.model, np.array(GRID.process) * chosen[0]
    x, P, Q = found["states"][5], found["covariances"][5], np.zeros_like(model.Q)
    for k in range(6, len(lost)):
        x, P, Q = (model.F @ x, *(model.F @ A @ model.F.T for A in (P, Q)))
        Q = Q + model.Q
        wanted = P + (found["weights"][k] * process).sum() * Q
        size = np.abs(wanted).max()
        np.testing.assert_allclose(found["states"][k], x, atol=1e-10 * np.abs(x).max())
        np.testing.assert_allclose(found["covariances"][k], wanted, atol=1e-9 * size)


def test_weights_drift_to_the_prior_while_nothing_is_received():
    model = navgym.LinearModel()
    y = np.random.default_rng(0).standard_normal((4000, 4))
    recording = navgym.Recording(np.arange(4000.0), y, np.arange(4000) > 20, model=model)
    weights = run_bank(recording, GRID, SHARED, (1.0, 1.0, 0.9, 0.9, 0.2))["weights"][-1]
    np.testing.assert_allclose(weights.sum(0), np.array([4, 2, 1]) / 7, rtol=1e-3)


@pytest.mark.parametrize("modes", [BANK, IMM, IMM_WIDE])
def test_transitions_are_stochastic(modes):
    T = twin.transition(modes, 0.97, 0.9)
    np.testing.assert_allclose(T.sum(1), 1.0)


def test_the_banks_are_those_of_the_science_page():
    r, q, outliers, prior = BANK.table().T
    assert sorted(set(r)) == [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0]
    kinds = list(zip(q, outliers, strict=True))
    assert kinds == [(1.0, 0.0), (1.0, 1.0), (100.0, 0.0)] * 8
    np.testing.assert_allclose(prior.reshape(8, 3).sum(0), np.array([4, 2, 1]) / 7)
    assert len(IMM.table()) == 6
    assert len(IMM_WIDE.table()) == 13


def test_an_outlier_hardly_moves_the_bank():
    recording = navgym.simulate("auv/nominal", 3, steps=200, loss=0.0)
    y = recording.measurements.copy()
    y[150] += 12.0
    hit = navgym.Recording(recording.time, y, model=recording.model)
    shift = {
        name: np.abs(
            navgym.estimate(name, hit).states[150] - navgym.estimate(name, recording).states[150]
        )[[0, 2]].max()
        for name in ("kf", "bank")
    }
    assert shift["kf"] > 2.0
    assert shift["bank"] < 0.25


def test_log_likelihood_prefers_the_true_noise_scale():
    """The mixture's log-likelihood is a density of the data: best, on average, at the truth."""
    batch = Batch.of(simulate_many("auv/nominal", range(20), measurement_scale=4.0, loss=0.0))

    def total(scale):
        found = run("imm", batch, {"measurement_noise_scale": scale}, everything=True)
        return found.log_likelihood.sum()

    single = run("kf", batch, {"measurement_noise_scale": 4.0}, everything=True)
    assert max(total(s) for s in (0.02, 4.0, 900.0)) == total(4.0)
    assert total(4.0) < single.log_likelihood.sum()


def axes_model(**changed):
    rng = np.random.default_rng(1)
    parts = {
        "F": rng.standard_normal((2, 2)),
        "Q": spd(rng, 2),
        "R": spd(rng, 2),
        "P0": spd(rng, 2),
    }
    return {name: np.kron(np.eye(2), M) for name, M in parts.items()} | changed


def test_only_two_equal_uncoupled_axes_share_a_covariance():
    assert separable(navgym.LinearModel(**axes_model()).pack())
    assert separable(navgym.simulate("auv/position-only", 0).model.pack())
    Q = axes_model()["Q"]
    for change in (
        {"Q": Q + 1e-3},
        {"Q": Q + np.diag([0, 0, 0, 1e-3])},
        {"R": axes_model()["R"] + np.diag([1e-3, 0, 0, 0])},
        {"P0": np.eye(4) + 1e-3},
        {"F": axes_model()["F"] + np.eye(4, k=2)},
        {"H": np.eye(4)[[0, 2, 1, 3]]},
    ):
        assert not separable(navgym.LinearModel(**axes_model(**change)).pack()), change
    assert not separable(navgym.LinearModel(F=np.eye(3)).pack())


def test_an_estimate_does_not_depend_on_what_is_lost_later():
    whole = navgym.simulate("auv/switch-D", seed=3, steps=120)
    lost = whole.lost.copy()
    lost[80, 0] = True  # from here on the axes differ
    other = navgym.Recording(whole.time, whole.measurements, lost, model=whole.model)
    for name in ("bank", "imm", "imm_wide"):
        states = [navgym.estimate(name, r).states for r in (whole, other)]
        np.testing.assert_array_equal(states[0][:80], states[1][:80])
        assert not np.array_equal(states[0][80:], states[1][80:])
