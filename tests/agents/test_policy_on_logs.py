"""A policy trained on logs: what it reads, how far it acts, what chooses it, what is written."""

import dataclasses

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
pytest.importorskip("tyro")

import navgym
from navgym.agents.evaluation.rollout import Learnt, roll_out
from navgym.agents.policies.policy import Policy, shipped
from navgym.agents.training import trainer
from navgym.agents.training.command import parse
from navgym.agents.training.configuration import presets
from navgym.agents.training.log_validation import LogValidation
from navgym.agents.training.material import material
from navgym.agents.training.run import settled, train
from navgym.agents.training.verdict import judged
from navgym.command import main as command
from tests.agents.mixtures import quiet, recording, saved
from tests.agents.small import RECIPE

USUAL = presets()["auv-logs"][1]


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return saved(tmp_path_factory.mktemp("logs"))


def tiny(folder, logs, **changes):
    recipe = dataclasses.replace(RECIPE, hidden=(8,))
    usual = {
        "log": tuple(logs), "out": folder, "lanes": 8, "decisions": 500, "interval": 200, "recipe": recipe,
        "trials": 2, "draws": 1, "pool": 9,
    }  # fmt: skip
    return dataclasses.replace(USUAL, **usual | changes)


@pytest.fixture(scope="module")
def made(logs, tmp_path_factory):
    return train(tiny(tmp_path_factory.mktemp("made"), logs), report=quiet).policy


def test_the_same_training_gives_the_same_policy_and_goes_on_from_its_own_start(
    made, logs, tmp_path
):
    config = tiny(tmp_path, logs)
    first = train(config, report=quiet).policy
    assert all(
        np.array_equal(a, b) for (a, _), (b, _) in zip(first.layers, made.layers, strict=True)
    )
    said = []
    again = train(config, report=said.append).policy
    assert any(line.startswith("going on after") for line in said)
    assert not any(line.startswith("tuning") for line in said)
    assert all(
        np.array_equal(a, b) for (a, _), (b, _) in zip(first.layers, again.layers, strict=True)
    )


def test_the_usual_policy_on_logs_is_small(made):
    assert len(USUAL.observations) == 11
    assert USUAL.recipe.hidden == (16, 16)
    assert (USUAL.reach, USUAL.recipe.gamma, USUAL.decisions) == (0.5, 0.5, 200_000)
    used = np.flatnonzero(np.abs(made.layers[0][0]).sum(axis=0))
    assert {made.manifest.observation_names[i] for i in used} == {*USUAL.observations}


def test_it_uses_half_of_the_range(made):
    wild = np.random.default_rng(0).uniform(-5.0, 5.0, (500, len(made.low)))
    assert np.abs(made(wild)).max() <= 0.5
    assert made.reach == 0.5


def test_what_was_saved_acts_alike(made, tmp_path):
    back = Policy.load(made.save(tmp_path / "policy"))
    wild = np.random.default_rng(0).uniform(-5.0, 5.0, (50, len(made.low)))
    assert np.array_equal(back(wild), made(wild))


def test_a_policy_of_whole_reach_is_written_as_before():
    header, _ = shipped("auv").parts()
    assert "reach" not in header["architecture"]


def test_the_lanes_show_the_agent_its_columns_alone(logs, tmp_path):
    config = settled(tiny(tmp_path, logs), True, quiet, "")
    found = material(config)
    env = found.env
    env.seed(0)
    shown = env.reset()
    assert shown.shape == (8, 11)
    env.step_async(np.ones((8, 3)))
    shown, *_ = env.step_wait()
    assert shown.flags.c_contiguous  # or a training that was stopped ends with other bits
    assert env.observation_space.shape == (11,)
    whole = env.counters()["observations"]
    assert np.array_equal(shown, whole[:, list(found.columns)])


