"""The INS filter, dense: F of the error equations as they are written, Φ = I + FT + ½(FT)², Joseph updates.

States and signs are those of `navgym.ins.error_state`. Measurements must lie at the ends of filter steps.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from navgym.inertial.earth import EARTH_RATE as OMEGA
from navgym.inertial.earth import ECCENTRICITY_SQUARED, EQUATORIAL_RADIUS

n = 22
r, v, phi, bg, ba, M = (slice(3 * i, 3 * i + 3) for i in range(6))
s, alpha, c = 18, 19, slice(20, 22)


def cross(a):
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def frame(place, velocity):
    """ω_ie, ω_en, gravity, radii with the height."""
    L, h = place[0], place[2]
    flat = 1.0 - ECCENTRICITY_SQUARED * np.sin(L) ** 2
    RE = EQUATORIAL_RADIUS / np.sqrt(flat)
    RN = RE * (1.0 - ECCENTRICITY_SQUARED) / flat + h
    RE += h
    ie = OMEGA * np.array([np.cos(L), 0.0, -np.sin(L)])
    en = np.array([velocity[1] / RE, -velocity[0] / RN, -velocity[1] * np.tan(L) / RE])
    g0 = 9.7803253359 * (1.0 + 1.93185265241e-3 * np.sin(L) ** 2) / np.sqrt(flat)
    f = 1.0 / 298.257223563
    x = h / EQUATORIAL_RADIUS
    g = g0 * (
        1.0 - 2.0 * (1.0 + f + 3.449786506841e-3 - 2.0 * f * np.sin(L) ** 2) * x + 3.0 * x * x
    )
    return ie, en, g, RN, RE


class Navigator:
    """A nominal and a covariance.

    Args:
        model: a record of `navgym.ins.error_state.MODEL`.
    """

    def __init__(self, model):
        self.model = model
        start = model["start"]
        self.place, self.v, self.C = start[:3].copy(), start[3:6].copy(), start[6:].reshape(3, 3)
        self.constants = np.zeros(n)
        self.P = np.diag(model["deviation"] ** 2)

    def predict(self, tape, scale=1.0):
        """A step of increments."""
        T, k = self.model["T"], self.constants
        dR = tape["dR"] @ Rotation.from_rotvec(tape["J_R"] @ k[bg]).as_matrix()
        dv = tape["dv"] + tape["J_vg"] @ k[bg] + tape["J_va"] @ k[ba]
        ie, en, g, RN, RE = frame(self.place, self.v)
        dv_n = Rotation.from_rotvec(-0.5 * T * (ie + en)).apply(self.C @ dv)
        fall = np.array([0.0, 0.0, g * T])
        middle = self.v + 0.5 * (dv_n + fall)
        F = self.continuous(middle, dv_n / T, dR, ie, en, g, RN, RE)
        Phi = np.eye(n) + F * T + 0.5 * (F * T) @ (F * T)
        self.P = Phi @ self.P @ Phi.T + self.noise(T, scale)
        after = self.v + dv_n + fall - T * np.cross(2.0 * ie + en, middle)
        L, lon, h = self.place
        north = 0.5 * T * (self.v[0] + after[0]) / RN
        east = 0.5 * T * (self.v[1] + after[1]) / (RE * np.cos(L + 0.5 * north))
        self.place = np.array([L + north, lon + east, h - 0.5 * T * (self.v[2] + after[2])])
        en = frame(np.array([L, lon, h]), middle)[1]
        self.C = Rotation.from_rotvec(-T * (ie + en)).as_matrix() @ self.C @ dR
        self.v = after
        k[c] *= self.model["current_memory"]

    def continuous(self, velocity, force, dR, ie, en, g, RN, RE):
        """F (n, n), at the middle of a step."""
        F, L = np.zeros((n, n)), self.place[0]
        vN, vE, vD = velocity
        C = self.C @ Rotation.from_rotvec(0.5 * Rotation.from_matrix(dR).as_rotvec()).as_matrix()
        F[r, v] = np.eye(3)
        F[r, r] = [
            [-vD / RN, 0.0, vN / RN],
            [vE * np.tan(L) / RN, -(vD + vN * np.tan(L)) / RE, vE / RE],
            [0.0, 0.0, 0.0],
        ]
        N_v = np.array([[0.0, 1.0 / RE, 0.0], [-1.0 / RN, 0.0, 0.0], [0.0, -np.tan(L) / RE, 0.0]])
        ie_r, en_r = np.zeros((3, 3)), np.zeros((3, 3))
        ie_r[:, 0] = OMEGA * np.array([-np.sin(L), 0.0, -np.cos(L)]) / RN
        en_r[:, 2] = vE / RE**2, -vN / RN**2, -vE * np.tan(L) / RE**2
        en_r[2, 0] = -vE / (np.cos(L) ** 2 * RE * RN)
        F[v, v] = -cross(2.0 * ie + en) + cross(velocity) @ N_v
        F[v, r] = cross(velocity) @ (2.0 * ie_r + en_r)
        F[5, 2] += 2.0 * g / np.sqrt(RN * RE)
        F[v, phi], F[v, ba] = cross(force), C
        F[phi, phi] = -cross(ie + en)
        F[phi, v], F[phi, r], F[phi, bg] = N_v, ie_r + en_r, -C
        F[c, c] = np.log(self.model["current_memory"]) / self.model["T"] * np.eye(2)
        return F

    def noise(self, T, scale):
        """Q (n, n)."""
        m, Q = self.model, np.zeros((n, n))
        q = scale * m["accelerometer"] * np.eye(3)
        Q[r, r], Q[r, v], Q[v, r], Q[v, v] = q * T**3 / 3, q * T**2 / 2, q * T**2 / 2, q * T
        Q[phi, phi] = scale * m["gyro"] * T * np.eye(3)
        Q[bg, bg], Q[ba, ba] = (
            m["gyro_walk"] * T * np.eye(3),
            m["accelerometer_walk"] * T * np.eye(3),
        )
        Q[c, c] = m["current_noise"] * np.eye(2)
        return Q

    def position(self):
        """NED of the origin."""
        m = self.model
        north, east = (self.place[:2] - m["origin"][:2]) * m["metres"]
        return np.array([north, east, m["origin"][2] - self.place[2]])

    def see(self, kind, event, lever):
        """Predicted − measured, and H (rows, n), of a measurement at the step's end."""
        k, C, H = self.constants, self.C, np.zeros((3, n))
        z = event["z"]
        if kind in ("dvl", "water"):
            flow = np.zeros(3)
            flow[:2] = k[c] if kind == "water" else 0.0
            body = C.T @ (self.v - flow) + np.cross(event["rate"] - k[bg], lever)
            H[:, v], H[:, phi], H[:, bg] = C.T, -C.T @ cross(self.v - flow), -cross(lever)
            if kind == "water":
                H[:, c] = C.T[:, :2]
                return body - z, H
            e = cross([0.0, 0.0, 1.0])
            turned = body - k[alpha] * e @ body
            H = (1.0 + k[s]) * (np.eye(3) - k[alpha] * e) @ H
            H[:, s], H[:, alpha] = -turned, (1.0 + k[s]) * e @ body
            return (1.0 + k[s]) * turned - z, H
        if kind == "magnetometer":
            H[:, phi], H[:, M] = -C.T @ cross(self.model["field"]), -np.eye(3)
            return C.T @ self.model["field"] + k[M] - z, H
        H[:, r], H[:, phi] = np.eye(3), cross(C @ lever)
        predicted = self.position() + C @ lever
        if kind == "depth":
            return predicted[2:] - z[:1], H[2:]
        return predicted - z, H

    def update(self, kind, event, sensor):
        """One measurement, in Joseph form; returns its NIS."""
        z, H = self.see(kind, event, sensor["lever"])
        R = np.diag(sensor["variance"][: len(z)])
        S = H @ self.P @ H.T + R
        K = np.linalg.solve(S, H @ self.P).T
        A = np.eye(n) - K @ H
        self.P = A @ self.P @ A.T + K @ R @ K.T
        x = K @ z
        _, _, _, RN, RE = frame(self.place, self.v)
        self.place = self.place - [x[0] / RN, 0.0, -x[2]]
        self.place[1] -= x[1] / (RE * np.cos(self.place[0]))
        # which δv goes with which φ, about the velocity as it is now
        J = np.eye(n)
        J[v, phi] = -cross(x[v])
        self.P = J @ self.P @ J.T
        self.v = self.v - x[v]
        self.C = Rotation.from_rotvec(x[phi]).as_matrix() @ self.C
        self.constants[9:] += x[9:]
        return z @ np.linalg.solve(S, z)

    def answer(self):
        """The filter's states (n,)."""
        found = self.constants.copy()
        found[r], found[v] = self.position(), self.v
        found[phi] = Rotation.from_matrix(self.C).as_euler("ZYX")[::-1]
        return found


def run(batch, i=0, scale=1.0):
    """States (K, n), covariances (K, n, n) and NIS (K,) of recording i of a batch."""
    navigator, sensors = Navigator(batch.models[i]), batch.sensors[i]
    kinds = [m.kind for m in batch.recordings[i].model.sensors.values()]
    states, covariances, nis = [], [], []
    for tape in batch.tapes[i, : batch.lengths[i]]:
        navigator.predict(tape, scale)
        total = []
        for event in batch.events[i, tape["first"] : tape["first"] + tape["count"]]:
            if not event["lost"]:
                which = event["sensor"]
                total.append(navigator.update(kinds[which], event, sensors[which]))
        states.append(navigator.answer())
        covariances.append(navigator.P)
        nis.append(sum(total) if total else np.nan)
    return np.array(states), np.array(covariances), np.array(nis)
