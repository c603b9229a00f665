"""The deck's catalogue: what each name runs, schedules, batches, and what is refused."""

import importlib
from dataclasses import replace

import numpy as np
import pytest

import navgym
from navgym.deck import alignment as kernels
from navgym.deck.batch import DeckBatch
from navgym.deck.catalogue import CATALOGUE as DECK_CATALOGUE
from navgym.deck.filters import full_table, printed_models, rule_of
from navgym.inertial.flexure import ARCMIN, FlexureModel
from navgym.simulation import simulate_many
from navgym.statespace.filters.catalogue import CATALOGUE
from tests.deck.lanes import run_alignment
from tests.helpers import run_deck
from tests.twins import alignment as twin

IDENTIFYING = [name for name, f in DECK_CATALOGUE.items() if f.option.method is not None]
PLAIN = [name for name in DECK_CATALOGUE if name not in IDENTIFYING]


@pytest.fixture(scope="module")
def switching():
    """30 s: calm, swell, slam and glitch follow one another every 5 s."""
    return navgym.simulate("deck/switch-30", 2, duration=30.0, dwell=(5.0, 5.0))


def same(found, wanted):
    """A DeckEstimate is the first lane of a kernel's run, to the bit."""
    for name in ("states", "covariances", "innovations", "weights", "nis", "log_likelihood"):
        np.testing.assert_array_equal(getattr(found, name), wanted[name][0], err_msg=name)


# --- what the names mean --------------------------------------------------------------------------


def test_alignment_is_the_kernel_with_everything_off(switching):
    same(navgym.estimate("alignment", switching), run_alignment([switching]))
    given = {"velocity_noise": 1.5, "process_noise_scale": 3.0}
    same(navgym.estimate("alignment", switching, given), run_alignment([switching], **given))


def test_alignment_mcc_is_the_kernel_with_a_width(switching):
    given = {"kernel_width": 3.0, "velocity_noise": 1.5}
    same(navgym.estimate("alignment_mcc", switching, given), run_alignment([switching], **given))
    default = DECK_CATALOGUE["alignment_mcc"].space.defaults
    same(navgym.estimate("alignment_mcc", switching), run_alignment([switching], **default))


def test_alignment_own_is_the_kernel_by_the_subs_own_channels(switching):
    own = navgym.estimate("alignment_own", switching, {"kernel_width": 3.0})
    same(own, run_alignment([switching], {"own_channels": 1}, kernel_width=3.0))
    measured = navgym.estimate("alignment_mcc", switching, {"kernel_width": 3.0})
    assert np.abs(own.theta_rate - measured.theta_rate).max() > 0.0


def test_by_own_channels_a_wrong_one_spoils_no_other_at_large_angles():
    """θ̇ is a third better where IMUs are turned by (30, 10, 30) degrees."""
    changes = {"static": (1800.0, 600.0, 1800.0), "duration": 240.0}
    batch = DeckBatch.of(simulate_many("deck/glitch", navgym.seeds("test", 4, 100), **changes))
    rms = []
    for name in ("alignment_own", "alignment_mcc"):
        rates = run_deck(name, batch, {"kernel_width": 2.0}).states[:, 1200:, 21:]
        error = rates - batch.truth[:, 1200:, 3:]
        rms.append(np.sqrt((error**2).sum(axis=-1).mean(axis=1)).mean())
    assert rms[0] < 0.75 * rms[1]


def test_the_oracle_beats_the_believer_where_the_model_changes():
    batch = DeckBatch.of(simulate_many("deck/switch-30", range(6), duration=240.0))
    rms = {
        name: np.sqrt(
            np.nanmean((run_deck(name, batch).states[..., 21:] - batch.truth[..., 3:]) ** 2)
        )
        for name in PLAIN
    }
    assert rms["oracle"] < 0.75 * rms["alignment_mcc"]
    assert rms["alignment_mcc"] < 0.75 * rms["alignment"]


