"""Files of tuned parameters: what they hold is what filters and environments run with."""

import re
import warnings

import gymnasium
import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import navgym
from navgym.problem import PROBLEMS
from navgym.tuned import as_model, read_tuned

AUV = PROBLEMS["auv"]

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
        ('filter = "kf"\n[parameters]\nposition_noise_scale = 0.0\n', "must be a positive number"),
        ('filter = "kf"\n[parameters]\n[model]\nposition_noise = "big"\n', "must hold numbers"),
        ('filter = "kf"\n[parameters]\n[model]\nposition_noise = -1.0\n', "must hold numbers"),
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


# ---- the model that scales refer to


def recording(position_noise=1.0, acceleration=0.1, steps=80, dt=1.0, velocity_noise=0.1):
    rng = np.random.default_rng(0)
    model = navgym.LinearModel.white_acceleration(dt, acceleration, position_noise, velocity_noise)
    y = rng.normal(size=(steps, model.m)).cumsum(axis=0)
    return navgym.Recording(dt * np.arange(1.0, steps + 1), y, model=model)


def written(path, of, **scales):
    batch = AUV.stack([of])
    rows = "".join(f"{k} = {v}\n" for k, v in scales.items())
    model = tomli_w.dumps({"model": as_model(AUV.noises(batch))})
    path.write_text(f'filter = "kf"\n[parameters]\n{rows}{model}')
    return path


def test_a_file_says_what_its_models_believed(tmp_path):
    found = read_tuned(written(tmp_path / "tuned.toml", recording(2.0, 0.3)))
    assert found.model == {
        "position_noise": (2.0,), "velocity_noise": (pytest.approx(0.1),),
        "process_density": (pytest.approx(0.3),),
    }  # fmt: skip


def test_the_noise_of_a_model_does_not_depend_on_how_a_log_is_cut():
    a, b = (AUV.noises(AUV.stack([recording(dt=dt)])) for dt in (0.1, 10.0))
    assert a.keys() == b.keys()
    for name in a:
        np.testing.assert_allclose(a[name].deviations, b[name].deviations)


def test_on_a_model_of_the_same_noise_nothing_is_said(tmp_path):
    path = written(tmp_path / "tuned.toml", recording(), position_noise_scale=4.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        navgym.estimate("kf", recording(dt=0.5), path)


@given(st.floats(0.1, 10.0), st.floats(0.1, 10.0), st.floats(0.01, 100.0))
@settings(
    max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
def test_on_a_model_of_other_noise_a_warning_says_how_to_convert(tmp_path, old, new, scale):
    """What it says gives the estimate that the file's model would have given."""
    assume(abs(old / new - 1.0) > 0.05)
    path = written(tmp_path / "tuned.toml", recording(old), position_noise_scale=scale)
    with pytest.warns(UserWarning, match="believed in other noise") as caught:
        navgym.estimate("kf", recording(new), path)
    said = float(
        re.search(r"= (\S+?)[.;]? ?(?:Read|$)", str(caught[0].message)).group(1).rstrip(".")
    )
    assert said == pytest.approx(scale * (old / new) ** 2, rel=1e-3)
    converted = navgym.estimate("kf", recording(new), {"position_noise_scale": said})
    meant = navgym.estimate("kf", recording(old), {"position_noise_scale": scale})
    np.testing.assert_allclose(converted.states, meant.states, rtol=1e-2, atol=1e-3)


def test_a_sensor_that_is_not_there_is_said(tmp_path):
    path = written(tmp_path / "tuned.toml", recording(), process_noise_scale=2.0)
    with pytest.warns(UserWarning, match="velocity_noise was 0.1, and this recording has none"):
        navgym.estimate("kf", recording(velocity_noise=None), path)


def test_a_deck_says_the_noise_of_its_flexure(tmp_path):
    deck = PROBLEMS["deck"]
    made = navgym.simulate("deck/paper", duration=4.0)
    (name, told), *_ = deck.noises(deck.stack([made])).items()
    assert name == "flexure_density"
    np.testing.assert_allclose(np.square(told.deviations), made.model.flexure.noise_density)
