"""What tests of live filters share: policies made at random, episodes, estimates side by side."""

import numpy as np

from navgym.agents.policies.manifest import Manifest
from navgym.agents.policies.policy import Policy


def some_policy(env, environment, seed=0, bias=None, size=1.0):
    """A random network, its actions times `size`, or a policy whose actions are always `bias`."""
    rng = np.random.default_rng(seed)
    manifest = Manifest.of(environment, env.engine, {"command": "none"})
    n, k = len(manifest.observation_names), len(manifest.action_parameters)
    if bias is not None:
        return Policy(manifest, [(np.zeros((k, n)), np.broadcast_to(bias, k).astype(float))])
    sizes = ((16, n), (k, 16))
    layers = [(rng.normal(size=s) / 2, 0.3 * rng.normal(size=s[0])) for s in sizes]
    layers[-1] = size * layers[-1][0], size * layers[-1][1]
    return Policy(manifest, layers)


def episode(env, policy):
    """Parameters (decisions, P) in force while the policy plays one episode."""
    obs, _ = env.reset(seed=0)
    rows, over = [], False
    while not over:
        obs, _, terminated, truncated, info = env.step(policy(obs))
        rows.append([info[name] for name in env.engine.space.names])
        over = terminated or truncated
    return np.array(rows)


def schedule(space, rows):
    return {name: column.tolist() for name, column in zip(space.names, rows.T, strict=True)}


def stacked(found, name):
    return np.array([getattr(f, name) for f in found])


def parameters(space, found):
    return np.array([space.array(f.parameters)[0] for f in found])
