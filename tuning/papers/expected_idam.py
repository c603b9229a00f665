"""Deck figures to reproduce, and the paper's own (IDAM section 5).

docs/science/idam.md#expected-errors, docs/science/idam.md#scenarios-and-headroom.

θ and attitude in arcmin, θ̇ in arcmin/s. The prototype's number of runs is not known; with a
seed-to-seed deviation of 1.3 to 3.6′ its means carry some tenth of their value.
"""

from __future__ import annotations

from collections.abc import Mapping

SPREAD = 0.12  # half-width of a prototype's figure, as a share of it

# IDAM figure 6: RMSE of the z-axis attitude, one run
PAPER_Z: Mapping[str, float] = {"idam": 4.260, "woam": 5.032, "svram": 6.560}

# B2: true flexure, r_V = 2 m/s, 300 s scored from 60 s
ORACLE_THETA = (1.85, 1.39, 3.99)
ORACLE_ATTITUDE = (0.29, 0.38, 0.67)
POSTERIOR = (1.51, 1.51, 3.99)  # the filter's own deviation of θ at 300 s
SPLIT = (1.45, 1.45, 3.96)  # σ/√(1 + βt/4)
LEVER_Z = {"exact": 0.8, "3 cm": 6.0, "Φ × r0": 26.0}  # θ_z with a small r_V

# B2: rms of ln b
LN_B: Mapping[str, tuple[float, float, float] | None] = {
    "regression": (0.12, 0.12, 0.20), "nls": None, "rvm": None, "rvm_dictionary": None, "svr": None,
    "swarm": None, "whale": None, "tufts_kumaresan": None,
}  # fmt: skip
BODY_FACTOR = (3.5, 3.5, 6.8)  # b identified from body-frame increments over the true one

# B3: θ, θ_ac, θ̇ (lengths)
SWITCH: Mapping[str, tuple[float, float, float]] = {
    "MCC off": (6.75, 1.35, 1.531),
    "best fixed width": (6.14, 1.04, 0.724),
    "true-regime schedule": (5.91, 0.90, 0.494),
}
SWITCH_GAIN = 32.0  # % of θ̇, schedule against best fixed

# RepoIMU: angular frequency of the relative swing by the optical reference, rad/s:
# docs/science/data.md#repoimu
PENDULUM: Mapping[str, float] = {"Test03_Trial1": 4.227, "Test05_Trial2": 4.186}

# docs/science/idam.md, correntropy and model prediction: widths that are best, change of θ in %
GLITCH_WIDTHS = (2.0, 5.0)
SLAM_WIDTH = 20.0  # or more
PREDICTION_THETA = (-4.0, 5.0)

# docs/science/idam.md, identification where the sea changes: θ_ac in %, won by the truth, lost by short windows
SEA_TRUE = (18.0, 24.0)
SEA_IDENTIFIED = (46.0, 122.0)

# what the paper prints beside its figures
PAPER_GAINS: Mapping[str, float] = {
    "woam": 15.34,
    "svram": 35.06,
}  # % by which IDAM is better, section 5
PAPER_SEA: Mapping[str, tuple[float, float, float]] = {  # figure 10: RMSE in roll, pitch, heading
    "svram": (5.155, 5.098, 25.143), "woam": (0.828, 1.914, 10.735), "idam": (0.797, 1.852, 9.589),
}  # fmt: skip
PAPER_SEA_GAINS: Mapping[tuple[str, str], tuple[float, float, float]] = {  # %, the first over the second
    ("woam", "svram"): (83.94, 62.46, 57.30), ("idam", "woam"): (3.74, 3.24, 10.68),
}  # fmt: skip
INSTALLED = (
    (-0.041, 0.430, -0.250),
    (-0.029, 0.525, 0.330),
)  # table 2: pitch, roll, heading in degrees
