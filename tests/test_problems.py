"""Every registered problem passes the same checks, found through the register."""

import dataclasses
import math
import pickle
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import navgym
from navgym.core.parameters import ParameterSpace
from navgym.envs.columns import INFORMATION, TERMINATED, TRUNCATED
from navgym.envs.live import CONTROLLED
from navgym.envs.rules import HandRule
from navgym.envs.settings import LaneSettings
from navgym.estimation import Estimate
from navgym.metrics.errors import run_rmse
from navgym.problem import (
    PROBLEMS,
    REGISTERED,
    Filter,
    Registered,
    Run,
    load,
    problem_of,
    problems,
    problems_with,
    register,
)
from navgym.readers import formats
from navgym.simulation import find_scenario, simulate_many

ARRAYS = ("states", "covariances", "innovations", "nis", "log_likelihood", "components")
WHOLE = (0.0, 1.0)
NAMES = list(PROBLEMS)
FILTERS = [(p.name, f) for p in problems() for f in p.filters]
SCENARIOS = [p.full_name(s) for p in problems() for s in p.scenarios.values()]
every = pytest.mark.parametrize("problem", list(problems()), ids=NAMES)


def longer(problem, times):
    """Overrides that make a recording so many times as long as can be."""
    return {name: times * value for name, value in problem.brief.items()}


def usual(problem, times=1, seeds=(0, 1, 2)):
    """Recordings of the scenario that studies are on."""
    return simulate_many(problem.study.scenario, seeds, **longer(problem, times))


def judged(problem):
    """A batch that is long enough for errors, with recordings of two lengths."""
    first = problem.stack(usual(problem, seeds=[0]))
    times = max(2, math.ceil(1.5 * problem.scoring.settling / (first.steps * first.step)))
    return problem.stack([*usual(problem, times, [0, 1]), *usual(problem, 2 * times, [2])])


# ---- finding one


class TestFinding:
    @every
    def test_everything_that_belongs_to_a_problem_leads_to_it(self, problem):
        recording = usual(problem)[0]
        scenario = find_scenario(problem.study.scenario)
        for what in (
            problem.name, problem.study.scenario, problem.environment.id, recording, scenario,
        ):  # fmt: skip
            assert problem_of(what) is problem
        for name in problem.filters:
            assert problem in problems_with(name)
            if len(problems_with(name)) == 1:
                assert problem_of(name) is problem

    @every
    def test_it_travels_to_a_process_that_has_not_met_it(self, problem):
        assert pickle.loads(pickle.dumps(problem)) is problem
        code = "import pickle, sys; print(pickle.load(sys.stdin.buffer).name)"
        told = subprocess.run(
            [sys.executable, "-c", code],
            input=pickle.dumps(problem),
            capture_output=True,
            check=True,
        )
        assert told.stdout.decode().strip() == problem.name

    @every
    def test_names_of_a_filter_that_several_have_say_whose(self, problem):
        for name, chosen in problem.filters.items():
            having = problems_with(name)
            assert navgym.parameter_space(name, problem) == chosen.space
            assert navgym.parameter_space(name, problem.name) == chosen.space
            if len(having) > 1:
                with pytest.raises(ValueError, match="several problems") as error:
                    problem_of(name)
                assert all(repr(p.name) in str(error.value) for p in having)
            assert chosen.summary in navgym.filters()[name]

    def test_oracle_is_everybodys(self):
        assert len(problems_with("oracle")) == len(PROBLEMS)
        with pytest.raises(ValueError, match="several problems"):
            navgym.parameter_space("oracle")

    @every
    def test_unknown_names_are_refused_with_the_nearest(self, problem):
        name = max(problem.filters, key=len)
        for ask in (problem.find, problem_of, navgym.parameter_space):
            with pytest.raises(ValueError, match=f"Did you mean '{name}'"):
                ask(f"{name}x")
        with pytest.raises(ValueError, match=f"Did you mean '{problem.study.scenario}'"):
            find_scenario(f"{problem.study.scenario}x")

    @every
    def test_a_filter_of_another_problem_is_refused_naming_it(self, problem):
        for other in problems():
            for name in set(other.filters) - set(problem.filters):
                with pytest.raises(ValueError, match=problem.recording.__name__):
                    problem.find(name)

    def test_what_belongs_to_nobody_is_refused_with_what_would(self):
        with pytest.raises(TypeError, match="must be one of Recording, DualIMURecording"):
            problem_of(np.zeros(3))

    def test_formats_environments_and_scenario_names_are_one_problems_each(self):
        assert len(formats()) == sum(len(p.readers) for p in problems()) + 1  # and npz, of all
        assert len({p.environment.id for p in problems()}) == len(PROBLEMS)
        assert len({p.scenario for p in problems()}) == len(PROBLEMS)
        assert len({p.recording for p in problems()}) == len(PROBLEMS)
        assert list(navgym.scenarios()) == SCENARIOS

    @every
    def test_the_register_is_right_about_it(self, problem):
        where = REGISTERED[problem.name]
        assert where.environment == problem.environment.id
        single, vector = load(where.single), load(where.vector)
        assert single.SETTINGS is vector.SETTINGS is problem.environment.settings
        assert single.ENGINE is vector.ENGINE
        register(problem.name, where)
        with pytest.raises(ValueError, match=f"there is a problem '{problem.name}' already"):
            register(problem.name, Registered("elsewhere:PROBLEM", "x", "elsewhere:XEnv"))


