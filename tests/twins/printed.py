"""QIVBF as table 1 prints it, with the additions that its module names."""

import numpy as np

from tests.twins.gaussian import Log, at, judge, parabola, rows


def printed(model, time, y, lost, sweeps=5, tau=5.0, count0=5.0):
    """Table 1 in its own order; filled values are taken for measurements and kept as nodes."""
    n, m = model.n, model.m
    x, log = model.x0, Log()
    past = [[] for _ in range(m)]
    for k, t in enumerate(time):
        F, H, Q, R = (at(M, k) for M in (model.F, model.H, model.Q, model.R))
        x_first = F @ x
        P_first = np.outer(x_first - x, x_first - x) + Q
        verdict = judge(x_first, P_first, y[k], H, R, ~lost[k])
        value = np.array([
            y[k, i] if not lost[k, i] else parabola(past[i], t)[0] if len(past[i]) >= 3 else np.nan
            for i in range(m)
        ])  # fmt: skip
        used = ~np.isnan(value)
        x, P = x_first, P_first
        M, m_dof = tau * P_first, tau + n + 1.0
        U, u_dof = count0 * R, count0 + m + 1.0
        for _ in range(sweeps if used.any() else 0):
            A = P_first + np.outer(x - x_first, x - x_first)  # eq. 34, A of a point
            M, m_dof = M + A, m_dof + 1.0
            e = np.where(used, value - H @ x, 0.0)
            U, u_dof = U + np.outer(e, e), u_dof + 1.0  # eq. 35-36
            P_hat, R_hat = M / (m_dof - n - 1.0), U / (u_dof - m - 1.0)  # eq. 37-38
            H_u, R_u = rows(H, R_hat, used)
            K = P_hat @ H_u.T @ np.linalg.inv(H_u @ P_hat @ H_u.T + R_u)
            x = x + K @ (value[used] - H_u @ x)  # eq. 40: from x^(l)
            P = P_hat - K @ H_u @ P_hat
        for i in np.flatnonzero(used):
            past[i].append((t, value[i]))
        log.add(x, P, *verdict)
    return log.arrays()
