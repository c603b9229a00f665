"""A combiner's training learns, gives the same network twice, and survives being stopped."""

import json

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
pytest.importorskip("tyro")

import navgym
from navgym.agents import Combiner
from navgym.agents.combiner.material import RANGES, CombinerConfiguration, material
from navgym.agents.combiner.training import Network, Trainer, gains, mixed, train
from navgym.agents.training import checkpoints
from navgym.command import main as command
from navgym.core.seeds import seeds, split_of
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import combiner as kernels
from tests.agents.both import run
from tests.agents.small import quiet
from tests.agents.test_training import Stopped, stop_after

TINY = {
    "recordings": 12, "validation": 3, "steps": 80, "rounds": 6, "batch": 6, "chunk": 40,
    "interval": 2, "seed": 3,
}  # fmt: skip


SCENARIOS = ("auv/switch-D", "auv/switch-B")


def tiny(folder, **changes):
    return CombinerConfiguration(**TINY | {"out": folder} | changes)


def same(one, other):
    return all((getattr(one, n) == getattr(other, n)).all() for n in kernels.ARRAYS)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    config = tiny(tmp_path_factory.mktemp("made"))
    return train(config, report=quiet, command="the command"), config


def test_the_same_training_gives_the_same_network(made, tmp_path):
    first, _ = made
    assert same(train(tiny(tmp_path / "one"), report=quiet), first)
    assert not same(train(tiny(tmp_path / "two", seed=4), report=quiet), first)


@pytest.mark.parametrize("lines", [3, 4])
def test_a_training_that_was_stopped_ends_with_the_same_network(made, tmp_path, lines):
    with pytest.raises(Stopped):
        train(tiny(tmp_path), report=stop_after(lines))
    said = []
    assert same(train(tiny(tmp_path), report=said.append), made[0])
    assert any(line.startswith("going on after round") for line in said)


def test_a_damaged_checkpoint_is_told_and_the_one_before_taken(made, tmp_path):
    with pytest.raises(Stopped):
        train(tiny(tmp_path), report=stop_after(4))
    last = max((tmp_path / "checkpoints").iterdir())
    last.write_bytes(last.read_bytes()[:100])
    said = []
    assert same(train(tiny(tmp_path), report=said.append), made[0])
    assert "is damaged" in said[0]


def test_a_folder_of_another_training_is_refused_unless_started_anew(made, tmp_path):
    train(tiny(tmp_path, rounds=1), report=quiet)
    with pytest.raises(ValueError, match="another training, which differs in rounds"):
        train(tiny(tmp_path), report=quiet)
    assert same(train(tiny(tmp_path), fresh=True, report=quiet), made[0])


def test_the_files_say_where_they_come_from(made):
    combiner, config = made
    loaded = Combiner.load(config.folder / "combiner")
    assert same(loaded, combiner)
    training = loaded.training
    assert training["command"] == "the command"
    assert training["seeds"]["train"] == [36, 47]
    assert training["configuration"]["rounds"] == 6
    assert set(training["validation"]["gains"]) == {
        "auv/switch-D",
        "auv/switch-B",
        "randomised",
        "others",
    }


def test_it_learns_what_it_is_shown(tmp_path):
    """On the recordings that it is taught with, it comes to beat the bank."""
    config = tiny(tmp_path, recordings=12, batch=12, rounds=60, interval=60, steps=120, seed=0)
    trainer = Trainer(config, quiet)
    before = gains(trainer.network, trainer.material).mean()
    trainer.run()
    assert before == pytest.approx(0.0, abs=1e-6)
    assert gains(trainer.network, trainer.material).mean() > 0.01


def test_the_network_in_torch_is_the_kernels():
    torch = pytest.importorskip("torch")
    torch.manual_seed(1)
    batch = StateSpaceBatch.of(tiny(None).simulated(SCENARIOS, seeds("train", 3)))
    of = material(tiny(None).simulated(SCENARIOS, seeds("train", 3)))
    network = Network.for_inputs(48, of.inputs)
    for parameter in network.layers["out"].parameters():
        torch.nn.init.normal_(parameter, std=0.5)
    with torch.no_grad():
        moved, _ = network(torch.from_numpy(of.inputs))
        offsets = mixed(torch.from_numpy(of.log_weights) + moved, torch.from_numpy(of.offsets))
    oracle = run("oracle", batch).states[..., [0, 2]]
    found = network.combiner({}).run(batch).states[..., [0, 2]]
    assert np.abs(found - run("bank", batch).states[..., [0, 2]]).max() > 0.05
    np.testing.assert_allclose(found - oracle, offsets.numpy(), atol=2e-4)


