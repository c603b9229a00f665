"""The public names are a contract: each exists, with its fields and its arguments."""

import inspect
import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest

import navgym
from navgym.problem import problems_with

CLASSES = {
    "Recording": ("time", "measurements", "lost", "truth", "regime", "model", "meta"),
    "LinearModel": ("F", "dt", "H", "Q", "R", "x0", "P0"),
    "Estimate": ("time", "states", "covariances", "innovations", "nis", "diverged"),
    "DualIMURecording": (
        "time", "main_angle", "main_velocity", "sub_angle", "sub_velocity", "model", "theta",
        "theta_rate", "static", "attitude", "regime", "meta",
    ),
    "DeckModel": ("flexure", "lever_arm", "samples_per_step", "misalignment"),
    "FlexureModel": ("damping", "stiffness", "sigma", "deviation", "evidence", "diagnostics"),
    "DeckEstimate": (
        "attitude", "attitude_error", "static", "theta", "theta_rate", "covariances", "weights",
        "innovations", "diverged", "unobserved",
    ),
    "Parameter": (
        "name", "symbol", "unit", "low", "high", "scale", "default", "integer", "equation",
    ),
    "ParameterSpace": ("parameters",),
}  # fmt: skip
FUNCTIONS = {
    "simulate": ("scenario", "seed", "steps"),
    "scenarios": (),
    "estimate": ("filter_name", "recording", "parameters"),
    "filters": (),
    "parameter_space": ("filter_name",),
    "seeds": ("split", "count"),
    "read": (),
    "geographic": ("recording", "states"),
    "identify": ("method", "increments", "interval"),
    "flexure_increments": ("recording",),
}
FILTERS = (
    "kf", "kf_zero", "kf_hold", "kf_extrapolate", "vbakf", "qivbf", "qivbf_printed", "imm",
    "imm_wide", "bank", "bank_2026", "oracle", "cukf", "ukf", "ckf", "ekf",
)  # fmt: skip


@pytest.mark.parametrize("name", CLASSES)
def test_classes_have_their_documented_fields(name):
    kind = getattr(navgym, name)
    manual = "".join(base.__doc__ or "" for base in kind.__mro__)
    for field in CLASSES[name]:
        own = getattr(kind, field, None)
        if isinstance(own, property):
            assert own.__doc__, f"{name}.{field} is not documented"
            continue
        assert field in {f.name for f in fields(kind)}
        if name != "ParameterSpace":
            assert f"{field}:" in manual, f"{name}.{field} is not documented"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_take_their_documented_arguments(name):
    function = getattr(navgym, name)
    given = tuple(inspect.signature(function).parameters)
    assert given[: len(FUNCTIONS[name])] == FUNCTIONS[name]
    assert function.__doc__


def test_every_public_name_loads_and_is_listed():
    for name in navgym.__all__:
        assert getattr(navgym, name) is not None
        assert name in dir(navgym)
    assert set(CLASSES) | set(FUNCTIONS) <= set(navgym.__all__)


@pytest.mark.parametrize("first", ["simulate", "estimate", "filters", "scenarios", "seeds"])
def test_listings_can_be_called_whatever_was_used_before(first):
    code = (
        f"import navgym; navgym.{first}; import navgym.statespace.filters.spaces, navgym.core.seeds; "
        "print('kf' in navgym.filters(), 'auv/tvr' in navgym.scenarios(), navgym.statespace.filters.spaces)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.startswith("True True <module")


def test_unknown_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="estimte"):
        navgym.estimte  # noqa: B018


@pytest.mark.parametrize("name", FILTERS)
def test_every_promised_filter_is_listed_with_a_line(name):
    assert len(navgym.filters()[name]) > 10
    for problem in problems_with(name):
        assert navgym.parameter_space(name, problem) is not None


def test_recordings_save_and_load_by_method():
    assert callable(navgym.Recording.save)
    assert callable(navgym.Recording.load)


def test_ten_lines_filter_a_log():
    """From plain arrays to an estimate with nothing but the public names."""
    rng = np.random.default_rng(0)
    time = np.arange(1.0, 51.0)
    fixes = np.column_stack([time, np.ones(50), time, np.ones(50)]) + rng.standard_normal((50, 4))
    fixes[20:25] = np.nan
    recording = navgym.Recording(time, fixes)
    estimate = navgym.estimate("bank", recording)
    assert np.abs(estimate.states[-1, [0, 2]] - 50.0).max() < 2.0
    assert not estimate.diverged


def test_importing_the_library_loads_no_learning_framework_and_no_compiler():
    code = (
        "import sys, navgym; "
        "print([m for m in ('torch', 'stable_baselines3', 'optuna', 'numba', 'scipy') "
        "if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
