"""Identification: closed forms, sampling limits, invariances, errors."""

import numpy as np
import pytest

import navgym
from navgym.identification import METHODS, catalogue, correlate, identify, methods, shape
from navgym.inertial.flexure import FlexureModel
from tests.conftest import real_data
from tests.identification.world import PAPER, exact, logarithms, rms_ln_b, simulate

QUICK = ("rvm", "rvm_dictionary", "nls", "tufts_kumaresan", "regression")
FITS = ("rvm", "rvm_dictionary", "nls", "tufts_kumaresan")
SEARCH = {"population": 10, "epochs": 15}
SIGMA = [1e-3, 2e-3, 3e-3]
WORLDS = {
    "oscillating": FlexureModel.from_correlation_time([10.0, 6.0, 20.0], SIGMA, 1.5),
    "nearly critical": FlexureModel.from_correlation_time([10.0, 6.0, 20.0], SIGMA, 0.01),
    "critical": FlexureModel.from_correlation_time([10.0, 6.0, 20.0], SIGMA),
    "overdamped": FlexureModel([0.6, 0.6, 0.3], [0.04, 0.06, 0.01], SIGMA),
}


@pytest.fixture(scope="module")
def records():
    return simulate(PAPER, 300.0, 0.5, runs=24)


def varied(shape):
    return np.random.default_rng(0).standard_normal(shape)


def options(method):
    """Keywords that make a method quick; skips the test where its library is missing."""
    if method == "svr":
        pytest.importorskip("sklearn")
    return SEARCH if method in {"whale", "swarm"} else {}


@pytest.mark.parametrize("world", WORLDS)
def test_the_closed_form_is_the_second_difference_of_the_autocorrelation(world):
    model, lags = WORLDS[world], 0.5 * np.arange(1.0, 100.0)
    places = np.log(
        np.column_stack((model.damping / 2.0 / np.sqrt(model.stiffness), np.sqrt(model.stiffness)))
    )
    ours = model.sigma**2 * shape.increment_autocorrelation(places, lags, 0.5).T
    wanted = model.increment_autocorrelation(lags, 0.5)
    np.testing.assert_allclose(ours, wanted, atol=1e-8 * np.abs(wanted).max())


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("method", FITS)
def test_an_exact_autocorrelation_gives_the_truth(method, world):
    model = WORLDS[world]
    data, close = exact(model), 1e-2 if method == "rvm" else 1e-3  # its Gaussians are no sines
    for axis in range(3):
        found = getattr(methods, method)(data, axis)
        zeta, b = np.exp(found.place)
        assert b == pytest.approx(np.sqrt(model.stiffness[axis]), rel=close)
        assert 2.0 * zeta * b == pytest.approx(model.damping[axis], rel=close)
        unit = shape.increment_autocorrelation(found.place, data.lags, data.step)
        assert shape.amplitude(unit, found.curve) == pytest.approx(
            model.sigma[axis] ** 2, rel=4.0 * close
        )


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("method", ["nls", "regression"])
def test_a_long_record_gives_the_truth(method, world):
    model = WORLDS[world]
    record = simulate(model, 40_000.0, 0.5, seed=7)[0]
    found = identify(method, record, 0.5)
    error = logarithms(found) - logarithms(model)
    assert (np.abs(error) < 4.5 * found.deviation + 0.01).all()
    assert (np.abs(error) < 0.5).all()


def test_gyro_noise_at_lag_zero_does_not_enter():
    quiet = simulate(PAPER, 3000.0, 0.5, seed=3)[0]
    rng = np.random.default_rng(0)
    white = quiet.std(axis=0) * rng.standard_normal(quiet.shape)
    # what is summed up to θ, as the regression needs it, tolerates less
    for method, share in (("nls", 0.3), ("rvm", 0.3), ("regression", 0.02)):
        one, other = identify(method, quiet, 0.5), identify(method, quiet + share * white, 0.5)
        difference = logarithms(one)[:, 1:] - logarithms(other)[:, 1:]
        assert (np.abs(difference) < one.deviation[:, 1:]).all()
    # whereas lag 0 itself grows by the noise's variance
    ratio = correlate(quiet + 0.3 * white, 0.5).variance / correlate(quiet, 0.5).variance
    np.testing.assert_allclose(ratio, 1.09, atol=0.03)


