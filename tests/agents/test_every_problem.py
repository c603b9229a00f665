"""Agents of every registered problem train, run live and are judged, by the same code."""

import dataclasses
import json
import math

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("tyro")
pytest.importorskip("tomli_w")

from navgym.agents.evaluation import report as evaluation_report
from navgym.agents.evaluation import tables as evaluation_tables
from navgym.agents.evaluation.contest import BEST_FIXED, DEFAULT, FALLBACK, OWN, RANDOM, Extent
from navgym.agents.evaluation.rollout import Learnt, replay_filter, roll_out
from navgym.agents.evaluation.verdicts import evaluate, leagues
from navgym.agents.live.streaming import SelfTuningFilter
from navgym.agents.policies.policy import Policy
from navgym.agents.training.configuration import Configuration, markdown, presets
from navgym.agents.training.randomisation import drawn
from navgym.agents.training.run import train
from navgym.problem import PROBLEMS, problems
from navgym.simulation import find_scenario, simulate_many
from navgym.tuning.report import page as report
from tests.agents import hand_made
from tests.agents.small import RECIPE, quiet

every = pytest.mark.parametrize("problem", list(problems()), ids=list(PROBLEMS))


def short(problem):
    """Overrides for recordings of some decisions, a little longer than what counts for no error."""
    batch = problem.stack(simulate_many(problem.study.scenario, [0], **problem.brief))
    times = max(10, math.ceil(1.3 * problem.scoring.settling / (batch.steps * batch.step)))
    return {name: times * value for name, value in problem.brief.items()}


def small(problem, folder, **changes):
    """The problem's first training, as a few thousand decisions."""
    config = presets()[next(iter(problem.training.presets))][1]
    return dataclasses.replace(
        config, overrides=short(problem), pool=4, validation=3, lanes=8, decisions=2000,
        interval=1000, recipe=RECIPE, out=folder, **changes,
    )  # fmt: skip


def idle(problem, **settings):
    """A policy that leaves the best fixed parameters in force."""
    return hand_made.policy(problem.environment.id, problem.study.scenario, **settings)


# ---- training


@every
def test_a_training_under_drawn_conditions_gives_a_policy_that_loads(problem, tmp_path):
    made = train(small(problem, tmp_path, randomise=True), report=quiet)
    assert math.isfinite(made.best.score)
    assert made.history[-1].decisions >= 2000
    assert "randomised" in made.best.scores["gains"]
    loaded = Policy.load(tmp_path / "policy")
    assert loaded.manifest.environment == problem.environment.id
    assert loaded.manifest.filter == problem.environment.settings.FILTER
    assert Configuration.from_toml(tmp_path / "config.toml") == small(
        problem, tmp_path, randomise=True
    )


@every
def test_conditions_depend_on_the_seed_alone_and_are_the_problems(problem):
    scenario, ranges = find_scenario(problem.study.scenario), problem.training.ranges()
    found = [drawn(scenario, ranges, seed) for seed in range(20)]
    assert found[7] == drawn(scenario, ranges, 7)
    assert any(each != scenario for each in found)
    assert all(isinstance(each, problem.scenario) for each in found)
    for other in problems():
        if other is not problem:
            with pytest.raises(TypeError, match="are no conditions of"):
                drawn(scenario, other.training.ranges(), 0)


# ---- ranges in configurations


def own(problem, **changes):
    return Configuration(
        environment=problem.environment.id, scenarios=(problem.study.scenario,), **changes
    )


def changed(problem):
    """A field of the problem's ranges, its usual value, and another one."""
    field = next(f for f in dataclasses.fields(problem.training.ranges) if f.name != "chance")
    usual = getattr(problem.training.ranges(), field.name)
    return field.name, [float(usual[0]), float(np.mean(usual))]


@every
def test_ranges_are_checked_by_the_problem_and_kept_where_they_differ(problem):
    name, value = changed(problem)
    config = own(problem, ranges={name: value})
    assert list(getattr(config.conditions, name)) == value
    assert Configuration.from_dict(config.as_dict()) == config
    whole = dataclasses.asdict(problem.training.ranges())
    assert own(problem, ranges=whole) == own(problem)
    with pytest.raises(ValueError, match=r"ranges: unknown field 'foo'"):
        own(problem, ranges={"foo": 1.0})
    assert f"| `ranges.{name}` |" in markdown()


