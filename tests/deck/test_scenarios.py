"""Deck scenarios: the catalogue, what is refused, overrides."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

import navgym
from navgym.deck.scenarios import (
    DECK_CATALOGUE,
    REGIMES,
    DeckRegime,
    DeckScenario,
)
from navgym.inertial.flexure import ARCMIN
from navgym.inertial.imu import NO_ERRORS, ImuErrors
from navgym.simulation import find_scenario


def test_the_paper_is_section_5():
    s = DECK_CATALOGUE["paper"]
    assert s.samples == 30_000
    assert s.speed == pytest.approx(10.29, abs=0.01)  # 20 kn
    model = s.model
    assert model.flexure.sigma == pytest.approx(np.array([6.0, 6.0, 10.0]) * ARCMIN)
    assert np.sqrt(model.flexure.stiffness) == pytest.approx(2.146 / np.array([10.0, 10.0, 30.0]))
    assert model.flexure.frequency_squared == pytest.approx(np.zeros(3), abs=1e-15)
    np.testing.assert_array_equal(model.lever_arm, [10.0, 10.0, 2.0])
    assert s.lever_error == 0.0
    assert s.sub.scaled(0.1) == s.main


def test_only_the_papers_scenario_knows_the_lever_arm():
    assert [n for n, s in DECK_CATALOGUE.items() if s.lever_error == 0.0] == ["paper"]
    assert [n for n, s in DECK_CATALOGUE.items() if s.static_lever] == ["lever"]


def test_regimes_are_those_of_the_measured_headroom():
    assert [r.name for r in REGIMES] == ["calm", "swell", "slam", "glitch"]
    swell, slam, glitch = REGIMES[1:]
    assert swell.flexure.sigma == pytest.approx(np.array([9.0, 9.0, 12.0]) * ARCMIN)
    mu = swell.flexure.damping / 2.0
    assert np.sqrt(swell.flexure.frequency_squared) == pytest.approx(1.5 * mu)
    assert (slam.slam_rate, slam.slam_size) == (0.2, 4.0)
    assert (glitch.glitch_rate, glitch.glitch_velocity, glitch.glitch_rate_size) == (0.1, 1.0, 2e-3)


def test_a_scenario_believes_its_first_regime_unless_told():
    calm, swell = REGIMES[:2]
    s = DeckScenario("x", "", regimes=(swell, calm))
    np.testing.assert_array_equal(s.model.flexure.stiffness, swell.flexure.stiffness)
    told = s.override(believed=calm)
    np.testing.assert_array_equal(told.model.flexure.stiffness, calm.flexure.stiffness)


def test_recordings_hold_whole_filter_steps():
    assert DeckScenario("x", "", duration=1.03).samples == 105
    assert DeckScenario("x", "", duration=1.02).samples == 100
    assert DeckScenario("x", "", duration=1.0, rate=50.0, samples_per_step=1).samples == 50


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"rate": 0.0}, "rate must"),
        ({"duration": 0.05}, "duration must"),
        ({"samples_per_step": 0}, "samples_per_step"),
        ({"regimes": ()}, "regimes must be a tuple of at least one DeckRegime"),
        ({"regimes": ("calm",)}, "regimes must be a tuple of at least one DeckRegime"),
        ({"dwell": (20.0, 10.0)}, "dwell"),
        ({"dwell": (0.0, 10.0)}, "dwell"),
        ({"lever_error": -0.1}, "lever_error must"),
        ({"latitude": 91.0}, "latitude must"),
        ({"latitude": 89.1}, "latitude must"),
        ({"latitude": -89.1}, "latitude must"),
        ({"heading": 360.1}, "heading must"),
        ({"heading": -360.1}, "heading must"),
        ({"speed": -0.1}, "speed must"),
        ({"lever_arm": (1.0, 2.0)}, r"lever_arm must be three numbers, got \(1.0, 2.0\)"),
        ({"sway": (1.0, np.nan, 0.0)}, "sway must be finite"),
        ({"static": 3.0}, "static must be three numbers"),
        ({"sway_rate": (1.0,)}, "sway_rate must be three numbers"),
    ],
)
def test_impossible_scenarios_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        DeckScenario("x", "", **fields)


def test_errors_of_another_kind_are_refused():
    for name in ("sub", "main"):
        with pytest.raises(TypeError, match=f"{name} must be ImuErrors, got 0.1"):
            DeckScenario("x", "", **{name: 0.1})


@pytest.mark.parametrize(
    "fields",
    [
        {"rate": 0.5, "samples_per_step": 1},
        {"duration": 0.1},  # two filter steps
        {"dwell": (1e-3, 1e-3)},
        {"lever_error": 0.0},
        {"latitude": 89.0},
        {"latitude": -89.0},
        {"heading": 360.0},
        {"heading": -360.0},
        {"speed": 0.0},
        {"regimes": (DeckRegime(glitch_rate=1.0, outlier_rate=1.0),)},
        {
            "regimes": (
                DeckRegime(
                    slam_size=0.0, glitch_velocity=0.0, glitch_rate_size=0.0, outlier_size=0.0
                ),
            )
        },
    ],
    ids=" ".join,
)
def test_the_ends_of_every_range_belong_to_it(fields):
    made = DeckScenario("x", "", **fields)
    for name, value in fields.items():
        assert getattr(made, name) == value


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"tau": (1.0, 2.0)}, "tau of regime 'storm' must be three positive numbers"),
        ({"sigma": (1.0, 0.0, 2.0)}, "sigma of regime 'storm' must be three positive numbers"),
        ({"oscillation": -1.0}, "oscillation of regime 'storm'"),
        ({"glitch_rate": 1.1}, "glitch_rate of regime 'storm'"),
        ({"outlier_rate": -0.1}, "outlier_rate of regime 'storm'"),
        ({"slam_rate": -1.0}, "slam_rate of regime 'storm'"),
        ({"glitch_velocity": np.inf}, "glitch_velocity of regime 'storm'"),
    ],
)
def test_impossible_regimes_are_refused_by_name(fields, message):
    with pytest.raises(ValueError, match=message):
        DeckRegime("storm", **fields)


def test_imu_errors_are_in_the_units_of_data_sheets():
    degree, gravity = np.pi / 180.0, 9.80665
    wanted = [degree / 3600, degree / 60, 1e-6 * gravity, 1e-6 * gravity, 1e-6, degree / 3600]
    for i, unit in enumerate(wanted):
        np.testing.assert_allclose(ImuErrors(*np.eye(6)[i]).si, np.eye(6)[i] * unit)
    assert ImuErrors(1.0, 2.0, 3.0, 4.0, 5.0, 6.0).scaled(0.5) == ImuErrors(0.5, 1, 1.5, 2, 2.5, 3)


def test_negative_imu_errors_are_refused():
    with pytest.raises(ValueError, match="gyro_bias must"):
        ImuErrors(gyro_bias=-1.0)
    assert NO_ERRORS.si == (0.0,) * 6


CHANGES = {
    "duration": 12.0,
    "rate": 50.0,
    "samples_per_step": 2,
    "regimes": REGIMES[:2],
    "dwell": (5.0, 6.0),
    "static": (1.0, 2.0, 3.0),
    "lever_arm": (1.0, 2.0, 3.0),
    "lever_error": 0.5,
    "static_lever": True,
    "sway": (1.0, 2.0, 3.0),
    "sway_rate": (1.0, 2.0, 3.0),
    "heading": 12.0,
    "latitude": -30.0,
    "speed": 3.0,
    "sub": ImuErrors(1.0),
    "main": ImuErrors(1.0),
    "believed": REGIMES[1],
    "reference": {"kernel_width": 3.0},
    "name": "mine",
    "summary": "my own",
}
UNSEEN = {"reference", "name", "summary"}  # by the recording's numbers


@pytest.mark.parametrize("field", CHANGES)
def test_every_field_can_be_overridden_and_matters(field):
    base = find_scenario("deck/switch-30", duration=20.0, dwell=(3.0, 3.0))
    changed = base.override(**{field: CHANGES[field]})
    assert getattr(changed, field) == CHANGES[field]
    assert replace(changed, **{field: getattr(base, field)}) == base
    a, b = (navgym.simulate(s, 0) for s in (base, changed))
    if field not in UNSEEN:
        assert different(a, b)


def different(a, b):
    """Whether anything but the meta data differs between two recordings."""
    names = ("time", "main_angle", "sub_angle", "sub_velocity", "regime", "static", "theta")
    if any(not np.array_equal(getattr(a, n), getattr(b, n)) for n in names):
        return True
    x, y = a.model.arrays(), b.model.arrays()
    return any(not np.array_equal(x[n], y[n]) for n in x)


def test_every_field_has_its_override_test():
    assert set(CHANGES) == set(DeckScenario.__dataclass_fields__)


def test_unknown_fields_are_refused_with_the_nearest_name():
    with pytest.raises(ValueError, match="lever_error"):
        find_scenario("deck/paper", lever_eror=0.1)
    with pytest.raises(ValueError, match="deck/glitch"):
        find_scenario("deck/glitches")


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
@pytest.mark.parametrize("name", DECK_CATALOGUE)
def test_scenarios_survive_copies(name, copied):
    scenario = DECK_CATALOGUE[name]
    assert copied(scenario) == scenario
    assert hash(copied(scenario)) == hash(scenario)
    with pytest.raises(TypeError):
        copied(scenario).reference["kernel_width"] = 1.0
