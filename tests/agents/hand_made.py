"""Policies made by hand: linear in a few observations."""

import numpy as np

from agents.manifest import Manifest
from agents.policy import Policy
from agents.rollout import AUV, DECK, ENGINES
from navgym.simulation import find_scenario

CHOICES = {AUV: ("process_noise_scale", "forgetting"), DECK: ("kernel_width",)}


def policy(environment, scenario, weights=(), reference=None, **settings):
    """Actions = weights · observation + bias.

    Args:
        weights: by (number of the action, name of the observation, or "bias").
        settings: arguments of the environment.
    """
    make, kind = ENGINES[environment]
    given = {"action_parameters": CHOICES[environment], "action": "residual"} | settings
    if reference is None:
        reference = dict(find_scenario(scenario).reference)
    engine = make(kind(scenario, reference=reference, **given), 1)
    names = list(engine.observation_names)
    w, b = np.zeros((len(engine.table), len(names))), np.zeros(len(engine.table))
    for (action, name), value in dict(weights).items():
        if name == "bias":
            b[action] = value
        else:
            w[action, names.index(name)] = value
    manifest = Manifest.of(environment, engine, {"command": "made by hand"})
    return Policy(manifest, [(w, b)])
