"""The extended and sigma-point filters, the turn model, and the scenario that they meet in."""

import numba
import numpy as np
import pytest

import navgym
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import nonlinear
from navgym.statespace.filters.catalogue import CATALOGUE
from navgym.statespace.turn_model import DEGREE, RECORD
from tests.helpers import run
from tests.twins import nonlinear as twin

FILTERS = ("ekf", "ukf", "ckf", "cukf")
SIGMA = ("ukf", "ckf", "cukf")
SCENARIO = "auv/coordinated-turn"


def turn_recording(model, steps, seed=0, loss=0.0):
    """A voyage under `model`, drawn with the numpy twin's f and h."""
    rng = np.random.default_rng(seed)
    x = rng.multivariate_normal(model.x0, model.P0)
    truth, seen = [], []
    for k in range(steps):
        s = twin.system(model, k)
        x = s.f(x) + rng.multivariate_normal(np.zeros(5), s.Q)
        truth.append(x)
        seen.append(s.h(x) + rng.multivariate_normal(np.zeros(4), s.R))
    lost = rng.random((steps, 4)) < loss
    time = np.cumsum(np.broadcast_to(model.dt, steps))
    return navgym.Recording(time, seen, lost, truth, model=model)


def correlated(deviations, rho):
    """A covariance with these standard deviations and one correlation throughout."""
    d = np.asarray(deviations)
    return np.outer(d, d) * (rho + (1 - rho) * np.eye(len(d)))


@pytest.fixture(scope="module")
def hard():
    """Irregular steps, correlated noise, a wide prior, components lost one by one."""
    dt = np.random.default_rng(1).uniform(0.5, 1.5, 60)
    model = navgym.CoordinatedTurnModel(
        dt=dt,
        R=correlated([1, DEGREE, 0.1, 2 * DEGREE], 0.5),
        P0=correlated([5, 0.2, 5, 0.2, 2 * DEGREE], 0.2),
        x0=[40, 0.3, -10, 1.4, 4 * DEGREE],
        beacon=[3, -7],
    )
    return turn_recording(model, 60, seed=2, loss=0.4)


def close(estimate, steps, tolerance):
    """Whether an estimate agrees with the twin's in everything that it reports."""
    pairs = (
        (estimate.states, [s.x for s in steps]),
        (estimate.covariances, [s.P for s in steps]),
        (estimate.innovations, [s.innovation for s in steps]),
        (estimate.nis, [s.nis for s in steps]),
        (estimate.log_likelihood, [s.log_likelihood for s in steps]),
    )
    for mine, theirs in pairs:
        np.testing.assert_allclose(mine, np.array(theirs), rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("name", FILTERS)
def test_kernel_agrees_with_the_equations_with_lost_rows_deleted(hard, name):
    noise = {"process_noise_scale": 2.0, "measurement_noise_scale": 0.5}
    spread = {"sigma_spread": 0.6} if name in ("ukf", "cukf") else {}
    estimate = navgym.estimate(name, hard, noise | spread)
    assert {0, 1, 2, 3, 4} == set((~hard.lost).sum(1)), "every number of received rows occurs"
    close(estimate, twin.run(name, hard, q=2.0, r=0.5, a=0.6), 1e-9)


@numba.njit
def linearise(lane, model):
    """All four model functions at point 0."""
    nonlinear.move_slope(lane, model, 0)
    nonlinear.sense_slope(lane, model, 0)
    nonlinear.sense(lane, model, 0)
    nonlinear.move(lane, model, 0)


def derivative(function, x, step=1e-3):
    """Jacobian by differences of fourth order."""
    columns = []
    for e in step * np.eye(len(x)):
        near, far = function(x + e) - function(x - e), function(x + 2 * e) - function(x - 2 * e)
        columns.append((8 * near - far) / (12 * step))
    return np.array(columns).T


@pytest.mark.parametrize("omega", [0.0, 1e-9, -0.0076, 0.0078, -0.7, 3.0])
def test_jacobians_are_the_derivatives_of_f_and_h(omega):
    # at dt = 1.3 s the second and third turns lie on either side of `nonlinear.SERIES`
    model = navgym.CoordinatedTurnModel(dt=1.3, beacon=[5, -2])
    s = twin.system(model, 0)
    x = np.array([30.0, 1.2, -20.0, 0.9, omega])
    lanes = np.zeros(1, nonlinear.lane_type(5, 4))
    lanes["points"][0, 0] = x
    linearise(lanes[0], model.pack()[0])
    np.testing.assert_allclose(lanes["points"][0, 0], s.f(x), atol=1e-13)
    np.testing.assert_allclose(lanes["seen"][0, 0], s.h(x), atol=1e-13)
    np.testing.assert_allclose(lanes["local"]["F"][0], derivative(s.f, x), rtol=0, atol=1e-9)
    np.testing.assert_allclose(lanes["local"]["H"][0], derivative(s.h, x), rtol=0, atol=1e-9)


def linear_recording(steps=40):
    """Eight states, three mixtures of them measured, F and H changing from sample to sample."""
    rng = np.random.default_rng(3)
    model = navgym.LinearModel(
        F=np.eye(8) + 0.1 * rng.standard_normal((steps, 8, 8)),
        H=rng.standard_normal((steps, 3, 8)),
        Q=0.1 * correlated(np.linspace(1, 2, 8), 0.3),
        R=correlated([1, 0.5, 2], -0.4),
        x0=np.arange(8.0),
        P0=correlated(np.linspace(3, 1, 8), 0.5),
    )
    y, lost = rng.standard_normal((steps, 3)), rng.random((steps, 3)) < 0.3
    return navgym.Recording(np.arange(1.0, steps + 1), y, lost, model=model)


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize(
    "make", [linear_recording, lambda: navgym.simulate("auv/component-loss", 4, 80)]
)
def test_on_a_linear_model_every_filter_is_the_kalman_filter(name, make):
    recording = make()
    noise = {"process_noise_scale": 3.0, "measurement_noise_scale": 0.7}
    spread = {"sigma_spread": 0.3} if name in ("ukf", "cukf") else {}
    ours = navgym.estimate(name, recording, noise | spread)
    reference = navgym.estimate("kf", recording, noise)
    for field in ("states", "covariances", "innovations", "nis", "log_likelihood"):
        mine, theirs = getattr(ours, field), getattr(reference, field)
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-9)