def test_half_an_action_is_what_acts(logs, tmp_path):
    config = settled(tiny(tmp_path, logs), True, quiet, "")
    one, half = (material(dataclasses.replace(config, reach=r)).env for r in (1.0, 0.5))
    for env, size in ((one, 0.5), (half, 1.0)):
        env.seed(0)
        env.reset()
        env.step_async(np.full((8, 3), size))
        env.step_wait()
    assert np.array_equal(one.latest("rmse"), half.latest("rmse"))


def test_training_sees_the_earlier_part_of_each_log_and_the_rest_chooses(logs, tmp_path):
    config = settled(tiny(tmp_path, logs), True, quiet, "")
    lengths = material(config).env.engine.shelf.stations["length"]
    assert lengths.tolist() == [84, 84, 84]
    cases = next(iter(LogValidation(config).cases.values()))
    assert cases.span == (0.7, 1.0)


def test_validation_logs_choose_and_whole_logs_are_trained_on(logs, tmp_path):
    config = settled(tiny(tmp_path, logs[:2], validation_log=logs[2:]), True, quiet, "")
    assert material(config).env.engine.shelf.stations["length"].tolist() == [120, 120]
    found = LogValidation(config)
    assert next(iter(found.cases.values())).span == (0.0, 1.0)
    assert found.how == "on the validation logs"


def test_without_truth_it_learns_from_the_likelihood_and_says_what_that_is_worth(tmp_path):
    said = []
    config = settled(tiny(tmp_path, saved(tmp_path, truth=False)), True, said.append, "")
    assert config.reward == "likelihood"
    assert "teaches little" in said[0]
    assert LogValidation(config).counts == "fixes"


def test_where_the_guard_says_no_the_policy_leaves_the_tuned_parameters(
    logs, tmp_path, monkeypatch
):
    no = judged("policy", "there", [{"fixes": -0.01}])
    monkeypatch.setattr(trainer.LogValidation, "verdict", lambda *_: no)
    said = []
    kept = train(tiny(tmp_path, logs), report=said.append).policy
    assert any("the policy is NOT kept" in line for line in said)
    assert kept.manifest.training["guard"]["better"] is False
    (schedule,) = roll_out(Learnt(kept), [recording(9)]).schedules
    for name, value in kept.manifest.reference.items():
        assert schedule[name] == pytest.approx(value) if not isinstance(value, str) else True


def test_the_manifest_names_no_folder(made, tmp_path):
    text = made.save(tmp_path / "policy").with_suffix(".json").read_text()
    assert "log0.npz" in text
    assert str(tmp_path.parent.parent) not in text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"clone": True}, "observations and reach are for ppo"),
        ({"randomise": True}, "are for simulated recordings"),
        ({"observations": ("magic",)}, "unknown observation 'magic'"),
        ({"start": "idam"}, "sets those of 'qivbf'"),
    ],
)
def test_what_cannot_be_is_refused(changes, message, logs, tmp_path):
    if "start" in changes:
        path = tmp_path / "tuned.toml"
        path.write_text('filter = "kf"\n[parameters]\nprocess_noise_scale = 4.0\n')
        changes = {"start": path}
    with pytest.raises(ValueError, match=message):
        train(tiny(tmp_path / "out", logs, **changes), report=quiet)


def test_logs_of_another_problem_than_the_preset(tmp_path):
    deck = navgym.simulate("deck/switch-60", seed=0, duration=20.0).save(tmp_path / "deck.npz")
    with pytest.raises(ValueError, match=r"deck\.npz is a log of the Deck, and .* plays the AUV"):
        train(tiny(tmp_path, (deck,)), report=quiet)


def test_auv_means_the_small_one_with_logs(logs):
    words = ["--log", *map(str, logs)]
    assert parse(["auv", *words]).configuration.observations == USUAL.observations
    assert parse(words).configuration.reach == 0.5
    assert parse(["auv"]).configuration.observations == ()


def test_options_of_logs_without_logs_are_refused(capsys):
    assert command(["train", "auv", "--start", "tuned.toml"]) == 2
    assert "start is for trainings on logs" in capsys.readouterr().err
