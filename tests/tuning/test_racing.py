"""Candidates are given up when they are surely worse, and only then."""

import functools

import numpy as np
import optuna
import pytest

from navgym.metrics.measures import METRICS
from navgym.tuning.cases import Cases
from navgym.tuning.objectives import Evaluation, Objective, Pooled
from navgym.tuning.study import racing
from navgym.tuning.study.racing import LOOKS, Leader, race
from navgym.tuning.study.run import Search, search
from tests.tuning.goals import Bowls

COUNT = 40
FREE = ("prior_count", "forgetting", "process_noise_scale")


@pytest.fixture(scope="module")
def leader():
    losses = np.random.default_rng(1).lognormal(0.0, 0.8, COUNT)  # easy instances and hard ones
    return Leader(float(losses.mean()), losses)


class Given:
    """An `InstanceGoal` whose losses are written down."""

    metric, space, about = "mean", Bowls.space, {}

    def __init__(self, losses):
        self.losses = losses

    def __len__(self):
        return len(self.losses)

    def evaluate(self, values, which=None):
        return Evaluation(self.losses if which is None else self.losses[which])

    def __call__(self, values):
        return float(self.losses.mean())


def serial(calls):
    return [racing.evaluate(*call) for call in calls]


def raced(losses, leader, seed=0):
    """How many instances a candidate with these losses gets to see."""
    order = racing.order(len(losses), seed, 1, True)
    [(found, seen)] = race(Given(losses), [{}], [order], leader, serial)
    np.testing.assert_array_equal(seen, order[: len(seen)])
    np.testing.assert_array_equal(found.losses, losses[seen])
    return len(seen)


def test_a_candidate_equal_to_the_leader_sees_every_instance(leader):
    assert {raced(leader.losses.copy(), leader, seed) for seed in range(8)} == {COUNT}


def test_a_better_candidate_sees_every_instance(leader):
    rng = np.random.default_rng(2)
    for seed in range(20):
        losses = leader.losses * rng.lognormal(-0.3, 0.2, COUNT)
        assert raced(losses, leader, seed) == COUNT


def test_a_candidate_worse_on_every_instance_is_given_up_at_the_first_look(leader):
    first = round(LOOKS[0] * COUNT)
    for seed in range(30):  # orders in which the easy instances come first among them
        assert raced(1.01 * leader.losses, leader, seed) == first


def test_as_good_a_candidate_is_given_up_in_about_one_of_ten_races(leader):
    rng = np.random.default_rng(3)
    given_up = 0
    for seed in range(150):
        one, other = leader.losses * rng.lognormal(0.0, 0.5, (2, COUNT))
        given_up += raced(one, Leader(float(other.mean()), other), seed) < COUNT
    assert 0.05 < given_up / 150 < 0.15


def test_without_a_leader_everybody_sees_everything_in_the_order_given():
    order = racing.order(COUNT, 0, 3, False)
    np.testing.assert_array_equal(order, np.arange(COUNT))
    losses = np.arange(float(COUNT))
    [(found, seen)] = race(Given(losses), [{}], [order], None, serial)
    np.testing.assert_array_equal(found.losses, losses)
    np.testing.assert_array_equal(seen, order)


def test_trials_see_the_instances_in_orders_of_their_own():
    orders = [racing.order(COUNT, 0, trial, True) for trial in range(3)]
    for order in orders:
        np.testing.assert_array_equal(np.sort(order), np.arange(COUNT))
    assert len({tuple(order) for order in orders}) == 3


# ---- parts of an evaluation


@functools.cache
def objective(kind):
    if kind == "auv":
        return Objective("qivbf", FREE, Cases.simulated("auv/switch-D", "train", 12, steps=150))
    if kind == "blind":
        cases = Cases.simulated("auv/switch-D", "train", 12, steps=150)
        return Objective("qivbf", FREE, cases, measure="likelihood")
    if kind == "deck":
        cases = Cases.simulated("deck/switch-60", "train", 5, duration=75.0)
        return Objective("alignment_mcc", ("kernel_width",), cases)
    return Pooled([objective("auv"), objective("other")]) if kind == "pooled" else other()


def other():
    return Objective("qivbf", FREE, Cases.simulated("auv/heavy", "train", 7, steps=100))


