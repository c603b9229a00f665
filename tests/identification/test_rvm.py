"""Sparse Bayesian regression: published figures, a readable twin, a peer in C++, invariances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import null_space

from navgym.identification import RVM
from navgym.identification.kernels import fast_marginal_likelihood
from navgym.identification.rvm import spline
from tests.identification import twin

X = np.linspace(-10.0, 10.0, 100)
SINC = np.sinc(X / np.pi)


def noisy(seed, points=100, sigma=0.1):
    x = np.linspace(-10.0, 10.0, points)
    return x, np.sinc(x / np.pi) + sigma * np.random.default_rng(seed).standard_normal(points)


def test_tippings_noise_free_sinc_takes_nine_relevance_vectors():
    # Tipping (2001), section 4.1: linear spline kernel, σ fixed at .01; 9 vectors, error .0070.
    # His w₀ has a prior about 0 as every weight has: it is one more column of the design.
    design = np.column_stack((spline(X[:, None], X[:, None]), np.ones(len(X))))
    printed = RVM("precomputed", bias=False, noise=0.01).fit(design, SINC)
    assert printed.converged
    assert len(printed.relevance) == 9 + 1
    assert np.abs(printed.predict(design) - SINC).max() == pytest.approx(0.0070, abs=1e-4)
    # without a prior on w₀, which an offset of y would shift, as many vectors come nearer
    machine = RVM("spline", noise=0.01).fit(X, SINC)
    assert machine.converged
    assert len(machine.relevance) == 9
    assert np.abs(machine.predict(X) - SINC).max() < 0.0070


@pytest.mark.parametrize("bias", [False, True])
def test_tippings_noisy_sinc(bias):
    # Tipping (2001), table 1, as corrected later: RMS .0326 with 6.7 vectors
    errors, counts = [], []
    for seed in range(60):
        machine = RVM("spline", bias=bias).fit(*noisy(seed))
        errors.append(np.sqrt(np.mean((machine.predict(X) - SINC) ** 2)))
        counts.append(len(machine.relevance))
    assert np.mean(errors) == pytest.approx(0.0326, abs=0.003)
    least = 0.8 if bias else 0.6  # w₀ takes the place of half a vector
    assert 6.7 - least < np.mean(counts) < 6.7 + 0.6


@pytest.mark.parametrize("bias", [False, True])
def test_uniform_noise_of_tippings_second_table(bias):
    errors = []
    for seed in range(60):
        y = SINC + np.random.default_rng(seed).uniform(-0.1, 0.1, 100)
        machine = RVM("spline", bias=bias).fit(X, y)
        errors.append(np.sqrt(np.mean((machine.predict(X) - SINC) ** 2)))
    assert np.mean(errors) == pytest.approx(0.0187, abs=0.003)


@pytest.mark.parametrize("learn", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_the_kernel_does_what_its_twin_does(seed, learn):
    rng = np.random.default_rng(seed)
    B = rng.standard_normal((25, 30))
    B /= np.linalg.norm(B, axis=1)[:, None]
    y = B[3] - 2.0 * B[11] + 0.1 * rng.standard_normal(30)
    first = np.array([0, 11, 20])
    active, alpha, mean, U, beta, trace, converged = fast_marginal_likelihood(
        B.T.copy(), y, 30, first, 100.0, learn, 1e12, 1e-6, 10_000
    )
    begun, found = twin.all_together(B, y, first.tolist(), 100.0, learn)
    wanted, found = twin.one_by_one(B, y, begun, found, learn, 1e-6)
    assert converged
    assert sorted(active) == sorted(wanted)
    np.testing.assert_allclose(alpha, [wanted[i] for i in active], rtol=1e-4)
    assert beta == pytest.approx(found, rel=1e-5)
    ours = dict(zip(active.tolist(), alpha, strict=True))
    assert trace[-1] == pytest.approx(twin.evidence(B, y, ours, beta), abs=1e-8)
    weights, variance = twin.posterior(B, y, ours, beta)
    np.testing.assert_allclose(mean, weights, rtol=1e-8)
    np.testing.assert_allclose(np.diag(U.T @ U), variance, rtol=1e-8)


def test_evidence_reaches_that_of_a_peer():
    rvr = pytest.importorskip("fastrvm").RVR
    for seed in range(5):
        x, y = noisy(seed, 200)
        ours = RVM("gaussian", scale=2.0, bias=False).fit(x, y)
        peer = rvr(kernel="rbf", gamma=0.25).fit(x[:, None], y)
        theirs = peer.scores_[-1] - len(x) / 2.0 * np.log(2.0 * np.pi)  # it leaves this out
        assert ours.evidence > theirs - 1.0
        np.testing.assert_allclose(ours.predict(x), peer.predict(x[:, None]), atol=0.05)


def test_the_evidence_never_falls_once_functions_move_one_by_one():
    machine = RVM("gaussian", scale=2.0, noise=0.1).fit(*noisy(0))
    steps = np.diff(machine.trace[40:])  # before, they may move together
    assert len(steps) > 10
    assert steps.min() > -1e-9


@pytest.mark.parametrize("bias", [False, True])
def test_the_evidence_is_the_density_of_the_targets(bias):
    """Integrated over w₀, that of N − 1 contrasts; the mean has ∫ N(√N w₀; …) dw₀ = 1/√N left."""
    x, y = noisy(1, 40)
    machine = RVM("gaussian", scale=2.0, bias=bias).fit(x, y)
    design = np.exp(-((x[:, None] - x[machine.relevance]) ** 2) / 4.0)
    C = machine.sigma**2 * np.eye(len(x)) + design @ np.diag(1.0 / machine.alpha) @ design.T
    contrasts = null_space(np.ones((1, len(x)))).T if bias else np.eye(len(x))
    C, y = contrasts @ C @ contrasts.T, contrasts @ y
    wanted = -0.5 * (np.linalg.slogdet(2 * np.pi * C)[1] + y @ np.linalg.solve(C, y))
    assert machine.evidence == pytest.approx(wanted - bias * 0.5 * np.log(len(x)), rel=1e-6)


def test_weights_constant_and_their_covariance_are_those_of_the_normal_equations():
    x, y = noisy(1, 40)
    machine = RVM("gaussian", scale=2.0).fit(x, y)
    design = np.exp(-((x[:, None] - x[machine.relevance]) ** 2) / 4.0)
    design = np.column_stack((design, np.ones(len(x))))
    precision = np.diag([*machine.alpha, 0.0]) + design.T @ design / machine.sigma**2
    np.testing.assert_allclose(np.linalg.inv(precision), machine.covariance, rtol=1e-6)
    mean = machine.covariance @ design.T @ y / machine.sigma**2
    np.testing.assert_allclose([*machine.weights, machine.intercept], mean, rtol=1e-6)
    variance = np.einsum("ni,ij,nj->n", design, machine.covariance, design)
    told = machine.predict(x, deviation=True)
    np.testing.assert_allclose(told[0], design @ mean, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(told[1] ** 2, variance + machine.sigma**2, rtol=1e-6)


def test_the_band_holds_the_share_of_data_that_it_promises():
    inside = []
    for seed in range(20):
        x, y = noisy(seed)
        mean, deviation = RVM("gaussian", scale=2.0).fit(x, y).predict(x, deviation=True)
        inside.append(np.abs(y - mean) < 2.0 * deviation)
    assert 0.93 < np.mean(inside) < 0.98


@pytest.mark.parametrize("factor", [1e-9, 1e6])
@pytest.mark.parametrize("bias", [False, True])
def test_units_of_the_targets_do_not_matter(bias, factor):
    x, y = noisy(2)
    one, other = (RVM(scale=2.0, bias=bias).fit(x, f * y) for f in (1.0, factor))
    np.testing.assert_array_equal(one.relevance, other.relevance)
    np.testing.assert_allclose(factor * one.weights, other.weights, rtol=1e-6)
    assert other.sigma == pytest.approx(factor * one.sigma)
    assert other.evidence == pytest.approx(one.evidence - (len(y) - bias) * np.log(factor))


def test_a_kernel_may_be_a_function_or_a_matrix():
    x, y = noisy(3)
    named = RVM("gaussian", scale=2.0).fit(x, y)
    called = RVM(lambda a, b: np.exp(-((a - b.T) ** 2) / 4.0)).fit(x, y)
    matrix = np.exp(-((x[:, None] - x) ** 2) / 4.0)
    given = RVM("precomputed").fit(matrix, y)
    np.testing.assert_allclose(called.predict(x), named.predict(x), atol=1e-9)
    np.testing.assert_allclose(given.predict(matrix), named.predict(x), atol=1e-9)


def test_a_constant_is_learnt_with_a_bias_and_two_dimensions_are_points():
    grid = np.stack(np.meshgrid(np.arange(8.0), np.arange(8.0)), axis=-1).reshape(-1, 2)
    rng = np.random.default_rng(0)
    y = 5.0 + np.exp(-((grid - 3.0) ** 2).sum(axis=1) / 4.0) + 0.01 * rng.standard_normal(64)
    machine = RVM(scale=2.0, bias=True).fit(grid, y)
    assert machine.intercept == pytest.approx(5.0, abs=0.05)
    assert len(machine.relevance) <= 6


def test_a_constant_may_be_all_that_is_relevant():
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(X))
    nothing = np.zeros((len(X), 1))
    machine = RVM("precomputed", bias=True, noise=0.01).fit(nothing, 5.0 + noise)
    assert len(machine.relevance) == len(machine.weights) == 0
    assert machine.intercept == pytest.approx(5.0 + noise.mean(), rel=1e-6)
    mean, deviation = machine.predict(nothing[:3], deviation=True)
    np.testing.assert_allclose(mean, machine.intercept)
    np.testing.assert_allclose(deviation, 0.01 * np.sqrt(1.0 + 1.0 / len(X)), rtol=1e-4)


def test_targets_that_are_zero_leave_nothing_relevant():
    machine = RVM().fit(X, np.zeros(100))
    assert len(machine.relevance) == 0
    np.testing.assert_array_equal(machine.predict(X), 0.0)


@pytest.mark.parametrize(("points", "functions"), [(10, 200), (60, 5), (2, 2)])
def test_a_design_may_be_wide_or_tall(points, functions):
    rng = np.random.default_rng(0)
    design = rng.standard_normal((points, functions))
    machine = RVM("precomputed", bias=True).fit(design, design[:, 1] + 1.0)
    assert np.isfinite(machine.predict(design)).all()
    assert len(machine.relevance) <= points


def test_functions_that_repeat_do_no_harm():
    design = np.repeat(np.exp(-((X[:, None] - X[::10]) ** 2) / 4.0), 5, axis=1)
    machine = RVM("precomputed").fit(design, design[:, 12])
    np.testing.assert_allclose(machine.predict(design), design[:, 12], atol=1e-4)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kernel": "gausian"}, "Did you mean 'gaussian'"),
        ({"scale": 0.0}, "scale"),
        ({"noise": -1.0}, "noise"),
        ({"limit": 0}, "limit"),
    ],
)
def test_options_that_cannot_be_used_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        RVM(**options)


def test_a_function_that_is_zero_everywhere_is_never_relevant():
    design = np.column_stack((np.zeros(len(X)), np.exp(-((X[:, None] - X[::10]) ** 2) / 9.0)))
    with_it, without = RVM("precomputed", noise=0.1), RVM("precomputed", noise=0.1)
    with_it.fit(design, SINC)
    without.fit(design[:, 1:], SINC)
    assert 0 not in with_it.relevance
    assert np.isfinite(with_it.predict(design)).all()
    np.testing.assert_allclose(with_it.predict(design), without.predict(design[:, 1:]), atol=1e-3)


def test_data_that_cannot_be_used_are_named():
    for points in (np.zeros((3, 1, 1)), np.zeros((0, 2)), np.zeros(0), 3.0):
        with pytest.raises(ValueError, match="x must have shape"):
            RVM().fit(points, np.zeros(len(np.atleast_1d(points))))
    with pytest.raises(ValueError, match="and at least 2"):
        RVM().fit([1.0], [1.0])
    with pytest.raises(ValueError, match="y must hold one number per row"):
        RVM().fit(X, SINC[:-1])
    with pytest.raises(ValueError, match=r"kernel\(x, z\) must return shape"):
        RVM(lambda a, b: a).fit(X, SINC)
    with pytest.raises(RuntimeError, match="call fit"):
        RVM().predict(X)


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 10_000),
    size=st.floats(-6.0, 8.0),
    sign=st.sampled_from((-1.0, 1.0)),
    unit=st.floats(-100.0, 100.0),
    kernel=st.sampled_from(("gaussian", "spline")),
)
def test_an_offset_of_the_targets_moves_the_intercept_only(seed, size, sign, unit, kernel):
    """The constant is integrated over, so that no prior ties it to 0; what is left is rounding."""
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(-10.0, 10.0, rng.integers(5, 60)))
    y = 10.0**unit * (np.sinc(x / np.pi) + 0.1 * rng.standard_normal(len(x)))
    spread = y.std()
    offset = sign * 10.0**size * spread
    one, other = (RVM(kernel, scale=2.0).fit(x, y + c) for c in (0.0, offset))
    close = spread * (1e-9 + 1e-14 * 10.0**size)
    np.testing.assert_array_equal(one.relevance, other.relevance)
    np.testing.assert_allclose(other.predict(x) - offset, one.predict(x), rtol=0, atol=close)
    np.testing.assert_allclose(other.intercept - offset, one.intercept, rtol=1e-6, atol=20 * close)
    assert other.sigma == pytest.approx(one.sigma, rel=1e-6)


@settings(deadline=None, max_examples=40)
@given(
    points=st.integers(2, 40),
    value=st.floats(-1e100, 1e100).filter(lambda v: v == 0.0 or abs(v) > 1e-100),
    seed=st.integers(0, 100),
)
def test_a_constant_target_is_predicted_with_next_to_no_noise(points, value, seed):
    x = np.random.default_rng(seed).uniform(-1.0, 1.0, points)
    machine = RVM(scale=3.0).fit(x, np.full(points, value))
    mean, deviation = machine.predict(x, deviation=True)
    np.testing.assert_allclose(mean, value, rtol=1e-12)
    assert (deviation <= 2e-6 * (abs(value) or 1.0)).all()
    assert len(machine.relevance) == 0
    assert machine.intercept == pytest.approx(value, rel=1e-12)


SHAPES = {
    "noise": lambda rng, n: rng.standard_normal(n),
    "line": lambda rng, n: np.arange(float(n)),
    "spike": lambda rng, n: np.eye(n)[0],
    "constant": lambda rng, n: np.ones(n),
    "last digits": lambda rng, n: 1.0 + 2.2e-16 * rng.integers(0, 3, n),
    "exact": lambda rng, n: np.exp(-(np.linspace(-1.0, 1.0, n) ** 2)),
}
PLACES = {
    "even": lambda rng, n: np.linspace(-1.0, 1.0, n)[:, None],
    "plane": lambda rng, n: rng.standard_normal((n, 2)),
    "repeated": lambda rng, n: rng.integers(0, 3, (n, 2)),
    "one point": lambda rng, n: np.ones((n, 1)),
}


@settings(deadline=None, max_examples=150)
@given(
    seed=st.integers(0, 10_000),
    points=st.integers(2, 50),
    place=st.sampled_from(sorted(PLACES)),
    target=st.sampled_from(sorted(SHAPES)),
    offset=st.sampled_from((0.0, 1.0, 1e5, -1e8, 1e15)),
    unit=st.integers(-100, 100),
    far=st.integers(-8, 8),
    kernel=st.sampled_from(("gaussian", "spline")),
    bias=st.booleans(),
    scale=st.integers(-300, 6),
    noise=st.sampled_from((None, 1e-200, 1e-6, 1.0, 1e6)),
)
def test_whatever_it_learns_is_finite_and_settled(
    seed, points, place, target, offset, unit, far, kernel, bias, scale, noise
):
    rng = np.random.default_rng(seed)
    x = PLACES[place](rng, points) * 10.0**far
    y = (SHAPES[target](rng, points) + offset) * 10.0**unit
    given_noise = None if noise is None else max(noise * 10.0**unit, 1e-300)
    machine = RVM(kernel, bias=bias, scale=10.0**scale, noise=given_noise).fit(x, y)
    mean, deviation = machine.predict(x, deviation=True)
    for value in (mean, deviation, machine.weights, machine.covariance, machine.trace):
        assert np.isfinite(value).all()
    assert (deviation >= machine.sigma * (1.0 - 1e-12)).all()
    assert machine.sigma > 0.0
    assert machine.converged


def test_a_limit_that_came_first_is_told():
    machine = RVM("spline", noise=0.01, limit=5).fit(X, SINC)
    assert machine.iterations == 5
    assert not machine.converged


@pytest.mark.parametrize(("fitted", "asked"), [((20,), (3, 2)), ((20, 2), (3,)), ((20, 3), (4, 2))])
@pytest.mark.parametrize("kernel", ["gaussian", "spline", "precomputed", lambda a, b: a @ b.T])
def test_points_of_another_dimension_are_refused_with_both_numbers(kernel, fitted, asked):
    rng = np.random.default_rng(0)
    machine = RVM(kernel).fit(rng.standard_normal(fitted), rng.standard_normal(20))
    old, new = ((*shape, 1)[1] for shape in (fitted, asked))
    with pytest.raises(ValueError, match=f"must have {old} column.*got {new}"):
        machine.predict(np.zeros(asked))


def test_whole_numbers_lists_and_columns_are_points_like_any_other():
    x, y = np.arange(20), np.arange(20) % 5
    wanted = RVM(scale=2.0).fit(x.astype(float), y.astype(float)).predict(x)
    for same in (RVM(scale=2.0).fit(x.tolist(), y.tolist()), RVM(scale=2.0).fit(x[:, None], y)):
        np.testing.assert_array_equal(same.predict(x[:, None]), wanted)
    unmasked = np.ma.masked_array(y, mask=np.zeros(20, bool))
    np.testing.assert_array_equal(RVM(scale=2.0).fit(x, unmasked).predict(x), wanted)


def test_points_and_targets_that_are_not_numbers_are_refused():
    masked = np.ma.masked_array(SINC, mask=np.arange(len(X)) == 3)
    with pytest.raises(ValueError, match="y must be known, got 1 masked"):
        RVM().fit(X, masked)
    with pytest.raises(ValueError, match="x must be known, got 1 masked"):
        RVM().fit(masked, SINC)
    for value in (np.nan, np.inf):
        with pytest.raises(ValueError, match="y must be finite"):
            RVM().fit(X, np.where(np.arange(len(X)) == 3, value, SINC))
        with pytest.raises(ValueError, match="x must be finite"):
            RVM().fit(X, SINC).predict([value])
    with pytest.raises(ValueError, match="y must hold one number per row"):
        RVM().fit(X, SINC[:, None])
    with pytest.raises(ValueError, match="rescale them"):
        RVM("spline").fit(1e150 * X, SINC)
    with pytest.raises(ValueError, match="another unit"):
        RVM().fit(X, 1e160 * SINC)
