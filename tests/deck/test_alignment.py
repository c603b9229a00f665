"""The compiled deck filter against its dense twin, theory, and docs/science/idam.md#pitfalls."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import navgym
from navgym.core import health
from navgym.deck import alignment as kernels
from navgym.deck.estimation import attitude_error, attitudes
from navgym.deck.mechanization import TAPE
from navgym.inertial import update
from navgym.inertial.flexure import ARCMIN, FlexureModel
from navgym.simulation import simulate_many
from tests.deck.lanes import outputs_for, prepare, rule_of, run_alignment
from tests.twins import alignment as twin
from tests.twins.alignment import Rules

PAPER = FlexureModel.from_correlation_time([10.0, 10.0, 30.0], np.array([6.0, 6.0, 10.0]) * ARCMIN)
OVERDAMPED = FlexureModel([2.0, 1.0, 3.0], [0.05, 0.1, 0.2], 2e-3)
SWELL = FlexureModel.from_correlation_time([6.0, 6.0, 12.0], 3e-3, 1.5)


@pytest.fixture(scope="module")
def glitchy():
    """5 s: 100 filter steps, a tenth of the transmitted values wrong, misaligned by some degrees."""
    return navgym.simulate("deck/glitch", 3, duration=5.0, static=(200.0, -100.0, 300.0))


@pytest.fixture(scope="module")
def calm():
    """A minute in a calm sea."""
    return navgym.simulate("deck/paper", 1, duration=60.0)


@pytest.fixture(scope="module")
def long():
    """The paper's 300 s, 30 times over, the velocities trusted as little as an unknown lever asks."""
    recordings = simulate_many("deck/paper", range(30))
    return recordings, run_alignment(recordings[:1], velocity_noise=2.0)


def deviations(found):
    """(K, 24) standard deviations."""
    return np.sqrt(np.diagonal(np.asarray(found["covariances"]), axis1=-2, axis2=-1))


def theta_errors(found):
    """(N, K, 3) rad."""
    return found["states"][..., kernels.THETA] - found["tapes"]["theta"]


def agree(found, wanted, tolerance=1e-6, lane=0):
    """Assert that a lane of the kernel does as the twin does, in units of standard deviations.

    A prior of .3 rad beside one of 1e-8 costs half of the digits, whatever the form of the update.
    """
    sd = deviations(wanted)
    scale = {
        "states": sd,
        "covariances": sd[:, :, None] * sd[:, None, :],
        "innovations": np.sqrt(wanted["innovation_variance"]),
        "innovation_variance": np.array(wanted["innovation_variance"]),
        "weights": 1.0,
        "nis": np.array(wanted["nis"]),
        "log_likelihood": 1.0 + np.array(wanted["nis"]),  # half of the NIS is in it
        "model_error": 1e-3,
    }
    for name, unit in scale.items():
        error = np.abs(found[name][lane] - np.array(wanted[name])) / unit
        assert error.max() <= tolerance, f"{name}: {error.max():.1e}"


# --- the kernel and its twin ----------------------------------------------------------------------

