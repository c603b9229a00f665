"""The tunables of every filter, declared once; rows stand in the order of the kernels' columns."""

from __future__ import annotations

from dataclasses import replace

from navgym.core.parameters import Parameter, ParameterSpace

ANY_SCALE = (1e-6, 1e6)  # a log's model may be off by more than one would search by oneself
PROCESS = Parameter(
    "process_noise_scale", "q", "1", 0.1, 1000.0, "log", 1.0, widest=ANY_SCALE,
    equation="multiplies Q (QIVBF table 2)",
)  # fmt: skip
MEASUREMENT = Parameter(
    "measurement_noise_scale", "r", "1", 0.01, 1000.0, "log", 1.0, widest=ANY_SCALE,
    equation="multiplies R (QIVBF table 2)",
)  # fmt: skip
INFLATION = Parameter(
    "fill_inflation", "c", "1", 1.0, 100.0, "log", 1.0,
    equation="multiplies the fill's variance Σl² R (QIVBF eq. 28, corrected)",
)  # fmt: skip
SPREAD = Parameter(
    "sigma_spread", "a", "1", 0.1, 2.0, "log", 0.775,
    equation="QIVBF eq. 7; √(3/5) matches the fourth moment of five states",
)  # fmt: skip

KALMAN = ParameterSpace((PROCESS, MEASUREMENT))
SIGMA = ParameterSpace((PROCESS, MEASUREMENT, SPREAD))
KALMAN_FILL = ParameterSpace((PROCESS, MEASUREMENT, INFLATION))
NONE = ParameterSpace(())

# Defaults: one setting for the whole catalogue, that no unmodelled motion locks out, from
#     python scripts/choose_defaults.py defaults
# which says what it costs where the model is right. Best settings per scenario are in
# navgym.auv.scenarios (`reference`).
_VB = (
    Parameter(
        "vb_iterations", "N_VB", "1", 1, 20, "linear", 5, integer=True, equation="QIVBF table 1",
    ),
    Parameter(
        "prior_count", "τ", "1", 0.1, 300.0, "log", 8.7,
        equation="weight of P⁻ in P̂, s (QIVBF eq. 34, 37, corrected)",
    ),
    Parameter(
        "forgetting", "ρ", "1", 0.6, 0.999, "log-complement", 0.985,
        equation="per second: ν⁻ = ρν, U⁻ = ρU (not in the paper; Huang et al. 2018)",
    ),
    Parameter(
        "initial_count", "ν0", "1", 1.0, 100.0, "log", 49.0,
        equation="first count of R̂, s (QIVBF table 1, init, corrected)", at_start=True,
    ),
    Parameter(
        "initial_scale", "r0", "1", 0.01, 100.0, "log", 0.77,
        equation="first R̂ over R (QIVBF table 1, init, corrected)", at_start=True,
    ),
    replace(PROCESS, default=15.0),
)  # fmt: skip
FILL = Parameter(
    "fill", "fill", "1", 0, 1, "linear", 0, integer=True, choices=("skip", "extrapolate"),
    equation="what a lost sample becomes (QIVBF eq. 27-28, corrected)",
)  # fmt: skip
VBAKF = ParameterSpace(_VB)
# the printed filter keeps priors that make its first expectations P⁻ and R
PRINTED = ParameterSpace((_VB[0], replace(_VB[1], default=5.0), replace(_VB[3], default=5.0)))
QIVBF = ParameterSpace((*_VB, FILL, INFLATION))

_MODE_STAY = Parameter(
    "mode_stay", "p_s", "1", 0.8, 0.9999, "log-complement", 0.97,
    equation="probability that a mode stays for 1 s (not in the paper; Blom & Bar-Shalom 1988)",
)  # fmt: skip
IMM = ParameterSpace((PROCESS, MEASUREMENT, _MODE_STAY))
BANK = ParameterSpace(
    (
        PROCESS,
        MEASUREMENT,
        Parameter(
            "scale_stay", "p_R", "1", 0.8, 0.9999, "log-complement", 0.995,
            equation="probability that the R scale stays for 1 s (not in the paper)",
        ),
        Parameter(
            "regime_stay", "p_g", "1", 0.8, 0.9999, "log-complement", 0.985,
            equation="probability that the regime stays for 1 s (not in the paper)",
        ),
        Parameter(
            "outlier_rate", "ε", "1", 0.0, 0.5, "linear", 0.2,
            equation="probability of an outlier in the outlier regime (not in the paper)",
        ),
    )
)  # fmt: skip