@every
def test_a_file_of_the_time_when_each_problem_had_ranges_of_its_own_still_reads(problem):
    name, value = changed(problem)
    tables = {
        f"{p.name}_ranges": json.loads(json.dumps(dataclasses.asdict(p.training.ranges())))
        for p in problems()
    }
    values = own(problem).as_dict()
    del values["ranges"]
    assert Configuration.from_dict(values | tables) == own(problem)
    tables[f"{problem.name}_ranges"][name] = value
    assert Configuration.from_dict(values | tables) == own(problem, ranges={name: value})


# ---- live


@every
def test_a_live_filter_estimates_what_the_roll_outs_schedule_does(problem):
    weights = {(0, "bias"): 0.4}
    policy = hand_made.policy(problem.environment.id, problem.study.scenario, weights)
    recordings = simulate_many(problem.study.scenario, [3], **short(problem))
    chooser = Learnt(policy)
    rolled = roll_out(chooser, recordings)
    run = problem.run(
        replay_filter(chooser), problem.stack(recordings), rolled.schedules, rolled.interval
    )
    step = float(recordings[0].time[1] - recordings[0].time[0])
    live = SelfTuningFilter(
        policy.manifest.filter, policy, recordings[0].model, interval=step, rule=None
    )
    states = np.stack([each.state for each in live.follow(recordings[0])])
    np.testing.assert_array_equal(states, run.states[0])
    assert live.decisions > 0


# ---- contests


@pytest.fixture(scope="module", params=list(problems()), ids=list(PROBLEMS))
def bench(request):
    """A quick evaluation of an idle policy, with its fallback."""
    policy = idle(request.param, overrides=short(request.param))
    (found,) = evaluate(leagues({"p": policy}, Extent(quick=True, runs=3)), progress=False)
    return found


def test_everybody_runs_on_every_kind_of_recordings(bench):
    contest = bench.league.problem.contest
    (result,) = bench.own()
    ladder = list(result.main.errors)
    assert ladder[0] == contest.plain
    assert {r.label for r in contest.rivals if not r.real_only} <= set(ladder)
    assert {RANDOM, DEFAULT, BEST_FIXED, "p"} <= set(ladder)
    bounds = [r.label for r in contest.rivals if r.bound]
    assert ladder[-len(bounds) :] == bounds
    assert all(result.main[seer.label].bound for seer in contest.seers)
    assert list(result.comparisons) == list(contest.quantities)
    assert result.main[contest.plain].score == 0.0
    shifts = {r.condition.name for r in bench.shifts(result.condition.name)}
    assert set(contest.quick_shifts) <= shifts
    assert len(bench.rest()) == 1
    assert any(FALLBACK.format("p") in r.main for r in bench.results)


def test_a_policy_that_does_nothing_is_the_best_fixed_parameters(bench):
    (result,) = bench.own()
    errors = result.main.errors
    # a residual of nothing gives the parameters back but for rounding
    np.testing.assert_allclose(errors["p"], errors[BEST_FIXED], rtol=1e-9)
    (verdict,) = bench.verdicts
    assert not verdict.better


def test_an_evaluation_is_told_in_the_problems_words(bench, tmp_path):
    problem = bench.league.problem
    (result,) = bench.own()
    assert result.condition.kind == OWN
    text = evaluation_tables.as_text([bench])
    assert f"{problem.title}, {result.condition.name}" in text
    assert problem.scoring.measures[problem.contest.quantities[0]].label in text
    results = evaluation_tables.as_json([bench], {})
    json.dumps(results, allow_nan=False)
    assert set(results) == {"provenance", problem.environment.id}
    page = report.write_page(tmp_path / "r.html", evaluation_report.page([bench], {})).read_text()
    for rival in problem.contest.rivals:
        assert (f">{rival.about}<" in page) != rival.real_only
    own_words = {r.about for r in problem.contest.rivals}
    words = {r.about for p in problems() for r in p.contest.rivals} - own_words
    assert not [each for each in words if f">{each}<" in page]


@every
def test_a_scenario_of_another_problem_is_refused(problem):
    policy = idle(problem)
    for other in problems():
        if other is not problem:
            with pytest.raises(ValueError, match="cannot serve"):
                leagues({"p": policy}, Extent(), scenarios=(other.study.scenario,))