def test_lags_begin_where_increments_no_longer_overlap():
    record = simulate(PAPER, 100.0, 0.05)[0]
    data = correlate(record, 0.05, step=0.5)
    assert data.step == pytest.approx(0.5)
    assert data.lags[0] == pytest.approx(0.5)
    sums = np.array([record[k : k + 10].sum(axis=0) for k in range(len(record) - 9)])
    sums -= sums.mean(axis=0)
    wanted = [np.mean(sums[n:] * sums[: len(sums) - n], axis=0) for n in (0, 10, 20, 100)]
    np.testing.assert_allclose(data.variance, wanted[0])
    np.testing.assert_allclose(data.values[[0, 1, 9]], wanted[1:], rtol=1e-9, atol=1e-20)


def test_pairs_with_a_missing_increment_are_left_out():
    record = simulate(PAPER, 200.0, 0.5, seed=1)[0]
    record[100:140] = np.nan
    record[250, 1] = np.nan  # one axis missing: the row is
    data = correlate(record, 0.5)
    there = np.isfinite(record).all(axis=1)
    x = record - record[there].mean(axis=0)
    pairs = there[7:] & there[:-7]
    wanted = np.mean((x[7:] * x[:-7])[pairs], axis=0)
    np.testing.assert_allclose(data.values[6], wanted, rtol=1e-9)
    assert data.duration == pytest.approx(0.5 * there.sum())


@pytest.mark.parametrize("method", QUICK)
def test_gaps_cost_little(method):
    record = simulate(PAPER, 3000.0, 0.5, seed=5)[0]
    holed = record.copy()
    holed[::301] = np.nan
    whole, found = identify(method, record, 0.5), identify(method, holed, 0.5)
    assert (np.abs(logarithms(whole) - logarithms(found))[:, 1] < 0.6).all()


@pytest.mark.parametrize("method", METHODS)
def test_axes_may_be_exchanged(method, records):
    found = identify(method, records[0], 0.5, **options(method))
    turned = identify(method, records[0][:, [2, 0, 1]], 0.5, **options(method))
    np.testing.assert_allclose(logarithms(turned), logarithms(found)[[2, 0, 1]], atol=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_sigma_scales_with_the_increments_and_nothing_else_does(method, records):
    found = logarithms(identify(method, records[1], 0.5, **options(method)))
    scaled = logarithms(identify(method, 7.0 * records[1], 0.5, **options(method)))
    np.testing.assert_allclose(scaled - found, np.log([[1.0, 1.0, 7.0]] * 3), atol=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_the_same_record_gives_the_same_model(method, records):
    one, other = (identify(method, records[2], 0.5, **options(method)) for _ in range(2))
    np.testing.assert_array_equal(logarithms(one), logarithms(other))


def test_a_search_depends_on_its_seed(records):
    one, other = (identify("whale", records[0], 0.5, seed=s, **SEARCH) for s in (1, 2))
    assert not np.array_equal(logarithms(one), logarithms(other))


def test_a_swarm_that_searches_long_ends_in_the_least_squares_fit(records):
    fit = identify("nls", records[3], 0.5)
    swarm = identify("swarm", records[3], 0.5, population=40, epochs=150)
    assert (swarm.diagnostics["residual"] < 1.02 * fit.diagnostics["residual"]).all()


def test_regression_is_near_the_sampling_limit_and_fits_are_not(records):
    # std ln b ≈ 1/√(bW): .125, .125, .216
    limit = 1.0 / np.sqrt(np.sqrt(PAPER.stiffness) * 300.0)
    found = {m: [identify(m, r, 0.5) for r in records] for m in ("regression", "nls", "rvm")}
    rms = {m: rms_ln_b(models, PAPER) for m, models in found.items()}
    assert (rms["regression"] < 1.45 * limit).all()
    assert (rms["regression"] > 0.6 * limit).all()
    assert (rms["regression"] < rms["nls"]).all()
    np.testing.assert_allclose(rms["rvm"], rms["nls"], atol=0.005)  # the same to two decimals


def test_only_instruments_find_the_damping(records):
    plain = [identify("regression", r, 0.5, instruments=False) for r in records]
    exactly = [identify("regression", r, 0.5) for r in records]
    damping = [np.median([m.damping / PAPER.damping for m in f]) for f in (plain, exactly)]
    assert damping[0] == pytest.approx(2.0 / 3.0, abs=0.1)
    assert damping[1] == pytest.approx(1.0, abs=0.12)


def test_deviations_are_what_errors_are(records):
    for method in ("regression", "nls"):
        models = [identify(method, r, 0.5) for r in records]
        ratio = [(logarithms(m) - logarithms(PAPER)) / m.deviation for m in models]
        assert 0.8 < np.sqrt(np.median(np.square(ratio))) / 0.6745 < 1.5


@pytest.mark.parametrize("world", WORLDS)
def test_no_estimate_beats_the_fisher_information_of_the_path(world):
    """Seen continuously, dθ̇ = −(2μ θ̇ + b² θ) dt + dw tells of 2μ and b² with W var(θ̇)/q and
    W var(θ)/q. The W/t0 increments tell of q as a chi-square does, and σ² = q/(2·2μ·b²).
    """
    model, data = WORLDS[world], exact(WORLDS[world], duration=170.0)
    for axis in range(3):
        q, W = model.noise_density[axis], 170.0
        absolute = q / W / np.array([model.rate_sigma[axis] ** 2, model.sigma[axis] ** 2])
        relative = absolute / np.array([model.damping[axis], model.stiffness[axis]]) ** 2
        own = np.diag([*relative, 2.0 * 0.5 / W])  # of ln 2μ, ln b², ln q
        to_logs = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.5, -0.5, 0.5]])
        b = np.sqrt(model.stiffness[axis])
        place = np.log([model.damping[axis] / 2.0 / b, b])
        np.testing.assert_allclose(
            shape.sampling_limit(place, data), to_logs @ own @ to_logs.T, rtol=1e-9
        )


