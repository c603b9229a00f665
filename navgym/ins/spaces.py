"""The tunables of every INS filter, declared once."""

from __future__ import annotations

from dataclasses import replace

from navgym.core.parameters import Parameter, ParameterSpace

IMU_NOISE = Parameter(
    "imu_noise_scale", "q", "1", 1.0, 300.0, "log", 10.0, widest=(0.01, 1e6),
    equation="multiplies the variances of the IMU's white noise (Q of QIVBF eq. 3)",
)  # fmt: skip
DVL_NOISE = Parameter(
    "dvl_noise_scale", "r_v", "1", 1.0, 300.0, "log", 1.0, widest=(0.01, 1e6),
    equation="multiplies the Doppler log's R (QIVBF eq. 4)",
)  # fmt: skip
FIX_NOISE = Parameter(
    "fix_noise_scale", "r_p", "1", 1.0, 30.0, "log", 1.0, widest=(0.01, 1e6),
    equation="multiplies the R of position fixes (not in the paper)",
)  # fmt: skip
MAGNETIC_NOISE = Parameter(
    "magnetic_noise_scale", "r_m", "1", 1.0, 100.0, "log", 1.0, widest=(0.01, 1e6),
    equation="multiplies the R of magnetometer and magnetic heading (QIVBF eq. 4)",
)  # fmt: skip
FILL = Parameter(
    "fill", "fill", "1", 0, 2, "linear", 0, integer=True, choices=("skip", "hold", "extrapolate"),
    equation="what a lost velocity becomes: nothing, the last one, three of them extrapolated (QIVBF eq. 27)",
)  # fmt: skip
FILL_VARIANCE = Parameter(
    "fill_variance", "R_f", "m²/s²", 0.01, 1000.0, "log", 0.3, widest=(1e-6, 1000.0),
    equation="variance of what stands in (QIVBF eq. 28: Σl² times it where three are extrapolated)",
)  # fmt: skip
FILL_GROWTH = Parameter(
    "fill_growth", "Ṙ_f", "m²/s³", 0.001, 1.0, "log", 0.03, widest=(1e-9, 10.0),
    equation="by which that variance grows per second since the loss (not in the paper)",
)  # fmt: skip
FILL_TURN = Parameter(
    "fill_turn_limit", "θ_f", "°", 5.0, 180.0, "log", 180.0,
    equation="nothing stands in once the gyros have turned so far since the loss; 180 is off (not in the paper)",
)  # fmt: skip
GATE = Parameter(
    "gate", "γ", "1", 9.0, 1e4, "log", 1e4,
    equation="a sensor whose NIS is beyond is left out; 10000 is off (not in the paper)",
)  # fmt: skip
FREEDOM = Parameter(
    "student_freedom", "ν", "1", 1.5, 10.0, "log", 4.0,
    equation="degrees of freedom of a measurement's Student-t noise (not in the paper)",
)  # fmt: skip
WIDTH = Parameter(
    "kernel_width", "σ", "1", 1.5, 50.0, "log", 4.0,
    equation="of the correntropy criterion (IDAM eq. 45)",
)  # fmt: skip
FORGETTING = Parameter(
    "forgetting", "ρ", "1", 0.85, 0.995, "log-complement", 0.9,
    equation="of R̂ from one measurement of a sensor to the next: ν⁻ = ρν, U⁻ = ρU (Huang et al. 2018)",
)  # fmt: skip
ITERATIONS = Parameter(
    "vb_iterations", "N_VB", "1", 1, 5, "linear", 3, integer=True, equation="QIVBF table 1",
)  # fmt: skip
METER = Parameter(
    "vibration_meter", "meter", "1", 0, 1, "linear", 0, integer=True, choices=("off", "on"),
    equation="whether q follows the noise seen in the accelerometers (not in the paper)",
)  # fmt: skip

_FILL = (FILL, FILL_VARIANCE, FILL_GROWTH, FILL_TURN)
_NOISE = (IMU_NOISE, DVL_NOISE, FIX_NOISE, MAGNETIC_NOISE)
KF = ParameterSpace((*_NOISE, *_FILL, GATE))
STUDENT = ParameterSpace((*_NOISE, *_FILL, FREEDOM))
MCC = ParameterSpace((*_NOISE, *_FILL, WIDTH))
VB = ParameterSpace((*_NOISE, *_FILL, FORGETTING, ITERATIONS))
BANK = ParameterSpace((*_NOISE, *_FILL, METER))
ORACLE = ParameterSpace((replace(IMU_NOISE, default=1.0), *_FILL))
