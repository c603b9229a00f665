"""The AUV as a `Problem`."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import numpy as np

from navgym.auv.conditions import AUVRanges, draw
from navgym.auv.scenarios import CATALOGUE as SCENARIOS
from navgym.auv.scenarios import SHIFTS, AUVScenario
from navgym.auv.settings import AUVDropoutSettings
from navgym.formats.kinds import MARK as DEVICE_LOG
from navgym.metrics.measures import CLIP, Measure, Quantity, by_name
from navgym.problem import (
    Amount,
    Contest,
    Environment,
    Preset,
    Problem,
    Rival,
    Scoring,
    Steering,
    Study,
    Tracks,
    Training,
    lazy,
)
from navgym.statespace.batch import StateSpaceBatch
from navgym.statespace.filters.catalogue import CATALOGUE
from navgym.statespace.models import LinearModel
from navgym.statespace.recording import Recording

# what matters in a variational filter
STEERED = ("vb_iterations", "prior_count", "forgetting", "process_noise_scale")
SCHEDULED = ("forgetting", "process_noise_scale")
# Parameters by true regime, from `python -m navgym.agents.evaluation.regime_tables`: tuned on 40 training
# recordings from the best fixed parameters, the best of the leaders on 40 validation recordings.
_TABLES: dict[str, dict[str, tuple[float, float]]] = {
    "switch-A": {
        "calm": (0.932, 0.78), "noisy": (0.967, 1.5), "outlier": (0.72, 6.8), "burst": (0.89, 2.5),
    },
    "switch-B": {
        "calm": (0.86, 1.3), "noisy": (0.965, 1.3), "outlier": (0.78, 12.0), "burst": (0.85, 1.3),
        "manoeuvre": (0.89, 70.0),
    },
    "switch-D": {"nominal": (0.915, 1.1), "outlier": (0.79, 10.0), "manoeuvre": (0.88, 120.0)},
    "tvr": {"calm": (0.83, 2.8), "noisy": (0.9987, 1.1)},
}  # fmt: skip


def _guess(batch: StateSpaceBatch) -> dict[str, list[float]]:
    """The true Q of each regime; the model's where a regime does not occur."""
    labels = np.concatenate(batch.regimes())
    scales = np.concatenate([r.process_scale for r in batch.recordings])
    count = len(batch.recordings[0].meta["regimes"])
    here = [scales[labels == g] for g in range(count)]
    return {"process_noise_scale": [float(q.mean()) if len(q) else 1.0 for q in here]}


def _refuses(scenario: Any) -> str | None:
    """Why the environment's filter cannot play a scenario."""
    if isinstance(scenario.model, LinearModel):
        return None
    return "its model is nonlinear: choose a scenario with a linear one, such as 'auv/switch-D'"


RMSE = Quantity("rmse", "position RMSE", "m")
FIXES = Quantity("fixes", "one-step error of the position fixes", "m", needs_truth=False, clip=CLIP)
VELOCITIES = Quantity("velocities", "one-step error of the velocities", "m/s", needs_truth=False, clip=CLIP)  # fmt: skip

SCORING = Scoring(
    quantities=MappingProxyType({"rmse": RMSE}),
    measures=by_name(
        Measure("rmse", "position RMSE, m", (RMSE,)),
        Measure("fixes", "one-step error of the position fixes, m: needs no truth", (FIXES,)),
        Measure(
            "velocities", "one-step error of the velocities, m/s: needs no truth", (VELOCITIES,)
        ),
    ),
    errors=lazy("navgym.auv.scoring:errors"),
    squared=lazy("navgym.auv.scoring:squared"),
    scored=lazy("navgym.auv.scoring:scored"),
    nees=lazy("navgym.auv.scoring:nees"),
    foretold=MappingProxyType({"fixes": FIXES, "velocities": VELOCITIES}),
    rows=lazy("navgym.auv.scoring:rows"),
)

STEERING = Steering(
    filter="qivbf",
    free=STEERED,
    scheduled=SCHEDULED,
    # the prototype's priors, so that best fixed means the same four parameters
    fixed={"initial_count": 5.0, "initial_scale": 1.0},
    first=tuple(
        {"vb_iterations": 5, "prior_count": tau, "forgetting": 0.9, "process_noise_scale": 30.0}
        for tau in (10.0, 2.0)
    ),
    measures=("rmse",),
    beside=("kf", "imm", "imm_wide", "bank", "bank_2026"),
    amount=Amount(200, 40, 40, 300),
    quick=Amount(8, 8, 8, 20),
    quick_overrides={"steps": 200},
    guess=_guess,
)

STUDY = Study(
    filter="qivbf",
    scenario="auv/switch-D",
    amount=Amount(200, 40, 100, 300),
    free=STEERED,
    referred=("qivbf",),
    beside=("kf", "imm", "imm_wide", "bank", "ekf", "ukf", "ckf"),
    steering=STEERING,
    tables={
        name: {g: dict(zip(SCHEDULED, row, strict=True)) for g, row in table.items()}
        for name, table in _TABLES.items()
    },
)