def test_the_deviation_of_a_fit_is_bartletts():
    """Least squares on an empirical autocorrelation whose errors covary as Bartlett (1946) says."""
    model = FlexureModel([0.9, 0.5, 1.6], [0.5, 0.8, 0.6], SIGMA)
    data = exact(model, lags=40, duration=170.0)
    noise = 0.3 * data.variance  # of the gyros, at lag 0
    for axis in range(3):
        b = np.sqrt(model.stiffness[axis])
        place = np.log([model.damping[axis] / 2.0 / b, b])

        def curve(logs, times, axis=axis):
            return FlexureModel(*np.exp(logs)).increment_autocorrelation(times, 0.5)[..., axis]

        R = curve(logarithms(model)[axis], 0.5 * np.arange(-160.0, 161.0))
        R[160] = data.variance[axis] + noise[axis]
        m = np.arange(-100, 101) + 160
        lags = np.arange(1, 41)
        errors = np.array(
            [[R[m] @ R[m + p - r] + R[m + p] @ R[m - r] for r in lags] for p in lags]
        ) * (0.5 / 170.0)  # fmt: skip
        here, h = logarithms(model)[axis], 1e-5 * np.eye(3)
        J = np.stack([(curve(here + e, data.lags) - curve(here - e, data.lags)) / 2e-5 for e in h])
        inverse = np.linalg.pinv(J.T)
        wanted = inverse @ errors @ inverse.T
        found = shape.deviation(place, model.sigma[axis], data, data.variance[axis] + noise[axis])
        least = np.sqrt(np.diag(shape.sampling_limit(place, data)))
        scale = np.maximum(least / np.sqrt(np.diag(wanted)), 1.0)
        np.testing.assert_allclose(found, wanted * np.outer(scale, scale), rtol=2e-3, atol=1e-5)


def test_a_method_that_is_no_fit_adds_its_distance_from_the_fit_to_the_covariance(records):
    """`nls` is the fit that is nearest to the same curve; the error of the way to it is one more."""
    for record in records[:3]:
        far, near = identify("tufts_kumaresan", record, 0.5), identify("nls", record, 0.5)
        away = logarithms(far) - logarithms(near)
        wanted = near.diagnostics["covariance"] + away[:, :, None] * away[:, None, :]
        np.testing.assert_allclose(far.diagnostics["covariance"], wanted, rtol=1e-6, atol=1e-12)


