"""Studies' goals on recordings: closed forms, limits, parts of a whole, pools, cost."""

import pickle

import numpy as np
import pytest
from scipy import stats

import navgym
from navgym.problem import PROBLEMS
from navgym.tuning.cases import Cases
from navgym.tuning.objectives import Costed, Objective, Pooled, find_measure, narrowed

BRIEF = {"duration": 90.0}


@pytest.fixture(scope="module")
def cases():
    return Cases.simulated("auv/switch-D", "train", 6, steps=120, loss=0.2)


@pytest.fixture(scope="module")
def deck():
    return Cases.simulated("deck/glitch", "train", 3, **BRIEF)


def test_the_likelihood_of_a_filter_is_that_of_its_gaussian_predictions(cases):
    found = cases.judge("kf", None, ("nll", "nis"))
    for i, recording in enumerate(cases.recordings):
        e = navgym.estimate("kf", recording)
        model, log_density, squares, count = recording.model, 0.0, 0.0, 0
        P, x = model.P0, model.x0
        for k in range(len(recording)):
            P, x = model.F @ P @ model.F.T + model.Q, model.F @ x
            if not recording.lost[k].any():
                S = model.H @ P @ model.H.T + model.R
                law = stats.multivariate_normal(model.H @ x, S)
                y = recording.measurements[k]
                log_density += law.logpdf(y)
                squares += (y - model.H @ x) @ np.linalg.solve(S, y - model.H @ x)
                count += len(y)
            x, P = e.states[k], e.covariances[k]
        assert found.quantities["nll"][i] == pytest.approx(-log_density / count, rel=1e-9)
        assert found.quantities["nis"][i] == pytest.approx(abs(np.log(squares / count)), rel=1e-9)


def test_a_matched_filter_is_more_likely_and_more_consistent_than_a_wrong_one():
    cases = Cases.simulated("auv/nominal", "train", 10)
    for measure in ("likelihood", "consistency"):
        goal = Objective("kf", ["measurement_noise_scale"], cases, measure=measure)
        right = goal({"measurement_noise_scale": 1.0})
        for wrong in (0.2, 5.0):
            assert right < goal({"measurement_noise_scale": wrong})
    # ln of a mean of k chi-squares per degree of freedom is about normal with deviation √(2/k)
    components = (~cases.batch.lost).sum() / len(cases)
    deviation = np.sqrt(2.0 / components)
    spread = deviation * np.sqrt((1.0 - 2.0 / np.pi) / len(cases))
    assert right == pytest.approx(deviation * np.sqrt(2.0 / np.pi), abs=4.0 * spread)


def test_the_one_step_error_of_the_fixes_is_that_of_the_predictions_in_metres(cases):
    """By hand: |y - H x⁻| of the position rows, each cut at two deviations of the plain filter's."""
    found = cases.judge("qivbf", None, ("fixes",)).quantities["fixes"]
    for i, recording in enumerate(cases.recordings):
        model, y, total = recording.model, recording.measurements, 0.0
        for row in (0, 2):
            e, plain = (
                y[:, row] - _foretold(model, navgym.estimate(name, recording))[:, row]
                for name in ("qivbf", "kf")
            )
            heard = ~np.isnan(e)
            most = 2.0 * 1.4826 * np.quantile(np.abs(plain[heard]), 0.5, method="lower")
            total += np.mean(np.minimum(np.abs(e[heard]), most) ** 2)
        assert found[i] == pytest.approx(np.sqrt(total), rel=1e-9)


def _foretold(model, estimate):
    before = np.concatenate([model.x0[None], estimate.states[:-1]])
    return before @ model.F.T @ model.H.T


@pytest.mark.parametrize(
    ("reads", "name"), [((0, 1, 2, 3), "fixes"), ((0, 2), "fixes"), ((1, 3), "velocities")]
)
def test_what_is_foretold_is_what_is_measured(reads, name):
    model = navgym.LinearModel(H=np.eye(4)[list(reads)], R=np.eye(len(reads)))
    y = np.random.default_rng(0).normal(size=(50, len(reads))).cumsum(axis=0)
    cases = Cases.of([navgym.Recording(np.arange(50.0), y, model=model)])
    assert cases.foretold.name == name
    goal = Objective("kf", ["process_noise_scale"], cases, measure=name)
    assert 0.0 < goal({"process_noise_scale": 3.0}) < np.inf
    if name == "velocities":
        with pytest.raises(ValueError, match=r"fixes.*hold none: use 'velocities'"):
            Objective("kf", ["process_noise_scale"], cases, measure="fixes")