# ---- recordings


class TestRecordings:
    @pytest.mark.parametrize("name", SCENARIOS)
    def test_simulations_are_recordings_and_can_be_repeated(self, name):
        problem = problem_of(name)
        first, again = (navgym.simulate(name, 5, **problem.brief) for _ in range(2))
        assert isinstance(first, problem.recording)
        assert first.meta["scenario"] == name
        assert first.meta["seed"] == 5
        for field in dataclasses.fields(first):
            a, b = getattr(first, field.name), getattr(again, field.name)
            if isinstance(a, np.ndarray):
                np.testing.assert_array_equal(a, b)
                assert not a.flags.writeable

    @every
    def test_a_seed_makes_its_recording_in_any_company(self, problem):
        together, alone = usual(problem)[2], usual(problem, seeds=[2])[0]
        np.testing.assert_array_equal(*(problem.stack([r]).truth for r in (together, alone)))

    @every
    def test_a_seed_of_no_split_is_refused(self, problem):
        with pytest.raises(ValueError, match="seed"):
            navgym.simulate(problem.study.scenario, 10**12)

    @pytest.mark.parametrize("name", SCENARIOS)
    def test_scenarios_survive_a_pickle_and_refuse_unknown_fields(self, name):
        scenario = find_scenario(name)
        assert pickle.loads(pickle.dumps(scenario)) == scenario
        with pytest.raises(ValueError, match="unknown scenario field 'no_such_field'"):
            scenario.override(no_such_field=1)

    @pytest.mark.parametrize("name", SCENARIOS)
    def test_references_are_parameters_of_what_a_study_tunes(self, name):
        problem, reference = problem_of(name), find_scenario(name).reference
        for filter_name in problem.study.referred:
            space = problem.find(filter_name).space
            known = {n: v for n, v in reference.items() if n in space.names}
            assert len(space.array(known)) == 1
        assert problem.environment.settings.SPACE.array(reference).shape[0] == 1

    @every
    def test_readers_can_be_found(self, problem):
        for name in problem.readers:
            assert callable(load(formats()[name]))
            assert load(formats()[name]).__doc__