def test_eq_10_as_printed_is_not_the_kalman_filter_of_a_linear_model():
    recording = linear_recording()
    reference = navgym.estimate("kf", recording).states
    right = np.array([s.x for s in twin.run("ukf", recording)])
    # as printed, h sees the points of eq. 8, which know nothing of Q
    printed = np.array([s.x for s in twin.run("ukf", recording, redraw=False)])
    assert np.abs(right - reference).max() < 1e-9 < 0.01 < np.abs(printed - reference).max()


def test_eq_16_and_26_as_printed_diverge():
    for seed in range(5):
        recording = turn_recording(navgym.CoordinatedTurnModel(), 20, seed)
        before = np.trace(recording.model.P0)
        # a = 1, since a smaller spread meets an indefinite covariance before the run has exploded
        right, printed = (twin.run("cukf", recording, a=1.0, sign=sign)[-1] for sign in (-1.0, 1.0))
        assert np.trace(right.P) < before < 1e6 * before < np.trace(printed.P)
        assert np.linalg.norm(right.x - recording.truth[-1]) < 3.0
        assert np.linalg.norm(printed.x - recording.truth[-1]) > 100.0


def test_cukf_takes_unscented_and_cubature_stages_in_turn_of_what_was_received(hard):
    a = {"sigma_spread": 0.4}
    ukf, cukf = navgym.estimate("ukf", hard, a), navgym.estimate("cukf", hard, a)
    _, second = np.flatnonzero(~hard.lost.all(1))[:2]
    assert (ukf.states[:second] == cukf.states[:second]).all()
    assert not np.allclose(ukf.states[second], cukf.states[second], atol=1e-9)
    ckf, same = navgym.estimate("ckf", hard), navgym.estimate("cukf", hard, {"sigma_spread": 1.0})
    assert (ckf.states == same.states).all()


def turned(recording, angle):
    """The same voyage in a world turned by `angle` about the origin."""
    c, s = np.cos(angle), np.sin(angle)
    T = np.eye(5)
    for i in (0, 1):
        T[i, i] = T[i + 2, i + 2] = c
        T[i, i + 2], T[i + 2, i] = -s, s
    model = recording.model
    new = navgym.CoordinatedTurnModel(
        dt=model.dt, Q=model.Q, R=model.R, x0=T @ model.x0, P0=T @ model.P0 @ T.T,
        beacon=T[np.ix_([0, 2], [0, 2])] @ model.beacon,
    )  # fmt: skip
    y = recording.measurements + angle * np.array([0, 1, 0, 1])
    y[:, [1, 3]] = (y[:, [1, 3]] + np.pi) % (2 * np.pi) - np.pi
    return navgym.Recording(recording.time, y, recording.lost, model=new), T


