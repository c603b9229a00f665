"""Linear models: defaults of the paper, packing, and what is no model."""

import copy
import dataclasses
import pickle
import re

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

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


def test_white_acceleration_is_a_wandering_velocity_and_its_integral():
    """A Wiener process of density a²: its variance is a² t, that of its integral a² t³/3."""
    model = LinearModel.white_acceleration(2.0, acceleration=0.3, velocity_noise=None)
    wanted = 0.09 * np.array([[8.0 / 3.0, 2.0], [2.0, 2.0]])
    for axis in (slice(0, 2), slice(2, 4)):
        np.testing.assert_allclose(model.Q[axis, axis], wanted)
    assert not model.Q[:2, 2:].any()
    assert model.m == 2
    stacked = LinearModel.white_acceleration([1.0, 2.0])
    np.testing.assert_allclose(stacked.Q[1] / 0.01, model.Q / 0.09)
    np.testing.assert_allclose(np.diag(stacked.R), [1.0, 0.01, 1.0, 0.01])


def test_a_transition_of_ones_own_takes_nothing_from_table_2():
    """Four states need not be positions and velocities."""
    model = LinearModel(F=np.eye(4))
    np.testing.assert_array_equal(model.x0, np.zeros(4))
    for field in ("Q", "H", "R", "P0"):
        np.testing.assert_array_equal(getattr(model, field), np.eye(4))
    assert (model.position, model.velocity, model.dt) == ((0, 1, 2, 3), (), None)
    assert LinearModel(F=np.eye(2)).position == (0, 1)
    both = LinearModel(F=constant_velocity(2.0), dt=2.0)  # is that of the paper, over its step
    np.testing.assert_array_equal(both.Q, LinearModel(dt=2.0).Q)
    assert both.position == (0, 2)


# what changes over time, in continuous time


def stable(rng, n):
    """A drift (1/s) that decays in every direction, and a density of full or lesser rank."""
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.05) * np.eye(n)
    root = rng.standard_normal((n, rng.integers(1, n + 1)))
    return A, root @ root.T


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_a_model_in_continuous_time_is_its_integral(n):
    """Q = ∫ e^{As} D e^{Aᵀs} ds by quadrature, F = e^{At}."""
    A, D = stable(np.random.default_rng(n), n)
    for dt in (0.01, 0.7, 4.0):
        model = LinearModel.from_continuous(A, D, dt)
        wanted, _ = scipy.integrate.quad_vec(
            lambda s: scipy.linalg.expm(A * s) @ D @ scipy.linalg.expm(A * s).T, 0.0, dt,
            epsabs=0.0, epsrel=1e-11,
        )  # fmt: skip
        np.testing.assert_allclose(model.F, scipy.linalg.expm(A * dt), rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(model.Q, wanted, rtol=1e-9, atol=1e-11 * wanted.max())


def test_a_model_in_continuous_time_follows_small_steps():
    """Ten thousand steps of Euler come within their own error of it."""
    A, D = stable(np.random.default_rng(7), 3)
    N = 10_000
    step, Q = np.eye(3) + A * 2.0 / N, np.zeros((3, 3))
    for _ in range(N):
        Q = step @ Q @ step.T + D * 2.0 / N
    model = LinearModel.from_continuous(A, D, 2.0)
    np.testing.assert_allclose(model.F, np.linalg.matrix_power(step, N), atol=1e-3)
    np.testing.assert_allclose(model.Q, Q, rtol=2e-3, atol=2e-3 * np.abs(Q).max())


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 5))
def test_a_long_step_is_many_short_ones(seed, n):
    """Q(s + t) = F(t) Q(s) F(t)ᵀ + Q(t): to the last digits, also of steps of very unlike length."""
    A, D = stable(np.random.default_rng(seed), n)
    dt = np.array([0.001, 0.4, 30.0, 30.001, 30.4])
    F, Q = (getattr(LinearModel.from_continuous(A, D, dt), name) for name in "FQ")
    size = np.abs(Q).max()
    for short, long in ((0, 3), (1, 4)):
        both = F[short] @ Q[2] @ F[short].T + Q[short]
        np.testing.assert_allclose(Q[long], both, rtol=1e-9, atol=1e-12 * size)
        np.testing.assert_allclose(F[long], F[short] @ F[2], rtol=1e-9, atol=1e-13)