def test_the_printed_filter_takes_the_damping_for_twice_the_frequency(switching):
    """Eq. 76 writes −β², −2β whatever was identified."""
    flexure = FlexureModel([0.1, 0.2, 0.3], [0.04, 0.09, 0.16], 1e-3)
    packed = printed_models(switching, flexure)[0]
    critical = FlexureModel([0.4, 0.6, 0.8], [0.04, 0.09, 0.16], 1e-3)
    np.testing.assert_allclose(packed["transition"], critical.transition(0.05), rtol=1e-12)
    np.testing.assert_allclose(packed["noise"], critical.process_noise(0.05), rtol=1e-12)
    rule = rule_of(DECK_CATALOGUE["idam_printed"].option, False)[0]
    assert rule["by_noise"] == rule["no_cross"] == rule["printed_covariance"] == 1
    for name in set(DECK_CATALOGUE) - {"idam_printed"}:
        rule = rule_of(DECK_CATALOGUE[name].option, True)[0]
        assert rule["by_noise"] == rule["no_cross"] == rule["printed_covariance"] == 0
        assert rule["iterations"] == rule["judged"] == 1


def test_the_printed_covariance_is_too_large_where_weights_are_small(switching):
    """Pzz = HPHᵀC + R: P falls by a part only of what the gain takes; it agrees at weight 1."""
    right, printed = (
        run_alignment([switching], {"printed_covariance": p}, kernel_width=2.0) for p in (0, 1)
    )
    P, Q = (np.diagonal(f["covariances"][0], axis1=1, axis2=2) for f in (right, printed))
    assert (Q[-1, 21:] > 1.01 * P[-1, 21:]).all()
    off = [run_alignment([switching], {"printed_covariance": p}) for p in (0, 1)]
    np.testing.assert_array_equal(off[0]["covariances"], off[1]["covariances"])


def test_columns_that_a_filter_does_not_expose_are_off():
    space = DECK_CATALOGUE["alignment"].space
    table = full_table(space, np.array([[[0.7, 3.0]]]))
    np.testing.assert_array_equal(table, [[[50.0, 0.7, 1e6, 3.0]]])


# --- schedules ------------------------------------------------------------------------------------


def test_a_schedule_changes_the_width_every_second(switching):
    widths = [2.0, 50.0] * 15
    found = navgym.estimate("alignment_mcc", switching, {"kernel_width": widths})
    per_second = found.weights.reshape(30, 20, 6)
    assert (per_second[1::2] == 1.0).all()
    assert (per_second[::2] < 1.0).any(axis=(1, 2)).all()
    rules = [twin.Rules(width=w if w < 50.0 else np.inf) for w in np.repeat(widths, 20)]
    tape = DeckBatch.of([switching]).tapes[0]
    wanted = twin.alignment(switching, tape[:100], rules[:100])
    sd = np.sqrt(np.diagonal(np.array(wanted["covariances"]), axis1=1, axis2=2))
    assert (np.abs(found.states[:100] - wanted["states"]) / sd).max() < 1e-6


def test_the_last_row_of_a_schedule_holds_and_the_interval_is_in_filter_steps(switching):
    found = navgym.estimate("alignment_mcc", switching, {"kernel_width": [50.0, 2.0]}, 7)
    assert (found.weights[:7] == 1.0).all()
    assert (found.weights[7:] < 1.0).any(axis=1).mean() > 0.9


def test_a_schedule_of_one_value_is_that_value(switching):
    one = navgym.estimate("alignment_mcc", switching, {"kernel_width": 4.0})
    many = navgym.estimate("alignment_mcc", switching, {"kernel_width": [4.0] * 30})
    np.testing.assert_array_equal(one.states, many.states)


@pytest.mark.parametrize("interval", [0, -1, 2.5])
def test_impossible_intervals_are_refused(interval, switching):
    with pytest.raises((ValueError, TypeError), match="decision_interval"):
        navgym.estimate("alignment", switching, None, interval)


