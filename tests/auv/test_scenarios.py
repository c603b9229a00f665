"""The catalogue of scenarios: its members, its shifts, and what it refuses."""

import math
import re

import pytest

import navgym
from navgym.auv.scenarios import CATALOGUE, SHIFTS, AUVScenario, Loss, Regime, Turns
from navgym.simulation import find_scenario

NAMED = (
    "nominal", "paper", "burst", "tvr", "heavy", "student", "mismatch", "turn", "position-only",
    "component-loss", "switch-A", "switch-B", "switch-D",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMED)
def test_the_catalogue_holds_every_promised_name(name):
    assert CATALOGUE[name].name == name
    assert len(navgym.scenarios()[f"auv/{name}"]) > 10


@pytest.mark.parametrize("name", SHIFTS)
@pytest.mark.parametrize("scenario", ["auv/switch-D", "auv/switch-B"])
def test_every_shift_applies(scenario, name):
    assert find_scenario(scenario, **SHIFTS[name]) != find_scenario(scenario)
    navgym.simulate(scenario, 0, **SHIFTS[name])


def test_transitions_keep_the_long_run_rate():
    """Stationary share of a two-state chain: p01 / (p01 + p10)."""
    for loss in (Loss(0.3, length=20.0), Loss(0.6, length=10.0), Loss(0.9, length=9.0)):
        into, stay = loss.transition
        assert into / (into + 1.0 - stay) == pytest.approx(loss.rate)
        assert 1.0 / (1.0 - stay) == pytest.approx(loss.length)


BAD = [
    (lambda: Loss(1.2), "loss rate", "1.2"),
    (lambda: Loss(-0.1), "loss rate", "-0.1"),
    (lambda: Loss(math.nan), "loss rate", "nan"),
    (lambda: Loss("a"), "loss rate", "'a'"),
    (lambda: Loss(0.5, length=0.5), "loss length", "0.5"),
    (lambda: Loss(0.9, length=3.0), "loss length", "3.0"),
    (lambda: Loss(0.5, length=math.nan), "loss length", "nan"),
    (lambda: Loss(outages=-1), "outages", "-1"),
    (lambda: Loss(outages=1, outage_length=0), "outage_length", "0"),
    (lambda: Regime("x", measurement_scale=0.0), "measurement_scale of regime 'x'", "0.0"),
    (lambda: Regime("x", process_scale=math.inf), "process_scale of regime 'x'", "inf"),
    (lambda: Regime("x", outlier_scale=-1.0), "outlier_scale of regime 'x'", "-1.0"),
    (lambda: Regime("x", outlier_rate=2.0), "outlier_rate of regime 'x'", "2.0"),
    (lambda: Regime("x", degrees=0.0), "degrees of regime 'x'", "0.0"),
    (lambda: Regime("x", degrees=math.nan), "degrees of regime 'x'", "nan"),
    (lambda: Turns(rate=(9.0, 3.0)), "rate of turns", "(9.0, 3.0)"),
    (lambda: Turns(dwell=(0, 0)), "dwell of turns", "0"),
    (lambda: Turns(dwell=5), "dwell of turns", "5"),
    (lambda: AUVScenario("x", "", steps=0), "steps", "0"),
    (lambda: AUVScenario("x", "", steps=1.5), "steps", "1.5"),
    (lambda: AUVScenario("x", "", dt=0.0), "dt", "0.0"),
    (lambda: AUVScenario("x", "", dt=math.inf), "dt", "inf"),
    (lambda: AUVScenario("x", "", measured="positions"), "'positions'", "Did you mean 'position'"),
    (lambda: AUVScenario("x", "", loss=None), "loss rate", "None"),
    (lambda: AUVScenario("x", "", regimes=()), "regimes", "()"),
    (lambda: AUVScenario("x", "", regimes=("a",)), "regimes", "'a'"),
    (lambda: AUVScenario("x", "", dwell=(5, 3)), "dwell", "(5, 3)"),
    (lambda: AUVScenario("x", "", dwell=(5.5, 9.5)), "dwell", "5.5"),
    (lambda: AUVScenario("x", "", dwell=5), "dwell", "5"),
    (lambda: AUVScenario("x", "", measurement_scale=-1.0), "measurement_scale", "-1.0"),
    (lambda: AUVScenario("x", "", outlier_scale=0.0), "outlier_scale", "0.0"),
    (lambda: AUVScenario("x", "", manoeuvre_scale=0.0), "manoeuvre_scale", "0.0"),
]


def test_the_ends_of_every_range_belong_to_it():
    Loss(0.0), Loss(1.0), Loss(0.5, length=1.0), Loss(outages=0), Loss(outages=1, outage_length=1)
    Regime("x", outlier_rate=0.0), Regime("x", outlier_rate=1.0)
    Turns(rate=(0.0, 0.0), dwell=(1e-3, 1e-3))
    AUVScenario("x", "", steps=1, dt=1e-3, dwell=(1, 1))
    for name in ("measurement_scale", "process_scale", "outlier_scale"):
        assert getattr(Regime("x", **{name: 1e-9}), name) == 1e-9
    for name in ("measurement_scale", "process_scale", "outlier_scale", "manoeuvre_scale"):
        assert getattr(AUVScenario("x", "", **{name: 1e-9}), name) == 1e-9


@pytest.mark.parametrize(("make", "field", "value"), BAD)
def test_bad_fields_are_refused_by_name_and_value(make, field, value):
    with pytest.raises(ValueError, match=re.escape(field)) as caught:
        make()
    assert value in str(caught.value)


def test_unknown_fields_are_refused_with_the_nearest_name():
    with pytest.raises(ValueError, match=r"unknown scenario field 'los'\. Did you mean 'loss'"):
        navgym.simulate("auv/nominal", los=0.3)