def test_positions_that_are_never_received_are_not_foretold():
    y = np.random.default_rng(0).normal(size=(50, 4))
    y[:, [0, 2]] = np.nan
    assert Cases.of([navgym.Recording(np.arange(50.0), y)]).foretold.name == "velocities"


def test_ranges_and_bearings_are_judged_by_the_spread_of_the_plain_filter():
    cases = Cases.simulated("auv/coordinated-turn", "train", 2, steps=100)
    assert cases.foretold.name == "one_step"
    found = cases.judge("ekf", None, ("one_step",)).quantities["one_step"]
    np.testing.assert_allclose(
        found, 1.0, rtol=0.2
    )  # normal innovations are as wide as their spread


def test_one_step_errors_are_cut_alike_in_parts_of_a_log_and_for_every_filter(cases):
    part = Cases.of(cases.recordings, span=(0.5, 1.0))
    np.testing.assert_array_equal(part.spreads, cases.spreads)
    np.testing.assert_array_equal(cases.take([2, 0]).spreads, cases.spreads[[2, 0]])


def test_a_part_that_holds_nothing_to_judge_by_is_refused_in_words():
    y = np.random.default_rng(0).normal(size=(40, 4))
    y[20:] = np.nan
    recording = navgym.Recording(np.arange(40.0), y)
    cases = Cases.of([recording], {"scored": [0.5, 1.0]}, (0.5, 1.0))
    with pytest.raises(ValueError, match=r"between 50% and 100% .*no one-step error of the pos"):
        Objective("kf", ["process_noise_scale"], cases, measure="fixes")


def test_consistency_is_one_for_a_filter_whose_model_is_right():
    cases = Cases.simulated("auv/nominal", "train", 20, steps=200, loss=0.3)
    nis, nees = cases.consistency("kf", None)
    assert nis.consistent
    assert nees.consistent
    assert nis.samples < nees.samples == 20 * 200  # a third of the samples was lost
    doubted, _ = cases.consistency(
        "kf", {"process_noise_scale": 4.0, "measurement_noise_scale": 4.0}
    )
    assert doubted.mean == pytest.approx(nis.mean / 4.0, rel=0.02)  # P0 stays
    assert not doubted.consistent


def test_the_likelihood_needs_no_truth(cases):
    blind = [
        navgym.Recording(r.time, r.measurements, r.lost, model=r.model) for r in cases.recordings
    ]
    with_truth = Objective("qivbf", ["forgetting"], cases, measure="likelihood")
    without = Objective("qivbf", ["forgetting"], Cases.of(blind), measure="likelihood")
    assert with_truth({"forgetting": 0.9}) == without({"forgetting": 0.9})


@pytest.mark.parametrize("measure", PROBLEMS["auv"].scoring.measures)
def test_parts_of_the_instances_are_those_of_the_whole(cases, measure):
    goal = Objective("qivbf", ["forgetting"], cases, measure=measure)
    whole = goal.evaluate({"forgetting": 0.8}).losses
    which = np.array([4, 0, 3])
    np.testing.assert_array_equal(goal.evaluate({"forgetting": 0.8}, which).losses, whole[which])


@pytest.mark.parametrize("measure", PROBLEMS["deck"].scoring.measures)
def test_parts_of_a_deck_are_those_of_the_whole(deck, measure):
    goal = Objective("alignment_mcc", ["kernel_width"], deck, measure=measure)
    whole = goal.evaluate({"kernel_width": 4.0})
    part = goal.evaluate({"kernel_width": 4.0}, np.array([2, 0]))
    np.testing.assert_array_equal(part.losses, whole.losses[[2, 0]])
    for name, each in whole.limits.items():
        np.testing.assert_array_equal(part.limits[name], each[[2, 0]])
    assert np.isfinite(whole.losses).all()


def test_the_plain_deck_filter_has_a_composite_of_one(deck):
    plain = Objective("alignment", ["velocity_noise"], deck)
    assert plain(plain.space.defaults) == pytest.approx(1.0, rel=1e-12)