def test_longer_schedules_than_the_recording_are_refused(switching):
    with pytest.raises(ValueError, match="at most 30 rows, got 31"):
        navgym.estimate("alignment_mcc", switching, {"kernel_width": [4.0] * 31})


# --- batches --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PLAIN)
def test_a_recording_is_filtered_alike_in_any_company(name, switching):
    others = simulate_many("deck/switch-30", [7, 8], duration=40.0, dwell=(3.0, 3.0))
    batch = DeckBatch.of([others[0], switching, others[1]])
    found = run_deck(name, batch, everything=True)
    alone = navgym.estimate(name, switching)
    np.testing.assert_array_equal(found.states[1, :600], alone.states)
    np.testing.assert_array_equal(found.covariances[1, :600], alone.covariances)
    assert np.isnan(found.states[1, 600:]).all()


def test_each_recording_may_have_parameters_of_its_own(switching):
    batch = DeckBatch.of([switching, switching])
    given = [{"kernel_width": 2.0}, {"kernel_width": 20.0}]
    found = run_deck("alignment_mcc", batch, given).states
    for i in range(2):
        alone = navgym.estimate("alignment_mcc", switching, given[i]).states
        np.testing.assert_array_equal(found[i], alone)


def test_truth_of_a_batch_ends_with_each_recording(switching):
    longer = navgym.simulate("deck/paper", 0, duration=35.0)
    truth = DeckBatch.of([switching, longer]).truth
    assert truth.shape == (2, 700, 6)
    assert np.isnan(truth[0, 600:]).all()
    np.testing.assert_array_equal(truth[1, :, :3], longer.at_steps(longer.theta))
    assert DeckBatch.of([switching, replace(longer, theta=None)]).truth is None


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize("field", ["true_flexure", "impulse_variance", "disturbance_variance"])
def test_the_oracle_needs_the_truth(field, switching):
    with pytest.raises(
        ValueError, match=r"'oracle' needs the true flexure and noises.*use alignment"
    ):
        navgym.estimate("oracle", replace(switching, **{field: None}))


@pytest.mark.parametrize("name", sorted(set(CATALOGUE) - set(DECK_CATALOGUE)))
def test_filters_for_single_recordings_refuse_decks(name, switching):
    with pytest.raises(
        ValueError,
        match=f"{name}.* is for a Recording .AUV., and this is a DualIMURecording.*use one of alignment",
    ):
        navgym.estimate(name, switching)


@pytest.mark.parametrize("name", sorted(set(DECK_CATALOGUE) - set(CATALOGUE)))
def test_deck_filters_refuse_single_recordings(name):
    with pytest.raises(
        ValueError,
        match=f"{name}.* is for a DualIMURecording .Deck., and this is a Recording.*use one of kf",
    ):
        navgym.estimate(name, navgym.simulate("auv/nominal", 0))


def test_unknown_names_are_refused_with_the_nearest(switching):
    with pytest.raises(ValueError, match="alignment_mcc"):
        navgym.estimate("alignment_mc", switching)
    with pytest.raises(ValueError, match="kernel_width"):
        navgym.estimate("alignment_mcc", switching, {"kernel_with": 3.0})
    with pytest.raises(ValueError, match=r"kernel_width.*1\.5"):
        navgym.estimate("alignment_mcc", switching, {"kernel_width": 1.0})


@pytest.mark.parametrize("name", IDENTIFYING)
def test_identifying_filters_keep_the_believed_model_over_their_first_window(name, switching):
    """Nothing is identified before a window is full."""
    if not hasattr(importlib.import_module("navgym.identification"), "identify"):
        pytest.skip("navgym.identification is not complete")
    found = navgym.estimate(name, switching)
    assert found.flexures == ()
    if name != "idam_printed":
        given = DECK_CATALOGUE[name].space.defaults
        known = {c: given[c] for c in kernels.COLUMNS}
        np.testing.assert_array_equal(
            found.states, run_alignment([switching], **known)["states"][0]
        )
    assert np.isfinite(found.states).all()
    assert np.abs(found.theta).max() < 100.0 * ARCMIN