class TestBatches:
    @every
    def test_a_batch_says_how_long_its_recordings_are(self, problem):
        batch = problem.stack([*usual(problem, 1, [0]), *usual(problem, 2, [1])])
        assert len(batch) == len(batch.recordings) == len(batch.lengths) == 2
        assert batch.lengths.max() == batch.steps == 2 * batch.lengths[0]
        assert batch.decision_interval >= 1
        assert batch.truth.shape[:2] == (2, batch.steps)
        assert np.isnan(batch.truth[0, batch.lengths[0] :]).all()
        assert np.isfinite(batch.truth[1]).all()
        for i, length in enumerate(batch.lengths):
            time = batch.time_of(i)
            assert time.shape == batch.regimes()[i].shape == (length,)
            assert np.median(np.diff(time)) == pytest.approx(batch.step)
        assert batch.regimes()[0].max() < len(batch.recordings[0].meta["regimes"])

    @every
    def test_taking_some_is_stacking_some(self, problem):
        recordings = usual(problem)
        taken, stacked = (
            problem.stack(recordings).take([2, 0]),
            problem.stack([recordings[2], recordings[0]]),
        )
        assert taken.recordings == stacked.recordings
        np.testing.assert_array_equal(taken.lengths, stacked.lengths)
        np.testing.assert_array_equal(taken.truth, stacked.truth)

    @every
    def test_nothing_cannot_be_stacked(self, problem):
        with pytest.raises(ValueError, match="at least one"):
            problem.stack([])


# ---- filters


@pytest.mark.parametrize(("name", "filter_name"), FILTERS)
class TestEveryFilter:
    def test_a_run_has_the_declared_shapes_and_company_changes_no_bit(self, name, filter_name):
        problem = PROBLEMS[name]
        recordings = [*usual(problem, 1, [0]), *usual(problem, 2, [1])]
        batch = problem.stack(recordings)
        run = problem.run(filter_name, batch, everything=True)
        (N, T, n), m = run.states.shape, run.innovations.shape[2]
        assert (2, batch.steps) == (N, T)
        assert run.covariances.shape == (N, T, n, n)
        assert run.innovations.shape == (N, T, m)
        assert run.nis.shape == run.log_likelihood.shape == run.components.shape == (N, T)
        assert run.diverged.shape == (N,)
        assert all(len(each) == N for each in run.extras.values())
        for i, recording in enumerate(recordings):
            length = batch.lengths[i]
            alone = navgym.estimate(filter_name, recording)
            assert isinstance(alone, Estimate)
            for field in ARRAYS[:-1]:
                np.testing.assert_array_equal(
                    getattr(run, field)[i, :length], getattr(alone, field), err_msg=field
                )
            np.testing.assert_array_equal(alone.time, batch.time_of(i))
            heard = run.components[i, :length] > 0
            np.testing.assert_array_equal(heard, np.isfinite(run.nis[i, :length]))
        assert np.isnan(run.states[0, batch.lengths[0] :]).all()

    def test_states_alone_unless_asked_for_more_are_the_same_states(self, name, filter_name):
        problem = PROBLEMS[name]
        batch = problem.stack(usual(problem))
        short, full = (problem.run(filter_name, batch, **m) for m in ({}, {"everything": True}))
        np.testing.assert_array_equal(short.states, full.states)
        np.testing.assert_array_equal(short.diverged, full.diverged)
        assert all(getattr(short, field).shape[1] == 0 for field in ARRAYS[1:])

    def test_defaults_can_be_given_as_a_schedule_and_by_recording(self, name, filter_name):
        problem = PROBLEMS[name]
        batch, space = problem.stack(usual(problem)), problem.find(filter_name).space
        bare = problem.run(filter_name, batch).states
        rows = np.repeat(space.array(), batch.steps, axis=0)
        scheduled = problem.run(filter_name, batch, rows, decision_interval=1).states
        np.testing.assert_array_equal(scheduled, bare)
        each = problem.run(filter_name, batch, [space.defaults] * len(batch)).states
        np.testing.assert_array_equal(each, bare)


