"""Linear models: defaults of the paper, packing, and what is no model."""

import copy
import dataclasses
import pickle
import re

import numpy as np
import pytest

from navgym import CoordinatedTurnModel, LinearModel
from navgym.statespace.models import constant_velocity
from navgym.statespace.recording import model_from_arrays

NAN = np.nan


def test_defaults_are_table_2_of_the_paper():
    model = LinearModel()
    assert (model.n, model.m, model.steps) == (4, 4, None)
    np.testing.assert_array_equal(model.F, np.eye(4) + np.diag([1.0, 0.0, 1.0], 1))
    np.testing.assert_array_equal(model.Q, 1e-3 * np.diag([1, 0.5, 1, 0.5]))
    for field in ("H", "R", "P0"):
        np.testing.assert_array_equal(getattr(model, field), np.eye(4))
    np.testing.assert_array_equal(model.x0, [0, 1, 0, 1])
    assert (model.position, model.velocity) == ((0, 2), (1, 3))


def test_constant_velocity_moves_by_its_velocity():
    x = constant_velocity(2.5) @ [1.0, 3.0, -1.0, 4.0]
    np.testing.assert_array_equal(x, [8.5, 3.0, 9.0, 4.0])


def test_steps_of_a_track_compose():
    F = constant_velocity([0.5, 2.0])
    np.testing.assert_allclose(F[1] @ F[0], constant_velocity(2.5))


def test_white_acceleration_is_that_of_a_track_pushed_for_a_step():
    """Q is the covariance of [dt²/2, dt] a; over N short steps it adds up as F carries it."""
    model = LinearModel.white_acceleration(2.0, acceleration=0.3, velocity_noise=None)
    push = 0.3 * np.array([2.0, 2.0])
    np.testing.assert_allclose(model.Q[:2, :2], np.outer(push, push))
    assert model.m == 2
    stacked = LinearModel.white_acceleration([1.0, 2.0])
    np.testing.assert_allclose(stacked.Q[1] / 0.01, model.Q / 0.09)
    np.testing.assert_allclose(np.diag(stacked.R), [1.0, 0.01, 1.0, 0.01])


@pytest.mark.parametrize("steps", [None, 3])
def test_packing_keeps_every_matrix(steps):
    rng = np.random.default_rng(0)
    shape = (3, 3) if steps is None else (steps, 3, 3)
    model = LinearModel(F=rng.standard_normal(shape), H=rng.standard_normal((2, 3)))
    packed = model.pack()
    assert packed.shape == (steps or 1,)
    for field in ("F", "H", "Q", "R", "x0", "P0"):
        np.testing.assert_array_equal(packed[field], np.broadcast_to(
            getattr(model, field), packed[field].shape
        ))  # fmt: skip


def test_rows_that_copy_a_state_are_found():
    H = [[0, 1, 0], [0, 2, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1e-9], [0, 0, 0]]
    np.testing.assert_array_equal(
        LinearModel(F=np.eye(3), H=H).pack()["rows"][0], [1, -1, -1, 2, -1, -1]
    )


def test_noise_free_measurements_follow_h():
    rng = np.random.default_rng(0)
    H, x = rng.standard_normal((5, 2, 3)), rng.standard_normal((5, 3))
    np.testing.assert_allclose(LinearModel(F=np.eye(3), H=H[0]).observe(x), x @ H[0].T)
    np.testing.assert_allclose(
        LinearModel(F=np.eye(3), H=H).observe(x), [h @ v for h, v in zip(H, x, strict=True)]
    )


def test_arrays_are_copied_and_read_only():
    R = np.eye(4)
    model = LinearModel(R=R)
    R[:] = 5.0
    np.testing.assert_array_equal(model.R, np.eye(4))
    with pytest.raises(ValueError, match="read-only"):
        model.R[0, 0] = 2.0


def test_a_semidefinite_process_noise_is_allowed():
    LinearModel(Q=np.diag([1.0, 0.0, 1.0, 0.0]))


