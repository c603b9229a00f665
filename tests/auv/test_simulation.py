"""Simulated AUV recordings: losses, regimes, noise and tracks against theory."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import navgym
from navgym.auv.scenarios import CATALOGUE, AUVScenario, Loss, Regime, Turns
from navgym.auv.simulation import draw_losses
from navgym.core.regimes import sequence
from navgym.simulation import find_scenario, simulate_many

LINEAR = [name for name, s in CATALOGUE.items() if s.measured != "beacon"]


def runs(flags):
    """Lengths of the runs of True in a (T,) array, those that touch an end left out."""
    edges = np.flatnonzero(np.diff(flags.astype(int)))
    lengths = np.diff(edges)
    return lengths[::2] if not flags[0] else lengths[1::2]


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_scenario_simulates_what_it_says(name):
    scenario = CATALOGUE[name]
    recording = navgym.simulate(f"auv/{name}", 7)
    assert len(recording) == scenario.steps
    assert recording.truth.shape == (scenario.steps, recording.model.n)
    assert recording.meta["scenario"] == f"auv/{name}"
    assert recording.meta["seed"] == 7
    assert recording.meta["regimes"] == [r.name for r in scenario.regimes]
    np.testing.assert_allclose(np.diff(recording.time), scenario.dt)
    assert f"auv/{name}" in navgym.scenarios()


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_seed_is_one_recording_in_any_company(name):
    alone = navgym.simulate(f"auv/{name}", 5, steps=120)
    among = simulate_many(f"auv/{name}", [9, 5, 2], steps=120)[1]
    for field in ("truth", "measurements", "lost", "regime", "process_scale", "measurement_scale"):
        np.testing.assert_array_equal(getattr(alone, field), getattr(among, field))
    other = navgym.simulate(f"auv/{name}", 6, steps=120)
    assert (other.truth != alone.truth).all()


# losses


def lost_share(loss, count=400, **fields):
    recordings = simulate_many(AUVScenario("x", "", loss=loss, **fields), range(count))
    return np.stack([r.lost for r in recordings])


@pytest.mark.parametrize("rate", [0.0, 0.1, 0.5, 0.9, 1.0])
def test_independent_losses_have_their_rate_and_no_memory(rate):
    lost = lost_share(Loss(rate))
    spread = np.sqrt(rate * (1 - rate))
    assert lost[:, :, 0].mean() == pytest.approx(rate, abs=4.5 * spread / np.sqrt(400 * 500))
    np.testing.assert_array_equal(lost, lost[:, :, :1].repeat(4, axis=2))
    away = lost[:, :, 0] - rate
    assert abs((away[:, 1:] * away[:, :-1]).mean()) <= 4.5 * spread**2 / np.sqrt(400 * 500)


@pytest.mark.parametrize(("rate", "length"), [(0.3, 20.0), (0.6, 10.0), (0.1, 1.0), (0.75, 3.0)])
def test_bursts_have_their_rate_and_mean_length_from_the_first_sample_on(rate, length):
    """Gilbert-Elliott: run lengths are geometric, gaps too, and the chain starts stationary."""
    lost = lost_share(Loss(rate, length=length), steps=600)[:, :, 0]
    # runs correlate neighbours over about `length` samples
    error = 4.5 * np.sqrt(rate * (1 - rate) * 2 * length / (400 * 600))
    assert lost.mean() == pytest.approx(rate, abs=error)
    assert lost[:, 0].mean() == pytest.approx(rate, abs=4.5 * np.sqrt(rate * (1 - rate) / 400))
    # P(lost again | lost) is 1 - 1/length, estimated without the bias of cut runs
    stay = lost[:, 1:][lost[:, :-1]]
    again = 1 - 1 / length
    assert stay.mean() == pytest.approx(again, abs=4.5 * np.sqrt(again / length / len(stay)) + 1e-9)


def test_burst_lengths_are_geometric():
    lost = lost_share(Loss(0.2, length=4.0), count=20, steps=5000)[:, :, 0]
    lengths = np.concatenate([runs(row) for row in lost])
    for k in (1, 2, 5, 10):
        share = 0.75 ** (k - 1)
        error = 4.5 * np.sqrt(share / len(lengths))
        assert (lengths >= k).mean() == pytest.approx(share, abs=error)


def test_components_are_lost_independently_where_asked():
    lost = lost_share(Loss(0.3, length=5.0, per_component=True), steps=600)
    assert np.abs(lost.mean((0, 1)) - 0.3).max() < 0.02
    correlation = np.corrcoef(lost.reshape(-1, 4).T)
    assert np.abs(correlation - np.eye(4)).max() < 0.03


def test_components_are_lost_together_in_regimes_that_do_not_separate_them():
    """A scenario's own per-component loss does not tear a regime's joint bursts apart."""
    regimes = (Regime("apart"), Regime("together", loss=Loss(0.5, length=5.0)))
    scenario = AUVScenario("x", "", loss=Loss(0.3, per_component=True), regimes=regimes, steps=2000)
    recording = navgym.simulate(scenario, 0)
    together = recording.lost[recording.regime == 1]
    np.testing.assert_array_equal(together, together[:, :1].repeat(4, axis=1))
    apart = recording.lost[recording.regime == 0]
    assert (apart != apart[:, :1]).any()


def test_bursts_run_across_regimes_that_share_one_loss_process():
    """Regimes that change every second sample must not cut bursts of mean length 10."""
    regimes = (Regime("a"), Regime("b"))
    lost = lost_share(Loss(0.3, length=10.0), 100, regimes=regimes, dwell=(2, 2))[:, :, 0]
    stay = lost[:, 1:][lost[:, :-1]].mean()
    assert stay == pytest.approx(0.9, abs=0.01)


def test_planned_outages_are_spread_evenly_and_come_on_top():
    lost = navgym.simulate("auv/outage", 0, steps=600).lost[:, 0]
    np.testing.assert_array_equal(runs(lost), [30, 30, 30])
    starts = np.flatnonzero(np.diff(lost.astype(int)) == 1) + 1
    np.testing.assert_array_equal(starts, [85, 285, 485])
    more = navgym.simulate("auv/outage", 0, steps=600, loss=Loss(0.3, outages=3)).lost[:, 0]
    assert more[lost].all()
    assert more[~lost].mean() == pytest.approx(0.3, abs=0.1)


def test_losses_of_a_log_follow_the_same_process():
    rng = np.random.default_rng(0)
    base = Loss(0.4)
    lost = draw_losses(base, [base], np.zeros(20000, dtype=np.int64), 3, rng)
    assert lost.shape == (20000, 3)
    assert lost.mean() == pytest.approx(0.4, abs=0.02)


# regimes and noise


def test_regimes_dwell_in_range_and_never_follow_themselves():
    scenario = AUVScenario(
        "x", "", regimes=tuple(Regime(name) for name in "abc"), dwell=(5, 9), steps=4000
    )
    recordings = simulate_many(scenario, range(20))
    stays, followers = [], np.zeros((3, 3))
    for recording in recordings:
        changes = np.flatnonzero(np.diff(recording.regime)) + 1
        stays.append(np.diff(changes))
        np.add.at(followers, (recording.regime[changes - 1], recording.regime[changes]), 1)
    stays = np.concatenate(stays)
    assert sorted(set(stays)) == [5, 6, 7, 8, 9]
    counts = np.bincount(stays)[5:]
    assert np.abs(counts / len(stays) - 0.2).max() < 4.5 * np.sqrt(0.16 / len(stays))
    np.testing.assert_array_equal(np.diag(followers), 0)
    shares = followers / followers.sum(1, keepdims=True)
    assert np.abs(shares[~np.eye(3, dtype=bool)] - 0.5).max() < 0.05
    assert len({r.regime[0] for r in recordings}) == 3


def test_every_first_stay_is_whole_and_its_regime_drawn_evenly():
    firsts = []
    for seed in range(600):
        labels = sequence(3, (2, 2), 6, np.random.default_rng(seed))
        assert (labels[::2] == labels[1::2]).all()
        firsts.append(labels[0])
    assert np.abs(np.bincount(firsts) / 600 - 1 / 3).max() < 4.5 * np.sqrt(2 / 9 / 600)


def test_scales_are_those_of_the_regimes():
    recording = navgym.simulate("auv/switch-B", 3)
    names = np.array(recording.meta["regimes"])[recording.regime]
    for name, q, r in (("calm", 1, 0.25), ("noisy", 1, 25), ("burst", 1, 1), ("manoeuvre", 100, 1)):
        np.testing.assert_array_equal(recording.process_scale[names == name], q)
        np.testing.assert_array_equal(recording.measurement_scale[names == name], r)
    assert set(recording.measurement_scale[names == "outlier"]) == {1.0, 100.0}


def noise(recording):
    """Measurement noise in units of the model's sigma, lost samples included."""
    whole = simulate_many(
        find_scenario(recording.meta["scenario"], loss=0.0, steps=len(recording)),
        [recording.meta["seed"]],
    )[0]
    return whole.measurements - whole.model.observe(whole.truth)


