"""A training gives the same policy twice, whatever interrupts it, and says what it did."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("tyro")
pytest.importorskip("tomli_w")

from navgym.agents.policies.policy import Policy
from navgym.agents.training import checkpoints
from navgym.agents.training.configuration import Configuration, presets
from navgym.agents.training.run import train
from navgym.agents.training.validation import Validation
from tests.agents.both import AUV, DECK
from tests.agents.small import RECIPE, quiet, tiny

ROOT = Path(__file__).resolve().parents[2]


class Stopped(Exception):
    """Stands for a kill."""


def stop_after(lines):
    """A report that kills the training with its `lines`-th line."""
    seen = []

    def report(line):
        seen.append(line)
        if len(seen) == lines:
            raise Stopped

    return report


def same(one, other):
    pairs = zip(one.layers, other.layers, strict=True)
    return all((w == v).all() and (b == c).all() for (w, b), (v, c) in pairs)


# ---- what a training makes


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    lines = []
    config = tiny(tmp_path_factory.mktemp("made"))
    return train(config, report=lines.append, command="the command"), lines, config


def test_the_folder_holds_everything(made):
    result, _, config = made
    names = {p.name for p in config.folder.iterdir()}
    assert {"policy.npz", "policy.json", "config.toml", "training.json", "tensorboard"} <= names
    assert Configuration.from_toml(config.folder / "config.toml") == config
    facts = json.loads((config.folder / "training.json").read_text())
    assert facts["command"] == "the command"
    assert [m["decisions"] for m in facts["history"]] == [m.decisions for m in result.history]
    assert facts["seeds"]["train"] == [18, 23]


def test_the_best_policy_on_validation_is_kept_and_its_manifest_says_so(made):
    result, _, config = made
    best = max(result.history, key=lambda mark: mark.score)
    assert result.best == best
    policy = Policy.load(config.folder / "policy")
    assert same(policy, result.policy)
    assert policy.manifest.training["validation"]["score"] == best.score
    again = Validation(config)(policy)
    assert again.score == best.score
    assert policy.manifest.environment == AUV
    assert policy.manifest.reference["process_noise_scale"] == 70.0
    np.testing.assert_array_equal(policy.low, again.low)
    np.testing.assert_array_equal(policy.high, again.high)


def test_progress_tells_the_gain_over_best_fixed_parameters(made):
    result, lines, _ = made
    gains = [line for line in lines if "% against best fixed parameters" in line]
    assert len(gains) == len(result.history) >= 4
    last = result.history[-1].scores["gains"]["auv/switch-D"]["rmse"]
    assert f"{100 * last:+.1f} ± " in gains[-1]


def test_looks_come_at_the_interval(made):
    result, _, config = made
    decisions = [mark.decisions for mark in result.history]
    update = config.lanes * config.recipe.steps
    firsts = [next(d for d in range(0, 2000, update) if d >= at) for at in range(0, 1500, 400)]
    assert decisions[:4] == firsts
    assert decisions[-1] >= config.decisions


def test_the_same_command_gives_the_same_files(made, tmp_path):
    _, _, config = made
    train(dataclasses.replace(config, out=tmp_path), report=quiet, command="the command")
    for name in ("policy.json", "config.toml"):
        wanted = (config.folder / name).read_bytes().replace(str(config.folder).encode(), b"X")
        assert (tmp_path / name).read_bytes().replace(str(tmp_path).encode(), b"X") == wanted


def test_another_seed_gives_another_policy(made, tmp_path):
    result, _, config = made
    other = train(dataclasses.replace(config, out=tmp_path, seed=4), report=quiet)
    assert not same(other.policy, result.policy)


def test_a_finished_training_is_only_reported_again(made):
    result, _, config = made
    lines = []
    again = train(config, report=lines.append, command="the command")
    assert [m.decisions for m in again.history] == [m.decisions for m in result.history]
    assert same(again.policy, result.policy)
    assert not [line for line in lines if "against best fixed" in line]


def test_another_configuration_in_the_same_folder_is_refused(made):
    _, _, config = made
    with pytest.raises(ValueError, match=r"another training, which differs in lanes.*--fresh"):
        train(dataclasses.replace(config, lanes=9), report=quiet)


def test_a_learning_curve_is_drawn(made):
    pytest.importorskip("matplotlib")
    pytest.importorskip("jinja2")
    page = (made[2].folder / "training.html").read_text()
    assert "<svg" in page
    assert "best fixed parameters" in page


# ---- interruptions


@pytest.mark.parametrize(
    ("algorithm", "lines"),
    [("ppo", 1), ("ppo", 2), ("ppo", 4), ("sac", 4), ("tqc", 4), ("recurrent_ppo", 4)],
)
def test_a_killed_training_ends_where_an_uninterrupted_one_does(algorithm, lines, tmp_path):
    if algorithm in ("tqc", "recurrent_ppo"):
        pytest.importorskip("sb3_contrib")
    brief = dataclasses.replace(RECIPE, hidden=(8,), learning_starts=64, gradient_steps=1, epochs=1)
    options = {"algorithm": algorithm, "decisions": 500, "interval": 150, "recipe": brief}
    whole = train(tiny(tmp_path / "whole", **options), report=quiet)
    config = tiny(tmp_path / "killed", **options)
    with pytest.raises(Stopped):
        train(config, report=stop_after(lines))
    continued = train(config, report=quiet)
    assert [(m.decisions, m.scores) for m in continued.history] == [
        (m.decisions, m.scores) for m in whole.history
    ]
    states = [checkpoints.latest(tmp_path / n / "checkpoints")[0] for n in ("whole", "killed")]
    one, other = ({k: v.tobytes() for k, v in state.arrays.items()} for state in states)
    assert one == other
    assert states[0].facts["lanes"] == states[1].facts["lanes"]
    if whole.policy is not None:
        assert same(whole.policy, continued.policy)


def test_a_damaged_checkpoint_costs_only_what_came_after_the_one_before(tmp_path):
    whole = train(tiny(tmp_path / "whole"), report=quiet)
    config = tiny(tmp_path / "hurt")
    with pytest.raises(Stopped):
        train(config, report=stop_after(4))
    last = sorted((config.folder / "checkpoints").iterdir())[-1]
    last.write_bytes(last.read_bytes()[:-100])
    lines = []
    continued = train(config, report=lines.append)
    assert "is damaged" in lines[0]
    assert same(continued.policy, whole.policy)


def test_fresh_starts_anew(tmp_path):
    config = tiny(tmp_path)
    with pytest.raises(Stopped):
        train(config, report=stop_after(3))
    lines = []
    train(config, fresh=True, report=lines.append)
    assert not [line for line in lines if "going on" in line]


def test_a_batch_larger_than_an_update_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"recipe\.batch must be from 2 to .* = 128, got 500"):
        tiny(tmp_path, recipe=dataclasses.replace(RECIPE, batch=500))


def test_the_deck_trains_too(tmp_path):
    preset = presets()["deck"][1]
    config = dataclasses.replace(
        preset, out=tmp_path, overrides={"duration": 70.0}, pool=3, validation=2, lanes=4,
        decisions=64, interval=64, recipe=dataclasses.replace(RECIPE, steps=8),
        arguments={"warmup": 50.0},
    )  # fmt: skip
    result = train(config, report=quiet)
    gains = result.best.scores["gains"]["deck/switch-60"]
    assert set(gains) == {"theta_rate_rmse", "theta_ac_rmse", "theta_rmse"}
    assert result.policy.manifest.environment == DECK
    assert result.policy.manifest.settings["warmup"] == 50.0


@pytest.mark.slow
def test_a_killed_process_loses_nothing(tmp_path):
    for name in ("whole", "killed"):
        (tmp_path / f"{name}.toml").write_text(tiny(tmp_path / name).to_toml())

    def start(name):
        script = [sys.executable, "-m", "navgym.command", "train", str(tmp_path / f"{name}.toml")]
        return subprocess.Popen(script, stdout=subprocess.PIPE, text=True, bufsize=1)

    assert start("whole").wait() == 0
    victim = start("killed")
    for line in victim.stdout:
        if "%  512 decisions" in line:
            victim.kill()
            break
    assert victim.wait() != 0
    assert not (tmp_path / "killed/training.json").exists()
    assert start("killed").wait() == 0
    policies = [Policy.load(tmp_path / name / "policy") for name in ("whole", "killed")]
    assert same(*policies)


@pytest.mark.slow
def test_a_short_training_beats_best_fixed_parameters(tmp_path):
    config = Configuration(
        decisions=150_000, pool=150, validation=100, interval=150_000, out=tmp_path
    )
    assert train(config, report=quiet).best.score > 0.04
