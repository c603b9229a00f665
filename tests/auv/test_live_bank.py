"""The bank sample by sample: what `estimate` makes of the whole, and what happens when it is lost."""

import dataclasses
from decimal import Decimal

import numpy as np
import pytest

import navgym


def uneven(seed=0, steps=60, apart=False):
    """A recording at uneven times, and the function that makes its models."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.choice([0.2, 1.0, 1.7, 40.0], steps))
    y = np.cumsum(rng.standard_normal((steps, 4)), axis=0)
    y[rng.random((steps, 4) if apart else (steps, 1)).repeat(1 if apart else 4, 1) < 0.3] = np.nan
    dt = np.diff(time, prepend=time[0] - 1.0)
    model = navgym.LinearModel.white_acceleration(dt, 0.3, x0=np.zeros(4))

    def made(step):
        return navgym.LinearModel.white_acceleration(step, 0.3, x0=np.zeros(4))

    return navgym.Recording(time, y, model=model), made


def agree(live, recording, wanted):
    found = list(live.follow(recording))
    for name, own in (("state", "states"), ("covariance", "covariances"), ("nis", "nis")):
        np.testing.assert_allclose(
            np.array([getattr(e, name) for e in found]), getattr(wanted, own), rtol=1e-9, atol=1e-12
        )
    weights = np.array([e.weights for e in found])
    np.testing.assert_allclose(weights, wanted.extras["weights"], rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("name", ["bank", "imm_wide"])
@pytest.mark.parametrize("scenario", ["auv/switch-D", "auv/component-loss", "auv/position-only"])
def test_sample_by_sample_is_what_estimate_makes_of_the_whole(name, scenario):
    recording = navgym.simulate(scenario, 3, steps=80, loss=0.3)
    own = {"process_noise_scale": 2.0}
    agree(
        navgym.LiveBank(recording.model, own, name), recording,
        navgym.estimate(name, recording, own),
    )  # fmt: skip


@pytest.mark.parametrize("apart", [False, True])
def test_steps_of_any_length_are_those_of_a_recording(apart):
    recording, made = uneven(apart=apart)
    wanted = navgym.estimate("bank", recording)
    agree(navgym.LiveBank(recording.model), recording, wanted)
    agree(navgym.LiveBank(made), recording, wanted)


def test_it_begins_anew_where_it_is_lost_and_follows():
    """A vehicle that is carried off by 100 km: within some samples the bank is with it."""
    recording = navgym.simulate("auv/nominal", 4, steps=200, loss=0.0)
    y = recording.measurements.copy()
    y[100:, [0, 2]] += 1e5
    live = navgym.LiveBank(recording.model)
    found = list(live.follow(dataclasses.replace(recording, measurements=y)))
    off = np.array([e.state for e in found[150:]]) - recording.truth[150:]
    assert np.abs(off[:, [0, 2]] - 1e5).max() < 5.0
    live.reset()
    again = list(live.follow(recording))
    assert live.restarts == 0
    np.testing.assert_array_equal(again[99].state, found[99].state)


def test_numbers_that_break_it_do_not_end_it():
    live = navgym.LiveBank(navgym.LinearModel())
    truth = navgym.simulate("auv/nominal", 1, loss=0.0).measurements
    for y in truth[:20]:
        live.step(y)
    broken = live.step(np.full(4, 1e200))
    assert broken.diverged
    assert live.restarts == 1
    for y in truth[21:60]:
        found = live.step(y)
    assert np.abs(found.state - truth[59]).max() < 6.0


def test_a_clock_may_be_exact_and_may_be_set():
    live, plain = (navgym.LiveBank(navgym.LinearModel.white_acceleration) for _ in range(2))
    y = np.ones(4)
    for k in range(1, 6):
        live.step(y, time=Decimal("1764000000.1") + k)
        wanted = plain.step(y, time=float(k))
    live.restart_clock()
    found = live.step(y, time=Decimal(7))
    np.testing.assert_allclose(found.state, plain.step(y).state, rtol=1e-9)
    assert wanted.time == 5.0


def test_bad_input_is_told_and_changes_nothing():
    live = navgym.LiveBank(navgym.LinearModel())
    live.step(np.ones(4), time=1.0)
    before = live.step(np.ones(4), time=2.0).state
    for bad, message in (
        ({"measurement": np.ones(3)}, r"measurement must have shape \(4,\)"),
        ({"measurement": [np.inf, 0, 0, 0]}, "finite or NaN"),
        ({"measurement": np.ones(4), "time": 1.5}, "time must be finite and increase"),
        ({"measurement": np.ones(4), "time": 9.0}, "the model is made for steps of 1 s"),
    ):
        with pytest.raises(ValueError, match=message):
            live.step(**bad)
    other = navgym.LiveBank(navgym.LinearModel())
    for _ in range(2):
        other.step(np.ones(4))
    np.testing.assert_array_equal(live.step(np.ones(4)).state, other.step(np.ones(4)).state)
    assert before.shape == (4,)
    with pytest.raises(ValueError, match="unknown filter_name 'qivbf'"):
        navgym.LiveBank(navgym.LinearModel(), filter_name="qivbf")
