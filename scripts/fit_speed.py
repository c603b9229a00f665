"""Fit the speed process of the INS simulator to A-KIT's tracks 1-3, and hold it against tracks 4-6.

    NAVGYM_DATA=… python scripts/fit_speed.py

Prints the fitted process, and over 10 to 180 s by how much surge and sway have changed: of the tracks that
were fitted, of those that were not, and of what the simulator makes of the fit on their own turn rates.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from navgym.core.checks import Array
from navgym.core.data import data_folder
from navgym.core.tables import read_table
from navgym.ins.speed import LAGS, fit, lagged, structure

FITTED_ON, OTHERS = (1, 2, 3), (4, 5, 6)


def log_of(folder: Path, track: int) -> tuple[Array, Array]:
    """Body velocity of the Doppler log (T, 3), and the IMU's mean turn rate around each (T,)."""
    dvl = read_table(folder / f"DVL_trajectory{track}.csv")
    imu = read_table(folder / f"IMU_trajectory{track}.csv")
    time, clock = dvl.numbers("Time [s]"), imu.numbers("Time [s]")
    turn = np.cumsum(imu.numbers("GYRO Z [rad/s]")) * float(np.median(np.diff(clock)))
    rate = np.interp(time + 0.5, clock, turn) - np.interp(time - 0.5, clock, turn)
    return dvl.matrix(("DVL X [m/s]", "DVL Y [m/s]", "DVL Z [m/s]")), rate


def main() -> int:
    """Print the fit and what it is worth."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    folder = data_folder("akit")
    if folder is None:
        print("set NAVGYM_DATA to the folder that holds akit/", file=sys.stderr)
        return 1
    logs = {t: log_of(Path(folder), t) for t in FITTED_ON + OTHERS}
    process = fit([logs[t] for t in FITTED_ON])
    print(process)
    print("of tracks 4-6 it would be", fit([logs[t] for t in OTHERS]))
    print("change of surge, m/s, after s:", *LAGS)
    for name, column in (("surge", 0), ("sway", 1)):
        for tracks in (FITTED_ON, OTHERS):
            own = [logs[t][0][:, column] for t in tracks]
            print(name, tracks, *(f"{x:.3f}" for x in np.sqrt(structure(own))))
    for tracks in (FITTED_ON, OTHERS):
        made = [_made(process, *logs[t], seed) for t in tracks for seed in range(20)]
        for name, column in (("surge", 0), ("sway", 1)):
            own = [m[:, column] for m in made]
            print("made", name, tracks, *(f"{x:.3f}" for x in np.sqrt(structure(own))))
    return 0


def _made(p: object, velocity: Array, rate: Array, seed: int) -> Array:
    """A body velocity (T, 2) by the process, on a track's own turn rates."""
    rng, cruise = np.random.default_rng(seed), float(velocity[:, 0].mean())
    found = np.empty((len(rate), 2))
    for i, kind in enumerate(("surge", "sway")):
        sd, memory = (getattr(p, f"{kind}_{n}") for n in ("deviation", "time"))
        keep, x = np.exp(-1.0 / memory), sd * rng.standard_normal()
        for k in range(len(rate)):
            found[k, i] = cruise * x
            x = keep * x + sd * np.sqrt(1.0 - keep**2) * rng.standard_normal()
    found[:, 0] -= p.turn_loss * lagged(rate**2, p.turn_time)  # type: ignore[attr-defined]
    found[:, 1] -= p.side_slip * rate  # type: ignore[attr-defined]
    return found


if __name__ == "__main__":
    raise SystemExit(main())