BAD = [
    ({"F": np.zeros((2, 3))}, "F", "(2, 3)"),
    ({"F": np.zeros((0, 0))}, "F", "(0, 0)"),
    ({"F": np.eye(4), "dt": 1.0}, "F or dt", "1.0"),
    ({"H": np.eye(3)}, "H", "(3, 3)"),
    ({"H": np.zeros((0, 4))}, "H", "(0, 4)"),
    ({"Q": np.eye(3)}, "Q", "(3, 3)"),
    ({"Q": -np.eye(4)}, "Q", "-1"),
    ({"Q": np.eye(4) + np.eye(4, k=1)}, "Q", "(Q + Q.T) / 2"),
    ({"R": np.zeros((4, 4))}, "R", "smallest eigenvalue is 0"),
    ({"R": np.ones((4, 4))}, "R", "smallest eigenvalue"),
    ({"R": np.eye(4) * NAN}, "R", "nan at index (0, 0)"),
    ({"P0": np.diag([1.0, 1.0, 1.0, 0.0])}, "P0", "positive definite"),
    ({"P0": np.tile(np.eye(4), (3, 1, 1))}, "P0", "(3, 4, 4)"),
    ({"x0": [1.0, 2.0]}, "x0", "(2,)"),
    ({"x0": [1.0, 2.0, 3.0, NAN]}, "x0", "nan at index (3,)"),
    ({"x0": "abcd"}, "x0", "'abcd'"),
    ({"x0": list("1234")}, "x0", "text: turn it into numbers first"),
    ({"x0": np.array(["1", 2, 3, 4], object)}, "x0", "text: turn it into numbers first"),
    ({"x0": [1j, 0, 0, 0]}, "x0", "take their real part"),
    ({"dt": np.array([1, 2], "m8[s]")}, "dt", "durations: turn them into seconds"),
    ({"Q": [[1.0], [1.0, 2.0]]}, "Q", "make its rows equally long"),
    ({"dt": 0.0}, "dt", "0.0"),
    ({"dt": [1.0, -1.0]}, "dt", "-1.0"),
    ({"dt": NAN}, "dt", "nan"),
    ({"dt": "x"}, "dt", "'x'"),
    ({"dt": np.ones(3), "R": np.tile(np.eye(4), (4, 1, 1))}, "F, H, Q, R", "{3, 4}"),
    ({"position": (0, 7)}, "position", "(0, 7)"),
    ({"velocity": (1, 1)}, "velocity", "(1, 1)"),
    ({"position": "ab"}, "position", "'ab'"),
    ({"position": (0.5,)}, "position", "(0.5,)"),
]


@pytest.mark.parametrize(("fields", "field", "value"), BAD)
def test_bad_fields_are_refused_by_name_and_value(fields, field, value):
    with pytest.raises(ValueError, match=re.escape(field)) as caught:
        LinearModel(**fields)
    assert value in str(caught.value)


@pytest.mark.parametrize("dt", [0.5, [1.0, 2.0, 0.5]])
def test_a_model_made_from_a_step_can_be_changed_and_keeps_the_step(dt):
    changed = dataclasses.replace(LinearModel(dt=dt), R=4.0 * np.eye(4))
    for model in (changed, model_from_arrays(changed.arrays())):
        np.testing.assert_array_equal(model.dt, dt)
        np.testing.assert_array_equal(model.F, constant_velocity(dt))
        np.testing.assert_array_equal(model.R, 4.0 * np.eye(4))
    with pytest.raises(ValueError, match="replace both"):
        dataclasses.replace(changed, dt=7.0)


@pytest.mark.parametrize(
    "again", [copy.copy, copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))]
)
@pytest.mark.parametrize("model", [LinearModel(dt=2.0), CoordinatedTurnModel()], ids=["cv", "turn"])
def test_copies_and_pickles_stay_read_only(model, again):
    for name, value in vars(again(model)).items():
        assert not isinstance(value, np.ndarray) or not value.flags.writeable, name
        np.testing.assert_array_equal(value, getattr(model, name))