@pytest.mark.parametrize(
    ("name", "angle", "tolerance"),
    # A Cholesky factor has preferred axes, so a sigma-point set follows the world exactly only
    # through half a turn; by any other angle an estimate moves by a part of its own uncertainty.
    [("ekf", 2.8, 1e-8), ("ekf", np.pi, 1e-8)]
    + [(name, np.pi, 1e-8) for name in SIGMA]
    + [(name, 2.8, 0.5) for name in SIGMA],
)
def test_estimates_turn_with_the_world(hard, name, angle, tolerance):
    moved, T = turned(hard, angle)
    bearings = (r.measurements[~r.lost[:, 1], 1] for r in (hard, moved))
    assert any((np.abs(np.diff(b)) > np.pi).any() for b in bearings), "the cut at pi is crossed"
    here, there = navgym.estimate(name, hard), navgym.estimate(name, moved)
    sigma = np.sqrt(np.diagonal(here.covariances, axis1=1, axis2=2))
    error = np.abs(there.states @ T - here.states) / sigma
    assert error.max() < tolerance


@pytest.mark.parametrize("name", FILTERS)
def test_whole_turns_added_to_measured_angles_change_nothing(hard, name):
    whole = np.random.default_rng(5).integers(-3, 4, hard.measurements.shape) * [0, 1, 0, 1]
    y = hard.measurements + 2 * np.pi * whole
    again = navgym.Recording(hard.time, y, hard.lost, model=hard.model)
    here, there = navgym.estimate(name, hard), navgym.estimate(name, again)
    np.testing.assert_allclose(there.states, here.states, atol=1e-9)
    np.testing.assert_allclose(there.innovations, here.innovations, atol=1e-12)


@pytest.mark.parametrize("name", FILTERS)
def test_all_lost_is_pure_prediction(hard, name):
    blind = navgym.Recording(hard.time, hard.measurements, np.ones(60, bool), model=hard.model)
    estimate = navgym.estimate(name, blind)
    assert np.isnan(estimate.nis).all()
    assert np.isnan(estimate.innovations).all()
    assert not estimate.diverged
    x = hard.model.x0
    for k in range(60):
        x = twin.system(hard.model, k).f(x)
    if name == "ekf":
        np.testing.assert_allclose(estimate.states[-1], x, atol=1e-9)
    # the turn rate is a random walk of its own: no filter may bend it
    variance = hard.model.P0[4, 4] + np.cumsum(hard.model.Q[:, 4, 4])
    np.testing.assert_allclose(estimate.states[:, 4], hard.model.x0[4], atol=1e-12)
    np.testing.assert_allclose(estimate.covariances[:, 4, 4], variance, rtol=1e-9)


@pytest.mark.parametrize("name", FILTERS)
def test_one_sample_is_enough(hard, name):
    one = navgym.Recording(
        [1.0], hard.measurements[:1], model=navgym.CoordinatedTurnModel(x0=[40, 0, 0, 1, 0.01])
    )
    close(navgym.estimate(name, one), twin.run(name, one), 1e-9)


def test_landing_on_the_beacon_is_flagged_and_leaves_the_neighbours_exact():
    model = navgym.CoordinatedTurnModel(x0=[-1.5, 1.5, 0, 0, 0])
    doomed = navgym.Recording([1.0, 2.0], np.ones((2, 4)), model=model)
    healthy = turn_recording(navgym.CoordinatedTurnModel(), 2)
    together = run("ekf", StateSpaceBatch.of([healthy, doomed, healthy]))
    assert together.diverged.tolist() == [False, True, False]
    assert np.isnan(together.states[1]).all()
    for i in (0, 2):
        assert (together.states[i] == navgym.estimate("ekf", healthy).states).all()


def test_truth_is_the_model_s_own_motion_and_measurement():
    calm = navgym.simulate(SCENARIO, 7, process_scale=1e-20, measurement_scale=1e-20, loss=0.0)
    s = twin.system(calm.model, 0)
    np.testing.assert_allclose(calm.truth[1:], [s.f(x) for x in calm.truth[:-1]], atol=1e-7)
    seen = np.array([s.h(x) for x in calm.truth])
    np.testing.assert_allclose(calm.measurements, seen, atol=1e-7)
    np.testing.assert_allclose(calm.model.observe(calm.truth), seen, atol=1e-12)


def test_noise_of_the_scenario_is_what_the_model_says():
    recording = navgym.simulate(SCENARIO, 8, 4000, loss=0.0)
    s = twin.system(recording.model, 0)
    w = recording.truth[1:] - [s.f(x) for x in recording.truth[:-1]]
    v = twin.wrapped(s, recording.measurements - [s.h(x) for x in recording.truth])
    for sample, covariance in ((w, s.Q), (v, s.R)):
        # each whitened variance is chi-square / 4000: standard deviation sqrt(2 / 4000) = .022
        white = np.linalg.solve(np.linalg.cholesky(covariance), sample.T)
        np.testing.assert_allclose(np.cov(white), np.eye(len(covariance)), atol=5 * 0.022)


@pytest.fixture(scope="module")
def fleet():
    """Sixty fresh voyages of the scenario."""
    return StateSpaceBatch.of(
        [navgym.simulate(SCENARIO, s) for s in navgym.seeds("validation", 60)]
    )


