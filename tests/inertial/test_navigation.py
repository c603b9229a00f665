"""Mechanisation on the ellipsoid and its inverse, increments over a step, rotations: against closed forms and pyins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from navgym.core.compile import kernel
from navgym.inertial import ellipsoid, mechanization, preintegration, rotation
from navgym.inertial.earth import EARTH_RATE, radii_of_curvature

H = 0.01
START = np.array([0.57, 0.61, -20.0])
small = st.floats(-3.0, 3.0)


@kernel
def gravity_at(sine, height):
    return ellipsoid.normal_gravity(sine, height)


@kernel
def round_trip(x, y, z, C):
    rotation.exponential(x, y, z, C)
    return rotation.logarithm(C)


@kernel
def upkeep(C):
    rotation.orthonormalise(C)


@kernel
def euler_trip(roll, pitch, heading, C):
    rotation.euler_matrix(roll, pitch, heading, C)
    return rotation.euler_angles(C)


def motion(seconds, seed=0):
    """Velocities and attitudes of a vehicle that swings, turns and dives, T + 1 of each."""
    t = np.arange(round(seconds / H) + 1) * H
    a, b, c = np.random.default_rng(seed).uniform(0.5, 1.5, 3)
    angles = np.stack([0.05 * np.sin(a * t), 0.1 * np.sin(0.7 * b * t + 0.3), 0.1 * t + 0.3 * np.sin(c * t)], 1)  # fmt: skip
    C = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    body = np.stack([1.5 + 0.3 * np.sin(0.2 * t), 0.1 * np.sin(a * t), 0.05 * np.cos(b * t)], 1)
    return np.einsum("kij,kj->ki", C, body), np.ascontiguousarray(C)


def sensed(velocity, attitude):
    """Increments that reproduce a motion, and positions after each."""
    count = len(velocity) - 1
    angle, force, place = (np.empty((count, 3)) for _ in range(3))
    mechanization.increments(velocity, attitude, H, START.copy(), angle, force, place)
    return angle, force, place


def reckoned(angle, force, velocity, attitude, start=START):
    """Positions, velocities and attitudes by dead reckoning."""
    count = len(angle)
    out = np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3, 3))
    mechanization.mechanise(angle, force, H, start.copy(), velocity.copy(), attitude.copy(), *out)
    return out


def metres(difference):
    meridian, across = radii_of_curvature(START[0])
    return difference * [meridian, across * np.cos(START[0]), 1.0]


def test_normal_gravity_is_the_published_one():
    # WGS-84: NIMA TR8350.2, table 3.4; and its fall with height, 3.0877e-6 /s² at 45°
    assert gravity_at(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert gravity_at(1.0, 0.0) == pytest.approx(9.8321849378, abs=1e-8)
    s = np.sin(np.radians(45.0))
    assert gravity_at(s, 0.0) - gravity_at(s, 1000.0) == pytest.approx(3.0848e-3, rel=2e-3)


def test_increments_reproduce_the_motion_to_a_nanometre():
    velocity, attitude = motion(30.0)
    angle, force, place = sensed(velocity, attitude)
    positions, velocities, attitudes = reckoned(angle, force, velocity[0], attitude[0])
    assert np.abs(metres(positions - place)).max() < 1e-9
    assert np.abs(velocities - velocity[1:]).max() < 1e-11
    assert np.abs(attitudes - attitude[1:]).max() < 1e-12


def test_a_vehicle_at_rest_feels_gravity_and_the_turning_earth():
    velocity, attitude = np.zeros((101, 3)), np.repeat(np.eye(3)[None], 101, axis=0)
    angle, force, place = sensed(velocity, attitude)
    g = gravity_at(np.sin(START[0]), START[2])
    rate = EARTH_RATE * np.array([np.cos(START[0]), 0.0, -np.sin(START[0])])
    np.testing.assert_allclose(angle / H, np.tile(rate, (100, 1)), atol=1e-16)
    np.testing.assert_allclose(force / H, np.tile([0.0, 0.0, -g], (100, 1)), atol=2e-6)
    np.testing.assert_array_equal(place[-1], START)


def test_dead_reckoning_is_that_of_pyins():
    pandas, pyins = pytest.importorskip("pandas"), pytest.importorskip("pyins.strapdown")
    velocity, attitude = motion(30.0, seed=3)
    angle, force, _ = sensed(velocity, attitude)
    positions, velocities, attitudes = reckoned(angle, force, velocity[0], attitude[0])
    angles = Rotation.from_matrix(attitude[0]).as_euler("ZYX", degrees=True)[::-1]
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    start = [*np.degrees(START[:2]), START[2], *velocity[0], *angles]
    integrator = pyins.Integrator(pandas.Series(start, index=names, name=0.0))
    turned = force + 0.5 * np.cross(angle, force)
    columns = ["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"]
    table = np.column_stack([np.full(len(angle), H), angle, turned])
    time = H * np.arange(1, len(angle) + 1)
    found = integrator.integrate(pandas.DataFrame(table, index=time, columns=columns)).iloc[-1]
    other = np.array([*np.radians(found[["lat", "lon"]]), found["alt"]])
    assert np.abs(metres(positions[-1] - other)).max() < 3e-3
    assert np.abs(velocities[-1] - found[["VN", "VE", "VD"]].to_numpy(float)).max() < 1e-4
    turn = Rotation.from_euler("ZYX", found[["heading", "pitch", "roll"]].to_numpy(float), degrees=True)  # fmt: skip
    assert (turn.inv() * Rotation.from_matrix(attitudes[-1])).magnitude() < 1e-7


@settings(max_examples=30)
@given(x=small, y=small, z=small)
def test_exponential_and_logarithm_are_scipys(x, y, z):
    r, C = np.array([x, y, z]), np.empty((3, 3))
    if np.linalg.norm(r) > np.pi - 1e-3:
        r *= 3.0 / np.linalg.norm(r)
    back = round_trip(*r, C)
    np.testing.assert_allclose(C, Rotation.from_rotvec(r).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(back, r, atol=1e-7)
    bent = C + 1e-5 * np.random.default_rng(0).standard_normal((3, 3))
    upkeep(bent)
    assert np.abs(bent.T @ bent - np.eye(3)).max() < 1e-8


def test_euler_angles_are_scipys_and_come_back():
    C, angles = np.empty((3, 3)), (0.3, -0.4, 2.5)
    assert euler_trip(*angles, C) == pytest.approx(angles, abs=1e-14)
    expected = Rotation.from_euler("ZYX", angles[::-1]).as_matrix()
    np.testing.assert_allclose(C, expected, atol=1e-15)


class TestPreintegration:
    PER = 20

    def steps(self, angle, force):
        found = np.zeros(len(angle) // self.PER, np.dtype(preintegration.INCREMENT))
        preintegration.preintegrate(angle, force, H, self.PER, found)
        return found

    def test_a_step_is_the_product_of_its_turns_and_the_sum_of_turned_velocities(self):
        angle, force, _ = sensed(*motion(1.0))
        step, R, v = self.steps(angle, force)[2], Rotation.identity(), np.zeros(3)
        for a, f in zip(angle[40:60], force[40:60], strict=True):
            v += R.apply(f + 0.5 * np.cross(a, f))
            R = R * Rotation.from_rotvec(a)
        np.testing.assert_allclose(step["dR"], R.as_matrix(), atol=1e-14)
        np.testing.assert_allclose(step["dv"], v, atol=1e-13)

    def test_jacobians_say_what_biases_do(self):
        angle, force, _ = sensed(*motion(10.0))
        step = self.steps(angle, force)
        gyro, acc = np.array([2e-4, -3e-4, 1e-4]), np.array([0.03, -0.02, 0.01])
        for g, a in ((gyro, 0.0 * acc), (0.0 * gyro, acc)):
            other = self.steps(angle - g * H, force - a * H)
            turn = Rotation.from_rotvec(step["J_R"] @ g).as_matrix()
            np.testing.assert_allclose(step["dR"] @ turn, other["dR"], atol=1e-9)
            v = step["dv"] + step["J_vg"] @ g + step["J_va"] @ a
            np.testing.assert_allclose(v, other["dv"], atol=1e-8)
            moved = np.abs(step["dv"] - other["dv"]).max()
            assert moved > 1e-5  # the test would see them
