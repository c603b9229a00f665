"""Filters that adapt, at any rate, after any gap, and with measurements that repeat one another."""

import numpy as np
import pytest

import navgym
from navgym.statespace.filters import qivbf
from navgym.statespace.filters.catalogue import CATALOGUE
from tests.helpers import run_family

VARIATIONAL = ["vbakf", "qivbf"]
SOUND = [name for name in CATALOGUE if name not in ("qivbf_printed", "oracle", "kf_zero")]


def vb_lane(recording, rho=0.97):
    """The lane of the variational filter after its last sample."""
    return run_family(qivbf, recording, (5, 5.0, rho, 5.0, 1.0, 1.0, 0, 1.0))["lane"]


def late(rate, delay=0.5, radius=50.0, speed=10.0):
    """A car on a circle whose fixes are good and whose velocity comes late: (recording, truth).

    The model knows of neither: it holds the fixes for ten times worse than they are.
    """
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 120.0, 1.0 / rate)
    angle, before = speed / radius * time, speed / radius * (time - delay)
    place = radius * np.stack([np.sin(angle), -np.cos(angle)], 1)
    velocity = speed * np.stack([np.cos(before), np.sin(before)], 1)
    fix = place + 0.3 * rng.normal(size=place.shape)
    velocity = velocity + 0.05 * rng.normal(size=place.shape)
    y = np.stack([fix, velocity], 2).reshape(len(time), 4)
    model = navgym.LinearModel.white_acceleration(1.0 / rate, 2.0, 3.0, 0.5, x0=[0, 10, -50, 0])
    return navgym.Recording(time, y, model=model), place


@pytest.mark.parametrize("rate", [5, 10, 20, 50])
def test_errors_that_last_over_many_samples_do_not_outvote_everything_else(rate):
    """Memory in samples had these kilometres off: a biased velocity that agrees with itself."""
    recording, place = late(rate)
    error = {
        name: np.linalg.norm(navgym.estimate(name, recording).states[:, [0, 2]] - place, axis=1)
        for name in ("kf", "bank", *VARIATIONAL)
    }
    for name in ("bank", *VARIATIONAL):
        assert not navgym.estimate(name, recording).diverged
        assert np.sqrt((error[name] ** 2).mean()) < 2.0 * np.sqrt((error["kf"] ** 2).mean())
        assert error[name].max() < 10.0


@pytest.mark.parametrize("dt", [0.02, 0.25, 1.0])
def test_what_is_forgotten_is_told_per_second(dt):
    """ν settles where ρ^dt ν + dt = ν: near 1/(1 − ρ) seconds, whatever the rate."""
    model = navgym.LinearModel(dt=dt)
    time = np.arange(1, int(400 / dt) + 1) * dt
    y = np.random.default_rng(0).normal(size=(len(time), 4))
    count = vb_lane(navgym.Recording(time, y, model=model))["count"]
    assert count == pytest.approx(dt / (1.0 - 0.97**dt), rel=1e-3)
    assert count == pytest.approx(1.0 / (1.0 - 0.97), rel=0.02)


@pytest.mark.parametrize("name", SOUND)
@pytest.mark.parametrize("gap", [300, 1800])
def test_the_first_fixes_after_a_gap_in_time_are_taken(name, gap):
    """The prior is wide then, and rightly so: it is no reason to distrust the fix."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        time = np.arange(300.0 + gap + 30.0)
        velocity = 1.0 + 0.05 * rng.normal(size=(len(time), 2)).cumsum(axis=0)
        place = velocity.cumsum(axis=0)
        y = np.stack([place, velocity], 2).reshape(len(time), 4)
        y = y + rng.normal(size=y.shape) * [1.0, 0.1, 1.0, 0.1]
        kept = (time < 300.0) | (time >= 300.0 + gap)
        model = navgym.LinearModel.white_acceleration(np.diff(time[kept], prepend=-1.0))
        found = navgym.estimate(name, navgym.Recording(time[kept], y[kept], model=model))
        error = np.linalg.norm(found.states[:, [0, 2]] - place[kept], axis=1)
        assert error[300:].max() < 5.0
        assert not found.diverged


S, C = 0.35355, 0.86603
BEAMS = np.array([[S, S, C, 0], [-S, S, C, 0], [-S, -S, C, 0], [S, -S, C, 0]])  # a state unseen
TWICE = np.array([[1.0, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0]])


@pytest.mark.parametrize("dt", [0.1, 1.0])
@pytest.mark.parametrize("H", [BEAMS, TWICE], ids=["four beams", "one sensor in two columns"])
def test_measurements_that_repeat_one_another_never_make_noise_singular(H, dt):
    """What they have in common errs by nothing: R̂ falls there to 1e-6 of the model's R, and stays."""
    n, steps = H.shape[1], 100_000
    rng = np.random.default_rng(0)
    state = 0.02 * rng.normal(size=(steps, n)).cumsum(axis=0)
    y = (state + 0.03 * rng.normal(size=(steps, n))) @ H.T
    R = 9e-4 * np.diag([1.0, 2.0, 3.0, 4.0])
    model = navgym.LinearModel(F=np.eye(n), H=H, Q=4e-4 * np.eye(n), R=R)
    recording = navgym.Recording(np.arange(1.0, steps + 1) * dt, y, model=model)
    for name in VARIATIONAL:
        found = navgym.estimate(name, recording)
        assert np.isfinite(found.states).all()
        assert not found.diverged
        rank = np.linalg.matrix_rank(H)
        seen = np.linalg.pinv(H) @ H  # what H does not see wanders
        off = ((found.states - state) @ seen)[1000:]
        assert np.sqrt((off**2).sum(1).mean() / rank) < 0.06
    whitened = vb_lane(recording)["R"] / np.sqrt(np.outer(np.diag(R), np.diag(R)))
    least = np.linalg.eigvalsh(whitened).min()
    assert 0.99e-6 < least < 2e-6


def test_noise_is_found_within_its_bounds_and_no_further():
    """True noise of 1e-8 and of 1e6 times the model's R: R̂ ends at 1e-6 and at 1e4 of it."""
    rng = np.random.default_rng(0)
    model = navgym.LinearModel(F=[[1.0]], Q=[[1e-14]], R=[[1.0]], P0=[[1e-6]])
    noise = {}
    for share in (1e-8, 1.0, 1e6):
        y = share**0.5 * rng.normal(size=(3000, 1))
        recording = navgym.Recording(np.arange(3000.0), y, model=model)
        noise[share] = vb_lane(recording, 0.99)["R"][0, 0]
    assert noise[1e-8] == pytest.approx(1e-6, rel=0.2)
    assert noise[1.0] == pytest.approx(1.0, rel=0.5)
    assert noise[1e6] == pytest.approx(1e4, rel=1e-6)
