"""The bending deck as a `Problem`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from navgym.deck import spaces
from navgym.deck.catalogue import CATALOGUE
from navgym.deck.conditions import DeckRanges, draw, shifts
from navgym.deck.recording import DualIMURecording
from navgym.deck.scenarios import DECK_CATALOGUE, DeckScenario
from navgym.deck.settings import START, DeckDeformationSettings
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

# The correntropy criterion against glitches, and off elsewhere.
_WIDTHS = {"calm": 50.0, "swell": 50.0, "slam": 50.0, "glitch": 2.0}
_SWITCHING = ("switch-60", "switch-30", "switch-gyro")
# what a lane of the environment runs while nobody identifies: every parameter of idam, the flexure
# as believed
STEERED = replace(CATALOGUE["alignment_mcc"], space=spaces.IDAM)


def _guess(batch: Any) -> dict[str, list[float]]:
    """The kernel narrow where there are glitches, and off elsewhere."""
    regimes = batch.recordings[0].meta["regimes"]
    return {"kernel_width": [2.0 if "glitch" in name else 50.0 for name in regimes]}


def _replayed(settings: Mapping[str, Any]) -> Filter:
    """The filter that a lane runs: idam itself where the agent sets how the flexure is identified."""
    identifies = "rvm_kernel_scale" in settings.get("action_parameters", ())
    found = CATALOGUE["idam"] if identifies else STEERED
    if not settings.get("own_channels", False):
        return found
    return replace(found, option=replace(found.option, own=True))


def _score(settings: Any, gains: Mapping[str, float]) -> float:
    """Gains weighed as the environment's composite reward weighs them."""
    ac, price = float(settings.ac_weight), float(settings.theta_price)
    worse = min(gains["theta_rmse"], 0.0)
    return gains["theta_rate_rmse"] + ac * gains["theta_ac_rmse"] + price * worse


_QUANTITIES = {
    q.name: q
    for q in (
        Quantity("theta_rate", "θ̇ RMSE", "′/s"),
        Quantity("theta_ac", "θ_ac RMSE", "′"),
        Quantity("theta", "θ RMSE", "′"),
        Quantity("attitude", "attitude RMSE", "′"),
    )
}
_RATE, _AC, _THETA, _ATTITUDE = _QUANTITIES.values()
# Nothing is cut: a glitch counts the same whatever the parameters, what it leaves behind does not.
RATES = Quantity("rates", "one-step error of the matched rates", "′/s", needs_truth=False)

SCORING = Scoring(
    quantities=MappingProxyType(_QUANTITIES),
    measures=by_name(
        Measure(
            "composite",
            "θ̇ and the fast part of θ, each over the plain filter's; θ may grow by 2 % at most",
            (_RATE, _AC),
            ((_THETA, 0.02),),
        ),
        Measure("theta_rate", "RMSE of θ̇, ′/s", (_RATE,)),
        Measure("theta_ac", "RMSE of θ less its 60 s mean, ′", (_AC,)),
        Measure("theta", "RMSE of θ, ′", (_THETA,)),
        Measure("attitude", "RMSE of the total attitude, ′", (_ATTITUDE,)),
        Measure("rates", "one-step error of the matched rates, ′/s: needs no truth", (RATES,)),
    ),
    errors=lazy("navgym.deck.scoring:errors"),
    squared=lazy("navgym.deck.scoring:squared"),
    scored=lazy("navgym.deck.scoring:scored"),
    nees=lazy("navgym.deck.scoring:nees"),
    foretold=MappingProxyType({"rates": RATES}),
    rows=lazy("navgym.deck.scoring:rows"),
    settling=START,
    at_once=1,
)

STEERING = Steering(
    filter="alignment_mcc",
    free=("kernel_width",),
    scheduled=("kernel_width",),
    fixed={},
    first=(),
    measures=("theta_rate", "theta_ac", "theta"),
    beside=("alignment", "deck_bank"),
    amount=Amount(60, 16, 16, 60),
    quick=Amount(4, 2, 2, 2),
    quick_overrides={},
    guess=_guess,
)

STUDY = Study(
    held=(
        "velocity_noise",
    ),  # it lets the lever arm's errors into θ, which foretells no worse for it
    filter="alignment_mcc",
    scenario="deck/switch-60",
    amount=Amount(60, 16, 16, 60),
    free=(),
    referred=("alignment_mcc", "idam", "idam_printed", "svram", "woam"),
    beside=("alignment", "alignment_mcc", "idam", "deck_bank"),
    steering=STEERING,
    tables={n: {g: {"kernel_width": w} for g, w in _WIDTHS.items()} for n in _SWITCHING},
)