def test_theta_may_not_grow_beyond_its_limit(deck):
    goal = Objective("alignment_mcc", ["velocity_noise", "kernel_width"], deck)
    assert goal.evaluate(goal.space.defaults).constraints["theta"] == pytest.approx(1 / 1.02 - 1)
    found = goal.evaluate({"velocity_noise": 0.01, "kernel_width": 10.0})
    theta, default = (
        deck.judge("alignment_mcc", v, ("theta",)).quantities["theta"].mean()
        for v in ({"velocity_noise": 0.01}, None)
    )
    assert found.constraints["theta"] == pytest.approx(theta / (1.02 * default) - 1.0, rel=1e-9)


def test_a_span_scores_only_its_samples(cases):
    recordings = cases.recordings
    first = Cases.of(recordings, span=(0.0, 0.5))
    cut = [
        navgym.Recording(r.time[:60], r.measurements[:60], r.lost[:60], r.truth[:60], model=r.model)
        for r in recordings
    ]
    for name in ("rmse", "nll", "nis"):
        short = Cases.of(cut).judge("kf", None, (name,)).quantities[name]
        np.testing.assert_allclose(
            first.judge("kf", None, (name,)).quantities[name], short, rtol=1e-12
        )
    halves = [Cases.of(recordings, span=s).errors("kf")[0] ** 2 for s in ((0, 0.5), (0.5, 1.0))]
    np.testing.assert_allclose(np.mean(halves, axis=0), cases.errors("kf")[0] ** 2, rtol=1e-12)


@pytest.mark.parametrize("which", ["cases", "deck"])
def test_simulated_cases_travel_as_their_recipe(which, request):
    chosen = request.getfixturevalue(which)
    packed = pickle.dumps(chosen)
    assert len(packed) < 1000
    again = pickle.loads(packed)
    one, other = (c.plain_errors() for c in (chosen, again))
    np.testing.assert_array_equal(one, other)
    assert pickle.loads(packed) is again  # a worker makes them once
    assert len(pickle.dumps(chosen.take([0]))) > 1000  # a part has no recipe of its own


def test_a_pool_weighs_scenarios_by_the_plain_filter():
    sets = [Cases.simulated(f"auv/{n}", "train", 4, steps=100) for n in ("heavy", "mismatch")]
    members = [Objective("qivbf", ["process_noise_scale"], c) for c in sets]
    pool, values = Pooled(members), {"process_noise_scale": 5.0}
    ratios = [m(values) / c.plain_errors().mean() for m, c in zip(members, sets, strict=True)]
    assert pool(values) == pytest.approx(np.mean(ratios), rel=1e-12)
    which = np.array([6, 1])
    np.testing.assert_array_equal(
        pool.evaluate(values, which).losses, pool.evaluate(values).losses[which]
    )


def test_more_sweeps_cost_more_time(cases):
    goal = Costed(
        Objective("qivbf", ["vb_iterations"], Cases.simulated("auv/nominal", "train", 20))
    )
    few, many = (goal.evaluate({"vb_iterations": n}) for n in (1, 20))
    assert few.microseconds < many.microseconds
    assert goal({"vb_iterations": 5}) == goal.goal({"vb_iterations": 5})


def test_a_narrowed_range_stays_inside():
    p = navgym.parameter_space("qivbf")["process_noise_scale"]
    small = narrowed(p, 1.0, 10.0)
    assert (small.low, small.high, small.default) == (1.0, 10.0, 10.0)
    wide = narrowed(p, 1e-4, 1e4)  # a scale may go beyond what searches walk by themselves
    assert (wide.low, wide.high, wide.default) == (1e-4, 1e4, p.default)
    for ends in ((10.0, 1.0), (5.0, 5.0), (0.0, 10.0), (1.0, 1e9)):
        with pytest.raises(ValueError, match="range of process_noise_scale must be low < high"):
            narrowed(p, *ends)


def test_a_parameter_is_free_once(cases):
    with pytest.raises(ValueError, match="each parameter once, got 'forgetting' twice"):
        Objective("qivbf", ["forgetting", "vb_iterations", "forgetting"], cases)


def test_a_measure_of_another_problem_is_unknown():
    with pytest.raises(ValueError, match="unknown measure 'composite'"):
        find_measure(PROBLEMS["auv"], "composite")
    assert find_measure(PROBLEMS["deck"], None).name == "composite"
