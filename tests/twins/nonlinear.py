"""The extended, unscented and cubature filters and CUKF in numpy, as the equations have them.

Written from QIVBF section 3.2 with the corrections named at each line, and from the coordinated
turn in complex numbers: p + iq for a place, v for a velocity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navgym import CoordinatedTurnModel, LinearModel, Recording


class Linear:
    """f(x) = F x, h(x) = H x at sample k."""

    angles = ()

    def __init__(self, model: LinearModel, k: int) -> None:
        self.A, self.C, self.Q, self.R = (
            a[min(k, len(a) - 1)] if a.ndim == 3 else a
            for a in (model.F, model.H, model.Q, model.R)
        )

    def f(self, x):
        return self.A @ x

    def h(self, x):
        return self.C @ x

    def F(self, x):
        return self.A

    def H(self, x):
        return self.C


class Turn:
    """p' = p + v (e^{iω dt} − 1)/(iω), v' = v e^{iω dt};  ln(p − beacon), ln v are observed."""

    angles = (1, 3)

    def __init__(self, model: CoordinatedTurnModel, k: int) -> None:
        self.dt = float(model.dt if model.dt.ndim == 0 else model.dt[k])
        self.Q = model.Q if model.Q.ndim == 2 else model.Q[k]
        self.R = model.R if model.R.ndim == 2 else model.R[k]
        self.beacon = complex(*model.beacon)

    @staticmethod
    def split(x):
        return complex(x[0], x[2]), complex(x[1], x[3]), x[4]

    def f(self, x):
        p, v, w = self.split(x)
        E = np.exp(1j * w * self.dt)
        p, v = p + v * (np.expm1(1j * w * self.dt) / (1j * w) if w else self.dt), v * E
        return np.array([p.real, v.real, p.imag, v.imag, w])

    def h(self, x):
        p, v, _ = self.split(x)
        z = p - self.beacon
        return np.array([abs(z), np.angle(z), abs(v), np.angle(v)])

    def F(self, x):
        _, v, w = self.split(x)
        E = np.exp(1j * w * self.dt)
        g = (E - 1) / (1j * w)
        columns = [(1, 0), (g, E), (1j, 0), (1j * g, 1j * E)]  # ∂(p', v')/∂(Px, Vx, Py, Vy)
        columns.append((v * (self.dt * E - g) / w, 1j * self.dt * v * E))
        rows = [[part(c[i]) for c in columns] for part in (np.real, np.imag) for i in (0, 1)]
        return np.array([*rows, [0, 0, 0, 0, 1]], dtype=float)

    def H(self, x):
        p, v, _ = self.split(x)
        H = np.zeros((4, 5))
        for first, z in ((0, p - self.beacon), (1, v)):
            slope = np.array([1, 1j]) / z  # d ln z = dz / z: relative length, and direction
            H[2 * first, [first, first + 2]] = abs(z) * slope.real
            H[2 * first + 1, [first, first + 2]] = slope.imag
        return H


def system(model, k):
    """What f, h, Q, R are at sample k."""
    return (Turn if isinstance(model, CoordinatedTurnModel) else Linear)(model, k)


def wrapped(s, difference):
    """`difference` of measurements (..., m) with the angles brought into [−π, π)."""
    difference = np.array(difference)
    angles = list(s.angles)
    difference[..., angles] = (difference[..., angles] + np.pi) % (2 * np.pi) - np.pi
    return difference


@dataclass
class Step:
    """What one sample leaves behind."""

    x: np.ndarray
    P: np.ndarray
    innovation: np.ndarray
    nis: float
    log_likelihood: float


def update(s, x, P, Z, Pzz, Pxz, z, used, sign=-1.0):
    """QIVBF eq. 14-16, the rows that were not received deleted; sign = +1 is eq. 16 as printed."""
    innovation = np.full(len(z), np.nan)
    if not used.any():
        return Step(x, P, innovation, np.nan, np.nan)
    v = innovation[used] = wrapped(s, z - Z)[used]
    S = Pzz[np.ix_(used, used)]
    K = Pxz[:, used] @ np.linalg.inv(S)
    nis = v @ np.linalg.solve(S, v)
    log_likelihood = -(nis + np.linalg.slogdet(S)[1] + len(v) * np.log(2 * np.pi)) / 2
    return Step(x + K @ v, P + sign * K @ S @ K.T, innovation, nis, log_likelihood)


def extended(s, x, P, z, used, q, r):
    """The Kalman filter of the model linearised at the last estimate and at the prediction."""
    F = s.F(x)
    x, P = s.f(x), F @ P @ F.T + q * s.Q
    H = s.H(x)
    return update(s, x, P, s.h(x), H @ P @ H.T + r * s.R, P @ H.T, z, used)


def sigma_points(x, P, a):
    """QIVBF eq. 7."""
    L = len(x)
    S = a * np.linalg.cholesky(L * P)
    chi = np.vstack([x, x + S.T, x - S.T])
    weights = np.array([1 - 1 / a**2] + 2 * L * [1 / (2 * L * a**2)])
    return chi, weights


def unscented(s, x, P, z, used, q, r, a, sign=-1.0, redraw=True):
    """QIVBF eq. 7-16. Eq. 10 as printed sees the propagated points, which lack Q: redraw=False."""
    chi, w = sigma_points(x, P, a)
    chi = np.array([s.f(c) for c in chi])
    x = w @ chi
    P = (w * (chi - x).T) @ (chi - x) + q * s.Q
    if redraw:
        chi, w = sigma_points(x, P, a)
    seen = np.array([s.h(c) for c in chi])
    seen = seen[0] + wrapped(s, seen - seen[0])
    Z = w @ seen
    Pzz = (w * (seen - Z).T) @ (seen - Z) + r * s.R
    Pxz = (w * (chi - x).T) @ (seen - Z)
    return update(s, x, P, Z, Pzz, Pxz, z, used, sign)


def cubature(s, x, P, z, used, q, r, sign=-1.0):
    """QIVBF eq. 17-26, corrected: 2n points ± √n S e_j, weights 1/(2n), second line of 25 is Pxz."""
    n = len(x)
    xi = np.sqrt(n) * np.hstack([np.eye(n), -np.eye(n)])
    points = (np.linalg.cholesky(P) @ xi).T + x
    mu = np.array([s.f(c) for c in points])
    x = mu.mean(0)
    P = mu.T @ mu / (2 * n) - np.outer(x, x) + q * s.Q
    points = (np.linalg.cholesky(P) @ xi).T + x
    pi = np.array([s.h(c) for c in points])
    pi = pi[0] + wrapped(s, pi - pi[0])
    Z = pi.mean(0)
    Pzz = pi.T @ pi / (2 * n) - np.outer(Z, Z) + r * s.R
    Pxz = points.T @ pi / (2 * n) - np.outer(x, Z)
    return update(s, x, P, Z, Pzz, Pxz, z, used, sign)


def run(name: str, recording: Recording, q=1.0, r=1.0, a=0.775, **variant) -> list[Step]:
    """One filter over a recording: "ekf", "ukf", "ckf" or "cukf"."""
    x, P = recording.model.x0, recording.model.P0
    steps, taken = [], 0
    for k, (z, lost) in enumerate(zip(recording.measurements, recording.lost, strict=True)):
        s = system(recording.model, k)
        if name == "ekf":
            step = extended(s, x, P, z, ~lost, q, r)
        elif name == "ukf" or (name == "cukf" and taken % 2 == 0):
            step = unscented(s, x, P, z, ~lost, q, r, a, **variant)
        else:
            step = cubature(s, x, P, z, ~lost, q, r, **variant)
        x, P = step.x, step.P
        taken += not lost.all()
        steps.append(step)
    return steps
