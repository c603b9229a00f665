"""Banks of Kalman filters against the textbook's IMM, and where they must equal one filter."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import navgym
from navgym.simulation import simulate_many
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import kalman
from navgym.statespace.filters.bank import separable
from navgym.statespace.filters.modes import (
    BANK,
    BANK_2026,
    IMM,
    IMM_WIDE,
    MODE_SETS,
    Modes,
    ModeSet,
    Node,
    Regime,
)
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
EVEN = tuple(Node(s, s) for s in (0.3, 3.0, 6.0, 40.0))
GRID = ModeSet(
    EVEN,
    (
        Regime("calm", 4.0),
        Regime("manoeuvre", 1.0, process=50.0),
        Regime("outliers", 2.0, outliers=True),
    ),
    near=0.2,
)
PARTLY = ModeSet(
    (*EVEN, Node(1.0, 0.1, prior=0.3), Node(20.0, 1.0, prior=0.3)),
    (
        Regime("calm", 4.0),
        Regime("manoeuvre", 0.5, 2.0, process=50.0, nodes=((0.3, 0.3), (3.0, 3.0))),
        Regime("late", 0.5, 0.7, motion="late", nodes=((1.0, 0.1),)),
        Regime("outliers", 2.0, outliers=True, nodes=((0.3, 0.3), (40.0, 40.0), (20.0, 1.0))),
        Regime("velocity error", 0.3, 0.5, motion="bias", nodes=((3.0, 3.0), (1.0, 0.1))),
    ),
    near=0.2,
    outliers=((0.6, 100.0, 100.0), (0.4, 50.0, 1.0)),
)
ALONE = ModeSet((Node(1.0, 1.0),))
ALIKE = ModeSet((Node(1.0, 1.0),) * 6)


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


@st.composite
def moving(draw, alike, steps=8):
    """Velocities that move positions, both measured: two axes alike, or turned into each other."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    F, Q, R, P0, H = [], [], [], [], []
    for _ in range(1 if alike else 2):
        dt = rng.uniform(0.1, 3.0)
        F.append([[1.0, dt], [0.0, rng.uniform(0.8, 1.0)]])
        Q.append(spd(rng, 2, 10.0 ** rng.integers(-3, 1)))
        R.append(np.diag(10.0 ** rng.uniform(-2, 1, 2)))
        P0.append(spd(rng, 2))
        H.append(np.diag(10.0 ** rng.uniform(-0.5, 0.5, 2)))
    whole = {
        name: np.kron(np.eye(2), parts[0]) if alike else twin.block(*map(np.array, parts))
        for name, parts in (("F", F), ("Q", Q), ("R", R), ("P0", P0), ("H", H))
    }
    if not alike:
        c, s = np.cos(1.0), np.sin(1.0)
        whole["H"] = np.kron(np.array([[c, s], [-s, c]]), np.eye(2)) @ whole["H"]
    lost = rng.random((steps, 4)) < draw(st.sampled_from([0.0, 0.3, 0.7]))
    if alike:
        lost[:, 2:] = lost[:, :2]
    model = navgym.LinearModel(**whole, x0=rng.standard_normal(4), position=(0, 2), velocity=(1, 3))
    return random_problem(rng, model, lost)


def agree(found, wanted):
    same(found, wanted, 1e-9)
    np.testing.assert_allclose(found["weights"], wanted["weights"], rtol=1e-8, atol=1e-12)


def by_twin(problem, modes, chosen, axes):
    return twin.bank(*problem.parts, modes, twin.structure_of(problem.model), chosen, axes)


@given(problem=problems(sizes=((2, 1),)), chosen=leaks())
def test_whole_state_agrees_with_the_textbook(problem, chosen):
    agree(run_bank(problem.recording, GRID, FULL, chosen), by_twin(problem, GRID, chosen, FULL))


@given(problem=twins(), chosen=leaks())
def test_shared_covariance_agrees_with_its_twin(problem, chosen):
    agree(run_bank(problem.recording, GRID, SHARED, chosen), by_twin(problem, GRID, chosen, SHARED))


@given(problem=moving(alike=False), chosen=leaks())
def test_lags_errors_and_outliers_agree_with_the_textbook(problem, chosen):
    found = run_bank(problem.recording, PARTLY, FULL, chosen)
    agree(found, by_twin(problem, PARTLY, chosen, FULL))