def test_measurement_noise_has_the_models_covariance():
    v = np.concatenate([noise(r) for r in simulate_many("auv/nominal", range(40))])
    assert np.abs(np.cov(v.T) - np.eye(4)).max() < 4.5 * np.sqrt(2 / len(v))
    assert np.abs(v.mean(0)).max() < 4.5 / np.sqrt(len(v))
    lag = (v[1:] * v[:-1]).mean(0)
    assert np.abs(lag).max() < 4.5 / np.sqrt(len(v))


def test_outliers_have_their_share_and_size():
    recordings = simulate_many("auv/heavy", range(40))
    scale = np.concatenate([r.measurement_scale for r in recordings])
    v = np.concatenate([noise(r) for r in recordings])
    hit = scale > 1
    assert hit.mean() == pytest.approx(0.1, abs=4.5 * np.sqrt(0.09 / len(hit)))
    assert v[hit].std() == pytest.approx(10.0, rel=0.03)
    assert v[~hit].std() == pytest.approx(1.0, rel=0.02)


def test_student_noise_has_the_quantiles_of_student_t():
    """t with 3 degrees, scale 1: P(|t| > 1.638) = .2, P(|t| > 3.182) = .05, P(|t| > 5.841) = .01."""
    v = np.concatenate([noise(r) for r in simulate_many("auv/student", range(100))])
    for bound, share in ((1.6377, 0.2), (3.1824, 0.05), (5.8409, 0.01)):
        found = (np.abs(v) > bound).mean(0)
        assert np.abs(found - share).max() < 4.5 * np.sqrt(share / len(v))


