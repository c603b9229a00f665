"""Policies made by hand: linear in a few observations."""

import json

import numpy as np

from navgym.agents.evaluation.rollout import problem_in
from navgym.agents.policies import portable
from navgym.agents.policies.manifest import Manifest
from navgym.agents.policies.policy import Policy
from navgym.core.storage import read_npz
from navgym.simulation import find_scenario


def forged(path, facts):
    """Give a pair of files another JSON, with the hash that fits: an edit by who means to."""
    target, beside = portable.pair(path)
    facts = facts | {"sha256": portable.seal(facts, read_npz(target, "is broken", ""))}
    beside.write_text(json.dumps(facts))


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
