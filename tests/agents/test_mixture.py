"""A mixture of fixed filters: what it weighs, when it does not, its files, and the same on live data."""

import json

import gymnasium
import numpy as np
import pytest

import navgym
from navgym.agents import LiveMixture, Mixture
from navgym.agents.mixture.experts import BANK, Expert, around, meanings
from navgym.agents.mixture.live import REASONS
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import mixture as kernels
from navgym.statespace.filters.modes import MODE_SETS, Modes, Structure
from tests.agents.mixtures import FEATURES, TUNED, mixture, recording
from tests.auv.test_live_bank import uneven


def one_sided(favourite, **fields):
    """A mixture of the usual experts that always favours one of them."""
    made = mixture(size=0.0, **fields)
    b = np.zeros(len(made.experts))
    b[favourite] = 60.0
    flat = np.zeros(FEATURES)
    return Mixture(made.experts, flat, flat + 1.0, flat - 20.0, flat + 20.0, made.W, b)


# ---- the experts


def test_experts_are_the_tuned_filter_copies_of_it_the_plain_filter_and_the_bank():
    q = [e.parameters.get("process_noise_scale") for e in around(TUNED)]
    assert q == [2.0, 1.0, 6.0, 20.0, 2.0, 5.0, None]
    assert around(TUNED)[4].parameters["prior_count"] == pytest.approx(0.6)
    assert [e.filter for e in around(TUNED)] == ["qivbf"] * 5 + ["kf", "bank"]


def test_a_copy_stays_inside_what_its_filter_admits():
    least = Expert("qivbf", {"prior_count": 0.1})
    assert around(least)[4].parameters["prior_count"] == 0.1


def test_noise_scales_of_sensors_are_shared():
    tuned = Expert("qivbf", {"process_noise_scale": 2.0, "velocity_noise_scale": 3.0})
    assert all(e.parameters["velocity_noise_scale"] == 3.0 for e in around(tuned))


@pytest.mark.parametrize("name", ["oracle", "ekf", "idam"])
def test_a_filter_that_cannot_be_an_expert_is_refused(name):
    with pytest.raises(ValueError, match="must be a filter of linear models that needs no truth"):
        Expert(name)


def test_what_the_bank_says_is_read_off_its_modes():
    structure = Structure.of(StateSpaceBatch.of([recording()]))
    modes = Modes.of(MODE_SETS[BANK], structure)
    table = meanings(structure)
    some = next(j for j in range(modes.count) if modes.scales[modes.node[j]][0] == 100.0)
    assert table[some, 0] == pytest.approx(np.log(10.0))
    assert set(np.unique(table[:, 2:])) == {0.0, 1.0}


# ---- what it answers


@pytest.mark.parametrize("favourite", range(7))
def test_all_weight_on_one_expert_is_that_expert(favourite):
    made, log = one_sided(favourite), recording()
    own = made.experts[favourite]
    alone = navgym.estimate(own.filter, log, dict(own.parameters))
    found = made.estimate(log, fallback=False)
    sure = found.extras["weights"][:, favourite] == 1.0
    assert sure.mean() > 0.9  # else it had foretold far worse than the best
    np.testing.assert_allclose(found.states[sure], alone.states[sure])
    np.testing.assert_allclose(found.covariances[sure], alone.covariances[sure], atol=1e-12)


def test_weights_are_a_softmax_of_the_features_of_rows_up_to_now():
    made, log = mixture(), recording()
    found = made.estimate(log, fallback=False)
    z = np.clip(found.extras["features"], -kernels.CLIP, kernels.CLIP) @ made.W
    w = np.exp(z - z.max(axis=1, keepdims=True))
    able = found.extras["weights"] > 0.0
    w = np.where(able, w, 0.0)
    np.testing.assert_allclose(found.extras["weights"], w / w.sum(axis=1, keepdims=True))


def test_what_comes_later_changes_nothing_before():
    made, log = mixture(), recording(steps=120)
    short = navgym.Recording(log.time[:60], log.measurements[:60], log.lost[:60], model=log.model)
    whole, part = made.estimate(log), made.estimate(short)
    assert np.array_equal(whole.states[:60], part.states)


def test_it_never_sees_the_truth():
    made, log = mixture(), recording()
    blind = navgym.Recording(log.time, log.measurements, log.lost, model=log.model)
    assert np.array_equal(made.estimate(log).states, made.estimate(blind).states)