def test_student_scale_is_what_an_oracle_may_divide_by():
    recordings = simulate_many("auv/student", range(40))
    white = [noise(r) / np.sqrt(r.measurement_scale)[:, None] for r in recordings]
    assert np.concatenate(white).std() == pytest.approx(1.0, rel=0.02)


# tracks


def test_tracks_spread_as_the_model_says():
    """Truth starts from N(x0, P0) a step before the first sample; covariance F P Fᵀ + Q after."""
    truth = np.stack([r.truth for r in simulate_many("auv/nominal", range(4000), steps=40)])
    model = CATALOGUE["nominal"].model
    x, P = model.x0, model.P0
    for k in range(40):
        x, P = model.F @ x, model.F @ P @ model.F.T + model.Q
        if k in (0, 1, 39):
            D = np.sqrt(np.diag(P))
            assert np.abs((truth[:, k].mean(0) - x) / D).max() < 4.5 / np.sqrt(4000)
            found = np.cov(truth[:, k].T)
            assert np.abs((found - P) / np.outer(D, D)).max() < 4.5 * np.sqrt(2 / 4000)


@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_process_noise_has_the_scaled_covariance(scale):
    recordings = simulate_many("auv/mismatch", range(20), manoeuvre_scale=scale)
    model = recordings[0].model
    w = np.concatenate([r.truth[1:] - r.truth[:-1] @ model.F.T for r in recordings])
    D = np.sqrt(scale * np.diag(model.Q))
    assert np.abs(np.cov((w / D).T) - np.eye(4)).max() < 4.5 * np.sqrt(2 / len(w))


def quiet_turn(**fields):
    """A turning track with next to no process noise, and its turn rate per step in degrees/s."""
    scenario = find_scenario("auv/turn", process_scale=1e-14, loss=0.0, steps=400, **fields)
    truth = navgym.simulate(scenario, 1).truth
    heading = np.unwrap(np.arctan2(truth[:, 3], truth[:, 1]))
    return truth, np.degrees(np.diff(heading)) / scenario.dt


def test_turns_keep_the_speed():
    truth, rate = quiet_turn()
    speed = np.hypot(truth[:, 1], truth[:, 3])
    np.testing.assert_allclose(speed, speed[0], rtol=1e-6)
    assert np.abs(rate).max() > 3.0