def test_where_nothing_decays_the_slowest_wave_is_taken_for_the_signal():
    """No pole lies outside of the unit circle: the one nearest to it is moved just beyond."""
    roots = np.array([0.5, 0.97 * np.exp(0.4j), 0.97 * np.exp(-0.4j), -0.2])
    found = methods._signal(roots, np.ones(30))
    np.testing.assert_allclose(found, 1.001 * np.exp([0.4j, -0.4j]), rtol=1e-12)


def test_the_longest_lag_goes_from_twenty_steps_to_half_the_record():
    record = varied((400, 3))
    for longest in (10.0, 100.0):
        assert correlate(record, 0.5, longest_lag=longest).lags[-1] == longest
    for longest in (9.5, 100.5):
        with pytest.raises(ValueError, match="longest_lag"):
            correlate(record, 0.5, longest_lag=longest)
    assert correlate(varied((80, 3)), 0.5).lags[-1] == 10.0  # a quarter of 40 s
    assert correlate(varied((600, 3)), 0.5).lags[-1] == 60.0


def test_forty_pairs_at_each_lag_are_enough():
    """Two halves of 80 increments far apart hold 2 · (80 − n) pairs at lag n."""
    record = varied((400, 3))
    record[80:320] = np.nan
    assert len(correlate(record, 0.5, longest_lag=30.0).lags) == 60
    with pytest.raises(ValueError, match="only 38 pairs"):
        correlate(record, 0.5, longest_lag=30.5)


def test_the_kernel_scale_is_a_dead_knob_below_eight_seconds(records):
    def ln_b(scale):
        models = [identify("rvm", r, 0.5, kernel_scale=scale) for r in records[:4]]
        return np.log([m.stiffness for m in models]) / 2.0

    still = ln_b(1.0)
    for scale in (2.0, 4.0, 8.0):
        assert np.abs(ln_b(scale) - still).max() < 0.03
    assert np.abs(ln_b(32.0) - still).max() > 0.05  # over-smoothed


def test_what_a_model_says_about_its_identification(records):
    found = identify("rvm", records[0], 0.5, longest_lag=40.0)
    told = found.diagnostics
    assert told["lags"].shape == (80,)
    assert told["autocorrelation"].shape == told["smoothed"].shape == (80, 3)
    assert (told["relevance_vectors"] > 0).all()
    assert told["covariance"].shape == (3, 3, 3)
    assert found.evidence.shape == (3,)
    assert identify("nls", records[0], 0.5).evidence is None
    limit = np.sqrt(1.0 / (np.sqrt(found.stiffness) * 300.0) * found.damping / 2.0)
    limit /= found.stiffness**0.25
    assert (found.deviation[:, 1] / 2.0 >= limit * 0.999).all()


def test_the_residual_is_the_misfit_of_the_model_s_autocorrelation(records):
    for method in ("nls", "regression"):
        found = identify(method, records[0], 0.5)
        told = found.diagnostics
        misfit = found.increment_autocorrelation(told["lags"], 0.5) - told["autocorrelation"]
        wanted = np.linalg.norm(misfit, axis=0) / np.linalg.norm(told["autocorrelation"], axis=0)
        np.testing.assert_allclose(told["residual"], wanted, rtol=1e-6)


@pytest.mark.parametrize("end", [0, 1], ids=["least", "largest"])
@pytest.mark.parametrize("which", [0, 1], ids=["damping ratio", "frequency"])
def test_an_axis_within_a_thousandth_of_the_region_s_edge_says_so(records, monkeypatch, which, end):
    away = 1e-3 * np.array([0.0, 0.9, 1.1])

    def placed(data, axis):
        region = shape.region(data)
        place = np.mean(region, axis=0)
        place[which] = region[end][which] + away[axis] * (-1.0) ** end
        curve = shape.increment_autocorrelation(place, data.lags, data.step)
        return methods.Found(place, curve, covariance=np.eye(3))

    monkeypatch.setitem(catalogue._FUNCTIONS, "nls", placed)
    assert identify("nls", records[0], 0.5).diagnostics["at_bound"].tolist() == [True, True, False]


