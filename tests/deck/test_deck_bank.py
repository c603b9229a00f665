"""The deck's bank: against its dense twin, against what a fine simulation and algebra say, and at sea."""

from dataclasses import replace

import numpy as np
import pytest

import navgym
from navgym.deck import hypotheses
from navgym.deck.bank import GLITCH, PLAIN, SLAM
from navgym.deck.batch import DeckBatch
from navgym.deck.joint import AT
from navgym.deck.problem import PROBLEM
from navgym.inertial.flexure import ARCMIN, FlexureModel
from navgym.simulation import simulate_many
from tests.deck.lanes import bank_lanes, run_bank
from tests.twins import deck_bank as twin

MODES = ("plain", "plain", "slam", "glitch")
TRUTH = [AT.THETA, AT.RATE, AT.MEAN]  # of axis 0
RATE = slice(21, 24)


@pytest.fixture(scope="module")
def short():
    """6 s: calm, swell, slam and glitch, 1.5 s each; misaligned by some degrees."""
    return navgym.simulate(
        "deck/switch-30", 7, duration=6.0, dwell=(1.5, 1.5), static=(200.0, -100.0, 300.0)
    )


@pytest.fixture(scope="module")
def sea():
    """Four recordings of four minutes in switching seas."""
    recordings = simulate_many("deck/switch-30", navgym.seeds("test", 4, 500), duration=240.0)
    return DeckBatch.of(recordings)


@pytest.fixture(scope="module")
def found(sea):
    """The bank on them."""
    return PROBLEM.run("deck_bank", sea, everything=True)


def rate_errors(batch, rates, lag=0):
    """(N,) RMS length of θ̇'s error from a minute on, ′/s, where rates are told `lag` steps late."""
    true = batch.tapes["theta_rate"][:, 1200 : batch.steps - lag]
    error = rates[:, 1200 + lag :] - true
    return np.sqrt((error**2).sum(axis=-1).mean(axis=1)) / ARCMIN


def agree(found, wanted, tolerance=1e-6):
    """A run's first recording does as the twin does, in units of standard deviations."""
    sd = np.sqrt(np.diagonal(wanted["covariances"], axis1=1, axis2=2))[:, :24]
    P, n = wanted["covariances"][:, :24, :24], len(sd)
    found = {
        name: found[name][0][:n] for name in ("states", "covariances", "nis", "log_likelihood")
    }
    assert (np.abs(found["states"] - wanted["states"][:, :24]) / sd).max() < tolerance
    error = np.abs(found["covariances"] - P) / (sd[:, :, None] * sd[:, None, :])
    assert error.max() < tolerance
    np.testing.assert_allclose(found["nis"], wanted["nis"], rtol=tolerance)
    np.testing.assert_allclose(found["log_likelihood"], wanted["log_likelihood"], atol=1e-5)


# --- the kernel and its twin ----------------------------------------------------------------------