def test_turns_follow_circles():
    """The distance to the centre v/ω to the left stays the radius throughout a turn."""
    truth, rate = quiet_turn()
    turning = np.abs(rate) > 1.0
    first = int(np.argmax(turning))
    last = first + int(np.argmin(turning[first:]))
    omega = np.radians(rate[first])
    x, vx, y, vy = truth[first : last + 1].T
    centre = np.stack([x - vy / omega, y + vx / omega])
    np.testing.assert_allclose(centre, centre[:, :1] + np.zeros(len(x)), rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("dt", [0.5, 1.0, 2.0])
def test_turn_rates_and_durations_keep_to_their_ranges(dt):
    _, rate = quiet_turn(dt=dt, turns=Turns(rate=(2.0, 4.0), dwell=(10, 20)))
    turning = np.abs(rate) > 1e-3
    assert 1.99 < np.abs(rate[turning]).min() <= np.abs(rate[turning]).max() < 4.01
    durations = dt * np.concatenate([runs(turning), runs(~turning)])
    assert 10.0 <= durations.min() <= durations.max() <= 20.0


@pytest.mark.parametrize("measured", ["all", "position", "velocity"])
def test_measured_components_are_those_named(measured):
    recording = navgym.simulate(
        "auv/nominal", 0, loss=0.0, measured=measured, measurement_scale=1e-18
    )
    columns = {"all": [0, 1, 2, 3], "position": [0, 2], "velocity": [1, 3]}[measured]
    np.testing.assert_allclose(recording.measurements, recording.truth[:, columns], atol=1e-7)


# paired streams


@pytest.mark.parametrize("loss", [Loss(0.7), Loss(0.3, length=9.0), Loss(0.3, per_component=True)])
@pytest.mark.parametrize("name", LINEAR)
def test_losses_leave_track_and_noise_as_they_were(name, loss):
    base, other = (navgym.simulate(f"auv/{name}", 4, steps=200, loss=k) for k in (Loss(0.1), loss))
    np.testing.assert_array_equal(base.truth, other.truth)
    np.testing.assert_array_equal(base.measurement_scale, other.measurement_scale)
    both = ~base.lost & ~other.lost
    np.testing.assert_array_equal(base.measurements[both], other.measurements[both])


def test_noise_leaves_track_losses_and_regimes_as_they_were():
    base = navgym.simulate("auv/switch-B", 4)
    other = navgym.simulate("auv/switch-B", 4, measurement_scale=3.0, outlier_scale=50.0)
    for field in ("truth", "lost", "regime", "process_scale"):
        np.testing.assert_array_equal(getattr(base, field), getattr(other, field))


def test_dwell_leaves_losses_measurement_noise_and_initial_state_as_they_were():
    base, other = (navgym.simulate("auv/tvr", 4, dwell=dwell) for dwell in ((75, 125), (20, 30)))
    np.testing.assert_array_equal(base.lost, other.lost)
    np.testing.assert_array_equal(base.truth, other.truth)
    white = [
        (r.measurements - r.truth) / np.sqrt(r.measurement_scale)[:, None] for r in (base, other)
    ]
    np.testing.assert_allclose(*white, rtol=1e-9, atol=1e-9)


def test_the_same_seed_of_two_scenarios_shares_its_track():
    nominal, heavy = (navgym.simulate(f"auv/{name}", 8) for name in ("nominal", "heavy"))
    np.testing.assert_array_equal(nominal.truth, heavy.truth)
    np.testing.assert_array_equal(nominal.lost, heavy.lost)


# overrides


CHANGES = {
    "steps": 33,
    "dt": 0.5,
    "measured": "position",
    "loss": Loss(0.2, length=4.0),
    "regimes": (Regime("a", 2.0), Regime("b", outlier_rate=0.5)),
    "dwell": (3, 7),
    "turns": Turns(),
    "sway": (0.2, 30.0),
    "memory": 0.5,
    "measurement_scale": 4.0,
    "process_scale": 9.0,
    "outlier_scale": 7.0,
    "manoeuvre_scale": 300.0,
    "reference": {"process_noise_scale": 2.0},
    "name": "mine",
    "summary": "my own",
}


@pytest.mark.parametrize("field", CHANGES)
def test_every_field_can_be_overridden(field):
    scenario = find_scenario("auv/switch-B", **{field: CHANGES[field]})
    assert getattr(scenario, field) == CHANGES[field]
    assert (
        replace(scenario, **{field: getattr(CATALOGUE["switch-B"], field)}) == CATALOGUE["switch-B"]
    )
    navgym.simulate(scenario, 0)


def test_every_field_has_its_override_test():
    assert set(CHANGES) == set(AUVScenario.__dataclass_fields__)


def test_a_number_is_an_independent_loss_rate():
    assert find_scenario("auv/nominal", loss=0.5).loss == Loss(0.5)


def test_global_factors_multiply_every_regime():
    base, scaled = (
        navgym.simulate("auv/switch-B", 2, **factors)
        for factors in ({}, {"measurement_scale": 3.0, "process_scale": 5.0})
    )
    np.testing.assert_allclose(scaled.measurement_scale, 3.0 * base.measurement_scale)
    np.testing.assert_allclose(scaled.process_scale, 5.0 * base.process_scale)


def test_outlier_and_manoeuvre_scales_replace_the_regimes_own():
    recording = navgym.simulate("auv/switch-D", 2, outlier_scale=50.0, manoeuvre_scale=300.0)
    assert set(recording.measurement_scale) == {1.0, 50.0}
    assert set(recording.process_scale) == {1.0, 300.0}


@pytest.mark.parametrize("name", CATALOGUE)
def test_scenarios_survive_pickling(name):
    scenario = CATALOGUE[name].override(loss=Loss(0.4, length=5.0), reference={"fill": "skip"})
    again = pickle.loads(pickle.dumps(scenario))
    assert again == scenario
    assert hash(again) == hash(scenario)
    with pytest.raises(TypeError):
        again.reference["fill"] = "extrapolate"


def test_scenarios_cannot_be_changed_in_place():
    with pytest.raises(AttributeError):
        CATALOGUE["nominal"].steps = 3
    with pytest.raises(TypeError):
        CATALOGUE["mine"] = CATALOGUE["nominal"]


def test_a_thousand_recordings_of_800_steps_take_seconds():
    import time

    simulate_many("auv/switch-B", range(5))
    began = time.perf_counter()
    simulate_many("auv/switch-B", range(1000))
    assert time.perf_counter() - began < 6.0


def test_a_sway_adds_a_sine_that_starts_from_rest_and_leaves_all_else():
    """The difference to the same recording without it is the double integral of A sin(wt + phase)."""
    amount, period = 0.3, 20.0
    plain, pushed = (
        navgym.simulate("auv/nominal", 3, steps=400, dt=0.5, sway=sway)
        for sway in (None, (amount, period))
    )
    added = pushed.truth - plain.truth
    moved = (pushed.measurements - plain.measurements)[~plain.lost.any(axis=1)]
    np.testing.assert_allclose(moved, added[~plain.lost.any(axis=1)], atol=1e-9)
    np.testing.assert_array_equal(pushed.lost, plain.lost)
    t = plain.time
    for position, velocity in ((0, 1), (2, 3)):
        acceleration = np.gradient(added[:, velocity], t)[2:-2]
        assert np.abs(acceleration).max() == pytest.approx(amount, rel=0.02)
        spectrum = np.abs(np.fft.rfft(acceleration - acceleration.mean()))
        assert np.argmax(spectrum) == round(len(acceleration) * 0.5 / period)
        moved = np.gradient(added[:, position], t)[2:-2]
        np.testing.assert_allclose(moved, added[2:-2, velocity], atol=0.02)
        assert added[0, velocity] == added[0, position] == 0.0


def test_noise_with_a_memory_is_as_large_and_as_correlated_as_said():
    recording = navgym.simulate("auv/nominal", 1, steps=60_000, memory=0.8, loss=0.0)
    noise = recording.measurements - recording.truth
    deviations = np.sqrt(np.diag(recording.model.R))
    np.testing.assert_allclose(noise.std(axis=0), deviations, rtol=0.03)
    for lag in (1, 3):
        each = [np.corrcoef(c[lag:], c[:-lag])[0, 1] for c in noise.T]
        np.testing.assert_allclose(each, 0.8**lag, atol=0.02)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"memory": 1.0}, "memory must"),
        ({"sway": (0.1, 0.0)}, "period of sway"),
        ({"sway": (0.1,)}, "amplitude .* and a period"),
        ({"sway": (0.1, 20.0), "measured": "beacon"}, "linear model"),
    ],
)
def test_a_sway_or_a_memory_that_cannot_be_is_refused(fields, said):
    with pytest.raises(ValueError, match=said):
        CATALOGUE["nominal"].override(**fields)
