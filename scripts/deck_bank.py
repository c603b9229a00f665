"""What the deck's bank is worth, in seas that it expects and in seas that it does not.

    python scripts/deck_bank.py                    every table, 60 recordings: half an hour on one core
    python scripts/deck_bank.py --runs 8           a look
    python scripts/deck_bank.py --only seas lags   some of the tables
    python scripts/deck_bank.py --split train      for whoever changes the bank

Errors are RMS lengths from 60 s on, means over recordings; gains are paired, with 95 % intervals.
"fixed" is `alignment_mcc` at the scenario's best fixed width, "policy" the shipped policy without its
fallback, the oracle knows flexure, slams and glitches. Where the bank has something wrong, its
parameters say so or the scenario does. Recordings are of test seeds, which nothing was chosen on.
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from navgym import agents
from navgym.agents.evaluation.contest import choosing
from navgym.agents.evaluation.rollout import Learnt
from navgym.core.checks import Array
from navgym.deck import alignment, alignment_model, bank, hypotheses, joint
from navgym.deck.catalogue import CATALOGUE, Deck
from navgym.deck.conditions import mild
from navgym.deck.errors import deck_errors, run_errors
from navgym.deck.problem import PROBLEM
from navgym.deck.scenarios import (
    CALM,
    GLITCH,
    GUESS,
    HEAVY_SEA,
    SLAM,
    SUB_ERRORS,
    SWELL,
    DeckRegime,
)
from navgym.deck.spaces import ALIGNMENT_MCC
from navgym.inertial.flexure import ARCMIN
from navgym.metrics import paired_difference
from navgym.problem import Filter
from navgym.simulation import find_scenario
from navgym.tuning.cases import Cases

QUANTITIES = ("theta_rate", "theta_ac", "theta", "attitude")
CHUNK = 10  # recordings in memory at a time
START = 1200  # filter steps that are not scored
Found = dict[str, Any]


@dataclass(frozen=True)
class Options:
    """What was asked for."""

    runs: int = 60
    """recordings per condition"""
    only: tuple[Literal["main", "shifts", "wrong", "seas", "lags", "widths", "nees", "identified", "told", "smoothed"], ...] = ()  # fmt: skip
    """tables to make; none: all"""
    split: str = "test"
    """whose seeds"""
    out: Path | None = None
    """a JSON file to write"""


@dataclass(frozen=True)
class Condition:
    """Recordings, and what the banks are told.

    Args:
        scenario: full name.
        overrides: of the scenario.
        told: parameters of both banks.
        best: whether the shipped policy and the fixed width are there too.
    """

    scenario: str = "deck/switch-60"
    overrides: Mapping[str, Any] = field(default_factory=dict)
    told: Mapping[str, Any] = field(default_factory=dict)
    best: bool = True

    def parts(self, options: Options) -> Any:
        """The recordings, some at a time."""
        for first in range(0, options.runs, CHUNK):
            count = min(CHUNK, options.runs - first)
            yield Cases.simulated(self.scenario, options.split, count, first, **self.overrides)


def _regimes(change: Callable[[DeckRegime], DeckRegime]) -> dict[str, Any]:
    """switch-60's regimes, changed; the filter believes what it believed."""
    return {"regimes": tuple(change(r) for r in (CALM, SWELL, SLAM, GLITCH)), "believed": CALM}


def _change(regime: DeckRegime, name: str, **fields: Any) -> DeckRegime:
    return dataclasses.replace(regime, **fields) if regime.name == name else regime


_BOTH = dataclasses.replace(SLAM, name="slam", glitch_rate=0.1)
_PER_AXIS = {"tau": (5.0, 15.0, 20.0), "sigma": (9.0, 4.0, 15.0)}
_FIRST_SEA = DeckRegime("sea", tau=(8.0, 8.0, 20.0), sigma=(7.5, 7.5, 11.0), oscillation=0.75)
_SECOND_SEA = DeckRegime("sea", tau=(6.0, 6.0, 12.0), sigma=(9.0, 9.0, 15.0), oscillation=1.0)