CASES = {
    "defaults": {},
    "lever": {"lever_sd": 0.1, "velocity_noise": 2e-3},
    "measured channels": {"own_channels": 0.0},
    "other events": {
        "mode_stay": 0.8, "slam_rate": 3.0, "slam_size": 2.0, "glitch_rate": 0.3,
        "glitch_velocity": 0.1, "glitch_rate_size": 1e-4, "process_noise_scale": 2.0,
    },
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_kernel_agrees_with_its_twin(case, short):
    columns = CASES[case]
    found = run_bank([short], **columns)
    flexures = hypotheses.flexures_of(short.model)
    told = {"process" if n == "process_noise_scale" else n: v for n, v in columns.items()}
    steps = short.steps if case == "defaults" else 20
    wanted = twin.bank(
        short, found["tapes"][0][:steps], MODES, twin.Beliefs(**told),
        lambda _, j: flexures[int(j == 1)],
    )  # fmt: skip
    agree(found, wanted)
    weights = found["mode_weights"][0]
    np.testing.assert_allclose(weights[:steps], wanted["mode_weights"], atol=1e-6)
    sd = np.sqrt(np.diagonal(wanted["covariances"], axis1=1, axis2=2))[2:, 27:33]
    late = found["lagged"][0].reshape(-1, 6)[2:steps]
    assert (np.abs(late - wanted["states"][2:, 27:33]) / sd).max() < 1e-6
    if case == "defaults":  # every mode has had its turn
        assert (weights.max(axis=0) > 0.8).all()


def test_the_oracle_agrees_with_its_twin(short):
    """Told the flexure, the noises and when slams come, step by step."""
    flexures = {tuple(row): FlexureModel(row[:3], row[3:6], row[6:]) for row in short.true_flexure}
    assert (short.impulse_variance > 0.0).any()
    run = PROBLEM.run("oracle", DeckBatch.of([short]), everything=True)
    wanted = twin.bank(
        short, DeckBatch.of([short]).tapes[0], ("plain",), twin.Beliefs(),
        lambda k, _: flexures[tuple(short.true_flexure[k])],
        short.impulse_variance, short.impulse_left[:, 0], short.disturbance_variance,
    )  # fmt: skip
    names = ("states", "covariances", "nis", "log_likelihood")
    agree({name: getattr(run, name) for name in names}, wanted)
    assert "mode_weights" not in run.extras


def test_steps_with_filled_samples_leave_the_rates_unused(short):
    lost = replace(short, sub_angle=_without(short.sub_angle, 200, 215))
    run = PROBLEM.run("deck_bank", DeckBatch.of([lost]), everything=True)
    assert np.isnan(run.innovations[0, 40:43, 3:]).all()
    assert np.isfinite(run.innovations[0, 43:]).all()
    assert np.isfinite(run.states).all()
    assert run.components[0, 40] == 3


def _without(samples, first, last):
    gone = samples.copy()
    gone[first:last] = np.nan
    return gone


# --- the joint model of the mean rate -------------------------------------------------------------


def predicted(recording, start):
    """P⁻ (3, 3) of [θ, θ̇, m] of axis 0 after a step from `start` (2, 2), nothing measured."""
    deaf = replace(recording, model=replace(recording.model, rate_noise=1e6))
    kinds = np.array([[PLAIN, 0]])
    lanes, models, tapes = bank_lanes([deaf], kinds)
    block = [AT.THETA, AT.RATE]
    lanes["P"][..., np.ix_(block, block)[0], np.ix_(block, block)[1]] = start
    row = hypotheses.OFF.copy()[None, None]
    row[..., 0] = 1e6
    lanes["length"] = 1
    from navgym.deck import bank

    out = hypotheses.outputs_for(1, 1, 1, everything=False)
    noise = hypotheses.NOTHING_KNOWN
    bank.run(lanes, models, kinds, tapes, 0, row, 1, *noise, *out.values())
    return lanes["P"][0, 0][np.ix_(TRUTH, TRUTH)]


def test_the_mean_rate_is_that_of_a_fine_simulation(short):
    """θ, θ̇ and the mean of θ̇, sampled five hundred times a step, of 40 000 decks."""
    model, dt, fine, runs = short.model.flexure, short.step, 500, 40_000
    start = np.array([[4e-6, 5e-8], [5e-8, 1e-8]])
    rng = np.random.default_rng(1)
    F, Q = model.transition(dt / fine)[0], np.linalg.cholesky(model.process_noise(dt / fine)[0])
    x = np.linalg.cholesky(start) @ rng.standard_normal((2, runs))
    total = np.zeros(runs)
    for _ in range(fine):
        before = x[1]
        x = F @ x + Q @ rng.standard_normal((2, runs))
        total += (before + x[1]) / 2.0
    seen = np.cov(np.vstack([x, total / fine]))
    P = predicted(short, start)
    sd = np.sqrt(np.diag(P))
    # the mean and the end of the rate are alike to two parts in a thousand: that part counts too
    assert np.abs((seen - P) / np.outer(sd, sd)).max() < 0.03
    apart = np.array([0.0, -1.0, 1.0])
    assert apart @ seen @ apart == pytest.approx(apart @ P @ apart, rel=0.03)


def test_what_gyros_measure_misses_the_rate_by_noise_that_drives_it(short):
    """v = m − θ̇: var v = q dt/3, cov(θ̇, v) = −q dt/2, cov(θ, v) = −q dt²/6, to a step's damping."""
    P = predicted(short, np.zeros((2, 2)))
    q, dt = short.model.flexure.noise_density[0], short.step
    v = np.array([0.0, -1.0, 1.0])
    assert v @ P @ v == pytest.approx(q * dt / 3.0, rel=0.03)
    assert P[1] @ v == pytest.approx(-q * dt / 2.0, rel=0.03)
    assert P[0] @ v == pytest.approx(-q * dt**2 / 6.0, rel=0.05)


def test_errors_of_the_rate_are_as_large_as_the_bank_says():
    """Where the end-point model is too sure by half: tests/deck/test_alignment.py."""
    nees = []
    for r in simulate_many("deck/paper", navgym.seeds("test", 12, 300), duration=150.0):
        found = navgym.estimate("deck_bank", r)
        e = (found.theta_rate - r.at_steps(r.theta_rate))[1200::20]
        P = found.covariances[1200::20, RATE, RATE]
        nees.append(np.einsum("ki,kij,kj->k", e, np.linalg.inv(P), e).mean() / 3.0)
    assert 0.8 < np.mean(nees) < 1.1


# --- modes ----------------------------------------------------------------------------------------


def test_modes_that_agree_are_one_filter(short):
    one = run_bank([short], np.array([[GLITCH, 0]]))
    four = run_bank([short], np.array([[GLITCH, 0]] * 4))
    np.testing.assert_allclose(four["mode_weights"], 0.25, atol=1e-9)
    sd = np.sqrt(np.diagonal(one["covariances"], axis1=2, axis2=3))
    assert (np.abs(four["states"] - one["states"]) / sd).max() < 1e-6


def test_modes_without_events_are_plain(short):
    """Events that cannot come change nothing."""
    plain = run_bank([short], np.array([[PLAIN, 0]]))
    for kind, never in ((SLAM, {"slam_rate": 1e-12}), (GLITCH, {"glitch_rate": 0.0})):
        found = run_bank([short], np.array([[kind, 0]]), **never)
        sd = np.sqrt(np.diagonal(plain["covariances"], axis1=2, axis2=3))
        calm = slice(0, 20)  # before the first event
        assert (np.abs(found["states"] - plain["states"]) / sd)[:, calm].max() < 1e-6


def test_p_stays_symmetric_and_positive_over_a_hundred_thousand_steps():
    recording = navgym.simulate("deck/switch-30", 4, duration=300.0)
    lanes, models, tapes = bank_lanes([recording], lever_sd=0.1)
    from navgym.deck import bank
    from navgym.deck.catalogue import CATALOGUE

    space = CATALOGUE["deck_bank_lever"].space
    row = hypotheses.table_of(space, space.array({})[None])
    out = hypotheses.outputs_for(1, tapes.shape[1], 4, everything=False)
    for lap in range(17):  # the same five minutes again: attitudes go on from where they begin
        args = (lanes, models, hypotheses.KINDS, tapes, lap * tapes.shape[1], row, 1)
        bank.run(*args, *hypotheses.NOTHING_KNOWN, *out.values())
    assert lanes["k"][0, -1] == 102_000
    for P in lanes["P"][0]:
        sd = np.sqrt(np.diag(P))
        correlation = P / np.outer(sd, sd)
        assert np.abs(correlation - correlation.T).max() < 1e-8
        assert np.linalg.eigvalsh(correlation).min() > -1e-9


def test_it_finds_the_regime(sea, found):
    weights, regimes = found.extras["mode_weights"][:, 1200:], np.array(sea.regimes())[:, 1200:]
    np.testing.assert_allclose(weights.sum(axis=-1), 1.0, atol=1e-9)
    names = sea.recordings[0].meta["regimes"]
    for j, name in enumerate(("calm", "swell", "slam", "glitch")):
        mean = weights[regimes == names.index(name)].mean(axis=0)
        assert mean.argmax() == j
        assert mean[j] > 0.7


def test_it_needs_no_width_and_beats_every_width(sea, found):
    own = rate_errors(sea, found.states[..., RATE]).mean()
    for width in (50.0, 10.0, 3.0):
        other = PROBLEM.run("alignment_mcc", sea, {"kernel_width": width}).states
        assert own < 0.7 * rate_errors(sea, other[..., RATE]).mean()


def test_a_step_later_it_knows_the_rate_better(sea, found):
    late = found.extras["theta_rate_lagged"]
    at_once, one, two = (
        rate_errors(sea, rates, lag).mean()
        for lag, rates in enumerate((found.states[..., RATE], late[:, :, 0], late[:, :, 1]))
    )
    assert one < 0.87 * at_once
    assert two < 1.01 * one


def test_an_estimate_tells_rates_after_a_lag(short):
    found = navgym.estimate("deck_bank", short)
    np.testing.assert_array_equal(found.theta_rate_after(0.0), found.theta_rate)
    late = found.extras["theta_rate_lagged"]
    for steps, lag in ((1, 0.05), (2, 0.1)):
        told = found.theta_rate_after(lag)
        np.testing.assert_array_equal(told[:-steps], late[steps:, steps - 1])
        assert np.isnan(told[-steps:]).all()
    with pytest.raises(ValueError, match=r"lag must be one of 0, 0\.05, 0\.1 s, got 0\.07"):
        found.theta_rate_after(0.07)
    with pytest.raises(ValueError, match="use deck_bank"):
        navgym.estimate("alignment", short).theta_rate_after(0.05)


# --- lever arm and channels -----------------------------------------------------------------------


def test_without_a_lever_error_both_banks_are_one(short):
    batch = DeckBatch.of([short])
    same = {"lever_sd": 0.0, "velocity_noise": 0.2}
    one, other = (PROBLEM.run(n, batch, same).states for n in ("deck_bank", "deck_bank_lever"))
    np.testing.assert_array_equal(one, other)


def test_an_unknown_lever_arm_costs_theta_unless_it_is_a_state():
    batch = DeckBatch.of(simulate_many("deck/lever", navgym.seeds("test", 4, 200)))
    rms = []
    for name in ("deck_bank", "deck_bank_lever"):
        error = PROBLEM.run(name, batch).states[:, 1200:, 18:21] - batch.truth[:, 1200:, :3]
        rms.append(np.sqrt((error**2).sum(-1).mean()) / ARCMIN)
    assert rms[0] > 9.0
    assert rms[1] < 7.0


def test_a_wrong_channel_spoils_no_other_at_large_angles():
    changes = {"static": (1800.0, 600.0, 1800.0), "duration": 120.0}
    batch = DeckBatch.of(simulate_many("deck/glitch", navgym.seeds("test", 3, 100), **changes))
    on, off = (
        rate_errors(
            batch, PROBLEM.run("deck_bank", batch, {"own_channels": c}).states[..., RATE]
        ).mean()
        for c in ("on", "off")
    )
    assert on < 0.8 * off


# --- what it survives -----------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1e2, 1e6, 1e200])
@pytest.mark.parametrize("channel", [1, 4])
def test_a_wrong_value_of_any_size_is_survived(channel, size):
    calm = navgym.simulate("deck/paper", 1, duration=40.0)
    disturbance = np.zeros((calm.steps, 6))
    unit = 1.0 if channel < 3 else 2e-3
    disturbance[600, channel] = size * unit
    clean = navgym.estimate("deck_bank", calm)
    hit = navgym.estimate("deck_bank", replace(calm, disturbance=disturbance))
    assert np.isfinite(hit.states).all()
    assert not hit.diverged
    assert hit.weights[600, channel] < 1e-3
    sd = np.sqrt(np.diagonal(hit.covariances, axis1=1, axis2=2))
    apart = (np.abs(hit.states - clean.states) / sd)[600:]
    assert apart.max() < 4.0
    assert apart[-1].max() < 0.5


# --- live -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["deck_bank", "deck_bank_lever"])
def test_live_it_is_what_estimate_says_to_the_bit(name, short):
    wanted = navgym.estimate(name, short, {"slam_rate": 0.5})
    live = navgym.LiveDeckBank(short.model, {"slam_rate": 0.5}, name, interval=short.interval)
    for _ in range(2):
        found = list(live.follow(short))
        for field, array in (
            ("state", wanted.states), ("covariance", wanted.covariances), ("nis", wanted.nis),
            ("mode_weights", wanted.extras["mode_weights"]), ("attitude", wanted.attitude),
            ("lagged", wanted.extras["theta_rate_lagged"]),
        ):  # fmt: skip
            np.testing.assert_array_equal(np.array([getattr(f, field) for f in found]), array)
        live.reset()
    assert found[-1].parameters["slam_rate"] == 0.5


def test_live_it_begins_anew_where_it_has_lost_the_track(short):
    live = navgym.LiveDeckBank(short.model, interval=short.interval)
    found = []
    for k, (sample, _, _) in enumerate(live.samples(short)):
        broken = sample * np.nan_to_num(1e300 if 250 <= k < 255 else 1.0)
        estimate = live.step(broken)
        found += [] if estimate is None else [estimate]
    assert live.restarts >= 1
    assert any(f.diverged for f in found)
    assert np.isfinite(found[-1].state).all()


def test_live_lost_samples_are_filled_in_and_marked(short):
    live, gaps = navgym.LiveDeckBank(short.model, interval=short.interval), []
    for k, (sample, _, _) in enumerate(live.samples(short)):
        found = live.step(sample, lost=[False, False, *[200 <= k < 210] * 2])
        if found is not None:
            gaps.append(int(found.tape["gap"][0]))
    assert gaps == [5 if k in (40, 41) else 0 for k in range(short.steps)]
    assert np.isfinite(found.state).all()


def test_live_what_cannot_be_is_refused(short):
    with pytest.raises(ValueError, match="deck_bank"):
        navgym.LiveDeckBank(short.model, filter_name="deck_bnk")
    with pytest.raises(ValueError, match="slam_rate"):
        navgym.LiveDeckBank(short.model, {"slam_rat": 1.0})
    with pytest.raises(TypeError, match="DeckModel"):
        navgym.LiveDeckBank(None)
    live = navgym.LiveDeckBank(short.model)
    live.step(np.zeros(12), time=1.0)
    with pytest.raises(ValueError, match=r"time must move by.*restart_clock"):
        live.step(np.zeros(12), time=2.0)
    live.restart_clock()
    live.step(np.zeros(12), time=2.0)