@pytest.mark.parametrize("kind", ["auv", "blind", "deck", "pooled"])
def test_losses_in_parts_are_those_of_the_whole(kind):
    goal = objective(kind)
    values = goal.space.defaults
    whole = goal.evaluate(values)
    order = racing.order(len(goal), 0, 1, True)
    parts = np.array_split(order, 3)
    joined = Evaluation.joined([goal.evaluate(values, part) for part in parts])
    np.testing.assert_array_equal(joined.losses, whole.losses[order])
    assert joined.limits.keys() == whole.limits.keys()
    for name, each in joined.limits.items():
        np.testing.assert_array_equal(each, whole.limits[name][order])


# ---- what it saves


class Counting:
    """A goal that counts the runs of the filter."""

    def __init__(self, goal):
        self.goal, self.runs = goal, 0
        self.space, self.about, self.metric = goal.space, goal.about, goal.metric

    def __len__(self):
        return len(self.goal)

    def evaluate(self, values, which=None):
        self.runs += len(self) if which is None else len(which)
        return self.goal.evaluate(values, which)

    def __call__(self, values):
        return self.goal(values)


def test_pruning_finds_as_good_parameters_with_fewer_runs():
    cases = Cases.simulated("auv/switch-D", "train", COUNT, steps=150)
    goal = Objective("qivbf", FREE, cases, fixed={"vb_iterations": 2})
    for seed in range(3):
        best, runs = {}, {}
        for prune in (False, True):
            counting = Counting(goal)
            outcome = search(counting, Search(60, seed, batch=4, prune=prune), progress=False)
            best[prune], runs[prune] = goal(outcome.best.values), counting.runs
            assert outcome.best.result == best[prune]
        assert best[True] < 1.01 * best[False]
        assert runs[False] == 60 * COUNT
        assert runs[True] < 0.7 * runs[False]


def test_the_estimate_of_a_trial_given_up_never_beats_the_leader():
    outcome = search(Bowls(), Search(60, batch=4, prune=True), progress=False)
    given_up = [t for t in outcome.trials if t.given_up]
    assert given_up
    for trial in given_up:
        whole = [t.result for t in outcome.trials[: trial.number] if not t.given_up]
        assert trial.result >= min(whole)
    errors = [trial.result / Bowls()(trial.values) - 1 for trial in given_up]
    assert np.abs(np.median(errors)) < 0.05
    assert outcome.best.result == METRICS["mean"](Bowls().evaluate(outcome.best.values).losses)


def pruned_by_optuna(leader, seen, losses):
    """What Optuna's pruner says, in a study of the leader and the candidate."""

    def trial(values, result):
        states = optuna.trial.TrialState
        state = states.RUNNING if result is None else states.COMPLETE
        steps = dict(zip(seen.tolist(), values.tolist(), strict=True))
        return optuna.create_trial(state=state, value=result, intermediate_values=steps)

    study = optuna.create_study()
    study.add_trial(trial(leader.losses[seen], leader.value))
    pruner = optuna.pruners.WilcoxonPruner(p_threshold=racing.P_VALUE)
    return pruner.prune(study, trial(losses, None))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("count", [1, 2, 4, 5, 8, 16, 28, 50, 51, 80])
@pytest.mark.parametrize("round_to", [None, 1])  # rounded: ties, and changes of nothing
def test_the_judgement_is_that_of_optunas_pruner(count, round_to):
    rng = np.random.default_rng(count)
    said = []
    for shift in np.linspace(-0.2, 1.0, 20):
        losses = 1.0 + rng.random(100)
        leader = racing.Leader(float(losses.mean()), losses)
        seen = rng.permutation(100)[:count]
        candidate = losses[seen] + rng.standard_normal(count) * 0.8 + shift
        if round_to is not None:
            candidate = losses[seen] + np.round(candidate - losses[seen], round_to)
        said.append(racing.hopeless(leader, seen, candidate))
        assert said[-1] == pruned_by_optuna(leader, seen, candidate)
    assert any(said) == (count >= 5)  # fewer cannot be sure


def test_losses_that_are_not_finite_give_nobody_up():
    leader = racing.Leader(1.0, np.ones(20))
    losses = np.full(20, 3.0)
    assert racing.hopeless(leader, np.arange(20), losses + 0.01 * np.arange(20))
    losses[3] = np.inf
    assert not racing.hopeless(leader, np.arange(20), losses)