class TestPlainAndBound:
    @every
    def test_the_plain_filter_runs_and_does_not_diverge(self, problem):
        batch = problem.stack(usual(problem))
        run = problem.run(problem.plain_filter(batch), batch)
        assert isinstance(run, Run)
        assert not run.diverged.any()
        assert problem.plain_filter(batch) in problem.plain

    @every
    def test_the_bound_needs_the_truth_and_says_so(self, problem):
        assert problem.find(problem.bound).needs_scales
        recording = usual(problem)[0]
        known = {
            f.name: None
            for f in dataclasses.fields(recording)
            if f.default is None and f.name not in ("model", "lost")
        }
        blind = dataclasses.replace(recording, **known)
        assert problem.stack([blind]).truth is None
        assert problem.stack([blind]).regimes() == []
        with pytest.raises(ValueError, match=f"{problem.bound!r} needs the true"):
            navgym.estimate(problem.bound, blind)
        navgym.estimate(problem.plain[0], blind)

    @every
    def test_a_filter_of_ones_own_runs_with_its_own_space(self, problem):
        chosen = problem.find(problem.study.filter)
        name = problem.environment.steered[0]
        first = dataclasses.replace(chosen.space[name], default=chosen.space[name].high)
        space = ParameterSpace(tuple(first if p.name == name else p for p in chosen.space))
        own = dataclasses.replace(chosen, name="mine", space=space)
        assert problem.find(own) is own
        batch = problem.stack(usual(problem))
        found = problem.run(own, batch).states
        np.testing.assert_array_equal(
            found, problem.run(chosen.name, batch, {name: first.default}).states
        )
        assert not np.array_equal(found, problem.run(chosen.name, batch).states)


# ---- judging


