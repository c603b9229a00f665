"""The teacher knows the regime to come; the student learns to guess it."""

import dataclasses
import json

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("tyro")
pytest.importorskip("tomli_w")

from navgym.agents.training.cloning import Regimes, find_teacher
from navgym.agents.training.configuration import Cloning
from navgym.agents.training.material import material
from navgym.agents.training.run import train
from tests.agents.small import RECIPE, quiet, tiny


def test_the_teacher_answers_for_the_sample_to_come(tmp_path):
    env = material(tiny(tmp_path, overrides={"steps": 100, "dwell": (12, 20)})).env
    env.reset()
    regimes = Regimes(env)
    assert regimes.names == ("nominal", "outlier", "manoeuvre")
    for _ in range(10):
        stations = env.engine.stations
        tapes = env.engine.shelf.tapes["regime"]
        wanted = [tapes[s["which"], s["k"]] for s in stations]
        np.testing.assert_array_equal(regimes(), wanted)
        env.step(np.zeros((8, 3), dtype=np.float32))


def test_regimes_of_a_mixture_go_by_name(tmp_path):
    env = material(tiny(tmp_path, scenarios=("auv/switch-D", "auv/switch-A"))).env
    env.seed(0)
    env.reset()
    regimes = Regimes(env)
    assert regimes.names == ("nominal", "outlier", "manoeuvre", "calm", "noisy", "burst")
    for i, number in enumerate(regimes()):
        station = env.engine.stations[i]
        label = env.engine.label(i)["regimes"]
        own = label[int(env.engine.shelf.tapes["regime"][station["which"], station["k"]])]
        assert regimes.names[number] == own


def test_the_search_finds_that_manoeuvres_want_more_process_noise(tmp_path):
    config = tiny(
        tmp_path, lanes=64, overrides={"steps": 300, "dwell": (40, 60)}, pool=16,
        cloning=Cloning(search=6),
    )  # fmt: skip
    env = material(config).env
    env.seed(0)
    teacher = find_teacher(config, env, 0)
    process = dict(zip(teacher.regimes, teacher.actions[:, 0], strict=True))
    assert process["manoeuvre"] > 0.0 > process["nominal"]


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_a_clone_guesses_what_the_teacher_would_do(tmp_path, algorithm):
    options = {
        "overrides": {"steps": 300}, "pool": 20, "lanes": 32, "decisions": 64, "interval": 64,
        "cloning": Cloning(decisions=20_000, epochs=10, search=4),
        "recipe": dataclasses.replace(RECIPE, steps=2),
    }  # fmt: skip
    train(tiny(tmp_path, clone=True, algorithm=algorithm, **options), report=quiet)
    found = json.loads((tmp_path / "training.json").read_text())["cloned"]
    assert set(found["teacher"]) == {"nominal", "outlier", "manoeuvre"}
    assert len(found["losses"]) == 3
    assert found["losses"][-1] < 0.7 * found["spread"]
