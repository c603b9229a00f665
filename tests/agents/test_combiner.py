"""The combiner against its equations in numpy, against the bank, and as files."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from scipy.special import expit

import navgym
from navgym.agents import Combiner
from navgym.agents.combiner.combiner import KIND, bank_facts
from navgym.agents.policies import portable
from navgym.auv.scenarios import Loss
from navgym.simulation import simulate_many
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters import combiner as kernels
from navgym.statespace.filters.modes import BANK
from navgym.tuning.cases import Cases
from tests.agents.both import run
from tests.agents.hand_made import forged
from tests.helpers import NAMES, identical, run_bank
from tests.twins import bank as twin

UNITS = 48  # the usual number: another one would compile another kernel
PRETRAINED = Path(__file__).resolve().parents[2] / "agents" / "pretrained" / "combiner"
CHOSEN = (1.0, 1.0, 0.995, 0.985, 0.2)  # the bank's parameters
MODES = kernels.modes_of(BANK)
NODES, MOVED = kernels.moved_by(BANK)[0], sum(kernels.moved_by(BANK))


def network(seed=0, size=0.3):
    """A combiner with random weights that move the bank's visibly."""
    rng = np.random.default_rng(seed)
    arrays = {
        name: size * rng.standard_normal(shape)
        for name, shape in kernels.shapes(BANK, UNITS).items()
    }
    return Combiner(**arrays | {"gain": np.full_like(arrays["gain"], 0.5)})


def idle():
    """A combiner that moves nothing."""
    return Combiner(**{n: np.zeros(s) for n, s in kernels.shapes(BANK, UNITS).items()})


@pytest.fixture(scope="module")
def trained():
    return Combiner.load(PRETRAINED)


def altered(recording, **changes):
    parts = {"measurements": recording.measurements, "lost": recording.lost} | changes
    return navgym.Recording(recording.time, **parts, model=recording.model)


# ---- what it computes


def marginals(weights):
    """Weights of the nodes and of the regimes, (T, A + B), from those of the modes (T, J)."""
    nodes = [weights[:, MODES.node == a].sum(1) for a in range(NODES)]
    regimes = [weights[:, MODES.regime == b].sum(1) for b in range(MOVED - NODES)]
    return np.stack(nodes + regimes, axis=1)


def read(recording, axes):
    """The network's inputs (T, D), by the textbook's bank."""
    parts = recording.model, recording.time, recording.measurements, recording.lost
    bank = twin.bank(*parts, BANK, kernels.STRUCTURE, CHOSEN, axes)
    logs = np.log(1e-4 + marginals(bank["weights"]))
    before, found = np.zeros(4), []
    for k, got in enumerate(~recording.lost):
        row = [*logs[k], got.mean()]
        if got.any():
            z, S = np.zeros(4), bank["S"][k][np.ix_(got, got)]
            z[got] = np.linalg.solve(np.linalg.cholesky(S), bank["innovations"][k, got])
            products = [z[0] * before[0] + z[2] * before[2], z[1] * before[1] + z[3] * before[3]]
            products += [z[0] * z[1] + z[2] * z[3]]
            row += [math.log(0.01 + z[0] ** 2 + z[2] ** 2), math.log(0.01 + z[1] ** 2 + z[3] ** 2)]
            row += [p / math.sqrt(1 + abs(p)) for p in products]
            row += [math.log(0.01 + z @ z)]
            before = z
        else:
            row += [0.0] * 6
        found.append(row)
    return np.array(found)


def moved(combiner, inputs):
    """Log-weights (T, J) that the network adds, by the equations of its module."""
    h, found = np.zeros(UNITS), []
    for row in inputs:
        u = np.clip((row - combiner.shift) * combiner.gain, -kernels.CLIP, kernels.CLIP)
        now, past = (
            np.split(u @ combiner.W + combiner.b, 3),
            np.split(h @ combiner.U + combiner.c, 3),
        )
        r, z = expit(now[0] + past[0]), expit(now[1] + past[1])
        n = np.tanh(now[2] + r * past[2])
        h = n + z * (h - n)
        a = kernels.BOUND * np.tanh((h @ combiner.V + combiner.d) / kernels.BOUND)
        found.append(a[MODES.node] + a[NODES + MODES.regime])
    return np.array(found)