ENVIRONMENT = Environment(
    id="navgym/AUVDropout-v0",
    settings=AUVDropoutSettings,
    engine=lazy("navgym.auv.engine:Engine"),
    live=lazy("navgym.auv.live:LiveAUV"),
    steered=("process_noise_scale", "forgetting"),
    replayed=lambda _: CATALOGUE["qivbf"],
    refuses=_refuses,
)

FEW = (
    "filter.log_nis.0.8", "filter.log_nis.0.95", "filter.correlation.0.8", "filter.correlation.0.95",
    "filter.power_position.0.95", "filter.power_velocity.0.8", "filter.power_velocity.0.95", "lost.0.95",
    "since_received", "noise_position", "noise_velocity",
)  # fmt: skip
TRAINING = Training(
    ranges=AUVRanges,
    draw=draw,
    presets={
        "auv": Preset("a specialist for auv/switch-D, in a minute or two", {}),
        "auv-b": Preset("a specialist for auv/switch-B", {"scenarios": ("auv/switch-B",)}),
        "auv-robust": Preset(
            "for any sea: conditions are drawn anew for each recording; what agents/pretrained holds",
            {
                "randomise": True,
                "untouched": 0.6,
                "references": True,
                "reward": "relative",
                "pool": 2000,
                "decisions": 2_000_000,
                "ranges": {
                    "chance": 0.3,
                    "quick": 0.25,
                    "measurement_scale": (0.1, 100.0),
                    "dwell": (8.0, 300.0),
                },
            },
        ),
        # few observations, few units, half the range: what carries over from some tracks to others
        "auv-logs": Preset(
            "for one's own vessel: what auv means with --log",
            {
                "observations": FEW,
                "reach": 0.5,
                "decisions": 200_000,
                "interval": 20_000,
                "recipe": {"hidden": (16, 16), "gamma": 0.5},
            },
        ),
    },
)

CONTEST = Contest(
    quantities=("rmse",),
    everywhere=("rmse",),
    rivals=(
        Rival("kf", "kf", about="the plain filter: predicts only where a sample is lost"),
        Rival("kf_extrapolate", "kf_extrapolate", about="the plain filter with quadratic fill", real_only=True),
        Rival("imm, models off ×3", "imm", {"measurement_noise_scale": 1.0 / 3.0}, "the IMM with every R three times too small"),
        Rival("imm", "imm", about="6 Kalman filters over R and Q, weighed by how well they predict", adapts=True),
        Rival("imm_wide", "imm_wide", about="13 Kalman filters over R and Q, likewise", adapts=True),
        Rival("bank", "bank", about="68 Kalman filters over noise, motion and outliers; nothing in it was learnt", adapts=True),
        Rival("bank_2026", "bank_2026", about="the bank as it was first: 24 filters, one R scale for all sensors", adapts=True),
        Rival("oracle", "oracle", about="told the true noise of every sample: a bound", bound=True),
    ),
    hand_rule=lazy("navgym.auv.rule:CovarianceMatching"),
    rule="covariance matching on innovations",
    default="qivbf",
    highlight="bank",
    top="oracle",
    yardstick="oracle",
    own=300,
    other=300,
    quick_own=40,
    quick_other=40,
    chunk=100,
    judged=60,
    others=("auv/switch-B", "auv/switch-D", "auv/switch-A", "auv/student", "auv/turn"),
    shifts=lambda _: SHIFTS,
    quick_shifts=("loss .3", "R x3", "dwell 20-60"),
)  # fmt: skip

TRACKS = Tracks(
    name="akit",
    about="Tracks 1-6 of the Snapir AUV (A-KIT, github.com/ansfl/A-KIT): real Doppler velocity, "
    "position fixes made from the post-processed reference with 1 m of noise, independent losses.",
    folds=((1, 2, 3), (4, 5, 6)),
    rates=(0.1, 0.3, 0.5),
    recording=lazy("navgym.auv.tracks:recording"),
    title="A-KIT",
)

PROBLEM = Problem(
    name="auv",
    title="AUV",
    recording=Recording,
    scenario=AUVScenario,
    scenarios=SCENARIOS,
    simulate=lazy("navgym.auv.simulation:simulate"),
    brief={"steps": 10},
    readers={
        "akit": "navgym.auv.akit:read_akit",
        "csv": "navgym.auv.csv_log:read_csv",
        "log": "navgym.auv.device_log:read_log",
    },
    told=lazy("navgym.auv.told:told"),
    evidence=lazy("navgym.auv.inspection:evidence"),
    marks={"akit": r"\bGT_trajectory\d+\.csv", "log": DEVICE_LOG},
    filters=CATALOGUE,
    stack=StateSpaceBatch.of,
    runner=lazy("navgym.statespace.run:run"),
    estimate=lazy("navgym.statespace.run:estimate"),
    smoother=lazy("navgym.statespace.smoothing:smooth"),
    noise=lazy("navgym.statespace.noise:space"),
    believing=lazy("navgym.statespace.noise:believing"),
    noises=lazy("navgym.statespace.believed:noises"),
    kernels=lazy("navgym.auv.warm:kernels"),
    plain=("kf", "ekf"),
    bound="oracle",
    scoring=SCORING,
    study=STUDY,
    environment=ENVIRONMENT,
    training=TRAINING,
    contest=CONTEST,
    tracks=TRACKS,
)