def test_no_filter_beats_another_on_the_coordinated_turn(fleet):
    error = {}
    for name in FILTERS:
        result = run(name, fleet)
        assert not result.diverged.any()
        e = (result.states - fleet.truth)[:, :, [0, 2]]
        error[name] = np.sqrt((e**2).sum(-1).mean(-1))
    for name in SIGMA:
        # paired, as both saw the same noise: under one per cent of the error apart
        assert abs((error[name] - error["ekf"]).mean()) < 0.01 * error["ekf"].mean()


@pytest.mark.parametrize("name", FILTERS)
def test_the_errors_are_as_large_as_the_filter_says(fleet, name):
    result = run(name, fleet, everything=True)
    e = result.states - fleet.truth
    nees = np.einsum("...i,...i", e, np.linalg.solve(result.covariances, e[..., None])[..., 0])
    # chi-square with 5 degrees: 60 runs, each worth about ten independent draws
    assert nees.mean() == pytest.approx(5.0, abs=4 * np.sqrt(2 * 5 / (60 * 10)))


def test_filters_for_linear_models_refuse_a_turn_model_and_name_those_that_can(hard):
    for name in CATALOGUE:
        if name not in FILTERS:
            with pytest.raises(
                ValueError, match=f"'{name}' needs a LinearModel.*ekf, ukf, ckf, cukf"
            ):
                navgym.estimate(name, hard)


def test_turn_model_survives_a_file(hard, tmp_path):
    again = navgym.Recording.load(hard.save(tmp_path / "turn.npz"))
    assert isinstance(again.model, navgym.CoordinatedTurnModel)
    assert (again.model.pack() == hard.model.pack()).all()
    assert (again.truth == hard.truth).all()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("dt", 0.0), ("dt", [[1.0]]), ("Q", np.eye(4)), ("Q", -np.eye(5)), ("R", np.zeros((4, 4))),
        ("R", np.eye(3)), ("x0", np.ones(4)), ("x0", [0, 1, 0, 1, 0]), ("x0", [9, 0, 9, 0, 0]),
        ("P0", np.zeros((5, 5))), ("P0", [np.eye(5)]), ("beacon", [1, 2, 3]), ("beacon", [np.nan, 0]),
    ],
)  # fmt: skip
def test_turn_model_names_the_field_that_is_wrong(field, value):
    with pytest.raises(ValueError, match=rf"^{field} must"):
        navgym.CoordinatedTurnModel(**{field: value})


def test_turn_model_wants_one_time_axis():
    with pytest.raises(ValueError, match="agree on its length"):
        navgym.CoordinatedTurnModel(dt=np.ones(3), R=np.tile(np.eye(4), (4, 1, 1)))
    assert navgym.CoordinatedTurnModel(dt=np.ones(3)).pack().shape == (3,)
    assert navgym.CoordinatedTurnModel().pack().dtype == RECORD


def test_unmodelled_turns_do_not_go_with_a_model_that_turns():
    with pytest.raises(ValueError, match="turns="):
        navgym.simulate("auv/turn", 0, measured="beacon")


def test_the_default_turn_is_the_one_that_is_documented():
    model = navgym.CoordinatedTurnModel()
    np.testing.assert_allclose(np.sqrt(np.diag(model.R)), [1.0, np.radians(1), 0.1, np.radians(2)])
    np.testing.assert_allclose(np.sqrt(np.diag(model.P0)), [1.0, 0.2, 1.0, 0.2, np.radians(1)])
    for matrix in (model.R, model.P0):
        assert not (matrix - np.diag(np.diag(matrix))).any()
    np.testing.assert_allclose(model.x0, [175.0, 0.0, 0.0, 1.5, np.radians(1.5)])
    assert model.x0[3] / model.x0[4] == pytest.approx(60.0, abs=5.0)  # m, radius of the turn


@pytest.mark.parametrize("dt", [0.3, 1.0, 2.0])
def test_its_process_noise_is_white_acceleration_and_a_wandering_turn_rate(dt):
    """Two steps add what one of twice the length does; the rates wander as a Wiener process."""
    one, two = (navgym.CoordinatedTurnModel(dt=t).Q for t in (dt, 2.0 * dt))
    F = np.eye(5)
    F[0, 1] = F[2, 3] = dt
    np.testing.assert_allclose(F @ one @ F.T + one, two, rtol=1e-12, atol=1e-18)
    wander = [0.02**2, 0.02**2, np.radians(0.05) ** 2]
    np.testing.assert_allclose(np.diag(one)[[1, 3, 4]], np.array(wander) * dt)
    np.testing.assert_allclose(np.diag(one)[[0, 2]], 0.02**2 * dt**3 / 3.0)
