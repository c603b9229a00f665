"""A simulated deck: increments of the flexure, by its exact discretisation."""

import numpy as np

from navgym.identification import Correlation
from navgym.inertial.flexure import ARCMIN, FlexureModel

PAPER = FlexureModel.from_correlation_time([10.0, 10.0, 30.0], np.array([6.0, 6.0, 10.0]) * ARCMIN)


def simulate(model, duration, dt, runs=1, seed=0, gyro=0.0):
    """(runs, T, 3) increments of θ over `dt` s, from its long-run law on, plus white noise, rad."""
    rng = np.random.default_rng(seed)
    steps = round(duration / dt)
    transition, noise = model.transition(dt), np.linalg.cholesky(model.process_noise(dt))
    start = np.linalg.cholesky(model.stationary())
    x = np.einsum("aij,raj->rai", start, rng.standard_normal((runs, 3, 2)))
    theta = np.empty((runs, steps + 1, 3))
    theta[:, 0] = x[..., 0]
    for k in range(steps):
        w = np.einsum("aij,raj->rai", noise, rng.standard_normal((runs, 3, 2)))
        x = np.einsum("aij,raj->rai", transition, x) + w
        theta[:, k + 1] = x[..., 0]
    increments = np.diff(theta, axis=1)
    return increments + gyro * rng.standard_normal(increments.shape)


def exact(model, step=0.5, lags=120, duration=300.0):
    """What a record without sampling error would tell."""
    times = step * np.arange(1.0, lags + 1.0)
    return Correlation(
        step, duration, times, model.increment_autocorrelation(times, step),
        model.increment_autocorrelation(0.0, step), np.zeros((0, 3)),
    )  # fmt: skip


def logarithms(model):
    """(3, 3) ln 2μ, ln b², ln σ (columns) per axis (rows)."""
    return np.log(np.column_stack((model.damping, model.stiffness, model.sigma)))


def rms_ln_b(found, truth):
    """(3,) root mean square error of ln b over models."""
    error = np.array([np.log(m.stiffness) - np.log(truth.stiffness) for m in found]) / 2.0
    return np.sqrt(np.mean(error**2, axis=0))