@given(problem=moving(alike=True), chosen=leaks())
def test_lags_errors_and_outliers_of_a_shared_covariance_agree_with_their_twin(problem, chosen):
    found = run_bank(problem.recording, PARTLY, SHARED, chosen)
    agree(found, by_twin(problem, PARTLY, chosen, SHARED))


@given(problem=moving(alike=True), chosen=leaks(), data=st.data())
def test_axes_that_part_go_on_as_one_state(problem, chosen, data):
    lost = problem.lost.copy()
    k = data.draw(st.integers(0, len(lost) - 1))
    lost[k, 0] = not lost[k, 0]
    problem = problem.alter(lost=lost)
    found = run_bank(problem.recording, PARTLY, SHARED, chosen)
    agree(found, by_twin(problem, PARTLY, chosen, SHARED))


@pytest.mark.parametrize("name", MODE_SETS)
@pytest.mark.parametrize(
    ("scenario", "axes"), [("auv/component-loss", FULL), ("auv/switch-B", SHARED)]
)
def test_names_mean_their_modes_and_take_the_path_that_applies(name, scenario, axes):
    recording = navgym.simulate(scenario, 4, steps=12)
    lost = recording.lost.copy()
    lost[0] = (
        [True, False, False, False] if axes == FULL else False
    )  # apart from the start, or never
    recording = dataclasses.replace(recording, lost=lost)
    chosen = (2.0, 3.0, 0.98, 0.95, 0.1) if name.startswith("bank") else (2.0, 3.0, 0.98, 1.0, 0.0)
    wanted = twin.bank(
        recording.model, recording.time, recording.measurements, recording.lost, MODE_SETS[name],
        twin.structure_of(recording.model), chosen, axes=axes,
    )  # fmt: skip
    space = navgym.parameter_space(name)
    found = navgym.estimate(name, recording, dict(zip(space.names, chosen, strict=False)))
    same(vars(found), wanted)
    np.testing.assert_allclose(found.extras["weights"], wanted["weights"], rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("axes", [FULL, SHARED])
@given(problem=twins())
def test_one_mode_is_the_kalman_filter(axes, problem):
    found = run_bank(problem.recording, ALONE, axes)
    wanted = run_family(kalman, problem.recording, (1.0, 1.0, 1.0))
    same(found, {name: wanted[name] for name in wanted if name != "lane"}, 1e-10)
    np.testing.assert_allclose(found["weights"], 1.0, rtol=1e-12)


@given(problem=twins())
def test_one_mode_keeps_its_weight_whatever_leaks_to_neighbours(problem):
    near = ModeSet((Node(1.0, 1.0),), near=0.5)
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
    batch = StateSpaceBatch.of(recordings)
    shared = run("bank", batch).states
    whole = np.stack([run_bank(r, BANK, FULL)["states"] for r in recordings])
    rmse = [np.sqrt(((s - batch.truth)[..., [0, 2]] ** 2).sum(-1).mean()) for s in (shared, whole)]
    assert rmse[0] == pytest.approx(rmse[1], rel=0.002)


@given(problem=problems(sizes=((2, 1),)), chosen=leaks())
def test_weights_are_probabilities(problem, chosen):
    weights = run_bank(problem.recording, GRID, FULL, chosen)["weights"]
    assert weights.min() >= 0.0
    np.testing.assert_allclose(weights.sum(1), 1.0, rtol=1e-12)


@given(problem=problems(sizes=((2, 1),), varying=False), chosen=leaks())
def test_mixing_and_losing_keep_the_moments_of_the_mixture(problem, chosen):
    """Since the last measurement x = F x and P = F P Fᵀ + E[q] Q, whatever the modes exchange."""
    lost = problem.lost.copy()
    lost[5], lost[6:] = False, True
    found = run_bank(problem.alter(lost=lost).recording, GRID, FULL, chosen)
    model = problem.model
    process = Modes.of(GRID, twin.structure_of(model)).table()[:, 0] * chosen[0]
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
    regimes = weights.reshape(3, len(EVEN)).sum(1)  # calm, manoeuvre, outliers
    np.testing.assert_allclose(regimes, np.array([4, 1, 2]) / 7, rtol=1e-3)


@pytest.mark.parametrize("chosen", [*MODE_SETS.values(), PARTLY])
def test_transitions_are_stochastic(chosen):
    modes = Modes.of(chosen, twin.structure_of(navgym.LinearModel()))
    T, stay = twin.transition(chosen, modes, 0.97, 0.9)
    np.testing.assert_allclose(T.sum(1), 1.0)
    assert (stay <= np.diag(T) + 1e-12).all()


def modes_of(chosen, model=None):
    return Modes.of(chosen, twin.structure_of(model or navgym.LinearModel()))


def test_the_banks_are_those_of_the_science_page():
    old = modes_of(BANK_2026)
    assert sorted(set(old.scales[:, 0])) == [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0]
    assert [(r.process, r.outliers) for r in old.regimes] == [(1, False), (100, False), (1, True)]
    np.testing.assert_allclose(old.shares, np.array([4, 1, 2]) / 7)
    assert [modes_of(chosen).count for chosen in (IMM, IMM_WIDE, BANK_2026, BANK)] == [
        6, 13, 24, 68,
    ]  # fmt: skip


def test_what_a_model_cannot_show_has_no_mode():
    """Without velocities, or with rows that mix them with positions, nothing can be late or uneven."""
    whole = modes_of(BANK)
    assert {r.motion for r in whole.regimes} == {"model", "late", "bias"}
    mixing = navgym.LinearModel(dt=1.0, H=np.eye(4) + 0.1 * np.eye(4, k=1))
    for model in (
        navgym.simulate("auv/position-only", 0).model,
        mixing,
        navgym.LinearModel(F=np.eye(3)),
    ):
        modes = modes_of(BANK, model)
        assert {r.motion for r in modes.regimes} == {"model"}
        assert (modes.scales == modes.scales[:, :1]).all()
        assert modes.count == 10 + 10 + 3 + 10 + 6


def test_sensors_that_measure_the_same_have_scales_of_their_own():
    """Of two receivers a mode knows either to be worse, and the bank finds which."""
    H = np.eye(4)[[0, 2, 0, 2]]
    model = navgym.LinearModel(dt=1.0, H=H, sensors=("gps", "gps", "usbl", "usbl"))
    modes = modes_of(BANK, model)
    alone = modes.scales[(modes.scales != 1.0).sum(1) == 2]
    assert {tuple(row) for row in alone} == {
        (s, s, 1.0, 1.0) if first else (1.0, 1.0, s, s)
        for s in (0.1, 10.0, 30.0)
        for first in (0, 1)
    }
    rng = np.random.default_rng(5)
    truth = navgym.simulate("auv/nominal", 5, loss=0.0).truth[:300]
    noise = rng.standard_normal((300, 4)) * np.array([1.0, 1.0, 4.0, 4.0])
    recording = navgym.Recording(np.arange(1.0, 301.0), truth @ H.T + noise, model=model)
    found = navgym.estimate("bank", recording)
    gps, _, usbl, _ = np.exp(
        (found.extras["weights"][100:] @ np.log(modes.scales[modes.node])).mean(0)
    )
    assert gps < 2.0
    assert 8.0 < usbl < 32.0  # of 16


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
    batch = StateSpaceBatch.of(
        simulate_many("auv/nominal", range(20), measurement_scale=4.0, loss=0.0)
    )

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


@pytest.mark.parametrize("angle", [0.3, np.pi / 2, 2.5])
def test_turning_the_axes_turns_the_estimate(angle):
    """East and north are a matter of taste where both are measured alike."""
    recording = navgym.simulate("auv/switch-D", 8, steps=150, loss=0.3)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.kron(np.array([[c, -s], [s, c]]), np.eye(2))
    model = recording.model
    turned = navgym.Recording(
        recording.time, recording.measurements @ turn.T, recording.lost,
        model=dataclasses.replace(model, x0=turn @ model.x0),
    )  # fmt: skip
    one, other = navgym.estimate("bank", recording), navgym.estimate("bank", turned)
    size = np.abs(one.states).max()
    np.testing.assert_allclose(other.states, one.states @ turn.T, atol=1e-9 * size)
    np.testing.assert_allclose(other.covariances, turn @ one.covariances @ turn.T, atol=1e-9)
    np.testing.assert_allclose(other.extras["weights"], one.extras["weights"], atol=1e-9)