LOSSES = {"auv/switch-B": Loss(0.2), "auv/component-loss": Loss(0.3, per_component=True)}


@pytest.mark.parametrize("scenario", LOSSES)
def test_weights_are_those_of_the_equations(scenario):
    recording = navgym.simulate(scenario, 7, steps=30, loss=LOSSES[scenario])
    combiner = network()
    bank = navgym.estimate("bank", recording).extras["weights"]
    wanted = bank * np.exp(moved(combiner, read(recording, 2)))
    wanted /= wanted.sum(1, keepdims=True)
    found = combiner.estimate(recording).extras["weights"]
    assert np.abs(found - bank).max() > 0.1
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-11)


@pytest.mark.parametrize(("scenario", "axes"), [("auv/switch-B", 2), ("auv/component-loss", 1)])
def test_the_estimate_is_the_mixture_of_the_banks_modes_under_the_new_weights(scenario, axes):
    recording = navgym.simulate(scenario, 3, steps=60)
    lane = run_bank(recording, BANK, axes, CHOSEN)["lane"]
    found = network().estimate(recording)
    assert not recording.lost[-1].all()
    weights = found.extras["weights"][-1]
    p, J = 4 // axes, len(weights)
    means = lane["after"]["mean"][:4, :J].reshape(p, axes, J).transpose(2, 1, 0).reshape(J, 4)
    lower = np.tril(np.moveaxis(lane["after"]["cov"][:p, :p, :J], -1, 0))
    both = lower + np.swapaxes(np.tril(lower, -1), 1, 2)
    blocks = [np.kron(np.eye(axes), C) for C in both]
    x = weights @ means
    P = sum(
        w * (C + np.outer(m - x, m - x)) for w, C, m in zip(weights, blocks, means, strict=True)
    )
    np.testing.assert_allclose(found.states[-1], x, rtol=1e-10)
    np.testing.assert_allclose(found.covariances[-1], P, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("scenario", ["auv/switch-D", "auv/component-loss"])
def test_a_network_that_moves_nothing_is_the_bank(scenario):
    recording = navgym.simulate(scenario, 11, steps=150)
    found, bank = idle().estimate(recording), navgym.estimate("bank", recording)
    for name in ("innovations", "nis", "log_likelihood"):
        np.testing.assert_array_equal(getattr(found, name), getattr(bank, name))
    np.testing.assert_allclose(found.states, bank.states, rtol=1e-12)
    np.testing.assert_allclose(found.covariances, bank.covariances, rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(found.extras["weights"], bank.extras["weights"], rtol=1e-12)


def test_no_weight_moves_further_than_the_bound():
    recording = navgym.simulate("auv/switch-B", 5, steps=200)
    bank = navgym.estimate("bank", recording).extras["weights"]
    found = network(size=50.0).estimate(recording).extras["weights"]
    usual = bank > 1e-200
    shift = np.log(found[usual] / bank[usual])
    assert np.abs(shift).max() > kernels.BOUND
    assert np.abs(shift).max() <= 4 * kernels.BOUND  # two for the mode, two for the others' sum
    np.testing.assert_allclose(found.sum(1), 1.0, rtol=1e-12)


def test_the_fast_hyperbolic_tangent_is_one():
    x = np.concatenate([np.linspace(-50.0, 50.0, 20001), [1e-9, -1e-300, 1e300, -np.inf]])
    fast = numba.vectorize(["float64(float64)"])(kernels.tanh.py_func)
    np.testing.assert_allclose(fast(x), np.tanh(x), rtol=1e-14, atol=1e-300)


# ---- batches, causality, losses


def test_a_recording_is_estimated_alike_in_any_batch():
    lengths = (90, 40, 90, 65)
    recordings = [navgym.simulate("auv/switch-B", i, steps=s) for i, s in enumerate(lengths)]
    recordings.append(navgym.simulate("auv/component-loss", 1, steps=70))
    combiner = network()
    together = combiner.run(StateSpaceBatch.of(recordings), everything=True)
    for i, recording in enumerate(recordings):
        alone = combiner.estimate(recording)
        identical({n: getattr(together, n)[i, : len(recording)] for n in NAMES}, alone)
        np.testing.assert_array_equal(
            together.extras["weights"][i, : len(recording)], alone.extras["weights"]
        )
        assert np.isnan(together.states[i, len(recording) :]).all()


def test_later_samples_change_no_earlier_estimate():
    whole = navgym.simulate("auv/switch-D", 3, steps=120)
    y, lost = whole.measurements.copy(), whole.lost.copy()
    y[80:] += 30.0
    lost[80, 0] = True  # from here on the axes differ
    combiner = network()
    for other in (altered(whole, measurements=y), altered(whole, lost=lost)):
        one, two = combiner.estimate(whole), combiner.estimate(other)
        for name in ("states", "covariances"):
            np.testing.assert_array_equal(getattr(one, name)[:80], getattr(two, name)[:80])
        assert not np.array_equal(one.states[80:], two.states[80:])


def test_what_was_lost_is_not_read():
    whole = navgym.simulate("auv/component-loss", 3, steps=100)
    y = whole.measurements.copy()
    y[whole.lost] = 1e6
    nan = whole.measurements.copy()
    nan[whole.lost] = np.nan
    combiner = network()
    wanted = combiner.estimate(whole)
    identical(combiner.estimate(altered(whole, measurements=y)), wanted)
    identical(combiner.estimate(altered(whole, measurements=nan, lost=None)), wanted)


def test_nothing_received_is_the_prediction():
    whole = navgym.simulate("auv/switch-D", 3, steps=30)
    found = network().estimate(altered(whole, lost=np.ones(30, bool)))
    k = np.arange(1.0, 31.0)  # x0 = [0, 1, 0, 1]
    np.testing.assert_allclose(found.states, np.stack([k, k**0, k, k**0], axis=1))
    assert np.isfinite(found.covariances).all()


def test_a_failure_of_the_bank_is_told_and_spares_the_others():
    good = navgym.simulate("auv/switch-D", 3, steps=40)
    y = good.measurements.copy()
    y[20] = 1e200
    found = network().run(
        StateSpaceBatch.of([altered(good, measurements=y), good]), everything=True
    )
    assert found.diverged.tolist() == [True, False]
    assert np.isnan(found.states[0, 20:]).all()
    assert np.isnan(found.covariances[0, 20:]).all()
    identical({n: getattr(found, n)[1] for n in NAMES}, network().estimate(good))


def test_states_alone_are_the_same_states():
    batch = StateSpaceBatch.of(simulate_many("auv/switch-B", range(3), 80))
    brief, full = (network().run(batch, everything=e) for e in (False, True))
    np.testing.assert_array_equal(brief.states, full.states)
    assert brief.covariances.size == 0


@pytest.mark.parametrize("scenario", ["auv/position-only", "auv/coordinated-turn"])
def test_another_model_size_is_refused_with_the_remedy(scenario):
    with pytest.raises(ValueError, match=r'4 states and 4 measurements.*navgym\.estimate\("bank"'):
        network().estimate(navgym.simulate(scenario, 1, steps=20))


def test_on_request_another_model_size_gets_the_banks_own_weights():
    recording = navgym.simulate("auv/position-only", 1, steps=50)
    found = network().estimate(recording, fallback=True)
    bank = navgym.estimate("bank", recording)
    identical(found, bank)
    np.testing.assert_array_equal(found.extras["weights"], bank.extras["weights"])


# ---- files


def test_it_comes_back_from_its_files_to_the_last_bit(tmp_path):
    one = network()
    written = one.save(tmp_path / "mine")
    assert written == tmp_path / "mine.npz"
    two = Combiner.load(tmp_path / "mine.json")
    for name in kernels.ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    recording = navgym.simulate("auv/switch-B", 2, steps=60)
    identical(one.estimate(recording), two.estimate(recording))


def test_its_arrays_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        network().W[0] = 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"W": np.full((MOVED + 7, 3 * UNITS), np.nan)}, "W must be finite, got nan"),
        ({"V": np.full((UNITS, MOVED), 1e300)}, "V must be finite, got inf"),
        ({"b": np.zeros(7)}, r"b must have shape \(144,\)"),
        ({"U": np.zeros(3)}, r"U must have shape \(H, 3 H\)"),
        ({"d": ["a"] * MOVED}, "d must be an array of numbers"),
    ],
)
def test_arrays_that_are_no_network_are_refused(change, message):
    arrays = {name: getattr(idle(), name) for name in kernels.ARRAYS}
    with pytest.raises(ValueError, match=message):
        Combiner(**arrays | change)


