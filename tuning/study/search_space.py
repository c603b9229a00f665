"""Between a `ParameterSpace` and Optuna: distributions, names of parameters, samplers."""

from __future__ import annotations

import copy
import importlib.util
import io
import pickle
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.trial import FrozenTrial

from navgym.core.checks import one_of
from navgym.core.parameters import Parameter, ParameterSpace

SAMPLERS = ("tpe", "cma-es", "gp", "nsga-ii", "random")
STARTUP_TRIALS = 15  # random trials before a model takes over, the enqueued ones included
POPULATION = 24  # of NSGA-II


def distributions(space: ParameterSpace) -> dict[str, BaseDistribution]:
    """Optuna's search space. A log-complement parameter is searched as "1 - name", on a log scale."""
    return dict(distribution(p) for p in space)


def distribution(p: Parameter) -> tuple[str, BaseDistribution]:
    """What Optuna calls a parameter, and where it searches."""
    if p.choices:
        return p.name, CategoricalDistribution(p.choices)
    if p.integer:
        return p.name, IntDistribution(round(p.low), round(p.high), log=p.scale == "log")
    if p.scale == "log-complement":
        return f"1 - {p.name}", FloatDistribution(1.0 - p.high, 1.0 - p.low, log=True)
    return p.name, FloatDistribution(p.low, p.high, log=p.scale == "log")


def to_optuna(space: ParameterSpace, values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters as Optuna names them."""
    named = {}
    for p in space:
        value = p.show(p.check(values[p.name]))
        complement = p.scale == "log-complement"
        named[distribution(p)[0]] = 1.0 - float(value) if complement else value
    return named


def from_optuna(space: ParameterSpace, params: Mapping[str, Any]) -> dict[str, Any]:
    """Inverse of `to_optuna`."""
    values = {}
    for p in space:
        found = params[distribution(p)[0]]
        if p.scale == "log-complement":
            found = min(max(1.0 - found, p.low), p.high)
        values[p.name] = p.show(p.check(found))
    return values


def sampler_of(
    name: str, seed: int, count: int, space: Mapping[str, BaseDistribution] | None = None
) -> optuna.samplers.BaseSampler:
    """A fresh sampler for the `count`-th trial: its draws depend on the history alone, not on who
    resumed it.

    Args:
        name: of `SAMPLERS`.
        seed: of the study.
        count: trials before this one.
        space: what is searched; by default TPE reads it off the trials, all of them each time.

    Raises:
        ValueError: an unknown name.
        ImportError: "gp" without torch.
    """
    one_of("sampler", name, SAMPLERS)
    words = int(np.random.SeedSequence([seed, count]).generate_state(1)[0])
    if name == "random":
        return optuna.samplers.RandomSampler(seed=words)
    if name == "nsga-ii":
        return optuna.samplers.NSGAIISampler(seed=words, population_size=POPULATION)
    if name == "cma-es":
        return _CovarianceSampler(
            seed=words, n_startup_trials=STARTUP_TRIALS, warn_independent_sampling=False
        )
    if name == "gp":
        return _gaussian_process(words)
    usual: dict[str, Any] = {
        "seed": words,
        "multivariate": True,
        "n_startup_trials": STARTUP_TRIALS,
    }
    return optuna.samplers.TPESampler(**usual) if space is None else _TreeSampler(space, **usual)


class _TreeSampler(optuna.samplers.TPESampler):
    """TPE that is told what it searches."""

    def __init__(self, space: Mapping[str, BaseDistribution], **options: Any) -> None:
        super().__init__(**options)
        # sorted, and without what cannot vary, as Optuna finds it
        self._told = {name: d for name, d in sorted(space.items()) if not d.single()}

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """The whole space: every finished trial has all parameters."""
        del study, trial
        return self._told


class _CovarianceSampler(optuna.samplers.CmaEsSampler):
    """CMA-ES whose draws do not depend on a trial's number, which a kill may have moved on by one.

    Optuna keeps the optimiser in the study as a pickle, and a journal or database may be others': here
    nothing but an optimiser's arrays is unpickled.
    """

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Optuna adds the number to the seed."""
        alike = copy.copy(trial)
        alike.number = 0
        return super().sample_relative(study, alike, search_space)

    def _restore_optimizer(self, completed_trials: list[FrozenTrial]) -> Any:
        """The optimiser as the last trial left it, or None."""
        for trial in reversed(completed_trials):
            mine = {
                name: value
                for name, value in trial.system_attrs.items()
                if name.startswith(self._attr_key_optimizer)
            }
            if mine:
                return _optimiser(self._concat_optimizer_attrs(mine))
        return None


class _Arrays(pickle.Unpickler):
    """Reads an optimiser of `cmaes`, and nothing that could run other code."""

    def find_class(self, module: str, name: str) -> Any:
        """What a pickle names; UnpicklingError for what no optimiser holds."""
        held = {
            "cmaes._cma": {"CMA"},
            "numpy": {"dtype", "ndarray"},
            "numpy._core.multiarray": {"_reconstruct", "scalar"},
        }
        if name not in held.get(module, ()):
            raise pickle.UnpicklingError(f"it names {module}.{name}")
        return super().find_class(module, name)


def _optimiser(text: str) -> Any:
    """An optimiser from its pickle in hexadecimal digits; ValueError for anything else."""
    try:
        return _Arrays(io.BytesIO(bytes.fromhex(text))).load()
    except Exception as error:
        raise ValueError(
            f"the study holds no optimiser of CMA-ES where there should be one ({error}): it is damaged "
            "or forged. Name another folder or storage."
        ) from error


def _gaussian_process(seed: int) -> optuna.samplers.BaseSampler:
    if importlib.util.find_spec("torch") is None:
        raise ImportError("sampler 'gp' needs torch: pip install 'navgym[agents]', or use 'tpe'.")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        return optuna.samplers.GPSampler(seed=seed, n_startup_trials=STARTUP_TRIALS)