def test_material_is_what_bank_and_oracle_say():
    recordings = tiny(None).simulated(SCENARIOS, seeds("train", 4))
    of, batch = material(recordings), StateSpaceBatch.of(recordings)
    bank = run("bank", batch).states[..., [0, 2]]
    weights = np.exp(of.log_weights)[..., None]
    mean = (weights * of.offsets).sum(2) + of.scatter + batch.truth[..., [0, 2]]
    np.testing.assert_allclose(mean, bank, atol=1e-4)
    error = ((bank - batch.truth[..., [0, 2]]) ** 2).sum(-1).mean(1)
    np.testing.assert_allclose(of.scale, error, rtol=1e-5)


def test_splits_stay_apart(tmp_path):
    one, two = tiny(tmp_path, seed=0), tiny(tmp_path, seed=1)
    assert not set(one.training_seeds) & set(two.training_seeds)
    assert {split_of(s) for s in (*one.training_seeds, *two.training_seeds)} == {"train"}


def test_conditions_reach_beyond_the_shifts_that_are_reported():
    low, high = RANGES.measurement_scale
    assert low < 1 / 3
    assert high > 10.0
    drawn = tiny(None).simulated(SCENARIOS, seeds("train", 60))
    scales = [np.median(r.measurement_scale) for r in drawn]
    assert min(scales) < 0.3
    assert max(scales) > 10.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"recordings": 5, "batch": 6}, "batch=6 exceeds recordings=5"),
        ({"rounds": 0}, "rounds must be a whole number of at least 1"),
        ({"validation": 1}, "validation must be a whole number of at least 2"),
        ({"learning_rate": 0.0}, "learning_rate must be a finite number above 0"),
        ({"scenarios": ()}, "scenarios must name at least one"),
        ({"scenarios": ("auv/swich-D",)}, "Did you mean 'auv/switch-D'"),
        ({"others": ()}, "others must name at least one"),
        ({"others": ("auv/position-only",)}, "has another model than the combiner reads"),
        ({"scenarios": ("deck/paper",)}, "has another model than the combiner reads"),
    ],
)
def test_a_configuration_that_cannot_be_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        CombinerConfiguration(**change)


def test_more_material_than_memory_is_refused_with_what_fits(tmp_path):
    with pytest.raises(ValueError, match=r"recordings=12 take .* set recordings=\d"):
        train(tiny(tmp_path, memory=1e-4), report=quiet)


# ---- the command line


def call(*words):
    return command(["combine", *map(str, words)])


def test_the_command_line_reports_on_a_combiner(made, tmp_path, capsys):
    _, config = made
    words = ("--evaluate", config.folder / "combiner", "--report", 4, "--out", tmp_path)
    assert call(*words, "--scenarios", "auv/switch-B") == 0
    assert "gain over bank" in capsys.readouterr().out
    (row,) = json.loads((tmp_path / "report.json").read_text())
    cases = navgym.seeds("test", 4)
    batch = StateSpaceBatch.of([navgym.simulate("auv/switch-B", s) for s in cases])
    error = np.sqrt(((run("bank", batch).states - batch.truth)[..., [0, 2]] ** 2).sum(-1).mean(1))
    assert row["bank"] == pytest.approx(error.mean())
    assert row["difference"]["relative_gain"] == pytest.approx(1 - row["error"] / row["bank"])


def test_the_command_line_trains(tmp_path, capsys):
    words = [f"--{name}={value}" for name, value in TINY.items()]
    assert call(*words, "--out", tmp_path, "--report", 0) == 0
    assert "100%" in capsys.readouterr().out
    made = Combiner.load(tmp_path / "combiner")
    assert made.training["command"].startswith("navgym combine --recordings=12")
    assert len(list((tmp_path / "checkpoints").iterdir())) == checkpoints.KEPT


def test_wrong_words_end_with_a_message(tmp_path, capsys):
    assert call("--evaluate", tmp_path / "none") == 2
    assert "none.npz is missing" in capsys.readouterr().err
    assert call("--out", tmp_path, "--memory", 1e-6) == 2
    assert "memory" in capsys.readouterr().err


def test_the_shipped_combiner_is_called_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call("--evaluate", "combiner", "--report", 0) == 0
