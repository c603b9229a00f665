"""The INS error-state EKF as most people would write it: dense matrices, plain numpy; to be measured against."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from navgym.core.checks import Array
from navgym.inertial.earth import EARTH_RATE, GRAVITY
from navgym.ins.batch import InsBatch
from navgym.ins.kinds import NAMES

STATES = 22
R, V, PHI, BG, BA, M = (slice(3 * i, 3 * i + 3) for i in range(6))
S, ALPHA, C = 18, 19, slice(20, 22)
RADIUS = 6.37e6  # m: a round Earth is the same arithmetic
EYE = np.eye(3)
ACROSS = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # e_z×


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


class DenseIns:
    """A nominal, its constants, and a covariance of 22 error states.

    Args:
        model: a record of `navgym.ins.error_state.MODEL`.
        scale: of the IMU's white noise.
    """

    def __init__(self, model: Any, scale: float) -> None:
        start = model["start"]
        self.model, self.latitude = model, float(start[0])
        self.p = np.array([*(start[:2] - model["origin"][:2]) * model["metres"], model["origin"][2] - start[2]])  # fmt: skip
        self.v, self.C = start[3:6].copy(), start[6:].reshape(3, 3).copy()
        self.k, self.P = np.zeros(STATES), np.diag(model["deviation"] ** 2)
        self.Q = self._noise(scale)

    def _noise(self, scale: float) -> Array:
        m, T, Q = self.model, float(self.model["T"]), np.zeros((STATES, STATES))
        for part, density in ((V, scale * m["accelerometer"]), (PHI, scale * m["gyro"]), (BG, m["gyro_walk"]), (BA, m["accelerometer_walk"])):  # fmt: skip
            Q[part, part] = density * T * EYE
        Q[R, R], Q[C, C] = Q[V, V] * T**2 / 3.0, m["current_noise"] * np.eye(2)
        Q[R, V] = Q[V, R] = Q[V, V] * T / 2.0
        return Q

    def predict(self, step: Any) -> None:
        """A step of increments."""
        T = float(self.model["T"])
        dv = self.C @ (step["dv"] + step["J_vg"] @ self.k[BG] + step["J_va"] @ self.k[BA])
        earth = EARTH_RATE * np.array([np.cos(self.latitude), 0.0, -np.sin(self.latitude)])
        rate = earth + np.array([self.v[1], -self.v[0], -self.v[1] * np.tan(self.latitude)]) / RADIUS  # fmt: skip
        F = np.zeros((STATES, STATES))
        F[R, V], F[V, PHI], F[V, BA], F[PHI, BG] = EYE, _cross(dv / T), self.C, -self.C
        F[V, V], F[PHI, PHI], F[5, 2] = -_cross(earth + rate), -_cross(rate), 2.0 * GRAVITY / RADIUS
        Phi = np.eye(STATES) + F * T + 0.5 * (F * T) @ (F * T)
        Phi[C, C] = self.model["current_memory"] * np.eye(2)
        self.P = Phi @ self.P @ Phi.T + self.Q
        after = self.v + dv + np.array([0.0, 0.0, GRAVITY * T]) - T * np.cross(earth + rate, self.v)
        self.p = self.p + 0.5 * T * (self.v + after)
        turn = step["dR"] @ Rotation.from_rotvec(step["J_R"] @ self.k[BG]).as_matrix()
        self.C, self.v = Rotation.from_rotvec(-T * rate).as_matrix() @ self.C @ turn, after
        self.k[C] *= self.model["current_memory"]

    def rows(self, kind: str, event: Any) -> tuple[Array, Array]:
        """Predicted − measured, and H (rows, 22)."""
        C_, k, z, H = self.C, self.k, event["z"], np.zeros((3, STATES))
        if kind in ("dvl", "water"):
            v = self.v - np.array([*k[C], 0.0]) if kind == "water" else self.v
            body = C_.T @ v
            H[:, V], H[:, PHI] = C_.T, -C_.T @ _cross(v)
            if kind == "water":
                H[:, C] = C_.T[:, :2]
                return body - z, H
            A = (1.0 + k[S]) * (EYE - k[ALPHA] * ACROSS)
            H = A @ H
            H[:, S], H[:, ALPHA] = -A @ body, ACROSS @ body
            return A @ body - z, H
        if kind == "magnetometer":
            H[:, PHI], H[:, M] = -C_.T @ _cross(self.model["field"]), -EYE
            return C_.T @ self.model["field"] + k[M] - z, H
        H[:, R] = EYE
        return (self.p[2:] - z[:1], H[2:]) if kind == "depth" else (self.p - z, H)

    def update(self, kind: str, event: Any, variance: Array) -> None:
        """One measurement, in Joseph form."""
        r, H = self.rows(kind, event)
        noise = np.diag(variance[: len(r)])
        K = np.linalg.solve(H @ self.P @ H.T + noise, H @ self.P).T
        A = np.eye(STATES) - K @ H
        self.P = A @ self.P @ A.T + K @ noise @ K.T
        x = K @ r
        self.p, self.v = self.p - x[R], self.v - x[V]
        self.C = Rotation.from_rotvec(x[PHI]).as_matrix() @ self.C
        self.k[9:] += x[9:]


def dense_ins(batch: InsBatch, scale: float = 10.0) -> Array:
    """Positions (K, 3) of a batch's first recording."""
    found = np.zeros((int(batch.lengths[0]), 3))
    navigator, sensors = DenseIns(batch.models[0], scale), batch.sensors[0]
    events: NDArray[Any] = batch.events[0]
    for k, step in enumerate(batch.tapes[0, : len(found)]):
        navigator.predict(step)
        for event in events[step["first"] : step["first"] + step["count"]]:
            if not event["lost"]:
                sensor = sensors[event["sensor"]]
                navigator.update(NAMES[sensor["kind"]], event, sensor["variance"])
        found[k] = navigator.p
    return found
