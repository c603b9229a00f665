"""INS/DVL figures to reproduce, from a compiled prototype that was measured before this problem was built.

Position in m; docs/science/ins.md says what differs in its missions. They are for acceptance only.
"""

from __future__ import annotations

from collections.abc import Mapping

SPREAD = 0.1  # half-width of a prototype's figure, as a share of it: eight to twenty missions each

# matched filter: horizontal RMSE with fixes of 2 m per 10 s, and without
MATCHED: Mapping[str, tuple[float, float]] = {
    "navigation": (0.489, 1.257),
    "tactical": (0.543, 1.415),
    "mems": (0.621, 2.328),
}
NEES, NEES_SLACK = 1.0, 0.1  # per degree of freedom, of a filter that is right

# noise that changes: horizontal RMSE after 60 s
NOISE: Mapping[str, Mapping[str, float]] = {
    "dvl-switch": {"KF": 1.69, "KF, R×10": 2.18, "Student": 1.80, "MCC": 1.68, "VB": 1.60, "bank": 1.55, "oracle": 1.53},
    "dvl-switch, tactical": {"KF": 1.37, "KF, R×10": 1.68, "VB": 1.23, "bank": 1.19, "oracle": 1.16},
    "usbl-switch": {"KF": 1.14, "KF, R×10": 1.28, "Student": 1.03, "MCC": 1.04, "VB": 0.98, "bank": 0.88, "oracle": 0.85},
    "anomaly": {"KF": 3.79, "KF, R×10": 2.76, "Student": 0.66, "MCC": 0.62, "VB": 0.65, "bank": 0.63, "oracle": 0.60},
    "survey": {"KF": 4.57, "KF, R×10": 3.56, "Student": 1.50, "MCC": 1.44, "VB": 1.40, "bank": 1.15, "oracle": 1.14},
    "survey, tactical": {"KF": 2.29, "KF, R×10": 1.78, "VB": 1.04, "bank": 0.885, "oracle": 0.861},
}  # fmt: skip
NEAR_ORACLE = 1.08  # the bank's error over that of the filter that knows R

# a lost Doppler log, a vehicle that keeps its speed
FILLS: Mapping[str, Mapping[str, float]] = {
    "outages, steady": {"nothing": 32.6, "hold, .3 + .03/s": 21.6, "hold until 15°": 12.8, "water track": 6.84},
    "bursts, steady": {"nothing": 12.6, "hold, .3 + .03/s": 7.35, "hold until 15°": 5.9, "water track": 4.05},
}  # fmt: skip

# real tracks without fixes: median end error in % of the distance, heading in degrees (13 tracks; here 6)
END, HEADING = 0.41, 0.78
# median rms, m, by the outage's length, as recorded and with MEMS errors added (13 tracks)
OUTAGES: Mapping[int, Mapping[str, tuple[float, float]]] = {
    60: {"KF": (3.70, 6.33)},
    120: {"KF": (5.68, 17.9), "KF, R×10": (4.10, 14.5), "Student": (4.9, 13.7)},
}
# with fixes of 1 m and 10, 30, 50 % of all lost: dead reckoning on the AUV half's tracks, in time with each other
DEAD_RECKONING = (0.353, 0.445, 0.582)
