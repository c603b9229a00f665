"""The AUV's own navigator as a `Problem`."""

from __future__ import annotations

from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from navgym.ins.catalogue import CATALOGUE
from navgym.ins.conditions import InsRanges, draw, shifts
from navgym.ins.recording import InertialRecording
from navgym.ins.scenarios import CATALOGUE as SCENARIOS
from navgym.ins.scenarios import InsScenario
from navgym.ins.settings import SETTLED, INSDropoutSettings
from navgym.metrics.measures import CLIP, Measure, Quantity, by_name
from navgym.problem import (
    Amount,
    Contest,
    Environment,
    Preset,
    Problem,
    Rival,
    Scoring,
    Seer,
    Steering,
    Study,
    Tracks,
    Training,
    lazy,
)

outage = lazy("navgym.ins.tracks:outage")

STEERED = ("imu_noise_scale", "fill", "fill_variance")
_NOISE = ("imu_noise_scale", "dvl_noise_scale", "fix_noise_scale", "magnetic_noise_scale")


def _guess(batch: Any) -> dict[str, list[float]]:
    """The mean true scale of each kind's R in each regime, within the parameters' ranges."""
    recordings = batch.recordings
    count = len(recordings[0].meta["regimes"])
    found = {}
    for name, sensor, top in (("dvl_noise_scale", "dvl", 300.0), ("fix_noise_scale", "fix", 30.0), ("magnetic_noise_scale", "magnetometer", 100.0)):  # fmt: skip
        sums, heard = np.zeros(count), np.zeros(count)
        for r in recordings:
            if sensor in r.aiding:
                k = np.clip(
                    np.searchsorted(r.step_time, r.aiding[sensor].time - 1e-6), 0, r.steps - 1
                )
                np.add.at(sums, r.regime[k], r.noise_scales[sensor])
                np.add.at(heard, r.regime[k], 1.0)
        means = np.where(heard > 0, sums / np.maximum(heard, 1.0), 1.0)
        found[name] = np.clip(means, 1.0, top).tolist()
    return found


POSITION = Quantity("position", "position RMSE", "m")
VELOCITY = Quantity("velocity", "velocity RMSE", "m/s")
HEADING = Quantity("heading", "heading RMSE", "°")
VELOCITIES = Quantity("velocities", "one-step error of Doppler velocities", "m/s", needs_truth=False, clip=CLIP)  # fmt: skip
FIXES = Quantity("fixes", "one-step error of position fixes", "m", needs_truth=False, clip=CLIP)

SCORING = Scoring(
    quantities=MappingProxyType({q.name: q for q in (POSITION, VELOCITY, HEADING)}),
    measures=by_name(
        Measure("position", "RMSE of the horizontal position, m", (POSITION,)),
        Measure("velocity", "RMSE of the horizontal velocity, m/s", (VELOCITY,)),
        Measure("heading", "RMSE of the heading, °", (HEADING,)),
        Measure(
            "velocities", "one-step error of Doppler velocities, m/s: needs no truth", (VELOCITIES,)
        ),
        Measure("fixes", "one-step error of position fixes, m: needs no truth", (FIXES,)),
    ),
    errors=lazy("navgym.ins.scoring:errors"),
    squared=lazy("navgym.ins.scoring:squared"),
    scored=lazy("navgym.ins.scoring:scored"),
    nees=lazy("navgym.ins.scoring:nees"),
    foretold=MappingProxyType({"velocities": VELOCITIES, "fixes": FIXES}),
    rows=lazy("navgym.ins.scoring:rows"),
    settling=SETTLED,
    at_once=4,
)

STEERING = Steering(
    filter="ins_kf",
    free=_NOISE,
    scheduled=_NOISE[1:],
    fixed={},
    first=({"imu_noise_scale": 1.0}, {"dvl_noise_scale": 10.0, "fix_noise_scale": 10.0, "magnetic_noise_scale": 10.0}),
    measures=("position", "velocity"),
    beside=("ins_kf", "ins_student", "ins_vb", "ins_bank"),
    amount=Amount(100, 12, 12, 40),
    quick=Amount(4, 2, 2, 2),
    quick_overrides={"duration": 240.0},
    guess=_guess,
)  # fmt: skip

STUDY = Study(
    filter="ins_kf",
    scenario="ins/survey",
    amount=Amount(100, 12, 12, 40),
    free=_NOISE,
    referred=("ins_kf", "ins_student", "ins_mcc", "ins_vb", "ins_bank"),
    beside=("ins_kf", "ins_student", "ins_vb", "ins_bank"),
    steering=STEERING,
    # what a lost log is worth shows in no innovation while it is lost
    held=("fill", "fill_variance", "fill_growth", "fill_turn_limit"),
)