MAIN = {"switch-60": Condition(), "switch-30": Condition("deck/switch-30"), "switch-gyro": Condition("deck/switch-gyro")}  # fmt: skip
SHIFTS = {
    "15 s segments": Condition(overrides={"dwell": (15.0, 15.0)}),
    "mild sea": Condition(overrides=mild(find_scenario("deck/switch-60"))),
    "slams twice as large": Condition(overrides=_regimes(lambda r: _change(r, "slam", slam_size=8.0))),
    "slams of 2/s": Condition(overrides=_regimes(lambda r: _change(r, "slam", slam_rate=2.0))),
    "lever 10 cm": Condition(overrides={"lever_error": 0.1}),
    "flexure guessed": Condition(overrides={"believed": GUESS}),
    "flexure changed per axis": Condition(overrides=_regimes(lambda r: dataclasses.replace(r, **_PER_AXIS) if r.name != "swell" else r)),
    "glitch rate 30 %": Condition(overrides=_regimes(lambda r: _change(r, "glitch", glitch_rate=0.3))),
    "slams and glitches at once": Condition(overrides={"regimes": (CALM, SWELL, _BOTH, GLITCH)}),
    "IMU ten times worse": Condition(overrides={"sub": SUB_ERRORS.scaled(10.0)}),
    "static (30, 10, 30) degrees": Condition(overrides={"static": (1800.0, 600.0, 1800.0)}),
}  # fmt: skip
WRONG = {
    "glitch sizes told ½": Condition(told={"glitch_velocity": 0.5, "glitch_rate_size": 1e-3}),
    "glitch sizes told ×2": Condition(told={"glitch_velocity": 2.0, "glitch_rate_size": 4e-3}),
    "glitch rate told ¼": Condition(told={"glitch_rate": 0.025}),
    "glitch rate told ×3": Condition(told={"glitch_rate": 0.3}),
    "slam size told ½": Condition(told={"slam_size": 2.0}),
    "slam size told ×2": Condition(told={"slam_size": 8.0}),
    "slam rate told ¼": Condition(told={"slam_rate": 0.05}),
    "slam rate told ×3": Condition(told={"slam_rate": 0.6}),
    "stay told 30 s": Condition(told={"mode_stay": 0.967}),
    "stay told 300 s": Condition(told={"mode_stay": 0.9967}),
}
SEAS = {
    "calm": Condition("deck/paper", {"lever_error": 0.03}, best=False),
    "lever": Condition("deck/lever", best=False),
    "swell": Condition("deck/paper", {"regimes": (SWELL,), "believed": CALM, "lever_error": 0.03}, best=False),
    "first sea between": Condition("deck/paper", {"regimes": (_FIRST_SEA,), "believed": CALM, "lever_error": 0.03}, best=False),
    "second sea between": Condition("deck/paper", {"regimes": (_SECOND_SEA,), "believed": CALM, "lever_error": 0.03}, best=False),
    "heavy sea": Condition("deck/paper", {"regimes": (HEAVY_SEA,), "believed": CALM, "lever_error": 0.03}, best=False),
    "sea-state": Condition("deck/sea-state", best=False),
}  # fmt: skip


_OTHERS: dict[str, dict[str, dict[str, Array]]] = {}


def errors(cases: Cases, states: Array) -> dict[str, Array]:
    """Norms by quantity, (N,) each."""
    norm = deck_errors(cases.batch, states).norm
    return {q: norm[q] for q in QUANTITIES}


def contenders(condition: Condition, cases: Cases, known: bool) -> dict[str, Callable[[], Array]]:
    """Who runs on a condition: label to states (N, K, 24); those who are told nothing unless `known`."""

    def run(name: str | Filter, parameters: Any = None, interval: int | None = None) -> Array:
        return PROBLEM.run(name, cases.batch, parameters, interval).states

    told = dict(condition.told)
    found = {
        "deck_bank": lambda: run("deck_bank", told),
        "deck_bank_lever": lambda: run("deck_bank_lever", told),
    }
    if known:
        return found
    found["oracle"] = lambda: run("oracle")
    if not condition.best:
        found["alignment"] = lambda: run("alignment")
    else:
        width = find_scenario(condition.scenario).reference
        found["fixed"] = lambda: run("alignment_mcc", dict(width))
        policy = choosing("policy", Learnt(agents.shipped("deck")), cases)
        entry = policy.entry
        found["policy"] = lambda: run(policy.runs or "", entry.parameters, entry.interval)
    return found


