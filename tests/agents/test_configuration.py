"""One declaration of a training: file, command line, docs, search."""

import dataclasses
import json

import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("tyro")
pytest.importorskip("tomli_w")

from navgym.agents.policies.policy import Policy
from navgym.agents.training import command, hyperparameters
from navgym.agents.training.configuration import Configuration, markdown, presets
from navgym.agents.training.hyperparameters import ShortTraining
from navgym.agents.training.run import train
from navgym.command import main as navgym_command
from tests.agents.small import RECIPE, quiet, tiny


class TestConfiguration:
    @pytest.mark.parametrize("name", presets())
    def test_a_preset_survives_its_file(self, name, tmp_path):
        config = presets()[name][1]
        path = tmp_path / "c.toml"
        path.write_text(config.to_toml())
        assert Configuration.from_toml(path) == config
        assert command.parse([str(path)]).configuration == config
        assert command.parse([name]).configuration == config

    def test_the_command_line_overrides_a_preset(self):
        words = [
            "deck",
            "--recipe.gamma",
            "0.8",
            "--overrides",
            '{"duration": 90.0}',
            "--seed",
            "2",
        ]
        found = command.parse(words).configuration
        wanted = presets()["deck"][1]
        wanted = dataclasses.replace(
            wanted, overrides={"duration": 90.0}, seed=2,
            recipe=dataclasses.replace(wanted.recipe, gamma=0.8),
        )  # fmt: skip
        assert found == wanted

    def test_help_names_every_field(self, capsys):
        with pytest.raises(SystemExit):
            command.parse(["--help"])
        text = capsys.readouterr().out
        for field in dataclasses.fields(Configuration):
            assert f"--{field.name.replace('_', '-')}" in text
        for name in presets():
            assert f"  {name} " in text

    def test_the_table_for_the_docs_explains_every_field(self):
        rows = [line.split(" | ") for line in markdown().splitlines()[2:]]
        assert len(rows) > 40
        assert all(len(row) == 3 and len(row[2].strip(" |")) > 2 for row in rows)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("lane = 3", r"unknown field 'lane'\. Did you mean 'lanes'"),
            ('lanes = "many"', "lanes must be of type int, got 'many'"),
            ("lanes = true", "lanes must be of type int, got True"),
            ("recipe = 3", "recipe must be a table"),
            ("[recipe]\ngama = 1.0", r"unknown field of recipe: 'gama'\. Did you mean 'gamma'"),
            ("[recipe]\ngamma = 1.5", r"recipe\.gamma must be a number in 0\.\.1, got 1\.5"),
            ('scenarios = "auv/switch-D"', "scenarios must be a list"),
            ('algorithm = "dqn"', "unknown algorithm 'dqn'"),
            ("lanes = [", "c.toml is not TOML: "),
        ],
    )
    def test_a_wrong_file_is_refused_naming_the_field(self, text, message, tmp_path):
        path = tmp_path / "c.toml"
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            Configuration.from_toml(path)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"lanes": 0}, "lanes must be a whole number"),
            ({"scenarios": ()}, "at least one scenario"),
            ({"scenarios": ("auv/switch-E",)}, "unknown scenario 'auv/switch-E'"),
            ({"environment": "navgym/AUVDropout-v9"}, "unknown environment"),
            ({"arguments": {"reward": "absolute"}}, "must not hold 'reward'"),
            ({"validation": 1}, "validation must be a whole number of at least 2"),
            ({"memory": 0.0}, "memory must be"),
            ({"arguments": {"foo": 1}}, "unknown argument of navgym/AUVDropout-v0: 'foo'"),
            ({"lanes": 4}, r"recipe\.batch must be from 2 to lanes x recipe\.steps = 256"),
        ],
    )
    def test_wrong_values_are_refused(self, changes, message):
        with pytest.raises(ValueError, match=message):
            Configuration(**changes)

    def test_folders_differ_by_what_is_trained(self):
        folders = {
            Configuration(seed=1).folder,
            Configuration(seed=2).folder,
            Configuration(algorithm="sac").folder,
            Configuration(randomise=True).folder,
            presets()["deck"][1].folder,
        }
        assert len(folders) == 5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["deckk"], "neither a preset nor a TOML file"),
        (["absent.toml"], "absent.toml"),
        (["--scenarios", "auv/switch-Z"], "unknown scenario"),
    ],
)
def test_the_script_says_what_is_wrong_and_exits_with_2(words, message, capsys):
    assert navgym_command(["train", *words]) == 2
    assert message in capsys.readouterr().err


def test_ctrl_c_leaves_a_usable_policy_and_a_hint(tmp_path, monkeypatch, capsys):
    config = tiny(tmp_path)
    (tmp_path / "in.toml").write_text(config.to_toml())

    def interrupted(*arguments, **keywords):
        keywords["report"] = quiet
        train(*arguments, **keywords)
        raise KeyboardInterrupt

    monkeypatch.setattr("navgym.agents.training.run.train", interrupted)
    assert navgym_command(["train", str(tmp_path / "in.toml")]) == 130
    assert "without --fresh, goes on" in capsys.readouterr().err
    assert Policy.load(tmp_path / "policy").manifest.environment == "navgym/AUVDropout-v0"


def test_the_recipe_is_a_goal_for_a_study(tmp_path):
    config = tiny(tmp_path)
    goal = ShortTraining(config, 128)
    assert goal.recipe(goal.space.defaults) == dataclasses.replace(RECIPE, hidden=(64, 64))
    value = goal(goal.space.defaults)
    assert value == goal(goal.space.defaults)
    assert goal(goal.space.defaults | {"units": 32}) != value
    assert json.loads(json.dumps(goal.about))["decisions"] == 128


def test_a_search_writes_a_recipe_that_trains(tmp_path, capsys):
    pytest.importorskip("optuna")
    config = tiny(tmp_path, decisions=640)
    (tmp_path / "in.toml").write_text(config.to_toml())
    assert navgym_command(["train", str(tmp_path / "in.toml"), "--search", "2"]) == 0
    best = Configuration.from_toml(tmp_path / "best-recipe.toml")
    assert best.decisions == 640
    assert "best-recipe.toml" in capsys.readouterr().out


def test_only_the_recipe_of_ppo_is_searched(tmp_path):
    with pytest.raises(ValueError, match="knows the recipe of ppo"):
        hyperparameters.tune(tiny(tmp_path, algorithm="sac"), 1)
