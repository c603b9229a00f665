"""The corrected variational-Bayes filter: its equations, bound, limits and published example."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import navgym
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import kalman, qivbf
from tests.helpers import identical, problems, random_model, random_problem, run, run_family, same
from tests.twins.vb import elbo, variational, vb_step

INF = np.inf
SKIP = 0
COLUMNS = ("sweeps", "tau", "rho", "count0", "scale0", "q", "fill", "inflation")


def vb(recording, **chosen):
    """The kernel with any parameters, named as the twin's."""
    usual = {"sweeps": 5, "tau": 5.0, "rho": 0.97, "count0": 5.0, "scale0": 1.0, "q": 1.0}
    values = usual | {"fill": SKIP, "inflation": 1.0} | chosen
    return run_family(qivbf, recording, [values[name] for name in COLUMNS])


@st.composite
def tunings(draw):
    return {
        "sweeps": draw(st.integers(1, 10)),
        "tau": draw(st.floats(0.1, 300.0)),
        "rho": draw(st.floats(0.6, 0.999)),
        "count0": draw(st.floats(1.0, 100.0)),
        "scale0": draw(st.floats(0.1, 10.0)),
        "q": draw(st.floats(0.1, 10.0)),
    }


@given(problem=problems(), tuning=tunings())
def test_predict_only_agrees_with_its_twin(problem, tuning):
    found = vb(problem.recording, **tuning)
    twin = variational(*problem.parts, **tuning)
    noise = twin.pop("noise")
    same(found, twin)
    np.testing.assert_allclose(found["lane"]["R"], noise[-1], atol=1e-9 * np.abs(noise[-1]).max())


@given(problem=problems(), tuning=tunings(), c=st.floats(1.0, 100.0))
def test_quadratic_fill_agrees_with_its_twin(problem, tuning, c):
    found = vb(problem.recording, **tuning, fill=qivbf.EXTRAPOLATE, inflation=c)
    twin = variational(*problem.parts, **tuning, fill="extrapolate", inflation=c)
    del twin["noise"]
    same(found, twin)


@given(problem=problems(steps=4), tuning=tunings())
def test_noise_that_passes_all_bounds_is_held_as_in_its_twin(problem, tuning):
    """Measurements a hundred sigma off, minutes apart: R̂ rises sixfold a sample, up to the most it may be."""
    far = problem.alter(y=1e2 * (1.0 + np.abs(problem.y)), time=problem.time * 900.0)
    twin = variational(*far.parts, **tuning)
    noise = twin.pop("noise")
    found = vb(far.recording, **tuning)
    same(found, twin, 1e-4)  # all components err alike: R̂ is hardly better than singular
    R = found["lane"]["R"]
    np.testing.assert_allclose(R, noise[-1], atol=1e-6 * np.abs(noise[-1]).max())
    most = 1e4 * np.diag(np.broadcast_to(far.model.R, (4, *R.shape))[-1])
    samples = (~far.lost).any(axis=1).sum()
    most = np.minimum(most, tuning["scale0"] * most / 1e4 * 6.0**samples)
    assert (np.diag(R) <= most * (1.0 + 1e-9)).all()


@pytest.mark.parametrize(("name", "fill"), [("vbakf", "skip"), ("qivbf", "extrapolate")])
def test_names_and_parameters_reach_the_kernel(name, fill):
    recording = navgym.simulate("auv/component-loss", 2, steps=60)
    chosen = {
        "vb_iterations": 3, "prior_count": 7.0, "forgetting": 0.9, "initial_count": 4.0,
        "initial_scale": 2.0, "process_noise_scale": 3.0,
    }  # fmt: skip
    more = {"fill": fill, "fill_inflation": 5.0} if name == "qivbf" else {}
    twin = variational(
        recording.model, recording.time, recording.measurements, recording.lost,
        *chosen.values(), fill, 5.0,
    )  # fmt: skip
    del twin["noise"]
    same(vars(navgym.estimate(name, recording, chosen | more)), twin)


