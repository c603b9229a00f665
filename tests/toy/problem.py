"""The toy as a `Problem`."""

import numpy as np

from navgym.envs.rules import HandRule
from navgym.metrics.measures import Measure, Quantity, by_name
from navgym.problem import (
    Amount,
    Contest,
    Environment,
    Filter,
    Preset,
    Problem,
    Rival,
    Scoring,
    Steering,
    Study,
    Training,
    lazy,
)
from navgym.statespace.filters.spaces import NONE
from tests.toy.settings import SPACE, ToyWalkSettings
from tests.toy.world import SCENARIOS, WalkRanges, WalkRecording, WalkScenario, draw, simulate

FILTERS = {
    f.name: f
    for f in (
        Filter("walk_kf", "scalar Kalman filter of a walk at random", SPACE, "walk"),
        Filter("oracle", "the same, told the true process noise", NONE, "walk", needs_scales=True),
    )
}
ERROR = Quantity("rmse", "RMSE", "m")


class ByNis(HandRule):
    """More process noise where innovations are larger than the filter believes, less where smaller."""

    steered = ("process_noise_scale",)

    def begin(self, lanes, reference):
        self._q = np.full(lanes, float(reference["process_noise_scale"]))

    def choose(self, signal):
        self._q = np.clip(self._q * np.exp(0.5 * signal("log_nis.0.9")), 1.0, 100.0)
        return {"process_noise_scale": self._q}


PROBLEM = Problem(
    name="toy",
    title="Toy",
    recording=WalkRecording,
    scenario=WalkScenario,
    scenarios=SCENARIOS,
    simulate=simulate,
    brief={"steps": 10},
    readers={"walk": "tests.toy.world:read_walk"},
    filters=FILTERS,
    stack=lazy("tests.toy.filtering:WalkBatch.of"),
    runner=lazy("tests.toy.filtering:run"),
    estimate=lazy("tests.toy.filtering:estimate"),
    kernels=lazy("tests.toy.filtering:warm"),
    plain=("walk_kf",),
    bound="oracle",
    scoring=Scoring(
        quantities={"rmse": ERROR},
        measures=by_name(Measure("rmse", "RMSE, m", (ERROR,))),
        errors=lazy("tests.toy.filtering:errors"),
        squared=lazy("tests.toy.filtering:squared"),
        scored=lazy("tests.toy.filtering:scored"),
        nees=lazy("tests.toy.filtering:nees"),
    ),
    study=Study(
        filter="walk_kf",
        scenario="toy/switch",
        amount=Amount(40, 20, 20, 60),
        free=(),
        referred=("walk_kf",),
        beside=("walk_kf",),
        steering=Steering(
            filter="walk_kf",
            free=("process_noise_scale",),
            scheduled=("process_noise_scale",),
            fixed={},
            first=(),
            measures=("rmse",),
            beside=("walk_kf",),
            amount=Amount(40, 20, 20, 60),
            quick=Amount(4, 4, 4, 4),
            quick_overrides={"steps": 60},
            guess=lambda _: {"process_noise_scale": [1.0, 100.0]},
        ),
        tables={
            "switch": {
                "calm": {"process_noise_scale": 1.0}, "rough": {"process_noise_scale": 100.0},
            }
        },
    ),
    environment=Environment(
        id="navgym/ToyWalk-v0",
        settings=ToyWalkSettings,
        engine=lazy("tests.toy.environment:WalkEngine"),
        live=lazy("tests.toy.environment:LiveWalk"),
        steered=("process_noise_scale",),
        replayed=lambda _: FILTERS["walk_kf"],
    ),
    training=Training(
        ranges=WalkRanges,
        draw=draw,
        presets={
            "toy": Preset(
                "the walk's process noise",
                {"action_parameters": ("process_noise_scale",), "decisions": 20_000, "pool": 64},
            )
        },
    ),
    contest=Contest(
        quantities=("rmse",),
        everywhere=("rmse",),
        rivals=(
            Rival("plain", "walk_kf", about="the plain filter"),
            Rival("oracle", "oracle", about="told the true process noise: a bound", bound=True),
        ),
        hand_rule=ByNis,
        rule="process noise by NIS",
        default="walk_kf",
        highlight="",
        top="oracle",
        yardstick="oracle",
        own=60,
        other=60,
        quick_own=8,
        quick_other=8,
        chunk=20,
        judged=4,
        others=("toy/calm",),
        shifts=lambda _: {"loss .5": {"loss": 0.5}, "Q x4": {"process_scale": 4.0}},
        quick_shifts=("loss .5",),
    ),
)  # fmt: skip
