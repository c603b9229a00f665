"""A live lane that fails: outliers are left out, jumps are followed, neither costs more than ten samples."""

import numpy as np
import pytest

import navgym
from navgym import agents
from navgym.auv.kernels import AGREEING

JUMP, RECOVERY = 300, 10
SIGMAS = np.array([1.0, 0.1, 1.0, 0.1])  # what the model believes of px, vx, py, vy


def voyage(steps=600, seed=0, noise=1.0, acceleration=0.1):
    """Truth (T, 4) at 1 Hz under white acceleration, measurements (T, 4), and the generator."""
    rng = np.random.default_rng(seed)
    state, truth = np.array([0.0, 1.0, 0.0, 0.5]), np.zeros((steps, 4))
    # a second's share of position, given that of velocity: mean half of it, variance a²/12
    for k in range(steps):
        for i in (0, 2):
            push = acceleration * rng.normal()
            state[i] += state[i + 1] + push / 2 + acceleration / 12**0.5 * rng.normal()
            state[i + 1] += push
        truth[k] = state
    return truth, truth + noise * SIGMAS * rng.normal(size=truth.shape), rng


def model(rows, dt=1.0):
    whole = navgym.LinearModel.white_acceleration(dt)
    R = np.diag(SIGMAS[rows] ** 2)
    return navgym.LinearModel(dt=dt, H=np.eye(4)[rows], Q=whole.Q, R=R)


def live(truth, measurements, rows):
    """Position errors (T,) of the shipped policy's filter, m, and the filter."""
    tuned = agents.SelfTuningFilter("qivbf", agents.shipped("auv"), model(rows))
    states = np.array([tuned.step(y).state for y in measurements[:, rows]])
    return _miss(states, truth), tuned


def plain(truth, measurements, rows):
    """The same of the plain Kalman filter."""
    time = np.arange(len(truth)) + 1.0
    recording = navgym.Recording(time, measurements[:, rows], model=model(rows))
    return _miss(navgym.estimate("kf", recording).states, truth)


def _miss(states, truth):
    return np.hypot(*(states - truth)[:, [0, 2]].T)


EVERYTHING, FIXES = [0, 1, 2, 3], [0, 2]


each_log = pytest.mark.parametrize("rows", [EVERYTHING, FIXES], ids=["all", "fixes"])


@each_log
class TestOutliers:
    def test_one_of_a_kilometre_is_left_out(self, rows):
        truth, y, _ = voyage()
        y[JUMP, 0] += 1000.0
        miss, tuned = live(truth, y, rows)
        assert tuned.restarts == 0
        assert miss.max() < 6.0

    @pytest.mark.parametrize("length", [2, 3, AGREEING - 1])
    def test_so_is_a_burst_that_is_shorter_than_what_is_believed(self, rows, length):
        truth, y, rng = voyage()
        y[100 : 100 + length, [0, 2]] += [1000.0, -400.0]  # alike
        y[JUMP : JUMP + length, [0, 2]] += 1000.0 * rng.normal(size=(length, 2))
        miss, tuned = live(truth, y, rows)
        assert tuned.restarts == 0
        assert miss.max() < 10.0

    def test_two_in_a_thousand_of_a_kilometre(self, rows):
        truth, y, rng = voyage(3000)
        wild = rng.random(len(y)) < 0.002
        y[wild] += 1000.0 * rng.normal(size=(wild.sum(), 4)) * [1, 0, 1, 0]
        miss, tuned = live(truth, y, rows)
        assert wild.sum() > 3
        assert tuned.restarts == 0
        assert miss.max() < 15.0
        # a plain filter that never saw them
        y[wild] = np.nan
        assert np.sqrt((miss**2).mean()) < 1.5 * np.sqrt((plain(truth, y, rows) ** 2).mean())


