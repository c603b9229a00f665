"""Where Optuna searches, and with what."""

import numpy as np
import optuna
import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from navgym.tuning.study.search_space import SAMPLERS, distributions, sampler_of
from tests.tuning.goals import SPACE


def test_every_scale_is_searched_as_it_is_declared():
    found = distributions(SPACE)
    p = {name: SPACE[name] for name in SPACE.defaults}
    forgetting, sweeps = p["forgetting"], p["vb_iterations"]
    assert found["1 - forgetting"] == FloatDistribution(
        1.0 - forgetting.high, 1.0 - forgetting.low, log=True
    )
    assert found["vb_iterations"] == IntDistribution(
        round(sweeps.low), round(sweeps.high), log=sweeps.scale == "log"
    )
    assert found["fill"] == CategoricalDistribution(p["fill"].choices)
    noise = p["process_noise_scale"]
    assert noise.scale == "log"
    assert found["process_noise_scale"] == FloatDistribution(noise.low, noise.high, log=True)
    assert len(found) == len(SPACE)


KINDS = {
    "tpe": "TPESampler", "cma-es": "CmaEsSampler", "gp": "GPSampler", "nsga-ii": "NSGAIISampler",
    "random": "RandomSampler",
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n == "gp")) for n in SAMPLERS]
)  # the Gaussian process imports torch
def test_a_sampler_is_of_its_kind(name):
    if name == "gp":
        pytest.importorskip("torch")
    assert isinstance(sampler_of(name, 0, 0), getattr(optuna.samplers, KINDS[name]))


def test_draws_depend_on_the_seed_and_the_number_of_trials_alone():
    def draw(seed, count):
        study = optuna.create_study(sampler=sampler_of("random", seed, count))
        return tuple(study.ask(distributions(SPACE)).params.values())

    assert draw(1, 5) == draw(1, 5)
    assert len({draw(0, 0), draw(0, 1), draw(1, 0), draw(1, 1)}) == 4


def test_cma_es_goes_on_from_the_history_whatever_number_the_trial_has():
    """A trial that was killed leaves a gap in the numbers; what is drawn next must not change."""
    space = {name: FloatDistribution(0.0, 1.0) for name in "xy"}
    done = [
        optuna.create_trial(params={"x": x, "y": y}, distributions=space, value=x**2 + y**2)
        for x, y in np.random.default_rng(0).uniform(size=(20, 2)).tolist()
    ]
    killed = optuna.create_trial(state=optuna.trial.TrialState.FAIL)
    found = []
    for trials in (done, [*done, killed]):
        study = optuna.create_study(sampler=sampler_of("cma-es", 3, 20))
        study.add_trials(trials)
        drawn = study.ask(space)
        found.append((drawn.number, drawn.params))
    (first, one), (second, other) = found
    assert (first, second) == (20, 21)
    assert one == other


def test_an_unknown_sampler_is_refused_with_the_nearest():
    with pytest.raises(ValueError, match="Did you mean 'cma-es'"):
        sampler_of("cmaes", 0, 0)
