"""The INS sample by sample: late measurements, and what is refused."""

import numpy as np
import pytest

from navgym.envs.live import CONTROLLED
from navgym.ins.live import LiveINS
from navgym.ins.settings import INSDropoutSettings
from tests.ins.lanes import made


def followed(recording, model=None):
    """States after each step, and the lane."""
    lane = LiveINS(INSDropoutSettings(), {}, model or recording.model, recording.interval)
    found = []
    for sample, time, _ in lane.samples(recording):
        lane.put(sample, None, time)
        if lane.ready():
            assert lane.step(look=True) == 0
            found.append(lane.answer(CONTROLLED)[0])
    return np.array(found), lane


def test_what_arrives_late_ends_where_what_came_in_order_ends():
    late = made(seed=3, duration=12.0, fix_period=4.0, fix_latency=1.3)
    prompt = made(seed=3, duration=12.0, fix_period=4.0)
    one, _ = followed(late)
    other, _ = followed(prompt)
    # fixes of 4 and 8 s arrive at 5.3 and 9.3 s
    heard = np.round(np.r_[4.0, 5.3, 8.0, 9.3] / 0.2).astype(int)
    np.testing.assert_array_equal(one[: heard[0] - 1], other[: heard[0] - 1])
    assert np.abs(one[heard[0] : heard[1] - 1] - other[heard[0] : heard[1] - 1]).max() > 1e-3
    np.testing.assert_array_equal(one[heard[1] : heard[2] - 1], other[heard[1] : heard[2] - 1])
    np.testing.assert_array_equal(one[heard[3] : 59], other[heard[3] : 59])


class TestBadInput:
    @pytest.fixture
    def lane(self):
        lane = LiveINS(INSDropoutSettings(), {}, made(duration=4.0).model, 0.01)
        lane.put(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.098]]), None, 1.0)
        return lane

    @pytest.mark.parametrize(
        ("sample", "time", "told"),
        [
            ([1.0, 2.0], 1.01, "shape"),
            ({"imu": np.full((2, 3), np.inf)}, 1.01, "mark it as lost"),
            ({"imu": np.zeros((2, 3)), "sonar": 1.0}, 1.01, "unknown sensor"),
            ({"imu": np.zeros((2, 3)), "dvl": [1.0]}, 1.01, "3 finite numbers"),
            ({"imu": np.zeros((2, 3)), "dvl": ([1.0, 0.0, 0.0], 3.0)}, 1.01, "one clock"),
            (np.zeros((2, 3)), 1.5, "restart_clock"),
        ],
    )
    def test_a_sample_that_cannot_be_is_refused_and_changes_nothing(self, lane, sample, time, told):
        with pytest.raises(ValueError, match=told):
            lane.put(sample, None, time)
        assert lane.time == 1.0
        lane.put(np.zeros((2, 3)), None, 1.01)

    def test_a_model_of_another_kind_is_refused(self):
        with pytest.raises(TypeError, match="InsModel"):
            LiveINS(INSDropoutSettings(), {}, object())
