"""How errors move and what sensors see of them: against finite differences of the navigator itself."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from navgym.ins.batch import InsBatch
from navgym.ins.layout import LAYOUT, STATES
from tests.ins.lanes import correct, lane_at_truth, look, made, metres_at, reckon

BLOCKS = ("R", "V", "PHI", "BG", "BA")
# E4: relative, per block; the two by their short way through the Earth's curvature
LOOSE = {("V", "R"): 3.5e-3, ("PHI", "BA"): 3.3e-4, ("PHI", "V"): 3e-5, ("PHI", "R"): 3e-5}
STEPS = {"R": 1.0, "V": 1e-2, "PHI": 1e-5, "BG": 1e-7, "BA": 1e-4}


@pytest.fixture(scope="module")
def world():
    # a MEMS IMU has biases for which J_R, taken at none, is 5e-5 off
    recording = made(seed=2, duration=31.0, grade="navigation")
    return recording, InsBatch.of([recording])


def moved(world, dx):
    """The nominal after 30 s, from an error dx (n,) at the start; and Φ of each step."""
    recording, batch = world
    lane = lane_at_truth(recording, batch, 0)
    correct(lane, -dx)
    transitions = np.zeros((150, 9, 15))
    reckon(lane, batch.models, batch.tapes[0, 1:151], transitions)
    return lane, transitions


def error_between(one, other):
    """δ of two nominals, (9,)."""
    metres = np.array([*metres_at(other), -1.0])
    position = (one["place"][0] - other["place"][0]) * metres
    turn = (
        Rotation.from_matrix(one["attitude"][0]) * Rotation.from_matrix(other["attitude"][0]).inv()
    )
    return np.concatenate([position, one["v"][0] - other["v"][0], -turn.as_rotvec()])


def test_transitions_over_half_a_minute_are_finite_differences_of_the_navigator(world):
    _, transitions = moved(world, np.zeros(STATES))
    product = np.eye(15)
    for F in transitions:
        product = np.vstack([F, np.eye(15)[9:]]) @ product
    for name in BLOCKS:
        for j in LAYOUT.indices(name):
            dx = np.zeros(STATES)
            dx[j] = STEPS[name]
            ahead, behind = moved(world, dx)[0], moved(world, -dx)[0]
            column = error_between(ahead, behind) / (2.0 * STEPS[name])
            for i, row in enumerate(("R", "V", "PHI")):
                whole = np.abs(product[3 * i : 3 * i + 3, list(LAYOUT.indices(name))]).max()
                off = np.abs(column[3 * i : 3 * i + 3] - product[3 * i : 3 * i + 3, j]).max()
                assert off <= LOOSE.get((row, name), 1.5e-5) * whole, (row, name, off / whole)


@pytest.mark.parametrize("name", ["dvl", "depth", "magnetometer", "fix", "water", "heading"])
def test_what_a_sensor_sees_of_each_error_is_a_finite_difference_of_its_prediction(world, name):
    recording, batch = world
    lane, events, sensors = lane_at_truth(recording, batch, 40), batch.events[0], batch.sensors[0]
    sensors = sensors.copy()
    names = list(recording.model.sensors)
    sensor = names.index("depth" if name == "heading" else name)
    event = events[events["sensor"] == sensor][2:3].copy()
    if name == "heading":
        sensors["kind"][sensor] = 4
    sensors["lever"][sensor] = 1.2, -0.4, 0.3
    event["lag"], event["rate"] = 0.0, (0.02, -0.03, 0.1)
    H = np.zeros((3, STATES))
    look(lane, batch.models, sensors, event, H)
    rows = int(lane["rows"][0])
    assert np.abs(H[:rows]).max() > 0.0
    for j in range(STATES):
        size, seen = 1e-4 if j > 2 else 0.1, []
        for sign in (1.0, -1.0):
            other, dx = lane_at_truth(recording, batch, 40), np.zeros(STATES)
            dx[j] = sign * size
            correct(other, -dx)
            look(other, batch.models, sensors, event, np.zeros((3, STATES)))
            seen.append(other["r"][0, :rows].copy())
        slope = (seen[0] - seen[1]) / (2.0 * size)
        np.testing.assert_allclose(H[:rows, j], slope, atol=3e-6 * max(1.0, np.abs(H).max()))


@pytest.mark.parametrize("name", ["dvl", "depth", "magnetometer", "fix", "water"])
def test_a_measurement_within_a_step_is_predicted_for_its_own_moment(name):
    # without noise, whatever the lag, and with the biases of a bad IMU known
    quiet = {f"{n}_noise": 1e-9 for n in ("depth", "magnetometer", "water")}
    quiet |= {"dvl_noise": (1e-9,) * 3, "fix_noise": (1e-9,) * 3, "current": 0.0}
    recording = made(
        seed=4, duration=20.0, samples_per_step=17, dvl_lever=(0.0, 0.0, 0.0), fix_period=1.0, waves=3.0, **quiet
    )  # fmt: skip
    batch = InsBatch.of([recording])
    sensor = list(recording.model.sensors).index(name)
    lags = set()
    for k in range(10, recording.steps):
        tape = batch.tapes[0, k]
        for e in range(tape["first"], tape["first"] + tape["count"]):
            event = batch.events[0, e : e + 1]
            if event["sensor"][0] != sensor:
                continue
            lane = lane_at_truth(recording, batch, k)
            look(lane, batch.models, batch.sensors[0], event, np.zeros((3, STATES)))
            rows = int(lane["rows"][0])
            # IMU noise over the lag is left
            assert np.abs(lane["r"][0, :rows]).max() < (2e-3 if name != "magnetometer" else 5e-3)
            lags.add(round(float(event["lag"][0]), 3))
    assert len(lags) > 5