def test_long_steps_of_decaying_states_keep_their_digits():
    """A velocity that forgets at .05/s, over 300 s: e^{15} squared is lost where Q is not halved.

    Closed forms of the Ornstein-Uhlenbeck process and its integral (Uhlenbeck & Ornstein 1930).
    """
    b, q, t = 0.05, 0.02, 300.0
    model = LinearModel.from_continuous([[0.0, 1.0], [0.0, -b]], np.diag([0.0, q]), t)
    e = np.exp(-b * t)
    variance = q / b**2 * (t - 2.0 * (1.0 - e) / b + (1.0 - e**2) / (2.0 * b))
    mixed = q / (2.0 * b**2) * (1.0 - e) ** 2
    own = q / (2.0 * b) * (1.0 - e**2)
    np.testing.assert_allclose(model.Q, [[variance, mixed], [mixed, own]], rtol=1e-12)
    np.testing.assert_allclose(model.F, [[1.0, (1.0 - e) / b], [0.0, e]], rtol=1e-11)


@pytest.mark.parametrize(
    ("A", "D", "dt", "field"),
    [
        (np.eye(2), np.eye(3), 1.0, "density"),
        (np.ones((2, 3)), np.eye(2), 1.0, "A"),
        ([[np.nan]], np.eye(1), 1.0, "A"),
        (np.eye(2), np.eye(2), 0.0, "dt"),
        (np.eye(2), np.eye(2), [1.0, -1.0], "dt"),
        (np.eye(2), -np.eye(2), 1.0, "Q"),
    ],
)
def test_what_is_no_model_in_continuous_time_is_refused(A, D, dt, field):
    with pytest.raises(ValueError, match=rf"^{field} must"):
        LinearModel.from_continuous(A, D, dt)


# names of sensors and axes


def test_rows_are_named_after_what_they_measure():
    assert LinearModel().sensors == ("position", "velocity") * 2
    assert LinearModel(H=np.eye(4)[[1, 0, 2]]).sensors == ("velocity", "position", "position")
    fast = LinearModel.white_acceleration(1.0, velocity_noise=None)
    assert fast.sensors == ("position", "position")
    lever = [[1, 0.1, 0, 0], [0, 1, 0, 0]]
    assert LinearModel(H=lever).sensors == ("measurement",) * 2  # a row sees both: one word for all
    assert LinearModel(F=np.eye(3)).sensors == ("measurement",) * 3
    own = LinearModel(F=np.eye(3), position=(0, 1), velocity=(2,))
    assert own.sensors == ("position", "position", "velocity")
    assert LinearModel(F=np.eye(3), position=(0,), velocity=(2,)).sensors == ("measurement",) * 3
    changing = np.stack([np.eye(4)[:2], np.eye(4)[[0, 3]]])
    assert LinearModel(H=changing).sensors == ("position", "velocity")
    assert LinearModel().axes == ("all",) * 4


def test_names_are_ones_own_where_they_are_given():
    model = LinearModel(sensors=["gnss", "dvl"] * 2, axes=("x", "x", "y", "y"))
    assert model.sensors == ("gnss", "dvl", "gnss", "dvl")
    assert model.axes == ("x", "x", "y", "y")
    again = model_from_arrays(model.arrays())
    assert (again.sensors, again.axes) == (model.sensors, model.axes)


# what is no model


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
    ({"R": np.zeros((4, 4))}, "R", "[0. 0. 0. 0.]"),
    ({"R": np.diag([1.0, 0.0, 1.0, 1.0])}, "R", "a time axis, (T, m, m), and must be lost there"),
    ({"R": -np.eye(4)}, "R", "smallest eigenvalue is -1"),
    ({"R": np.ones((4, 4))}, "R", "smallest eigenvalue"),
    ({"R": np.eye(4) * NAN}, "R", "[nan nan nan nan]"),
    ({"R": np.eye(4) + np.diag([NAN] * 3, 1)}, "R", "got NaN or infinity"),
    ({"R": np.diag([1.0, np.inf, 1.0, 1.0])}, "R", "got NaN or infinity"),
    ({"R": np.stack([np.eye(4), np.diag([1.0, np.inf, 1.0, 1.0])])}, "R", "NaN or infinity"),
    ({"R": np.stack([np.eye(4), np.diag([1.0, NAN, -1.0, 1.0])])}, "R", "eigenvalue is -1"),
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
    ({"sensors": ["gnss"]}, "sensors", "4 names"),
    ({"sensors": "gnss"}, "sensors", "'gnss'"),
    ({"sensors": ["gnss", "dvl", "gnss", "two words"]}, "sensors", "two words"),
    ({"sensors": [1, 2, 3, 4]}, "sensors", "[1, 2, 3, 4]"),
    ({"axes": ("x", "y")}, "axes", "4 names"),
    ({"axes": ("x", "x", "y", "")}, "axes", "letters, digits and _"),
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