def test_a_recording_is_the_same_in_any_batch():
    logs = [recording(i, steps=100 - 10 * i) for i in range(3)]
    together = mixture().run(StateSpaceBatch.of(logs))
    for i, log in enumerate(logs):
        own = mixture().estimate(log).states
        np.testing.assert_allclose(together.states[i, : len(log)], own, atol=1e-9)
        assert np.isnan(together.states[i, len(log) :]).all()


def test_innovations_are_what_the_weights_before_the_row_foretold():
    made, log = mixture(), recording()
    found = made.estimate(log, fallback=False)
    each = [navgym.estimate(e.filter, log, dict(e.parameters)).innovations for e in made.experts]
    before = found.extras["weights"][:-1]
    expected = np.einsum("tk,ktm->tm", before, np.stack(each)[:, 1:])
    np.testing.assert_allclose(found.innovations[1:], expected, atol=1e-12)


def test_features_are_those_of_the_environment_where_it_has_them():
    """The same exponential means that a policy of navgym/AUVDropout-v0 sees."""
    log = recording(steps=60)
    made = gymnasium.make(
        "navgym/AUVDropout-v0", recordings=[log], reference=dict(TUNED.parameters), decision_interval=1,
        action="residual", reward="likelihood",
    )  # fmt: skip
    names = made.unwrapped.engine.observation_names
    made.reset(seed=0)
    seen = []
    over = False
    while not over:
        observation, _, ended, cut, _ = made.step(np.zeros(made.action_space.shape))
        seen.append(observation)
        over = ended or cut
    features = mixture(experts=(TUNED,)).estimate(log).extras["features"]
    for name in ("log_nis.0.8", "log_nis.0.95", "correlation.0.95", "power_position.0.95", "power_velocity.0.8"):  # fmt: skip
        own = features[:, kernels.FEATURES.index(name)]
        theirs = np.stack(seen)[:, list(names).index(f"filter.{name}")]
        np.testing.assert_allclose(own, theirs, atol=2e-5)
    lost = np.stack(seen)[:, list(names).index("lost.0.95")]
    np.testing.assert_allclose(features[:, 7], lost, atol=1e-6)


# ---- what gets nothing, and when the reference answers


def test_an_expert_that_diverges_gets_no_weight():
    """Believing in hardly any motion, it is left behind by a vehicle that turns."""
    stuck = Expert("kf", {"process_noise_scale": 1e-6, "measurement_noise_scale": 1e4})
    made = mixture(experts=(TUNED, stuck), size=0.0)
    log = navgym.simulate("auv/turn", seed=1, steps=300)
    found = made.estimate(log, fallback=False)
    weight = found.extras["weights"][:, 1]
    assert weight[0] == 0.5
    assert weight[-50:].max() == 0.0
    assert found.states[-1] == pytest.approx(navgym.estimate("qivbf", log, dict(TUNED.parameters)).states[-1])  # fmt: skip


def test_where_the_reference_itself_is_lost_the_others_answer():
    stuck = Expert("kf", {"process_noise_scale": 1e-6, "measurement_noise_scale": 1e4})
    made = mixture(experts=(stuck, TUNED), size=0.0)
    log = navgym.simulate("auv/turn", seed=1, steps=300)
    assert made.estimate(log).extras["weights"][-1, 1] == 1.0


def test_while_it_foretells_worse_than_the_reference_that_answers_alone():
    bad = Expert("kf", {"process_noise_scale": 1000.0})
    flat = np.zeros(FEATURES)
    made = Mixture(
        (TUNED, bad), flat, flat + 1.0, flat - 20.0, flat + 20.0, np.zeros((FEATURES, 2)),
        np.array([0.0, 30.0]),
    )  # fmt: skip
    found = made.estimate(recording(steps=400))
    last = found.extras["reasons"][-100:]
    assert (last == kernels.BEHIND_REFERENCE).mean() > 0.5
    assert (found.extras["weights"][-100:][last > 0, 0] == 1.0).all()


def test_what_was_not_seen_in_training_makes_the_reference_answer():
    made = mixture()
    flat = np.zeros(FEATURES)
    narrow = Mixture(made.experts, flat, flat + 1.0, flat - 1.0, flat - 0.99, made.W, made.b)
    assert (narrow.estimate(recording()).extras["reasons"] == kernels.UNSEEN).any()


# ---- live