def measured(condition: Condition, options: Options) -> dict[str, dict[str, Array]]:
    """Errors (N,) by contender and quantity; of those who are told nothing, only once."""
    where = f"{condition.scenario}, {condition.overrides}"
    others = _OTHERS.get(where, {})
    parts: dict[str, list[dict[str, Array]]] = {}
    for cases in condition.parts(options):
        for label, states in contenders(condition, cases, bool(others)).items():
            parts.setdefault(label, []).append(errors(cases, states()))
    found = {
        label: {q: np.concatenate([p[q] for p in each]) for q in QUANTITIES}
        for label, each in parts.items()
    }
    _OTHERS[where] = others or {k: v for k, v in found.items() if not k.startswith("deck_bank")}
    return found | _OTHERS[where]


def gain(own: Array, base: Array) -> str:
    """Paired gain in per cent with its interval."""
    g = paired_difference(own, base)
    return f"{100 * g.relative_gain:+.1f} ({100 * g.gain_low:+.1f} to {100 * g.gain_high:+.1f})"


def compare(title: str, conditions: Mapping[str, Condition], options: Options) -> Found:
    """A table per condition: everybody's means, and the banks' gains over whoever is best known."""
    print(f"\n## {title}\n")
    print("| condition | filter | θ̇ | θ_ac | θ | attitude | θ̇ over fixed, % | θ̇ over policy, % | θ_ac over fixed, % | worst θ̇ |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|")
    found = {}
    for name, condition in conditions.items():
        each = measured(condition, options)
        base = each["fixed" if condition.best else "alignment"]
        other = each.get("policy", base)
        for label, e in each.items():
            means = " | ".join(f"{e[q].mean():.3f}" for q in QUANTITIES)
            gains = [(e["theta_rate"], base["theta_rate"]), (e["theta_rate"], other["theta_rate"]), (e["theta_ac"], base["theta_ac"])]  # fmt: skip
            told = " | ".join("–" if a is b else gain(a, b) for a, b in gains)
            print(
                f"| {name} | {label} | {means} | {told} | {e['theta_rate'].max():.2f} |", flush=True
            )
        found[name] = {k: {q: v.tolist() for q, v in e.items()} for k, e in each.items()}
    return found