ENVIRONMENT = Environment(
    id="navgym/INSDropout-v0",
    settings=INSDropoutSettings,
    engine=lazy("navgym.ins.engine:InsEngine"),
    live=lazy("navgym.ins.live:LiveINS"),
    steered=STEERED,
    replayed=lambda _: CATALOGUE["ins_kf"],
)

TRAINING = Training(
    ranges=InsRanges,
    draw=draw,
    presets={
        "ins": Preset(
            "what stands in for a lost Doppler log, once per second",
            {
                "environment": ENVIRONMENT.id, "scenarios": ("ins/outage", "ins/burst"), "reward": "position",
                "action_parameters": ("fill_variance", "fill_growth"), "decision_interval": 5, "decisions": 250_000,
                "recipe": {"gamma": 0.995, "gae_lambda": 0.97}, "pool": 100, "validation": 24, "interval": 50_000,
            },
        ),
    },
)  # fmt: skip

CONTEST = Contest(
    quantities=("position", "velocity", "heading"),
    everywhere=("position", "velocity"),
    rivals=(
        Rival("predict only", "ins_kf", about="the plain filter: nothing stands in for a lost log"),
        Rival("hold", "ins_kf", {"fill": "hold"}, "the last velocity held, its variance growing"),
        Rival("student", "ins_student", about="the noise of each sensor a Student-t", adapts=True),
        Rival("vb", "ins_vb", about="R of each sensor estimated", adapts=True),
        Rival("bank", "ins_bank", about="16 hypotheses on R of each sensor; nothing in it was learnt", adapts=True),
        Rival("water track", "ins_kf", about="the plain filter with a log of the velocity through water, and states for the current", overrides={"water_period": 1.0}),
        Rival("oracle", "oracle", about="told the true noise of every measurement: a bound on noise, not on losses", bound=True),
    ),
    hand_rule=lazy("navgym.ins.rule:TurnGate"),
    rule="hold until the gyros have turned by 30°; it believes the IMU's data sheet",
    default="ins_kf",
    highlight="bank",
    top="oracle",
    yardstick="predict only",
    own=60,
    other=20,
    quick_own=6,
    quick_other=4,
    chunk=10,
    judged=2,
    others=("ins/burst", "ins/outage", "ins/dvl-switch"),
    shifts=shifts,
    quick_shifts=("tactical",),
    shift_first_only=True,
    streams_own=False,
    seers=(
        Seer("oracle gate", lazy("navgym.ins.oracles:gate"), "held only while the true body velocity is within .1 m/s of the last measured one: a bound on gates"),
        Seer("oracle variance", lazy("navgym.ins.oracles:variance"), "held with a variance that follows the true change since: a bound on fills"),
    ),
)  # fmt: skip

TRACKS = Tracks(
    name="akit",
    about="Tracks 1-6 of the Snapir AUV (A-KIT, github.com/ansfl/A-KIT, first upload): recorded IMU and Doppler "
    "log, depth and position fixes made from the post-processed reference, independent losses.",
    folds=((1, 2, 3), (4, 5, 6)),
    rates=(0.1, 0.3, 0.5),
    recording=lazy("navgym.ins.tracks:recording"),
    title="A-KIT",
    variants={
        f"{length:g} s lost{told}": partial(outage, length=length, imu_errors=grade)
        for grade, told in ((None, ""), ("mems", ", MEMS errors added"))
        for length in (60.0, 120.0)
    },
)

PROBLEM = Problem(
    name="ins",
    title="INS",
    recording=InertialRecording,
    scenario=InsScenario,
    scenarios=SCENARIOS,
    simulate=lazy("navgym.ins.simulation:simulate"),
    brief={"duration": 4.0},
    readers={
        "akit_ins": "navgym.ins.akit:read_akit_ins",
        "ins_csv": "navgym.ins.csv_set:read_ins_csv",
        "ins_log": "navgym.ins.device_log:read_ins_log",
    },
    told=lazy("navgym.ins.told:told"),
    evidence=lazy("navgym.ins.inspection:evidence"),
    marks={"ins_csv": r"\bimu\.csv"},
    filters=CATALOGUE,
    stack=lazy("navgym.ins.batch:InsBatch.of"),
    runner=lazy("navgym.ins.estimation:run"),
    estimate=lazy("navgym.ins.estimation:estimate"),
    smoother=lazy("navgym.ins.smoothing:smooth"),
    noises=lazy("navgym.ins.scoring:noises"),
    kernels=lazy("navgym.ins.warm:kernels"),
    plain=("ins_kf",),
    bound="oracle",
    scoring=SCORING,
    study=STUDY,
    environment=ENVIRONMENT,
    training=TRAINING,
    contest=CONTEST,
    tracks=TRACKS,
)  # fmt: skip