class TestScoring:
    @every
    def test_quantities_are_the_roots_of_their_squared_errors(self, problem):
        scoring, batch = problem.scoring, judged(problem)
        states = problem.run(problem.plain_filter(batch), batch).states
        found = scoring.errors(batch, states, list(scoring.quantities), WHOLE)
        assert list(found) == list(scoring.quantities)
        first = np.arange(batch.steps) >= round(scoring.settling / batch.step)
        for name, each in found.items():
            squared = scoring.squared(batch, states, name, WHOLE)
            assert squared.shape == (len(batch), batch.steps)
            np.testing.assert_allclose(run_rmse(np.where(first, squared, np.nan)), each, rtol=1e-9)
        mask = scoring.scored(batch, WHOLE)
        assert mask.dtype == np.bool_
        assert (
            mask[:, first].sum()
            == mask.sum()
            == sum(length - np.count_nonzero(~first) for length in batch.lengths)
        )
        part = scoring.scored(batch, (0.5, 1.0))
        assert 0 < part.sum() <= mask.sum()
        assert not (part & ~mask).any()

    @every
    def test_a_failed_run_has_infinite_errors(self, problem):
        batch = judged(problem)
        states = problem.run(problem.plain_filter(batch), batch).states
        states[1, batch.lengths[1] // 2 :] = np.nan
        for name in problem.scoring.quantities:
            each = problem.scoring.errors(batch, states, [name], WHOLE)[name]
            assert np.isinf(each[1])
            assert np.isfinite(each[[0, 2]]).all()

    @every
    def test_errors_without_truth_are_refused(self, problem):
        batch = judged(problem)
        states = problem.run(problem.plain_filter(batch), batch).states
        blind = problem.stack(
            [dataclasses.replace(r, **dict.fromkeys(_truths(r))) for r in batch.recordings]
        )
        name = next(iter(problem.scoring.quantities))
        with pytest.raises(ValueError, match="truth"):
            problem.scoring.errors(blind, states, [name], WHOLE)

    @every
    def test_measures_begin_with_the_default_and_end_with_those_that_need_no_truth(self, problem):
        scoring = problem.scoring
        assert list(scoring.measures)[-2:] == ["likelihood", "consistency"]
        assert not any(m.needs_truth for m in list(scoring.measures.values())[-2:])
        default, *_ = scoring.measures.values()
        assert default.needs_truth
        assert next(iter(scoring.quantities)) in default.quantities
        for name, measure in scoring.measures.items():
            assert measure.name == name
            if measure.needs_truth:
                assert set(measure.quantities) <= set(scoring.quantities)

    @every
    def test_consistency_of_the_bound_is_judged_where_there_is_truth(self, problem):
        batch = judged(problem)
        run = problem.run(problem.bound, batch, everything=True)
        nees = problem.scoring.nees(batch, run)
        assert nees.shape == (len(batch), batch.steps)
        assert np.nanmean(nees) < 20.0


def _truths(recording):
    return ("truth",) if hasattr(recording, "truth") else ("theta", "theta_rate")


# ---- environments


@every
def test_gymnasiums_checker_finds_nothing_where_the_truth_is_not_known(problem):
    own = problem.environment
    recording = judged(problem).recordings[0]
    blind = dataclasses.replace(recording, **dict.fromkeys(_truths(recording)))
    env = gymnasium.make(own.id, recording=blind, reward=own.settings.BLIND).unwrapped
    check_env(env, skip_render_check=True)
    env.reset(seed=1)
    info = env.step(env.action_space.sample())[4]
    assert not np.isnan(list(info.values())).any()
    assert not any("rmse" in name for name in info)


@every
def test_a_wrong_argument_is_named_with_the_nearest(problem):
    with pytest.raises(TypeError, match=r"unknown argument 'sceanrio'. Did you mean 'scenario'"):
        gymnasium.make(problem.environment.id, sceanrio="x")


def rolled_out(problem, recordings):
    """Random decisions on every recording: the engine, rows per decision and lane, and states."""
    own = problem.environment
    settings = own.settings(
        problem.study.scenario, recordings=tuple(recordings), reward=own.settings.BLIND,
        action_parameters=own.steered,
    )  # fmt: skip
    engine = own.engine(settings, len(recordings), trail=True)
    obs = np.stack([engine.restart(i, recording=i) for i in range(engine.count)])
    start = engine.stations["k"].copy()
    rng, rows = np.random.default_rng(0), []
    while engine.stations["active"].any():
        out = engine.step(rng.uniform(-1.0, 1.0, (engine.count, len(engine.table))), obs)
        assert not (out[:, TERMINATED] > 0.0).any()
        rows.append(out[:, INFORMATION + len(engine.INFO_NAMES) :].copy())
        engine.stations["active"][out[:, TRUNCATED] > 0.0] = 0
    return engine, start, np.stack(rows, axis=1)


class TestEnvironment:
    @every
    def test_settings_are_of_this_problem(self, problem):
        settings = problem.environment.settings
        assert issubclass(settings, LaneSettings)
        assert settings.FILTER in problem.filters
        assert problem.filters[settings.FILTER].space == settings.SPACE
        assert (problem.recording, problem.scenario) == (settings.RECORDING, settings.SCENARIO)
        assert settings.BLIND in settings.REWARDS
        assert settings.__dataclass_fields__["reward"].default in settings.REWARDS
        assert problem_of(settings.__dataclass_fields__["scenario"].default) is problem
        assert set(problem.environment.steered) <= set(settings.SPACE.names)
        assert not any(settings.SPACE[n].at_start for n in problem.environment.steered)

    @every
    def test_a_roll_out_is_the_replayed_filter_and_a_live_lane_to_the_last_bit(self, problem):
        recordings = usual(problem, 4, [0, 1])
        engine, start, rows = rolled_out(problem, recordings)
        own, interval = problem.environment, engine.settings.decision_interval
        assert not start.any()
        replayed = own.replayed(vars(engine.settings))
        assert isinstance(replayed, Filter)
        batch = problem.stack(recordings)
        for i, recording in enumerate(recordings):
            run = problem.run(replayed, batch.take([i]), rows[i], interval, everything=True)
            n = run.states.shape[2]
            np.testing.assert_array_equal(engine.trail[i, :, :n], run.states[0])
            assert len(np.unique(rows[i], axis=0)) > 1
            found = self.live(problem, engine, recording, rows[i])
            np.testing.assert_array_equal([x for x, _, _ in found], run.states[0])
            np.testing.assert_array_equal([P for _, P, _ in found], run.covariances[0])
            np.testing.assert_array_equal([nis for _, _, nis in found], run.nis[0])

    @staticmethod
    def live(problem, engine, recording, rows):
        """The controlled filter's answers, sample by sample, with the same parameters."""
        step = float(recording.time[1] - recording.time[0])
        settings = engine.settings
        lane = problem.environment.live(settings, engine.reference, recording.model, step)
        assert lane.names == engine.observation_names
        found = []
        for sample, time, more in lane.samples(recording):
            lane.put(sample, None, time, **more)
            while lane.ready():
                if len(found) % settings.decision_interval == 0:
                    lane.choose(rows[len(found) // settings.decision_interval])
                assert lane.step(look=True) == 0
                found.append(lane.answer(CONTROLLED))
        assert np.isfinite(lane.observation).all()
        return found

    @every
    def test_errors_of_the_reference_are_told_beside_those_of_the_controlled_filter(self, problem):
        env = gymnasium.make(problem.environment.id, overrides=longer(problem, 2)).unwrapped
        names = env.engine.INFO_NAMES
        assert [n for n in names if f"reference_{n}" in names]
        assert {"regime", "reward_term"} <= set(names)

    @every
    def test_scenarios_that_the_environment_cannot_play_are_refused_with_a_reason(self, problem):
        for scenario in problem.scenarios.values():
            why = problem.environment.refuses(scenario)
            options = {"scenario": scenario, "overrides": problem.brief}
            if why is None:
                gymnasium.make(problem.environment.id, **options).reset(seed=0)
            else:
                assert len(why) > 10
                with pytest.raises(TypeError):
                    gymnasium.make(problem.environment.id, **options)

    @every
    def test_nothing_gained_scores_nothing_and_better_scores_more(self, problem):
        names = _info_pairs(problem)
        own = problem.environment
        settings = own.settings(problem.study.scenario)
        assert own.score(settings, dict.fromkeys(names, 0.0)) == 0.0
        assert own.score(settings, dict.fromkeys(names, 0.1)) > 0.0


def _info_pairs(problem):
    names = load(REGISTERED[problem.name].single).ENGINE.INFO_NAMES
    return [n for n in names if f"reference_{n}" in names]


# ---- training, contests, studies


class TestTraining:
    @every
    def test_drawn_conditions_are_scenarios_that_simulate(self, problem):
        training = problem.training
        scenario = find_scenario(problem.study.scenario, **problem.brief)
        rng = np.random.default_rng(0)
        seen = set()
        for _ in range(5):
            drawn = training.draw(scenario, training.ranges(), rng)
            assert isinstance(drawn, problem.scenario)
            assert isinstance(problem.simulate(drawn, [0])[0], problem.recording)
            seen.add(repr(drawn))
        assert len(seen) > 1
        a, b = (training.draw(scenario, training.ranges(), np.random.default_rng(1)) for _ in "ab")
        assert repr(a) == repr(b)

    @every
    def test_a_hand_rule_sets_what_it_says_for_every_lane(self, problem):
        rule = problem.contest.hand_rule()
        assert isinstance(rule, HandRule)
        settings = problem.environment.settings(
            problem.study.scenario, action_parameters=rule.steered, overrides=problem.brief
        )
        engine = problem.environment.engine(settings, 3)
        obs = np.stack([engine.restart(i) for i in range(3)])
        rule.begin(3, engine.reference)
        names = engine.observation_names
        for _ in range(2):
            chosen = rule.choose(lambda name, obs=obs: obs[:, names.index(name)].astype(float))
            assert set(chosen) == set(rule.steered)
            for name, values in chosen.items():
                assert name in engine.space.names
                assert np.shape(values) == (3,)
                assert np.isfinite(values).all()
            engine.step(np.zeros((3, len(engine.table))), obs)


class TestContest:
    @every
    def test_rivals_are_filters_the_plain_one_first(self, problem):
        contest = problem.contest
        labels = [r.label for r in contest.rivals]
        assert len(set(labels)) == len(labels)
        assert contest.plain == labels[0]
        assert contest.rivals[0].filter in problem.plain
        assert problem.bound in [r.filter for r in contest.rivals if r.bound]
        for rival in contest.rivals:
            problem.find(rival.filter).space.array(rival.parameters)
        assert contest.default in problem.filters
        assert {contest.yardstick, contest.highlight or contest.plain} <= set(labels)
        assert set(contest.everywhere) <= set(contest.quantities) <= set(problem.scoring.quantities)
        assert contest.quantities[0] == contest.everywhere[0]

    @every
    def test_shifts_and_short_runs_are_overrides_that_simulate(self, problem):
        scenario = find_scenario(problem.study.scenario)
        shifts = problem.contest.shifts(scenario)
        assert set(problem.contest.quick_shifts) <= set(shifts)
        for overrides in (problem.contest.quick, *shifts.values()):
            changed = scenario.override(**overrides)
            problem.simulate(changed.override(**problem.brief), [0])

    @every
    def test_other_scenarios_are_its_own(self, problem):
        for name in problem.contest.others:
            assert problem_of(name) is problem
            find_scenario(name)

    @every
    def test_tracks_fall_into_two_folds(self, problem):
        tracks = problem.tracks
        if tracks is None:
            pytest.skip("no real recordings to report on")
        one, other = tracks.folds
        assert one
        assert other
        assert not set(one) & set(other)
        assert all(0.0 <= rate <= 1.0 for rate in tracks.rates)
        made = tracks.recording(None, one[0], tracks.rates[0], 0)
        assert isinstance(made, problem.recording)


class TestStudy:
    @every
    def test_what_is_tuned_has_what_is_varied(self, problem):
        study = problem.study
        space = problem.find(study.filter).space
        assert set(study.free) <= set(space.names)
        assert problem_of(study.scenario) is problem
        assert set(study.referred) | set(study.beside) <= set(problem.filters)

    @every
    def test_tables_follow_the_regimes_that_recordings_have(self, problem):
        for name, table in problem.study.tables.items():
            recording = problem.simulate(problem.scenarios[name].override(**problem.brief), [0])[0]
            assert set(table) == set(recording.meta["regimes"])
            for row in table.values():
                problem.find(problem.study.steering.filter).space.array(row)

    @every
    def test_steering_varies_and_schedules_parameters_of_its_filter(self, problem):
        steering = problem.study.steering
        space = problem.find(steering.filter).space
        for names in (steering.free, steering.scheduled, steering.fixed):
            space.subset(names)
        for values in steering.first:
            space.array(values)
        assert set(steering.measures) <= set(problem.scoring.measures)
        batch = problem.stack(usual(problem))
        regimes = batch.recordings[0].meta["regimes"]
        for name, values in steering.guess(batch).items():
            assert name in steering.scheduled
            assert len(values) == len(regimes)


@every
def test_kernels_are_jobs_with_names(problem):
    jobs = [job for group in problem.kernels() for job in group]
    assert jobs
    assert all(isinstance(what, str) and callable(job) for what, job in jobs)
    assert len({what for what, _ in jobs}) == len(jobs)


def test_listing_problems_loads_no_compiler():
    code = "import sys, navgym; navgym.scenarios(); navgym.filters(); print('numba' in sys.modules)"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "False"