def lags(options: Options) -> Found:
    """θ̇ told one and two steps late, from the bank's own lagged states."""
    print(
        "\n## θ̇ with a lag\n\n| filter | at once | 50 ms late | 100 ms late | 50 ms over at once, % |"
    )
    print("|---|---|---|---|---|")
    found = {}
    for name in ("deck_bank", "deck_bank_lever"):
        rows: list[Array] = []
        for cases in Condition().parts(
            dataclasses.replace(options, runs=max(options.runs // 2, 2))
        ):
            for i in range(len(cases)):
                one = cases.take([i]).batch
                run = PROBLEM.run(name, one, everything=True)
                late = run.extras["theta_rate_lagged"][0]
                told = [run.states[0][:, 21:], *(late[:, b] for b in range(2))]
                rows.append(np.array([_late(one, told[b], b) for b in range(3)]))
        each = np.array(rows)
        means = " | ".join(f"{m:.3f}" for m in each.mean(axis=0))
        print(f"| {name} | {means} | {gain(each[:, 1], each[:, 0])} |", flush=True)
        found[name] = each.tolist()
    return found


def smoothed(options: Options) -> Found:
    """What the banks know afterwards: each step by the whole recording (`navgym.smooth`)."""
    print("\n## Afterwards\n\n| sea | filter | | θ̇ | θ_ac | θ | attitude | NEES of θ̇, θ |")
    print("|---|---|---|---|---|---|---|---|")
    found = {}
    few = dataclasses.replace(options, runs=max(options.runs // 5, 2))
    for sea in ("calm", "lever", "switch-60"):
        condition = Condition() if sea == "switch-60" else SEAS[sea]
        rows: dict[tuple[str, str], list[Array]] = {}
        for cases in condition.parts(few):
            for i in range(len(cases)):
                one = cases.take([i]).batch
                for name in ("deck_bank", "deck_bank_lever"):
                    ways = PROBLEM.run(name, one, everything=True), PROBLEM.smooth(name, one)
                    for way, run in zip(("filtered", "smoothed"), ways, strict=True):
                        e = deck_errors(one, run.states).norm
                        told = [e[q][0] for q in QUANTITIES] + _nees(one, run)
                        rows.setdefault((name, way), []).append(np.array(told))
        for (name, way), each in rows.items():
            m = np.mean(each, axis=0)
            means = " | ".join(f"{v:.3f}" for v in m[:4])
            print(f"| {sea} | {name} | {way} | {means} | {m[4]:.2f}, {m[5]:.2f} |", flush=True)
            found[f"{sea}, {name}, {way}"] = np.array(each).tolist()
    return found


def _late(batch: Any, rates: Array, lag: int) -> float:
    """RMS length of θ̇'s error, ′/s, of rates (K, 3) that are told `lag` steps late."""
    true = batch.tapes["theta_rate"][0]
    error = rates[START + lag :] - true[START : len(true) - lag]
    return float(np.sqrt((error**2).sum(axis=1).mean())) / ARCMIN


def widths(options: Options) -> Found:
    """The joint model of the mean rate, one mode, with a correntropy kernel of fixed width."""
    print("\n## The joint model at a fixed width: θ̇, and what it changes\n")
    print("| scenario | width | end-point model | joint model | gain, % |\n|---|---|---|---|---|")
    space = ALIGNMENT_MCC
    joint = Filter("joint", "the joint model at a fixed width", space, "deck", Deck(joint=True))
    found = {}
    for scenario in ("paper", "slam", "glitch", "switch-60"):
        rows: dict[float, list[tuple[Array, Array]]] = {}
        few = dataclasses.replace(options, runs=max(options.runs // 2, 2))
        for cases in Condition(f"deck/{scenario}").parts(few):
            for width in (50.0, 20.0, 10.0, 5.0, 3.0):
                runs = [
                    PROBLEM.run(f, cases.batch, {"kernel_width": width}).states
                    for f in (CATALOGUE["alignment_mcc"], joint)
                ]
                each = [
                    deck_errors(cases.batch, s, attitude=False).norm["theta_rate"] for s in runs
                ]
                rows.setdefault(width, []).append((each[0], each[1]))
        for width, parts in rows.items():
            plain, own = (np.concatenate([p[i] for p in parts]) for i in range(2))
            print(f"| {scenario} | {width:g} | {plain.mean():.3f} | {own.mean():.3f} | {gain(own, plain)} |", flush=True)  # fmt: skip
            found[f"{scenario}, {width:g}"] = [plain.tolist(), own.tolist()]
    return found


def nees(options: Options) -> Found:
    """Errors of θ̇ and of θ against what the filters say of them, per state."""
    print(
        "\n## Normalised errors squared, per state\n\n| sea | filter | θ̇ | θ |\n|---|---|---|---|"
    )
    found = {}
    for sea in ("calm", "lever", "switch-60"):
        condition = Condition() if sea == "switch-60" else SEAS[sea]
        rows: dict[str, list[Any]] = {}
        for cases in condition.parts(options):
            for i in range(len(cases)):
                one = cases.take([i]).batch
                for name in ("alignment", "deck_bank", "deck_bank_lever"):
                    run = PROBLEM.run(name, one, everything=True)
                    rows.setdefault(name, []).append(_nees(one, run))
        for name, each in rows.items():
            rate, theta = np.mean(each, axis=0)
            print(f"| {sea} | {name} | {rate:.2f} | {theta:.2f} |", flush=True)
            found[f"{sea}, {name}"] = np.array(each).tolist()
    return found


def identified(options: Options) -> Found:
    """Filters that identify the flexure beside the bank, which believes two: a third of the recordings."""
    print("\n## Identification beside the bank\n\n| sea | filter | θ̇ | θ_ac | θ | attitude | θ̇: the bank over it, % | θ_ac, % |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")
    few, found = dataclasses.replace(options, runs=max(options.runs // 3, 2)), {}
    for scenario in ("paper", "sea-state", "switch-60"):
        parts: dict[str, list[dict[str, Array]]] = {}
        for cases in Condition(f"deck/{scenario}").parts(few):
            for name in ("alignment_mcc", "idam", "svram", "woam", "deck_bank", "oracle"):
                wide = {} if name in ("deck_bank", "oracle") else _best_width(scenario)
                states = PROBLEM.run(name, cases.batch, wide).states
                parts.setdefault(name, []).append(errors(cases, states))
        each = {n: {q: np.concatenate([p[q] for p in rows]) for q in QUANTITIES} for n, rows in parts.items()}  # fmt: skip
        for name, e in each.items():
            means = " | ".join(f"{e[q].mean():.3f}" for q in QUANTITIES)
            own = each["deck_bank"]
            gains = " | ".join("–" if e is own else gain(own[q], e[q]) for q in QUANTITIES[:2])
            print(f"| {scenario} | {name} | {means} | {gains} |", flush=True)
        found[scenario] = {n: {q: v.tolist() for q, v in e.items()} for n, e in each.items()}
    return found


def told(options: Options) -> Found:
    """What the bank would win if it were told the regime: the mode of each step's runs alone."""
    print(
        "\n## The regime told instead of found\n\n| filter | θ̇ | θ_ac | θ | attitude | θ̇ won by knowing, % |"
    )
    print("|---|---|---|---|---|---|")
    parts: dict[str, list[dict[str, Array]]] = {"found": [], "told": []}
    for cases in Condition().parts(options):
        found = PROBLEM.run("deck_bank", cases.batch).states
        known = np.concatenate([_knowing(cases.take([i])) for i in range(len(cases))])
        parts["found"].append(errors(cases, found))
        parts["told"].append(errors(cases, known))
    each = {n: {q: np.concatenate([p[q] for p in rows]) for q in QUANTITIES} for n, rows in parts.items()}  # fmt: skip
    for name, e in each.items():
        means = " | ".join(f"{e[q].mean():.3f}" for q in QUANTITIES)
        won = "–" if name == "found" else gain(e["theta_rate"], each["found"]["theta_rate"])
        print(f"| {name} | {means} | {won} |", flush=True)
    return {n: {q: v.tolist() for q, v in e.items()} for n, e in each.items()}


def _knowing(cases: Cases) -> Array:
    """States (1, K, 24) on one recording of switch-60 of the bank's modes, each where it is right."""
    batch, recording, n = cases.batch, cases.recordings[0], alignment.STATES
    mode = {"calm": 0, "swell": 1, "slam": 2, "glitch": 3}
    right = np.array([mode[name] for name in cases.regimes])[batch.regimes()[0]]
    space = CATALOGUE["deck_bank"].space
    row = hypotheses.table_of(space, space.array({})[None])
    models = alignment_model.pack(recording, hypotheses.flexures_of(recording.model))[None]
    lanes = np.zeros((1, 2), joint.LANE)
    hypotheses.begin(lanes, models, hypotheses.KINDS[:1], np.zeros(1))
    states, ends = np.zeros((1, len(right), n)), np.flatnonzero(np.diff(right)) + 1
    for first, last in pairwise([0, *ends, len(right)]):
        kinds = hypotheses.KINDS[right[first]][None]
        out = hypotheses.outputs_for(1, last - first, 1, everything=False)
        tapes = np.ascontiguousarray(batch.tapes[:, first:last])
        bank.run(
            lanes, models, kinds, tapes, first, row, 1, *hypotheses.NOTHING_KNOWN, *out.values()
        )
        states[:, first:last] = out["states"]
    return states


def _best_width(scenario: str) -> dict[str, Any]:
    return dict(find_scenario(f"deck/{scenario}").reference)


def _nees(batch: Any, run: Any) -> list[float]:
    errors, P = run_errors(batch, 0, run.states[0], attitude=False), run.covariances[0]
    found = []
    for name, first in (("theta_rate", 21), ("theta", 18)):
        e = errors[name][START::20] * ARCMIN
        own = P[START::20, first : first + 3, first : first + 3]
        found.append(float(np.einsum("ki,kij,kj->k", e, np.linalg.inv(own), e).mean() / 3.0))
    return found


def main() -> None:
    """Make the tables that were asked for."""
    options, began = tyro.cli(Options, description=__doc__), time.perf_counter()
    tables: dict[str, Callable[[], Found]] = {
        "main": lambda: compare("Switching seas", MAIN, options),
        "shifts": lambda: compare("Other conditions", SHIFTS, options),
        "wrong": lambda: compare("switch-60, told wrong", WRONG, options),
        "seas": lambda: compare("One sea; gains over `alignment`", SEAS, options),
        "lags": lambda: lags(options),
        "widths": lambda: widths(options),
        "nees": lambda: nees(options),
        "identified": lambda: identified(options),
        "told": lambda: told(options),
        "smoothed": lambda: smoothed(options),
    }
    chosen = options.only or tuple(tables)
    found = {name: tables[name]() for name in chosen}
    print(
        f"\n{options.runs} recordings of {options.split} seeds; {time.perf_counter() - began:.0f} s"
    )
    if options.out is not None:
        options.out.write_text(json.dumps(found))


if __name__ == "__main__":
    main()
