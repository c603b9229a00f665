"""Dead reckoning by a Doppler log and a given heading, with position fixes: four states, in plain numpy.

States: position north and east, the log's scale error and its misalignment. The lost velocity is the last
one in body axes, turned by the heading as it goes on.
"""

from __future__ import annotations

import numpy as np

from navgym.core.checks import Array
from navgym.statespace.recording import Recording

SCALE, MISALIGNMENT = 0.005, np.radians(0.5)  # standard deviations at the start
CLIP = 9.0  # squared deviations of a fix's row, at most so many of which count


def dead_reckon(
    recording: Recording, moves: Array, densities: tuple[float, float]
) -> tuple[Array, float]:
    """States (K, 4) as [Px, 0, Py, 0], and the mean square of a fix's one-step error, clipped.

    Args:
        recording: fixes in columns 0 and 2; its model holds the start and their noise.
        moves: (K, 2) m north and east between fixes, as the log has it.
        densities: of the velocity's error, m²/s, where it was heard and where it was lost.
    """
    model, y = recording.model, np.asarray(recording.measurements)[:, [0, 2]]
    R = np.asarray(model.R)[np.ix_([0, 2], [0, 2])]
    P = np.diag([*R.diagonal(), SCALE**2, MISALIGNMENT**2])
    x = np.array([*np.asarray(model.x0)[[0, 2]], 0.0, 0.0])
    steps = np.diff(recording.time, prepend=recording.time[0] - float(np.median(np.diff(recording.time))))  # fmt: skip
    added = np.where(np.asarray(recording.lost)[:, 1], densities[1], densities[0]) * steps
    found, squares = np.zeros((len(y), 4)), []
    for k, (z, u) in enumerate(zip(y, moves, strict=True)):
        F = np.eye(4)
        F[:2, 2], F[:2, 3] = -u, [u[1], -u[0]]
        x = F @ x + [*u, 0.0, 0.0]
        P = F @ P @ F.T
        P[[0, 1], [0, 1]] += added[k]
        if np.isfinite(z).all():
            r, S = z - x[:2], P[:2, :2] + R
            squares += list(np.minimum(r**2, CLIP * R.diagonal()))
            K = np.linalg.solve(S, P[:2]).T
            x, P = x + K @ r, P - K @ S @ K.T
        found[k, [0, 2]] = x[:2]
    return found, float(np.mean(squares))
