"""Files of tuned parameters: what they hold is what filters and environments run with."""

import gymnasium
import numpy as np
import pytest

import navgym
from navgym.tuned import read_tuned

GOOD = 'filter = "qivbf"\n[parameters]\nforgetting = 0.9\nfill = "skip"\nvb_iterations = 3\n'
VALUES = {"forgetting": 0.9, "fill": "skip", "vb_iterations": 3}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "tuned.toml"
    path.write_text(GOOD)
    return path


@pytest.mark.parametrize("kind", [str, lambda p: p])
def test_an_estimate_from_a_file_is_one_with_its_parameters(file, kind):
    recording = navgym.simulate("auv/switch-D", steps=60, loss=0.2)
    found = navgym.estimate("qivbf", recording, kind(file))
    np.testing.assert_array_equal(found.states, navgym.estimate("qivbf", recording, VALUES).states)


def test_a_deck_filter_reads_its_file_too(tmp_path):
    path = tmp_path / "tuned.toml"
    path.write_text('filter = "alignment_mcc"\n[parameters]\nkernel_width = 3.0\n')
    recording = navgym.simulate("deck/paper", duration=4.0)
    found = navgym.estimate("alignment_mcc", recording, path)
    same = navgym.estimate("alignment_mcc", recording, {"kernel_width": 3.0})
    np.testing.assert_array_equal(found.states, same.states)


def test_an_environment_takes_a_file_for_its_reference(file):
    env = gymnasium.make("navgym/AUVDropout-v0", reference=file, overrides={"steps": 20})
    reference = env.unwrapped.engine.reference
    assert {name: reference[name] for name in VALUES} == VALUES


def test_a_file_of_another_filter_is_refused_naming_both(file):
    recording = navgym.simulate("auv/nominal", steps=5)
    with pytest.raises(ValueError, match="'qivbf', not of 'bank'"):
        navgym.estimate("bank", recording, file)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("filter = ", "is not TOML"),
        ("\x00\x01", "is not TOML"),
        ("[parameters]\n", "lacks 'filter'"),
        ('filter = "qivbf"\n', "lacks 'parameters'"),
        ('filter = "qivbf"\nparameters = 3\n', "holds no tuned parameters"),
        ('filter = "qivf"\n[parameters]\n', "Did you mean 'qivbf'"),
        ('filter = "qivbf"\n[parameters]\nforgeting = 0.9\n', "Did you mean 'forgetting'"),
        ('filter = "qivbf"\n[parameters]\nforgetting = 2.0\n', "forgetting must lie in"),
        ('filter = "qivbf"\n[parameters]\nfill = "hold"\n', "unknown fill 'hold'"),
    ],
)
def test_a_bad_file_is_refused_with_its_name(tmp_path, text, message):
    path = tmp_path / "tuned.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        read_tuned(path)
    assert "tuned.toml" in str(caught.value)


def test_a_missing_file_is_said_to_be_missing(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_tuned(tmp_path / "none.toml")