def header(tmp_path, **changes):
    network().save(tmp_path / "mine")
    facts = json.loads((tmp_path / "mine.json").read_text()) | changes
    forged(tmp_path / "mine", facts)


def test_a_combiner_of_another_bank_is_refused_by_name(tmp_path):
    facts = bank_facts()
    facts["parameters"] = facts["parameters"] | {"scale_stay": 0.9}
    header(tmp_path, bank=facts)
    with pytest.raises(ValueError, match="a bank that differs from this navgym's in parameters"):
        Combiner.load(tmp_path / "mine")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "navgym policy"}, "describes a navgym policy, not a navgym combiner"),
        ({"format": 99}, "format 99"),
        ({"bank": 3}, "mine.npz"),
    ],
)
def test_foreign_files_are_refused(tmp_path, changes, message):
    header(tmp_path, **changes)
    with pytest.raises(ValueError, match=message):
        Combiner.load(tmp_path / "mine")


def test_damaged_files_are_refused(tmp_path):
    path = network().save(tmp_path / "mine")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="truncated"):
        Combiner.load(path)
    path.write_bytes(whole)
    text = (tmp_path / "mine.json").read_text()
    (tmp_path / "mine.json").write_text(text[:100])
    with pytest.raises(ValueError, match="truncated"):
        Combiner.load(path)
    (tmp_path / "mine.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"mine\.json is missing"):
        Combiner.load(path)
    arrays = {name: getattr(network(), name) for name in kernels.ARRAYS if name != "c"}
    portable.write(tmp_path / "mine", KIND, arrays, {"bank": bank_facts(), "training": {}})
    with pytest.raises(ValueError, match="lacks 'c'"):
        Combiner.load(path)


def squared(cases, states):
    """Squared position errors over time."""
    return cases.problem.scoring.squared(cases.batch, states, "rmse", cases.span)


# ---- the one that is shipped


@pytest.mark.parametrize(("scenario", "least"), [("auv/switch-D", 0.0), ("auv/switch-B", 0.01)])
def test_the_shipped_one_beats_the_bank_on_fresh_seeds(trained, scenario, least):
    cases = Cases.simulated(scenario, "test", 40, start=5000)
    own = cases.problem.scoring.errors(
        cases.batch, trained.run(cases.batch).states, ["rmse"], cases.span
    )["rmse"].mean()
    assert own < (1.0 - least) * cases.errors("bank")[0].mean()


@pytest.mark.parametrize(("scenario", "left"), [("auv/switch-D", 0.9), ("auv/switch-B", 0.85)])
def test_the_shipped_one_comes_nearer_to_the_oracle_than_the_bank(trained, scenario, left):
    """Of the mean squared distance to the oracle's estimate, so much is left at most."""
    batch = Cases.simulated(scenario, "test", 60, start=5000).batch
    oracle = run("oracle", batch).states[..., [0, 2]]
    own, bank = (
        ((found.states[..., [0, 2]] - oracle) ** 2).sum(-1).mean()
        for found in (trained.run(batch), run("bank", batch))
    )
    assert own < left * bank


def test_the_shipped_one_keeps_the_bank_consistent(trained):
    """Mean squared error over predicted variance of the position stays what the bank's is."""
    cases = Cases.simulated("auv/switch-B", "test", 30)
    ratios = []
    for found in (
        trained.run(cases.batch, everything=True),
        run("bank", cases.batch, everything=True),
    ):
        variance = found.covariances[..., [0, 2], [0, 2]].sum(-1)
        ratios.append(np.nanmean(squared(cases, found.states)) / variance.mean())
    assert abs(math.log(ratios[0])) < abs(math.log(ratios[1])) + 0.05


def test_running_one_needs_no_torch():
    code = (
        "import sys, navgym, agents\n"
        f"c = agents.Combiner.load({str(PRETRAINED)!r})\n"
        "c.estimate(navgym.simulate('auv/switch-D', 0, steps=20))\n"
        "assert not {'torch', 'stable_baselines3'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