@each_log
class TestJumps:
    @pytest.mark.parametrize("far", [1000.0, 1e5])
    @pytest.mark.parametrize("noise", [300**-0.5, 1.0, 300**0.5])
    def test_a_vehicle_that_is_elsewhere_is_found_when_five_samples_agree(self, rows, noise, far):
        truth, y, _ = voyage(noise=noise)
        for values in (truth, y):
            values[JUMP:, 0] += far
        miss, tuned = live(truth, y, rows)
        assert tuned.restarts == 1
        assert miss[JUMP + AGREEING - 1 :].max() < max(10.0, 5.0 * noise)

    def test_a_burst_that_is_longer_is_believed_and_left_again(self, rows):
        truth, y, _ = voyage()
        y[JUMP : JUMP + 12, [0, 2]] += [1000.0, 500.0]
        miss, tuned = live(truth, y, rows)
        assert tuned.restarts == 2
        assert miss[JUMP + 12 + AGREEING :].max() < 10.0

    def test_outliers_beside_a_jump_do_not_hide_it(self, rows):
        truth, y, rng = voyage(900)
        wild = rng.random(len(y)) < 0.02
        y[wild] += 1000.0 * rng.normal(size=(wild.sum(), 4)) * [1, 0, 1, 0]
        for values in (truth, y):
            values[JUMP:, 0] += 1000.0
        miss, _ = live(truth, y, rows)
        assert miss[JUMP + RECOVERY :].max() < 20.0

    def test_losses_beside_a_jump_only_delay_it(self, rows):
        truth, y, rng = voyage(900)
        y[rng.random(y.shape) < 0.5] = np.nan
        for values in (truth, y):
            values[JUMP:, 0] += 1000.0
        miss, _ = live(truth, y, rows)
        heard = np.flatnonzero(np.isfinite(y[JUMP:, 0]))[AGREEING]
        assert miss[JUMP + heard + 1 :].max() < 30.0


@each_log
class TestWrongModels:
    @pytest.mark.parametrize("noise", [300**-0.5, 300**0.5])
    def test_noise_that_is_not_the_models_is_no_lost_track(self, rows, noise):
        truth, y, rng = voyage(1500, noise=noise)
        wild = rng.random(len(y)) < 0.002
        y[wild] += 1000.0 * rng.normal(size=(wild.sum(), 4)) * [1, 0, 1, 0]
        miss, tuned = live(truth, y, rows)
        assert wild.any()
        assert tuned.restarts == 0
        assert miss[50:].max() < max(10.0, 5.0 * noise)

    @pytest.mark.parametrize("acceleration", [0.001, 3.0])
    def test_wrong_process_noise_does_not_lose_it(self, rows, acceleration):
        truth, y, _ = voyage(acceleration=acceleration)
        miss, _ = live(truth, y, rows)
        assert np.sqrt((miss[50:] ** 2).mean()) < (2.0 if acceleration < 1.0 else 40.0)

    @pytest.mark.parametrize("seed", [0, 1, 2])
    def test_ten_minutes_without_anything(self, rows, seed):
        truth, y, _ = voyage(1500, seed)
        y[JUMP : JUMP + 600] = np.nan
        miss, _ = live(truth, y, rows)
        after = miss[JUMP + 600 + RECOVERY :]
        assert after.max() < 10.0
        kalman = plain(truth, y, rows)[JUMP + 600 + RECOVERY :]
        assert np.sqrt((after**2).mean()) < 2.0 * np.sqrt((kalman**2).mean())


@pytest.mark.parametrize("where", [0, 1, 3, 60])
def test_a_restart_at_any_sample_goes_on(where):
    truth, y, _ = voyage(200)
    for values in (truth, y):
        values[where:, 2] -= 5e3
    miss, _ = live(truth, y, EVERYTHING)
    assert miss[where + RECOVERY :].max() < 10.0


def test_a_number_that_breaks_everything_is_a_lost_one():
    truth, y, _ = voyage(200)
    broken = y.copy()
    broken[100] = 1e200
    y[100] = np.nan
    tuned = [
        agents.SelfTuningFilter("qivbf", agents.shipped("auv"), model(EVERYTHING)) for _ in "ab"
    ]
    found = [
        [t.step(row).state for row in rows] for t, rows in zip(tuned, (broken, y), strict=True)
    ]
    np.testing.assert_array_equal(found[0][100], found[1][100])
    assert _miss(np.array(found[0]), truth).max() < 10.0
    assert tuned[0].restarts == 1