def test_one_step_by_hand():
    """Scalar, F = H = 1: x⁻ = 0, P⁻ = 3 + 1, y = 2, one sweep from (x⁻, P⁻)."""
    model = navgym.LinearModel(F=[[1.0]], Q=[[1.0]], R=[[2.0]], P0=[[3.0]])
    recording = navgym.Recording([1.0], [[2.0]], model=model)
    found = vb(recording, sweeps=1, tau=7.0, rho=0.5, count0=6.0, scale0=0.5)
    # P̂ = P⁻ = 4; ν⁻ = 3, R⁻ = 1, B = 2² + 4 = 8, R̂ = (3·1 + 8)/4 = 2.75; K = 4/6.75
    assert found["states"][0, 0] == pytest.approx(2.0 * 4.0 / 6.75)
    assert found["covariances"][0, 0, 0] == pytest.approx(4.0 * 2.75 / 6.75)
    assert found["lane"]["R"][0, 0] == pytest.approx(2.75)
    assert found["lane"]["count"] == 4.0
    # the judgement comes before the adaptation: S = 4 + 1
    assert found["nis"][0] == pytest.approx(4.0 / 5.0)


@given(problem=problems())
def test_infinite_counts_make_it_the_kalman_filter(problem):
    """τ → ∞, ρ = 1, ν0 → ∞: neither P nor R can move, whatever is lost."""
    found = vb(problem.recording, tau=INF, rho=1.0, count0=INF)
    same(found, run_family(kalman, problem.recording, (1.0, 1.0, 1.0)), 1e-10)


@given(problem=problems())
def test_infinite_counts_and_fill_make_it_the_kalman_filter_with_fill(problem):
    found = vb(problem.recording, tau=INF, rho=1.0, count0=INF, fill=qivbf.EXTRAPOLATE)
    wanted = run_family(kalman, problem.recording, (1.0, 1.0, 1.0), kalman.EXTRAPOLATE)
    same(found, wanted, 1e-10)


@given(problem=problems(), tuning=tunings())
def test_fill_changes_nothing_when_nothing_is_lost(problem, tuning):
    recording = problem.alter(lost=np.zeros_like(problem.lost)).recording
    identical(
        vb(recording, **tuning), vb(recording, **tuning, fill=qivbf.EXTRAPOLATE, inflation=3.0)
    )


@given(problem=problems(steps=1, varying=False), tuning=tunings())
def test_evidence_bound_never_falls_over_sweeps(problem, tuning):
    """Also where components are lost: their noise is one more latent variable of the ascent."""
    got = ~problem.lost[0]
    if not got.any():
        return
    model, tau, scale0 = problem.model, tuning["tau"], tuning["scale0"]
    x = model.F @ model.x0
    P = model.F @ model.P0 @ model.F.T + tuning["q"] * model.Q
    count = max(tuning["rho"] * tuning["count0"], qivbf.LEAST_COUNT)
    prior = (x, P, scale0 * model.R, count, problem.y[0], model.H, model.R, got, tau)
    bounds = []
    for sweeps in range(1, 11):
        found = vb(problem.recording, **(tuning | {"sweeps": sweeps}))
        lane = found["lane"]
        bounds.append(
            elbo(
                found["states"][0], found["covariances"][0], lane["P_prior"], lane["R_used"], *prior
            )
        )
    assert np.diff(bounds).min() >= -1e-9 * (1.0 + np.abs(bounds).max())


@given(problem=problems(steps=1, varying=False), tuning=tunings(), weight=st.floats(0.005, 1.0))
def test_evidence_bound_never_falls_where_a_sample_counts_less(problem, tuning, weight):
    """Of the twin, with which the kernel agrees: a power of the likelihood has a bound as well."""
    got = ~problem.lost[0]
    if not got.any():
        return
    model, tau = problem.model, tuning["tau"]
    prior = model.F @ model.x0, model.F @ model.P0 @ model.F.T + model.Q, model.R, tuning["count0"]
    data = problem.y[0], model.H, model.R, got
    bounds = [
        elbo(*vb_step(*prior, *data, sweeps, tau, weight), *prior, *data, tau, weight)
        for sweeps in range(1, 11)
    ]
    assert np.diff(bounds).min() >= -1e-9 * (1.0 + np.abs(bounds).max())


