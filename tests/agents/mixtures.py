"""Small logs and mixtures for tests."""

import dataclasses

import numpy as np

import navgym
from navgym.agents.mixture.experts import Expert, around
from navgym.agents.mixture.mixture import Mixture
from navgym.agents.mixture.training import MixtureConfiguration
from navgym.statespace.filters import mixture as kernels

TUNED = Expert("qivbf", {"process_noise_scale": 2.0, "prior_count": 3.0})
FEATURES = len(kernels.FEATURES)


def recording(seed=0, steps=120, loss=0.3, truth=True):
    """A simulated voyage under losses, its noise unknown to filters."""
    made = navgym.simulate("auv/switch-D", seed=seed, steps=steps, loss=loss)
    nothing = {"process_scale": None, "measurement_scale": None, "regime": None}
    return dataclasses.replace(made, truth=made.truth if truth else None, **nothing)


def saved(folder, count=3, **options):
    """Paths of `count` logs in `folder`."""
    return tuple(recording(i, **options).save(folder / f"log{i}.npz") for i in range(count))


def mixture(seed=0, experts=None, size=0.3):
    """One with weights drawn at random."""
    rng = np.random.default_rng(seed)
    experts = around(TUNED) if experts is None else experts
    flat = np.zeros(FEATURES)
    return Mixture(
        experts, flat, flat + 1.0, flat - 20.0, flat + 20.0,
        size * rng.standard_normal((FEATURES, len(experts))), np.zeros(len(experts)), {"by": "hand"},
    )  # fmt: skip


def small(folder, log, **changes):
    """A training of seconds."""
    usual = {"trials": 4, "draws": 1, "iterations": 30, "seed": 3}
    return MixtureConfiguration(log=tuple(log), out=folder, **usual | changes)


def quiet(_line):
    """Takes progress and says nothing."""
