"""The deck's half of the evaluation: conditions, contenders, errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.baselines import PLAIN, Random, TrueRegime, hand_rule, has_table, whole_filters
from agents.contest import (
    AS_TRAINED,
    BEST_FIXED,
    DEFAULT,
    HAND_RULE,
    OTHER,
    OWN,
    SHIFT,
    Condition,
    Contender,
    Labels,
    World,
    choosing,
    short,
)
from agents.rollout import DECK, STEERED_DECK
from navgym._checks import Array
from navgym.deck_estimation import run_deck
from navgym.filters.alignment import FLEXING
from navgym.filters.catalogue import Filter
from navgym.metrics import consistency, nees
from navgym.metrics.deck import START, deck_errors, run_errors
from navgym.scenarios.deck import GUESS, DeckScenario
from navgym.simulation import find_scenario
from tuning.comparison import Entry
from tuning.deck_cases import DeckCases

TABLE = "true-regime schedule"
OTHERS = ("deck/switch-60", "deck/switch-30", "deck/switch-gyro")
QUICK = {"duration": 240.0}  # s


def shifts(scenario: DeckScenario) -> dict[str, dict[str, Any]]:
    """Conditions that no policy is trained on, as overrides of `scenario`, by name."""
    return {
        "15 s segments": {"dwell": (15.0, 15.0)},
        "mild sea": mild(scenario),
        "flexure guessed": {"believed": GUESS},
    }


def mild(scenario: DeckScenario) -> dict[str, Any]:
    """Half the sway, half the slams' and the glitches' size, and θ half as large in every regime.

    The filter goes on believing what it believed.
    """
    regimes = tuple(
        replace(
            r,
            sigma=(r.sigma[0] / 2.0, r.sigma[1] / 2.0, r.sigma[2] / 2.0),
            slam_size=r.slam_size / 2.0,
            glitch_velocity=r.glitch_velocity / 2.0,
            glitch_rate_size=r.glitch_rate_size / 2.0,
        )
        for r in scenario.regimes
    )
    believed = scenario.regimes[0] if scenario.believed is None else scenario.believed
    sway = tuple(a / 2.0 for a in scenario.sway)
    return {"regimes": regimes, "sway": sway, "believed": believed}


class DeckWorld(World):
    """Contests of the deck environment; see `World`."""

    environment, half = DECK, "deck"
    quantities = ("theta_rate", "theta_ac", "theta", "attitude")
    everywhere = quantities[:3]  # the attitude takes as long as the filters
    plain, top = PLAIN[DECK], TABLE
    # the bound knows the regime from the first step on, everybody else may begin badly in a glitch
    yardstick = plain
    chunk = 10

    def count(self, condition: Condition) -> int:
        """Recordings of a condition."""
        return self.size.deck if condition.kind == OWN else self.size.deck_other

    def conditions(self) -> list[Condition]:
        """Own scenarios, their shifts, other scenarios; quick ones are shorter."""
        quick = self.size.quick
        more = QUICK if quick else {}
        found = [replace(own, overrides={**own.overrides, **more}) for own in self.own]
        for own in list(found):
            changes: dict[str, Any] = {AS_TRAINED: {}} if self.fallback else {}
            if own is found[0]:  # one scenario's shifts tell enough of the others'
                more_changes = shifts(find_scenario(own.scenario, **own.overrides))
                changes |= dict(list(more_changes.items())[: 1 if quick else None])
            found += [
                Condition(n, own.scenario, {**own.overrides, **c}, SHIFT, own.name)
                for n, c in changes.items()
            ]
        others = [s for s in OTHERS if s not in {own.scenario for own in self.own}]
        chosen = others[-1:] if quick else others
        return found + [Condition(short(s), s, dict(more), OTHER) for s in chosen]

    def streams(self, condition: Condition) -> bool:
        """Whether policies run with their fallback: not where it would take half an hour."""
        return self.fallback and condition.kind != OWN

    def cases(self, condition: Condition, start: int, count: int) -> DeckCases:
        """Test recordings."""
        return DeckCases.simulated(
            condition.scenario, "test", count, start, **dict(condition.overrides)
        )

    def contenders(self, condition: Condition, cases: DeckCases) -> list[Contender]:
        """From the filter without correntropy to the oracle."""
        whole = {e.label: Contender(e) for e in whole_filters(DECK)}
        found = [whole.pop(PLAIN[DECK])]
        found += [choosing("random", Random(DECK), cases)] if condition.kind == OWN else []
        found.append(Contender(Entry(DEFAULT, "alignment_mcc")))
        found += self._fixed(condition)
        found.append(choosing(HAND_RULE, hand_rule(DECK), cases))
        found += self.learners(condition, cases)
        found += [self._table(condition, cases)] if has_table(condition.scenario) else []
        return found + list(whole.values())

    def _fixed(self, condition: Condition) -> list[Contender]:
        """The best fixed parameters here, and the policies' own where they are others."""
        here = dict(find_scenario(condition.scenario).reference)
        found = [Contender(Entry(BEST_FIXED, "alignment_mcc", here))]
        for label, own in self.references(here).items():
            found.append(Contender(Entry(label, "idam", own), runs=STEERED_DECK))
        return found

    def _table(self, condition: Condition, cases: DeckCases) -> Contender:
        lengths, regimes = cases.batch.lengths, cases.batch.tapes["regime"]
        known = [each[:length] for each, length in zip(regimes, lengths, strict=True)]
        table = TrueRegime(DECK, condition.scenario, known, cases.regimes)
        entry = Entry(TABLE, "alignment_mcc", table.schedules(), bound=True, interval=1)
        return Contender(entry)

    # ---- what runs come to

    def run(self, contender: Contender, cases: DeckCases) -> tuple[Array, NDArray[Any]]:
        """See `World`."""
        entry = contender.entry
        found = run_deck(self._chosen(contender), cases.batch, entry.parameters, entry.interval)
        return found["states"], found["diverged"]

    @staticmethod
    def _chosen(contender: Contender) -> str | Filter:
        runs = contender.runs
        return runs if isinstance(runs, Filter) else contender.entry.filter

    def errors(self, cases: DeckCases, states: Array, names: Sequence[str]) -> dict[str, Array]:
        """RMSE of θ̇, of the fast part of θ, of θ and of the attitude."""
        norm = deck_errors(cases.batch, states, attitude="attitude" in names).norm
        return {name: norm[name] for name in names}

    def seconds(self, cases: DeckCases, states: Array) -> Array:
        """Mean squared error of θ̇ in each second from where scoring begins, (arcmin/s)²."""
        per, first = self._grid(cases)
        found = []
        for i, length in enumerate(cases.batch.lengths):
            error = run_errors(cases.batch, i, states[i, :length], attitude=False)["theta_rate"]
            square = (error**2).sum(axis=1)[: length // per * per]
            found.append(square.reshape(-1, per).mean(axis=1)[first:])
        return np.stack(found)

    @staticmethod
    def _grid(cases: DeckCases) -> tuple[int, int]:
        """Filter steps per second, and the second from which on errors count."""
        return max(1, round(1.0 / cases.batch.step)), round(START)

    def labels(self, cases: DeckCases) -> list[Labels]:
        """See `World`."""
        if len(cases.regimes) < 2:
            return []
        per, first = self._grid(cases)
        regimes = np.nan_to_num(cases.batch.tapes["regime"]).astype(np.int64)
        meta = {"regimes": cases.regimes}
        return [
            Labels(row[: n // per * per : per][first:], meta)
            for row, n in zip(regimes, cases.batch.lengths, strict=True)
        ]

    def times(self, cases: DeckCases) -> Array:
        """See `World`."""
        found: Array = np.arange(1, cases.batch.lengths[0] + 1) * cases.batch.step
        return found

    def consistency(self, contender: Contender, cases: DeckCases) -> dict[str, float]:
        """See `World`; of the first recording, NEES of θ and θ̇."""
        entry, some = contender.entry, cases.take([0])
        own = entry.parameters
        parameters = own[:1] if isinstance(own, list) else own
        found = run_deck(
            self._chosen(contender), some.batch, parameters, entry.interval, everything=True
        )
        scored = slice(round(START / some.batch.step), None)
        report = found["report"][0, scored]
        dof = np.isfinite(report["innovation"]).sum(axis=1)
        nis = consistency(report["nis"], dof)
        truth = some.batch.truth
        assert truth is not None
        own_states, P = found["states"][0, scored, FLEXING], found["covariances"][0, scored]
        normalised = nees(own_states, P[:, FLEXING, FLEXING], truth[0, scored])
        heard = dof[np.isfinite(report["nis"]) & (dof > 0)]
        return {
            "nis": nis.mean * nis.samples / float(heard.sum()),
            "inside": nis.inside,
            "nees": float(np.nanmean(normalised)) / truth.shape[-1],
        }


def serves(scenario: str) -> None:
    """Raise ValueError unless the environment can play `scenario`."""
    found = find_scenario(scenario)
    if not isinstance(found, DeckScenario):
        raise ValueError(  # noqa: TRY004
            f"a policy of {DECK} cannot serve {scenario!r}: choose one of {', '.join(OTHERS)}."
        )
