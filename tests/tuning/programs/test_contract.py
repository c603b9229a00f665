"""What a program's parameters are declared as, and what is said of a declaration that cannot be."""

import math

import pytest

from navgym.tuning.programs.contract import Contract
from tests.tuning.programs import making


def test_a_declaration_becomes_parameters(tmp_path):
    text = making.CONTRACT + (
        '[parameters.gate]\nrange = [1, 9]\ndefault = 3\ninteger = true\nscale = "linear"\n'
        'target = "EKF_GATE"\nprior = 1.5\n'
        '[parameters.kind]\nchoices = ["huber", "none"]\ndefault = "none"\n'
        '[output]\ninnovation = "nu"\nvariance = ["s"]\n'
    )
    found = Contract.load(making.contract(tmp_path, text))
    assert found.space.names == ("walk_noise", "meter_noise", "gate", "kind")
    assert found.space["walk_noise"].scale == "log"
    assert found.space["walk_noise"].unit == "m/√s"
    assert found.space.defaults["kind"] == "none"
    assert found.columns.innovation == ("nu",)
    assert found.named({"gate": 3}) == {"EKF_GATE": 3}
    assert found.members(("process", "gate")) == ("walk_noise", "gate")
    assert found.priors == {"gate": 1.5}


def test_a_prior_on_a_logarithmic_scale_is_a_factor():
    told = {"parameters": {"q": {"range": [0.1, 10.0], "default": 1.0, "prior": 2.0}}}
    assert Contract.of_dict(told).priors["q"] == pytest.approx(math.log(2.0))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("range = [10, 0.1]\ndefault = 1", "parameters.q.range must have low < high"),
        ("range = [0.1]\ndefault = 1", "must be \\[low, high\\], two numbers"),
        ("range = [1, inf]\ndefault = 1", "two numbers"),
        ("default = 1", "parameters.q.range must be"),
        ("range = [1, 2]", "parameters.q.default must be a number, got None"),
        ("range = [1, 2]\ndefault = 3", "must lie in its range 1..2, got 3: widen"),
        ('range = [1, 2]\ndefault = "x"', "default must be a number, got 'x'"),
        ('range = [-1, 2]\ndefault = 1\nscale = "log"', "both on the log scale"),
        ('range = [1, 2]\ndefault = 1\nscale = "lgo"', "Did you mean 'log'"),
        ("range = [1, 2]\ndefault = 1\ngruop = 1", "unknown field of parameters.q: 'gruop'. Did you mean 'group'"),
        ("range = [1, 2]\ndefault = 1\nprior = 0.5", "a factor above 1"),
        ('choices = ["a"]', "must name two or more"),
    ],
)  # fmt: skip
def test_a_wrong_declaration_names_field_value_and_remedy(tmp_path, table, message):
    with pytest.raises(ValueError, match=message) as raised:
        Contract.load(making.contract(tmp_path, f"[parameters.q]\n{table}\n"))
    assert "walk.toml" in str(raised.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("format = 'toml'", "declares no parameters"),
        ("parameters = 3", "declares no parameters"),
        ("[parameters]\nq = 3", "must be a table with range and default, got 3"),
        ("formt = 'toml'", "Did you mean 'format'"),
        ("base = 'nowhere.yaml'\n[parameters.q]\nrange = [1, 2]\ndefault = 1", "there is no file"),
        ("format = 'px4'\n[parameters.q]\nrange = [1, 2]\ndefault = 1", "16 capital letters"),
        ("[parameters.q]\nrange = [1, 2]\ndefault = 1\n[output]\ninnvation = 'x'", "innvation"),
        ("[parameters", "TOML"),
    ],
)
def test_a_file_that_is_no_contract_is_refused(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        Contract.load(making.contract(tmp_path, text))