CASES = {
    "plain": ({}, {}, Rules()),
    "correntropy": ({"kernel_width": 3.0}, {}, Rules(width=3.0)),
    "narrow": ({"kernel_width": 1.5}, {}, Rules(width=1.5)),
    "model error": ({"model_error_weight": 1.0}, {}, Rules(weight=1.0)),
    "cheap model error": ({"model_error_weight": 0.01}, {}, Rules(weight=0.01)),
    "both": ({"kernel_width": 3.0, "model_error_weight": 1.0}, {}, Rules(width=3.0, weight=1.0)),
    "three iterations": ({"kernel_width": 3.0}, {"iterations": 3}, Rules(width=3.0, iterations=3)),
    "both, three iterations": (
        {"kernel_width": 3.0, "model_error_weight": 1.0},
        {"iterations": 3},
        Rules(width=3.0, weight=1.0, iterations=3),
    ),
    "judged by R": ({"kernel_width": 8.0}, {"by_noise": 1}, Rules(width=8.0, by_noise=True)),
    "no cross block": ({}, {"no_cross": 1}, Rules(cross=False)),
    "own channels": (
        {"kernel_width": 3.0},
        {"own_channels": 1},
        Rules(width=3.0, own_channels=True),
    ),
    "own channels, model error": (
        {"model_error_weight": 1.0},
        {"own_channels": 1},
        Rules(weight=1.0, own_channels=True),
    ),
    "noises": (
        {"velocity_noise": 1.7, "process_noise_scale": 30.0},
        {},
        Rules(velocity_noise=1.7, process=30.0),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_the_kernel_agrees_with_its_twin(case, glitchy):
    parameters, rule, rules = CASES[case]
    found = run_alignment([glitchy], rule, **parameters)
    tolerance = 1e-5 if rules.own_channels else 1e-6  # H of the twin by differences
    agree(found, twin.alignment(glitchy, found["tapes"][0], rules), tolerance)


def test_kernel_and_twin_agree_to_eight_digits_where_the_prior_is_well_scaled(glitchy):
    model = replace(glitchy.model, misalignment=1e-3)
    narrow = replace(glitchy, model=model, static=None)
    found = run_alignment([narrow], kernel_width=3.0)
    agree(found, twin.alignment(narrow, found["tapes"][0], Rules(width=3.0)), 1e-8)


@pytest.mark.parametrize("flexure", [OVERDAMPED, SWELL], ids=["overdamped", "oscillating"])
def test_any_sign_of_the_flexures_squared_frequency_will_do(flexure, glitchy):
    """λ² = b² − μ² < 0 and > 0; the twin's matrix exponential knows neither cosines nor sines."""
    found = run_alignment([glitchy], flexures=[flexure], model_error_weight=1.0)
    wanted = twin.alignment(
        glitchy, found["tapes"][0], Rules(weight=1.0), [flexure] * glitchy.steps
    )
    agree(found, wanted)


def test_the_tape_says_which_flexure_model_holds(glitchy):
    order = np.repeat([0, 2, 1], [40, 30, 30])

    def switch(tapes):
        tapes["model"] = order

    models = [PAPER, OVERDAMPED, SWELL]
    found = run_alignment([glitchy], flexures=models, change=switch)
    wanted = twin.alignment(glitchy, found["tapes"][0], Rules(), [models[i] for i in order])
    agree(found, wanted)


def test_steps_with_filled_samples_widen_p_and_leave_the_rates_unused(glitchy):
    def lose(tapes):
        tapes["gap"][0, 30:35] = [1, 5, 5, 5, 2]

    found = run_alignment([glitchy], change=lose)
    wanted = twin.alignment(glitchy, found["tapes"][0], Rules())
    sd = deviations(wanted)
    assert (np.abs(found["states"][0] - wanted["states"]) / sd).max() < 1e-6
    ratio = deviations(found)[0] / sd
    assert np.abs(ratio - 1.0).max() < 1e-6
    assert np.isnan(found["innovations"][0, 30:35, 3:]).all()
    assert np.isfinite(found["innovations"][0, 30:35, :3]).all()
    assert np.isfinite(found["innovations"][0, 35:]).all()
    assert found["nis"][0] == pytest.approx(np.array(wanted["nis"]), rel=1e-6)
    whole = run_alignment([glitchy])
    assert (
        deviations(found)[0, 34, kernels.PHI] > 5.0 * deviations(whole)[0, 34, kernels.PHI]
    ).all()


@given(seed=st.integers(0, 2**32 - 1), degrees=st.floats(0.0, 60.0))
def test_the_twins_jacobian_is_the_derivative_of_its_measurement(seed, degrees):
    """Central differences of h at random states, l of 30° (60° of attitude) included.

    h is a polynomial of second degree in the states, so these are exact but for rounding.
    """
    rng = np.random.default_rng(seed)
    tape = np.zeros((), TAPE)
    for name in ("V_s", "V_m", "w_s", "w_m"):
        tape[name] = rng.standard_normal(3)
    for name in ("q_mid", "q_m"):
        q = rng.standard_normal(4)
        tape[name] = q / np.linalg.norm(q)
    x = 0.1 * rng.standard_normal(24)
    x[:3] *= np.tan(np.radians(degrees) / 2.0) / np.linalg.norm(x[:3])
    step = 0.1
    difference = np.stack(
        [
            twin.predicted(x + step * e, tape) - twin.predicted(x - step * e, tape)
            for e in np.eye(24)
        ],
        axis=1,
    ) / (2.0 * step)
    np.testing.assert_allclose(twin.jacobian(x, tape), difference, atol=1e-12)


# --- limits of the robust parts -------------------------------------------------------------------


def theta_shift(recording, name, values, reference):
    """How far, in its standard deviations, θ and θ̇ move as a parameter takes each of `values`."""
    sd = deviations(reference)[0, :, kernels.FLEXING]
    runs = [
        run_alignment([recording], **{name: v})["states"][0, :, kernels.FLEXING] for v in values
    ]
    return [(np.abs(r - reference["states"][0, :, kernels.FLEXING]) / sd).max() for r in runs]


def test_correntropy_tends_to_the_kalman_filter_as_one_over_width_squared(calm):
    plain = run_alignment([calm])
    shift = theta_shift(calm, "kernel_width", [6.0, 12.0, 24.0, 48.0], plain)
    assert 1e-5 < shift[-1] < 1e-2
    ratios = np.array(shift[:-1]) / shift[1:]
    assert ratios[1:] == pytest.approx([4.0, 4.0], rel=0.05)


def test_a_width_of_fifty_is_exactly_off_rounding_included(calm):
    off, beyond, rounded, below = (
        run_alignment([calm], kernel_width=w) for w in (50.0, 1e9, 50.0 - 1e-13, 49.99)
    )
    np.testing.assert_array_equal(off["states"], beyond["states"])
    np.testing.assert_array_equal(off["states"], rounded["states"])
    np.testing.assert_array_equal(off["weights"], 1.0)
    assert (off["states"] != below["states"]).any()


def test_model_prediction_tends_to_off_as_one_over_its_weight(calm):
    plain = run_alignment([calm])
    shift = theta_shift(calm, "model_error_weight", [3e2, 3e3, 3e4, 3e5], plain)
    assert shift[-1] < 1e-2
    assert np.array(shift[1:-1]) / shift[2:] == pytest.approx([10.0, 10.0], rel=0.05)
    assert (run_alignment([calm], model_error_weight=3e5)["model_error"] != 0.0).any()


def test_a_weight_of_a_million_is_exactly_off(calm):
    off, beyond = (run_alignment([calm], model_error_weight=a) for a in (1e6, 1e12))
    np.testing.assert_array_equal(off["states"], beyond["states"])
    np.testing.assert_array_equal(off["model_error"], 0.0)


def total_attitude(found, recordings, start):
    """(N,) rms length of the attitude error after `start` s, arcmin."""
    rms = []
    for i, r in enumerate(recordings):
        estimated, _ = attitudes(found["tapes"][i], found["states"][i])
        error = attitude_error(estimated, r.at_steps(r.reference))[r.step_time > start]
        rms.append(np.sqrt((error**2).sum(1).mean()))
    return np.array(rms)


def test_a_free_model_error_destroys_the_alignment():
    """A → 0: the flexure explains every datum, and nothing is left for l."""
    recordings = simulate_many("deck/paper", range(4), duration=120.0)
    good, bad = (
        total_attitude(run_alignment(recordings, model_error_weight=a), recordings, 60.0)
        for a in (1e6, 1e-6)
    )
    assert good.max() < 4.0
    assert bad.min() > 3.0 * good.max()


# --- glitches -------------------------------------------------------------------------------------


def struck(recording, step, value):
    """The recording with one wrong transmission (6,)."""
    disturbance = np.zeros((recording.steps, 6))
    disturbance[step] = value
    return replace(recording, disturbance=disturbance)


@pytest.mark.parametrize("size", [1e2, 1e4, 1e6])
@pytest.mark.parametrize("channel", range(6))
def test_correntropy_ignores_a_glitch_of_any_size(channel, size, calm):
    clean = run_alignment([calm], kernel_width=3.0)
    value = np.zeros(6)
    value[channel] = size * np.sqrt(clean["innovation_variance"][0, 600, channel])
    hit = run_alignment([struck(calm, 600, value)], kernel_width=3.0)
    assert hit["weights"][0, 600, channel] == update.FLOOR
    assert np.isfinite(hit["states"]).all()
    assert np.isfinite(hit["covariances"]).all()
    # the filter that used the datum and the one that lost it differ, but as both expect
    apart = np.abs(hit["states"] - clean["states"])[0, 600:] / deviations(hit)[0, 600:]
    assert apart.max() < 3.0
    assert apart[-1].max() < 0.2


def test_the_plain_filter_believes_a_glitch(calm):
    clean = run_alignment([calm])
    hit = run_alignment([struck(calm, 600, [0.0, 0.0, 0.0, 0.02, 0.0, 0.0])])
    apart = (
        np.abs(hit["states"] - clean["states"])[0, 600, kernels.FLEXING]
        / deviations(clean)[0, 600, kernels.FLEXING]
    )
    assert apart.max() > 30.0


def from_a_minute_on(recordings, **rule):
    """Attitude errors over a second minute of a filter that begins there, anew, at width 2."""
    lanes, models, tapes, row = prepare(recordings, kernel_width=2.0)
    late = np.ascontiguousarray(tapes[:, 1200:])
    lanes["length"] = late.shape[1]
    out = outputs_for(late)
    kernels.run(lanes, models, late, rule_of(**rule), row, 1, *out)
    estimated = [
        attitudes(tape, states)[0][600:] for tape, states in zip(late, out[0], strict=True)
    ]
    error = [
        attitude_error(q, r.at_steps(r.reference)[1800:])
        for q, r in zip(estimated, recordings, strict=True)
    ]
    return np.sqrt((np.array(error) ** 2).sum(-1).mean(-1)), out[1]["weights"]


def test_judging_by_the_noise_alone_locks_out_under_a_wide_prior():
    """R-normalised weights reject what the prior leaves open, and the filter never recovers.

    The velocities have grown to 600 m/s when the filter begins, so that an innovation of many
    metres per second is what its prior of 17° predicts.
    """
    static = (600.0, -600.0, 900.0)
    recordings = simulate_many("deck/paper", range(3), duration=120.0, static=static)
    error, _ = from_a_minute_on(recordings)
    assert error.max() < 5.0
    error, weights = from_a_minute_on(recordings, by_noise=1)
    assert error.min() > 300.0
    assert weights[:, 600:, :2].max() < 1e-9


def test_judging_by_the_noise_alone_rejects_half_of_the_good_rates(calm):
    by_s, by_r = (run_alignment([calm], {"by_noise": r}, kernel_width=1.5) for r in (0, 1))
    assert by_s["weights"][0, :, 3:].mean() > 0.85
    assert by_r["weights"][0, :, 3:].mean() < 0.65


# --- covariances ----------------------------------------------------------------------------------


def test_the_cross_block_of_q_shows_in_p_and_hardly_in_the_errors():
    """Compare P (docs/science/idam.md#pitfalls): without the block V_r forgets whence it came."""
    recordings = simulate_many("deck/paper", range(10), duration=120.0)
    whole, torn = (run_alignment(recordings, {"no_cross": c}, velocity_noise=2.0) for c in (0, 1))
    ratio = deviations(torn)[:, -1] / deviations(whole)[:, -1]
    assert (ratio[:, kernels.VR] > 10.0).all()
    rms = [np.sqrt((theta_errors(found)[:, 1200:] ** 2).mean()) for found in (whole, torn)]
    assert rms[1] == pytest.approx(rms[0], rel=0.02)


def test_after_300_s_p_is_symmetric_and_positive_definite(long):
    P = long[1]["covariances"][0, ::50]
    sd = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    correlation = P / (sd[:, :, None] * sd[:, None, :])
    assert np.abs(correlation - correlation.swapaxes(1, 2)).max() < 1e-11
    assert np.linalg.eigvalsh(correlation).min() > 0.0


def test_the_deviation_of_theta_is_that_of_the_unknowable_split(long):
    """Gyros see θ(t) − θ(0); σ/√(1 + βt/4) is what the Markov model makes of the rest."""
    recordings, found = long
    model = recordings[0].model.flexure
    ratio = deviations(found)[0, -1, kernels.THETA] / model.split_deviation(300.0)
    assert ratio == pytest.approx(np.ones(3), abs=0.05)


def errors_of(recordings, **parameters):
    """(N, K, 6) errors of θ and θ̇, and their covariances (N, K, 6, 6), every 5 s from 60 s on."""
    lanes, models, tapes, row = prepare(recordings, **parameters)
    out = outputs_for(tapes, False)
    covariances = []
    for end in range(1200, tapes.shape[1] + 1, 100):
        lanes["length"] = end
        kernels.run(lanes, models, tapes, rule_of(judged=0), row, 1, *out)
        covariances.append(lanes["P"][:, kernels.FLEXING, kernels.FLEXING].copy())
    truth = np.concatenate([tapes["theta"], tapes["theta_rate"]], axis=-1)
    return (out[0][..., kernels.FLEXING] - truth)[:, 1199::100], np.stack(covariances, axis=1)


def nees(error, P):
    """Mean normalised estimation error squared over its dimension."""
    e = np.einsum("nki,nkij,nkj->nk", error, np.linalg.inv(P), error)
    return e.mean() / error.shape[-1]


def test_errors_of_theta_are_as_large_as_the_filter_says(long):
    """Errors of θ last as long as the record, so 30 runs are 30 samples: a wide band."""
    error, P = errors_of(long[0], velocity_noise=2.0)
    assert 0.3 < nees(error, P) < 1.3
    assert 0.5 < nees(error[..., :3], P[..., :3, :3]) < 1.2
    # a mean over the step is a datum on its end whose noise is not independent of Q: the filter
    # takes it for such, and is too sure of θ̇ by a fifth
    assert 1.0 < nees(error[..., 3:], P[..., 3:, 3:]) < 1.7


def test_errors_of_the_attitude_are_no_larger_than_the_filter_says(long):
    """2l + φ is the attitude's error, small l; r_V is wide, so the filter errs on the safe side."""
    recordings = long[0][:20]
    lanes, models, tapes, row = prepare(recordings, velocity_noise=2.0)
    out, found = outputs_for(tapes, False), []
    true = [r.at_steps(r.reference) for r in recordings]
    J = np.hstack([2.0 * np.eye(3), np.zeros((3, 3)), np.eye(3), np.zeros((3, 15))])
    for end in (2000, 4000, 6000):
        lanes["length"] = end
        kernels.run(lanes, models, tapes, rule_of(judged=0), row, 1, *out)
        for q, lane, tape in zip(true, lanes, tapes[:, end - 1 : end], strict=True):
            estimated, _ = attitudes(tape, lane["x"][None])
            error = attitude_error(estimated, q[end - 1 : end])[0] * ARCMIN
            error = twin.attitude(tape["q_m"][0]) @ error
            found.append(error @ np.linalg.solve(J @ lane["P"] @ J.T, error) / 3.0)
    assert 0.3 < np.mean(found) < 1.2


def test_theta_is_unknown_to_its_sigma_before_the_model_has_told_anything():
    """A simulator that starts from θ = 0 would give the split away: errors near 0 after 2 s."""
    recordings = simulate_many("deck/paper", range(200), duration=2.0)
    found = run_alignment(recordings, everything=False)
    power = (theta_errors(found)[:, -1] ** 2).mean(0) / recordings[0].model.flexure.sigma ** 2
    assert np.abs(power - 1.0).max() < 4.5 * np.sqrt(2.0 / 200)


def rms_theta_z(recordings, velocity_noise):
    found = run_alignment(recordings, everything=False, velocity_noise=velocity_noise)
    return np.sqrt((theta_errors(found)[:, 1200:, 2] ** 2).mean()) / ARCMIN


def test_an_exactly_known_lever_arm_is_a_hidden_oracle(long):
    """Velocities then see θ far below the limit of the gyros; 3 cm of lever arm spoil that."""
    exact = long[0][:8]
    off = simulate_many("deck/paper", range(8), lever_error=0.03)
    limit = rms_theta_z(exact, 2.0)
    assert 2.0 < limit < 7.0
    assert rms_theta_z(exact, 0.01) < 0.4 * limit
    assert rms_theta_z(off, 0.01) > 0.9 * limit
    assert rms_theta_z(off, 2.0) == pytest.approx(limit, rel=0.1)


def test_the_static_deformations_lever_arm_spoils_a_small_velocity_noise_more_than_centimetres_do():
    moved = simulate_many("deck/paper", range(6), static_lever=True)
    assert rms_theta_z(moved, 0.01) > 10.0
    assert rms_theta_z(moved, 2.0) < 7.0


# --- attitude -------------------------------------------------------------------------------------


@pytest.mark.parametrize("degrees", [0.2, 10.0, 30.0])
@pytest.mark.parametrize("axis", range(3))
def test_any_mounting_is_found_with_the_default_model(axis, degrees):
    static = tuple(np.eye(3)[axis] * degrees * 60.0)
    recordings = simulate_many("deck/paper", [4], duration=120.0, static=static)
    found = run_alignment(recordings, everything=False)
    assert total_attitude(found, recordings, 30.0)[0] < 3.0


def test_l_carries_the_static_and_the_first_dynamic_deformation(long):
    """2l → Φ + θ(0), so Φ follows as the attitude less θ, and 2l + θ counts θ(0) twice."""
    recordings = long[0][:8]
    found = run_alignment(recordings, everything=False, velocity_noise=2.0)
    l = found["states"][:, -1, kernels.L]  # noqa: E741
    start = np.array([r.theta[0] for r in recordings])
    static = recordings[0].static
    right = 2.0 * l - (static + start)
    wrong = 2.0 * l - static
    assert np.sqrt((right**2).mean()) / ARCMIN < 1.0
    assert np.sqrt((wrong**2).mean()) / ARCMIN > 4.0


def test_the_filters_rate_hardly_matters():
    """100 Hz and 20 Hz on the same increments, a second's velocities worth the same."""
    fast, slow = (
        run_alignment(
            [navgym.simulate("deck/paper", 2, duration=60.0, samples_per_step=s)],
            velocity_noise=0.2 * np.sqrt(5.0 / s),
        )
        for s in (1, 5)
    )
    np.testing.assert_array_equal(fast["tapes"][0, 4::5]["theta"], slow["tapes"][0]["theta"])
    apart = np.abs(fast["states"][0, 4::5] - slow["states"][0])[200:] / deviations(slow)[0, 200:]
    assert apart[:, kernels.THETA].max() < 0.2
    assert apart[:, kernels.L].max() < 0.6
    ratio = deviations(fast)[0, -1] / deviations(slow)[0, -1]
    assert ratio[:21] == pytest.approx(np.ones(21), abs=0.01)


# --- lanes ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("cut", [1, 37, 99])
def test_two_pieces_make_one_run_to_the_bit(cut, glitchy):
    parameters = {"kernel_width": 3.0, "model_error_weight": 1.0}
    whole = run_alignment([glitchy], **parameters)
    lanes, models, tapes, row = prepare([glitchy], **parameters)
    out = outputs_for(tapes)
    for end in (cut, 100):
        lanes["length"] = end
        kernels.run(lanes, models, tapes, rule_of(), row, 1, *out)
        assert lanes["k"][0] == end
    np.testing.assert_array_equal(out[0], whole["states"])
    np.testing.assert_array_equal(out[2], whole["covariances"])
    assert lanes[0].tobytes() == whole["lanes"][0].tobytes()


def test_a_lane_runs_alike_in_any_company(glitchy):
    others = simulate_many("deck/glitch", [5, 6], duration=7.0)
    alone = run_alignment([glitchy], kernel_width=3.0)
    among = run_alignment([others[0], glitchy, others[1]], kernel_width=3.0)
    for name in ("states", "covariances", "innovations", "nis", "log_likelihood"):
        np.testing.assert_array_equal(among[name][1, :100], alone[name][0])
    assert np.isnan(among["states"][1, 100:]).all()


@pytest.mark.parametrize("field", ["V_s", "w_s", "q_m", "dV", "omega"])
def test_a_corrupt_tape_fails_its_own_lane_only(field, glitchy):
    def corrupt(tapes):
        tapes[field][1, 50, 0] = np.nan

    clean = run_alignment([glitchy] * 3)
    found = run_alignment([glitchy] * 3, change=corrupt)
    assert found["lanes"]["diverged"].tolist() == [0, health.NUMERICAL, 0]
    for lane in (0, 2):
        np.testing.assert_array_equal(found["states"][lane], clean["states"][lane])
    np.testing.assert_array_equal(found["states"][1, :50], clean["states"][1, :50])
    assert np.isnan(found["states"][1, 50:]).all()
    assert np.isnan(found["covariances"][1, 50:]).all()


def test_innovations_that_run_away_are_flagged(calm):
    """A sub IMU that turns over between two samples: finite numbers, and no sense in them."""

    def turn_over(tapes):
        tapes["V_s"][0, 600:] *= -1.0
        tapes["w_s"][0, 600:] *= -1.0

    found = run_alignment([calm], change=turn_over)
    assert found["lanes"]["diverged"][0] == health.RUNAWAY
    assert np.isfinite(found["states"]).all()


def test_everything_off_saves_arrays_and_changes_nothing(glitchy):
    full = run_alignment([glitchy], kernel_width=3.0)
    lean = run_alignment([glitchy], everything=False, kernel_width=3.0)
    np.testing.assert_array_equal(full["states"], lean["states"])
    assert lean["covariances"].size == 0
