"""What is left for an agent on the deck, and what was tried for its filters and not built.

    python scripts/deck_agent.py                     every table, 40 recordings
    python scripts/deck_agent.py --runs 8            a look
    python scripts/deck_agent.py --only identified   some of the tables

"own": `alignment_own` beside `alignment_mcc`, at the scenario's best width. "joint": the bank's model of
the mean rate in a filter of one width, with widths chosen by the true regime (on other recordings), and
under the shipped policy's widths. "bank": the bank's parameters one by one; what the best of them would
win for all recordings alike, chosen anew for each recording, and chosen by the true regime, all with
hindsight, so that each is a bound. "identified": the bank on the flexure that an RVM finds every 120 s,
shrunk as `idam` does, for the believed sea alone or for both. Errors and gains are those of
`scripts/deck_bank.py`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import tyro
from deck_bank import MAIN, QUANTITIES, SEAS, SHIFTS, START, Condition, Options, errors, gain

from navgym import agents
from navgym.agents.evaluation.contest import choosing
from navgym.agents.evaluation.rollout import Learnt
from navgym.core.checks import Array
from navgym.deck import alignment, alignment_model, bank, hypotheses, joint
from navgym.deck.alignment import RATE
from navgym.deck.catalogue import CATALOGUE, Deck
from navgym.deck.filters import identify_lane
from navgym.deck.problem import PROBLEM
from navgym.deck.spaces import ALIGNMENT_MCC
from navgym.inertial.flexure import ARCMIN
from navgym.problem import Filter
from navgym.simulation import find_scenario
from navgym.tuning.cases import Cases

Errors = dict[str, Array]
WIDTHS = (1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 25.0, 50.0)
REGIMES = ("calm", "swell", "slam", "glitch")
TURNED = {"static": (1800.0, 600.0, 1800.0)}
OWN = {
    f"{name}{', turned by (30, 10, 30) degrees' if turned else ''}": Condition(f"deck/{name}", TURNED if turned else {})
    for turned in (False, True)
    for name in ("paper", "slam", "glitch", "switch-60", "switch-gyro")
}  # fmt: skip
AWAY = ("slams of 2/s", "slams and glitches at once", "flexure changed per axis", "glitch rate 30 %", "mild sea")  # fmt: skip
SEEN = {"switch-60": MAIN["switch-60"], **{name: SHIFTS[name] for name in AWAY}}
TRIED: list[dict[str, float]] = [
    {},
    *({"mode_stay": v} for v in (0.9, 0.967, 0.9967)),
    *({"slam_rate": v} for v in (0.05, 0.8, 2.0)),
    *({"slam_size": v} for v in (2.0, 8.0)),
    *({"glitch_rate": v} for v in (0.03, 0.3)),
    *({"velocity_noise": v} for v in (0.05, 0.1, 0.4)),
    *({"slam_rate": v, "mode_stay": 0.9} for v in (0.8, 2.0)),
]
IDENTIFIED = {
    "paper": Condition("deck/paper"), "sea-state": SEAS["sea-state"], "switch-60": MAIN["switch-60"],
    "swell": SEAS["swell"], "flexure changed per axis": SHIFTS["flexure changed per axis"],
}  # fmt: skip
WINDOW = 120.0  # s


@dataclass(frozen=True)
class Wanted:
    """What was asked for."""

    runs: int = 40
    """recordings per condition; a quarter of it, and at least two, where everything is tried"""
    only: tuple[Literal["own", "joint", "bank", "identified"], ...] = ()
    """tables to make; none: all"""
    split: str = "test"
    """whose seeds"""

    def parts(self, condition: Condition, runs: int | None = None) -> Iterator[Cases]:
        """A condition's recordings, some at a time."""
        found: Iterator[Cases] = condition.parts(Options(runs=runs or self.runs, split=self.split))
        return found

    @property
    def few(self) -> int:
        """Recordings per condition where everything is tried."""
        return max(self.runs // 4, 2)


def measured(parts: Iterator[Cases], run: Callable[[Cases], dict[str, Array]]) -> dict[str, Errors]:
    """Errors (N,) by label and quantity of everybody whose states `run` gives."""
    rows: dict[str, list[Errors]] = {}
    for cases in parts:
        for label, states in run(cases).items():
            rows.setdefault(label, []).append(errors(cases, states))
    return {k: {q: np.concatenate([r[q] for r in each]) for q in QUANTITIES} for k, each in rows.items()}  # fmt: skip


def head(title: str, first: str, base: str) -> None:
    """A table's title and head."""
    print(f"\n## {title}\n\n| {first} | filter | θ̇ | θ_ac | θ | attitude | θ̇ over {base}, % | θ_ac over {base}, % |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")


def show(name: str, each: dict[str, Errors], base: str) -> None:
    """Rows of a condition: means, and gains over `base`."""
    for label, e in each.items():
        means = " | ".join(f"{e[q].mean():.3f}" for q in QUANTITIES)
        gains = " | ".join("–" if label == base else gain(e[q], each[base][q]) for q in QUANTITIES[:2])  # fmt: skip
        print(f"| {name} | {label} | {means} | {gains} |", flush=True)


def own(wanted: Wanted) -> None:
    """The sub IMU's own channels in the filter of one width."""
    head("Own channels at a fixed width", "sea", "alignment_mcc")
    for name, condition in OWN.items():
        width = dict(find_scenario(condition.scenario).reference)

        def run(cases: Cases, width: dict[str, Any] = width) -> dict[str, Array]:
            names = ("alignment_mcc", "alignment_own")
            return {n: PROBLEM.run(n, cases.batch, width).states for n in names}

        show(name, measured(wanted.parts(condition), run), "alignment_mcc")


# ---- the joint model under chosen widths

MODELS = {
    "end-point": CATALOGUE["alignment_mcc"],
    "joint": Filter("joint", "the joint model of the mean rate", ALIGNMENT_MCC, "deck", Deck(joint=True)),
}  # fmt: skip


def by_regime(chosen: Filter, cases: Cases, widths: dict[str, float]) -> Array:
    """States under a width per true regime."""
    each = np.array([widths[name] for name in cases.regimes])
    schedules = [{"kernel_width": each[r]} for r in cases.batch.regimes()]
    return PROBLEM.run(chosen, cases.batch, schedules, 1).states


def best_widths(chosen: Filter, cases: Cases) -> tuple[float, dict[str, float]]:
    """The best width for all regimes, and the best per regime from there, by θ̇."""

    def cost(widths: dict[str, float]) -> float:
        return float(errors(cases, by_regime(chosen, cases, widths))["theta_rate"].mean())

    fixed = min(WIDTHS, key=lambda w: cost(dict.fromkeys(REGIMES, w)))
    table = dict.fromkeys(REGIMES, fixed)
    for name in REGIMES * 2:
        table[name] = min(WIDTHS, key=lambda w, n=name: cost({**table, n: w}))  # type: ignore[misc]
    return fixed, table


def joint_widths(wanted: Wanted) -> None:
    """What the joint model would win for a policy that chooses widths."""
    train = Cases.simulated("deck/switch-60", "train", wanted.few, 500)
    best = {label: best_widths(f, train) for label, f in MODELS.items()}
    policy = Learnt(agents.shipped("deck"))

    def run(cases: Cases) -> dict[str, Array]:
        entry, found = choosing("policy", policy, cases).entry, {}
        widths = [{"kernel_width": p["kernel_width"]} for p in entry.parameters]
        for label, f in MODELS.items():
            fixed, table = best[label]
            found[f"{label}, fixed"] = by_regime(f, cases, dict.fromkeys(REGIMES, fixed))
            found[f"{label}, by true regime"] = by_regime(f, cases, table)
            found[f"{label}, policy's widths"] = PROBLEM.run(f, cases.batch, widths, entry.interval).states  # fmt: skip
        return found | {"deck_bank": PROBLEM.run("deck_bank", cases.batch).states}

    head("Widths on both models of the mean rate", "sea", "end-point, fixed")
    show("switch-60", measured(wanted.parts(MAIN["switch-60"]), run), "end-point, fixed")
    print("\nWidths:", "; ".join(f"{k}: {f:g}, {t}" for k, (f, t) in best.items()))


# ---- the bank's parameters


def squares(cases: Cases, parameters: dict[str, float]) -> tuple[Array, Array]:
    """(N,) mean squared error of θ̇, and (N, regimes) the part of it from each regime, (′/s)²."""
    states = PROBLEM.run("deck_bank", cases.batch, parameters).states
    each = (((states[..., RATE] - cases.batch.tapes["theta_rate"]) / ARCMIN) ** 2).sum(-1)[
        :, START:
    ]
    which, steps = np.stack(cases.batch.regimes())[:, START:], each.shape[1]
    parts = [(each * (which == r)).sum(axis=1) / steps for r in range(len(cases.regimes))]
    return each.mean(axis=1), np.stack(parts, axis=1)


def bank_parameters(wanted: Wanted) -> None:
    """Bounds on what choosing the bank's parameters can win, condition by condition."""
    print("\n## The bank's parameters, chosen with hindsight\n\n| condition | θ̇ | one for all, % | which | per recording, % | by true regime, % |")  # fmt: skip
    print("|---|---|---|---|---|---|")
    for name, condition in SEEN.items():
        whole, parts = [], []
        for cases in wanted.parts(condition, wanted.few):
            found = [squares(cases, tried) for tried in TRIED]
            whole.append(np.sqrt([f[0] for f in found]))
            parts.append(np.array([f[1] for f in found]))
        rates, shares = np.concatenate(whole, axis=1), np.concatenate(parts, axis=1)
        usual, means = rates[0].mean(), rates.mean(axis=1)
        regimes = shares.sum(axis=1)
        chosen = 1.0 - np.sqrt(regimes.min(axis=0).sum() / regimes[0].sum())
        best = int(means.argmin())
        told = (1.0 - means[best] / usual, 1.0 - rates.min(axis=0).mean() / usual, chosen)
        one, each, regime = (f"{100 * g:.1f}" for g in told)
        print(f"| {name} | {usual:.3f} | {one} | {TRIED[best] or 'as shipped'} | {each} | {regime} |", flush=True)  # fmt: skip


# ---- the bank on identified flexure


def on_identified(cases: Cases, both: bool) -> Array:
    """States of a bank that identifies the flexure after every window, as `idam` does."""
    batch = cases.batch
    states = np.full((*batch.tapes.shape, alignment.STATES), np.nan)
    for i in range(len(cases)):
        states[i] = _one_identified(batch, i, both)
    return states


def _one_identified(batch: Any, i: int, both: bool) -> Array:
    recording, tapes, n = batch.recordings[i], batch.tapes[i : i + 1], alignment.STATES
    space, window = CATALOGUE["deck_bank"].space, round(WINDOW / batch.step)
    row = hypotheses.table_of(space, space.array({})[None])
    models = alignment_model.pack(recording, hypotheses.flexures_of(recording.model))[None]
    lanes = np.zeros((1, len(hypotheses.KINDS) + 1), joint.LANE)
    hypotheses.begin(lanes, models, hypotheses.KINDS, np.zeros(1))
    states = np.full((1, tapes.shape[1], n), np.nan)
    rest = (np.zeros((1, 0), alignment.REPORT), np.zeros((1, 0, n, n)), np.zeros((1, 0, 4)), np.zeros((1, 0, 2, 3)))  # fmt: skip
    for end in [*range(window, int(batch.lengths[i]), window), int(batch.lengths[i])]:
        lanes["length"] = end
        bank.run(lanes, models, hypotheses.KINDS, tapes, 0, row, 1, *hypotheses.NOTHING_KNOWN, states, *rest)  # fmt: skip
        found = identify_lane(
            Deck("rvm"), tapes[0], batch.step, recording.model.flexure, lanes[0, -1], window,
            {"rvm_kernel_scale": 2.0},
        )  # fmt: skip
        if found is not None:
            alignment_model.write_flexure(models[0, 0], found)
            if both:
                alignment_model.write_flexure(models[0, 1], hypotheses.rougher(found))
    return states[0]


def identified(wanted: Wanted) -> None:
    """The bank as it is, on identified flexure, and the oracle."""
    head("The bank on identified flexure", "sea", "deck_bank")

    def run(cases: Cases) -> dict[str, Array]:
        return {
            "deck_bank": PROBLEM.run("deck_bank", cases.batch).states,
            "believed sea identified": on_identified(cases, False),
            "both seas identified": on_identified(cases, True),
            "oracle": PROBLEM.run("oracle", cases.batch).states,
        }

    for name, condition in IDENTIFIED.items():
        show(name, measured(wanted.parts(condition), run), "deck_bank")


def main() -> None:
    """Make the tables that were asked for."""
    wanted, began = tyro.cli(Wanted, description=__doc__), time.perf_counter()
    tables = {"own": own, "joint": joint_widths, "bank": bank_parameters, "identified": identified}
    for name in wanted.only or tuple(tables):
        tables[name](wanted)
    print(
        f"\n{wanted.runs} recordings of {wanted.split} seeds; {time.perf_counter() - began:.0f} s"
    )


if __name__ == "__main__":
    main()