ENVIRONMENT = Environment(
    id="navgym/DeckDeformation-v0",
    settings=DeckDeformationSettings,
    engine=lazy("navgym.deck.engine:DeckEngine"),
    live=lazy("navgym.deck.live:LiveDeck"),
    steered=("kernel_width",),
    replayed=_replayed,
    score=_score,
)

TRAINING = Training(
    ranges=DeckRanges,
    draw=draw,
    presets={
        "deck": Preset(
            "kernel width of the deck filter, twice a second; what agents/pretrained holds",
            {
                "environment": ENVIRONMENT.id, "scenarios": ("deck/switch-60", "deck/switch-gyro"),
                "reward": "composite", "action_parameters": ("kernel_width",),
                "decision_interval": 10, "decisions": 300_000, "recipe": {"gamma": 0.95},
                "pool": 64, "validation": 16, "interval": 50_000,
            },
        ),
        "deck-robust": Preset(
            "the same under conditions drawn for each recording, by the sub IMU's own channels",
            {
                "environment": ENVIRONMENT.id, "scenarios": ("deck/switch-60", "deck/switch-gyro"),
                "reward": "composite", "action_parameters": ("kernel_width",),
                "arguments": {"own_channels": True}, "randomise": True, "ranges": {"chance": 0.25},
                "decision_interval": 10, "decisions": 400_000, "recipe": {"gamma": 0.95},
                "pool": 128, "validation": 24, "interval": 50_000,
            },
        ),
    },
)  # fmt: skip

CONTEST = Contest(
    quantities=("theta_rate", "theta_ac", "theta", "attitude"),
    everywhere=("theta_rate", "theta_ac", "theta"),  # the attitude takes as long as the filters
    rivals=(
        Rival("MCC off", "alignment", about="the plain filter: without correntropy"),
        Rival("deck_bank", "deck_bank", about="calm, rougher sea, slam and glitch side by side, weighed by what they foretell: no width to choose, nothing learnt", adapts=True),
        Rival("deck_bank_lever", "deck_bank_lever", about="the same with an error of the lever arm among its states, velocities trusted", adapts=True),
        Rival("oracle", "oracle", about="told the true flexure and noises of every step: a bound", bound=True),
    ),
    hand_rule=lazy("navgym.deck.rule:ResidualSign"),
    rule="the sign of what follows a large gyro residual",
    default="alignment_mcc",
    highlight="deck_bank",
    top="true-regime table",
    # the bound knows the regime from the first step on, everybody else may begin badly in a glitch
    yardstick="MCC off",
    own=200,
    other=30,  # policies run with their fallback there: a recording takes seconds
    quick_own=8,
    quick_other=4,
    chunk=10,
    judged=1,
    others=("deck/switch-gyro", "deck/switch-30", "deck/switch-60"),
    shifts=shifts,
    quick_shifts=("15 s segments",),
    quick={"duration": 240.0},
    shift_first_only=True,
    streams_own=False,
)  # fmt: skip

PROBLEM = Problem(
    name="deck",
    title="Deck",
    recording=DualIMURecording,
    scenario=DeckScenario,
    scenarios=DECK_CATALOGUE,
    simulate=lazy("navgym.deck.simulation:simulate"),
    brief={"duration": 4.0},
    readers={
        "deck_csv": "navgym.deck.csv_log:read_deck_csv",
        "deck_log": "navgym.deck.device_log:read_deck_log",
        "multi_imu": "navgym.deck.public_logs:read_multi_imu",
        "repoimu": "navgym.deck.public_logs:read_repoimu",
    },
    told=lazy("navgym.deck.told:told"),
    evidence=lazy("navgym.deck.inspection:evidence"),
    marks={
        "deck_csv": r"\b(main|sub)_(gyro|acc)_[xyz]\b",
        "multi_imu": r"\bpath_\d+_IMU_\d+\.csv",
        "repoimu": r"\bPendulum_\w+_Segment_\d+\.csv",
    },
    filters=CATALOGUE,
    stack=lazy("navgym.deck.batch:DeckBatch.of"),
    runner=lazy("navgym.deck.estimation:run"),
    estimate=lazy("navgym.deck.estimation:estimate"),
    smoother=lazy("navgym.deck.smoothing:smooth"),
    noises=lazy("navgym.deck.scoring:noises"),
    kernels=lazy("navgym.deck.warm:kernels"),
    plain=("alignment",),
    bound="oracle",
    scoring=SCORING,
    study=STUDY,
    environment=ENVIRONMENT,
    training=TRAINING,
    contest=CONTEST,
)
