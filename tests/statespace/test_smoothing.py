"""`navgym.smooth` on linear models: the dense solution of the whole recording at once."""

from __future__ import annotations

import numpy as np
import pytest

import navgym
from navgym.metrics.consistency import nees


def whole(recording, model, q, r):
    """Means and covariances of every state given every measurement, by one system of equations."""
    T, n = len(recording), model.n
    information, weighted = np.zeros((T * n, T * n)), np.zeros(T * n)
    packed = model.pack()
    k_of = lambda k: packed[min(k, len(packed) - 1)]  # noqa: E731
    first = k_of(0)
    mean = first["F"] @ first["x0"]
    P = first["F"] @ first["P0"] @ first["F"].T + q[0] * first["Q"]
    for k in range(T):
        own, now = slice(k * n, (k + 1) * n), k_of(k)
        if k == 0:
            information[own, own] += np.linalg.inv(P)
            weighted[own] += np.linalg.solve(P, mean)
        else:
            before = slice((k - 1) * n, k * n)
            A = np.hstack([-now["F"], np.eye(n)])
            both = np.r_[np.arange(before.start, before.stop), np.arange(own.start, own.stop)]
            information[np.ix_(both, both)] += A.T @ np.linalg.solve(q[k] * now["Q"], A)
        heard = ~recording.lost[k]
        if heard.any():
            H, R = now["H"][heard], r * now["R"][np.ix_(heard, heard)]
            information[own, own] += H.T @ np.linalg.solve(R, H)
            weighted[own] += H.T @ np.linalg.solve(R, recording.measurements[k][heard])
    covariance = np.linalg.inv(information)
    states = (covariance @ weighted).reshape(T, n)
    return states, np.stack(
        [covariance[k * n : (k + 1) * n, k * n : (k + 1) * n] for k in range(T)]
    )


def test_kf_smoothed_is_the_dense_solution():
    generator = np.random.default_rng(5)
    T = 40
    time = np.cumsum(generator.uniform(0.2, 8.0, T))
    model = navgym.LinearModel(
        dt=np.diff(time, prepend=time[0] - 1.0), R=np.diag([9.0, 0.1, 4.0, 0.1])
    )
    y = np.cumsum(generator.normal(size=(T, 4)), axis=0)
    lost = generator.random((T, 4)) < 0.4
    recording = navgym.Recording(measurements=y, lost=lost, time=time, model=model)
    q = np.repeat([1.0, 30.0, 0.2, 5.0], 10)
    schedule = {"process_noise_scale": q[::10].tolist(), "measurement_noise_scale": 2.0}
    found = navgym.smooth("kf", recording, schedule, decision_interval=10)
    states, covariances = whole(recording, model, q, 2.0)
    np.testing.assert_allclose(found.states, states, rtol=1e-9, atol=1e-9 * np.abs(states).max())
    np.testing.assert_allclose(found.covariances, covariances, atol=1e-9 * covariances.max())
    filtered = navgym.estimate("kf", recording, schedule, decision_interval=10)
    np.testing.assert_array_equal(found.states[-1], filtered.states[-1])
    np.testing.assert_array_equal(found.innovations, filtered.innovations)


def test_smoothed_errors_are_smaller_and_as_large_as_told():
    """With the true noise the normalised error squared has mean 1, in switching seas as well."""
    told, gain = [], []
    for seed in navgym.seeds("train", 20):
        recording = navgym.simulate("auv/switch-D", seed)
        after, before = navgym.smooth("oracle", recording), navgym.estimate("oracle", recording)
        told.append(
            nees(after.states[None], after.covariances[None], recording.truth[None]).mean() / 4
        )
        error = [((e.states - recording.truth)[:, [0, 2]] ** 2).mean() for e in (after, before)]
        gain.append(error[0] / error[1])
    assert np.mean(told) == pytest.approx(1.0, abs=0.06)
    assert np.mean(gain) < 0.7


def test_who_cannot_be_smoothed_says_who_can():
    recording = navgym.simulate("auv/nominal", 1, steps=20)
    with pytest.raises(ValueError, match=r"'bank' cannot be smoothed; .* can: kf, oracle"):
        navgym.smooth("bank", recording)
    turn = navgym.simulate("auv/coordinated-turn", 1, steps=20)
    with pytest.raises(ValueError, match="LinearModel"):
        navgym.smooth("kf", turn)
    with pytest.raises(TypeError, match="recording"):
        navgym.smooth("kf", "track.csv")


def test_a_filter_that_has_failed_is_told_as_it_is():
    y = np.zeros((30, 4))
    y[10:, 0] = np.where(np.arange(20) % 2, 1.7e308, -1.7e308)
    recording = navgym.Recording(np.arange(1.0, 31.0), y, model=navgym.LinearModel())
    found, filtered = navgym.smooth("kf", recording), navgym.estimate("kf", recording)
    assert filtered.diverged
    assert np.isnan(filtered.states).any()
    np.testing.assert_array_equal(found.states, filtered.states)