def test_a_usual_motion_lies_inside_of_the_region(records):
    assert not identify("nls", records[0], 0.5).diagnostics["at_bound"].any()


def test_every_method_has_a_summary():
    assert set(QUICK) < set(METHODS)
    assert all(len(summary) > 20 for summary in METHODS.values())


@pytest.mark.parametrize(
    ("arguments", "keywords", "message"),
    [
        (("rvn", varied((400, 3)), 0.5), {}, "Did you mean 'rvm'"),
        (("rvm", varied((400, 3)), 0.5), {"kernel_scal": 1.0}, "Did you mean 'kernel_scale'"),
        (("nls", varied((400, 3)), 0.5), {"kernel_scale": 1.0}, "option of method 'nls'"),
        (("nls", varied((400, 2)), 0.5), {}, r"shape \(T, 3\)"),
        (("nls", np.full((400, 3), np.inf), 0.5), {}, "infinities"),
        (("nls", varied((23, 3)), 0.5), {}, "12 s are needed"),
        (("nls", varied((79, 3)), 0.5), {"fewest": 80}, "40 s are needed"),
        (
            ("nls", varied((79, 3)), 0.5),
            {"fewest": 20},
            "fewest must be a whole number of at least",
        ),
        (("nls", np.full((400, 3), np.nan), 0.5), {}, "received"),
        (("nls", varied((400, 3)), 0.5), {"step": 0.1}, "step"),
        (("nls", varied((400, 3)), 0.0), {}, "interval"),
        (("nls", varied((400, 3)), 0.5), {"longest_lag": 150.0}, "longest_lag"),
    ],
)
def test_errors_name_what_is_wrong(arguments, keywords, message):
    with pytest.raises(ValueError, match=message):
        identify(*arguments, **keywords)


@pytest.mark.parametrize("value", [0.0, 1e-4])
def test_increments_that_never_change_hold_no_flexure(value, records):
    record = records[0].copy()
    record[:, 1] = value
    with pytest.raises(ValueError, match=r"axis y .*no flexure"):
        identify("nls", record, 0.5)


@pytest.mark.parametrize("method", QUICK)
def test_white_noise_crashes_nothing(method):
    record = np.random.default_rng(0).standard_normal((600, 3))
    found = identify(method, record, 0.5)
    assert np.isfinite(logarithms(found)).all()


def test_a_library_that_is_missing_is_named_with_its_extra(monkeypatch, records):
    monkeypatch.setitem(__import__("sys").modules, "sklearn.svm", None)
    with pytest.raises(ImportError, match=r"navgym\[identification\]"):
        identify("svr", records[0], 0.5)


