"""The tunables of the deck's filters, declared once; rows stand in the order of the kernels' columns."""

from __future__ import annotations

from dataclasses import replace

from navgym.core.parameters import Parameter, ParameterSpace
from navgym.statespace.filters.spaces import PROCESS

KERNEL_WIDTH = Parameter(
    "kernel_width", "σ", "1", 1.5, 50.0, "log", 10.0,
    equation="of the correntropy kernel (IDAM eq. 45, 53); at 50 the criterion is off",
)  # fmt: skip
VELOCITY_NOISE = Parameter(
    "velocity_noise", "r_V", "m/s", 0.01, 3.0, "log", 0.2,
    equation="std of a velocity difference (w_k of IDAM eq. 78)",
)  # fmt: skip
MODEL_ERROR_WEIGHT = Parameter(
    "model_error_weight", "A", "1", 1e-3, 1e6, "log", 1e6,
    equation="cost of a predicted model error, in units of dt/q (IDAM eq. 39-40); at 1e6 it is off",
)  # fmt: skip
DECK_PROCESS = replace(
    PROCESS, low=0.01, high=100.0, equation="multiplies the flexure's Q (IDAM eq. 3, corrected)"
)
RVM_KERNEL_SCALE = Parameter(
    "rvm_kernel_scale", "s", "s", 0.5, 32.0, "log", 2.0,
    equation="of the relevance vector machine's Gaussian kernel over lags (IDAM eq. 25)",
)  # fmt: skip
IDENTIFICATION_WINDOW = Parameter(
    "identification_window", "W", "s", 60.0, 600.0, "log", 120.0, at_start=True,
    equation="length of the records that the flexure is identified from (IDAM 3.2)",
)  # fmt: skip

ALIGNMENT = ParameterSpace((VELOCITY_NOISE, DECK_PROCESS))
ALIGNMENT_MCC = ParameterSpace((KERNEL_WIDTH, VELOCITY_NOISE, DECK_PROCESS))
_ROBUST = (KERNEL_WIDTH, VELOCITY_NOISE, MODEL_ERROR_WEIGHT, DECK_PROCESS)
IDAM = ParameterSpace((*_ROBUST, RVM_KERNEL_SCALE, IDENTIFICATION_WINDOW))
IDENTIFIED = ParameterSpace((*_ROBUST, IDENTIFICATION_WINDOW))
IDAM_PRINTED = ParameterSpace(
    (
        KERNEL_WIDTH, VELOCITY_NOISE, replace(MODEL_ERROR_WEIGHT, default=10.0), DECK_PROCESS,
        RVM_KERNEL_SCALE, IDENTIFICATION_WINDOW,
    )
)  # fmt: skip

_EVENTS = (
    Parameter(
        "mode_stay", "p_s", "1", 0.8, 0.9999, "log-complement", 0.99,
        equation="probability that a mode stays for 1 s (not in the paper; Blom & Bar-Shalom 1988)",
    ),
    Parameter(
        "slam_rate", "λ_s", "1/s", 0.01, 10.0, "log", 0.2,
        equation="jumps of θ̇ per second in the slam mode (not in the paper)",
    ),
    Parameter(
        "slam_size", "s_s", "1", 0.5, 50.0, "log", 4.0,
        equation="std of a jump over that of θ̇, bσ (not in the paper)",
    ),
    Parameter(
        "glitch_rate", "p_g", "1", 1e-3, 0.5, "log", 0.1,
        equation="probability, per channel and filter step, of a wrong value in the glitch mode (not in the paper)",
    ),
    Parameter(
        "glitch_velocity", "g_V", "m/s", 0.01, 100.0, "log", 1.0,
        equation="std of a wrong velocity (not in the paper)",
    ),
    Parameter(
        "glitch_rate_size", "g_ω", "rad/s", 1e-5, 0.1, "log", 2e-3,
        equation="std of a wrong rate (not in the paper)",
    ),
    Parameter(
        "own_channels", "G", "1", 0, 1, "linear", 1, integer=True, choices=("off", "on"),
        equation="innovations of V_s and ω_s alone, (I + l×)⁻¹ times those of IDAM eq. 78, once l is known",
    ),
)  # fmt: skip
_LEVER = Parameter(
    "lever_sd", "σ_r", "m", 0.0, 1.0, "linear", 0.0, at_start=True,
    equation="std of the lever arm's error, which is then estimated; at 0 it is not (not in the paper)",
)  # fmt: skip
_TRUSTED = replace(VELOCITY_NOISE, low=1e-3)
DECK_BANK = ParameterSpace((_TRUSTED, DECK_PROCESS, *_EVENTS, _LEVER))
DECK_BANK_LEVER = ParameterSpace(
    (replace(_TRUSTED, default=2e-3), DECK_PROCESS, *_EVENTS, replace(_LEVER, default=0.1))
)
