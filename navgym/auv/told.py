"""What a recording of positions and velocities holds, in words."""

from __future__ import annotations

import numpy as np

from navgym.statespace.recording import Recording


def told(recording: Recording) -> list[tuple[str, str]]:
    """Lines with a name each: what is measured, what is known, what a filter would believe."""
    model = recording.model
    R = np.asarray(getattr(model, "R", None))
    sigmas = np.sqrt(np.atleast_3d(R.T).T.diagonal(axis1=-2, axis2=-1))  # (1 or T, m)
    parts, believed = [], []
    sensors = np.asarray(model.sensors)
    for sensor in dict.fromkeys(model.sensors):
        rows = sensors == sensor
        parts.append(f"{sensor} ({rows.sum()}) {recording.lost[:, rows].mean():.1%} lost")
        here = sigmas[:, rows]
        least, most = np.nanmin(here), np.nanmax(here)
        spread = f"{least:.4g}" if least == most else f"{least:.4g} to {most:.4g}"
        believed.append(f"{sensor} {spread}")
    kind = f"{type(model).__name__} of {model.n} states; standard deviations: {', '.join(believed)}"
    truth = "in the log" if recording.truth is not None else "none: judged by its innovations"
    return [("measured", ", ".join(parts)), ("truth", truth), ("model", kind)]
