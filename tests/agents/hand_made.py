"""Policies made by hand: linear in a few observations."""

import numpy as np

from navgym.agents.evaluation.rollout import problem_in
from navgym.agents.policies.manifest import Manifest
from navgym.agents.policies.policy import Policy
from navgym.simulation import find_scenario


def policy(environment, scenario, weights=(), reference=None, **settings):
    """Actions = weights · observation + bias.

    Args:
        weights: by (number of the action, name of the observation, or "bias").
        settings: arguments of the environment.
    """
    own = problem_in(environment).environment
    given = {"action_parameters": own.steered, "action": "residual"} | settings
    if reference is None:
        reference = dict(find_scenario(scenario).reference)
    engine = own.engine(own.settings(scenario, reference=reference, **given), 1)
    names = list(engine.observation_names)
    w, b = np.zeros((len(engine.table), len(names))), np.zeros(len(engine.table))
    for (action, name), value in dict(weights).items():
        if name == "bias":
            b[action] = value
        else:
            w[action, names.index(name)] = value
    manifest = Manifest.of(environment, engine, {"command": "made by hand"})
    return Policy(manifest, [(w, b)])