def test_sweeps_converge_to_a_fixed_point_of_the_coordinate_updates():
    rng = np.random.default_rng(4)
    problem = random_problem(rng, random_model(rng, 4, 4), np.array([[False, True, False, False]]))
    found = vb(problem.recording, sweeps=400, tau=3.0)
    model, lane = problem.model, found["lane"]
    P = model.F @ model.P0 @ model.F.T + model.Q
    again = vb_step(
        model.F @ model.x0,
        P,
        model.R,
        0.97 * 5.0,
        problem.y[0],
        model.H,
        model.R,
        ~problem.lost[0],
        401,
        3.0,
    )
    for mine, theirs in zip(
        (found["states"][0], found["covariances"][0], lane["P_prior"], lane["R"]),
        again,
        strict=True,
    ):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-12)
    assert lane["change"] < 1e-20


def test_a_component_that_is_never_received_might_as_well_not_exist():
    """With R that does not couple it to the others, which the adapted R̂ must not do either."""
    whole = navgym.simulate("auv/tvr", 1)
    lost = whole.lost | np.array([False, True, False, True])
    R = np.eye(4)
    R[0, 2] = R[2, 0] = 0.4
    model = navgym.LinearModel(R=R)
    found = navgym.estimate(
        "vbakf", navgym.Recording(whole.time, whole.measurements, lost, model=model)
    )
    half = navgym.LinearModel(R=R[::2, ::2], H=np.eye(4)[::2])
    part = navgym.Recording(whole.time, whole.measurements[:, ::2], whole.lost[:, ::2], model=half)
    same(vars(found), vars(navgym.estimate("vbakf", part)), 1e-11, ("states", "covariances", "nis"))


def test_count_settles_where_a_new_sample_replaces_what_was_forgotten():
    recording = navgym.simulate("auv/nominal", 0, steps=300, loss=0.0)
    assert vb(recording, rho=0.9)["lane"]["count"] == pytest.approx(10.0)


def test_noise_estimate_finds_the_true_noise():
    recording = navgym.simulate("auv/nominal", 0, steps=2000, loss=0.0, measurement_scale=9.0)
    R = vb(recording, tau=300.0, rho=0.999)["lane"]["R"]
    np.testing.assert_allclose(R, 9.0 * np.eye(4), atol=9.0 * 4.5 * np.sqrt(2.0 / 900.0))


def outage(seed, length=200):
    """600 samples of which `length` are lost from the 200th on."""
    recording = navgym.simulate("auv/nominal", seed, steps=600, loss=0.0)
    dark = (np.arange(600) >= 200) & (np.arange(600) < 200 + length)
    return navgym.Recording(
        recording.time, recording.measurements, dark, truth=recording.truth, model=recording.model
    )


def head(recording, steps):
    """The first samples of a recording."""
    parts = (recording.time, recording.measurements, recording.lost)
    return navgym.Recording(*(part[:steps] for part in parts), model=recording.model)


@pytest.mark.parametrize("fill", [SKIP, qivbf.EXTRAPOLATE])
@pytest.mark.parametrize("rho", [0.8, 0.97, 0.999])
def test_an_outage_teaches_nothing_about_the_noise_and_forgets_only_so_much(fill, rho):
    """Of counts beyond ten, ρ per second; of ten or fewer what one sample forgets, and no more."""
    recording = outage(6)
    before, dark, after = (
        vb(head(recording, k), rho=rho, fill=fill)["lane"] for k in (200, 400, 401)
    )
    np.testing.assert_array_equal(dark["R"], before["R"])
    assert dark["count"] == before["count"]
    kept = max(before["count"] * rho**201, rho * min(before["count"], 10.0))
    assert after["count"] == pytest.approx(kept + 1.0)


@pytest.mark.parametrize("forgetting", [0.9, 0.97, 0.995])
def test_the_filter_recovers_at_once_from_a_long_outage(forgetting):
    batch = StateSpaceBatch.of([outage(seed) for seed in range(30)])

    def rmse(name, parameters):
        error = (run(name, batch, parameters).states - batch.truth)[:, 400:450, [0, 2]]
        return np.sqrt((error**2).sum(-1).mean())

    plain = {"process_noise_scale": 1.0, "vb_iterations": 5, "prior_count": 5.0}
    assert rmse("vbakf", plain | {"forgetting": forgetting}) < 1.15 * rmse("kf", None)