def test_live_it_answers_as_on_the_whole_recording():
    made, log = mixture(), recording(loss=0.4)
    whole = made.estimate(log)
    live = list(LiveMixture(made, log.model).follow(log))
    np.testing.assert_allclose(np.stack([e.state for e in live]), whole.states, rtol=1e-9)
    np.testing.assert_allclose(np.stack([e.covariance for e in live]), whole.covariances, rtol=1e-6, atol=1e-9)  # fmt: skip
    np.testing.assert_allclose(
        np.stack([e.weights for e in live]), whole.extras["weights"], atol=1e-9
    )
    assert [e.fallback for e in live] == [REASONS.get(int(r)) for r in whole.extras["reasons"]]


@pytest.mark.parametrize("apart", [False, True])
def test_live_at_uneven_times_and_where_components_are_lost_apart(apart):
    log, model = uneven(apart=apart)
    made = mixture(experts=(TUNED, Expert("kf", {"process_noise_scale": 5.0}), Expert(BANK)))
    whole = made.estimate(log)
    live = LiveMixture(made, model)
    found = [(e.state, e.weights, live.restarts) for e in live.follow(log)]
    kept = [
        k for k, (_, _, restarts) in enumerate(found) if not restarts
    ]  # no expert lost the track
    assert len(kept) > 30
    states, weights = (np.stack([found[k][i] for k in kept]) for i in (0, 1))
    np.testing.assert_allclose(states, whole.states[kept], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(weights, whole.extras["weights"][kept], atol=1e-7)


def test_live_noise_scales_of_sensors_act():
    tuned = Expert("qivbf", {"process_noise_scale": 2.0, "velocity_noise_scale": 9.0})
    made, log = mixture(experts=around(tuned)), recording()
    live = list(LiveMixture(made, log.model).follow(log))
    np.testing.assert_allclose(
        np.stack([e.state for e in live]), made.estimate(log).states, rtol=1e-9
    )


def test_live_a_jump_of_the_vehicle_is_followed_and_a_reset_begins_anew():
    made, log = mixture(), recording(loss=0.0, steps=200)
    live = LiveMixture(made, log.model)
    first = [e.state for e in live.follow(log)]
    moved = log.measurements[-1] + np.array([1000.0, 0.0, 0.0, 0.0])
    for _ in range(40):
        found = live.step(moved + np.random.default_rng(0).normal(size=4) * 0.01)
    assert abs(found.state[0] - moved[0]) < 60.0
    live.reset()
    assert np.array_equal([e.state for e in live.follow(log)], first)


@pytest.mark.parametrize(
    ("sample", "word"), [(np.zeros(3), "shape"), (np.full(4, np.inf), "finite")]
)
def test_live_a_sample_that_cannot_be_changes_nothing(sample, word):
    made, log = mixture(), recording(steps=40)
    live, other = LiveMixture(made, log.model), LiveMixture(made, log.model)
    with pytest.raises(ValueError, match=word):
        live.step(sample)
    assert np.array_equal(
        live.step(log.measurements[0]).state, other.step(log.measurements[0]).state
    )


# ---- files


def test_what_was_saved_is_read_back(tmp_path):
    made = mixture()
    path = made.save(tmp_path / "mine")
    back = Mixture.load(path)
    assert back.experts == made.experts
    assert all(
        np.array_equal(getattr(back, n), getattr(made, n)) for n in ("W", "b", "shift", "gain")
    )
    assert back.training == {"by": "hand"}


def test_a_file_of_another_kind_an_edited_one_and_half_of_one_are_refused(tmp_path):
    made = mixture()
    path = made.save(tmp_path / "mine")
    with pytest.raises(ValueError, match="describes a navgym mixture, not a navgym policy"):
        navgym.agents.Policy.load(path)
    beside = tmp_path / "mine.json"
    whole = json.loads(beside.read_text())
    beside.write_text(json.dumps(whole | {"training": {"by": "magic"}}))
    with pytest.raises(ValueError, match="does not belong to"):
        Mixture.load(path)
    beside.unlink()
    with pytest.raises(FileNotFoundError, match=r"mine\.json is missing"):
        Mixture.load(path)


def test_weights_that_do_not_fit_or_are_no_numbers_are_refused():
    made, flat = mixture(), np.zeros(FEATURES)
    with pytest.raises(ValueError, match="W must have shape"):
        Mixture(made.experts, flat, flat, flat, flat, np.zeros((2, 2)), made.b)
    with pytest.raises(ValueError, match="b must be finite"):
        Mixture(made.experts, flat, flat, flat, flat, made.W, made.b * np.nan)


def test_a_model_that_is_not_linear_is_refused():
    log = navgym.simulate("auv/coordinated-turn", seed=0, steps=30)
    with pytest.raises(ValueError, match="model is nonlinear"):
        mixture().estimate(log)