def swings(runs, seconds, dt, b, zeta, seed=0):
    """(runs, T, 3) increments of an oscillation that dies away from random phases, and 2 % of noise."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(round(seconds / dt) + 1.0)[:, None]
    phase, size = rng.uniform(0.0, 2.0 * np.pi, (runs, 1, 3)), rng.uniform(0.5, 1.5, (runs, 1, 3))
    wave = np.cos(b * np.sqrt(1.0 - zeta**2) * t + phase)
    increments = np.diff(0.05 * size * np.exp(-zeta * b * t) * wave, axis=1)
    return increments + 0.02 * increments.std() * rng.standard_normal(increments.shape)


def held(models, b):
    """Share of natural frequencies within two of their deviations."""
    away = [(0.5 * np.log(m.stiffness) - np.log(b)) / (m.deviation[:, 1] / 2.0) for m in models]
    return np.mean(np.abs(away) < 2.0)


@pytest.mark.parametrize("dt", [0.01, 0.05, 0.5])
@pytest.mark.parametrize("zeta", [0.005, 0.02, 0.1])
@pytest.mark.parametrize("b", [1.0, 4.2])
def test_a_swing_of_seventeen_seconds_is_identified_within_what_it_says(b, zeta, dt):
    with pytest.warns(UserWarning, match="17 s of increments are a short record"):
        found = [identify("nls", x, dt) for x in swings(12, 17.0, dt, b, zeta)]
    assert held(found, b) > 0.95
    assert all(m.diagnostics["short"] for m in found)
    relative = np.concatenate([m.deviation[:, 1] / 2.0 for m in found])
    assert 0.02 < np.median(relative) < 0.6  # a word, neither certainty nor nothing


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(("trial", "vicon"), [("Test03_Trial1", 4.227), ("Test05_Trial2", 4.186)])
@pytest.mark.parametrize("seconds", [17.0, None])
def test_seventeen_seconds_of_the_pendulum_tell_its_frequency(trial, vicon, seconds):
    recording = navgym.read("repoimu", real_data("repoimu"), trial=trial)
    rows = None if seconds is None else round(seconds / recording.step)
    found = identify("nls", navgym.flexure_increments(recording)[:rows], recording.step)
    swinging = int(np.argmax(found.sigma))
    away = 0.5 * np.log(found.stiffness[swinging]) - np.log(vicon)
    deviation = found.deviation[swinging, 1] / 2.0
    assert abs(away) < 2.0 * deviation
    assert deviation < 0.1
    assert found.diagnostics["short"]


@pytest.mark.filterwarnings("ignore:.*short record")
@pytest.mark.parametrize(("zeta", "share"), [(0.02, 0.95), (0.1, 0.93), (0.3, 0.9), (0.6, 0.8)])
@pytest.mark.parametrize("seconds", [17.0, 30.0])
def test_short_records_of_noise_hold_the_truth_as_often_as_the_manual_says(seconds, zeta, share):
    for b in (0.4, 1.0):
        model = FlexureModel([2.0 * zeta * b] * 3, [b**2] * 3, SIGMA)
        records = simulate(model, seconds, 0.05, runs=12, seed=8)
        assert held([identify("nls", x, 0.05) for x in records], b) >= share


def test_forty_seconds_are_no_short_record(recwarn):
    found = identify("nls", simulate(PAPER, 40.0, 0.05)[0], 0.05)
    assert not found.diagnostics["short"]
    assert found.diagnostics["step"] == pytest.approx(0.5)
    assert not [w for w in recwarn if "short record" in str(w.message)]


@pytest.mark.filterwarnings("ignore:.*short record")
@pytest.mark.parametrize("method", METHODS)
def test_no_method_gives_a_number_that_is_none(method):
    """From 24 increments on, of anything: a finite model, or an error that says why not."""
    rng = np.random.default_rng(0)
    for count in (24, 34, 79, 120):
        for record in (rng.standard_normal((count, 3)), swings(1, count * 0.5, 0.5, 1.0, 0.1)[0]):
            try:
                found = identify(method, record, 0.5, **options(method))
            except ValueError as error:
                assert "no flexure" in str(error)  # noqa: PT017
                continue
            assert np.isfinite(logarithms(found)).all()
            assert np.isfinite(found.deviation).all()
            assert (found.deviation > 0.0).all()


def test_masked_increments_are_missing():
    record = simulate(PAPER, 200.0, 0.5)[0]
    mask = np.zeros(record.shape, bool)
    mask[50:60, 1] = True
    holed = np.where(mask, np.nan, record)
    one, other = (identify("nls", x, 0.5) for x in (np.ma.masked_array(record, mask), holed))
    np.testing.assert_array_equal(logarithms(one), logarithms(other))


@pytest.mark.slow
def test_ordering_of_the_methods_over_many_records():
    records = simulate(PAPER, 300.0, 0.5, runs=20, seed=1)
    rms = {m: rms_ln_b([identify(m, r, 0.5) for r in records], PAPER) for m in METHODS}
    for fit, close in (("rvm", 0.01), ("rvm_dictionary", 0.01), ("swarm", 0.1)):
        np.testing.assert_allclose(rms[fit], rms["nls"], atol=close)
    for poor in ("whale", "tufts_kumaresan"):
        assert rms[poor].mean() > rms["nls"].mean()
    assert all((rms["regression"] <= other + 1e-9).all() for other in rms.values())
