"""A third problem goes all the way: simulated, estimated, tuned, trained, evaluated, streamed."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

import navgym
from navgym.problem import PROBLEMS, REGISTERED, adopt, problem_of
from navgym.tuned import read_tuned
from tests.toy.world import WalkModel, WalkRecording

ID = "navgym/ToyWalk-v0"
NOISE = "process_noise_scale"


def rmse(estimate, recording):
    return float(np.sqrt(np.mean((estimate.states[:, 0] - recording.truth) ** 2)))


def kalman(recording, q):
    """The filter as the book has it: x, P after each sample."""
    m = recording.model
    x, P, found = m.x0, m.P0, []
    for y in recording.measurements:
        P += q * m.Q
        if np.isfinite(y):
            K = P / (P + m.R)
            x, P = x + K * (y - x), (1.0 - K) * P
        found.append((x, P))
    return np.array(found)


# ---- estimates


def test_the_filter_is_the_textbooks():
    recording = navgym.simulate("toy/switch", 3)
    found = navgym.estimate("walk_kf", recording, {NOISE: 7.0})
    wanted = kalman(recording, 7.0)
    np.testing.assert_allclose(found.states[:, 0], wanted[:, 0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.covariances[:, 0, 0], wanted[:, 1], rtol=1e-12)
    np.testing.assert_array_equal(np.isnan(found.nis), np.isnan(recording.measurements))


def test_the_right_noise_beats_the_wrong_one_and_the_bound_beats_both():
    recordings = [navgym.simulate("toy/switch", seed) for seed in range(30)]
    mean = {
        label: np.mean([rmse(navgym.estimate(*each, r, given), r) for r in recordings])
        for label, each, given in (
            ("plain", ("walk_kf",), None), ("best", ("walk_kf",), {NOISE: 20.0}),
            ("bound", ("oracle",), None),
        )
    }  # fmt: skip
    assert mean["bound"] < mean["best"] < mean["plain"]


def test_it_is_listed_with_the_others():
    assert "toy/switch" in navgym.scenarios()
    assert "walk_kf" in navgym.filters()
    assert navgym.parameter_space("walk_kf").names == (NOISE,)
    with pytest.raises(ValueError, match="'walk_kf' is for a WalkRecording"):
        navgym.estimate("walk_kf", navgym.simulate("auv/nominal", steps=3))
    with pytest.raises(
        ValueError, match=r"kf.* is for a Recording .AUV.*use one of walk_kf, oracle"
    ):
        navgym.estimate("kf", navgym.simulate("toy/calm"))


def test_a_log_of_ones_own_is_read(tmp_path):
    (tmp_path / "walk.txt").write_text("1 0.5\n2 nan\n3 0.7\n")
    recording = navgym.read("walk", tmp_path / "walk.txt")
    assert isinstance(recording, WalkRecording)
    assert navgym.estimate("walk_kf", recording).nis.shape == (3,)


# ---- environment


def test_it_can_be_made_singly_and_in_batches():
    env = gymnasium.make(ID, overrides={"loss": 0.5})
    env.reset(seed=0)
    info = env.step(np.ones(1, dtype=np.float32))[4]
    assert info[NOISE] == pytest.approx(1000.0)
    batch = gymnasium.make_vec(ID, num_envs=4, pool=3)
    assert batch.reset(seed=0)[0].shape == (4, 4)


def test_a_walk_that_runs_away_ends_its_lane():
    recording = navgym.simulate("toy/calm", 1)
    absurd = recording.measurements.copy()
    absurd[50:] = 1e200
    env = gymnasium.make(ID, recording=replace(recording, measurements=absurd))
    env.reset()
    for _ in range(10):
        assert not env.step(np.zeros(1, dtype=np.float32))[2]
    _, reward, terminated, _, _ = env.step(np.zeros(1, dtype=np.float32))
    assert (reward, terminated) == (-20.0, True)


# ---- workers


def everything_by_name(what):
    return problem_of(what).name, navgym.simulate(what, 1, steps=3).meta["scenario"]


def test_a_spawned_process_finds_it_by_name():
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, adopt, (dict(REGISTERED),)) as pool:
        assert pool.submit(everything_by_name, "toy/calm").result() == ("toy", "toy/calm")
        assert pool.submit(len, PROBLEMS["toy"].filters).result() == 2


# ---- studies, trainings, contests


@pytest.mark.parametrize("workers", [1, 2])
def test_a_study_finds_more_noise_than_the_model_has(tmp_path, workers):
    pytest.importorskip("optuna")
    from navgym.tuning import tune
    from navgym.tuning.report import study as tune_report
    from navgym.tuning.settings import StudySettings

    settings = StudySettings(
        filter="walk_kf", scenario=("toy/switch",), trials=10, runs=8, select_runs=8, report_runs=12,
        workers=workers, out=tmp_path,
    )  # fmt: skip
    found = tune.run(settings)
    assert len(found.outcome.trials) == 10
    assert found.values[NOISE] > 4.0
    rows = found.reports["toy/switch"]
    assert rows["oracle"].mean < rows[found.tuned].mean < rows[found.default].mean
    tune_report.write(found)
    tuned = read_tuned(tmp_path / "tuned.toml")
    assert tuned.filter == "walk_kf"
    recording = navgym.simulate("toy/switch", 0)
    with_file = navgym.estimate("walk_kf", recording, tmp_path / "tuned.toml")
    assert rmse(with_file, recording) < rmse(navgym.estimate("walk_kf", recording), recording)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    pytest.importorskip("stable_baselines3")
    from navgym.agents.training.configuration import Configuration, Recipe
    from navgym.agents.training.run import train

    config = Configuration(
        environment=ID, scenarios=("toy/switch",), action_parameters=(NOISE,), decisions=4096,
        lanes=16, recipe=Recipe(steps=32, batch=128, epochs=4), pool=32, validation=16,
        interval=2048, randomise=True, out=tmp_path_factory.mktemp("toy"),
    )  # fmt: skip
    return train(config, report=lambda _: None)


def test_a_training_makes_a_policy_that_travels(trained):
    from navgym.agents.policies.policy import Policy

    assert len(trained.history) == 3
    assert np.isfinite(trained.best.score)
    policy = Policy.load(trained.folder / "policy")
    assert policy.manifest.environment == ID
    assert policy.manifest.filter == "walk_kf"


def test_a_policy_filters_samples_as_they_come(trained):
    from navgym.agents.live.streaming import SelfTuningFilter

    recording = navgym.simulate("toy/switch", 5)
    live = SelfTuningFilter("walk_kf", trained.policy, WalkModel())
    found = [live.step(y) for y in recording.measurements]
    assert np.isfinite([e.state for e in found]).all()
    assert len({e.parameters[NOISE] for e in found}) > 1
    live.reset()
    again = list(live.follow(recording))
    np.testing.assert_array_equal([e.state for e in again], [e.state for e in found])


def test_an_evaluation_knows_everybody(trained):
    from navgym.agents.evaluation.contest import BEST_FIXED, Extent
    from navgym.agents.evaluation.verdicts import evaluate, leagues

    extent = Extent(quick=True, runs=8)
    (bench,) = evaluate(leagues({"mine": trained.policy}, extent), progress=False)
    own = next(bench.own()).main
    assert {"mine", "plain", "oracle", "hand rule", BEST_FIXED} <= {r.label for r in own.rows}
    assert own["oracle"].mean < own["plain"].mean
    assert own["oracle"].score == 1.0
    assert [v.policy for v in bench.verdicts] == ["mine"]
    assert {r.condition.name for r in bench.results} >= {"switch"}
